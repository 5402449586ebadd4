//! 300 clients that poll 20 nodes without end. An answer tells which relay asked the node.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use crate::harness::{FIGURE_10, Over, PASSWORD, Peer, datagram, eventually, pause};

use super::site::{NODES, PUBLIC, START_PORT, Site};

pub(super) const CLIENTS: usize = 300;
/// How often a client asks.
const INTERVAL: Duration = Duration::from_millis(200);
/// How long a client waits for an answer before it asks again.
pub(super) const TIME_OUT: Duration = Duration::from_secs(1);
/// How long a socket waits before it looks whether all is over.
const LOOK: Duration = Duration::from_millis(200);
/// What is in front of the data octets of a request, and behind them.
const FRONT: usize = 14;
const BEHIND: usize = PASSWORD.len();

/// A request of a client, and when and by which relay it was answered.
struct Request {
    sent: Instant,
    answer: Option<(Instant, u8)>,
}

impl Request {
    /// Whether the client gave up before the answer came.
    fn is_lost(&self) -> bool {
        self.answer.is_none_or(|(came, _)| came - self.sent > TIME_OUT)
    }
}

struct Client {
    socket: Peer,
    node: u8,
    requests: Mutex<Vec<Request>>,
}

/// All clients, and the nodes that they poll.
pub(super) struct Clients {
    clients: Vec<Client>,
    nodes: Vec<(u8, Peer)>,
    over: AtomicBool,
}

impl Clients {
    pub(super) fn new(site: &Site) -> Self {
        let clients = site.internet.enter(|| {
            let client = |index: usize| {
                let address = IpAddr::from([203, 0, 113, 10 + (index / 15) as u8]);
                let node = 1 + index as u8 % NODES;
                Client { socket: Peer::bind((address, 0).into()), node, requests: Mutex::default() }
            };
            (0..CLIENTS).map(client).collect()
        });
        let nodes = site.plant.enter(|| {
            let address = |node| SocketAddr::from(([172, 17, 17, node], 34379));
            (1..=NODES).map(|node| (node, Peer::bind(address(node)))).collect()
        });
        Self { clients, nodes, over: AtomicBool::new(false) }
    }

    /// Has them ask for as long as the scenario takes.
    pub(super) fn during(&self, scenario: impl FnOnce()) {
        thread::scope(|scope| {
            let _over = Over(&self.over);
            for (node, socket) in &self.nodes {
                scope.spawn(|| serve(*node, socket, &self.over));
            }
            for client in &self.clients {
                scope.spawn(|| client.poll(&self.over));
            }
            scenario();
        });
    }

    /// Waits until each client was answered that asked from now on, and every one again.
    #[track_caller]
    pub(super) fn expect_answers(&self) {
        let now = Instant::now();
        eventually("every client is answered again", || {
            self.clients.iter().all(|client| client.answers_since(now) >= 2).then_some(())
        });
    }

    /// The relay that answered each client last.
    pub(super) fn relays(&self) -> Vec<u8> {
        let last = |client: &Client| {
            let requests = client.requests();
            requests.iter().rev().find_map(|request| request.answer).map_or(0, |(_, relay)| relay)
        };
        self.clients.iter().map(last).collect()
    }

    /// How many requests since then got no answer in time, but perhaps a late one.
    pub(super) fn lost_since(&self, begun: Instant) -> usize {
        let of_client = |client: &Client| {
            let requests = client.requests();
            // The last one is still waited for.
            let earlier = requests.len().saturating_sub(1);
            let since = requests[..earlier].iter().filter(|request| request.sent >= begun);
            since.filter(|request| request.is_lost()).count()
        };
        self.clients.iter().map(of_client).sum()
    }

    /// Each request of this time until now is answered in the end. On a busy machine that may take longer than a client waits.
    #[track_caller]
    pub(super) fn expect_none_lost(&self, begun: Instant) {
        let now = Instant::now();
        let is_open =
            |request: &Request| (begun..now).contains(&request.sent) && request.answer.is_none();
        eventually("no request is lost", || {
            let mut clients = self.clients.iter();
            clients.all(|client| !client.requests().iter().any(is_open)).then_some(())
        });
    }
}

impl Client {
    fn poll(&self, over: &AtomicBool) {
        let public = SocketAddr::new(PUBLIC.parse().unwrap(), START_PORT + u16::from(self.node));
        // They do not all ask at once.
        pause(INTERVAL * u32::from(self.node) / u32::from(NODES));
        while !over.load(Relaxed) {
            let number = self.requests().len();
            let mut route = FIGURE_10;
            route[1] = self.node;
            let sent = Instant::now();
            self.requests().push(Request { sent, answer: None });
            self.socket.send(public, &datagram(&route, &(number as u32).to_be_bytes(), PASSWORD));
            while self.requests()[number].answer.is_none() && sent.elapsed() < TIME_OUT {
                let left = TIME_OUT.saturating_sub(sent.elapsed()).max(Duration::from_millis(1));
                let Some((octets, from)) = self.socket.receive_within(left) else { break };
                assert_eq!(from, public, "who answers");
                // The route of an answer has one octet more.
                self.note(&octets[FRONT + 1..octets.len() - BEHIND]);
            }
            pause(INTERVAL.saturating_sub(sent.elapsed()));
        }
    }

    /// Takes an answer's data octets: the number of the request, and the relay that the node saw.
    fn note(&self, data: &[u8]) {
        let (number, relay) = data.split_first_chunk().expect("a number");
        let request = u32::from_be_bytes(*number) as usize;
        let answer = &mut self.requests()[request].answer;
        assert!(answer.is_none(), "two answers to one request");
        *answer = Some((Instant::now(), relay[0]));
    }

    fn requests(&self) -> MutexGuard<'_, Vec<Request>> {
        self.requests.lock().unwrap()
    }

    fn answers_since(&self, begun: Instant) -> usize {
        let requests = self.requests();
        let since = requests.iter().rev().take_while(|request| request.sent >= begun);
        since.filter(|request| request.answer.is_some()).count()
    }
}

/// A node that sends the data octets back, and the last octet of who asked.
fn serve(node: u8, socket: &Peer, over: &AtomicBool) {
    let way_back = [0x0B, 0x03, 0x06, 0x1F, 0x8B, 0x80 | node, 0x82, 0xA1, 0x80];
    while !over.load(Relaxed) {
        let Some((octets, from)) = socket.receive_within(LOOK) else { continue };
        let SocketAddr::V4(relay) = from else { panic!("{from}") };
        let mut data = octets[FRONT..octets.len() - BEHIND].to_vec();
        data.push(relay.ip().octets()[3] - 250);
        socket.send(from, &datagram(&way_back, &data, PASSWORD));
    }
}

/// How many clients each relay has.
pub(super) fn shares(relays: &[u8]) -> BTreeMap<u8, usize> {
    let mut shares = BTreeMap::new();
    for relay in relays {
        *shares.entry(*relay).or_default() += 1;
    }
    shares
}
