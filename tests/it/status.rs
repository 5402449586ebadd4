//! `pnet-nat status`: a relay seen from the terminal.

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::harness::{
    Process, Relay, Settings, Site, WRONG, eventually, exchange, pnet_nat, request,
};

/// Exit code, stdout and stderr.
fn status(site: &Site, arguments: &[&str]) -> (Option<i32>, String, String) {
    let url = format!("http://{}/", site.admin());
    let mut status = Process::start(pnet_nat(&[&["status", "--url", &url], arguments].concat()));
    (status.end(), status.stdout(), status.stderr())
}

/// The cells of the line that begins with these.
fn row(table: &str, begin: &[&str]) -> Vec<String> {
    let cells = |line: &str| -> Vec<String> {
        line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    let rows = table.lines().filter(|line| line.starts_with('|')).map(cells);
    rows.into_iter()
        .find(|row| row.starts_with(&begin.iter().map(|&s| s.to_owned()).collect::<Vec<_>>()))
        .expect(table)
}

#[test]
fn nets_nodes_and_drops_are_shown() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    for _ in 0..3 {
        exchange(&client, site.public(4), &node, 4);
    }
    client.send(site.public(3), &request(3));
    let wrong = request(4);
    client.send(site.public(4), &[&wrong[..wrong.len() - WRONG.len()], WRONG].concat());
    relay.expect_drops(&[("request", "password_wrong", 1)]);

    let table = eventually("node 3 is silent", || {
        let (code, table, _) = status(&site, &[]);
        assert_eq!(code, Some(0), "{table}");
        table.contains("silent   ").then_some(table)
    });
    assert_eq!(row(&table, &["section-1"])[1..5], ["1", "1", "3", "4"]);
    assert_eq!(row(&table, &["section-1", "3", "silent"])[3..6], ["1", "0", "–"]);
    assert_eq!(row(&table, &["section-1", "4", "answering"])[3..5], ["3", "3"]);
    assert_eq!(row(&table, &["section-1", "33", "never asked"])[3..5], ["0", "0"]);
    assert!(row(&table, &["password_wrong", "1"])[2].contains("someone who guesses"));
    assert!(table.contains("Wrong passwords came from 1 address."), "{table}");
    assert!(!table.contains('\x1b'), "no colour where there is no terminal");

    let (code, json, _) = status(&site, &["--format", "json", "--net", "section-1"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((code, &json["nets"][0]["silent_nodes"]), (Some(0), &serde_json::json!([3])));
    let (code, _, error) = status(&site, &["--net", "section-2"]);
    assert_eq!((code, error.contains("no net has this name")), (Some(1), true), "{error}");
    relay.finish();
}

#[test]
fn it_is_shown_again_and_again_until_it_is_told_to_end() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let url = format!("http://{}", site.admin());
    let mut watch = Process::start(pnet_nat(&[
        "status",
        "--url",
        &url,
        "--watch",
        "50ms",
        "--net",
        "section-1",
    ]));
    eventually("a rate is seen", || {
        exchange(&client, site.public(4), &node, 4);
        let stdout = watch.stdout();
        let rated = stdout.contains("Requests/s")
            && stdout.lines().any(|line| {
                let rate = line.split('|').nth(4).map(str::trim);
                line.starts_with("| section-1 |    4 |") && rate > Some("0.0")
            });
        rated.then_some(())
    });
    drop(relay);
    eventually("it tells that nobody answers", || {
        watch.stdout().contains("no answer").then_some(())
    });
    assert!(!watch.has_ended());
    watch.signal(Signal::SIGINT);
    assert_eq!(watch.end(), Some(0));
}

#[test]
fn faults_say_what_to_do() {
    let site = Site::claim();
    let (code, stdout, error) = status(&site, &[]);
    assert_eq!((code, stdout.as_str()), (Some(1), ""));
    assert!(error.contains("is the relay running, and is this its [admin] listen?"), "{error}");

    let admin = format!("listen = \"{}\"", site.admin());
    let configuration = site.configuration(&Settings::default());
    let with_token = format!("{admin}\ntoken_file = \"secrets/admin\"");
    let relay = Relay::start(&configuration.replace(&admin, &with_token), site.admin(), None);
    let folder = crate::harness::folder("");
    let token = folder.path().join("secrets/admin");
    let token = token.to_str().unwrap();
    assert_eq!(status(&site, &["--token-file", token]).0, Some(0));
    let (code, _, error) = status(&site, &[]);
    assert_eq!(
        (code, error.contains("asks for a token: --token-file")),
        (Some(1), true),
        "{error}"
    );
    std::fs::write(token, "0123456789abcdef\n").unwrap();
    let (code, _, error) = status(&site, &["--token-file", token]);
    assert_eq!((code, error.contains("has another token")), (Some(1), true), "{error}");
    std::fs::write(token, "short").unwrap();
    let (code, _, error) = status(&site, &["--token-file", token]);
    assert_eq!((code, error.contains("16 to 256 letters")), (Some(1), true), "{error}");
    drop(relay);
}
