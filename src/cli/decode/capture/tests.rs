//! Captures written by hand, sound and damaged.

use proptest::prelude::*;

use super::*;

/// A packet as it was read: number, time in the log's form, link type, octets.
type Read = (u64, Option<String>, i32, Vec<u8>);

fn all(file: &[u8]) -> (Vec<Read>, Option<String>) {
    let mut packets = Vec::new();
    let end = read(file, |packet| {
        let time = packet.time.map(|time| humantime::format_rfc3339_nanos(time).to_string());
        packets.push((packet.number, time, packet.link.0, packet.octets.to_vec()));
        Ok(())
    });
    (packets, end.err().map(|error| error.to_string()))
}

/// Writes numbers in one byte order.
#[derive(Clone, Copy)]
struct Writer {
    big_endian: bool,
}

impl Writer {
    fn u16(self, value: u16) -> Vec<u8> {
        if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() }.to_vec()
    }

    fn u32(self, value: u32) -> Vec<u8> {
        if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() }.to_vec()
    }

    fn u32s(self, values: &[u32]) -> Vec<u8> {
        values.iter().flat_map(|&value| self.u32(value)).collect()
    }

    /// A pcap file with these octets as a packet, twice.
    fn pcap(self, magic: u32, octets: &[u8]) -> Vec<u8> {
        let length = octets.len() as u32;
        let packet = [self.u32s(&[1_790_000_000, 7, length, length]), octets.to_vec()].concat();
        let header = [self.u32(magic), self.u16(2), self.u16(4), self.u32s(&[0, 0, 65535, 101])];
        [&header.concat()[..], &packet, &packet].concat()
    }

    fn block(self, kind: u32, body: &[u8]) -> Vec<u8> {
        let padded = [body, &vec![0; body.len().next_multiple_of(4) - body.len()]].concat();
        let length = self.u32(12 + padded.len() as u32);
        [&self.u32(kind)[..], &length, &padded, &length].concat()
    }

    fn section(self) -> Vec<u8> {
        let body = [self.u32(0x1A2B_3C4D), self.u16(1), self.u16(0), vec![0xFF; 8]].concat();
        self.block(SHB_MAGIC, &body)
    }

    fn interface(self, link: u16, options: &[(u16, &[u8])]) -> Vec<u8> {
        let mut body = [self.u16(link), self.u16(0), self.u32(0)].concat();
        for (code, value) in options {
            let padded = [value, &[0; 4][..value.len().next_multiple_of(4) - value.len()]];
            body.extend([self.u16(*code), self.u16(value.len() as u16), padded.concat()].concat());
        }
        body.extend([0; 4]);
        self.block(IDB_MAGIC, &body)
    }

    fn enhanced(self, interface: u32, time: u64, octets: &[u8]) -> Vec<u8> {
        let length = octets.len() as u32;
        let front = self.u32s(&[interface, (time >> 32) as u32, time as u32, length, length]);
        self.block(EPB_MAGIC, &[&front, octets].concat())
    }

    fn simple(self, octets: &[u8]) -> Vec<u8> {
        self.block(SPB_MAGIC, &[&self.u32(octets.len() as u32), octets].concat())
    }

    fn pcapng(self) -> Vec<u8> {
        let seconds = if self.big_endian { 10_i64.to_be_bytes() } else { 10_i64.to_le_bytes() };
        [
            self.section(),
            self.interface(1, &[]),
            self.interface(101, &[(9, &[9]), (14, &seconds)]),
            self.interface(113, &[(9, &[0x81])]),
            self.block(0x0BAD, &[1; 40]),
            self.enhanced(1, 1_790_000_000_000_000_008, b"one"),
            self.enhanced(0, 1_790_000_000_000_007, b"three"),
            self.enhanced(2, 3, b""),
            self.simple(b"simple"),
            // A new section has other interfaces.
            self.section(),
            self.interface(276, &[]),
            self.enhanced(0, 0, b"last"),
        ]
        .concat()
    }
}

const BOTH: [Writer; 2] = [Writer { big_endian: false }, Writer { big_endian: true }];

#[test]
fn pcap_in_both_orders_and_precisions() {
    for writer in BOTH {
        for (magic, fraction) in [(0xA1B2_C3D4, "000007000"), (0xA1B2_3C4D, "000000007")] {
            let file = writer.pcap(magic, b"octets");
            assert!(is_magic(&file[..4]));
            let time = Some(format!("2026-09-21T14:13:20.{fraction}Z"));
            let packet = |number| (number, time.clone(), 101, b"octets".to_vec());
            assert_eq!(all(&file), (vec![packet(1), packet(2)], None));
        }
    }
}

#[test]
#[cfg_attr(target_endian = "big", ignore = "pcapng is not read there")]
fn pcapng_in_both_orders_with_several_interfaces_and_sections() {
    for writer in BOTH {
        let file = writer.pcapng();
        assert!(is_magic(&file[..4]));
        let packet = |number, time: &str, link, octets: &[u8]| {
            (number, (!time.is_empty()).then(|| time.to_owned()), link, octets.to_vec())
        };
        let right = vec![
            packet(1, "2026-09-21T14:13:30.000000008Z", 101, b"one"),
            packet(2, "2026-09-21T14:13:20.000007000Z", 1, b"three"),
            packet(3, "1970-01-01T00:00:01.500000000Z", 113, b""),
            packet(4, "", 1, b"simple"),
            packet(5, "1970-01-01T00:00:00.000000000Z", 276, b"last"),
        ];
        assert_eq!(all(&file), (right, None));
    }
}

#[test]
#[cfg_attr(target_endian = "big", ignore = "pcapng is not read there")]
fn a_frame_check_sequence_is_left_out() {
    for big_endian in [false, true] {
        let writer = Writer { big_endian };
        let mut pcap = writer.pcap(0xA1B2_C3D4, b"frame+FCS!");
        // Four octets, and the bit that says so; then the same length without that bit.
        for (network, right) in
            [(0x2400_0001, &b"frame+"[..]), (0x2000_0001, b"frame+FCS!"), (1, b"frame+FCS!")]
        {
            pcap[20..24].copy_from_slice(&writer.u32(network));
            let (packets, error) = all(&pcap);
            assert_eq!((packets[0].2, &packets[0].3[..], error), (1, right, None));
        }
        let interface = writer.interface(1, &[(13, &[4])]);
        let packet = writer.enhanced(0, 0, b"frame+FCS!");
        let (packets, error) = all(&[writer.section(), interface, packet].concat());
        assert_eq!((&packets[0].3[..], error), (&b"frame+"[..], None));
    }
    // Of a packet that was cut off before, nothing more is taken away.
    assert_eq!(without_fcs(b"frame", 10, 4), (&b"frame"[..], 6));
    assert_eq!(without_fcs(b"abc", 3, 4), (&b""[..], 0));
}

#[test]
fn hex_text_is_no_capture() {
    for beginning in [&b"0200"[..], b"", b"\xD4\xC3\xB2", b"# ex"] {
        assert!(!is_magic(beginning));
    }
}

#[test]
#[cfg_attr(target_endian = "big", ignore = "pcapng is not read there")]
fn a_capture_that_was_cut_off_is_read_up_to_there() {
    for file in [BOTH[0].pcap(0xA1B2_C3D4, b"octets"), BOTH[1].pcapng()] {
        let (packets, _) = all(&file);
        for end in 0..file.len() {
            let (read, fault) = all(&file[..end]);
            assert_eq!(read, packets[..read.len()]);
            // Between blocks it just ends.
            let faults = ["the capture ends inside a block", "the capture is empty"];
            assert!(fault.is_none_or(|fault| faults.contains(&&fault[..])), "{end}");
        }
    }
}

#[test]
#[cfg_attr(target_endian = "big", ignore = "pcapng is not read there")]
fn lengths_without_reason_are_refused_before_they_are_reserved() {
    let writer = BOTH[0];
    let pcap = [writer.pcap(0xA1B2_C3D4, b""), writer.u32s(&[0, 0, u32::MAX, 0])].concat();
    let ng = |length| [writer.section(), writer.u32s(&[EPB_MAGIC, length, 0, 0])].concat();
    for file in [pcap, ng(0xFFFF_FFFC), ng(8)] {
        let fault = all(&file).1.unwrap();
        assert!(fault.starts_with("the capture has a damaged block at octet "), "{fault}");
    }
    let no_such_interface = [writer.section(), writer.simple(b"octets")].concat();
    assert!(all(&no_such_interface).1.unwrap().contains("damaged block at octet 28"));
}

#[test]
#[cfg_attr(target_endian = "big", ignore = "pcapng is not read there")]
fn a_time_out_of_all_reason_is_none() {
    let writer = BOTH[0];
    for (resolution, units) in [(0, u64::MAX), (0x7F, 1), (0xFF, 1)] {
        let interface = writer.interface(1, &[(9, &[resolution]), (14, &[0xFF; 8])]);
        let file = [writer.section(), interface, writer.enhanced(0, units, b"x")].concat();
        assert_eq!(all(&file), (vec![(1, None, 1, b"x".to_vec())], None));
    }
}

proptest! {
    #[test]
    fn no_capture_makes_it_panic(
        kind in 0_usize..4,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
    ) {
        let writer = BOTH[kind % 2];
        let mut file =
            if kind < 2 { writer.pcapng() } else { writer.pcap(0xA1B2_C3D4, &[0x45; 40]) };
        for (place, value) in changes {
            *place.get_mut(&mut file[4..]) = value;
        }
        let _ = read(&file[..], |packet| {
            let _ = (crate::cli::decode::packet::find(packet.link, packet.octets), packet.time);
            Ok(())
        });
    }
}
