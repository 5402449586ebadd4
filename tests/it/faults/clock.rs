//! A clock that is set while the relay runs, by hours or by years: what it does goes by the time
//! that passes, what it says by the clock.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::Value;

use crate::harness::{
    FIGURE_10, Relay, SECOND, Settings, Site, datagram, eventually, exchange, left_out, pnet_nat,
};

const YEAR: i64 = 365 * 86_400;

/// A server whose flows close soon, to see that time goes on for the relay.
const PRESS: &str = r#"
[[server]]
name = "press"
public_port = 20200
address = "SUBNET7:34379"
node = 7
allow = ["SUBNET0/24"]
idle_timeout = "1s"

[[server.password]]
name = "service"
file = "secrets/press"
"#;

#[test]
fn a_clock_that_jumps() {
    let Some(library) = faketime() else {
        return left_out("libfaketime, which sets a clock for one process alone");
    };
    let site = Site::claim();
    let subnet = site.address(0).to_string();
    let press = PRESS.replace("SUBNET", subnet.strip_suffix('0').unwrap());
    let clock = tempfile::NamedTempFile::new().unwrap();
    set(clock.path(), 0);
    let configuration = site.configuration(&Settings { sections: &press, ..Settings::default() });
    let relay = Relay::start_as(&configuration, site.admin(), |arguments| {
        let mut command = pnet_nat(arguments);
        // The library reads a file, which is no business of a relay.
        command.arg("--no-sandbox");
        command.env("LD_PRELOAD", library);
        command.env("FAKETIME_TIMESTAMP_FILE", clock.path());
        command.envs([("FAKETIME_NO_CACHE", "1"), ("FAKETIME_DONT_FAKE_MONOTONIC", "1")]);
        command
    });
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);

    for (jumps, offset) in [0, 3600, 2 * YEAR, -10 * YEAR].into_iter().enumerate() {
        set(clock.path(), offset);
        // A flow opens, is idle for its second, and closes: the relay has looked through all flows.
        let mut route = FIGURE_10;
        route[1] = 7;
        let octets = datagram(&route, &[], SECOND);
        site.client().send((site.public_address(), 20200).into(), &octets);
        let closed = eventually("the idle flow closes", || {
            let closed = relay.process.logged("flow closed");
            (closed.len() == jumps + 1).then(|| closed[jumps].clone())
        });
        assert_eq!(closed["reason"], "idle");
        assert!((1..20).contains(&closed["age_seconds"].as_u64().unwrap()), "{closed}");
        // The log has the clock's time, and so do the metrics.
        let seconds = humantime::parse_rfc3339(closed["timestamp"].as_str().unwrap()).unwrap();
        assert_near(seconds.duration_since(UNIX_EPOCH).unwrap().as_secs(), offset);

        assert_eq!(exchange(&client, site.public(4), &node, 4), port, "the other flow is open");
        let labels = [("net", "section-1"), ("node", "4")];
        assert_near(
            relay.metrics().sum("pnet_nat_last_response_timestamp_seconds", &labels),
            offset,
        );
    }
    relay.expect_drops(&[]);
    let closed = relay.finish().logged("flow closed");
    let of_section_1: Vec<&Value> =
        closed.iter().filter(|line| line["net"] == "section-1").collect();
    assert_eq!(of_section_1.len(), 1);
    assert_eq!(of_section_1[0]["reason"], "shutdown");
}

/// Unix time by the process's clock, within what a busy machine may take.
fn assert_near(seconds: u64, offset: i64) {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let apart = now.as_secs() as i64 + offset - seconds as i64;
    assert!(apart.abs() < 60, "{apart} seconds off the clock");
}

fn set(clock: &Path, offset: i64) {
    // In one go: the process may read it at any time.
    let new = clock.with_extension("new");
    fs::write(&new, format!("{offset:+}")).unwrap();
    fs::rename(new, clock).unwrap();
}

fn faketime() -> Option<PathBuf> {
    let folder = format!("/usr/lib/{}-linux-gnu/faketime", std::env::consts::ARCH);
    let library = Path::new(&folder).join("libfaketimeMT.so.1");
    library.exists().then_some(library)
}
