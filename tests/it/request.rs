//! `pnet-nat request` as a user meets it: which way it takes, what it sends, why an answer is missing,
//! statistics and exit codes.

use std::fs;

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{Process, Relay, Settings, Site, Terminal, eventually, folder, pnet_nat};

/// Simulated nodes of a site, and the password file that they share with their client.
struct Nodes {
    site: Site,
    folder: TempDir,
    _nodes: Process,
}

impl Nodes {
    /// Nodes 1 to 4 with further options.
    fn start(options: &[&str]) -> Self {
        let (site, folder) = (Site::claim(), folder(""));
        let listen = format!("{}-4", site.address(1));
        let mut command = pnet_nat(&["node", "--listen", &listen, "--password-file", PASSWORD]);
        command.args(options).current_dir(folder.path());
        let nodes = Process::start(command);
        eventually("the nodes are there", || (nodes.stdout().lines().count() == 4).then_some(()));
        Self { site, folder, _nodes: nodes }
    }

    /// A request with these options.
    fn request(&self, options: &[&str]) -> Process {
        let mut command = pnet_nat(&["request", "--password-file", PASSWORD]);
        command.args(options).current_dir(self.folder.path());
        Process::start(command)
    }

    /// A request to the Secure port of a node.
    fn ask(&self, node: u8, options: &[&str]) -> Process {
        let (to, node) = (self.site.address(node).to_string(), node.to_string());
        self.request(&[&["--to", &to, "--port", "34379", "--node", &node], options].concat())
    }
}

const PASSWORD: &str = "secrets/section-1";

fn json_lines(process: &mut Process, code: i32) -> Vec<Value> {
    assert_eq!(process.end(), Some(code), "{}\n{}", process.stdout(), process.stderr());
    process.stdout().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// What a request without an answer says.
fn told(process: &mut Process) -> String {
    assert_eq!(process.end(), Some(1), "{}\n{}", process.stdout(), process.stderr());
    let stdout = process.stdout();
    stdout.lines().next().unwrap().split_once("): ").unwrap().1.to_owned()
}

#[test]
fn a_client_with_an_ip_net_table_asks_through_the_relay() {
    let site = Site::claim();
    let configuration = site
        .configuration(&Settings::default())
        .replace(&format!("allow = [\"{}/24\"]", site.address(0)), "allow = [\"127.0.0.0/8\"]");
    let relay = Relay::start(&configuration, site.admin(), None);
    let _nodes = site.simulated_nodes("0s");
    let folder = folder("");
    let table = format!(
        "node_address = 9\n\
         [[ip_net]]\nid = 1\ntype = \"IPRange\"\naddress = \"{}\"\nport = 34378\nrouter = 0\n\
         [[ip_net]]\nid = 2\ntype = \"UDPRange\"\naddress = \"{}\"\nport = {}\nrouter = 8\n\
         use_password = true\n",
        site.address(0),
        site.public_address(),
        site.start_port(),
    );
    let request = |table: &str, options: &[&str]| {
        fs::write(folder.path().join("client.toml"), table).unwrap();
        let mut command = pnet_nat(&["request", "--table", "client.toml"]);
        command.args(options).current_dir(folder.path());
        Process::start(command)
    };
    let many =
        ["--net", "2", "--node", "1-4", "--count", "50", "--interval", "0s", "--window", "8"];
    let many = [&many[..], &["--timeout", "20s", "--format", "json"]].concat();
    let with_password = table.clone() + "password_file = \"secrets/section-1\"\n";
    for (table, password) in
        [(&with_password, &[][..]), (&table, &["--password-file", "secrets/section-1"])]
    {
        let lines = json_lines(&mut request(table, &[&many, password].concat()), 0);
        assert_eq!(lines.len(), 200 + 4 + 1);
        let sources = [2, 1, 0].map(|source| json!(source));
        let first = lines.iter().find(|line| line["node"] == 1).unwrap();
        assert_eq!(
            first["sources"].as_array().unwrap()[..],
            sources,
            "the net as the client knows it"
        );
        for (line, node) in lines[200..204].iter().zip(1..) {
            assert_eq!((&line["node"], &line["sent"]), (&json!(node), &json!(50)));
            assert_eq!((&line["answered"], &line["lost"]), (&json!(50), &json!(0)));
            assert!(line["p99_seconds"].as_f64() <= line["max_seconds"].as_f64());
        }
        assert_eq!((&lines[204]["sent"], &lines[204]["answered"]), (&json!(200), &json!(200)));
        assert_eq!(lines[204]["node"], Value::Null);
    }
    // The nodes themselves, in the client's own net, without a password.
    let own = ["--net", "1", "--node", "1-4", "--format", "json", "--timeout", "20s"];
    for line in json_lines(&mut request(&with_password, &own), 0) {
        assert!(line["to"].as_str().unwrap().ends_with(":34378"), "{line}");
    }
    for (net, table, why) in [
        (
            "2",
            &table,
            "row 2, UsePW: packages to this net carry a password, and there is none (PAS 7)",
        ),
        ("3", &table, "row 3, Nettype: the net is unused"),
        ("2", &table.replace("port = 34378", "port = 0"), "0 is out of bounds"),
    ] {
        let mut refused = request(table, &["--net", net, "--node", "1"]);
        assert_eq!(refused.end(), Some(2), "{}", refused.stdout());
        assert!(refused.stderr().contains(why), "{}", refused.stderr());
    }
    relay.expect_drops(&[]);
    relay.finish();
}

#[test]
fn a_request_says_what_it_is_told_to_say() {
    let nodes = Nodes::start(&[]);
    fs::write(nodes.folder.path().join("data"), [0xAB; 63]).unwrap();
    let options = ["--control", "$2A", "--beyond", "2.33", "--format", "json", "--timeout", "20s"];
    for (data, expected) in [("dead beef", "deadbeef".to_owned()), ("@data", "ab".repeat(63))] {
        let mut asked = nodes.ask(3, &[&options[..], &["--data", data]].concat());
        let lines = json_lines(&mut asked, 0);
        assert_eq!(lines.len(), 1);
        assert_eq!(
            (&lines[0]["data"], &lines[0]["control_status"]),
            (&json!(expected), &json!(0x2A))
        );
        assert_eq!(lines[0]["sources"], json!([11, 3, 2, 33, 0]));
        assert_eq!(lines[0]["destinations"].as_array().unwrap()[0], json!(125), "a dynamic client");
    }
    let mut broadcast = nodes.ask(3, &["--beyond", "2.126"]);
    assert_eq!(broadcast.end(), Some(0));
    assert!(broadcast.stdout().ends_with("sent; nobody answers a broadcast\n"));
}

/// It is cut into pieces, and put together again.
#[test]
fn a_memory_is_written_and_read() {
    let nodes = Nodes::start(&["--reply", "memory", "--read", "1", "--write", "2"]);
    let octets: Vec<u8> = (0..=255).cycle().take(900).collect();
    fs::write(nodes.folder.path().join("data"), &octets).unwrap();
    let patient = ["--timeout", "20s", "--format", "json", "--offset", "100"];
    let write = ["--control", "2", "--data", "@data"];
    json_lines(&mut nodes.ask(3, &[&patient[..], &write].concat()), 0);
    let read = ["--control", "1", "--size", "900"];
    let lines = json_lines(&mut nodes.ask(3, &[&patient[..], &read].concat()), 0);
    let expected: String = octets.iter().map(|octet| format!("{octet:02x}")).collect();
    assert_eq!(lines[0]["data"], json!(expected));
    let beyond = ["--control", "1", "--size", "63", "--offset", "1000", "--timeout", "200ms"];
    assert_eq!(told(&mut nodes.ask(3, &beyond)), "no answer within 200ms");
}

#[test]
fn an_answer_that_is_missing_has_a_reason() {
    // Long enough for an answer to come, however busy the machine.
    let long = ["--timeout", "2s"];
    for (fault, why) in [
        (&["--answer-from-other-port"][..], "answers came from another port, "),
        (&["--wrong-password"], "answers with a wrong password"),
        (&["--drop", "100%"], "no answer within 2s"),
    ] {
        let nodes = Nodes::start(fault);
        let told = told(&mut nodes.ask(2, &long));
        assert!(told.starts_with(why), "{told}");
    }
    let nodes = Nodes::start(&["--drop", "100%"]);
    let again = ["--timeout", "50ms", "--retries", "3"];
    assert_eq!(told(&mut nodes.ask(2, &again)), "no answer within 200ms, sent 4 times");
    // Nothing has this port, and it is said at once.
    let to = nodes.site.address(4).to_string();
    let nobody = ["--to", &to, "--port", "1", "--node", "4", "--timeout", "1h"];
    assert_eq!(told(&mut nodes.request(&nobody)), "nothing listens there");
}

#[test]
fn what_is_lost_on_the_way_is_asked_again() {
    let nodes = Nodes::start(&["--drop", "20%", "--reorder", "20%", "--duplicate", "20%"]);
    let options = ["--count", "100", "--interval", "0s", "--window", "16", "--retries", "50"];
    let options = [&options[..], &["--timeout", "200ms", "--format", "json"]].concat();
    let lines = json_lines(&mut nodes.ask(2, &options), 0);
    let all = lines.last().unwrap();
    assert_eq!(
        (&all["sent"], &all["answered"], &all["lost"]),
        (&json!(100), &json!(100), &json!(0))
    );
    assert!(all["retried"].as_u64().unwrap() > 0, "{all}");
    // Each answer has the number of a request, and none comes twice.
    let mut data: Vec<_> = lines[..100].iter().map(|line| line["data"].to_string()).collect();
    data.sort_unstable();
    let expected: Vec<_> = (0..100_u32).map(|number| format!("\"{number:08x}\"")).collect();
    assert_eq!(data, expected);
}

#[test]
fn the_exit_code_is_0_only_when_all_were_answered_or_enough() {
    // Linux gives out no such port, so nothing stands at that of node 5.
    let nodes = Nodes::start(&["--secure-port", "20004"]);
    let to = nodes.site.address(4).to_string();
    let some = ["--to", &to, "--start-port", "20000", "--node", "4-5", "--timeout", "20s"];
    for (tolerate, code) in [("0%", 1), ("49%", 1), ("50%", 0)] {
        let mut asked = nodes.request(
            &[&some[..], &["--tolerate", tolerate, "--count", "2", "--interval", "0s"]].concat(),
        );
        assert_eq!(asked.end(), Some(code), "{tolerate}: {}", asked.stdout());
        let stdout = asked.stdout();
        assert!(stdout.contains("node 5") && stdout.contains("nothing listens there"), "{stdout}");
        assert!(stdout.lines().last().unwrap().starts_with("sent 4, answered 2, lost 2; min "));
    }
}

#[test]
fn a_deadline_and_a_signal_end_it_with_statistics() {
    let nodes = Nodes::start(&["--delay", "1h"]);
    let slow = ["--timeout", "1h", "--count", "3", "--interval", "0s", "--window", "2"];
    let mut asked = nodes.ask(1, &[&slow[..], &["--deadline", "300ms"]].concat());
    assert_eq!(told(&mut asked), "no answer before the deadline");
    assert!(asked.stdout().ends_with("sent 2, answered 0, lost 2\n"), "{}", asked.stdout());

    let quick = Nodes::start(&[]);
    let mut asked = quick.ask(1, &["--count", "1000", "--interval", "10ms", "--timeout", "20s"]);
    eventually("it asks", || (asked.stdout().lines().count() > 3).then_some(()));
    asked.signal(Signal::SIGINT);
    let code = asked.end();
    let stdout = asked.stdout();
    let last = stdout.lines().last().unwrap();
    assert!(last.starts_with("sent ") && last.contains("p99"), "{last}");
    // It may have been stopped while it waited for an answer.
    assert_eq!(code, Some(i32::from(!last.contains("lost 0"))), "{stdout}");
}

/// `localhost` may be IPv6 as well, and the node has only IPv4.
#[test]
fn a_host_name_is_looked_up() {
    let folder = folder("");
    let node = ["node", "--listen", "127.0.0.1", "--secure-port", "0", "--normal-port", "0"];
    let mut command = pnet_nat(&[&node[..], &["--password-file", PASSWORD]].concat());
    let node = Process::start({
        command.current_dir(folder.path());
        command
    });
    let port = eventually("the node is there", || {
        let stdout = node.stdout();
        Some(stdout.lines().next()?.rsplit_once(' ')?.1.to_owned())
    });
    let request = |host: &str| {
        let options = ["request", "--to", host, "--port", &port, "--node", "1", "--timeout", "20s"];
        let mut command = pnet_nat(&[&options[..], &["--password-file", PASSWORD]].concat());
        command.current_dir(folder.path());
        Process::start(command)
    };
    let mut asked = request("localhost");
    assert_eq!(asked.end(), Some(0), "{}{}", asked.stdout(), asked.stderr());
    assert!(asked.stdout().starts_with("node 1 (127.0.0.1:"), "{}", asked.stdout());
    let mut asked = request("no-such-host.invalid");
    assert_eq!(asked.end(), Some(1));
    assert!(asked.stderr().contains("\"no-such-host.invalid\" cannot be looked up"));
}

#[test]
fn long_work_has_a_progress_bar_on_a_terminal() {
    let nodes = Nodes::start(&[]);
    let to = nodes.site.address(1).to_string();
    let options = ["request", "--to", &to, "--port", "34379", "--node", "1", "--timeout", "20s"];
    let options = [&options[..], &["--password-file", PASSWORD, "--interval", "700ms"]].concat();
    let on_a_terminal = |count: &str| {
        let mut command = pnet_nat(&[&options[..], &["--count", count]].concat());
        let mut terminal = Terminal::start(command.current_dir(nodes.folder.path()));
        assert_eq!(terminal.end(), Some(0), "{}", terminal.text());
        terminal.text()
    };
    let long = on_a_terminal("5");
    assert!(long.contains(" %, ") && long.contains(" of 5\r\x1b[K"), "{long:?}");
    assert!(!on_a_terminal("1").contains(" of 1"));
}

#[test]
fn what_makes_no_sense_is_refused() {
    let nodes = Nodes::start(&[]);
    let to = nodes.site.address(1).to_string();
    for (options, why) in [
        (&["--to", &to, "--port", "5", "--node", "1-2"][..], "--port is that of one node"),
        (&["--to", &to, "--node", "1"], "--start-port"),
        (&["--start-port", "20000", "--node", "1"], "--to"),
        (&["--table", "client.toml", "--node", "1"], "--net"),
        (
            &["--table", "client.toml", "--net", "1", "--to", &to, "--node", "1"],
            "cannot be used with",
        ),
        (&["--to", &to, "--port", "5", "--node", "1", "--offset", "1"], "needs --data to write"),
        (&["--to", &to, "--port", "5", "--node", "1", "--size", "1"], "--offset"),
        (&["--to", &to, "--port", "5", "--node", "1", "--window", "65"], "1..=64"),
        (&["--to", &to, "--port", "5", "--node", "1", "--data", "abc"], "hexadecimal digits"),
        (&["--to", &to, "--port", "5", "--node", "1", "--data", &"00".repeat(64)], "is too large"),
        (&["--to", &to, "--port", "5", "--node", "1", "--beyond", "2.128"], "from 0 to 127"),
        (&["--to", &to, "--port", "5", "--node", "1", "--tolerate", "10"], "\"0%\" to \"100%\""),
    ] {
        let mut refused = nodes.request(options);
        assert_eq!(refused.end(), Some(2), "{options:?}: {}", refused.stdout());
        assert!(refused.stderr().contains(why), "{options:?}: {}", refused.stderr());
    }
}

/// A node with a table answers the clients that the table names through it.
#[test]
fn a_node_takes_a_table() {
    let (site, folder) = (Site::claim(), folder(""));
    let own = format!(
        "node_address = 9\n[[ip_net]]\nid = 7\ntype = \"IPRange\"\naddress = \"{}\"\nport = 34378\n\
         router = 0\n",
        site.address(0)
    );
    let start = |table: &str| {
        fs::write(folder.path().join("node.toml"), table).unwrap();
        let listen = site.address(4).to_string();
        let options = ["node", "--listen", &listen, "--table", "node.toml"];
        let mut command = pnet_nat(&[&options[..], &["--password-file", PASSWORD]].concat());
        command.current_dir(folder.path());
        Process::start(command)
    };
    let router = own.replace("router = 0", "router = 4")
        + &format!(
            "[[ip_net]]\nid = 1\ntype = \"IPRange\"\naddress = \"{}\"\nport = 34378\nrouter = 0\n",
            site.address(0)
        );
    let mut refused = start(&router);
    assert_eq!(refused.end(), Some(2), "{}", refused.stdout());
    assert!(
        refused.stderr().contains("node 4: row 7, Router: 4 is the node itself"),
        "{}",
        refused.stderr()
    );
    let node = start(&own);
    eventually("the node is there", || (node.stdout().lines().count() == 1).then_some(()));
    let client = crate::harness::Peer::bind((site.address(3), 34378).into());
    client.send((site.address(4), 34378).into(), &[2, 0, 0, 0, 0x0B, 4, 0x87, 0x83, 0, 1, 42]);
    client.expect(&[2, 0, 0, 0, 7, 3, 3, 0x8B, 0x84, 0x80, 0, 1, 42]);
}
