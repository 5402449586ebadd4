//! What the attackers of SECURITY.md can do to the core, and what they cannot: one forges source
//! addresses, one has another password of the net, one changes ports.
//!
//! Their datagrams are well formed, so that only the rule under test can refuse them.

use std::net::{SocketAddr, SocketAddrV6};
use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;
use crate::pnet::wire::Password;

const SERVICE: &[u8; 8] = PASSWORD;
const OTHER: &[u8; 8] = b"another!";
const WRONG: &[u8; 8] = b"guessed!";

/// A relay with one net, and the time.
struct World {
    worker: Worker,
    now: Instant,
}

/// The fixture's net with a second password, as `change` makes it.
fn rules(change: impl FnOnce(&mut Net)) -> Rules {
    let mut net = net();
    net.credentials.push(credential("other", OTHER, None));
    change(&mut net);
    let limits = Limits {
        wrong_password_burst: 3,
        wrong_password_address_burst: 6,
        wrong_password_interval: Duration::from_secs(3600),
        ..LIMITS
    };
    Rules::new(table(vec![net], vec![node_4()]), limits)
}

impl World {
    fn new(change: impl FnOnce(&mut Net)) -> Self {
        let now = Instant::now();
        // The system has no route to the one, and would have to broadcast to the other.
        let sockets = Sockets { no_way: &["203.0.113.9", "198.51.100.255"], ..Sockets::default() };
        Self { worker: Worker::new(&rules(change), now, 1, sockets), now }
    }

    /// A request that the relay has not sent yet.
    fn ask_from(
        &mut self,
        client: SocketAddr,
        public: &str,
        password: &[u8; 8],
    ) -> Result<ToServer, DropReason> {
        let arrival = Arrival { public_address: public.parse().unwrap(), ..arrival(client) };
        self.worker.request(self.now, &arrival, &mut request(password))
    }

    fn ask(&mut self, client: &str, password: &[u8; 8]) -> Result<ToServer, DropReason> {
        let client: SocketAddr = client.parse().unwrap();
        let public = if client.is_ipv4() { PUBLIC } else { "2001:db8::1" };
        self.ask_from(client, public, password)
    }

    fn sent(&mut self, to: ToServer) {
        self.worker.core.request_sent(self.now, MappingId(0), to.asks, 24);
    }

    /// What the client receives of an answer of the node.
    fn answer(&mut self, to: ToServer, password: &[u8; 8]) -> Result<Vec<u8>, DropReason> {
        let mut octets = response(password);
        let back = self.worker.response(self.now, to.via, to.server, &mut octets)?;
        assert_eq!(back.client, CLIENT.parse().unwrap());
        Ok(octets)
    }

    /// Puts other rules in force: those of the start with this change.
    fn reload(&mut self, change: impl FnOnce(&mut Net)) {
        let Rules { table, limits, .. } = rules(change);
        let next = self.worker.rules.followed_by(table, limits);
        let next = self.worker.succession(&next, &Default::default());
        self.worker.reload(self.now, next);
    }

    fn flows(&self) -> usize {
        self.worker.flows(self.now)
    }

    fn node(&self) -> &NodeCounters {
        self.worker.counters.node(MappingId(0))
    }
}

#[test]
fn who_forges_a_source_that_no_answer_reaches() {
    let mut world = World::new(|net| net.max_flows = 1);
    let forged = [
        "198.51.100.7:0",
        "0.0.0.0:50000",
        "0.1.2.3:50000",
        "224.0.0.1:50000",
        "239.255.255.255:50000",
        "240.0.0.1:50000",
        "255.255.255.255:50000",
        "198.51.100.255:50000",
        "203.0.113.9:50000",
        "[2001:db8::7]:0",
        "[::]:50000",
        "[ff02::1]:50000",
        "[ff0e::7]:50000",
        "[::ffff:255.255.255.255]:50000",
    ];
    for client in forged {
        assert_eq!(world.ask(client, SERVICE), Err(DropReason::Unanswerable), "{client}");
    }
    assert_eq!(world.flows(), 0);
    assert!(world.ask(CLIENT, SERVICE).is_ok(), "nothing was used up");
    let received = world.node().direction(Direction::Request).received.get();
    assert_eq!(received, forged.len() as u64 + 1);
}

#[test]
fn an_address_of_a_link_is_for_that_link() {
    let mut world = World::new(|_| {});
    let global: SocketAddr = "[2001:db8::7]:50000".parse().unwrap();
    let of_the_link: SocketAddr = SocketAddrV6::new("fe80::7".parse().unwrap(), 50000, 0, 2).into();
    let mut passes = |client, public| world.ask_from(client, public, SERVICE).is_ok();
    assert!(!passes(global, "fe80::1"));
    assert!(passes(of_the_link, "fe80::1"));
    assert!(passes(of_the_link, "2001:db8::1"));
    assert!(passes(global, "2001:db8::1"));
}

/// The system is asked for the route to a client only after a right password, and only once.
#[test]
fn strangers_have_no_way_looked_for() {
    let mut world = World::new(|_| {});
    assert_eq!(world.ask("198.51.100.255:7", WRONG), Err(DropReason::PasswordWrong));
    assert_eq!(world.worker.effects.looked_for, 0);
    (0..3).for_each(|_| assert!(world.ask(CLIENT, SERVICE).is_ok()));
    assert_eq!(world.worker.effects.looked_for, 1);
}

#[test]
fn what_was_not_sent_was_not_asked() {
    let mut world = World::new(|_| {});
    world.ask(CLIENT, SERVICE).unwrap();
    world.worker.core.send_failed(MappingId(0), Direction::Request);
    let asked =
        |world: &World| (world.node().last_request.get(), world.node().unanswered_since.get());
    assert_eq!(asked(&world), (0, 0));
    assert!(!world.worker.core.awaits_answers(world.now), "nothing to wait for at the end");

    // The response time is that of the one that was sent.
    world.now += Duration::from_secs(2);
    let to = world.ask(CLIENT, SERVICE).unwrap();
    world.sent(to);
    assert!(world.worker.core.awaits_answers(world.now));
    assert_ne!(asked(&world), (0, 0));
    world.now += Duration::from_millis(3);
    world.worker.response(world.now, to.via, to.server, &mut response(SERVICE)).unwrap();
    let nanos = world.node().response_times.sum_nanos();
    assert_eq!(Duration::from_nanos(nanos), Duration::from_millis(3));
}

#[test]
fn who_forges_a_nodes_address() {
    let mut world = World::new(|_| {});
    for client in ["172.17.17.44:34379", "172.17.17.4:34379", "172.17.17.200:50000"] {
        assert_eq!(world.ask(client, SERVICE), Err(DropReason::SourceNotAllowed), "{client}");
    }
    let mut world = World::new(|net| net.allow.push("172.17.17.200/29".parse().unwrap()));
    assert!(world.ask("172.17.17.200:50000", SERVICE).is_ok(), "N-4");
    let node = world.ask("172.17.17.44:34379", SERVICE);
    assert_eq!(node, Err(DropReason::SourceNotAllowed));
}

/// An answer with the password of an earlier request passes, whoever sent the latest request.
#[test]
fn who_holds_another_password_of_the_net() {
    let mut world = World::new(|_| {});
    let to = world.ask(CLIENT, SERVICE).unwrap();
    world.sent(to);
    // The forger sends under the client's address and port, before each of its answers.
    for _ in 0..3 {
        let forged = world.ask(CLIENT, OTHER).unwrap();
        assert_eq!(forged, to, "on the client's own flow");
        world.sent(forged);
        assert_eq!(world.answer(to, SERVICE), Ok(response(SERVICE)));
        assert_eq!(world.answer(to, OTHER), Ok(response(OTHER)));
        assert_eq!(world.answer(to, WRONG), Err(DropReason::PasswordMismatch));
    }
}

/// A new port for each request evades the limits of a flow, but not those of the net. Clients that
/// have a flow are still served.
#[test]
fn who_changes_ports_for_each_request() {
    let mut world = World::new(|net| {
        (net.max_flows, net.max_flow_requests) = (10, Some(RequestRate::new(2)));
    });
    let to = world.ask(CLIENT, SERVICE).unwrap();
    world.sent(to);
    let passed = (1..=100).filter(|port| {
        let attacker = SocketAddr::from(([203, 0, 113, 66], 10_000 + port));
        match world.ask_from(attacker, PUBLIC, OTHER) {
            Ok(to) => {
                world.sent(to);
                true
            }
            Err(reason) => {
                assert_eq!(reason, DropReason::FlowLimit);
                false
            }
        }
    });
    assert_eq!(passed.count(), 9, "as many as the net has room for");
    assert_eq!(world.flows(), 10);
    assert_eq!(world.answer(to, SERVICE), Ok(response(SERVICE)));
    assert_eq!(world.ask(CLIENT, SERVICE), Ok(to), "an open flow is served all the same");
    assert_eq!(
        world.ask("198.51.100.8:1", SERVICE),
        Err(DropReason::FlowLimit),
        "a new one is not"
    );
}

/// The client changes its password while the flow is open. Answers come in any order, each with its
/// own.
#[test]
fn a_client_that_changes_its_password_loses_no_answer() {
    let device = |net: &mut Net, at: usize, password: &[u8; 8]| {
        net.credentials[at].device_password = Some(Password::new(*password));
    };
    let mut world = World::new(|net| {
        device(net, 0, b"device-1");
        device(net, 1, b"device-2");
    });
    for password in [SERVICE, OTHER] {
        let to = world.ask(CLIENT, password).unwrap();
        world.sent(to);
    }
    let to = world.ask(CLIENT, OTHER).unwrap();
    assert_eq!(world.answer(to, b"device-1"), Ok(response(SERVICE)));
    assert_eq!(world.answer(to, b"device-2"), Ok(response(OTHER)));
    // One password at the devices: the latest of the client's is its answer's.
    let mut world = World::new(|net| (0..2).for_each(|at| device(net, at, b"device-1")));
    for password in [OTHER, SERVICE] {
        let to = world.ask(CLIENT, password).unwrap();
        world.sent(to);
        assert_eq!(world.answer(to, b"device-1"), Ok(response(password)));
    }
}

/// After a reload, a flow keeps the passwords that were not withdrawn, and no others.
#[test]
fn a_reload_keeps_what_is_left_of_a_flows_passwords() {
    let mut world = World::new(|_| {});
    world.ask(CLIENT, OTHER).unwrap();
    let to = world.ask(CLIENT, SERVICE).unwrap();
    world.reload(|net| net.credentials.reverse());
    assert_eq!(world.answer(to, OTHER), Ok(response(OTHER)));
    world.reload(|net| drop(net.credentials.remove(1)));
    assert_eq!(world.answer(to, SERVICE), Ok(response(SERVICE)));
    assert_eq!(world.answer(to, OTHER), Err(DropReason::PasswordMismatch));
}

/// The attacker guesses under a client's address, from any port. The client still opens new flows.
#[test]
fn who_guesses_under_the_address_of_a_client() {
    let mut world = World::new(|_| {});
    let from = |port: u16| format!("198.51.100.7:{port}");
    world.ask(&from(1000), SERVICE).unwrap();
    let guess = |world: &mut World| {
        (2000..2100)
            .filter(|&port| world.ask(&from(port), WRONG) == Err(DropReason::PasswordWrong))
            .count()
    };
    assert_eq!(guess(&mut world), 100, "and is not slowed");
    assert!(world.ask(&from(1001), SERVICE).is_ok(), "a new flow of the client");
    assert!(world.ask(&from(2000), SERVICE).is_ok(), "from a port that was guessed from");

    // That holds for nobody else, and for the client only for a day.
    let stranger = |port: u16| format!("198.51.100.8:{port}");
    let guesses = (1..100)
        .filter(|&port| world.ask(&stranger(port), WRONG) == Err(DropReason::PasswordWrong));
    assert_eq!(guesses.count(), 6);
    assert_eq!(world.ask(&stranger(200), SERVICE), Err(DropReason::Throttled));
    world.now += Duration::from_secs(24 * 3600 + 120);
    world.worker.expire(world.now);
    assert!(guess(&mut world) < 10, "forgotten");
    assert_eq!(world.ask(&from(3000), SERVICE), Err(DropReason::Throttled));
}

/// A reload forgets the clients of a net if one of its passwords is withdrawn, and no others.
#[test]
fn a_withdrawn_password_makes_nobody_known() {
    for (withdrawn, known) in [(false, true), (true, false)] {
        let mut world = World::new(|_| {});
        world.ask(CLIENT, SERVICE).unwrap();
        world.reload(|net| {
            if withdrawn {
                net.credentials.remove(0);
            }
        });
        for port in 1..100 {
            let _ = world.ask(&format!("198.51.100.7:{port}"), WRONG);
        }
        let asked = world.ask("198.51.100.7:200", OTHER);
        assert_eq!(asked.is_ok(), known, "{asked:?}");
    }
}
