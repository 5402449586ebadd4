//! Measures the nanoseconds for each datagram in the codec and in the core, without a socket.
//!
//! Each figure is the time for one datagram. It includes the copy of the datagram into a buffer,
//! which the kernel makes when a datagram arrives. Run it with `cargo bench --bench core`. A name
//! after `--` selects cases.

use std::hint::black_box;
use std::net::{IpAddr, Ipv4Addr};

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput};
use fastrand::Rng;
use ipnet::IpNet;
use pnet_nat::nat::DropReason;
use pnet_nat::pnet::wire::{Datagram, Header};
use pnet_nat_rig::isolated_core::{
    DEVICE_PASSWORD, Flow, IDLE_TIMEOUT, PASSWORD, REST, Rig, Site, arrival, client_endpoint,
    datagram, garbage, largest_request, request, response,
};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    measure(&mut criterion, "parse", parse);
    measure(&mut criterion, "request", requests);
    measure(&mut criterion, "response", responses);
    measure(&mut criterion, "drop", drops);
    measure(&mut criterion, "source", sources);
    measure(&mut criterion, "flow", flow);
    criterion.final_summary();
}

fn measure(criterion: &mut Criterion, name: &str, cases: fn(&mut Group)) {
    let mut group = criterion.benchmark_group(name);
    group.throughput(Throughput::Elements(1));
    cases(&mut group);
    group.finish();
}

fn parse(group: &mut Group) {
    let header = Header::default();
    let small = request(1);
    group.bench_function("38 octets", |bencher| {
        bencher.iter(|| Datagram::parse(black_box(&small), header).is_ok());
    });
    let large = largest_request(1);
    assert!(Datagram::parse(&large, header).is_ok());
    group.bench_function("107 octets", |bencher| {
        bencher.iter(|| Datagram::parse(black_box(&large), header).is_ok());
    });
    for (name, start) in [("garbage", &[][..]), ("garbage behind a good header", &[2, 0, 0, 0])] {
        let mut turn = Turn::of(many_garbage(start));
        group.bench_function(name, |bencher| {
            bencher.iter(|| Datagram::parse(black_box(turn.next()), header).is_ok());
        });
    }
}

/// The name, the numbers of flows and nodes, and whether the servers have a password of their own.
const SIZES: [(&str, u32, u8, bool); 4] = [
    ("1 flow", 1, 1, false),
    ("1 flow, password exchanged", 1, 1, true),
    ("64 flows, 16 nodes", 64, 16, false),
    ("100,000 flows, 125 nodes, in random order", 100_000, 125, false),
];

fn requests(group: &mut Group) {
    for (name, flows, nodes, device_password) in SIZES {
        let (mut rig, mut turn) = at_work(flows, nodes, device_password);
        let octets: Vec<_> = (0..=nodes).map(request).collect();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let flow = turn.next();
                let mut octets = octets[usize::from(flow.node_address)];
                let arrival = flow.arrival();
                rig.request(&arrival, &mut octets).unwrap()
            });
        });
    }
}

fn responses(group: &mut Group) {
    for (name, flows, nodes, device_password) in SIZES {
        let (mut rig, mut turn) = at_work(flows, nodes, device_password);
        let password = if device_password { DEVICE_PASSWORD } else { PASSWORD };
        let octets: Vec<_> = (0..=nodes).map(|node| response(node, password)).collect();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let flow = turn.next();
                let mut octets = octets[usize::from(flow.node_address)];
                rig.response(flow.to.via, flow.to.server, &mut octets).unwrap()
            });
        });
    }
}

/// Measures datagrams of strangers, while 64 flows are open.
fn drops(group: &mut Group) {
    let (mut rig, mut turn) = at_work(64, 16, false);
    let route = [0x02, 0x01, 0x05, 0x02, 0x33, 0xfd, 0x81, 0xb1];
    let wrong: [u8; 38] = datagram(&route, &[7; 16], b"guessed!").try_into().unwrap();

    group.bench_function("wrong password from open flows", |bencher| {
        bencher.iter(|| {
            let arrival = arrival(turn.next().client, 1);
            let verdict = rig.request(&arrival, &mut { wrong });
            assert_eq!(verdict, Err(DropReason::PasswordWrong));
        });
    });
    let mut number = 0;
    group.bench_function("wrong password from 3,000,000 strangers", |bencher| {
        bencher.iter(|| {
            number = (number + 1) % 3_000_000;
            let arrival = arrival(client_endpoint(1_000_000 + number), 1);
            rig.request(&arrival, &mut { wrong }).is_err()
        });
    });
    group.bench_function("wrong password from a throttled sender", |bencher| {
        let arrival = arrival(client_endpoint(4_000_000), 1);
        for _ in 0..11 {
            let _ = rig.request(&arrival, &mut { wrong });
        }
        bencher.iter(|| {
            let verdict = rig.request(&arrival, &mut { wrong });
            assert_eq!(verdict, Err(DropReason::Throttled));
        });
    });
    let mut garbage = Turn::of(many_garbage(&[2, 0, 0, 0]));
    let outside = arrival("192.0.2.1:7".parse().unwrap(), 1);
    group.bench_function("garbage behind a good header", |bencher| {
        bencher.iter(|| {
            let octets = garbage.next();
            rig.request(&outside, octets).is_err()
        });
    });
}

/// Measures datagrams from outside of `allow`, with lists of different lengths.
fn sources(group: &mut Group) {
    for networks in [1_u32, 100, 10_000, 50_000] {
        // The networks are every fourth /32, so that no two of them can be merged into one.
        let network = |n| IpNet::from(IpAddr::from(Ipv4Addr::from_bits(0x0a00_0000 + 4 * n)));
        let allow = (0..networks).map(network).collect();
        let mut rig = Rig::new(&Site { allow, ..Site::default() });
        let mut random = Rng::with_seed(9);
        group.bench_function(format!("outside of {networks} networks"), |bencher| {
            bencher.iter(|| {
                let stranger = Ipv4Addr::from_bits(0x0a00_0001 + 4 * random.u32(..networks));
                let arrival = arrival((stranger, 7).into(), 1);
                let mut octets = request(1);
                let verdict = rig.request(&arrival, &mut octets);
                assert_eq!(verdict, Err(DropReason::SourceNotAllowed));
            });
        });
    }
}

/// Measures a flow's whole life: its socket is opened, the flow ends because it is idle, the pair
/// rests, the socket is closed.
fn flow(group: &mut Group) {
    let mut rig = Rig::new(&Site::default());
    group.bench_function("opened and closed", |bencher| {
        bencher.iter(|| {
            black_box(rig.open(0, 1));
            rig.now += IDLE_TIMEOUT;
            rig.expire();
            rig.now += REST;
            rig.expire();
        });
    });
    assert!(rig.core.is_idle());
}

/// A core with open flows, and these flows in random order.
fn at_work(flows: u32, nodes: u8, device_password: bool) -> (Rig, Turn<Flow>) {
    let mut rig = Rig::new(&Site { nodes, device_password, ..Site::default() });
    let mut flows = rig.open_all(flows, nodes);
    Rng::with_seed(3).shuffle(&mut flows);
    (rig, Turn::of(flows))
}

fn many_garbage(start: &[u8]) -> Vec<Vec<u8>> {
    let mut random = Rng::with_seed(5);
    (0..256).map(|_| garbage(&mut random, start)).collect()
}

/// Gives its items one after the other. After the last one it begins again.
struct Turn<T> {
    items: Vec<T>,
    at: usize,
}

impl<T> Turn<T> {
    fn of(items: Vec<T>) -> Self {
        Self { items, at: 0 }
    }

    fn next(&mut self) -> &mut T {
        self.at = if self.at + 1 < self.items.len() { self.at + 1 } else { 0 };
        &mut self.items[self.at]
    }
}
