//! What a datagram says, as JSON and as text on one line.
//!
//! Invariant: of the octets only the decoded fields are shown, and of the password only whether there is
//! one. Nothing here allocates: there may be millions of datagrams.

mod tree;

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::fragments::{Broken, Head};
use crate::cli::output::{Dotted, Hex};
use crate::pnet::wire::{
    BNA, Datagram, DatagramError, DatagramRepr, DlpduType, Elements, Header, Route, RouteFormat,
    SNA,
};

pub(super) use tree::Tree;

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
    #[serde(skip)]
    datagram: Option<Datagram<'a>>,
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
        Self { length: head.length, route: None, rest: None, fault, datagram: None }
    }

    /// Reads what was captured of a datagram of `length` octets.
    pub(super) fn of(octets: &'a [u8], length: usize, header: Header) -> Self {
        let captured = octets.len();
        if captured < length {
            let fault =
                Some(Fault { error: Error::Cut { captured, length }, error_offset: captured });
            return Self { length, route: None, rest: None, fault, datagram: None };
        }
        match Datagram::parse(octets, header) {
            Ok(datagram) => {
                let route = Some(RouteFields::of(header, datagram.route()));
                let rest = Some(Rest::of(&datagram));
                Self { length, route, rest, fault: None, datagram: Some(datagram) }
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
                    datagram: None,
                }
            }
        }
    }

    /// The datagram; none where it is malformed.
    pub(super) fn datagram(&self) -> Option<&Datagram<'a>> {
        self.datagram.as_ref()
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
