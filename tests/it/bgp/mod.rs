//! Three relays at work at once behind one address: the files of `deploy/bgp`, run as they are but for what
//! each host has of its own.
//!
//! Needs root and BIRD. Each case prints what clients noticed; the figures stand in `deploy/bgp/README.md`.

mod clients;
mod service;
mod site;

use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use clients::{CLIENTS, Clients, shares};
use site::{ALL, CONFIGURATION, Host, PUBLIC, Site, has_bird};

/// A third each, but for chance: one of a million runs is outside.
const FAIR: std::ops::RangeInclusive<usize> = CLIENTS / 5..=CLIENTS / 2;

/// What happens to the clients from a moment on.
struct Case<'a> {
    clients: &'a Clients,
    what: &'static str,
    begun: Instant,
    before: Vec<u8>,
}

impl<'a> Case<'a> {
    fn begin(clients: &'a Clients, what: &'static str) -> Self {
        clients.expect_answers();
        Self { clients, what, begun: Instant::now(), before: clients.relays() }
    }

    /// The route has changed by now. Whatever was lost was sent before.
    fn expect_loss_until_now(&self) {
        let (now, took) = (Instant::now(), self.begun.elapsed());
        self.clients.expect_answers();
        self.clients.expect_none_lost(now);
        self.tell(Some(took));
    }

    /// Every request is answered.
    fn expect_no_loss(&self) {
        self.clients.expect_answers();
        self.clients.expect_none_lost(self.begun);
        self.tell(None);
    }

    fn tell(&self, route_took: Option<Duration>) {
        let lost = self.clients.lost_since(self.begun);
        let (own, others) = self.moved();
        let route = route_took.map_or_else(String::new, |took| {
            format!("the route changed after {:.2} s; ", took.as_secs_f64())
        });
        println!(
            "{}: {route}{lost} requests without an answer in time; moved: {} clients, {others} of relays that stayed; now {:?}",
            self.what,
            own + others,
            shares(&self.clients.relays()),
        );
    }

    /// How many clients have another relay now: those whose relay has no client any more, and all others.
    fn moved(&self) -> (usize, usize) {
        let now = self.clients.relays();
        let moved = self.before.iter().zip(&now).filter(|(before, now)| before != now);
        let (own, others): (Vec<_>, Vec<_>) = moved.partition(|(before, _)| !now.contains(*before));
        (own.len(), others.len())
    }
}

#[test]
fn three_relays_at_work_at_once() {
    if !has_bird() {
        return;
    }
    let Some(mut site) = Site::build() else { return };
    let clients = Clients::new(&site);
    let clients = &clients;
    clients.during(|| {
        let case = Case::begin(clients, "all three");
        case.expect_no_loss();
        let spread = shares(&clients.relays());
        assert!(ALL.iter().all(|relay| FAIR.contains(&spread[relay])), "{spread:?}");
        let flows: Vec<_> = site.hosts.iter().map(Host::flows_in_the_kernel).collect();
        println!("flows in the kernel, by relay: {flows:?}");

        fails(&mut site, clients);
        is_taken_out(&mut site, clients);

        let case = Case::begin(clients, "all three reloaded");
        for number in ALL {
            let other = CONFIGURATION.replace("[\"1-20\"]", "[\"1-21\"]");
            site.host(number).relay().reload_to(&other);
        }
        case.expect_no_loss();
        resilient(&site, clients);
    });
    for host in &mut site.hosts {
        host.finish();
    }
}

/// What nobody has announced: requests are lost until the route is another one, and none after.
fn fails(site: &mut Site, clients: &Clients) {
    let case = Case::begin(clients, "relay killed");
    site.host(1).relay().process.signal(Signal::SIGKILL);
    site.expect_route(&[2, 3]);
    case.expect_loss_until_now();
    let case = Case::begin(clients, "relay started again");
    site.host(1).start_relay();
    site.expect_route(&ALL);
    case.expect_no_loss();

    let case = Case::begin(clients, "relay hung");
    site.host(2).relay().process.hold();
    site.expect_route(&[1, 3]);
    case.expect_loss_until_now();
    let case = Case::begin(clients, "relay goes on");
    site.host(2).relay().process.go_on();
    site.expect_route(&ALL);
    case.expect_no_loss();

    let case = Case::begin(clients, "cable to the router pulled");
    site.router.ip("link set port3 down");
    site.expect_route(&[1, 2]);
    case.expect_loss_until_now();
    let case = Case::begin(clients, "cable to the router back");
    site.router.ip("link set port3 up");
    site.expect_route(&ALL);
    case.expect_no_loss();

    let case = Case::begin(clients, "cable to the plant pulled");
    site.plant.ip("link set port1 down");
    site.expect_route(&[2, 3]);
    case.expect_loss_until_now();
    let case = Case::begin(clients, "cable to the plant back");
    site.plant.ip("link set port1 up");
    site.expect_route(&ALL);
    case.expect_no_loss();
}

/// What is announced loses nothing, and neither does the end of BIRD, for the relay goes on.
fn is_taken_out(site: &mut Site, clients: &Clients) {
    for number in ALL {
        let case = Case::begin(clients, "relay drained");
        site.host(number).relay().process.signal(Signal::SIGTERM);
        site.expect_route(&ALL.into_iter().filter(|other| *other != number).collect::<Vec<_>>());
        site.host(number).expect_rest();
        assert_eq!(site.host(number).relay().process.end(), Some(0));
        case.expect_no_loss();
        let case = Case::begin(clients, "relay started again");
        site.host(number).start_relay();
        site.expect_route(&ALL);
        case.expect_no_loss();
    }

    let case = Case::begin(clients, "BIRD killed");
    site.host(3).kill_bird();
    site.expect_route(&[1, 2]);
    case.expect_no_loss();
    let case = Case::begin(clients, "BIRD started again");
    site.host(3).restart_bird();
    site.expect_route(&ALL);
    case.expect_no_loss();
}

/// A route over a resilient group in front of BIRD's: only clients of the relay that is taken out move.
fn resilient(site: &Site, clients: &Clients) {
    for number in ALL {
        site.router.ip(&format!("nexthop add id {number} via 192.0.2.{} dev eth0", 10 + number));
    }
    let group = |members: &str| {
        let kind = "type resilient buckets 128 idle_timer 60";
        site.router.ip(&format!("nexthop replace id 10 group {members} {kind}"));
    };
    group("1/2/3");
    site.router.ip(&format!("route add {PUBLIC}/32 nhid 10"));
    let case = Case::begin(clients, "resilient group: a relay taken out");
    group("2/3");
    case.expect_no_loss();
    let (own, others) = case.moved();
    assert!(own > 0 && others == 0, "moved: {own}, and {others} of relays that stayed");
    let case = Case::begin(clients, "resilient group: the relay put back");
    group("1/2/3");
    case.expect_no_loss();
}
