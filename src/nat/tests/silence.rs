//! How long a flow lives without a datagram, second by second in simulated time (N-2, N-3).

use std::time::{Duration, Instant};

use super::fixture::*;
use crate::nat::*;

const IDLE_TIMEOUT: Duration = Duration::from_secs(300);
/// RFC 4787 REQ-5: a flow must not end before 120 s.
const SILENCE: Duration = Duration::from_secs(119);

/// One client, one node, and the time.
struct World {
    worker: Worker,
    now: Instant,
    /// Where the one request went.
    asked: ToServer,
}

impl World {
    /// A request has just passed.
    fn new() -> Self {
        let net = Net { idle_timeout: IDLE_TIMEOUT, ..net() };
        let rules = Rules::new(table(vec![net], vec![node_4()]), LIMITS);
        let now = Instant::now();
        let mut worker = Worker::new(&rules, now, 0, Sockets::default());
        let arrival = arrival(CLIENT.parse().unwrap());
        let asked = worker.request(now, &arrival, &mut request(PASSWORD)).unwrap();
        Self { worker, now, asked }
    }

    /// Lets time pass as in a worker, which looks for idle flows about once a second.
    fn pass(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = end.min(self.now + Duration::from_secs(1));
            self.worker.expire(self.now);
        }
    }

    fn answer(&mut self) -> Result<ToClient, DropReason> {
        let ToServer { via, server, .. } = self.asked;
        self.worker.response(self.now, via, server, &mut response(PASSWORD))
    }
}

#[test]
fn an_answer_comes_through_after_119_seconds_of_silence() {
    let mut world = World::new();
    world.pass(SILENCE);
    assert!(world.answer().is_ok());
    world.pass(SILENCE);
    assert!(world.answer().is_ok(), "and once more: N-3");
}

#[test]
fn a_flow_ends_with_its_time_out_and_not_before() {
    let mut world = World::new();
    let moment = Duration::from_millis(1);
    world.pass(IDLE_TIMEOUT - moment);
    assert!(world.answer().is_ok(), "N-2");
    world.pass(IDLE_TIMEOUT - moment);
    assert_eq!(world.worker.flows(world.now), 1, "N-3: since the answer");
    world.pass(moment);
    assert_eq!(world.worker.flows(world.now), 0);
    assert_eq!(world.worker.effects.closed, [(20_004, CloseReason::Idle)]);
    assert_eq!(world.answer(), Err(DropReason::UnknownFlow));
}
