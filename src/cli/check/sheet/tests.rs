use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;

use super::*;
use crate::config;

/// All kinds of nets.
const NETS: &str = r#"
[public]
listen = ["203.0.113.5"]
[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "172.17.17.0"
nodes = ["1-4", 33]
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "a"
[[udp_range_net.password]]
name = "new"
file = "b"
[[udp_range_net]]
name = "old"
start_port = 21000
subnet = "172.17.18.0"
nodes = [7]
allow = ["198.51.100.7"]
allow_without_password = true
[[server]]
name = "press"
public_port = 20200
address = "172.17.19.7:34379"
node = 7
allow = ["198.51.100.7"]
[[server.password]]
name = "service"
file = "a"
[[profinet_device]]
name = "drive-7"
public_port = 45007
address = "172.17.20.7"
allow = ["198.51.100.0/28"]
[[remote_net]]
name = "plant-2"
router = "203.0.113.9"
start_port = 20000
nodes = ["1-4"]
local_subnet = "127.17.2.0"
allow = ["127.0.0.0/8"]
[[remote_net.password]]
name = "service"
file = "a"
"#;

fn config(text: &str) -> Config {
    let folder = tempfile::tempdir().unwrap();
    for (name, password) in [("a", "s3cr3t-A"), ("b", "s3cr3t-B")] {
        fs::write(folder.path().join(name), password).unwrap();
        fs::set_permissions(folder.path().join(name), Permissions::from_mode(0o600)).unwrap();
    }
    let read = config::parse(text, &folder.path().join("pnet-nat.toml"));
    read.unwrap_or_else(|faults| panic!("{faults}")).0
}

#[test]
fn each_net_of_p_net_has_a_row_with_a_command_that_fits_it() {
    assert_eq!(
        sheet(&config(NETS), SheetFormat::Csv),
        "Net,IPAddr,UDPPort,UsePW,Router,Nettype,Nodes,Password,Test command\r\n\
         section-1,203.0.113.5,20000,1,\"the client's, never 0\",UDPRange,\"1-4,33\",\"service, new\",\
         \"pnet-nat request --to 203.0.113.5 --start-port 20000 --node 1-4,33 --password-file section-1-service\"\r\n\
         old,203.0.113.5,21000,0,\"the client's, never 0\",UDPRange,7,none,\
         pnet-nat request --to 203.0.113.5 --port 21007 --node 7\r\n\
         press,203.0.113.5,20193,1,\"the client's, never 0\",UDPRange,7,service,\
         pnet-nat request --to 203.0.113.5 --port 20200 --node 7 --password-file press-service\r\n\
         plant-2,127.17.2.0,34378,0,\"the client's, or 0\",IPRange,1-4,none,\
         pnet-nat request --to 127.17.2.1 --port 34378 --node 1\r\n"
    );
}

#[test]
fn every_format_says_the_same_and_has_no_password() {
    let config = config(NETS);
    for format in [SheetFormat::Csv, SheetFormat::Md, SheetFormat::Html] {
        let sheet = sheet(&config, format);
        for part in
            ["203.0.113.5", "20193", "1-4,33", "service, new", "IPRange", "section-1-service"]
        {
            assert!(sheet.contains(part), "{format:?}: {part}: {sheet}");
        }
        assert!(!sheet.contains("s3cr3t"), "{format:?}");
        assert!(!sheet.contains("drive-7"), "{format:?}: no client of P-NET asks it");
    }
}

/// A test command has to be one that `request` takes.
#[test]
fn where_the_relay_listens_on_all_addresses_the_router_is_to_be_filled_in() {
    let config = config(&NETS.replace("203.0.113.5\"]", "0.0.0.0\"]"));
    let sheet = sheet(&config, SheetFormat::Csv);
    assert!(sheet.contains("section-1,the router's public address,20000,"), "{sheet}");
    assert!(sheet.contains("--to ROUTER --start-port 20000"), "{sheet}");
}
