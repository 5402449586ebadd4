//! No thread can be had any more: whatever the relay does after its start, it does with those that
//! it has.

use std::fs;
use std::path::Path;

use nix::sys::signal::Signal;

use crate::harness::{
    Process, Relay, Settings, Site, Somebody, eventually, exchange, folder, request, response,
};

/// Lists of flows, reloads either way, and the end, with an answer that is due.
#[test]
fn no_thread_left_while_it_runs() {
    let Some(somebody) = Somebody::new() else { return };
    let site = Site::claim();
    let sound = site
        .configuration(&Settings { runtime: "workers = 2\ndrain = \"20s\"", ..Settings::default() })
        .replace("[admin]", "[admin]\nreload = true");
    let mut relay = Relay::start_as(&sound, site.admin(), |arguments| {
        somebody.owns(Path::new(arguments[2]).parent().unwrap());
        somebody.pnet_nat(Some(1 + 2 + 2), arguments)
    });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    let (status, flows) = relay.get("/api/v1/flows").unwrap();
    assert_eq!(status, 200, "{flows}");
    assert!(flows.contains(&client.address().to_string()), "{flows}");
    assert_eq!(relay.post_reload().0, 200);
    assert_eq!(relay.reload()["message"], "reload");
    relay.configure("[public");
    assert_eq!(relay.post_reload().0, 422);
    assert_eq!(relay.reload()["message"], "reload failed");
    exchange(&client, site.public(4), &node, 4);

    client.send(site.public(4), &request(4));
    let way_back = node.expect(&request(4));
    relay.process.signal(Signal::SIGTERM);
    eventually("it is not ready", || (relay.get("/-/ready")?.0 == 503).then_some(()));
    node.send(way_back, &response(4));
    client.expect(&response(4));
    assert_eq!(relay.process.end(), Some(0), "{}", relay.process.stderr());
    assert_eq!(relay.process.logged("stopped").len(), 1);
}

/// The limit stands in the way of a start: an error says so, whichever thread it is that is missing.
#[test]
fn no_thread_left_at_the_start() {
    let Some(somebody) = Somebody::new() else { return };
    let site = Site::claim();
    let runtime = Settings { runtime: "workers = 3\ndrain = \"0s\"", ..Settings::default() };
    let configuration = site.configuration(&runtime);
    let relay = Relay::start_as(&configuration, site.admin(), |arguments| {
        somebody.owns(Path::new(arguments[2]).parent().unwrap());
        somebody.pnet_nat(Some(1 + 3 + 2), arguments)
    });
    let threads = fs::read_dir(format!("/proc/{}/task", relay.process.id())).unwrap().count();
    assert_eq!(threads, 1 + 3 + 2, "the main one, workers, log, reloads");
    relay.finish();

    for most in 1..threads {
        let folder = folder(&configuration);
        somebody.owns(folder.path());
        let path = folder.path().join("pnet-nat.toml");
        let arguments = ["run", "--config", path.to_str().unwrap()];
        let mut process = Process::start(somebody.pnet_nat(Some(most), &arguments));
        let code = process.end();
        let said = process.stderr();
        assert!(matches!(code, Some(1..=99)), "{most} threads: {code:?}, {said}");
        assert!(said.contains("cannot start the thread"), "{most} threads: {said}");
        assert!(!said.contains("panicked"), "{most} threads: {said}");
    }
}

/// Commands that ask a relay are carried out without, or say what they lack.
#[test]
fn no_thread_left_for_who_asks() {
    let Some(somebody) = Somebody::new() else { return };
    let site = Site::claim();
    let _relay = site.relay(Settings::default());
    let url = format!("http://{}", site.admin());
    let asks = |threads, arguments: &[&str]| {
        let mut process = Process::start(somebody.pnet_nat(Some(threads), arguments));
        (process.end(), process.stdout(), process.stderr())
    };
    let (code, _, said) = asks(1, &["healthcheck", "--url", &format!("{url}/-/ready")]);
    assert_eq!(code, Some(0), "{said}");
    let (code, shown, said) = asks(1, &["status", "--url", &url]);
    assert_eq!(code, Some(0), "{said}");
    assert!(shown.contains("section-1"), "{shown}");
    // A label is 63 letters at most: no name server is asked for that one.
    for host in ["localhost".to_owned(), "a".repeat(64) + ".example"] {
        let nobody = format!("http://{host}:1/");
        let (code, why, said) = asks(1, &["healthcheck", "--url", &nobody]);
        assert_eq!((code, said.as_str()), (Some(1), ""), "{host}");
        assert!(why.starts_with("not ready: "), "{why}");
        let (code, _, said) = asks(1, &["reload", "--url", &nobody]);
        assert_eq!(code, Some(1), "{said}");
        assert!(said.contains("no answer from"), "{said}");
    }

    let watch = ["status", "--url", &url, "--watch"];
    let mut watching = Process::start(somebody.pnet_nat(Some(1), &watch));
    eventually("it shows the relay", || watching.stdout().contains("section-1").then_some(()));
    watching.signal(Signal::SIGINT);
    assert_eq!(watching.end(), Some(0), "{}", watching.stderr());
}
