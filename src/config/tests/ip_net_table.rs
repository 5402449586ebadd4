//! A client's IPNetTable as TOML: what it becomes, and what is refused, where, and with what advice.

use super::*;
use crate::pnet::ip_net_table::{Destination, IpNetTable, Nettype};
use crate::pnet::wire::{IpNetId, NodeAddress};

/// Line numbers in the cases below count from the first line of this text.
const TABLE: &str = r#"node_address = 4

[[ip_net]]
id = 1
type = "IPRange"
address = "172.17.18.0"
port = 34378
router = 0

[[ip_net]]
id = 2
type = "UDPRange"
address = "203.0.113.5"
port = 20000
router = 1
use_password = true
password_file = "secrets/a"

[[ip_net]]
id = 3
type = "Unused"
"#;

fn read_in(folder: &Path, text: &str) -> Result<(IpNetTable, Vec<Warning>), Faults> {
    parse_ip_net_table(text, &folder.join("client.toml"))
}

fn read(text: &str) -> Result<(IpNetTable, Vec<Warning>), Faults> {
    read_in(folder().path(), text)
}

fn changed(from: &str, to: &str) -> String {
    changed_in(TABLE, from, to)
}

fn refuses(cases: &[Case]) {
    each_is_refused(TABLE, cases, read_in);
}

#[test]
fn r15_a_table_is_read_whole() {
    let (table, warnings) = read(TABLE).unwrap_or_else(|faults| panic!("{faults}"));
    assert_eq!(warnings, []);
    let id = |number| IpNetId::new(number).unwrap();
    assert_eq!((table.node_address().get(), table.own_net()), (4, id(1)));
    let rows: Vec<_> = table.rows().map(|(id, fields)| (id.get(), fields.nettype)).collect();
    assert_eq!(rows, [(1, Nettype::IpRange), (2, Nettype::UdpRange)]);
    let node = Destination::Node(NodeAddress::new(4).unwrap());
    let way = table.translate(id(2), node).unwrap();
    assert_eq!((way.address.to_string(), way.port), ("203.0.113.5".to_owned(), 20004));
    assert!(way.use_password && way.next_hop == NodeAddress::new(1));
}

#[test]
fn an_unused_row_needs_no_fields_and_may_have_some() {
    let text = TABLE.to_owned() + "address = \"0.0.0.0\"\nport = 1\nrouter = 4\n";
    assert_eq!(read(&text).unwrap().0, read(TABLE).unwrap().0);
    let text = changed("\"UDPRange\"", "\"Unused\"");
    assert_eq!(read(&text).unwrap().0.rows().count(), 1);
}

#[test]
fn refuses_rows_that_the_standard_forbids() {
    refuses(&[
        // R-13
        ("id = 2", "id = 0", 11, "ip_net[1].id", "0 is not the IPNetID of a row (PAS 5.2.2, 9)"),
        ("id = 2", "id = 125", 11, "ip_net[1].id", "choose a whole number from 1 to 124"),
        ("id = 2", "id = 126", 11, "ip_net[1].id", "126 is not"),
        ("id = 2", "id = -7", 11, "ip_net[1].id", "-7 is not"),
        ("id = 2", "id = 1", 11, "ip_net[1].id", "line 4 has the row of IPNetID 1"),
        // R-15
        (
            "router = 1",
            "router = 4",
            15,
            "ip_net[1].router",
            "4 is the node itself, not a router (PAS 8)",
        ),
        ("router = 0", "router = 9", 1, "", "no IP Range net has router 0"),
        (
            "type = \"UDPRange\"\naddress = \"203.0.113.5\"\nport = 20000\nrouter = 1",
            "type = \"IPRange\"\naddress = \"172.17.19.0\"\nport = 34378\nrouter = 0",
            15,
            "ip_net[1].router",
            "row 1 has router 0 already",
        ),
        // R-18
        ("router = 1", "router = 0", 15, "ip_net[1].router", "(PAS 8 c)"),
        // R-20
        ("router = 1", "router = 126", 15, "ip_net[1].router", "from 0 to 125"),
        // A4
        (
            "use_password = true\npassword_file = \"secrets/a\"",
            "",
            10,
            "ip_net[1].use_password",
            "allow_without_password = true",
        ),
        // R-3
        ("port = 34378", "port = 34379", 3, "ip_net[0].use_password", "the Secure port"),
        // A15
        (
            "port = 20000",
            "port = 65411",
            14,
            "ip_net[1].port",
            "65411 + 125 is over 65535 (PAS 8 d); choose a start port up to 65410",
        ),
        ("port = 20000", "port = 0", 14, "ip_net[1].port", "out of bounds"),
        ("203.0.113.5", "224.0.0.1", 13, "ip_net[1].address", "not a host address"),
        ("172.17.18.0", "0.0.0.0", 6, "ip_net[0].address", "not a subnet of hosts"),
    ]);
}

#[test]
fn refuses_what_cannot_be_read() {
    refuses(&[
        ("node_address = 4", "", 1, "node_address", "add `node_address = 4`"),
        ("node_address = 4", "node_address = 126", 1, "node_address", "from 1 to 125"),
        ("id = 2\n", "", 10, "ip_net[1].id", "missing"),
        ("router = 1\n", "", 10, "ip_net[1].router", "missing"),
        ("\"UDPRange\"", "\"udp\"", 12, "ip_net[1].type", "the types are IPRange, UDPRange"),
        ("id = 2", "id = 2\nadress = 1", 12, "ip_net[1].adress", "did you mean `address`?"),
        ("[[ip_net]]", "udp_net = 1\n[[ip_net]]", 3, "udp_net", "keys here are node_address"),
        ("use_password = true", "use_password = \"yes\"", 16, "ip_net[1].use_password", "true or"),
        ("\"203.0.113.5\"", "\"2001:db8::1\"", 13, "ip_net[1].address", "not an IPv4 address"),
        ("203.0.113.5", "203.0.113.5/24", 13, "ip_net[1].address", "write \"203.0.113.5\""),
        ("203.0.113.5", "203.0.113.5:20000", 13, "ip_net[1].address", "without the port"),
        ("203.0.113.5", "router.example", 13, "ip_net[1].address", "names are not looked up"),
        ("id = 2", "id = 99999999999999999999", 11, "ip_net[1].id", "out of bounds"),
        // TOML takes a key for one of the section above it.
        (
            "node_address = 4\n\n[[ip_net]]\nid = 1",
            "[[ip_net]]\nid = 1\nnode_address = 4",
            3,
            "ip_net[0].node_address",
            "belongs to the whole file, not to [[ip_net]]: move it above the first section",
        ),
    ]);
}

#[test]
fn a_password_file_that_is_named_is_one() {
    refuses(&[
        ("secrets/a", "secrets/absent", 17, "ip_net[1].password_file", "cannot be read"),
        ("secrets/a", "secrets/for-others", 17, "ip_net[1].password_file", "chmod 600"),
        ("secrets/a", "secrets/seven", 17, "ip_net[1].password_file", "has 7 octets"),
        (
            "router = 0",
            "router = 0\npassword_file = \"secrets/a\"",
            9,
            "ip_net[0].password_file",
            "no package to this net carries a password",
        ),
        (
            "\"Unused\"",
            "\"Unused\"\npassword_file = \"secrets/absent\"",
            22,
            "ip_net[2].password_file",
            "cannot be read",
        ),
        (
            "router = 0",
            "router = 0\nallow_without_password = true",
            9,
            "ip_net[0].allow_without_password",
            "remove it",
        ),
    ]);
    let without = changed("password_file = \"secrets/a\"\n", "");
    assert!(read(&without).is_ok(), "it may be left out");
}

#[test]
fn warns_of_what_is_probably_not_meant() {
    let without = "allow_without_password = true";
    let warned = |text: &str| {
        let (_, warnings) = read(text).unwrap_or_else(|faults| panic!("{faults}"));
        let [Warning(warning)] = &warnings[..] else { panic!("{warnings:?}") };
        (warning.line.unwrap(), warning.key.clone(), warning.problem.clone())
    };
    // A4
    let text = changed("use_password = true\npassword_file = \"secrets/a\"", without);
    let (line, key, problem) = warned(&text);
    assert_eq!((line, key.as_str()), (16, "ip_net[1].allow_without_password"));
    assert!(problem.contains("PAS 7 forbids"), "{problem}");
    // A15
    let (line, key, problem) = warned(&changed("port = 20000", "port = 34378"));
    assert_eq!((line, key.as_str()), (14, "ip_net[1].port"));
    assert!(problem.contains("node 1 gets port 34379"), "{problem}");
}

/// In one run, and none that only follows from another.
#[test]
fn all_faults_of_a_table_in_one_run() {
    let text = r#"node_address = 0
[[ip_net]]
id = 1
type = "IPRange"
address = "172.17.18.0/24"
port = 34378
router = 0
[[ip_net]]
id = 1
type = "UDPRange"
address = "203.0.113.5"
port = 65500
use_passwort = true
[[ip_net]]
id = 2
type = "UDPRange"
address = "255.255.255.255"
port = 65500
router = 0
"#;
    let faults = parse_ip_net_table(text, Path::new("client.toml")).unwrap_err();
    insta::assert_snapshot!(faults);
}

#[test]
fn a_table_that_is_not_there_is_told_with_the_option() {
    let faults = load_ip_net_table(Path::new("/nowhere/client.toml")).unwrap_err().to_string();
    assert!(faults.contains("name a file with an IPNetTable") && faults.contains("--table"));
}
