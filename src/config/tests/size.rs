//! What is large is read in a time that grows with it, and told in a few lines.
//!
//! The bound on the time is one for hangs: reading that grew with the square took minutes.

use std::fmt::Write;
use std::sync::mpsc;
use std::thread;

use super::*;

const MOST_SECONDS: u64 = 120;

/// Reads a text on a thread of its own.
fn read_in_time(text: String) -> Result<(Config, Vec<Warning>), Faults> {
    let (done, outcome) = mpsc::channel();
    thread::spawn(move || {
        let _ = done.send(parse(&text, Path::new("pnet-nat.toml")));
    });
    outcome.recv_timeout(Duration::from_secs(MOST_SECONDS)).expect("it is read in time")
}

fn servers(count: usize) -> String {
    let mut text = "[public]\nlisten = [\"192.0.2.1\"]\n".to_owned();
    for index in 0..count {
        let (port, node) = (1024 + index, 1 + index % 125);
        let (b, c) = (index / 125 / 250, index / 125 % 250);
        write!(
            text,
            "[[server]]\nname = \"s{index}\"\npublic_port = {port}\n\
             address = \"10.{b}.{c}.{node}:34379\"\nnode = {node}\n\
             allow = [\"198.51.100.7\"]\nallow_without_password = true\n"
        )
        .unwrap();
    }
    text
}

#[test]
fn thirty_thousand_servers() {
    let (config, warnings) = read_in_time(servers(30_000)).unwrap();
    assert_eq!(config.table.mappings().len(), 30_000);
    let nets = config.table.nets();
    let last = config.table.mappings_of(NetId(29_999)).map(|id| config.table.mapping(id));
    assert_eq!(
        last.map(|m| (m.public_port, nets[29_999].name.as_str())).collect::<Vec<_>>(),
        [(31_023, "s29999")]
    );
    assert_eq!(warnings.len(), 101);
    assert!(warnings[100].0.problem.starts_with("29900 more warnings"), "{}", warnings[100]);
}

#[test]
fn blocks_that_all_overlap() {
    let mut text = servers(1);
    for index in 0..4000 {
        write!(
            text,
            "[[udp_range_net]]\nname = \"r{index}\"\nstart_port = 20000\n\
             subnet = \"172.17.17.0\"\nnodes = [\"1-125\"]\nallow = [\"198.51.100.7\"]\n\
             allow_without_password = true\n"
        )
        .unwrap();
    }
    let Faults(faults) = read_in_time(text).unwrap_err();
    assert_eq!(faults.len(), 101, "the ports and the servers of the first 50 later ones");
}

#[test]
fn twenty_thousand_elements_and_as_many_faults() {
    let elements = |element: &str| vec![element; 20_000].join(", ");
    for (from, to, line) in [
        ("\"1-4\", 33", elements("\"1-125\""), 8),
        ("\"192.0.2.1\"", elements("\"192.0.2.1\""), 2),
        ("\"192.0.2.1\"", elements("5"), 2),
        ("\"198.51.100.0/24\"", elements("\"x\""), 9),
        ("node = 7", (0..20_000).map(|n| format!("key-{n} = 1\n")).collect(), 18),
        ("node = 7", "node = = 7\n".repeat(20_000), 18),
    ] {
        let Faults(faults) = read_in_time(changed(from, &to)).unwrap_err();
        assert_eq!(faults.len(), 101, "{from}");
        let last = faults.last().unwrap();
        assert!(last.line >= Some(line) && last.line >= faults[99].line, "{last}");
        assert!(last.problem.contains(" more faults from this line on"), "{last}");
        let shown: usize = faults.iter().map(|fault| fault.to_string().len()).sum();
        assert!(shown < 50_000, "{shown} octets are shown");
    }
}

#[test]
fn a_text_that_is_long_is_cut_where_it_is_shown() {
    let long = "x".repeat(1_000_000);
    for (from, to) in [
        ("press", long.clone()),
        ("192.0.2.1", long.clone()),
        ("1-4", long.clone()),
        ("node = 7", format!("node = 7\n{long} = 1")),
        ("node = 7", format!("node = {}", "9".repeat(1_000_000))),
        ("node = 7", format!("node = 7\nidle_timeout = \"5 {long}\"")),
        ("node = 7", format!("node = {long}")),
    ] {
        let faults = read_in_time(changed(from, &to)).unwrap_err().to_string();
        assert!(faults.len() < 2000, "{} octets: {}", faults.len(), &faults[..2000]);
    }
}

#[test]
fn nesting_without_end_is_a_fault() {
    for (open, close) in [("[", "]"), ("{ a = ", "}")] {
        let deep = format!("a = {}1{}", open.repeat(100_000), close.repeat(100_000));
        assert!(read_in_time(deep).is_err());
    }
    assert!(read_in_time(format!("a{} = 1", ".a".repeat(100_000))).is_err());
}

#[test]
fn a_file_that_is_no_configuration_by_its_size() {
    let folder = folder();
    let path = folder.path().join("large.toml");
    fs::File::create(&path).unwrap().set_len(text::MOST_OCTETS + 1).unwrap();
    let faults = load(&path).unwrap_err().to_string();
    assert!(faults.contains("large.toml: has more than 16 MiB; "), "{faults}");
}
