//! The other commands: the demo, and the two ends of an exchange for people.

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use crate::harness::{Process, Relay, Settings, Site, eventually, folder, pnet_nat};

#[test]
fn the_demo_ends_well() {
    let mut demo = Process::start(pnet_nat(&["demo", "--seconds", "3"]));
    assert_eq!(demo.end(), Some(0), "{}\n{}", demo.stdout(), demo.stderr());
    let stdout = demo.stdout();
    for line in [
        "✓ every answer was right and none was lost",
        "✓ the stranger was never answered",
        "✓ received = forwarded + dropped",
    ] {
        assert!(stdout.contains(line), "{stdout}");
    }
}

/// Each takes ports that no other one is about to take.
#[test]
fn demos_do_not_get_in_each_others_way() {
    let demo = || Process::start(pnet_nat(&["demo", "--seconds", "1"]));
    let demos: Vec<_> = (0..6).map(|_| demo()).collect();
    for mut demo in demos {
        assert_eq!(demo.end(), Some(0), "{}\n{}", demo.stdout(), demo.stderr());
    }
}

#[test]
fn a_request_goes_through_the_relay_to_simulated_nodes_and_back() {
    let site = Site::claim();
    let configuration = site
        .configuration(&Settings::default())
        .replace(&format!("allow = [\"{}/24\"]", site.address(0)), "allow = [\"127.0.0.0/8\"]");
    let relay = Relay::start(&configuration, site.admin(), None);
    let folder = folder("");
    let password = folder.path().join("secrets/section-1");
    let password = password.to_str().unwrap();

    let listen = format!("{}-4", site.address(1));
    let mut nodes =
        Process::start(pnet_nat(&["node", "--listen", &listen, "--password-file", password]));
    eventually("the nodes are there", || (nodes.stdout().lines().count() == 4).then_some(()));

    let (to, start_port) = (site.public_address().to_string(), site.start_port().to_string());
    let request = |password: &str| {
        let arguments = [
            &["request", "--to", &to, "--start-port", &start_port, "--node", "1-4"][..],
            &["--count", "5", "--interval", "1ms", "--format", "json", "--timeout", "20s"],
            &["--password-file", password],
        ];
        let mut request = Process::start(pnet_nat(&arguments.concat()));
        (request.end(), request.stdout())
    };
    let (code, stdout) = request(password);
    assert_eq!(code, Some(0), "{stdout}");
    let summary: Value = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
    assert_eq!((&summary["sent"], &summary["answered"]), (&json!(20), &json!(20)));
    assert_eq!(relay.at_rest().sum("pnet_nat_flows", &[]), 4, "one client, four nodes");

    nodes.signal(Signal::SIGTERM);
    assert_eq!(nodes.end(), Some(0));
    for node in 1..=4 {
        let line = format!("node {node}: received 5, answered 5, refused 0");
        assert!(nodes.stdout().contains(&line), "{}", nodes.stdout());
    }
    relay.expect_drops(&[]);
    relay.finish();
}
