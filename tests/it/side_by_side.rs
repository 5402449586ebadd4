//! `pnet-nat status --target A --target B`: several relays side by side.

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use crate::harness::{Process, Relay, Settings, Site, eventually, exchange, pnet_nat, request};

/// Exit code, stdout and stderr.
fn status(targets: &[&str], arguments: &[&str]) -> (Option<i32>, String, String) {
    let targets = targets.iter().flat_map(|target| ["--target", target]);
    let arguments: Vec<_> =
        ["status"].into_iter().chain(targets).chain(arguments.iter().copied()).collect();
    let mut status = Process::start(pnet_nat(&arguments));
    (status.end(), status.stdout(), status.stderr())
}

/// The cells of the line that begins with this one.
fn row<'t>(table: &'t str, first: &str) -> Vec<&'t str> {
    let cells = |line: &'t str| -> Vec<&'t str> {
        line.trim_matches('|').split('|').map(str::trim).collect()
    };
    table
        .lines()
        .filter(|line| line.starts_with('|'))
        .map(cells)
        .find(|row| row[0] == first)
        .expect(table)
}

/// Two relays with the same nodes and rules, at addresses of their own.
fn pair(site: &Site, place: &Site) -> ([Relay; 2], [String; 2], String) {
    let settings = Settings::default();
    let configuration = site.configuration(&settings);
    let other = configuration
        .replace(
            &format!("[\"{}\"]", site.public_address()),
            &format!("[\"{}\"]", place.public_address()),
        )
        .replace(&site.admin().to_string(), &place.admin().to_string());
    let relays = [
        Relay::start(&configuration, site.admin(), None),
        Relay::start(&other, place.admin(), None),
    ];
    (relays, [site, place].map(|at| format!("http://{}", at.admin())), other)
}

#[test]
fn relays_are_shown_with_what_they_agree_on() {
    let (site, place) = (Site::claim(), Site::claim());
    let (relays, [first, second], configuration) = pair(&site, &place);
    let (client, node) = (site.client(), site.node(4));
    for _ in 0..3 {
        exchange(&client, site.public(4), &node, 4);
    }
    client.send(site.public(3), &request(3));
    client.send(site.public(4), b"noise");
    relays[0].expect_drops(&[("request", "too_short", 1)]);
    let table = eventually("node 3 is silent", || {
        let (code, table, said) = status(&[&first, &second], &[]);
        assert_eq!((code, said.as_str()), (Some(0), ""), "{table}");
        (row(&table, &first)[5] == "1").then_some(table)
    });
    assert_eq!(row(&table, &first)[1..6], ["relaying", "3", "1", "1", "1"]);
    assert_eq!(row(&table, &second)[1..6], ["relaying", "0", "0", "0", "0"]);
    assert!(row(&table, &second)[8].starts_with(env!("CARGO_PKG_VERSION")), "{table}");
    assert_eq!(row(&table, "section-1"), ["section-1", "the same at 2 of 2"]);
    assert!(!table.contains("different versions"), "{table}");

    // A rule, a net that only one of them has, and a file with a fault.
    let press = "[[server]]\nname = \"press\"\npublic_port = 30000\naddress = \"127.0.0.7:34379\"\n\
                 node = 7\nallow = [\"127.0.0.0/8\"]\nallow_without_password = true\n";
    let other = configuration.replace("allow = ", "max_flows = 17\nallow = ");
    relays[1].reload_to(&format!("{other}\n{press}"));
    relays[1].configure("[public]");
    relays[1].reload();
    let (code, table, _) = status(&[&first, &second], &[]);
    assert_eq!((code, row(&table, &second)[1]), (Some(0), "reload failed"), "{table}");
    let told = row(&table, "section-1")[1];
    assert!(
        told.starts_with("differs: ") && told.contains(&first) && told.contains(&second),
        "{told}"
    );
    assert_eq!(row(&table, "press")[1], format!("the same at 1 of 2; not at {first}"));

    let (code, json, _) = status(&[&first, &second], &["--format", "json", "--net", "section-1"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(code, Some(0));
    let [net] = json["nets"].as_array().unwrap().as_slice() else { panic!("{json}") };
    assert_eq!(
        (&net["net"], &net["agrees"], &net["absent"]),
        (&json!("section-1"), &json!(false), &json!([]))
    );
    let hashes = net["hashes"].as_object().unwrap();
    for (relay, target) in json["relays"].as_array().unwrap().iter().zip([&first, &second]) {
        assert_eq!(relay["target"], **target);
        let hash = relay["nets"][0]["config_hash"].as_str().unwrap();
        assert_eq!(hashes[hash], json!([target]));
        assert_eq!(relay["nets"][0]["nodes"], Value::Null, "sums alone");
    }
    relays.into_iter().for_each(|relay| drop(relay.finish()));
}

#[test]
fn one_that_does_not_answer_is_told_and_the_others_are_shown() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (here, nobody) =
        (format!("http://{}", site.admin()), format!("http://{}", site.address(9)));
    let (code, table, _) = status(&[&nobody, &here], &[]);
    assert_eq!((code, row(&table, &nobody)[1]), (Some(1), "see below"), "{table}");
    assert_eq!(row(&table, &here)[1], "relaying");
    assert!(table.contains(&format!("\nno answer from {nobody}; is the relay running")), "{table}");
    assert_eq!(row(&table, "section-1")[1], "the same at 1 of 1");
    let (code, json, _) = status(&[&nobody, &here], &["--format", "json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(code, Some(1));
    let error = json["relays"][0]["error"].as_str().unwrap();
    assert!(error.starts_with("no answer from "), "{error}");
    assert_eq!(json["relays"][1]["status"]["ready"], true);

    for one_alone in ["--events", "--refused"] {
        let (code, _, said) = status(&[&here, &here], &[one_alone]);
        assert_eq!((code, said.contains("give one --target")), (Some(1), true), "{said}");
    }
    // As it was called before.
    let arguments = ["status", "--url", &here, "--url", &nobody, "--watch", "50ms"];
    let mut watch = Process::start(pnet_nat(&arguments));
    eventually("it is shown again", || {
        (watch.stdout().matches("the same at 1 of 1").count() > 1).then_some(())
    });
    watch.signal(Signal::SIGINT);
    assert_eq!(watch.end(), Some(0));
    relay.finish();
}
