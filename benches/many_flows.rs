//! Measures how long a worker is busy with tasks that concern all of its flows. Each call is
//! measured alone, in processor time, with 1,000 flows up to a million. Between two calls the
//! worker handles datagrams.
//!
//! Run it with `cargo bench --bench many_flows`.

use std::time::Duration;

use nix::time::{ClockId, clock_gettime};
use pnet_nat_rig::isolated_core::{IDLE_TIMEOUT, PASSWORD, REST, Rig, Site};

const NODES: u8 = 125;
const SECOND: Duration = Duration::from_secs(1);

fn main() {
    println!("{:<44}{:>10}{:>12}{:>10}{:>14}", "", "flows", "longest", "calls", "together");
    for flows in [1_000, 100_000, 1_000_000] {
        measure(flows);
    }
}

fn measure(flows: u32) {
    let site = Site { nodes: NODES, ..Site::default() };
    let mut rig = Rig::new(&site);
    let mut opening = Calls::default();
    (0..flows).for_each(|number| _ = opening.time(|| rig.open(number, NODES)));
    let told = |what: &str, calls: Calls| {
        let Calls { longest, count, together } = calls;
        println!("{what:<44}{flows:>10}{longest:>12.1?}{count:>10}{together:>14.1?}");
    };

    told("a flow opens", opening);

    let mut calls = Calls::default();
    for _ in 0..10 {
        rig.now += SECOND;
        expire(&mut rig, &mut calls);
    }
    told("a tick, nothing is due", calls);

    for (what, password) in
        [("a reload that keeps all", PASSWORD), ("a reload that withdraws all", b"another!")]
    {
        let mut calls = Calls::default();
        let next = rig.succession(&Site { password, ..site.clone() });
        calls.time(|| rig.core.reload(rig.now, next, &mut rig.effects));
        while calls.time(|| rig.core.go_over(rig.now, &mut rig.effects)).is_none() {}
        told(what, calls);
    }

    let mut rig = Rig::new(&site);
    rig.open_all(flows, NODES);
    for (what, pause) in
        [("all flows idle at once", IDLE_TIMEOUT), ("all their sockets have rested", REST)]
    {
        let mut calls = Calls::default();
        rig.now += pause;
        expire(&mut rig, &mut calls);
        told(what, calls);
    }
    assert!(rig.core.is_idle());
}

fn expire(rig: &mut Rig, calls: &mut Calls) {
    while calls.time(|| rig.core.expire(rig.now, &mut rig.effects)) {}
}

/// The processor time that calls took.
#[derive(Default)]
struct Calls {
    longest: Duration,
    count: u32,
    together: Duration,
}

impl Calls {
    fn time<T>(&mut self, call: impl FnOnce() -> T) -> T {
        let begun = processor_time();
        let result = call();
        let took = processor_time() - begun;
        self.longest = self.longest.max(took);
        self.count += 1;
        self.together += took;
        result
    }
}

/// The processor time of this thread. Other work of the machine does not count.
fn processor_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).unwrap().into()
}
