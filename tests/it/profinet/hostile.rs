//! 100,000 datagrams that are nearly calls, through the relay: what reaches the device only reads, and
//! every datagram is accounted for.
//!
//! Needs root.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use fastrand::Rng;
use pnet_nat::profinet::endpoint_mapper::{HANDLE_FREE, Handle, LOOKUP, Lookup};
use pnet_nat::profinet::records::record_name;
use pnet_nat::profinet::rpc::{Interface, ReadImplicit, Rpc};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Uuid};

use super::through::{DEVICE, PUBLIC_PORT, start_relay};
use crate::harness::{Network, Over, PNIO_PORT, eventually};

const DATAGRAMS: u64 = 100_000;

/// A sound call of one of the kinds that may pass, and of others.
fn call(rng: &mut Rng) -> Vec<u8> {
    let order = if rng.bool() { ByteOrder::Big } else { ByteOrder::Little };
    let activity = Uuid::new(rng.u128(0..1000));
    let mut buffer = [0; 200];
    let length = if rng.u8(0..4) == 0 {
        Lookup::next_of_all(Handle::default()).emit(order, activity, rng.u32(0..3), &mut buffer)
    } else {
        let read = ReadImplicit {
            order,
            object: ObjectUuid { instance: 1, device: 2, vendor: 3 }.to_uuid(),
            activity,
            sequence: rng.u32(0..3),
            api: 0,
            slot: rng.u16(0..3),
            subslot: rng.u16(0..3),
            index: rng.choice([0xAFF0, 0xF841, 0xE040, 0x8071]).unwrap(),
            record_length: 1000,
            target_ar: Uuid::NIL,
        };
        read.emit(&mut buffer)
    };
    buffer[..length.unwrap()].to_vec()
}

/// Changes octets, most often those that say what is called, and cuts or lengthens.
fn mutated(rng: &mut Rng) -> Vec<u8> {
    let mut octets = call(rng);
    for _ in 0..rng.usize(0..4) {
        let at = match rng.u8(0..4) {
            0 => rng.choice([0, 1, 2, 4, 68, 69, 74, 75, 76, 77]).unwrap(),
            1 => rng.usize(24..40),
            _ => rng.usize(0..octets.len()),
        };
        octets[at] = if rng.bool() { rng.u8(0..12) } else { rng.u8(..) };
    }
    match rng.u8(0..20) {
        0 => octets.truncate(rng.usize(0..octets.len())),
        1 => octets.resize(octets.len() + rng.usize(1..1500), rng.u8(..)),
        _ => {}
    }
    octets
}

/// Whether the device may have received it.
fn only_reads(octets: &[u8]) -> bool {
    let Ok(rpc) = Rpc::parse(octets) else { return false };
    let header = rpc.header();
    match Interface::of(header.interface) {
        Some(Interface::Device) if header.operation == ReadImplicit::OPERATION => {
            match ReadImplicit::parse(&rpc) {
                Ok(Some(read)) => record_name(read.index).is_some_and(|_| read.index != 0xE040),
                Ok(None) => true, // a fragment, or what belongs to a call
                Err(_) => false,
            }
        }
        Some(Interface::EndpointMapper) => matches!(header.operation, LOOKUP | HANDLE_FREE),
        _ => false,
    }
}

#[test]
fn of_100_000_mutated_calls_none_but_reads_reach_the_device() {
    let Some(network) = Network::build() else { return };
    let mut rng = Rng::new();
    let seed = rng.u64(..);
    rng.seed(seed);
    println!("seed {seed}");
    let relay = start_relay(&network);
    let (client, device) =
        (network.client("198.51.100.7"), network.plant.peer((DEVICE, PNIO_PORT).into()));
    let (over, mut reached) = (AtomicBool::new(false), 0_u64);
    thread::scope(|scope| {
        let at_device = scope.spawn(|| {
            let mut reached = 0;
            while !over.load(Relaxed) {
                while let Some((octets, _)) = device.receive_within(Duration::from_millis(50)) {
                    assert!(only_reads(&octets), "seed {seed}: {octets:02X?}");
                    reached += 1;
                }
            }
            reached
        });
        let over = Over(&over);
        let public = format!("198.51.100.1:{PUBLIC_PORT}").parse().unwrap();
        for _ in 0..DATAGRAMS {
            client.send(public, &mutated(&mut rng));
        }
        network.edge.enter(|| {
            eventually("every datagram is accounted for", || {
                let metrics = relay.metrics();
                let requests = [("net", "drive-4"), ("node", "0"), ("direction", "request")];
                let received = metrics.sum("pnet_nat_received_datagrams_total", &requests);
                let lost = metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &requests[..1]);
                (received + lost == DATAGRAMS).then_some(())
            });
        });
        drop(over);
        reached = at_device.join().unwrap();
    });
    network.edge.enter(|| {
        let metrics = relay.at_rest();
        let requests = [("net", "drive-4"), ("direction", "request")];
        let forwarded = metrics.sum("pnet_nat_forwarded_datagrams_total", &requests);
        println!("{forwarded} of {DATAGRAMS} were forwarded, {reached} were read by the device");
        assert!(forwarded >= reached && reached > 1000, "{forwarded} {reached}");
        relay.finish();
    });
}
