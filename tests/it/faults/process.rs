//! What the relay's own process runs out of, and watchers that hold on to it.

use std::fs::File;
use std::io::Write;
use std::net::TcpStream;
use std::process::Command;

use nix::sys::resource::{Resource, getrlimit, rlim_t};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;
use socket2::{Domain, Socket, Type};

use crate::harness::{Relay, Settings, Site, eventually, exchange, pnet_nat, request};

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
    assert_ne!(exchange(&new, site.public(4), &node, 4), port);
    assert_eq!(exchange(&known, site.public(4), &node, 4), port);
    let log = relay.finish();
    assert_eq!(log.logged("cannot open an upstream socket").len(), 1);
}

/// Standard error is a pipe that is full, as when a log collector hangs: no line of the log can be
/// written any more. Requests, reloads and scrapes go on, and what is lost is counted.
#[test]
fn a_log_that_nobody_reads() {
    let site = Site::claim();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log");
    mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    // Somebody has it open, or the relay would not get to open it.
    let _reader = File::options().read(true).write(true).open(&path).unwrap();
    let sound =
        site.configuration(&Settings::default()).replace("[admin]", "[admin]\nreload = true");
    let relay = Relay::start_as(&sound, site.admin(), |arguments| {
        let relay = pnet_nat(arguments);
        let mut command = Command::new("sh");
        command.args(["-c", "exec \"$@\" 2>\"$0\""]).arg(&path);
        command.arg(relay.get_program()).args(relay.get_args());
        command
    });
    let (client, node) = (site.client(), site.node(4));
    let port = exchange(&client, site.public(4), &node, 4);
    let lost = || relay.metrics().sum("pnet_nat_log_lines_lost_total", &[]);
    assert_eq!(lost(), 0);

    // Each fault that is told is a line, and so are the number of the others and the outcome.
    let faults = vec!["200"; 1000].join(", ");
    relay.configure(&sound.replace("\"1-4\", 33", &faults));
    let mut reloads = 0;
    while lost() == 0 {
        assert_eq!(relay.post_reload().0, 422);
        assert_eq!(exchange(&client, site.public(4), &node, 4), port);
        reloads += 1;
        assert!(reloads < 300, "no line is lost");
    }
    let lines = reloads * 102;
    assert!(lost() <= lines - 16 * 1024 + 1, "{} of {lines}", lost());
    relay.configure(&sound);
    assert_eq!(relay.post_reload().0, 200);
    exchange(&site.client(), site.public(4), &node, 4);
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
    assert_eq!(relay.at_rest().sum("pnet_nat_forwarded_datagrams_total", &[]), 2 * 501);
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

fn limit_descriptors(relay: &Relay, soft: rlim_t) {
    let (process, limit) = (relay.process.id().to_string(), format!("--nofile={soft}:"));
    let status = Command::new("prlimit").args(["--pid", &process, &limit]).status().unwrap();
    assert!(status.success());
}
