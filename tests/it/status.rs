//! `pnet-nat status`: a relay seen from the terminal.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::Command;
use std::thread;

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use crate::harness::{
    Network, Process, Relay, Settings, Site, Terminal, WRONG, eventually, exchange, left_out,
    pnet_nat, request,
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
    assert!(table.contains("\nA silent node: ping its server from the router."), "{table}");
    assert!(table.contains("\nIn the kernel: "), "{table}");
    assert!(!table.contains('\x1b'), "no colour where there is no terminal");

    let (code, json, _) = status(&site, &["--format", "json", "--net", "section-1"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((code, &json["nets"][0]["silent_nodes"]), (Some(0), &json!([3])));
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
    let is_rate = |rate: Option<&str>| rate > Some("0.0");
    eventually("a rate is seen, also of what is dropped", || {
        exchange(&client, site.public(4), &node, 4);
        client.send(site.public(4), b"noise");
        let stdout = watch.stdout();
        let rated = stdout.contains("Requests/s")
            && stdout.lines().any(|line| {
                let rate = line.split('|').nth(4).map(str::trim);
                line.starts_with("| section-1 |    4 |") && is_rate(rate)
            })
            && stdout.lines().any(|line| {
                let rate = line.split('|').nth(3).map(str::trim);
                line.starts_with("| too_short ") && is_rate(rate)
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

/// Of a net alone there is nothing that belongs to another, or to none.
#[test]
fn what_the_kernel_dropped_is_shown_and_a_net_has_its_own() {
    let site = Site::claim();
    let section = "[datapath]\nreceive_buffer = 4096\n\
                   [[server]]\nname = \"press\"\npublic_port = PORT\naddress = \"SERVER:34379\"\n\
                   node = 7\nallow = [\"NET/24\"]\n[[server.password]]\nname = \"service\"\n\
                   file = \"secrets/press\"";
    let section = section
        .replace("PORT", &(site.start_port() + 100).to_string())
        .replace("SERVER", &site.address(7).to_string())
        .replace("NET", &site.address(0).to_string());
    let relay = site.relay(Settings { sections: &section, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let upstream = node.expect(&request(4));
    let wrong = request(4);
    let wrong = [&wrong[..wrong.len() - WRONG.len()], WRONG].concat();
    client.send(site.public(4), &wrong);
    relay.expect_drops(&[("request", "password_wrong", 1)]);
    relay.process.hold();
    for _ in 0..1000 {
        client.send(site.public(4), &wrong);
        node.send(upstream, &request(4));
    }
    relay.process.go_on();

    let all = eventually("both are counted", || {
        let (_, all, _) = status(&site, &[]);
        (all.contains("kernel: overflow") && all.contains("kernel: upstream overflow"))
            .then_some(all)
    });
    let why = row(&all, &["kernel: overflow"]);
    assert!(why[1].parse::<u32>().unwrap() > 100, "{why:?}");
    assert!(why[2].contains("Raise receive_buffer"), "{why:?}");
    assert!(row(&all, &["kernel: upstream overflow"])[2].starts_with("Answers of servers"));
    assert!(all.contains("\nFlows: 1 of "), "{all}");
    assert!(all.contains("Wrong passwords came from 1 address."), "{all}");

    let (_, one, _) = status(&site, &["--net", "section-1"]);
    assert!(one.contains("| kernel: overflow ") && !one.contains("upstream overflow"), "{one}");
    assert!(one.contains("Wrong passwords came from 1 address."), "{one}");
    let (_, other, _) = status(&site, &["--net", "press"]);
    assert!(other.contains("Nothing was dropped.") && !other.contains("Wrong pass"), "{other}");
    assert!(!other.contains("Flows:"), "{other}");
}

/// `status --watch` of a site, as a command.
fn watching(site: &Site, arguments: &[&str]) -> Command {
    let url = format!("http://{}", site.admin());
    pnet_nat(&[&["status", "--url", &url, "--watch", "50ms"], arguments].concat())
}

#[test]
fn a_terminal_shows_each_look_in_place_of_the_one_before() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    site.client().send(site.public(3), &request(3));
    let mut coloured = Terminal::start(&mut watching(&site, &[]));
    let mut plain = Terminal::start(watching(&site, &[]).env("NO_COLOR", "1"));
    for terminal in [&mut coloured, &mut plain] {
        eventually("it is shown twice, and node 3 is silent", || {
            let text = terminal.text();
            (text.contains("| silent ") && text.matches("\x1b[H").count() > 2).then_some(())
        });
        terminal.signal(Signal::SIGINT);
        assert_eq!(terminal.end(), Some(0));
        for look in terminal.text().split("\x1b[H").skip(1) {
            assert!(look.starts_with("\x1b[?7l") && look.contains("\x1b[?7h"), "{look:?}");
            assert!(look.lines().count() <= 24, "{look:?}");
        }
    }
    assert!(coloured.text().contains("\x1b[31m| section-1 |    3 |"), "{}", coloured.text());
    assert!(!Terminal::has_colours(&plain.text()), "{}", plain.text());

    let mut json = Terminal::start(&mut watching(&site, &["--format", "json"]));
    eventually("two lines", || (json.text().lines().count() > 2).then_some(()));
    json.signal(Signal::SIGINT);
    assert_eq!(json.end(), Some(0));
    for line in json.text().lines() {
        let line: Value = serde_json::from_str(line).expect(line);
        assert_eq!(line["nets"][0]["name"], "section-1");
    }
    relay.finish();
}

#[test]
fn a_file_gets_the_whole_table_also_when_a_terminal_is_there() {
    let site = Site::claim();
    let mut configuration = site.configuration(&Settings::default());
    configuration = configuration.replace("\"1-4\", 33", "\"1-60\"");
    let relay = Relay::start(&configuration, site.admin(), None);
    let log = relay.folder.path().join("log");
    let inner = watching(&site, &[]);
    let mut command = Command::new("sh");
    command.args(["-c", "exec \"$0\" \"$@\" > \"$LOG\""]).env("LOG", &log);
    command.arg(inner.get_program()).args(inner.get_args());
    let mut terminal = Terminal::start(&mut command);
    let text = eventually("it is shown twice", || {
        let text = fs::read_to_string(&log).ok()?;
        (text.matches("Nothing was dropped.").count() > 1).then_some(text)
    });
    terminal.signal(Signal::SIGINT);
    assert_eq!((terminal.end(), terminal.text().as_str()), (Some(0), ""));
    assert!(!text.contains('\x1b'), "{text:?}");
    assert_eq!(row(&text, &["section-1", "60"])[2], "never asked");
    relay.finish();
}

#[test]
fn of_many_nodes_the_silent_ones_are_shown_or_all() {
    let site = Site::claim();
    let mut configuration = site.configuration(&Settings::default());
    configuration = configuration.replace("\"1-4\", 33", "\"1-125\"");
    let relay = Relay::start(&configuration, site.admin(), None);
    let (_, table, _) = status(&site, &[]);
    assert!(table.contains("None of 125 nodes is silent; --full lists them."), "{table}");
    assert!(!table.contains("A silent node:"), "{table}");
    let (_, table, _) = status(&site, &["--full"]);
    assert_eq!(row(&table, &["section-1", "125"])[2], "never asked");
    site.client().send(site.public(3), &request(3));
    let table = eventually("node 3 is silent", || {
        let (_, table, _) = status(&site, &[]);
        table.contains("Silent: 1 of 125 nodes; --full lists all.").then_some(table)
    });
    assert_eq!(row(&table, &["section-1", "3"])[2], "silent");
    assert!(!table.contains("| never asked |"), "{table}");
    relay.finish();
}

/// The table, the API and the metrics tell the same of a flow that the kernel carries.
#[test]
fn a_flow_in_the_kernel_is_told_everywhere() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let place = network.place(r#"["198.51.100.1"]"#);
        let configuration = place.configuration(&Settings::default());
        let relay = Relay::start(&configuration, place.admin, None);
        let offload = || {
            let status: Value =
                serde_json::from_str(&relay.get("/api/v1/status").unwrap().1).unwrap();
            status["offload"].clone()
        };
        if let Value::String(why) = &offload()["why"] {
            return left_out(&format!("flows in the kernel: {why}"));
        }
        let (client, node) = (network.client("198.51.100.7"), network.node(4));
        for _ in 0..3 {
            exchange(&client, network.public("198.51.100.1", 4), &node, 4);
        }
        let interfaces = ["eth0", "eth1"];
        let expected = json!({ "state": "on", "why": null, "flows": 1, "interfaces": interfaces });
        assert_eq!(offload(), expected);
        for gauge in ["pnet_nat_kernel_offload", "pnet_nat_kernel_flows"] {
            assert_eq!(relay.metrics().sum(gauge, &[]), 1, "{gauge}");
        }
        let url = format!("http://{}/", place.admin);
        let mut status = Process::start(pnet_nat(&["status", "--url", &url]));
        assert_eq!(status.end(), Some(0));
        let table = status.stdout();
        assert!(table.contains("\nIn the kernel: 1 flow, at eth0, eth1\n"), "{table}");
        relay.finish();
    });
}

#[test]
fn a_failed_reload_and_a_relay_that_stops_are_shown() {
    let site = Site::claim();
    let runtime = "workers = 1\ndrain = \"20s\"";
    let mut relay = site.relay(Settings { runtime, ..Settings::default() });
    let (_, table, _) = status(&site, &[]);
    assert!(table.contains("\nLast reload successful; "), "{table}");
    relay.configure("[public]");
    relay.reload();
    let (code, table, _) = status(&site, &[]);
    assert!(table.contains("\nLast reload failed: "), "{table}");
    assert!(!table.contains("Not relaying") && code == Some(0), "{table}");

    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));
    relay.process.signal(Signal::SIGTERM); // it waits for the answer
    eventually("it stops", || {
        let (code, table, _) = status(&site, &[]);
        assert_eq!(code, Some(0), "{table}");
        table.contains("\nNot relaying: it is starting or stopping.\n").then_some(())
    });
    node.send(from_relay, &request(4));
    assert_eq!(relay.process.end(), Some(0));
}

#[test]
fn an_interrupt_ends_it_while_nobody_answers() {
    let site = Site::claim();
    let listener = TcpListener::bind(site.admin()).unwrap();
    let mut watch = Process::start(watching(&site, &["--timeout", "10m"]));
    let (_never_answered, _) = listener.accept().unwrap();
    watch.signal(Signal::SIGINT);
    assert_eq!(watch.end(), Some(0));
}

#[test]
fn what_is_no_relay_is_told_apart() {
    let site = Site::claim();
    let listener = TcpListener::bind(site.admin()).unwrap();
    for answer in ["[]", "\"nets\"", "null", "7", "{}", "<html>"] {
        thread::scope(|scope| {
            scope.spawn(|| {
                let (mut stream, _) = listener.accept().unwrap();
                let lines = BufReader::new(&stream).lines().map_while(Result::ok);
                lines.take_while(|line| !line.is_empty()).for_each(drop);
                let length = answer.len();
                write!(stream, "HTTP/1.1 200 OK\r\ncontent-length: {length}\r\n\r\n{answer}")
                    .unwrap();
            });
            let (code, stdout, error) = status(&site, &["--format", "json"]);
            assert_eq!((code, stdout.as_str()), (Some(1), ""), "{answer}");
            assert!(error.contains("is not the API of a pnet-nat"), "{answer}: {error}");
        });
    }
}

/// What a server answers that is no relay, or is one under somebody else's hand.
#[test]
fn nothing_that_a_server_answers_reaches_the_terminal_as_a_command() {
    let site = Site::claim();
    let listener = TcpListener::bind(site.admin()).unwrap();
    let harmful = "\x1b]0;title\x07\u{9b}31m\u{202e}\r\nforged";
    let json = json!({ "nets": harmful, harmful: harmful }).to_string();
    for (line, body) in [("503 No", harmful), ("200 OK", harmful), ("200 OK", json.as_str())] {
        thread::scope(|scope| {
            scope.spawn(|| {
                let (mut stream, _) = listener.accept().unwrap();
                let lines = BufReader::new(&stream).lines().map_while(Result::ok);
                lines.take_while(|line| !line.is_empty()).for_each(drop);
                let length = body.len();
                write!(stream, "HTTP/1.1 {line}\r\ncontent-length: {length}\r\n\r\n{body}")
                    .unwrap();
                // The second question, where there is one, finds nobody.
            });
            let (code, stdout, error) = status(&site, &["--timeout", "1s"]);
            assert_eq!((code, stdout.as_str()), (Some(1), ""));
            let printed = error.strip_suffix('\n').unwrap();
            assert!(!printed.contains(|c: char| c.is_control() || c == '\u{202e}'), "{printed:?}");
        });
    }
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
