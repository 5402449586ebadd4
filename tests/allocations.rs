//! The core allocates nothing for a datagram, neither for one of an open flow nor for one that is
//! dropped. The memory of an open flow is measured. A client node allocates nothing for what it receives, and
//! the views of PROFINET allocate nothing either.
//!
//! The allocator counts for each thread by itself, so that the tests may run at the same time.
// An allocator cannot be written without unsafe code. This one hands every call on to the system's.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use pnet_nat::nat::{Arrival, DropReason, Payload, RequestRate};
use pnet_nat::pnet::endpoint::client::{
    Arep, Attributes, Client, DestinationRoute, Outcome, Request, Source, Undelivered, Way,
};
use pnet_nat::pnet::ip_net_table::Destination;
use pnet_nat::pnet::wire::{MAX_DATAGRAM, Password};
use pnet_nat::profinet::blocks::Blocks;
use pnet_nat::profinet::dcp::Dcp;
use pnet_nat::profinet::lldp::Lldp;
use pnet_nat::profinet::mrp::Mrp;
use pnet_nat::profinet::ndr;
use pnet_nat::profinet::ptcp::Ptcp;
use pnet_nat::profinet::rpc::{Body, Flags1, Header, PacketType, ReadImplicit, Rpc};
use pnet_nat::profinet::rt::{CyclicData, PtcpFrame, RtFrame};
use pnet_nat::profinet::view::first_fault;
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Uuid};
use pnet_nat_rig::isolated_core::{
    DEVICE_PASSWORD, Flow, PASSWORD, REST, Rig, Site, arrival, client_endpoint, datagram, garbage,
    largest_request, request, response, server,
};

/// How often each datagram is sent.
const TIMES: usize = 1_000;

const ROUTE: [u8; 8] = [0x02, 0x01, 0x05, 0x02, 0x33, 0xfd, 0x81, 0xb1];

#[global_allocator]
static ALLOCATOR: Counting = Counting;

struct Counting;

thread_local! {
    static CALLS: Cell<usize> = const { Cell::new(0) };
    /// Octets held; negative if the thread has freed what another one allocated.
    static HELD: Cell<isize> = const { Cell::new(0) };
}

fn count(calls: usize, more: usize, less: usize) {
    // When a thread ends, its counters may be gone already.
    let _ = CALLS.try_with(|cell| cell.set(cell.get() + calls));
    let _ = HELD.try_with(|cell| cell.set(cell.get() + more as isize - less as isize));
}

// SAFETY: every call goes to the system's allocator unchanged. Counting does not allocate: the
// cells need no initialization and no destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(1, layout.size(), 0);
        // SAFETY: the caller's promise is handed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        count(0, 0, layout.size());
        // SAFETY: the caller's promise is handed on.
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(1, size, layout.size());
        // SAFETY: the caller's promise is handed on.
        unsafe { System.realloc(place, layout, size) }
    }
}

/// Runs `action` and asserts that it allocated nothing.
#[track_caller]
fn without_allocating<T>(action: impl FnOnce() -> T) -> T {
    let before = CALLS.get();
    let result = action();
    assert_eq!(CALLS.get() - before, 0, "allocations");
    result
}

#[test]
fn the_counter_counts() {
    let before = (CALLS.get(), HELD.get());
    let mut octets = Vec::<u8>::with_capacity(1000);
    assert_eq!((CALLS.get() - before.0, HELD.get() - before.1), (1, 1000));
    octets.reserve_exact(2000);
    assert_eq!((CALLS.get() - before.0, HELD.get() - before.1), (2, 2000));
    drop(octets);
    assert_eq!((CALLS.get() - before.0, HELD.get() - before.1), (2, 0));
}

#[test]
fn open_flows_cost_no_allocation() {
    let mut rig = Rig::new(&Site::default());
    let flows = rig.open_all(64, 16);
    let answers: Vec<_> = (1..=16).map(|node| response(node, PASSWORD)).collect();
    let requests: Vec<_> = (1..=16).map(request).collect();
    without_allocating(|| {
        for _ in 0..TIMES {
            for flow in &flows {
                let index = usize::from(flow.node_address) - 1;
                exchange(&mut rig, flow, &mut { requests[index] }, &mut { answers[index] });
            }
        }
    });
}

#[test]
fn the_largest_request_costs_no_allocation() {
    let mut rig = Rig::new(&Site::default());
    let flow = rig.open(0, 16);
    let (large, answer) = (largest_request(1), response(1, PASSWORD));
    without_allocating(|| {
        for _ in 0..TIMES {
            exchange(&mut rig, &flow, &mut { large }, &mut { answer });
        }
    });
}

/// The password is exchanged on the way in and on the way back.
#[test]
fn exchanging_the_password_costs_no_allocation() {
    let mut rig = Rig::new(&Site { device_password: true, ..Site::default() });
    let flow = rig.open(0, 16);
    let (asked, answer) = (request(1), response(1, DEVICE_PASSWORD));
    without_allocating(|| {
        for _ in 0..TIMES {
            let (mut asked, mut answer) = (asked, answer);
            exchange(&mut rig, &flow, &mut asked, &mut answer);
            assert!(asked.ends_with(DEVICE_PASSWORD) && answer.ends_with(PASSWORD));
        }
    });
}

#[test]
fn a_dropped_request_costs_no_allocation() {
    let outside: SocketAddr = "192.0.2.1:7".parse().unwrap();
    let member = client_endpoint(0);
    // From its address, no right password has come yet.
    let guesser: SocketAddr = "10.9.9.9:7".parse().unwrap();
    let secure = |route: &[u8]| datagram(route, &[7; 16], PASSWORD);
    let wrong = datagram(&ROUTE, &[7; 16], b"guessed!");
    let mut broadcast = ROUTE;
    broadcast[1] = 126;
    // The sender is a stranger wherever the check comes before that of the source.
    let cases: [(DropReason, SocketAddr, Vec<u8>); 16] = [
        (DropReason::TooShort, outside, vec![2, 0, 0, 0, 1]),
        (DropReason::TooLong, outside, vec![2; 108]),
        (DropReason::BadHeader, outside, [&[9, 9, 9, 9], &request(1)[4..]].concat()),
        (DropReason::BadRoute, outside, secure(&[0x02, 0x01, 0x02, 0x03])),
        (DropReason::RouteFormat, outside, secure(&[0x02, 0x81])),
        (DropReason::BadLength, outside, request(1)[..37].to_vec()),
        (DropReason::PasswordMissing, outside, datagram(&ROUTE, &[7; 16], &[])),
        (
            DropReason::Loop,
            SocketAddr::new(arrival(member, 1).public_address, 0),
            request(1).to_vec(),
        ),
        (DropReason::Unanswerable, SocketAddr::new(outside.ip(), 0), request(1).to_vec()),
        (DropReason::SourceNotAllowed, outside, request(1).to_vec()),
        (DropReason::PasswordWrong, member, wrong.clone()),
        (DropReason::Throttled, guesser, wrong),
        (DropReason::NotUnicast, member, request(1).to_vec()),
        (DropReason::Broadcast, member, secure(&broadcast)),
        (DropReason::NodeMismatch, member, request(2).to_vec()),
        (DropReason::FlowLimit, client_endpoint(2), request(1).to_vec()),
    ];
    let mut rig = Rig::new(&Site { max_flows: 1, ..Site::default() });
    rig.open(0, 16);
    let mut seen = Vec::new();
    for (reason, client, octets) in cases {
        let mut arrival = arrival(client, 1);
        if reason == DropReason::NotUnicast {
            arrival.public_address = Ipv4Addr::UNSPECIFIED.into();
        }
        if reason == DropReason::Throttled {
            (0..10).for_each(|_| {
                expect_drop(&mut rig, &arrival, &octets, DropReason::PasswordWrong);
            });
        }
        let once = octets.clone();
        without_allocating(|| {
            (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &once, reason));
        });
        seen.push(reason);
    }

    let mut rig = Rig::new(&Site { sockets: 0, ..Site::default() });
    let (arrival, octets) = (arrival(member, 1), request(1));
    let exhausted = DropReason::UpstreamExhausted;
    without_allocating(|| {
        (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &octets, exhausted));
    });
    seen.push(exhausted);

    let mut rig = Rig::new(&Site { max_requests: Some(RequestRate::new(1)), ..Site::default() });
    let limit = DropReason::RequestLimit;
    rig.open(0, 16);
    without_allocating(|| {
        (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &octets, limit));
    });
    seen.push(limit);

    let mut rig = Rig::new(&Site { is_remote: true, ..Site::default() });
    let unexpected = DropReason::PasswordUnexpected;
    without_allocating(|| {
        (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &octets, unexpected));
    });
    seen.push(unexpected);

    let left_out = DropReason::REQUEST.iter().filter(|reason| !seen.contains(reason));
    assert!(left_out.eq([&DropReason::SendFailed]), "the core does not send");
}

/// A password is put on in the room behind the request, and is taken off the answer.
#[test]
fn an_exchange_with_another_plant_costs_no_allocation() {
    let mut rig = Rig::new(&Site { is_remote: true, ..Site::default() });
    let arrival = arrival(client_endpoint(0), 1);
    let (asked, answer) = (request(1), response(1, PASSWORD));
    let len = asked.len() - PASSWORD.len();
    let mut room = asked;
    let to = rig
        .core
        .request(rig.now, &arrival, &mut Payload::new(&mut room, len), &mut rig.effects)
        .unwrap();
    without_allocating(|| {
        for _ in 0..TIMES {
            let (mut room, mut back) = (asked, answer);
            room[len..].fill(0);
            let mut payload = Payload::new(&mut room, len);
            rig.core.request(rig.now, &arrival, &mut payload, &mut rig.effects).unwrap();
            assert_eq!(*payload, asked);
            let mut payload = Payload::from(&mut back[..]);
            rig.core.response(rig.now, to.via, to.server, &mut payload).unwrap();
            assert_eq!(*payload, answer[..answer.len() - PASSWORD.len()]);
        }
    });
}

/// Memory for senders of wrong passwords is there from the start, however many they are.
#[test]
fn a_million_guessers_cost_no_allocation() {
    let mut rig = Rig::new(&Site::default());
    let wrong: [u8; 38] = datagram(&ROUTE, &[7; 16], b"guessed!").try_into().unwrap();
    let throttled = arrival(client_endpoint(1_000_000), 1);
    without_allocating(|| {
        for number in 0..1_000_000 {
            rig.now += Duration::from_micros(100);
            for arrival in [arrival(client_endpoint(number), 1), throttled] {
                let verdict = rig.request(&arrival, &mut { wrong });
                assert!(verdict.is_err());
            }
            if number % 10_000 == 0 {
                rig.expire();
            }
        }
    });
    assert!(!rig.core.is_idle(), "the throttled one is remembered");
}

/// Requests of a net with limits, which are not reached.
#[test]
fn limited_requests_cost_no_allocation() {
    let max_requests = Some(RequestRate::new(RequestRate::MOST));
    let mut rig = Rig::new(&Site { max_requests, ..Site::default() });
    let flow = rig.open(0, 16);
    let (asked, answer) = (request(1), response(1, PASSWORD));
    without_allocating(|| {
        for _ in 0..TIMES {
            exchange(&mut rig, &flow, &mut { asked }, &mut { answer });
        }
    });
}

#[test]
fn a_dropped_response_costs_no_allocation() {
    let stranger: SocketAddr = "172.17.17.200:34379".parse().unwrap();
    let sound = response(1, PASSWORD);
    let cases: [(DropReason, SocketAddr, Vec<u8>); 8] = [
        (DropReason::UnknownFlow, stranger, sound.to_vec()),
        (DropReason::UnknownFlow, server(2), sound.to_vec()),
        (DropReason::TooShort, server(1), vec![2]),
        (DropReason::TooLong, server(1), vec![2; 108]),
        (DropReason::BadHeader, server(1), [&[9, 9, 9, 9], &sound[4..]].concat()),
        (DropReason::BadRoute, server(1), datagram(&[0x81, 0x02], &[7; 16], PASSWORD)),
        (DropReason::BadLength, server(1), sound[..37].to_vec()),
        (DropReason::PasswordMismatch, server(1), response(1, b"guessed!").to_vec()),
    ];
    let mut rig = Rig::new(&Site::default());
    let via = rig.open(0, 16).to.via;
    for (reason, from, octets) in &cases {
        let mut octets = octets.clone();
        without_allocating(|| {
            for _ in 0..TIMES {
                let verdict = rig.response(via, *from, &mut octets);
                assert_eq!(verdict.err(), Some(*reason));
            }
        });
    }
    let seen = |reason| cases.iter().any(|(case, ..)| *case == reason);
    let left_out = DropReason::RESPONSE.iter().filter(|&&reason| !seen(reason));
    assert!(left_out.eq([&DropReason::SendFailed]), "the core does not send");
}

/// Garbage from a stranger, a client without a flow, a client with a flow, and nodes.
#[test]
fn garbage_costs_no_allocation() {
    let mut rig = Rig::new(&Site::default());
    let via = rig.open(0, 16).to.via;
    let mut random = fastrand::Rng::with_seed(7);
    for round in 0..10_000 {
        let start = &[2, 0, 0, 0][..round % 5];
        let mut octets = garbage(&mut random, start);
        let clients = ["192.0.2.1:7".parse().unwrap(), client_endpoint(1), client_endpoint(0)];
        without_allocating(|| {
            for client in clients {
                let verdict = rig.request(&arrival(client, 1), &mut octets);
                assert!(verdict.is_err());
            }
            for from in [server(1), server(2)] {
                assert!(rig.response(via, from, &mut octets).is_err());
            }
        });
    }
}

/// A client that was here before opens its flow again without an allocation.
#[test]
fn a_flow_that_comes_back_costs_no_allocation() {
    let mut rig = Rig::new(&Site::default());
    rig.open(0, 16);
    rig.core.shut_down(rig.now, &mut rig.effects);
    let (arrival, mut octets) = (arrival(client_endpoint(0), 1), request(1));
    without_allocating(|| {
        rig.request(&arrival, &mut octets).unwrap();
    });
}

/// What a client ignores, and what answers its requests, more often than there are addresses.
#[test]
fn what_a_client_receives_costs_no_allocation() {
    let [router, elsewhere]: [SocketAddr; 2] =
        ["203.0.113.5:20004", "203.0.113.5:9"].map(|address| address.parse().unwrap());
    let mut client = Client::new(Arep::new(Source::FIGURE_10));
    let endpoint = client.reserve(Attributes::new(DestinationRoute {
        way: Way { address: router, password: Some(Password::new(*PASSWORD)) },
        ip_net_id: Source::FIGURE_10.ip_net_id,
        node: Destination::try_from(4).unwrap(),
        beyond: [2, 33].into_iter().collect(),
    }));
    let endpoint = endpoint.unwrap();
    let mut random = fastrand::Rng::with_seed(7);
    let mut octets = [0; MAX_DATAGRAM];
    for round in 0..300 {
        let request = Request::Data { control_status: 0, data_octets: &[7; 63] };
        client.request(endpoint, &request).unwrap();
        let now = Duration::from_secs(round);
        let length = client.poll_transmit(now, &mut octets).unwrap().length;
        let address = client.get(endpoint).unwrap().address();
        let route = [0x7D, round as u8 % 125 + 1, 6, address, 0x8B, 0x84, 0x82, 0xA1, 0x80];
        let right = [&octets[..4], &route, &octets[12..length]].concat();
        let mut wrong = right.clone();
        *wrong.last_mut().unwrap() ^= 1;
        let noise = garbage(&mut random, &right[..round as usize % 10]);
        without_allocating(|| {
            client.receive(now, router, &noise).unwrap_err();
            client.receive(now, router, &wrong).unwrap_err();
            client.receive(now, elsewhere, &right).unwrap_err();
            client.undelivered(elsewhere, &noise, Undelivered::Forbidden);
            client.receive(now, router, &right).unwrap();
            client.receive(now, router, &right).unwrap_err();
        });
        assert_eq!(client.poll_finished(), Some(endpoint));
        assert!(matches!(client.take_outcome(endpoint), Some(Outcome::Answered(_))));
    }
}

/// Every field of every block in datagrams of every kind.
#[test]
fn reading_rpc_of_profinet_costs_no_allocation() {
    let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/profinet_rpc");
    let files = std::fs::read_dir(corpus).unwrap();
    let datagrams: Vec<_> =
        files.map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    let mut blocks = 0;
    without_allocating(|| {
        for datagram in &datagrams {
            let Ok(rpc) = Rpc::parse(datagram) else { continue };
            let Body::Stub(stub) = rpc.body() else { continue };
            let request = ndr::Request::read(stub).map(|request| request.args);
            let Ok(args) = request.or_else(|_| ndr::Response::read(stub).map(|it| it.args)) else {
                continue;
            };
            for block in Blocks::new(args) {
                assert_eq!(first_fault(&block.unwrap()), None);
                blocks += 1;
            }
        }
    });
    assert!(blocks > 50, "{blocks} blocks");
}

/// A plant sends thousands of RT frames a second.
#[test]
fn frames_of_profinet_are_read_without_allocating() {
    let cyclic = [&[0x80, 0x01][..], &[0; 40], &[0x12, 0x34, 0x35, 0]].concat();
    let dcp = b"\xFE\xFE\x05\0\x01\0\0\x02\0\x01\0\x08\x02\x02\0\x04plc1";
    let lldp = b"\x02\x04\x07plc\x04\x09\x07port-001\x06\x02\0\x14\0\0";
    let mrp = [&[0, 1, 1, 18, 0, 7][..], &[0xFF; 16], &[0, 0]].concat();
    let ptcp = [&[0xFF, 0x40][..], &[0; 20], &[0x0C, 6, 2, 0, 0, 0, 0, 9, 0, 0]].concat();
    let parts = without_allocating(|| {
        let mut parts = 0;
        for _ in 0..TIMES {
            let frame = RtFrame::parse(&cyclic).unwrap();
            parts += usize::from(CyclicData::parse(frame.behind).unwrap().status.cycle_counter);
            let frame = RtFrame::parse(dcp).unwrap();
            parts += Dcp::parse(frame.behind).unwrap().blocks().map(Result::unwrap).count();
            parts += Lldp::new(lldp).tlvs().map(Result::unwrap).count();
            parts += Mrp::parse(&mrp).unwrap().tlvs().map(Result::unwrap).count();
            let frame = RtFrame::parse(&ptcp).unwrap();
            let ptcp = Ptcp::parse(PtcpFrame::DelayRequest, frame.behind).unwrap().unwrap();
            parts += ptcp.tlvs().map(Result::unwrap).count();
        }
        parts
    });
    assert_eq!(parts, TIMES * (0x1234 + 1 + 3 + 1 + 1));
}

fn profinet() -> Site {
    Site { is_profinet: true, ..Site::default() }
}

/// A client reads a record: the call with this number.
fn read(sequence: u32) -> [u8; ReadImplicit::LEN] {
    let read = ReadImplicit {
        order: ByteOrder::Big,
        object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
        activity: Uuid::new(7),
        sequence,
        api: 0,
        slot: 0,
        subslot: 1,
        index: 0xAFF0,
        record_length: 1000,
        target_ar: Uuid::NIL,
    };
    let mut octets = [0; ReadImplicit::LEN];
    read.emit(&mut octets).unwrap();
    octets
}

/// A datagram about the call with this number, with another header than a read has.
fn about(sequence: u32, body: &[u8], change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let whole = read(sequence);
    let mut header = *Rpc::parse(&whole).unwrap().header();
    change(&mut header);
    let mut octets = vec![0; Header::LEN + body.len()];
    header.emit(body, &mut octets).unwrap();
    octets
}

/// More calls than a flow has room for, whole and in fragments, each with signals in both directions.
#[test]
fn an_exchange_with_a_profinet_device_costs_no_allocation() {
    let mut rig = Rig::new(&profinet());
    let (client, mut first) = (arrival(client_endpoint(0), 1), read(0));
    let to = rig.request(&client, &mut first).unwrap();
    let device = SocketAddr::new(to.server.ip(), 49_153);
    let calls: Vec<_> = (1..=20)
        .map(|call| {
            let whole = read(call);
            let (front, back) = whole[Header::LEN..].split_at(50);
            let fragment = |number, flags, stub| {
                about(call, stub, |header| {
                    header.flags1 = Flags1(flags);
                    header.fragment_number = number;
                })
            };
            let last = Flags1::FRAGMENT | Flags1::LAST_FRAGMENT;
            let ping = about(call, &[], |header| header.packet_type = PacketType::Ping);
            let there = [
                whole.to_vec(),
                ping,
                fragment(0, Flags1::FRAGMENT, front),
                fragment(1, last, back),
            ];
            let back = [(PacketType::Working, &[][..]), (PacketType::Response, &[0; 20])]
                .map(|(kind, body)| about(call, body, |header| header.packet_type = kind));
            (there, back)
        })
        .collect();
    let mut room = [0; 200];
    without_allocating(|| {
        for _ in 0..TIMES {
            for (there, back) in &calls {
                for octets in there {
                    let room = &mut room[..octets.len()];
                    room.copy_from_slice(octets);
                    assert_eq!(rig.request(&client, room).unwrap().via, to.via);
                }
                for octets in back {
                    let room = &mut room[..octets.len()];
                    room.copy_from_slice(octets);
                    assert_eq!(rig.response(to.via, device, room).unwrap().client, client.client);
                }
            }
        }
    });
}

#[test]
fn a_dropped_request_to_a_profinet_device_costs_no_allocation() {
    let outside: SocketAddr = "192.0.2.1:7".parse().unwrap();
    let member = client_endpoint(0);
    let whole = read(1);
    let changed = |at: usize, to: u8| {
        let mut octets = whole.to_vec();
        octets[at] = to;
        octets
    };
    let operation =
        |operation| about(1, &whole[Header::LEN..], |header| header.operation = operation);
    let ping = about(1, &[], |header| header.packet_type = PacketType::Ping);
    // The sender is a stranger wherever the check comes before that of the source.
    let cases: [(DropReason, SocketAddr, Vec<u8>); 20] = [
        (DropReason::NotUnicast, member, whole.to_vec()),
        (DropReason::TooShort, outside, whole[..79].to_vec()),
        (DropReason::TooLong, outside, vec![4; 1473]),
        (DropReason::BadHeader, outside, changed(0, 5)),
        (DropReason::BadLength, outside, [&whole[..], &[0]].concat()),
        (DropReason::Broadcast, outside, changed(2, Flags1::BROADCAST)),
        (DropReason::PacketType, outside, changed(1, PacketType::Response as u8)),
        (DropReason::RpcInterface, outside, operation(6)),
        (DropReason::RpcConnect, outside, operation(0)),
        (DropReason::RpcRelease, outside, operation(1)),
        (DropReason::RpcRead, outside, operation(2)),
        (DropReason::RpcWrite, outside, operation(3)),
        (DropReason::RpcControl, outside, operation(4)),
        (DropReason::RecordNotAllowed, outside, changed(Header::LEN + 54, 0xE0)),
        (DropReason::BadNdr, outside, changed(Header::LEN + 21, 8)),
        (DropReason::Loop, SocketAddr::new(arrival(member, 1).public_address, 0), whole.to_vec()),
        (DropReason::Unanswerable, SocketAddr::new(outside.ip(), 0), whole.to_vec()),
        (DropReason::SourceNotAllowed, outside, whole.to_vec()),
        (DropReason::UnknownExchange, member, ping),
        (DropReason::FlowLimit, client_endpoint(2), whole.to_vec()),
    ];
    let mut rig = Rig::new(&Site { max_flows: 1, ..profinet() });
    rig.request(&arrival(member, 1), &mut read(0)).unwrap();
    let mut seen = Vec::new();
    for (reason, client, octets) in cases {
        let mut arrival = arrival(client, 1);
        if reason == DropReason::NotUnicast {
            arrival.public_address = Ipv4Addr::UNSPECIFIED.into();
        }
        without_allocating(|| {
            (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &octets, reason));
        });
        seen.push(reason);
    }

    let arrival = arrival(member, 1);
    let mut rig = Rig::new(&Site { sockets: 0, ..profinet() });
    let exhausted = DropReason::UpstreamExhausted;
    without_allocating(|| {
        (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &whole, exhausted));
    });
    seen.push(exhausted);

    let mut rig = Rig::new(&Site { max_requests: Some(RequestRate::new(1)), ..profinet() });
    let limit = DropReason::RequestLimit;
    rig.request(&arrival, &mut read(0)).unwrap();
    without_allocating(|| {
        (0..TIMES).for_each(|_| expect_drop(&mut rig, &arrival, &whole, limit));
    });
    seen.push(limit);

    let left_out = DropReason::RPC_REQUEST.iter().filter(|reason| !seen.contains(reason));
    assert!(left_out.eq([&DropReason::SendFailed]), "the core does not send");
}

#[test]
fn a_dropped_response_of_a_profinet_device_costs_no_allocation() {
    let mut rig = Rig::new(&profinet());
    let to = rig.request(&arrival(client_endpoint(0), 1), &mut read(1)).unwrap();
    let device = SocketAddr::new(to.server.ip(), 49_153);
    let stranger: SocketAddr = "172.17.17.200:34964".parse().unwrap();
    let answer =
        |sequence, body| about(sequence, body, |header| header.packet_type = PacketType::Response);
    let sound = answer(1, &[0; 20]);
    let cases: [(DropReason, SocketAddr, Vec<u8>); 8] = [
        (DropReason::UnknownFlow, stranger, sound.clone()),
        (DropReason::TooShort, device, sound[..79].to_vec()),
        (DropReason::TooLong, device, vec![4; 1473]),
        (DropReason::BadHeader, device, [&[5], &sound[1..]].concat()),
        (DropReason::BadLength, device, sound[..99].to_vec()),
        (DropReason::PacketType, device, read(1).to_vec()),
        (DropReason::BadNdr, device, answer(1, &[1; 20])),
        (DropReason::UnknownExchange, device, answer(2, &[0; 20])),
    ];
    for (reason, from, octets) in &cases {
        let mut octets = octets.clone();
        without_allocating(|| {
            for _ in 0..TIMES {
                let verdict = rig.response(to.via, *from, &mut octets);
                assert_eq!(verdict.err(), Some(*reason));
            }
        });
    }
    let seen = |reason| cases.iter().any(|(case, ..)| *case == reason);
    let left_out = DropReason::RPC_RESPONSE.iter().filter(|&&reason| !seen(reason));
    assert!(left_out.eq([&DropReason::SendFailed]), "the core does not send");
}

#[test]
fn memory_of_100_000_flows() {
    const FLOWS: u32 = 100_000;
    let before = HELD.get();
    let mut rig = Rig::new(&Site { nodes: 125, max_flows: FLOWS, ..Site::default() });
    let empty = HELD.get();
    for number in 0..FLOWS {
        rig.open(number, 125);
    }
    let grown = HELD.get() - empty;
    assert!(grown < 20 * FLOWS as isize, "{grown} octets: all else had its room");
    let held = (HELD.get() - before).cast_unsigned();
    println!("memory of {FLOWS} flows: {held} octets, {} a flow", held / FLOWS as usize);
    assert!(held < 600 * FLOWS as usize, "{held} octets");

    // Closed, and rested.
    rig.core.shut_down(rig.now, &mut rig.effects);
    rig.now += REST;
    rig.expire();
    assert!(rig.core.is_idle());
}

fn exchange(rig: &mut Rig, flow: &Flow, asked: &mut [u8], answer: &mut [u8]) {
    let to = rig.request(&flow.arrival(), asked).unwrap();
    assert_eq!(to, flow.to);
    let back = rig.response(to.via, to.server, answer).unwrap();
    assert_eq!(back.client, flow.client);
}

/// A datagram that is dropped is not changed, so it may be sent again.
fn expect_drop(rig: &mut Rig, arrival: &Arrival, octets: &[u8], reason: DropReason) {
    let mut copy = [0; 1500];
    let copy = &mut copy[..octets.len()];
    copy.copy_from_slice(octets);
    let verdict = rig.request(arrival, copy);
    assert_eq!(verdict, Err(reason));
    assert_eq!(copy, octets);
}
