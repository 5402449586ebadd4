//! What holds while workers go over to a new configuration: one worker after the other, and each
//! with a few flows at a time.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;

/// What differs between the configurations.
#[derive(Clone, Copy)]
struct Site {
    max_flows: u32,
    max_requests: Option<u32>,
    password: &'static [u8; 8],
    public_port: u16,
    /// The public port of another node.
    other_port: u16,
}

const SITE: Site = Site {
    max_flows: 100,
    max_requests: None,
    password: PASSWORD,
    public_port: 20_004,
    other_port: 20_005,
};

impl Site {
    fn table(self) -> Arc<Table> {
        let net = Net {
            credentials: vec![credential("service", self.password, None)],
            max_flows: self.max_flows,
            max_requests: self.max_requests.map(RequestRate::new),
            ..net()
        };
        let node = Mapping { public_port: self.public_port, ..node_4() };
        table(vec![net], vec![node, mapping(0, 5, self.other_port, "172.17.17.5:34379")])
    }
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
        let rules = Rules::new(site.table(), LIMITS);
        let worker = |seed| Worker::new(&rules, now, seed, Sockets::default());
        let workers = (0..workers as u64).map(worker).collect();
        Self { now, rules, workers }
    }

    /// What each worker has to go over to.
    fn next(&mut self, site: Site, gone: &[ListenerId]) -> Vec<Succession> {
        self.rules = self.rules.followed_by(site.table(), LIMITS);
        let gone: BTreeSet<_> = gone.iter().copied().collect();
        self.workers.iter().map(|worker| worker.succession(&self.rules, &gone)).collect()
    }

    fn go_over(&mut self, worker: usize, next: Succession) {
        self.workers[worker].reload(self.now, next);
    }

    /// A request to the public port.
    fn request(
        &mut self,
        worker: usize,
        client: u16,
        password: &[u8; 8],
    ) -> Result<ToServer, DropReason> {
        let arrival = arrival(SocketAddr::new("198.51.100.7".parse().unwrap(), client));
        let mut octets = request(password);
        let worker = &mut self.workers[worker];
        let to = worker.request(self.now, &arrival, &mut octets)?;
        worker.core.request_sent(self.now, MappingId(0), to.asks, octets.len());
        Ok(to)
    }

    fn answer(&mut self, worker: usize, to: ToServer) -> Result<ToClient, DropReason> {
        self.workers[worker].response(self.now, to.via, to.server, &mut response(b""))
    }

    /// Closes what can be closed. True while other sockets wait for last answers.
    fn close_left(&mut self, worker: usize) -> bool {
        let Worker { core, effects, .. } = &mut self.workers[worker];
        loop {
            let before = core.leaving.len();
            let others = core.close_left(self.now, effects);
            core.check_invariants(self.now);
            if core.leaving.len() == before {
                return others;
            }
        }
    }

    fn flows(&self, worker: usize) -> usize {
        self.workers[worker].flows(self.now)
    }

    /// Lets all flows go over. Returns how many of them were closed, and the number of steps.
    fn settle(&mut self, worker: usize) -> (usize, usize) {
        let worker = &mut self.workers[worker];
        let mut steps = 1;
        loop {
            worker.core.check_invariants(self.now);
            match worker.go_over(self.now) {
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
    let Worker { core, effects, .. } = &mut router.workers[0];
    core.shut_down(now, effects);
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
    let Worker { effects, counters, .. } = &router.workers[0];
    assert_eq!(effects.closed, vec![(20_004, CloseReason::PasswordWithdrawn); 10]);
    assert_eq!(counters.net(NetId(0)).flows_closed(CloseReason::PasswordWithdrawn).get(), 10);
    assert_eq!((counters.net(NetId(0)).flows.get(), router.flows(0)), (1, 1));
}

/// The socket with the same index may be another one than before, on another port.
#[test]
fn a_flow_does_not_move_to_a_socket_that_took_the_place_of_its_own() {
    let mut router = Router::new(1, SITE);
    let to = router.request(0, 1, PASSWORD).unwrap();
    let next = router.next(Site { public_port: 50_004, ..SITE }, &[ListenerId(0)]).remove(0);
    router.go_over(0, next);
    assert_eq!((router.flows(0), router.answer(0, to)), (0, Err(DropReason::UnknownFlow)));
    router.request(0, 1, PASSWORD).unwrap();
    assert_eq!(router.settle(0).0, 1);
    assert_eq!(router.workers[0].effects.closed, [(20_004, CloseReason::MappingRemoved)]);
    assert_eq!(router.flows(0), 1);
}

/// A port that becomes a public port is given up as an upstream port, and clients get others.
/// Answers that are on their way to the old port still pass; later ones find it closed.
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
        assert_eq!(router.workers[0].effects.closed.len(), number + 1);
        assert_eq!(router.flows(0), 3);
        let to = router.request(0, number as u16 + 1, PASSWORD).unwrap();
        assert_eq!(to.via.0 as usize, 4 + number, "another port; and the flow limit holds");
        assert_eq!(router.flows(0), 4);
        assert!(router.close_left(0), "an answer is due");
        assert_eq!(router.workers[0].effects.closed_sockets.len(), number);
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
        assert_eq!(router.workers[0].effects.closed_sockets[number].0 as usize, number);
        for to in &asked[..=number] {
            assert_eq!(router.answer(0, *to), Err(DropReason::UnknownFlow));
        }
    }
    let closed = &router.workers[0].effects.closed;
    assert_eq!(*closed, [(20_004, CloseReason::PortWanted); 2], "and each is told of once");
}

/// However many there are, they do not wait for a tick for each part of them.
#[test]
fn all_that_wait_for_no_last_answer_are_closed_within_a_tick() {
    let mut router = Router::new(1, Site { max_flows: 9, ..SITE });
    (1..=9).for_each(|client| _ = router.request(0, client, PASSWORD).unwrap());
    let next = router.next(Site { max_flows: 9, ..SITE }, &[]).remove(0);
    router.go_over(0, next);
    router.workers[0].core.upstreams.leave(|_| true); // all of their ports are wanted
    assert_eq!(router.settle(0).0, 9);
    router.now += Duration::from_secs(2);
    let Worker { core, effects, .. } = &mut router.workers[0];
    while core.expire(router.now, effects) {}
    assert!(core.leaving.is_empty(), "{:?}", core.leaving);
    assert_eq!(effects.closed_sockets.len(), 9);
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
    assert_eq!(router.workers[0].effects.closed, [(20_004, CloseReason::PortWanted)]);
}

/// A flow that waited for its last answers is withdrawn, and a flow of another client gets its number
/// and has to leave its port, too.
#[test]
fn the_number_of_a_flow_that_left_can_leave_again() {
    let mut router = Router::new(1, SITE);
    router.request(0, 1, PASSWORD).unwrap();
    for (password, other_port) in [(PASSWORD, 50_000), (b"another!", 50_000), (b"another!", 50_001)]
    {
        let next = router.next(Site { password, other_port, ..SITE }, &[]).remove(0);
        router.go_over(0, next);
        router.settle(0);
        if password != PASSWORD && other_port == 50_000 {
            router.request(0, 2, password).unwrap();
        }
    }
    router.now += Duration::from_secs(2);
    let Worker { core, effects, .. } = &mut router.workers[0];
    while core.expire(router.now, effects) {}
    core.check_invariants(router.now);
    assert_eq!(effects.closed, [(20_004, CloseReason::PortWanted); 2]);
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
    assert_eq!(router.workers[0].effects.closed.len(), 10);
}

/// Counters go on, and readers of the old ones see the same figures.
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
        assert_eq!(SourceSketch::estimate([sources].into_iter()), 1, "how many were refused");
        let refused: Vec<_> = counters.refusals.list().map(|it| (it.refused, it.count)).collect();
        let expected = Refused {
            sender: CLIENT.parse::<SocketAddr>().unwrap().ip(),
            net: net_key("section-1"),
            node: 4,
            direction: Direction::Request,
            reason: DropReason::PasswordWrong,
        };
        assert_eq!(refused, [(expected, 1)]);
    }
}
