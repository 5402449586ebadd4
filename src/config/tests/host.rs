//! What is refused or warned of because of the host: its own addresses, and the ways to the servers.

use std::io;

use super::super::host::ThisHost;
use super::*;

/// A router with one interface for the Internet, one for a section, and one that leads to further
/// plants by a gateway.
struct Router {
    up: bool,
}

impl Host for Router {
    fn source_towards(&self, to: SocketAddr) -> Option<io::Result<IpAddr>> {
        let unreachable = || io::Error::from(io::ErrorKind::NetworkUnreachable);
        let source = match to.ip().to_string() {
            ip if ip == "172.17.17.250" || ip == "203.0.113.5" => ip,
            ip if self.up && ip.starts_with("172.17.17.") => "172.17.17.250".into(),
            ip if ip.starts_with("10.9.") => "10.8.0.2".into(),
            ip if ip.starts_with("10.") => return Some(Err(unreachable())),
            ip if ip.contains(':') => return Some(Err(unreachable())),
            _ => "203.0.113.5".into(),
        };
        Some(Ok(source.parse().unwrap()))
    }
}

const ROUTER: Router = Router { up: true };

/// A net of this kind alone, on these addresses.
fn text(listen: &str, server: &str) -> String {
    format!(
        "[public]\nlisten = [\"{listen}\"]\n[[server]]\nname = \"press\"\npublic_port = 20200\n\
         address = \"{server}\"\nnode = 7\nallow = [\"0.0.0.0/0\"]\n\
         [[server.password]]\nname = \"service\"\nfile = \"secrets/a\"\n"
    )
}

fn on(host: &Router, text: &str, in_force: Option<&Table>) -> Result<Vec<Warning>, Faults> {
    let folder = folder();
    let read = parse_on(text, &folder.path().join("pnet-nat.toml"), host, in_force);
    read.map(|(_, warnings)| warnings)
}

#[test]
fn a_server_that_is_the_router_itself_is_refused() {
    for own in ["203.0.113.5", "172.17.17.250"] {
        let Faults(faults) =
            on(&ROUTER, &text("0.0.0.0", &format!("{own}:20200")), None).unwrap_err();
        let [fault] = faults.as_slice() else { panic!("{faults:?}") };
        assert_eq!((fault.line, fault.key.as_str()), (Some(6), "server[0].address"));
        assert!(fault.problem.contains("this router itself") && !fault.passes, "{fault}");
    }
    assert!(on(&ROUTER, &text("0.0.0.0", "172.17.17.250:34379"), None).is_ok(), "a node on it");
    assert!(on(&ROUTER, &text("203.0.113.5", "172.17.17.250:20200"), None).is_ok(), "not heard");
}

#[test]
fn a_way_by_the_internet_side_is_refused_unless_it_is_wanted() {
    for (host, listen, server, why) in [
        (&ROUTER, "0.0.0.0", "172.71.17.7", "a typing mistake"),
        (&ROUTER, "203.0.113.5", "172.71.17.7", "the same, with an address by name"),
        (&Router { up: false }, "0.0.0.0", "172.17.17.7", "the plant's interface is down"),
    ] {
        let text = text(listen, &format!("{server}:34379"));
        let faults = on(host, &text, None).unwrap_err();
        assert!(faults.pass() && faults.0.len() == 1, "{why}: {faults}");
        let told = faults.to_string();
        assert!(told.contains("leaves by the Internet side, from 203.0.113.5"), "{why}: {told}");
        assert!(told.contains("servers_beyond_gateway = true"), "{why}: {told}");
        let wanted = text.replace("node = 7", "node = 7\nservers_beyond_gateway = true");
        assert!(on(host, &wanted, None).is_ok(), "{why}");
    }
    let range = SOUND.replace("172.17.17.0", "172.71.17.0").replace("192.0.2.1", "0.0.0.0");
    let Faults(faults) = on(&ROUTER, &range, None).unwrap_err();
    assert_eq!(faults[0].key, "udp_range_net[0].subnet");
}

#[test]
fn a_subnet_that_no_interface_holds_is_warned_of() {
    for (server, part) in [
        ("10.1.2.7:34379", "no route leads to 10.1.2.7"),
        ("10.9.2.7:34379", "no interface of this host is in the subnet of 10.9.2.7"),
        ("[fd00::7]:34379", "no route leads to fd00::7"),
    ] {
        let warnings = on(&ROUTER, &text("203.0.113.5", server), None).unwrap();
        assert!(warnings.iter().any(|warning| warning.0.problem.contains(part)), "{warnings:?}");
    }
    for near in ["172.17.17.7:34379", "127.0.0.7:34379", "[::1]:34379"] {
        assert_eq!(on(&ROUTER, &text("0.0.0.0", near), None).unwrap(), [], "{near}");
    }
}

/// A cable that is out must not keep a password that is withdrawn in force.
#[test]
fn servers_in_force_are_left_alone_and_others_are_not() {
    let folder = folder();
    let (configuration, down) = (text("0.0.0.0", "172.17.17.7:34379"), Router { up: false });
    let (config, _) = parse(&configuration, &folder.path().join("pnet-nat.toml")).unwrap();
    assert!(on(&down, &configuration, None).is_err());
    assert_eq!(on(&down, &configuration, Some(&config.table)).unwrap(), []);
    let other = configuration.replace("172.17.17.7", "172.71.17.7");
    assert!(on(&down, &other, Some(&config.table)).is_err());
}

#[test]
fn this_host_knows_its_own_addresses() {
    let asked = ThisHost.source_towards("127.0.0.1:9".parse().unwrap()).unwrap();
    assert_eq!(asked.unwrap(), "127.0.0.1".parse::<IpAddr>().unwrap());
}
