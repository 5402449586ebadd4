//! The admin server over a real socket, as its clients see it.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use serde_json::{Value, json};
use strum::VariantArray;
use tokio::sync::oneshot;

use axum::http::HeaderMap;
use foldhash::fast::FixedState;

use super::*;
use crate::config::fixture::{self, NODE_1, PASSWORDS, SECTION, config};
use crate::config::{Admin, Token};
use crate::nat::{Direction, DropReason, Refused, Writer, net_key};
use crate::observe::events::EventKind;
use crate::observe::history::{History, Series, Step};
use crate::observe::totals::Presence;

/// An admin server on a free port, in a thread of its own; ends when dropped.
struct Server {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    fn start(router: Arc<Router>) -> Self {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let thread = thread::spawn(move || {
            runtime.block_on(async {
                let listeners = Listeners::from_std(Some(listener), None).unwrap();
                let shutdown = async { _ = stopped.await };
                serve(listeners, router, None, Sandbox::off("in a test"), shutdown).await;
            });
        });
        Self { address, stop: Some(stop), thread: Some(thread) }
    }

    fn get(&self, path: &str) -> Answer {
        self.ask("GET", path)
    }

    fn ask(&self, method: &str, path: &str) -> Answer {
        self.ask_with(method, path, &[])
    }

    fn ask_with(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> Answer {
        let agent: ureq::Agent =
            ureq::Agent::config_builder().http_status_as_error(false).proxy(None).build().into();
        let url = format!("http://{}{path}", self.address);
        let mut request = ureq::http::Request::builder().method(method).uri(url);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut answer = agent.run(request.body(()).unwrap()).unwrap();
        Answer {
            status: answer.status().as_u16(),
            content_type: answer
                .headers()
                .get("content-type")
                .map(|value| value.to_str().unwrap().to_owned())
                .unwrap_or_default(),
            headers: answer.headers().clone(),
            text: answer.body_mut().read_to_string().unwrap(),
        }
    }

    fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).unwrap()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        self.thread.take().unwrap().join().unwrap();
    }
}

struct Answer {
    status: u16,
    content_type: String,
    headers: HeaderMap,
    text: String,
}

impl Answer {
    fn json(&self) -> Value {
        assert_eq!((self.status, self.content_type.as_str()), (200, "application/json"));
        serde_json::from_str(&self.text).unwrap()
    }
}

#[test]
fn routes_answer_and_others_name_them() {
    let server = Server::start(Router::idle(config(), 1));
    let healthy = server.get("/-/healthy");
    assert_eq!((healthy.status, healthy.text.as_str()), (200, "healthy\n"));
    let ready = server.get("/-/ready");
    assert_eq!((ready.status, ready.text.as_str()), (503, "not ready\n"));
    let lost = server.get("/api/v2/nets");
    assert_eq!(lost.status, 404);
    for (path, _) in ROUTES {
        assert!(lost.text.contains(path), "{path}");
        assert_ne!(server.get(path).status, 404, "{path}");
        assert_eq!(server.ask("DELETE", path).status, 405, "{path}");
    }
    for query in ["limit=10001", "limit=-1", "limit=many"] {
        for path in ["flows", "refused"] {
            let path = format!("/api/v1/{path}?{query}");
            assert_eq!(server.get(&path).status, 400, "{path}");
        }
    }
}

#[test]
fn metrics_have_their_type_and_arrive_whole() {
    let server = Server::start(Router::idle(config(), 1));
    let scrape = server.get("/metrics");
    assert_eq!(scrape.content_type, "text/plain; version=0.0.4; charset=utf-8");
    assert!(scrape.text.starts_with("# HELP pnet_nat_received_datagrams_total "));
    assert!(scrape.text.contains("\nprocess_start_time_seconds "));
}

/// A large answer to `GET /metrics`, of a client that reads it so much at a time.
struct Scraper {
    stream: TcpStream,
    read: Vec<u8>,
}

impl Scraper {
    fn of(server: &Server, headers: &str) -> Self {
        let socket =
            socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).unwrap();
        socket.set_recv_buffer_size(32 * 1024).unwrap(); // what it does not read stays with the server
        socket.connect(&server.address.into()).unwrap();
        let mut stream = TcpStream::from(socket);
        write!(stream, "GET /metrics HTTP/1.0\r\nhost: localhost\r\n{headers}\r\n").unwrap();
        Self { stream, read: Vec::new() }
    }

    /// Reads up to this many octets; false at the end.
    fn read(&mut self, octets: usize) -> bool {
        let before = self.read.len();
        let read = (&self.stream).take(octets as u64).read_to_end(&mut self.read);
        read.is_ok() && self.read.len() > before
    }

    /// What came after the headers.
    fn body(&self) -> &[u8] {
        let end = self.read.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        &self.read[end + 4..]
    }
}

/// A router with so many nets of 125 nodes.
fn large(nets: u16) -> Arc<Router> {
    let mut large = config();
    large.table = fixture::large_table(nets);
    Router::idle(large, 2)
}

/// The text of a scrape without what changes from one to the next.
fn series(text: &str) -> Vec<&str> {
    text.lines().map(|line| if line.starts_with("process_") { "" } else { line }).collect()
}

#[test]
fn metrics_come_compressed_to_those_who_ask_for_it() {
    let server = Server::start(Router::idle(config(), 1));
    let plain = server.get("/metrics");
    assert!(!plain.headers.contains_key("content-encoding"));
    assert_eq!(plain.headers["vary"], "accept-encoding");
    for headers in ["accept-encoding: gzip\r\n", "Accept-Encoding: br, GZIP;q=0.5\r\n"] {
        let mut scraper = Scraper::of(&server, headers);
        while scraper.read(1 << 20) {}
        let head = String::from_utf8_lossy(&scraper.read).to_lowercase();
        assert!(head.contains("\r\ncontent-encoding: gzip\r\n"), "{head}");
        let mut text = String::new();
        flate2::read::GzDecoder::new(scraper.body()).read_to_string(&mut text).unwrap();
        assert_eq!(series(&text), series(&plain.text));
    }
}

/// Whoever reads on gets all, however long it takes: here longer than anybody may stand still.
#[test]
#[expect(clippy::disallowed_methods, reason = "a reader's pace is a matter of time")]
fn a_reader_that_is_slow_but_steady_gets_all() {
    let server = Server::start(large(4));
    let mut whole = Scraper::of(&server, "");
    while whole.read(1 << 20) {}
    let whole = whole.body().len();
    assert!(whole > 2_000_000, "{whole}");
    let mut slow = Scraper::of(&server, "");
    let began = Instant::now();
    let pace = STILL_TIME.as_secs_f64() * 1.3 / whole as f64;
    while slow.read(16 * 1024) {
        let due = Duration::from_secs_f64(slow.read.len() as f64 * pace);
        thread::sleep(due.saturating_sub(began.elapsed()));
    }
    assert!(began.elapsed() > STILL_TIME);
    assert!(slow.body().ends_with(b"\n"));
    assert!(slow.body().len().abs_diff(whole) < 1024, "{} of {whole}", slow.body().len());
}

#[test]
#[expect(clippy::disallowed_methods, reason = "a reader's pace is a matter of time")]
fn a_reader_that_stands_still_is_cut_off() {
    let server = Server::start(large(4));
    let mut still = Scraper::of(&server, "");
    assert!(still.read(1));
    thread::sleep(STILL_TIME + Duration::from_secs(4));
    while still.read(1 << 20) {}
    assert!(still.read.len() < 1 << 20, "{} octets", still.read.len());
}

/// Scrapes at the same time get one text, which is made once; the next one gets another.
#[test]
fn who_scrapes_at_the_same_time_gets_the_same_text() {
    let router = large(4);
    let server = Server::start(Arc::clone(&router));
    let count = |n: u64| {
        let node = router.active_config();
        node.counters[0]
            .node(NODE_1)
            .direction(Direction::Request)
            .received
            .add(&Writer::of_worker(), n);
    };
    let received = |scraper: &Scraper| {
        let text = String::from_utf8_lossy(scraper.body()).into_owned();
        let line = text.lines().find(|line| {
            line.starts_with("pnet_nat_received_datagrams_total{") && line.contains("\"request\"")
        });
        line.unwrap().rsplit_once(' ').unwrap().1.to_owned()
    };
    count(1);
    let mut first = Scraper::of(&server, "");
    assert!(first.read(64 * 1024), "the text has begun");
    count(1);
    let mut second = Scraper::of(&server, "");
    assert!(second.read(64 * 1024));
    while first.read(64 * 1024) | second.read(64 * 1024) {}
    assert_eq!(received(&first), "1");
    assert_eq!(received(&second), "1", "it is that of the first");
    assert!(first.body() == second.body(), "all of it is");
    let mut third = Scraper::of(&server, "");
    while third.read(1 << 20) {}
    assert_eq!(received(&third), "2");
}

/// A text of long ago makes room for those that are asked for now.
#[test]
fn the_oldest_text_is_given_up_when_there_are_many() {
    let router = Router::idle(config(), 1);
    let metrics = Metrics::new(Arc::clone(&router), Sandbox::off("in a test"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (scrapes, turn) = (Scrapes::default(), Turn::default());
        let read = async || {
            let body = scrapes.body_of(&metrics, &turn);
            // The text is whole before the next one is asked for.
            for _ in 0..1000 {
                yield_now().await;
            }
            body
        };
        let mut bodies = Vec::new();
        for _ in 0..=scrape::MOST_TEXTS {
            bodies.push(read().await);
        }
        let mut bodies = bodies.into_iter();
        let oldest = axum::body::to_bytes(bodies.next().unwrap(), usize::MAX).await;
        assert!(oldest.is_err(), "its place is taken");
        for body in bodies {
            assert!(!axum::body::to_bytes(body, usize::MAX).await.unwrap().is_empty());
        }
    });
}

#[test]
fn scrapers_that_do_not_read_hold_up_neither_memory_nor_others() {
    let server = Server::start(large(64));
    let before = resident_bytes();
    let stuck: Vec<_> = (0..16)
        .map(|_| {
            let mut stream = server.connect();
            stream.write_all(b"GET /metrics HTTP/1.1\r\nhost: a\r\n\r\n").unwrap();
            stream.peek(&mut [0]).unwrap();
            stream
        })
        .collect();
    assert_eq!(server.get("/-/healthy").status, 200);
    let grown = resident_bytes().saturating_sub(before);
    assert!(grown < 64 << 20, "{grown} octets for 16 scrapers; each whole answer has 31 MB");
    drop(stuck);
}

fn resident_bytes() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    pages.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * 4096
}

#[test]
fn whoever_was_refused_is_listed_newest_first() {
    let (router, writer) = (Router::idle(config(), 2), Writer::of_worker());
    let server = Server::start(Arc::clone(&router));
    assert_eq!(server.get("/api/v1/refused").json(), json!({ "refused": [], "not_listed": 0 }));
    let active = router.active_config();
    let note = |worker: usize, now, sender: &str, net, node| {
        let (direction, reason) = (Direction::Request, DropReason::SourceNotAllowed);
        let (sender, net) = (sender.parse().unwrap(), net_key(net));
        let refused = Refused { sender, net, node, direction, reason };
        let refusals = &active.counters[worker].refusals;
        refusals.note(&writer, now, &refused, &FixedState::default());
    };
    note(0, 1, "198.51.100.9", "section-1", 33);
    note(1, 2_000_000, "2001:db8::7", "press", 7);
    note(1, 3_000_000, "198.51.100.9", "section-1", 33);
    active.counters[1].refusals.not_listed.add(&writer, 5);
    while router.started().elapsed() < Duration::from_millis(4) {
        thread::yield_now();
    }

    let mut all = server.get("/api/v1/refused").json();
    for row in all["refused"].as_array_mut().unwrap() {
        let [first, last] =
            ["first_age_seconds", "last_age_seconds"].map(|age| row[age].take().as_f64().unwrap());
        assert!(0.0 < last && last <= first && first < 60.0, "{first} {last}");
    }
    let row = |source, net, node, count| {
        json!({ "source": source, "net": net, "node": node, "direction": "request",
                "reason": "source_not_allowed", "count": count,
                "first_age_seconds": null, "last_age_seconds": null })
    };
    let rows = [row("198.51.100.9", "section-1", 33, 2), row("2001:db8::7", "press", 7, 1)];
    assert_eq!(all, json!({ "refused": rows, "not_listed": 5 }));
    let sources = |query: &str| {
        let answer = server.get(&format!("/api/v1/refused?{query}")).json();
        let rows = answer["refused"].as_array().unwrap().iter();
        rows.map(|row| row["source"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(sources("limit=1"), ["198.51.100.9"]);
    assert_eq!(sources("net=press"), ["2001:db8::7"]);
    assert_eq!(server.get("/api/v1/refused?net=none").status, 404);
    let metrics = server.get("/metrics").text;
    assert!(!metrics.contains("198.51.100.9") && !metrics.contains("db8"), "never in metrics");
}

#[test]
fn nets_show_what_was_counted() {
    let (router, writer) = (Router::idle(config(), 2), Writer::of_worker());
    for worker in &router.active_config().counters {
        let node = worker.node(NODE_1);
        node.direction(Direction::Request).received.add(&writer, 5);
        node.direction(Direction::Request).forwarded.add(&writer, 4);
        node.direction(Direction::Request).forwarded_bytes.add(&writer, 80);
        node.direction(Direction::Request).dropped(DropReason::Throttled).add(&writer, 1);
        node.response_times.observe(&writer, Duration::from_millis(4));
        node.last_request.set(&writer, 1);
        node.last_response.set(&writer, 1);
        worker.net(SECTION).wrong_password_sources.note(7);
        worker.net(SECTION).wrong_password_sources.note(1 << 40);
        worker.net(SECTION).flows.add(&writer, 3);
        worker.net(SECTION).flows_opened.add(&writer, 3);
        worker.accepted(SECTION)[0].add(&writer, 4);
    }
    let nets = Server::start(router).get("/api/v1/nets").json();
    let mut section = nets["nets"][0].clone();
    let mut nodes = section["nodes"].take();
    for age in ["last_request_age_seconds", "last_response_age_seconds"] {
        let age = nodes[0][age].take().as_f64().unwrap();
        assert!(age > 0.0 && age < 60.0, "{age}");
    }
    assert_eq!(
        section,
        json!({
            "name": "section-1", "kind": "udp_range_net", "start_port": 20000,
            "config_hash": config().hash_of(SECTION), "subnet": "172.17.17.0/24",
            "allow": ["198.51.100.0/24"],
            "credentials": [
                { "name": "service", "has_device_password": false },
                { "name": "team-b", "has_device_password": true },
            ],
            "allow_without_password": false, "require_response_password": false,
            "idle_timeout_seconds": 300.0, "max_flows": 4096,
            "max_requests_per_second": null, "max_flow_requests_per_second": null,
            "flows": 6, "flows_opened": 6, "flows_closed": {
                "idle": 0, "mapping_removed": 0, "source_withdrawn": 0, "password_withdrawn": 0,
                "port_wanted": 0,
                "shutdown": 0,
            },
            "accepted_requests": { "service": 8, "team-b": 0 },
            "kernel_dropped_datagrams": { "overflow": 0, "prefilter": 0 }, "nodes": null,
            "wrong_password_sources": 2,
            "answering_nodes": 1, "silent_nodes": [], "never_asked_nodes": 1,
            "request": {
                "received_datagrams": 10, "forwarded_datagrams": 8, "forwarded_bytes": 160,
                "dropped_datagrams": { "throttled": 2 },
            },
            "response": {
                "received_datagrams": 0, "forwarded_datagrams": 0, "forwarded_bytes": 0,
                "dropped_datagrams": {},
            },
            "response_time_mean_seconds": 0.004, "response_time_median_seconds": 0.004,
            "response_time_p99_seconds": 0.004,
            "response_time_buckets": [0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0],
            "response_times": [{ "up_to_seconds": 0.00405, "answers": 2, "sum_seconds": 0.008 }],
        })
    );
    let nothing = json!({
        "received_datagrams": 0, "forwarded_datagrams": 0, "forwarded_bytes": 0,
        "dropped_datagrams": {},
    });
    assert_eq!(
        nodes,
        json!([
            {
                "node": 1, "local_address": null, "public_port": 20001, "server": "172.17.17.1:34379",
                "request": {
                    "received_datagrams": 10, "forwarded_datagrams": 8, "forwarded_bytes": 160,
                    "dropped_datagrams": { "throttled": 2 },
                },
                "response": nothing, "state": "answering",
                "last_request_age_seconds": null, "last_response_age_seconds": null,
                "response_time_mean_seconds": 0.004, "response_time_median_seconds": 0.004,
                "response_time_p99_seconds": 0.004,
                "response_time_buckets": [0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0],
                "response_times": [
                    { "up_to_seconds": 0.00405, "answers": 2, "sum_seconds": 0.008 },
                ],
            },
            {
                "node": 33, "local_address": null, "public_port": 20033, "server": "172.17.17.33:34379",
                "request": nothing, "response": nothing, "state": "never_asked",
                "last_request_age_seconds": null, "last_response_age_seconds": null,
                "response_time_mean_seconds": null, "response_time_median_seconds": null,
                "response_time_p99_seconds": null,
                "response_time_buckets": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
                "response_times": [],
            },
        ])
    );
    let press = &nets["nets"][1];
    assert_eq!((&press["kind"], &press["subnet"]), (&json!("server"), &json!(null)));
    assert_eq!(press["nodes"][0]["node"], 7);
}

#[test]
fn events_come_newest_first_and_after_a_number() {
    let router = Router::idle(config(), 1);
    router.journal().note(EventKind::Start, "it relays".to_owned());
    router.journal().note(EventKind::Reload, "reload: nothing changed".to_owned());
    let server = Server::start(router);
    let all = server.get("/api/v1/events").json();
    let events = all["events"].as_array().unwrap();
    let mut newest = events[0].clone();
    assert!(newest["time"].take().as_f64() > Some(1.7e9));
    assert_eq!(
        newest,
        json!({
            "number": 2, "time": null, "kind": "reload", "net": null, "node": null,
            "text": "reload: nothing changed",
        })
    );
    assert_eq!((events.len(), &events[1]["kind"]), (2, &json!("start")));
    let later = server.get("/api/v1/events?after=1").json();
    assert_eq!(later["events"].as_array().unwrap().len(), 1);
    assert_eq!(server.get("/api/v1/events?after=2").json(), json!({ "events": [] }));
    assert_eq!(server.get("/api/v1/events?after=-1").status, 400);
}

#[test]
fn a_history_is_the_same_compressed_and_not() {
    let router = Router::idle(config(), 1);
    let step = Step { length: History::STEP, requests: 25, ..Step::default() };
    for n in 1..=7 {
        let presences = [Presence::Answering, Presence::Silent, Presence::NeverAsked].into_iter();
        router.journal().history().note(n * History::STEP, &step, presences);
    }
    let server = Server::start(router);
    let path = "/api/v1/history?net=section-1";
    let mut history = server.get(path).json();
    assert!(history["now"].take().as_f64() > Some(1.7e9));
    assert_eq!(history["hour"]["step_seconds"], 10);
    assert_eq!(history["day"]["step_seconds"], 60);
    for series in Series::VARIANTS {
        let of = |steps: &str| history[steps][series.label()].as_array().unwrap().len();
        assert_eq!((of("hour"), of("day")), (360, 1440), "{series:?}");
    }
    let requests = history["hour"]["requests"].as_array().unwrap();
    assert_eq!(
        requests[352..],
        [
            json!(null),
            json!(2.5),
            json!(2.5),
            json!(2.5),
            json!(2.5),
            json!(2.5),
            json!(2.5),
            json!(2.5)
        ]
    );
    assert_eq!(history["day"]["median_seconds"][1439], json!(null), "nobody answered");
    for (node, letter) in [("1", 'a'), ("33", 'n')] {
        let states = history["nodes"][node].as_str().unwrap();
        assert_eq!(states, format!("{}{letter}", "-".repeat(1439)));
    }
    assert!(server.get("/api/v1/history").json().get("nodes").is_none());
    assert_eq!(server.get("/api/v1/history?net=none").status, 404);

    let mut stream = server.connect();
    let headers = "host: localhost\r\naccept-encoding: gzip";
    write!(stream, "GET {path} HTTP/1.0\r\n{headers}\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let body = answer.windows(4).position(|octets| octets == b"\r\n\r\n").unwrap() + 4;
    assert!(String::from_utf8_lossy(&answer[..body]).contains("content-encoding: gzip"));
    assert!(answer.len() < 8 * 1024, "{} octets", answer.len());
    let mut text = String::new();
    flate2::read::GzDecoder::new(&answer[body..]).read_to_string(&mut text).unwrap();
    let mut unpacked: Value = serde_json::from_str(&text).unwrap();
    unpacked["now"].take();
    assert_eq!(unpacked, history);
}

#[test]
fn nets_come_one_by_one_and_without_nodes_when_so_asked() {
    let server = Server::start(Router::idle(config(), 1));
    let one = server.get("/api/v1/nets?net=press").json();
    assert_eq!(one["nets"].as_array().unwrap().len(), 1);
    assert_eq!(one["nets"][0]["nodes"][0]["node"], 7);
    let summary = server.get("/api/v1/nets?nodes=false").json();
    for net in summary["nets"].as_array().unwrap() {
        assert!(net.get("nodes").is_none() && net["never_asked_nodes"].as_u64() > Some(0), "{net}");
    }
    assert_eq!(server.get("/api/v1/nets?net=none").status, 404);
    assert_eq!(server.get("/api/v1/nets?nodes=maybe").status, 400);
}

#[test]
fn the_page_has_its_files_and_names_no_other_site() {
    let server = Server::start(Router::idle(config(), 1));
    for (path, content_type) in [
        ("/", "text/html; charset=utf-8"),
        ("/status.js", "text/javascript; charset=utf-8"),
        ("/status.css", "text/css; charset=utf-8"),
        ("/status.svg", "image/svg+xml"),
    ] {
        let file = server.get(path);
        assert_eq!((file.status, file.content_type.as_str()), (200, content_type), "{path}");
        let text = file.text.replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains("//www") && !text.contains("http:") && !text.contains("https:"));
    }
}

/// With whatever is answered, refused or not found.
#[test]
fn every_answer_says_that_it_is_for_nobody_else() {
    let server = Server::start(Router::idle(config(), 1));
    for (path, headers) in [
        ("/", &[][..]),
        ("/status.js", &[]),
        ("/metrics", &[]),
        ("/api/v1/flows", &[]),
        ("/api/v1/refused", &[]),
        ("/-/ready", &[]),
        ("/none", &[]),
        ("/api/v1/config", &[("host", "evil.example")]),
    ] {
        let answer = server.ask_with("GET", path, headers);
        for (name, value) in [
            ("cross-origin-resource-policy", "same-origin"),
            ("cache-control", "no-store"),
            ("x-content-type-options", "nosniff"),
            ("referrer-policy", "no-referrer"),
        ] {
            assert_eq!(answer.headers[name], value, "{name} of {path}");
        }
        let policy = answer.headers["content-security-policy"].to_str().unwrap();
        assert!(policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"));
    }
}

#[test]
fn drop_reasons_are_explained() {
    let reasons = Server::start(Router::idle(config(), 1)).get("/api/v1/drop-reasons").json();
    assert_eq!(reasons.as_object().unwrap().len(), DropReason::COUNT + 4);
    assert_eq!(reasons["password_wrong"], DropReason::PasswordWrong.explanation());
    for (cause, _) in crate::datapath::KernelDrops::default().by_cause() {
        for name in [format!("kernel: {cause}"), format!("kernel: upstream {cause}")] {
            assert!(reasons[&name].is_string(), "{name}");
        }
    }
}

#[test]
fn flows_and_configuration_have_their_shape() {
    let server = Server::start(Router::idle(config(), 1));
    let flows = server.get("/api/v1/flows?limit=5&net=section-1").json();
    let credential = |name| json!({ "net": "section-1", "credential": name, "accepted_requests": 0, "flows": 0 });
    let credentials = [credential("service"), credential("team-b")];
    assert_eq!(flows, json!({ "flows": [], "credentials": credentials, "complete": true }));
    assert_eq!(server.get("/api/v1/flows?net=absent").status, 404);
    let config = server.get("/api/v1/config").json();
    assert_eq!(config["header"], "02000000");
    assert_eq!(config["nets"][0]["nodes"][1]["public_port"], 20033);
    assert_eq!(config["nets"][1]["allow_without_password"], true);
    assert_eq!(config["wrong_password_address_burst"], 5120);
    assert_eq!(config["wrong_password_interval_seconds"], 60.0);
    assert_eq!(config["workers"], Value::Null);
    assert_eq!(config["admin_listen"], "127.0.0.1:9378");
    assert_eq!(config["admin_has_token"], false);
    assert_eq!(config["metrics_without_token"], false);
}

#[test]
fn no_answer_holds_a_password_in_any_writing() {
    let server = Server::start(Router::idle(config(), 1));
    for (path, _) in ROUTES.into_iter().chain([("/none", "")]) {
        let text = server.get(path).text.to_lowercase();
        for written in PASSWORDS.iter().flat_map(writings) {
            assert!(!text.contains(&written), "{path} shows {written}");
        }
    }
}

/// A password as text, hexadecimal, base64 and lists of octets, in lower case.
fn writings(password: &[u8; 8]) -> [String; 6] {
    let join = |separator: &str, octet: fn(&u8) -> String| {
        password.iter().map(octet).collect::<Vec<_>>().join(separator)
    };
    [
        String::from_utf8_lossy(password).to_lowercase(),
        join("", |octet| format!("{octet:02x}")),
        join(" ", |octet| format!("{octet:02x}")),
        join(",", u8::to_string),
        join(", ", u8::to_string),
        base64(password).to_lowercase(),
    ]
}

/// Base64 without the padding, whose last digit an encoder may write otherwise.
fn base64(octets: &[u8; 8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let bits = u64::from_be_bytes(*octets);
    (0..10).map(|digit| char::from(DIGITS[(bits >> (58 - 6 * digit)) as usize % 64])).collect()
}

#[test]
fn base64_is_base64() {
    assert_eq!(base64(b"PNETPASS"), "UE5FVFBBU1");
}

#[test]
fn a_client_that_says_nothing_is_cut_off() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut silent = server.connect();
    silent.write_all(b"GET /-/healthy HTTP/1.1\r\nhost:").unwrap();
    let mut answer = Vec::new();
    let _ = silent.read_to_end(&mut answer);
    assert!(!answer.starts_with(b"HTTP/1.1 200"));
    assert!(began.elapsed() >= HEADER_TIME && began.elapsed() < STILL_TIME);
}

#[test]
fn a_request_without_end_is_refused() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut endless = server.connect();
    let line = [b"GET /".as_slice(), &[b'a'; 4 * BUFFER]].concat();
    let _ = endless.write_all(&line);
    let mut answer = String::new();
    let _ = endless.read_to_string(&mut answer);
    assert!(began.elapsed() < HEADER_TIME, "it was refused for its length, not for its time");
    let refused = ["", "HTTP/1.1 414 ", "HTTP/1.1 431 "];
    assert!(refused.contains(&&answer[..answer.len().min(13)]), "{answer}");
}

/// Not even a client who says a little again and again.
#[test]
fn a_client_that_drips_is_cut_off() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut slow = server.connect();
    slow.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    slow.write_all(b"GET /-/healthy HTTP/1.1\r\n").unwrap();
    let is_cut = |slow: &mut TcpStream| match slow.read(&mut [0; 1024]) {
        Ok(octets) => octets == 0,
        Err(error) => error.kind() != io::ErrorKind::WouldBlock,
    };
    while !is_cut(&mut slow) {
        assert!(began.elapsed() < STILL_TIME, "it is not cut off");
        let _ = slow.write_all(b"a: b\r\n");
    }
    assert!(began.elapsed() >= HEADER_TIME);
}

#[test]
fn headers_without_end_are_refused() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut endless = server.connect();
    endless.write_all(b"GET /-/healthy HTTP/1.1\r\n").unwrap();
    while endless.write_all(b"a: 0123456789012345678901234567890123456789\r\n").is_ok() {}
    assert!(began.elapsed() < HEADER_TIME, "it was refused for its length, not for its time");
}

#[test]
fn a_body_without_end_is_not_read() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut endless = server.connect();
    endless
        .write_all(
            b"POST /metrics HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n",
        )
        .unwrap();
    while endless.write_all(&[b"400\r\n".as_slice(), &[b'a'; 1024], b"\r\n"].concat()).is_ok() {}
    assert!(began.elapsed() < HEADER_TIME);
}

#[test]
fn silent_connections_beyond_the_bound_are_cut_and_newcomers_answered() {
    let server = Server::start(Router::idle(config(), 1));
    let began = Instant::now();
    let mut silent: Vec<_> = (0..2 * connections::MOST).map(|_| server.connect()).collect();
    assert_eq!(server.get("/-/healthy").status, 200);
    assert!(began.elapsed() < HEADER_TIME, "it waited for those that are silent");
    for cut in &mut silent[..connections::MOST] {
        let _ = cut.read(&mut [0]); // an end or an error, but no waiting for the header time
    }
    assert!(began.elapsed() < HEADER_TIME, "there was no bound");
}

#[test]
fn every_answer_tells_browsers_to_keep_to_this_site() {
    let server = Server::start(Router::idle(config(), 1));
    for path in ["/", "/metrics", "/api/v1/nets", "/-/ready", "/none"] {
        let headers = server.get(path).headers;
        let policy = headers["content-security-policy"].to_str().unwrap();
        for directive in ["default-src 'self'", "frame-ancestors 'none'"] {
            assert!(policy.split("; ").any(|found| found == directive), "{path}: {policy}");
        }
        assert_eq!(headers["x-content-type-options"], "nosniff", "{path}");
        assert_eq!(headers["referrer-policy"], "no-referrer", "{path}");
    }
}

#[test]
fn a_token_is_asked_for_when_there_is_one() {
    let mut config = config();
    let token = Some(Token::new(b"0123456789abcdef").unwrap());
    config.admin = Some(Admin { token, ..config.admin.unwrap() });
    let server = Server::start(Router::idle(config, 1));
    for (path, _) in ROUTES.into_iter().chain([("/none", "")]) {
        let refused = server.get(path);
        if ["/-/healthy", "/-/ready", "/"].contains(&path) {
            assert_ne!(refused.status, 401, "{path}");
            continue;
        }
        assert_eq!(refused.status, 401, "{path}");
        assert_eq!(refused.headers["www-authenticate"], "Bearer realm=\"pnet-nat\"");
        assert!(!refused.text.contains("0123456789abcdef"));
        let bearer = ("authorization", "Bearer 0123456789abcdef");
        assert_ne!(server.ask_with("GET", path, &[bearer]).status, 401, "{path}");
    }
}

#[test]
fn status_tells_how_the_process_is_confined() {
    let server = Server::start(Router::idle(config(), 1));
    let status = server.get("/api/v1/status").json();
    assert_eq!(status["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(status["commit"].as_str().unwrap_or_default(), crate::COMMIT);
    assert_eq!((&status["ready"], &status["title"]), (&json!(false), &json!(null)));
    assert_eq!(status["reload"]["successful"], true);
    assert_eq!(status["public_ports"], 3);
    assert_eq!(status["stray_responses"]["received_datagrams"], 0);
    let upstream = &status["upstream_kernel_dropped_datagrams"];
    assert_eq!(*upstream, json!({ "overflow": 0, "prefilter": 0 }));
    assert!(status["uptime_seconds"].as_f64().unwrap() >= 0.0);
    let layers = ["memory", "no_new_privs", "capabilities", "landlock", "seccomp"];
    let off = layers.map(|layer| json!({ "layer": layer, "state": "off", "why": "in a test" }));
    assert_eq!(status["sandbox"], json!(off));
}

#[test]
fn status_tells_why_the_kernel_carries_no_flows() {
    let server = Server::start(Router::idle(config(), 1));
    let offload = &server.get("/api/v1/status").json()["offload"];
    let why = "[datapath] kernel = \"off\"";
    assert_eq!(*offload, json!({ "state": "off", "why": why, "flows": 0, "interfaces": [] }));
}

#[test]
fn stopping_does_not_wait_for_a_client_that_does_not_read() {
    let server = Server::start(Router::idle(config(), 1));
    let _silent = server.connect();
    assert_eq!(server.get("/-/healthy").status, 200);
    let began = Instant::now();
    drop(server);
    assert!(began.elapsed() < GRACE + Duration::from_millis(900), "{:?}", began.elapsed());
}
