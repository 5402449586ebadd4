//! A net of another plant: its password is put on requests here, and taken off answers.

use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;
use crate::pnet::wire::Password;

const OLD: &[u8; 8] = b"old-pass";
const NEW: &[u8; 8] = b"new-pass";
const PROGRAM: &str = "127.0.0.1:50000";

/// A relay with these passwords for nodes 4 and 5 of the other plant.
fn rules(passwords: &[&[u8; 8]]) -> Rules {
    let name = |password: &[u8; 8]| String::from_utf8(password.to_vec()).unwrap();
    let credential = |password: &&[u8; 8]| credential(&name(password), password, None);
    let net = Net {
        allow: vec!["127.0.0.0/8".parse().unwrap()],
        credentials: passwords.iter().map(credential).collect(),
        ..Net::new("plant-2", NetKind::Remote { start_port: 20_000 })
    };
    let node = |node_address: u8| {
        let local_address = Some([127, 17, 2, node_address].into());
        let server = format!("203.0.113.5:{}", 20_000 + u16::from(node_address));
        Mapping { local_address, ..mapping(0, node_address, 34_378, &server) }
    };
    Rules::new(table(vec![net], vec![node(4), node(5)]), LIMITS)
}

struct World {
    worker: Worker,
    now: Instant,
}

impl World {
    fn new(passwords: &[&[u8; 8]]) -> Self {
        let now = Instant::now();
        Self { worker: Worker::new(&rules(passwords), now, 0, Sockets::default()), now }
    }

    /// What leaves for the other plant's router when a program sends a request with this end.
    fn ask(&mut self, password: &[u8]) -> Result<(ToServer, Vec<u8>), DropReason> {
        let arrival = Arrival {
            public_address: "127.17.2.4".parse().unwrap(),
            ..arrival(PROGRAM.parse().unwrap())
        };
        let sent = request(password);
        let mut room = [&sent[..], &[0; Password::LEN]].concat();
        let mut payload = Payload::new(&mut room, sent.len());
        let Worker { core, effects, .. } = &mut self.worker;
        let to = core.request(self.now, &arrival, &mut payload, effects)?;
        core.request_sent(self.now, MappingId(0), to.asks, payload.len());
        Ok((to, payload.to_vec()))
    }

    /// What the program gets when the router sends an answer with this end.
    fn answer(&mut self, to: ToServer, password: &[u8]) -> Result<Vec<u8>, DropReason> {
        let mut octets = response(password);
        let mut payload = Payload::from(&mut octets[..]);
        let back = self.worker.core.response(self.now, to.via, to.server, &mut payload)?;
        assert_eq!(back.client, PROGRAM.parse().unwrap());
        assert_eq!(
            back.public_address.to_string(),
            "127.17.2.4",
            "from the address that was asked"
        );
        Ok(payload.to_vec())
    }

    fn reload(&mut self, passwords: &[&[u8; 8]]) {
        let Rules { table, limits, .. } = rules(passwords);
        let next = self.worker.rules.followed_by(table, limits);
        let next = self.worker.succession(&next, &Default::default());
        self.worker.reload(self.now, next);
    }
}

#[test]
fn the_password_is_put_on_and_taken_off() {
    let mut world = World::new(&[NEW]);
    let (to, sent) = world.ask(b"").unwrap();
    assert_eq!(to.server, "203.0.113.5:20004".parse().unwrap(), "R-10");
    assert_eq!(sent, request(NEW), "R-3");
    assert_eq!(world.answer(to, NEW), Ok(response(b"")));
    assert_eq!(
        world.answer(to, b""),
        Ok(response(b"")),
        "A16: without one there is none to take off"
    );
    assert_eq!(world.answer(to, OLD), Err(DropReason::PasswordMismatch));
}

#[test]
fn a_request_with_a_password_is_refused_even_with_the_right_one() {
    let mut world = World::new(&[NEW]);
    for password in [NEW, OLD] {
        assert_eq!(world.ask(password).unwrap_err(), DropReason::PasswordUnexpected);
    }
    assert_eq!(world.worker.flows(world.now), 0);
}

/// N-11: there is never a datagram that is longer than a package can be.
#[test]
fn the_longest_package_has_room_for_the_password() {
    let mut world = World::new(&[NEW]);
    let beyond: Vec<u8> = [&[11, 4][..], &[2; 20]].concat();
    let longest = datagram([&beyond, &[11, 3]], &[0; 63], b"");
    let arrival = arrival(PROGRAM.parse().unwrap());
    let mut room = [&longest[..], &[0; Password::LEN]].concat();
    let mut payload = Payload::new(&mut room, longest.len());
    let Worker { core, effects, .. } = &mut world.worker;
    core.request(world.now, &arrival, &mut payload, effects).unwrap();
    assert_eq!(payload.len(), longest.len() + Password::LEN);
    assert!(payload.ends_with(NEW));
}

/// The new password stands in front of the old one until its answers are in.
#[test]
fn a_password_is_changed_without_a_lost_answer() {
    let mut world = World::new(&[OLD]);
    let (asked_with_old, _) = world.ask(b"").unwrap();
    world.reload(&[NEW, OLD]);
    assert_eq!(
        world.answer(asked_with_old, OLD),
        Ok(response(b"")),
        "an answer that was under way"
    );
    let (to, sent) = world.ask(b"").unwrap();
    assert_eq!((to.via, &sent), (asked_with_old.via, &request(NEW)), "the same flow goes on");
    assert_eq!(world.answer(to, OLD), Ok(response(b"")), "another answer that was under way");
    assert_eq!(world.answer(to, NEW), Ok(response(b"")));
    world.reload(&[NEW]);
    assert_eq!(world.answer(to, OLD), Err(DropReason::PasswordMismatch));
    let (to, _) = world.ask(b"").unwrap();
    assert_eq!(world.answer(to, NEW), Ok(response(b"")));
}

/// What is withdrawn is so at once, also where no program has to know it.
#[test]
fn a_password_that_is_withdrawn_is_not_put_on_any_more() {
    let mut world = World::new(&[OLD]);
    let (to, _) = world.ask(b"").unwrap();
    world.reload(&[NEW]);
    assert_eq!(world.answer(to, OLD), Err(DropReason::UnknownFlow));
    let (to, sent) = world.ask(b"").unwrap();
    assert_eq!(sent, request(NEW));
    assert_eq!(world.answer(to, NEW), Ok(response(b"")));
    world.now += Duration::from_secs(1);
    assert_eq!(world.worker.flows(world.now), 1);
}

/// the tables of the other plant have one entry for a program, whichever nodes it asks.
#[test]
fn a_program_that_asks_several_nodes_comes_from_one_port() {
    let mut world = World::new(&[NEW]);
    let (to_4, _) = world.ask(b"").unwrap();
    let arrival = Arrival {
        listener: ListenerId(1),
        mapping: MappingId(1),
        public_address: "127.17.2.5".parse().unwrap(),
        client: PROGRAM.parse().unwrap(),
    };
    let mut sent = [request(b""), vec![0; Password::LEN]].concat();
    sent[5] = 5; // the node address
    let len = sent.len() - Password::LEN;
    let mut payload = Payload::new(&mut sent, len);
    let Worker { core, effects, .. } = &mut world.worker;
    let to_5 = core.request(world.now, &arrival, &mut payload, effects).unwrap();
    assert_eq!(to_5.via, to_4.via);
    assert_ne!(to_5.server, to_4.server);
}

#[test]
fn only_local_programs_may_use_it() {
    let mut world = World::new(&[NEW]);
    let arrival = arrival(CLIENT.parse().unwrap());
    let refused = world.worker.request(world.now, &arrival, &mut request(b""));
    assert_eq!(refused, Err(DropReason::SourceNotAllowed));
}
