//! `[[remote_net]]`: what it becomes, and what is refused.

use super::*;

/// A relay that has nothing but a remote net.
pub(super) const ADAPTER: &str = r#"[[remote_net]]
name = "plant-2"
router = "203.0.113.5"
start_port = 20000
nodes = ["1-3", 7]
local_subnet = "127.17.2.0"
allow = ["127.0.0.0/8"]
[[remote_net.password]]
name = "service"
file = "secrets/a"
"#;

#[test]
fn each_node_has_an_address_here_and_a_port_there() {
    let (config, warnings) = read(ADAPTER).unwrap();
    assert_eq!(warnings, []);
    assert!(config.listen.is_empty(), "nobody comes from outside");
    let [net] = config.table.nets() else { panic!("one net") };
    assert_eq!(net.kind, NetKind::Remote { start_port: 20_000 });
    assert!(!net.allow_without_password);
    let ways = config.table.mappings().iter().map(|mapping| {
        let here = SocketAddr::new(mapping.local_address.unwrap(), mapping.public_port);
        assert_eq!(config.addresses_of(mapping), [here.ip()]);
        (mapping.node_address, here.to_string(), mapping.server.to_string())
    });
    let expected = [1, 2, 3, 7].map(|node| {
        (
            node,
            format!("127.17.2.{node}:34378"),
            format!("203.0.113.5:{}", 20_000 + u16::from(node)),
        )
    });
    assert!(ways.eq(expected), "R-10, R-16");
}

#[test]
fn it_stands_beside_other_nets() {
    let beside = ADAPTER.replace("local_subnet", "local_port = 34400\nlocal_subnet");
    let (config, warnings) = read(&format!("{SOUND}{beside}")).unwrap();
    assert_eq!(warnings, []);
    let last = config.table.mappings().last().unwrap();
    assert_eq!((last.public_port, config.table.nets().len()), (34_400, 3));
    // Another net at the same port, but at other addresses.
    let other = ADAPTER.replace("plant-2", "plant-3").replace("127.17.2", "127.17.3");
    let other = other.replace("203.0.113.5", "203.0.113.6");
    assert!(read(&format!("{ADAPTER}{other}")).is_ok());
}

#[test]
fn what_cannot_be_is_refused_with_its_place() {
    each_is_refused(
        ADAPTER,
        &[
            ("router = \"203.0.113.5\"\n", "", 1, "remote_net[0].router", "missing"),
            ("203.0.113.5", "0.0.0.0", 3, "remote_net[0].router", "no router can be at 0.0.0.0"),
            ("203.0.113.5", "203.0.113.5:20000", 3, "remote_net[0].router", "without the port"),
            ("203.0.113.5", "plant.example", 3, "remote_net[0].router", "names are not looked up"),
            ("= 20000", "= 65411", 4, "remote_net[0].start_port", "is over 65535"),
            ("[\"1-3\", 7]", "[126]", 5, "remote_net[0].nodes[0]", "126"),
            ("127.17.2.0", "127.17.2.3", 6, "remote_net[0].local_subnet", "its mask is"),
            ("127.0.0.0/8", "0.0.0.0/0", 7, "remote_net[0].allow[0]", "without a password"),
            ("127.0.0.0/8", "::/0", 7, "remote_net[0].allow[0]", "without a password"),
            (
                "[[remote_net.password]]\nname = \"service\"\nfile = \"secrets/a\"\n",
                "",
                1,
                "remote_net[0].password",
                "the other plant's router needs a password",
            ),
            (
                "file = \"secrets/a\"",
                "file = \"secrets/a\"\ndevice_file = \"secrets/b\"",
                11,
                "remote_net[0].password[0].device_file",
                "remove it",
            ),
            (
                "router =",
                "allow_without_password = true\nrouter =",
                3,
                "remote_net[0].allow_without_password",
                "unknown key",
            ),
        ],
        read_in,
    );
}

#[test]
fn addresses_ports_and_routers_are_claimed_once() {
    let fault = |text: &str| {
        let Err(Faults(faults)) = read(text) else { panic!("taken: {text}") };
        let [fault] = faults.as_slice() else { panic!("{faults:#?}") };
        format!("{}: {}", fault.key, fault.problem)
    };
    let other = ADAPTER.replace("plant-2", "plant-3");
    let elsewhere = other.replace("203.0.113.5", "203.0.113.6");
    assert_eq!(
        fault(&format!("{ADAPTER}{elsewhere}")),
        "remote_net[1].local_subnet: 127.17.2.1:34378 (and 3 more) belongs to remote_net[0] \
         \"plant-2\" (line 1) too"
    );
    let same_router = other.replace("127.17.2.0", "127.17.3.0");
    assert_eq!(
        fault(&format!("{ADAPTER}{same_router}")),
        "remote_net[1].router: server 203.0.113.5:20001 (and 3 more) belongs to remote_net[0] \
         \"plant-2\" (line 1) too"
    );
    let on_a_public_port = ADAPTER.replace("local_subnet", "local_port = 20003\nlocal_subnet");
    let text = fault(&format!("{SOUND}{on_a_public_port}"));
    assert!(text.starts_with("remote_net[0].local_subnet: public port 20003"), "{text}");
    let looping = ADAPTER.replace("203.0.113.5", "192.0.2.1");
    let text = fault(&format!("{SOUND}{looping}"));
    assert!(text.contains("server 192.0.2.1:20001 is a public port of this router"), "{text}");
    let to_itself = ADAPTER.replace("203.0.113.5", "127.17.2.1").replace("20000", "34377");
    let text = fault(&to_itself);
    assert!(text.contains("server 127.17.2.1:34378 is a public port of this router"), "{text}");
}

#[test]
fn a_network_that_no_local_program_is_in_is_told() {
    let text = ADAPTER.replace("[\"127.0.0.0/8\"]", "[\"127.0.0.0/8\", \"2001:db8::/32\"]");
    let (_, warnings) = read(&text).unwrap();
    let [warning] = warnings.as_slice() else { panic!("{warnings:?}") };
    assert!(warning.to_string().contains("local addresses are IPv4"), "{warning}");
}
