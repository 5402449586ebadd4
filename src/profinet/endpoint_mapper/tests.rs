//! A look-up of one entry, octet by octet, and any octets at all.

use std::net::Ipv4Addr;

use proptest::collection::vec;
use proptest::prelude::*;

use super::super::ObjectUuid;
use super::*;

const ACTIVITY: Uuid = Uuid::new(0x0102_0304_0506_0708_090A_0B0C_0D0E_0F10);
const HANDLE: Uuid = Uuid::new(0xAABB_CCDD_EEFF_0011_2233_4455_6677_8899);
/// How the data of calls are written: NDR.
const NDR: Uuid = Uuid::new(0x8A88_5D04_1CEB_11C9_9FE8_0800_2B10_4860);

/// The octets of a tower: PROFINET device over UDP at 192.0.2.7:49152.
fn tower() -> Vec<u8> {
    let uuid = |uuid: Uuid| {
        let mut floor = vec![19, 0, 0x0D];
        floor.extend(uuid.on_wire(ByteOrder::Little));
        floor
    };
    [
        &[5, 0][..],
        &uuid(Interface::Device.uuid()),
        &[1, 0, 2, 0, 0, 0],
        &uuid(NDR),
        &[2, 0, 2, 0, 0, 0],
        &[1, 0, 0x0A, 2, 0, 0, 0],
        &[1, 0, 0x08, 2, 0, 0xC0, 0x00],
        &[1, 0, 0x09, 4, 0, 192, 0, 2, 7],
    ]
    .concat()
}

fn u32s(order: ByteOrder, numbers: &[u32]) -> Vec<u8> {
    let to_octets = |number: &u32| match order {
        ByteOrder::Big => number.to_be_bytes(),
        ByteOrder::Little => number.to_le_bytes(),
    };
    numbers.iter().flat_map(to_octets).collect()
}

/// Stub data of an answer with one entry.
fn answer(order: ByteOrder) -> Vec<u8> {
    let object = ObjectUuid { instance: 1, device: 2, vendor: 42 }.to_uuid();
    let tower = tower();
    let len = tower.len() as u32;
    [
        u32s(order, &[0]),
        HANDLE.on_wire(order).to_vec(),
        u32s(order, &[1, 1, 0, 1]),
        object.on_wire(order).to_vec(),
        u32s(order, &[3, 0, 7]),
        b"Valve 1\0".to_vec(),
        u32s(order, &[len, len]),
        tower,
        vec![0; (4 - len as usize % 4) % 4],
        u32s(order, &[0]),
    ]
    .concat()
}

#[test]
fn p_4_a_look_up_has_these_octets_in_both_byte_orders() {
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let lookup = Lookup::next_of_all(Handle { attributes: 0, uuid: HANDLE });
        let mut buffer = [0; Lookup::MAX_LEN];
        let len = lookup.emit(order, ACTIVITY, 3, &mut buffer).unwrap();
        let stub =
            [u32s(order, &[0, 0, 0, 1, 0]), HANDLE.on_wire(order).to_vec(), u32s(order, &[1])]
                .concat();
        assert_eq!(buffer[80..len], stub);
        let rpc = Rpc::parse(&buffer[..len]).unwrap();
        assert_eq!((rpc.header().sequence, rpc.header().activity), (3, ACTIVITY));
        assert_eq!((rpc.header().interface_version, rpc.header().operation), (3, LOOKUP));
        let Some(Message::Lookup(parsed)) = Message::of(&rpc).unwrap() else { panic!() };
        assert_eq!(parsed, lookup);
    }
}

#[test]
fn p_4_what_a_node_offers_is_read_from_the_answer() {
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let stub = answer(order);
        let answer = LookupAnswer::read(Octets::new(&stub).in_order(order)).unwrap();
        assert_eq!((answer.handle.uuid, answer.status), (HANDLE, 0));
        let entries: Vec<_> = answer.entries().collect();
        let [entry] = &entries[..] else { panic!("{entries:?}") };
        assert_eq!(ObjectUuid::of(entry.object).unwrap().vendor, 42);
        assert_eq!(entry.annotation, b"Valve 1");
        let tower = entry.tower.unwrap();
        assert_eq!(tower.udp_port(), Some(49152));
        assert_eq!(tower.interface(), Some(Interface::Device.uuid()));
        assert_eq!(
            tower.floors().collect::<Vec<_>>(),
            [
                Floor::Uuid { uuid: Interface::Device.uuid(), major: 1, minor: 0 },
                Floor::Uuid { uuid: NDR, major: 2, minor: 0 },
                Floor::Connectionless { minor: 0 },
                Floor::Udp { port: 49152 },
                Floor::Ip(Ipv4Addr::new(192, 0, 2, 7)),
            ]
        );
    }
}

#[test]
fn p_4_the_last_answer_has_no_entry() {
    let stub = u32s(ByteOrder::Big, &[0, 0, 0, 0, 0, 0, 1, 0, 0, LookupAnswer::NO_MORE_ENTRIES]);
    let answer = LookupAnswer::read(Octets::new(&stub)).unwrap();
    assert_eq!((answer.entries().count(), answer.handle), (0, Handle::default()));
    assert_eq!(answer.status, LookupAnswer::NO_MORE_ENTRIES);
}

#[test]
fn p_4_numbers_of_an_answer_that_contradict_each_other_are_refused() {
    let good = answer(ByteOrder::Big);
    for (at, value, offset) in [
        (23, 2, 20),  // more entries than the array has
        (31, 1, 20),  // an array that does not begin at 0
        (59, 1, 56),  // an annotation that does not begin at 0
        (63, 65, 56), // an annotation that is too long
        (75, 9, 72),  // a tower of another length
        (80, 6, 155), // a floor more than there are
        (80, 4, 146), // a floor less than there are
    ] {
        let mut stub = good.clone();
        stub[at] = value;
        let error = LookupAnswer::read(Octets::new(&stub)).unwrap_err();
        assert_eq!(error.offset, offset, "octet {at}: {error}");
    }
}

#[test]
fn p_4_a_handle_is_given_back() {
    let free = HandleFree { handle: Handle { attributes: 0, uuid: HANDLE } };
    let mut buffer = [0; HandleFree::LEN];
    assert_eq!(free.emit(ByteOrder::Little, ACTIVITY, 9, &mut buffer), Ok(100));
    let rpc = Rpc::parse(&buffer).unwrap();
    assert_eq!(rpc.header().operation, HANDLE_FREE);
    let Some(Message::HandleFree(parsed)) = Message::of(&rpc).unwrap() else { panic!() };
    assert_eq!(parsed, free);
    let stub = u32s(ByteOrder::Big, &[0, 0, 0, 0, 0, 5]);
    let answer = HandleFree::read_answer(Octets::new(&stub)).unwrap();
    assert_eq!(answer, (HandleFree { handle: Handle::default() }, 5));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    #[test]
    fn p_4_a_look_up_is_parsed_again(
        numbers in (any::<u32>(), any::<u32>(), any::<u32>(), any::<u32>()),
        object in any::<Option<u128>>(),
        interface in any::<Option<(u128, u16, u16)>>(),
        handle: u128,
        is_little: bool,
    ) {
        let lookup = Lookup {
            inquiry_type: numbers.0,
            object: object.map(Uuid::new),
            interface: interface
                .map(|(uuid, major, minor)| InterfaceId { uuid: Uuid::new(uuid), major, minor }),
            version_option: numbers.1,
            handle: Handle { attributes: numbers.2, uuid: Uuid::new(handle) },
            max_entries: numbers.3,
        };
        let order = if is_little { ByteOrder::Little } else { ByteOrder::Big };
        let mut buffer = [0; Lookup::MAX_LEN];
        let len = lookup.emit(order, ACTIVITY, 0, &mut buffer).unwrap();
        let rpc = Rpc::parse(&buffer[..len]).unwrap();
        let Some(Message::Lookup(parsed)) = Message::of(&rpc).unwrap() else { panic!() };
        prop_assert_eq!(parsed, lookup);
    }

    #[test]
    fn no_answer_panics(
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 0..5),
        noise in vec(any::<u8>(), 0..100),
        is_noise: bool,
    ) {
        let mut stub = if is_noise { noise } else { answer(ByteOrder::Big) };
        for (index, value) in changes {
            if !stub.is_empty() {
                *index.get_mut(&mut stub) = value;
            }
        }
        if let Ok(answer) = LookupAnswer::read(Octets::new(&stub)) {
            for entry in answer.entries() {
                entry.tower.map(|tower| tower.floors().count());
            }
        }
        let _ = (Lookup::read(Octets::new(&stub)), HandleFree::read_answer(Octets::new(&stub)));
    }
}
