//! `[[profinet_device]]`: what it becomes, and what is refused.

use super::*;
use crate::nat::{Record, Records};

const DEVICE: &str = r#"[public]
listen = ["192.0.2.1"]

[[profinet_device]]
name = "drive-7"
public_port = 45007
address = "172.17.17.7"
allow = ["198.51.100.0/28"]
"#;

#[test]
fn one_public_port_leads_to_one_device() {
    let (config, warnings) = read(DEVICE).unwrap();
    assert_eq!(warnings, []);
    let [net] = config.table.nets() else { panic!("one net") };
    assert_eq!(net.kind, NetKind::ProfinetDevice { records: Records::default() });
    assert!(net.credentials.is_empty());
    let [mapping] = config.table.mappings() else { panic!("one mapping") };
    assert_eq!((mapping.node_address, mapping.public_port), (0, 45_007));
    assert_eq!(mapping.server.to_string(), "172.17.17.7:34964");
}

#[test]
fn records_are_what_the_file_lists() {
    let text = DEVICE.replace("allow =", "records = [\"im0\", \"api_data\"]\nallow =");
    let (config, _) = read(&text).unwrap();
    let records: Records = [Record::Im0, Record::ApiData].into_iter().collect();
    assert_eq!(config.table.nets()[0].kind, NetKind::ProfinetDevice { records });
}

#[test]
fn what_cannot_be_is_refused_with_its_place() {
    each_is_refused(
        DEVICE,
        &[
            (
                "0/28\"",
                "0/28\", \"0.0.0.0/0\"",
                8,
                "profinet_device[0].allow[1]",
                "PROFINET has no",
            ),
            ("allow = [\"198.51.100.0/28\"]\n", "", 4, "profinet_device[0].allow", "missing"),
            (
                "172.17.17.7",
                "172.17.17.7:34964",
                7,
                "profinet_device[0].address",
                "without the port",
            ),
            ("172.17.17.7", "224.0.0.1", 7, "profinet_device[0].address", "no device can be"),
            (
                "172.17.17.7",
                "drive.example",
                7,
                "profinet_device[0].address",
                "names are not looked up",
            ),
            (
                "allow =",
                "records = [\"im0\", \"im7\"]\nallow =",
                8,
                "profinet_device[0].records[1]",
                "choose among im0, im1",
            ),
            (
                "allow =",
                "idle_timeout = \"5m\"\nallow =",
                8,
                "profinet_device[0].idle_timeout",
                "unknown key",
            ),
            (
                "allow =",
                "allow_without_password = true\nallow =",
                8,
                "profinet_device[0].allow_without_password",
                "unknown key",
            ),
        ],
        read_in,
    );
}

#[test]
fn it_stands_beside_p_net_at_the_same_address() {
    let (_, device) = DEVICE.split_once("\n[[").unwrap();
    let beside = format!("{SOUND}\n[[{}", device.replace("172.17.17.7", "172.17.17.3"));
    assert!(read(&beside).is_ok());
    let twice =
        format!("{DEVICE}\n[[{}", device.replace("drive-7", "again").replace("45007", "45008"));
    let Err(Faults(faults)) = read(&twice) else { panic!("taken") };
    assert!(faults[0].problem.starts_with("server 172.17.17.7:34964 belongs to"), "{}", faults[0]);
}
