//! What the relay's own process runs out of, and watchers that hold on to it.

use std::io::Write;
use std::net::TcpStream;
use std::process::Command;

use nix::sys::resource::{Resource, getrlimit};
use socket2::{Domain, Socket, Type};

use crate::harness::{Relay, Settings, Site, eventually, exchange, request};

/// Not one file descriptor can be had any more: a new client finds no upstream socket, the admin
/// server accepts nobody. Who is known goes on, and when it is over, all do.
#[test]
fn no_file_descriptors_left() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (known, new) = (site.client(), site.client());
    let (node, other) = (site.node(4), site.node(3));
    let port = exchange(&known, site.public(4), &node, 4);

    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    limit_descriptors(&relay, 3);
    new.send(site.public(4), &request(4));
    for _ in 0..20 {
        assert_eq!(exchange(&known, site.public(4), &node, 4), port);
        let sharing = exchange(&known, site.public(3), &other, 3);
        assert_eq!(sharing, port, "a new flow over an open socket");
    }
    // Somebody asks the admin server meanwhile.
    let waiting = TcpStream::connect(site.admin()).unwrap();
    eventually("the admin server says that it cannot accept", || {
        let says =
            |line: serde_json::Value| line["message"].as_str().unwrap().contains("cannot accept");
        relay.process.log().any(says).then_some(())
    });
    assert_eq!(exchange(&known, site.public(4), &node, 4), port);

    limit_descriptors(&relay, hard);
    drop(waiting);
    relay.expect_drops(&[("request", "upstream_exhausted", 1)]);
    assert_eq!(relay.process.logged("cannot open an upstream socket").len(), 1);
    assert_ne!(exchange(&new, site.public(4), &node, 4), port);
    assert_eq!(exchange(&known, site.public(4), &node, 4), port);
    relay.finish();
}

/// As many as the admin server serves at once, and more, ask for all metrics and read none.
#[test]
fn scrapers_that_do_not_read() {
    let site = Site::claim();
    let relay = site.relay(Settings { sections: &large_sections(), ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    let (_, metrics) = relay.get("/metrics").unwrap();
    assert!(metrics.len() > 1_500_000, "more than the kernel's buffers hold: {}", metrics.len());

    let stuck: Vec<_> = (0..70).map(|_| ask_and_do_not_read(&site)).collect();
    for _ in 0..500 {
        exchange(&client, site.public(4), &node, 4);
    }
    // They lose their place after a while; no relay has to be restarted for that.
    eventually("the admin server answers", || {
        relay.get("/-/ready").filter(|(status, _)| *status == 200)
    });
    exchange(&client, site.public(4), &node, 4);
    drop(stuck);
    relay.expect_drops(&[]);
    assert_eq!(relay.metrics().sum("pnet_nat_forwarded_datagrams_total", &[]), 2 * 501);
    relay.finish();
}

/// Sections of 125 nodes that nobody asks.
fn large_sections() -> String {
    let section = |index: u16| {
        format!(
            "[[udp_range_net]]\nname = \"large-{index}\"\nstart_port = {}\n\
             subnet = \"127.1.{index}.0\"\n\
             nodes = [\"1-125\"]\nallow = [\"127.0.0.0/8\"]\n\
             [[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/press\"\n",
            21000 + 200 * index
        )
    };
    (0..4).map(section).collect()
}

fn ask_and_do_not_read(site: &Site) -> Socket {
    let mut socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
    socket.set_recv_buffer_size(4096).unwrap(); // before connecting, so that no more is on the way
    socket.connect(&site.admin().into()).unwrap();
    socket.write_all(b"GET /metrics HTTP/1.1\r\nHost: relay\r\n\r\n").unwrap();
    socket
}

fn limit_descriptors(relay: &Relay, soft: u64) {
    let (process, limit) = (relay.process.id().to_string(), format!("--nofile={soft}:"));
    let status = Command::new("prlimit").args(["--pid", &process, &limit]).status().unwrap();
    assert!(status.success());
}
