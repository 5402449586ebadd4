//! `pnet-nat translate` as a user meets it, and that it takes what `check` prints for clients.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::harness::{ANNOTATED, PASSWORD, Process, folder, pnet_nat};

/// A client of subnet 172.17.18.0 with two plant sections, one of them behind a NAT router.
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
password_file = "secrets/section-1"

[[ip_net]]
id = 4
type = "IPRange"
address = "172.17.19.0"
port = 34378
router = 9
"#;

/// The command with this table, beside password files.
fn translate(table: &str, options: &[&str]) -> Process {
    let folder = folder("");
    fs::write(folder.path().join("client.toml"), table).unwrap();
    translate_in(folder.path(), options)
}

fn translate_in(folder: &Path, options: &[&str]) -> Process {
    let mut command = pnet_nat(&["translate", "--table", "client.toml"]);
    command.current_dir(folder).args(options);
    let mut translated = Process::start(command);
    translated.end();
    translated
}

fn lines(translated: &mut Process) -> Vec<Value> {
    assert_eq!(translated.end(), Some(0), "{}", translated.stderr());
    translated.stdout().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn people_are_shown_a_table() {
    let mut translated = translate(TABLE, &["--net", "2", "--node", "1-3,125"]);
    assert_eq!((translated.end(), translated.stderr()), (Some(0), String::new()));
    insta::assert_snapshot!(translated.stdout());
}

#[test]
fn r16_r17_r19_json_tells_each_method() {
    let json = |net: &str, node: &str| {
        let mut translated = translate(TABLE, &["--net", net, "--node", node, "--format", "json"]);
        assert_eq!(translated.end(), Some(0), "{}", translated.stderr());
        translated.stdout()
    };
    assert_eq!(
        json("2", "4"),
        "{\"net\":2,\"node\":4,\"method\":\"d\",\"address\":\"203.0.113.5\",\"port\":20004,\
         \"next_hop\":1,\"password\":true}\n"
    );
    assert_eq!(
        json("1", "4"),
        "{\"net\":1,\"node\":4,\"method\":\"a\",\"address\":\"172.17.18.4\",\"port\":34378,\
         \"next_hop\":null,\"password\":false}\n"
    );
    // R-42
    assert_eq!(
        json("4", "126"),
        "{\"net\":4,\"node\":126,\"method\":\"b\",\"address\":\"172.17.19.255\",\"port\":34378,\
         \"next_hop\":9,\"password\":false}\n"
    );
    assert_eq!(json("2", "1-125").lines().count(), 125);
}

#[test]
fn what_has_no_way_is_exit_code_2_with_the_reason() {
    for (net, node, reason) in [
        ("2", "126", "row 2, Nettype: a broadcast needs an IP Range net (PAS 10)"),
        ("2", "1-4,126", "a broadcast needs an IP Range net"),
        (
            "3",
            "4",
            "row 3, Nettype: the net is unused (PAS 5.2.4); the nets of this table: 1, 2, 4",
        ),
        ("125", "4", "row 125, IPNetID: the net of dynamic clients has no row (PAS 9)"),
        ("126", "4", "0, 126 and 127 are reserved (PAS 5.2.2)"),
        ("0", "4", "0, 126 and 127 are reserved (PAS 5.2.2)"),
        ("2", "127", "node addresses are 1 to 125"),
        ("2", "0", "node addresses are 1 to 125"),
    ] {
        let mut translated = translate(TABLE, &["--net", net, "--node", node]);
        assert_eq!(translated.end(), Some(2), "{net} {node}");
        let stderr = translated.stderr();
        assert!(stderr.contains(reason), "{net} {node}: {stderr}");
        assert_eq!(translated.stdout(), "");
    }
}

#[test]
fn every_fault_of_a_table_is_shown_and_the_exit_code_is_2() {
    let table = TABLE
        .replace("port = 20000", "port = 65500")
        .replace("router = 9", "router = 4\nspeed = 1")
        .replace("secrets/section-1", "secrets/absent");
    let mut translated = translate(&table, &["--net", "1", "--node", "1"]);
    assert_eq!((translated.end(), translated.stdout()), (Some(2), String::new()));
    insta::assert_snapshot!(translated.stderr());

    let mut absent = pnet_nat(&["translate", "--table", "/nowhere/client.toml"]);
    absent.args(["--net", "1", "--node", "1"]);
    let mut absent = Process::start(absent);
    assert_eq!(absent.end(), Some(2));
    assert!(absent.stderr().contains("name a file with an IPNetTable"), "{}", absent.stderr());
}

#[test]
fn options_come_from_the_environment_too() {
    let folder = folder("");
    fs::write(folder.path().join("client.toml"), TABLE).unwrap();
    let mut command = pnet_nat(&["translate"]);
    command.current_dir(folder.path()).env("PNET_NAT_TABLE", "client.toml");
    command.env("PNET_NAT_IP_NET_ID", "2").env("PNET_NAT_NODE", "1,3");
    command.env("PNET_NAT_FORMAT", "json");
    let lines = lines(&mut Process::start(command));
    assert_eq!(lines.iter().map(|line| line["port"].clone()).collect::<Vec<_>>(), [20001, 20003]);
}

#[test]
fn no_octet_of_a_password_is_printed() {
    let password = str::from_utf8(PASSWORD).unwrap();
    for table in [TABLE.to_owned(), TABLE.replace("router = 1", "router = 0")] {
        for format in ["text", "json"] {
            let options = ["--net", "2", "--node", "1-4", "--format", format];
            let translated = translate(&table, &options);
            let shown = translated.stdout() + &translated.stderr();
            assert!(!shown.is_empty() && !shown.contains(password), "{shown}");
        }
    }
}

/// What `check` prints for this configuration, from where the client's table begins.
fn table_of(configuration: &str) -> String {
    let folder = folder(configuration);
    let mut command = pnet_nat(&["check", "--config", "pnet-nat.toml"]);
    command.current_dir(folder.path());
    let mut checked = Process::start(command);
    assert_eq!(checked.end(), Some(0), "{}", checked.stderr());
    let stdout = checked.stdout();
    let start = stdout.find("# Only the client").unwrap_or_else(|| panic!("{stdout}"));
    stdout[start..].to_owned()
}

#[test]
fn translate_takes_back_the_rows_that_check_prints() {
    let annotated = ANNOTATED.replace("\"172.17.", "\"127.17.");
    let public = annotated.replace("[\"0.0.0.0\"]", "[\"192.0.2.1\", \"192.0.2.2\"]");
    for (configuration, address) in [(&annotated, "203.0.113.5"), (&public, "192.0.2.1")] {
        let table = table_of(configuration);
        let folder = folder("");
        fs::write(folder.path().join("client.toml"), &table).unwrap();
        // The public ports of the configuration: a section, and a single server at node 7.
        for (net, node, port) in [("2", "1", 20001), ("2", "33", 20033), ("3", "7", 20200)] {
            let options = ["--net", net, "--node", node, "--format", "json"];
            let mut translated = translate_in(folder.path(), &options);
            let [line] = &lines(&mut translated)[..] else { panic!("one line") };
            assert_eq!(translated.stderr(), "");
            let way = [&line["address"], &line["port"], &line["password"], &line["method"]];
            assert_eq!(way, [&json!(address), &json!(port), &json!(true), &json!("d")]);
        }
    }
}

/// A4: a net that goes without a password is taken back with a warning.
#[test]
fn a_net_without_a_password_is_taken_back_with_a_warning() {
    let annotated = ANNOTATED.replace("\"172.17.", "\"127.17.");
    let (section, rest) = annotated.split_once("[[udp_range_net.password]]").unwrap();
    let (_, rest) = rest.split_once("[[server]]").unwrap();
    let section = section.replace("#allow_without_password", "allow_without_password");
    let section =
        section.replace("allow_without_password = false", "allow_without_password = true");
    let table = table_of(&format!("{section}[[server]]{rest}"));
    let mut translated = translate(&table, &["--net", "2", "--node", "1", "--format", "json"]);
    assert_eq!(lines(&mut translated)[0]["password"], json!(false));
    assert!(translated.stderr().contains("PAS 7 forbids"), "{}", translated.stderr());
}

/// More nets than a table has rows.
#[test]
fn check_prints_no_more_rows_than_a_table_has() {
    let mut configuration = "[public]\nlisten = [\"127.0.0.1\"]\n".to_owned();
    for number in 0..130 {
        configuration += &format!(
            "[[server]]\nname = \"s-{number}\"\npublic_port = {}\naddress = \"127.17.{number}.7:34379\"\n\
             node = 7\nallow = [\"198.51.100.7\"]\n[[server.password]]\nname = \"service\"\n\
             file = \"secrets/section-1\"\n",
            41000 + number
        );
    }
    let table = table_of(&configuration);
    assert_eq!(table.matches("[[ip_net]]").count(), 124);
    assert!(table.contains("# 7 more nets need a second table"), "{table}");
    let mut translated = translate(&table, &["--net", "124", "--node", "7", "--format", "json"]);
    assert_eq!(lines(&mut translated)[0]["port"], json!(41122));
}

/// What no row can reach is left out, and told of.
#[test]
fn a15_check_tells_of_public_ports_that_no_row_leads_to() {
    let annotated = ANNOTATED.replace("\"172.17.", "\"127.17.");
    let high = annotated.replace("public_port = 20200", "public_port = 65418");
    let mut command = pnet_nat(&["check", "--config", "pnet-nat.toml"]);
    let folder = folder(&high);
    command.current_dir(folder.path());
    let mut checked = Process::start(command);
    assert_eq!(checked.end(), Some(0), "{}", checked.stderr());
    let (stdout, stderr) = (checked.stdout(), checked.stderr());
    let remark = "press: no row reaches node 7, because public port 65418 is too high.";
    assert!(stdout.contains(remark), "{stdout}");
    assert!(stderr.contains("choose a public port up to 65417"), "{stderr}");
    assert_eq!(table_of(&high).matches("[[ip_net]]").count(), 2);
    let highest = annotated.replace("public_port = 20200", "public_port = 65417");
    assert_eq!(table_of(&highest).matches("[[ip_net]]").count(), 3);
}

#[test]
fn a_relay_without_ipv4_has_no_row_for_an_ip_net_table() {
    let configuration = ANNOTATED
        .replace("\"172.17.", "\"127.17.")
        .replace("[\"0.0.0.0\"]", "[\"2001:db8::1\"]")
        .replace("\"198.51.100.", "\"2001:db8:1::\", \"198.51.100.");
    let mut command = pnet_nat(&["check", "--config", "pnet-nat.toml"]);
    let folder = folder(&configuration);
    command.current_dir(folder.path());
    let mut checked = Process::start(command);
    assert_eq!(checked.end(), Some(0), "{}", checked.stderr());
    let stdout = checked.stdout();
    assert!(stdout.ends_with("and an IPNetTable has no other.\n"), "{stdout}");
    assert!(!stdout.contains("[[ip_net]]"), "{stdout}");
}
