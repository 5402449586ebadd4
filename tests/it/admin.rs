//! Clients of the admin server that mean harm, or are just many: requests go on being relayed, and
//! probes being answered.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use crate::harness::{PATIENCE, Process, Relay, Settings, Site, exchange, pause, pnet_nat};
use crate::scale;

/// Connects again and again, says this much, and keeps what connections it has got.
fn harass(admin: SocketAddr, words: &[u8], over: &AtomicBool, made: &AtomicU32) {
    let mut held = Vec::new();
    while !over.load(Relaxed) {
        let Ok(mut stream) = TcpStream::connect(admin) else { continue };
        // It may be cut off already.
        let _ = stream.write_all(words);
        made.fetch_add(1, Relaxed);
        held.push(stream);
        if held.len() > 200 {
            held.drain(..100);
        }
        pause(Duration::from_millis(1));
    }
}

#[test]
fn whatever_its_clients_do_the_relay_relays_and_probes_are_answered() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    let (over, made) = (AtomicBool::new(false), AtomicU32::new(0));
    let huge = [b"GET /".as_slice(), &[b'a'; 100_000]].concat();
    let words: [&[u8]; 5] = [
        b"",
        b"GET /metrics HTTP/1.1\r\nx: ",
        b"GET /metrics HTTP/1.1\r\nhost: localhost\r\n\r\n",
        b"\0\xff\r\n\r\n",
        &huge,
    ];
    thread::scope(|scope| {
        for words in words {
            let (admin, over, made) = (site.admin(), &over, &made);
            scope.spawn(move || harass(admin, words, over, made));
        }
        let end = Instant::now() + Duration::from_secs(3);
        let (mut exchanges, mut probes) = (0, 0);
        while Instant::now() < end || probes < 3 {
            for _ in 0..20 {
                exchange(&client, site.public(4), &node, 4);
                exchanges += 1;
            }
            let url = format!("http://{}/-/ready", site.admin());
            let mut probe = Process::start(pnet_nat(&["healthcheck", "--url", &url]));
            assert_eq!(probe.end(), Some(0), "{}", probe.stdout());
            probes += 1;
        }
        over.store(true, Relaxed);
        println!("{exchanges} exchanges, {probes} probes, {} connections", made.load(Relaxed));
    });
    assert!(made.load(Relaxed) > 200, "nobody did any harm");
    relay.finish();
}

/// A scrape, to its end.
fn scrape(admin: SocketAddr, coding: &str) {
    let mut stream = TcpStream::connect(admin).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    write!(stream, "GET /metrics HTTP/1.1\r\nhost: localhost\r\naccept-encoding: {coding}\r\n\r\n")
        .unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    assert!(answer.starts_with(b"HTTP/1.1 200 "), "{coding}");
    assert!(answer.ends_with(b"\r\n0\r\n\r\n"), "a scrape was cut: {coding}");
}

#[test]
fn while_many_scrape_a_large_table_no_request_is_lost_and_probes_are_answered() {
    let site = Site::claim();
    // 1,000 public ports.
    let configuration = scale::configuration(&site, 8);
    let relay = Relay::start(&configuration, site.admin(), Some(4096));
    let (client, node) = (site.client(), site.node(4));
    let public = (site.public_address(), scale::start_port(0) + 4).into();
    let (mut exchanges, mut probes) = (0, 0);
    thread::scope(|scope| {
        let admin = site.admin();
        let scrapers = ["gzip", "identity"].repeat(8).into_iter().map(|coding| {
            scope.spawn(move || {
                for _ in 0..2 {
                    scrape(admin, coding);
                }
            })
        });
        let scrapers: Vec<_> = scrapers.collect();
        while scrapers.iter().any(|scraper| !scraper.is_finished()) {
            for _ in 0..20 {
                exchange(&client, public, &node, 4);
                exchanges += 1;
            }
            assert_eq!(relay.get("/-/ready").map(|(status, _)| status), Some(200));
            probes += 1;
        }
    });
    println!("{exchanges} exchanges, {probes} probes");
    assert!(probes > 2, "nobody asked beside the scrapes");
    let metrics = relay.at_rest();
    for name in ["pnet_nat_received_datagrams_total", "pnet_nat_forwarded_datagrams_total"] {
        for direction in ["request", "response"] {
            let count = metrics.sum(name, &[("direction", direction)]);
            assert_eq!(count, exchanges, "{name} {direction}");
        }
    }
    relay.finish();
}

#[test]
fn a_token_is_asked_for_and_probes_are_not() {
    let site = Site::claim();
    let admin = format!("listen = \"{}\"", site.admin());
    let configuration = site.configuration(&Settings::default());
    let with_token = format!("{admin}\ntoken_file = \"secrets/admin\"");
    let relay = Relay::start(&configuration.replace(&admin, &with_token), site.admin(), None);
    let ask = |path: &str, header: &str| {
        let mut stream = TcpStream::connect(site.admin()).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nhost: a.example\r\n{header}\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer[9..12].parse::<u16>().unwrap()
    };
    for path in ["/api/v1/nets", "/metrics", "/api/v1/config"] {
        assert_eq!(ask(path, "accept: */*"), 401, "{path}");
        assert_eq!(ask(path, "authorization: Bearer s3cr3t-0123456789"), 200, "{path}");
    }
    for path in ["/-/healthy", "/", "/status.js"] {
        assert_eq!(ask(path, "accept: */*"), 200, "{path}");
    }
    let url = format!("http://{}/-/ready", site.admin());
    assert_eq!(Process::start(pnet_nat(&["healthcheck", "--url", &url])).end(), Some(0));
    drop(relay);
}
