//! A datagram as it is printed. The JSON has the field names of the Wireshark dissector without `pnet.`;
//! a test compares the two.
//!
//! Invariant: of the octets only the decoded fields are shown, and of the password only whether there is
//! one. Nothing here allocates: there may be millions of datagrams.

use std::fmt::{self, Display};
use std::net::SocketAddr;
use std::time::SystemTime;

use serde::{Serialize, Serializer};

use super::fragments::{Broken, Head};
use super::row::InRow;
use crate::cli::output::{Dotted, Hex};
use crate::pnet::wire::{
    BNA, Datagram, DatagramError, DatagramRepr, DlpduType, Elements, Header, Route, RouteFormat,
    SNA,
};

/// A datagram and where it was found.
#[derive(Debug, Serialize)]
pub(super) struct Line<'a> {
    #[serde(flatten)]
    pub(super) place: Locator,
    /// How many IP fragments it came in, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fragments: Option<usize>,
    /// Only where it is one of several in a payload.
    #[serde(flatten)]
    pub(super) in_row: Option<InRow>,
    #[serde(flatten)]
    pub(super) fields: Fields<'a>,
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

/// What a datagram says, as far as it can be read.
#[derive(Debug, Serialize)]
pub(super) struct Fields<'a> {
    length: usize,
    #[serde(flatten)]
    route: Option<RouteFields<'a>>,
    #[serde(flatten)]
    rest: Option<Rest<'a>>,
    #[serde(flatten)]
    fault: Option<Fault>,
}

/// Header and route: what comes before the control-status.
#[derive(Debug, Serialize)]
struct RouteFields<'a> {
    #[serde(serialize_with = "text")]
    header: Header,
    #[serde(serialize_with = "text")]
    route: Hex<'a>,
    route_format: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    remaining_route_length: Option<u8>,
    #[serde(serialize_with = "list")]
    destinations: Elements,
    #[serde(serialize_with = "list")]
    sources: Elements,
    #[serde(flatten)]
    ip: Option<IpRoute>,
}

/// The roles of elements in a route of Extended or IP format.
#[derive(Debug, Serialize)]
struct IpRoute {
    ip_net_id: u8,
    node_address: u8,
    source_ip_net_id: u8,
    source_node_address: u8,
}

/// What comes after the route.
#[derive(Debug, Serialize)]
struct Rest<'a> {
    #[serde(serialize_with = "dlpdu_type", skip_serializing_if = "Option::is_none")]
    dlpdu_type: Option<DlpduType>,
    control_status: u8,
    data_field_format: u8,
    data_field_flags: u8,
    data_size: usize,
    #[serde(serialize_with = "text")]
    data: Hex<'a>,
    password: &'static str,
}

/// Why it is not a datagram, and the first octet that is wrong.
#[derive(Debug, Serialize)]
struct Fault {
    #[serde(serialize_with = "text")]
    error: Error,
    error_offset: usize,
}

#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("only {captured} of its {length} octets were captured")]
    Cut { captured: usize, length: usize },
    #[error(transparent)]
    Malformed(#[from] DatagramError),
    #[error(transparent)]
    Broken(#[from] Broken),
}

impl<'a> Fields<'a> {
    /// Those of a datagram whose fragments were not put together. Nothing but its length is certain.
    pub(super) fn of_broken(head: Head, why: Broken) -> Self {
        let fault = Some(Fault { error: why.into(), error_offset: head.captured });
        Self { length: head.length, route: None, rest: None, fault }
    }

    /// Reads what was captured of a datagram of `length` octets.
    pub(super) fn of(octets: &'a [u8], length: usize, header: Header) -> Self {
        let captured = octets.len();
        if captured < length {
            let fault =
                Some(Fault { error: Error::Cut { captured, length }, error_offset: captured });
            return Self { length, route: None, rest: None, fault };
        }
        match Datagram::parse(octets, header) {
            Ok(datagram) => {
                let route = Some(RouteFields::of(header, datagram.route()));
                Self { length, route, rest: Some(Rest::of(&datagram)), fault: None }
            }
            Err(error) => {
                // If only the length is wrong, the route can be shown.
                let package = octets.get(Header::LEN..).unwrap_or_default();
                let route =
                    Route::parse(package).ok().filter(|_| error == DatagramError::BadLength);
                let error_offset = error.position(octets, header);
                Self {
                    length,
                    route: route.map(|route| RouteFields::of(header, route)),
                    rest: None,
                    fault: Some(Fault { error: error.into(), error_offset }),
                }
            }
        }
    }
}

impl<'a> RouteFields<'a> {
    fn of(header: Header, route: Route<'a>) -> Self {
        let sources: Elements = route.sources().collect();
        let ip = match (route.ip_net_id(), route.node_address(), &sources[..]) {
            (Some(ip_net_id), Some(node_address), &[source_ip_net_id, source_node_address, ..]) => {
                Some(IpRoute { ip_net_id, node_address, source_ip_net_id, source_node_address })
            }
            _ => None,
        };
        Self {
            header,
            route: Hex(route.as_bytes()),
            route_format: match route.format() {
                RouteFormat::Simple => "simple",
                RouteFormat::Extended => "extended",
                RouteFormat::Complex => "complex",
                RouteFormat::Immediate => "immediate",
                RouteFormat::Ip => "ip",
            },
            remaining_route_length: route.remaining_route_length(),
            destinations: route.destinations().collect(),
            sources,
            ip,
        }
    }
}

impl<'a> Rest<'a> {
    fn of(datagram: &Datagram<'a>) -> Self {
        Self {
            dlpdu_type: datagram.dlpdu_type(),
            control_status: datagram.control_status(),
            data_field_format: datagram.data_field_format(),
            data_field_flags: DatagramRepr::parse(datagram).data_field_flags,
            data_size: datagram.data_octets().len(),
            data: Hex(datagram.data_octets()),
            password: if datagram.password().is_some() { "present" } else { "absent" },
        }
    }
}

impl Display for Line<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.place)?;
        if let Some(fragments) = self.fragments {
            write!(f, "of {fragments} fragments: ")?;
        }
        if let Some(in_row) = self.in_row {
            write!(f, "{in_row}: ")?;
        }
        self.fields.fmt(f)
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

impl Display for Fields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(Fault { error, error_offset }) = &self.fault {
            write!(f, "malformed at octet {error_offset} of {}: {error}", self.length)?;
        } else if let Some(rest) = &self.rest {
            f.write_str(rest.type_in_words())?;
        }
        if let Some(route) = &self.route {
            write!(f, "; {route}")?;
        }
        if let Some(rest) = &self.rest {
            let Rest { control_status, data_field_format, data, password, .. } = rest;
            write!(
                f,
                "; control-status ${control_status:02X}, data-field-format \
                 ${data_field_format:02X}, data "
            )?;
            if data.0.is_empty() {
                f.write_str("none")?;
            }
            write!(f, "{data}, password {password}")?;
        }
        Ok(())
    }
}

impl Rest<'_> {
    fn type_in_words(&self) -> &'static str {
        match self.dlpdu_type {
            Some(DlpduType::Confirmed) => "confirmed",
            Some(DlpduType::Unconfirmed) => "unconfirmed",
            Some(DlpduType::ImmediateReply) => "immediate reply",
            Some(DlpduType::Acknowledge) => "acknowledge",
            None => "of no DLPDU type",
        }
    }
}

impl Display for RouteFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} route to {}", self.route_format, self.destination())?;
        f.write_str(if self.ip.is_some() { ", from " } else { " from " })?;
        self.source().fmt(f)
    }
}

impl RouteFields<'_> {
    fn destination(&self) -> End<'_> {
        let ip = self.ip.as_ref().map(|ip| [ip.ip_net_id, ip.node_address]);
        End { ip, elements: &self.destinations }
    }

    fn source(&self) -> End<'_> {
        let ip = self.ip.as_ref().map(|ip| [ip.source_ip_net_id, ip.source_node_address]);
        End { ip, elements: &self.sources }
    }
}

/// One end of a route: over IP its net, its node, and the elements after these two.
struct End<'a> {
    ip: Option<[u8; 2]>,
    elements: &'a [u8],
}

impl Display for End<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some([ip_net_id, node_address]) = self.ip else {
            return Dotted(self.elements).fmt(f);
        };
        write!(f, "net {ip_net_id} node {node_address}")?;
        f.write_str(match node_address {
            BNA => " (every node)",
            SNA => " (service)",
            _ => "",
        })?;
        match self.elements.get(2..) {
            None | Some([]) => Ok(()),
            Some(beyond) => write!(f, ", on to {}", Dotted(beyond)),
        }
    }
}

fn rfc3339<S: Serializer>(time: &Option<SystemTime>, serializer: S) -> Result<S::Ok, S::Error> {
    match time {
        Some(time) => serializer.collect_str(&humantime::format_rfc3339_micros(*time)),
        None => serializer.serialize_none(),
    }
}

fn dlpdu_type<S: Serializer>(value: &Option<DlpduType>, serializer: S) -> Result<S::Ok, S::Error> {
    value
        .map(|dlpdu_type| match dlpdu_type {
            DlpduType::Confirmed => "confirmed",
            DlpduType::Unconfirmed => "unconfirmed",
            DlpduType::ImmediateReply => "immediate_reply",
            DlpduType::Acknowledge => "acknowledge",
        })
        .serialize(serializer)
}

fn text<S: Serializer>(value: &impl Display, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(value)
}

fn list<S: Serializer>(elements: &Elements, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(elements)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// PAS Figure 10 as a request to the Secure port.
    const FIGURE_10: &[u8] =
        b"\x02\0\0\0\x0B\x04\x05\x02\x21\x8B\x83\x9F\x2A\xC3\x12\x34\x56PNETPASS";

    fn line(octets: &[u8], length: usize) -> Line<'_> {
        let fields = Fields::of(octets, length, Header::default());
        Line { place: Locator::Text { line: 7 }, fragments: None, in_row: None, fields }
    }

    #[track_caller]
    fn shows(octets: &[u8], text: &str) {
        let line = line(octets, octets.len());
        assert_eq!(line.to_string(), format!("line 7: {text}"));
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
            line(&FIGURE_10[..20], 25).to_string(),
            "line 7: malformed at octet 20 of 25: only 20 of its 25 octets were captured"
        );
    }

    #[test]
    fn whatever_is_wrong_the_password_is_not_shown() {
        let behind = [FIGURE_10, b"x"].concat();
        let (mut header, mut route) = (FIGURE_10.to_vec(), FIGURE_10.to_vec());
        (header[1], route[6]) = (1, 0);
        for octets in [FIGURE_10, &behind, &header, &route, &FIGURE_10[..24], &FIGURE_10[17..]] {
            let line = line(octets, octets.len());
            let json = serde_json::to_string(&line).unwrap();
            for shown in [line.to_string(), json, format!("{line:?}")] {
                assert!(!shown.contains("PNET") && !shown.contains("504e"), "{shown}");
            }
        }
    }
}
