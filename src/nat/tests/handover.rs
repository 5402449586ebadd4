//! What holds while workers go over to a new configuration, one after the other and their flows a
//! few at a time.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::pnet::wire::{DlRoute, Header, Password};

use crate::nat::*;

const PASSWORD: &[u8; 8] = b"service!";
const SERVER: &str = "172.17.17.4:34379";

/// Sockets without end, and what is told of flows.
#[derive(Default)]
struct Sockets {
    closed: Vec<(u16, CloseReason)>,
    closed_sockets: Vec<UpstreamId>,
}

impl Effects for Sockets {
    fn open_upstream(&mut self, id: UpstreamId, _: NetId, _: bool) -> Option<u16> {
        Some(50_000 + id.0 as u16)
    }

    fn close_upstream(&mut self, id: UpstreamId) {
        self.closed_sockets.push(id);
    }

    fn flow_opened(&mut self, _: &Table, _: &FlowRecord) {}

    fn flow_closed(&mut self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        self.closed.push((table.mapping(flow.mapping).public_port, reason));
    }
}

/// What differs between the configurations.
#[derive(Clone, Copy)]
struct Site {
    max_flows: u32,
    max_requests: Option<u32>,
    password: &'static [u8; 8],
    public_port: u16,
    /// That of another node.
    other_port: u16,
}

const SITE: Site = Site {
    max_flows: 100,
    max_requests: None,
    password: PASSWORD,
    public_port: 40_004,
    other_port: 40_005,
};

impl Site {
    fn table(self) -> Arc<Table> {
        let net = Net {
            name: "section-1".into(),
            kind: NetKind::Server,
            allow: vec!["0.0.0.0/0".parse().unwrap()],
            credentials: vec![Credential {
                name: "service".into(),
                password: Password::new(*self.password),
                device_password: None,
            }],
            allow_without_password: false,
            require_response_password: false,
            idle_timeout: Duration::from_secs(300),
            max_flows: self.max_flows,
            max_requests: self.max_requests.map(RequestRate::new),
            max_flow_requests: None,
        };
        let mapping = Mapping {
            net: NetId(0),
            node_address: 4,
            public_port: self.public_port,
            server: SERVER.parse().unwrap(),
        };
        let other = Mapping {
            node_address: 5,
            public_port: self.other_port,
            server: "172.17.17.5:34379".parse().unwrap(),
            ..mapping
        };
        Arc::new(Table::new(Header::default(), vec![net], vec![mapping, other]))
    }

    fn limits(self) -> Limits {
        Limits {
            max_flows: 1000,
            wrong_password_burst: 100,
            wrong_password_address_burst: 10_000,
            wrong_password_interval: Duration::from_secs(1),
        }
    }
}

struct Worker {
    core: Core,
    counters: Arc<Counters>,
    sockets: Sockets,
}

/// Workers that share their rules.
struct Router {
    now: Instant,
    rules: Rules,
    workers: Vec<Worker>,
}

impl Router {
    fn new(workers: usize, site: Site) -> Self {
        let now = Instant::now();
        let rules = Rules::new(site.table(), site.limits());
        let worker = |seed| {
            let counters = Arc::new(Counters::new(&rules.table));
            let chance = Chance::from_seed(seed);
            let core = Core::new(rules.clone(), Arc::clone(&counters), now, chance);
            Worker { core, counters, sockets: Sockets::default() }
        };
        let workers = (0..workers as u64).map(worker).collect();
        Self { now, rules, workers }
    }

    /// What each worker is to go over to.
    fn next(&mut self, site: Site, gone: &[ListenerId]) -> Vec<Succession> {
        let rules = self.rules.followed_by(site.table(), site.limits());
        let gone: BTreeSet<_> = gone.iter().copied().collect();
        let transition = Arc::new(Transition::new(&self.rules, &rules, gone));
        let before = std::mem::replace(&mut self.rules, rules);
        let succession = |worker: &Worker| {
            let counters = worker.counters.followed_by(&before.table, &self.rules.table);
            Succession {
                rules: self.rules.clone(),
                counters: Arc::new(counters),
                transition: Arc::clone(&transition),
            }
        };
        self.workers.iter().map(succession).collect()
    }

    fn go_over(&mut self, worker: usize, next: Succession) {
        let Worker { core, counters, sockets } = &mut self.workers[worker];
        *counters = Arc::clone(&next.counters);
        core.reload(self.now, next, sockets);
    }

    /// A request to the public port.
    fn request(
        &mut self,
        worker: usize,
        client: u16,
        password: &[u8; 8],
    ) -> Result<ToServer, DropReason> {
        let route = DlRoute::new(&[11, 4, 2], &[11, 3]).unwrap().to_route().unwrap();
        let mut octets = Header::default().0.to_vec();
        octets.extend(route.as_route().as_bytes());
        octets.extend([0x02, 0]);
        octets.extend(password);
        let arrival = Arrival {
            listener: ListenerId(0),
            mapping: MappingId(0),
            public_address: "192.0.2.1".parse().unwrap(),
            client: SocketAddr::new("198.51.100.7".parse().unwrap(), client),
        };
        let Worker { core, sockets, .. } = &mut self.workers[worker];
        let to = core.request(self.now, &arrival, &mut octets, sockets)?;
        core.request_sent(self.now, MappingId(0), to.asks, octets.len());
        Ok(to)
    }

    fn answer(&mut self, worker: usize, to: ToServer) -> Result<ToClient, DropReason> {
        let route = DlRoute::new(&[3, 2], &[4, 11]).unwrap().to_route().unwrap();
        let mut octets = Header::default().0.to_vec();
        octets.extend(route.as_route().as_bytes());
        octets.extend([0x02, 0]);
        self.workers[worker].core.response(self.now, to.via, to.server, &mut octets)
    }

    /// Whether sockets are about to be closed and are not yet.
    fn close_left(&mut self, worker: usize) -> bool {
        let Worker { core, sockets, .. } = &mut self.workers[worker];
        loop {
            let before = core.leaving.len();
            let others = core.close_left(self.now, sockets);
            core.check_invariants(self.now);
            if core.leaving.len() == before {
                return others;
            }
        }
    }

    fn flows(&self, worker: usize) -> usize {
        self.workers[worker].core.flows(self.now).count()
    }

    /// Goes over to the end, and tells how many flows that closed and in how many steps.
    fn settle(&mut self, worker: usize) -> (usize, usize) {
        let Worker { core, sockets, .. } = &mut self.workers[worker];
        let mut steps = 1;
        loop {
            core.check_invariants(self.now);
            match core.go_over(self.now, sockets) {
                Some(closed) => return (closed, steps),
                None => steps += 1,
            }
        }
    }
}

#[test]
fn the_flow_limit_holds_while_one_worker_goes_over_after_the_other() {
    let mut router = Router::new(2, SITE);
    for client in 1..=50 {
        router.request(0, client, PASSWORD).unwrap();
        router.request(1, 100 + client, PASSWORD).unwrap();
    }
    let mut next = router.next(SITE, &[]).into_iter();
    router.go_over(0, next.next().unwrap());
    let full = Err(DropReason::FlowLimit);
    assert_eq!(router.request(0, 1000, PASSWORD), full, "the other worker's flows count");
    router.settle(0);
    assert_eq!(router.request(0, 1000, PASSWORD), full);
    assert_eq!(router.request(1, 1000, PASSWORD), full, "under the old rules as well");
    router.go_over(1, next.next().unwrap());
    router.settle(1);
    assert_eq!(router.request(1, 1000, PASSWORD), full);

    // What is given up is free for both.
    let now = router.now;
    let Worker { core, sockets, .. } = &mut router.workers[0];
    core.shut_down(now, sockets);
    for client in 1..=50 {
        router.request(1, 2000 + client, PASSWORD).unwrap();
    }
    assert_eq!(router.request(1, 3000, PASSWORD), full);
}

#[test]
fn a_lower_limit_closes_nothing_and_holds_for_new_flows() {
    let mut router = Router::new(1, SITE);
    (1..=10).for_each(|client| _ = router.request(0, client, PASSWORD).unwrap());
    let next = router.next(Site { max_flows: 5, ..SITE }, &[]).remove(0);
    router.go_over(0, next);
    assert_eq!(router.request(0, 11, PASSWORD), Err(DropReason::FlowLimit));
    assert_eq!(router.settle(0).0, 0);
    (1..=10).for_each(|client| _ = router.request(0, client, PASSWORD).unwrap());
}

#[test]
fn a_reload_gives_a_net_no_requests() {
    let site = Site { max_requests: Some(5), ..SITE };
    let mut router = Router::new(1, site);
    (0..5).for_each(|_| _ = router.request(0, 1, PASSWORD).unwrap());
    for max_requests in [5, 500, 5] {
        let site = Site { max_requests: Some(max_requests), ..SITE };
        let next = router.next(site, &[]).remove(0);
        router.go_over(0, next);
        router.settle(0);
        assert_eq!(router.request(0, 1, PASSWORD), Err(DropReason::RequestLimit));
    }
    router.now += Duration::from_millis(201);
    router.request(0, 1, PASSWORD).unwrap();
    assert_eq!(router.request(0, 1, PASSWORD), Err(DropReason::RequestLimit));
}

#[test]
fn what_is_withdrawn_is_so_at_once_and_closed_in_its_turn() {
    let mut router = Router::new(1, SITE);
    let opened: Vec<_> =
        (1..=10).map(|client| router.request(0, client, PASSWORD).unwrap()).collect();
    let next = router.next(Site { password: b"another!", ..SITE }, &[]).remove(0);
    router.go_over(0, next);
    assert_eq!(router.flows(0), 0, "none is shown");
    assert!(!router.workers[0].core.awaits_answers(router.now), "nor waited for");
    assert_eq!(router.answer(0, opened[9]), Err(DropReason::UnknownFlow));
    assert_eq!(router.request(0, 3, PASSWORD), Err(DropReason::PasswordWrong));
    router.request(0, 4, b"another!").unwrap();
    assert_eq!(router.flows(0), 1);

    let (closed, steps) = router.settle(0);
    assert_eq!(closed, 10, "those that a request found first are among them");
    assert!(steps >= 4, "a few at a time, not in {steps} steps");
    let Worker { sockets, counters, .. } = &router.workers[0];
    assert_eq!(sockets.closed, vec![(40_004, CloseReason::PasswordWithdrawn); 10]);
    assert_eq!(counters.net(NetId(0)).flows_closed(CloseReason::PasswordWithdrawn).get(), 10);
    assert_eq!((counters.net(NetId(0)).flows.get(), router.flows(0)), (1, 1));
}

/// The socket in a place may be another one than before, for another port.
#[test]
fn a_flow_does_not_move_to_a_socket_that_took_the_place_of_its_own() {
    let mut router = Router::new(1, SITE);
    let to = router.request(0, 1, PASSWORD).unwrap();
    let next = router.next(Site { public_port: 50_004, ..SITE }, &[ListenerId(0)]).remove(0);
    router.go_over(0, next);
    assert_eq!((router.flows(0), router.answer(0, to)), (0, Err(DropReason::UnknownFlow)));
    router.request(0, 1, PASSWORD).unwrap();
    assert_eq!(router.settle(0).0, 1);
    assert_eq!(router.workers[0].sockets.closed, [(40_004, CloseReason::MappingRemoved)]);
    assert_eq!(router.flows(0), 1);
}

/// A public port comes before one of the relay's own: clients are given other ones. But whatever is on
/// its way to the old one comes in, and later ones find it closed.
#[test]
fn the_last_answers_come_in_over_a_port_that_is_wanted() {
    let mut router = Router::new(1, Site { max_flows: 4, ..SITE });
    let asked: Vec<_> =
        (1..=4).map(|client| router.request(0, client, PASSWORD).unwrap()).collect();
    let (wanted, silent) = (asked[0], asked[1]);
    assert_eq!((wanted.via, silent.via), (UpstreamId(0), UpstreamId(1)));
    let site = Site { max_flows: 4, other_port: 50_000, ..SITE };
    for (number, other_port) in [(0, 50_000), (1, 50_001)] {
        let next = router.next(Site { other_port, ..site }, &[]).remove(0);
        router.go_over(0, next);
        router.answer(0, asked[2]).unwrap(); // brings its flow over before its turn
        let again = router.request(0, 1, PASSWORD).unwrap();
        assert_eq!(again.via == wanted.via, number == 0, "before its turn");
        assert_eq!(router.settle(0).0, 1);
        assert_eq!(router.workers[0].sockets.closed.len(), number + 1);
        assert_eq!(router.flows(0), 3);
        let to = router.request(0, number as u16 + 1, PASSWORD).unwrap();
        assert_eq!(to.via.0 as usize, 4 + number, "another port; and the flow limit holds");
        assert_eq!(router.flows(0), 4);
        assert!(router.close_left(0), "an answer is due");
        assert_eq!(router.workers[0].sockets.closed_sockets.len(), number);
        if number == 0 {
            for _ in 0..2 {
                assert!(router.close_left(0), "another answer is due");
                assert_eq!(router.answer(0, wanted).unwrap().client.port(), 1);
            }
            assert!(router.workers[0].core.awaits_answers(router.now), "the others");
        } else {
            router.now += Duration::from_secs(2);
        }
        assert!(!router.close_left(0), "nothing is in the way any more");
        assert_eq!(router.workers[0].sockets.closed_sockets[number].0 as usize, number);
        for to in &asked[..=number] {
            assert_eq!(router.answer(0, *to), Err(DropReason::UnknownFlow));
        }
    }
    let closed = &router.workers[0].sockets.closed;
    assert_eq!(*closed, [(40_004, CloseReason::PortWanted); 2], "and each is told of once");
}

#[test]
fn what_is_withdrawn_gets_no_last_answers() {
    let mut router = Router::new(1, SITE);
    let to = router.request(0, 1, PASSWORD).unwrap();
    let site = Site { other_port: 50_000, ..SITE };
    let next = router.next(site, &[]).remove(0);
    router.go_over(0, next);
    assert_eq!(router.settle(0).0, 1);
    let next = router.next(Site { password: b"another!", ..site }, &[]).remove(0);
    router.go_over(0, next);
    assert_eq!(router.answer(0, to), Err(DropReason::UnknownFlow));
    assert_eq!(router.settle(0).0, 0, "it was closed by the first");
    assert!(!router.close_left(0));
    assert_eq!(router.workers[0].sockets.closed, [(40_004, CloseReason::PortWanted)]);
}

#[test]
fn a_reload_on_top_of_another_finishes_it_first() {
    let mut router = Router::new(1, SITE);
    (1..=10).for_each(|client| _ = router.request(0, client, PASSWORD).unwrap());
    for password in [b"another!", PASSWORD] {
        let next = router.next(Site { password, ..SITE }, &[]).remove(0);
        router.go_over(0, next);
    }
    assert_eq!((router.flows(0), router.settle(0).0), (0, 0), "all were closed by the first");
    assert_eq!(router.workers[0].sockets.closed.len(), 10);
}

/// What is counted goes on, and the worker's figures are those that others read meanwhile.
#[test]
fn counters_go_on() {
    let mut router = Router::new(1, SITE);
    let to = router.request(0, 1, PASSWORD).unwrap();
    router.answer(0, to).unwrap();
    router.request(0, 2, b"guessed!").unwrap_err();
    let before = Arc::clone(&router.workers[0].counters);
    let next = router.next(SITE, &[]).remove(0);
    router.go_over(0, next);
    router.request(0, 1, PASSWORD).unwrap();
    let after = &router.workers[0].counters;
    for counters in [&before, after] {
        assert_eq!(counters.accepted(NetId(0))[0].get(), 2);
        assert_eq!(counters.net(NetId(0)).flows_opened.get(), 1);
        assert_eq!(counters.node(MappingId(0)).direction(Direction::Request).received.get(), 3);
        let sources = counters.net(NetId(0)).sources(DropReason::PasswordWrong);
        assert_eq!(SourceSketch::estimate([sources].into_iter()), 1, "who was refused");
    }
}
