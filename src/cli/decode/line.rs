//! What is printed: a datagram and where it was found, or a request that got no answer. The JSON has the
//! field names of the Wireshark dissector without `pnet.`; a test compares the two.

use std::fmt::{self, Display};
use std::io::{self, Write};
use std::net::SocketAddr;
use std::time::SystemTime;

use serde::{Serialize, Serializer};

use super::fields::{Fields, Tree};
use super::pairing::{Asked, PATIENCE, Request};
use super::profinet::Protocol;
use super::row::InRow;

/// A datagram and where it was found.
#[derive(Debug, Serialize)]
pub(super) struct Line<'a> {
    #[serde(flatten)]
    pub(super) place: Locator,
    /// The number of the packet again, as the other protocols call it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) frame: Option<u64>,
    pub(super) protocol: Protocol,
    /// How many IP fragments it came in, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fragments: Option<u64>,
    /// Only where it is one of several in a payload.
    #[serde(flatten)]
    pub(super) in_row: Option<InRow>,
    #[serde(flatten)]
    pub(super) fields: Fields<'a>,
    /// The request that it answers, if that is in the capture.
    #[serde(flatten)]
    pub(super) answer: Option<Answer>,
}

/// Where a datagram was found.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Locator {
    Text {
        line: u64,
    },
    Capture {
        packet: u64,
        #[serde(serialize_with = "rfc3339", skip_serializing_if = "Option::is_none")]
        time: Option<SystemTime>,
        from: SocketAddr,
        to: SocketAddr,
    },
}

/// An answer, seen from its request.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Answer {
    answer_to: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    response_time_seconds: Option<f64>,
    /// Only where it is another one than the answer comes from.
    #[serde(skip_serializing_if = "Option::is_none")]
    asked_port: Option<u16>,
}

impl From<Asked> for Answer {
    fn from(asked: Asked) -> Self {
        Self {
            answer_to: asked.packet,
            response_time_seconds: asked.elapsed.map(|elapsed| elapsed.as_secs_f64()),
            asked_port: asked.from_another_port.then_some(asked.server.port()),
        }
    }
}

/// A request without an answer.
#[derive(Debug, Serialize)]
pub(super) struct Unanswered {
    #[serde(flatten)]
    place: Locator,
    #[serde(skip_serializing_if = "Option::is_none")]
    ip_net_id: Option<u8>,
    node_address: u8,
    reason: Reason,
}

/// Why no answer is waited for any more.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Reason {
    /// None came in time.
    Time,
    /// The capture ended.
    End,
    /// Too many requests were open.
    Room,
}

impl Unanswered {
    pub(super) fn new(request: &Request, reason: Reason) -> Self {
        let &Request { packet, time, client, server, ip_net_id, node_address, .. } = request;
        let place = Locator::Capture { packet, time, from: client, to: server };
        Self { place, ip_net_id, node_address, reason }
    }
}

impl Locator {
    /// The number of the packet, in a capture.
    pub(super) fn packet(&self) -> Option<u64> {
        match self {
            Self::Text { .. } => None,
            Self::Capture { packet, .. } => Some(*packet),
        }
    }
}

impl Line<'_> {
    /// With a line for each field.
    pub(super) fn write_tree(&self, output: &mut impl Write) -> io::Result<()> {
        self.place_in_words(output)?;
        write!(output, "{}", Tree(&self.fields))?;
        match &self.answer {
            Some(answer) => writeln!(output, "    {answer}"),
            None => Ok(()),
        }
    }

    /// On one line.
    pub(super) fn write_text(&self, output: &mut impl Write) -> io::Result<()> {
        self.place_in_words(output)?;
        write!(output, "{}", self.fields)?;
        match &self.answer {
            Some(answer) => writeln!(output, "; {answer}"),
            None => writeln!(output),
        }
    }

    fn place_in_words(&self, output: &mut impl Write) -> io::Result<()> {
        write!(output, "{}: ", self.place)?;
        if let Some(fragments) = self.fragments {
            write!(output, "of {fragments} fragments: ")?;
        }
        match self.in_row {
            Some(in_row) => write!(output, "{in_row}: "),
            None => Ok(()),
        }
    }
}

impl Display for Locator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text { line } => write!(f, "line {line}"),
            Self::Capture { packet, time, from, to } => {
                write!(f, "packet {packet}, ")?;
                if let Some(time) = time {
                    write!(f, "{}, ", humantime::format_rfc3339_micros(*time))?;
                }
                write!(f, "{from} > {to}")
            }
        }
    }
}

impl Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "answer to packet {}", self.answer_to)?;
        if let Some(asked_port) = self.asked_port {
            write!(f, " from another port than {asked_port}")?;
        }
        match self.response_time_seconds {
            Some(seconds) => write!(f, ", +{:.3} ms", seconds * 1e3),
            None => Ok(()),
        }
    }
}

impl Display for Unanswered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { place, ip_net_id, node_address, reason } = self;
        write!(f, "{place}: unanswered request to ")?;
        if let Some(ip_net_id) = ip_net_id {
            write!(f, "net {ip_net_id} ")?;
        }
        write!(f, "node {node_address}, ")?;
        match reason {
            Reason::Time => write!(f, "no answer within {} s", PATIENCE.as_secs()),
            Reason::End => f.write_str("the capture ended"),
            Reason::Room => f.write_str("given up because too many requests are open"),
        }
    }
}

/// Times as they are in every JSON object.
pub(super) fn rfc3339<S: Serializer>(
    time: &Option<SystemTime>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match time {
        Some(time) => serializer.collect_str(&humantime::format_rfc3339_micros(*time)),
        None => serializer.serialize_none(),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::pnet::wire::Header;

    /// PAS Figure 10 as a request to the Secure port.
    const FIGURE_10: &[u8] =
        b"\x02\0\0\0\x0B\x04\x05\x02\x21\x8B\x83\x9F\x2A\xC3\x12\x34\x56PNETPASS";

    fn line(octets: &[u8], length: usize) -> Line<'_> {
        let fields = Fields::of(octets, length, Header::default());
        Line {
            place: Locator::Text { line: 7 },
            frame: None,
            protocol: Protocol::PNet,
            fragments: None,
            in_row: None,
            fields,
            answer: None,
        }
    }

    fn text(line: &Line<'_>) -> String {
        let mut text = Vec::new();
        line.write_text(&mut text).unwrap();
        String::from_utf8(text).unwrap().trim_end().to_owned()
    }

    #[track_caller]
    fn shows(octets: &[u8], right: &str) {
        let line = line(octets, octets.len());
        assert_eq!(text(&line), format!("line 7: {right}"));
    }

    #[test]
    fn figure_10_as_text() {
        shows(
            FIGURE_10,
            "confirmed; ip route to net 11 node 4, on to 2.33, from net 11 node 3, on to 31; \
             control-status $2A, data-field-format $C3, data 123456, password present",
        );
    }

    #[test]
    fn other_formats_as_text() {
        shows(
            b"\x02\0\0\0\x04\x83\0\0",
            "of no DLPDU type; simple route to 4 from 3; control-status $00, data-field-format \
             $00, data none, password absent",
        );
        shows(
            b"\x02\0\0\0\x83\x04\x01\x01\xFF",
            "immediate reply; immediate route to 4 from 3; control-status $01, data-field-format \
             $01, data ff, password absent",
        );
        shows(
            b"\x02\0\0\0\x0B\x7E\x8B\x83\0\x03abc",
            "unconfirmed; extended route to net 11 node 126 (every node), from net 11 node 3; \
             control-status $00, data-field-format $03, data 616263, password absent",
        );
    }

    #[test]
    fn what_is_wrong_and_where_as_text() {
        shows(b"\x02", "malformed at octet 1 of 1: a datagram has at least 8 octets");
        shows(
            b"\x02\0\0\0\x0B\x04\0\x8B\x83",
            "malformed at octet 6 of 9: bad route: the remaining-route-length is 0, not 1 to 27",
        );
        shows(
            &FIGURE_10[..16],
            "malformed at octet 16 of 16: the octets behind the route do not fit the \
             data-field-format; ip route to net 11 node 4, on to 2.33, from net 11 node 3, on to 31",
        );
        assert_eq!(
            text(&line(&FIGURE_10[..20], 25)),
            "line 7: malformed at octet 20 of 25: only 20 of its 25 octets were captured"
        );
    }

    #[test]
    fn an_answer_has_its_request_and_the_time_since_then() {
        let mut line = line(b"\x02\0\0\0\x04\x83\0\0", 8);
        let asked = Asked {
            packet: 17,
            elapsed: Some(Duration::from_nanos(1_234_499)),
            server: "203.0.113.5:20004".parse().unwrap(),
            from_another_port: true,
        };
        for (asked, words, json) in [
            (
                asked,
                "; answer to packet 17 from another port than 20004, +1.234 ms",
                r#","answer_to":17,"response_time_seconds":0.001234499,"asked_port":20004}"#,
            ),
            (
                Asked { from_another_port: false, ..asked },
                "; answer to packet 17, +1.234 ms",
                r#","answer_to":17,"response_time_seconds":0.001234499}"#,
            ),
            (
                Asked { from_another_port: false, elapsed: None, ..asked },
                "; answer to packet 17",
                r#","answer_to":17}"#,
            ),
        ] {
            line.answer = Some(asked.into());
            let text = text(&line);
            assert!(text.ends_with(&format!("password absent{words}")), "{text}");
            assert!(serde_json::to_string(&line).unwrap().ends_with(json));
        }
    }

    #[test]
    fn whatever_is_wrong_the_password_is_not_shown() {
        let behind = [FIGURE_10, b"x"].concat();
        let (mut header, mut route) = (FIGURE_10.to_vec(), FIGURE_10.to_vec());
        (header[1], route[6]) = (1, 0);
        for octets in [FIGURE_10, &behind, &header, &route, &FIGURE_10[..24], &FIGURE_10[17..]] {
            let line = line(octets, octets.len());
            let json = serde_json::to_string(&line).unwrap();
            let mut tree = Vec::new();
            line.write_tree(&mut tree).unwrap();
            let tree = String::from_utf8(tree).unwrap();
            for shown in [text(&line), tree, json, format!("{line:?}")] {
                assert!(!shown.contains("PNET") && !shown.contains("504e"), "{shown}");
            }
        }
    }
}
