//! A datagram as it is printed. The JSON has the field names of the Wireshark dissector without `pnet.`;
//! a test compares the two.
//!
//! Invariant: of the octets only the decoded fields are kept, and of the password only whether there is
//! one.

use std::fmt;
use std::net::SocketAddr;
use std::time::SystemTime;

use serde::{Serialize, Serializer};

use super::row::InRow;
use crate::cli::output::{dotted, hex};
use crate::pnet::wire::{
    BNA, Datagram, DatagramError, DatagramRepr, DlpduType, Header, Route, RouteFormat, SNA,
};

/// A datagram and where it was found.
#[derive(Debug, Serialize)]
pub(super) struct Line {
    #[serde(flatten)]
    pub(super) place: Locator,
    /// Only where it is one of several in a payload.
    #[serde(flatten)]
    pub(super) in_row: Option<InRow>,
    #[serde(flatten)]
    pub(super) fields: Fields,
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
pub(super) struct Fields {
    length: usize,
    #[serde(flatten)]
    route: Option<RouteFields>,
    #[serde(flatten)]
    rest: Option<Rest>,
    #[serde(flatten)]
    fault: Option<Fault>,
}

/// Header and route: what comes before the control-status.
#[derive(Debug, Serialize)]
struct RouteFields {
    header: String,
    route: String,
    route_format: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    remaining_route_length: Option<u8>,
    destinations: Vec<u8>,
    sources: Vec<u8>,
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
struct Rest {
    #[serde(skip_serializing_if = "Option::is_none")]
    dlpdu_type: Option<&'static str>,
    control_status: u8,
    data_field_format: u8,
    data_field_flags: u8,
    data_size: usize,
    data: String,
    password: &'static str,
}

/// Why it is not a datagram, and the first octet that is wrong.
#[derive(Debug, Serialize)]
struct Fault {
    error: String,
    error_offset: usize,
}

impl Fields {
    /// Reads what was captured of a datagram of `length` octets.
    pub(super) fn of(octets: &[u8], length: usize, header: Header) -> Self {
        let captured = octets.len();
        let fault = |error: String, error_offset| Some(Fault { error, error_offset });
        if captured < length {
            let error = format!("only {captured} of its {length} octets were captured");
            let fault = fault(error, captured);
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
                Self {
                    length,
                    route: route.map(|route| RouteFields::of(header, route)),
                    rest: None,
                    fault: fault(error.to_string(), error.position(octets, header)),
                }
            }
        }
    }
}

impl RouteFields {
    fn of(header: Header, route: Route<'_>) -> Self {
        let sources: Vec<_> = route.sources().collect();
        let ip = match (route.ip_net_id(), route.node_address(), &sources[..]) {
            (Some(ip_net_id), Some(node_address), &[source_ip_net_id, source_node_address, ..]) => {
                Some(IpRoute { ip_net_id, node_address, source_ip_net_id, source_node_address })
            }
            _ => None,
        };
        Self {
            header: header.to_string(),
            route: hex(route.as_bytes()),
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

impl Rest {
    fn of(datagram: &Datagram<'_>) -> Self {
        Self {
            dlpdu_type: datagram.dlpdu_type().map(|dlpdu_type| match dlpdu_type {
                DlpduType::Confirmed => "confirmed",
                DlpduType::Unconfirmed => "unconfirmed",
                DlpduType::ImmediateReply => "immediate_reply",
                DlpduType::Acknowledge => "acknowledge",
            }),
            control_status: datagram.control_status(),
            data_field_format: datagram.data_field_format(),
            data_field_flags: DatagramRepr::parse(datagram).data_field_flags,
            data_size: datagram.data_octets().len(),
            data: hex(datagram.data_octets()),
            password: if datagram.password().is_some() { "present" } else { "absent" },
        }
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            Locator::Text { line } => write!(f, "line {line}: ")?,
            Locator::Capture { packet, time, from, to } => {
                write!(f, "packet {packet}, ")?;
                if let Some(time) = time {
                    write!(f, "{}, ", humantime::format_rfc3339_micros(*time))?;
                }
                write!(f, "{from} > {to}: ")?;
            }
        }
        if let Some(InRow { datagram, datagrams }) = self.in_row {
            write!(f, "{datagram} of {datagrams}: ")?;
        }
        self.fields.fmt(f)
    }
}

impl fmt::Display for Fields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(Fault { error, error_offset }) = &self.fault {
            write!(f, "malformed at octet {error_offset} of {}: {error}", self.length)?;
        } else if let Some(rest) = &self.rest {
            f.write_str(&rest.dlpdu_type.unwrap_or("of no DLPDU type").replace('_', " "))?;
        }
        if let Some(route) = &self.route {
            write!(f, "; {route}")?;
        }
        if let Some(rest) = &self.rest {
            let Rest { control_status, data_field_format, data, password, .. } = rest;
            let data = if data.is_empty() { "none" } else { data };
            write!(
                f,
                "; control-status ${control_status:02X}, data-field-format \
                 ${data_field_format:02X}, data {data}, password {password}"
            )?;
        }
        Ok(())
    }
}

impl fmt::Display for RouteFields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} route", self.route_format)?;
        let Some(ip) = &self.ip else {
            return write!(f, " to {} from {}", dotted(&self.destinations), dotted(&self.sources));
        };
        end(f, "to", [ip.ip_net_id, ip.node_address], &self.destinations)?;
        f.write_str(",")?;
        end(f, "from", [ip.source_ip_net_id, ip.source_node_address], &self.sources)
    }
}

/// One end of a route over IP: its net, its node, and the elements after these two.
fn end(
    f: &mut fmt::Formatter<'_>,
    direction: &str,
    [ip_net_id, node_address]: [u8; 2],
    elements: &[u8],
) -> fmt::Result {
    write!(f, " {direction} net {ip_net_id} node {node_address}")?;
    f.write_str(match node_address {
        BNA => " (every node)",
        SNA => " (service)",
        _ => "",
    })?;
    match elements.get(2..) {
        None | Some([]) => Ok(()),
        Some(beyond) => write!(f, ", on to {}", dotted(beyond)),
    }
}

fn rfc3339<S: Serializer>(time: &Option<SystemTime>, serializer: S) -> Result<S::Ok, S::Error> {
    match time {
        Some(time) => serializer.collect_str(&humantime::format_rfc3339_micros(*time)),
        None => serializer.serialize_none(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// PAS Figure 10 as a request to the Secure port.
    const FIGURE_10: &[u8] =
        b"\x02\0\0\0\x0B\x04\x05\x02\x21\x8B\x83\x9F\x2A\xC3\x12\x34\x56PNETPASS";

    fn line(octets: &[u8], length: usize) -> Line {
        let fields = Fields::of(octets, length, Header::default());
        Line { place: Locator::Text { line: 7 }, in_row: None, fields }
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
