//! The IPNetTable of a client as TOML: `node_address` and an `[[ip_net]]` for each row.
//!
//! Beside the table, a file names the password of each row that uses one.
//!
//! Which rows are legal is known to [`IpNetTable`] alone. Here each of its faults gets the line of its
//! field and a remedy.

use std::collections::BTreeMap;
use std::path::Path;

use super::report::{Faults, Warning};
use super::secret::{path_of, read_password};
use super::text::{self, Kind};
use super::toml_table::{Entry, Section};
use super::{address, read_document};
use crate::pnet::ip_net_table::{
    Field, Fields, IllegalTable, IpNetTable, Nettype, RowFault, TableError,
};
use crate::pnet::wire::{IpNetId, LAST_NODE, NORMAL_PORT, NodeAddress, Password, SECURE_PORT};

/// The passwords of the rows that name one.
pub type Passwords = BTreeMap<IpNetId, Password>;

/// A row as far as it could be read, and where its fields are.
#[derive(Debug)]
struct Draft<'a> {
    id: IpNetId,
    fields: Fields,
    password: Option<Password>,
    entries: Entries<'a>,
}

/// The keys of an `[[ip_net]]` that are fields of the table.
#[derive(Debug)]
struct Entries<'a> {
    id: Entry<'a>,
    address: Entry<'a>,
    port: Entry<'a>,
    router: Entry<'a>,
    use_password: Entry<'a>,
}

impl<'a> Entries<'a> {
    fn of(&self, field: Field) -> &Entry<'a> {
        match field {
            Field::IpNetId => &self.id,
            Field::IpAddr => &self.address,
            Field::UdpPort => &self.port,
            Field::UsePw => &self.use_password,
            Field::Router => &self.router,
        }
    }
}

/// Reads a file with an IPNetTable, and the password files that it names, by the rules of the relay.
pub fn load(path: &Path) -> Result<((IpNetTable, Passwords), Vec<Warning>), Faults> {
    read_document(&text::read(path, Kind::IpNetTable)?, path, table)
}

/// Reads an IPNetTable from text as if it were the file `path`.
pub fn parse(text: &str, path: &Path) -> Result<(IpNetTable, Vec<Warning>), Faults> {
    read_document(text, path, table).map(|((table, _), warnings)| (table, warnings))
}

/// A row as [`parse`] reads it.
#[cfg(feature = "cli")]
pub(crate) fn row_as_toml(id: IpNetId, fields: &Fields) -> String {
    let Fields { nettype, ip_address, udp_port, use_password, router, allow_without_password } =
        fields;
    let without = if *allow_without_password { "allow_without_password = true\n" } else { "" };
    format!(
        "[[ip_net]]\nid = {id}\ntype = \"{nettype}\"\naddress = \"{ip_address}\"\n\
         port = {udp_port}\nrouter = {router}\nuse_password = {use_password}\n{without}"
    )
}

fn table(mut root: Section<'_>) -> Option<(IpNetTable, Passwords)> {
    let (place, report) = (root.place.clone(), root.report);
    let node_address = root.key("node_address", "4").required().integer(1..=LAST_NODE);
    let sections = root.key("ip_net", "").sections();
    root.finish();

    let sections = sections?;
    let count = sections.len();
    let mut drafts: Vec<Draft<'_>> = Vec::new();
    for draft in sections.into_iter().filter_map(draft) {
        match drafts.iter().find(|other| other.id == draft.id) {
            None => drafts.push(draft),
            Some(Draft { id, entries, .. }) => draft.entries.id.fault(
                format!("line {} has the row of IPNetID {id}", entries.id.place.line),
                remedy(RowFault::Repeated),
            ),
        }
    }
    let is_router = |node: &NodeAddress| drafts.iter().any(|row| row.fields.router == node.get());
    // Without a node address, the rows are checked as those of a node that is no router.
    let node_address = node_address.and_then(NodeAddress::new);
    let node_address = node_address.or_else(|| NodeAddress::all().find(|node| !is_router(node)))?;
    let illegal = match IpNetTable::new(node_address, drafts.iter().map(|row| (row.id, row.fields)))
    {
        Ok(table) => {
            let passwords = drafts.into_iter().filter_map(|row| Some((row.id, row.password?)));
            return report.is_sound().then(|| (table, passwords.collect()));
        }
        Err(IllegalTable(errors)) => errors,
    };
    for error in illegal {
        match error {
            TableError::Row { row, fault } => {
                let problem = format!("{fault} ({})", fault.clause());
                let draft = drafts.iter().find(|draft| draft.id == row);
                draft.inspect(|it| it.entries.of(fault.field()).fault(problem, remedy(fault)));
            }
            // One that could not be read may be the own net.
            TableError::NoOwnNet if drafts.len() < count => {}
            TableError::NoOwnNet => report.fault(&place, error.to_string(), OWN_NET.to_owned()),
        }
    }
    None
}

const OWN_NET: &str =
    "add an [[ip_net]] for it: `type = \"IPRange\"`, the node's subnet and `router = 0`";

/// An `[[ip_net]]`; none when one of its fields could not be read.
fn draft(mut section: Section<'_>) -> Option<Draft<'_>> {
    let id_entry = section.key("id", "2").required();
    let nettype_entry = section.key("type", "\"UDPRange\"").required();
    let nettype = nettype_entry.parse::<Nettype>();
    // The other fields of an unused row may be left out.
    let is_unused = nettype == Some(Nettype::Unused);
    let mut field = |key, example| {
        let entry = section.key(key, example);
        if is_unused { entry } else { entry.required() }
    };
    let address_entry = field("address", "\"203.0.113.5\"");
    let port_entry = field("port", "20000");
    let router_entry = field("router", "1");
    let use_password_entry = section.key("use_password", "true");
    let password_file = section.key("password_file", "\"secrets/section-1\"");
    let without_password = section.key("allow_without_password", "true");
    section.finish();

    let id = ip_net_id(&id_entry);
    let address = address::ipv4(&address_entry);
    let port = port_entry.integer(1..=u16::MAX);
    let router = router_entry.integer(0..=LAST_NODE);
    let use_password = flag(&use_password_entry);
    let allow_without_password = flag(&without_password);
    let password = password(&password_file);
    let fields = if is_unused {
        Fields::UNUSED
    } else {
        Fields {
            nettype: nettype?,
            ip_address: address?,
            udp_port: port?,
            use_password: use_password?,
            router: router?,
            allow_without_password: allow_without_password?,
        }
    };
    let entries = Entries {
        id: id_entry,
        address: address_entry,
        port: port_entry,
        router: router_entry,
        use_password: use_password_entry,
    };
    if !is_unused {
        check_use_of_password(&fields, &password_file, &without_password);
    }
    if fields.nettype == Nettype::UdpRange && fields.udp_port == NORMAL_PORT {
        entries.port.warn(
            format!("node 1 gets port {SECURE_PORT}, on which P-NET servers themselves listen"),
            "compare it with the start port of the NAT router",
        );
    }
    Some(Draft { id: id?, fields, password, entries })
}

/// A switch that is off when it is left out; none when it could not be read.
fn flag(entry: &Entry<'_>) -> Option<bool> {
    if entry.is_absent() { Some(false) } else { entry.boolean() }
}

fn ip_net_id(entry: &Entry<'_>) -> Option<IpNetId> {
    let number = entry.integer(i64::MIN..=i64::MAX)?;
    let id = u8::try_from(number).ok().and_then(IpNetId::new).filter(|id| *id <= IpNetId::LAST_ROW);
    if id.is_none() {
        entry.fault(
            format!("{number} is not the IPNetID of a row (PAS 5.2.2, 9)"),
            remedy(RowFault::DynamicClients),
        );
    }
    id
}

/// The password in the file that `entry` names.
fn password(entry: &Entry<'_>) -> Option<Password> {
    match read_password(path_of(entry)?) {
        Ok(password) => Some(password),
        Err(error) => {
            entry.fault(error.to_string(), error.remedy());
            None
        }
    }
}

/// Refuses keys about passwords that contradict the others.
fn check_use_of_password(fields: &Fields, password_file: &Entry<'_>, without: &Entry<'_>) {
    if password_file.is_there() && !fields.use_password {
        password_file.fault(
            "no package to this net carries a password",
            "set `use_password = true`, or remove `password_file`",
        );
    }
    if !fields.allow_without_password {
        return;
    }
    if fields.use_password || fields.nettype == Nettype::IpRange {
        without.fault("it says nothing about this net", "remove it");
    } else {
        without.warn(
            "packages go through the Internet without a password, which PAS 7 forbids",
            "use it only while the NAT router lets in nobody else",
        );
    }
}

fn remedy(fault: RowFault) -> &'static str {
    match fault {
        RowFault::DynamicClients => "choose a whole number from 1 to 124",
        RowFault::Repeated => "give each [[ip_net]] its own `id`",
        RowFault::NotAHost(_) => "name the public address of the NAT router",
        RowFault::NotASubnet(_) => "name the subnet of the nodes",
        RowFault::NoPort => "choose a port from 1 to 65535",
        RowFault::StartPortTooHigh(_) => "choose a start port up to 65410",
        RowFault::UdpRangeWithoutPassword => {
            "set `use_password = true`, or `allow_without_password = true` where the NAT router asks \
             for none"
        }
        RowFault::SecurePortWithoutPassword => {
            "set `use_password = true`, or name the Normal port, 34378"
        }
        RowFault::RouterNotANode(_) => "choose a node address from 1 to 125, or 0 for the own net",
        RowFault::RouterIsTheNode(_) => {
            "name the node address of the router; for the node's own net it is 0"
        }
        RowFault::UdpRangeWithoutRouter => {
            "name the node address of the router on the node's own net"
        }
        RowFault::SecondOwnNet(_) => "keep router 0 for the net that the node itself is in",
    }
}
