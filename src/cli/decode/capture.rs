//! The packets of a capture, pcap or pcapng, as a stream.
//!
//! The file is split into blocks here, and `pcap_parser` reads each one. Invariant: only one block is in
//! memory, and it is not longer than [`LONGEST_BLOCK`].

use std::io::{self, BufRead, Read};
use std::time::{Duration, SystemTime};

use anyhow::{Context, bail, ensure};
use pcap_parser::pcapng::{Block, OptionCode};
use pcap_parser::traits::PcapNGPacketBlock;
use pcap_parser::{
    EPB_MAGIC, IDB_MAGIC, InterfaceDescriptionBlock, Linktype, SHB_MAGIC, SPB_MAGIC,
    parse_block_be, parse_block_le, parse_pcap_frame, parse_pcap_frame_be, parse_pcap_header,
};

/// Octets in the longest block: more than any capture program stores of one packet.
const LONGEST_BLOCK: usize = 1 << 20;
/// Interfaces in one section.
const MOST_INTERFACES: usize = 1 << 16;
/// The pcapng option with the length of the frame check sequence.
const IF_FCSLEN: u16 = 13;
/// The last second of the year 9999: later times cannot be printed.
const LAST_SECOND: u64 = 253_402_300_799;

/// A captured packet.
#[derive(Debug)]
pub(super) struct Captured<'a> {
    /// Counted from 1, as Wireshark does.
    pub(super) number: u64,
    pub(super) time: Option<SystemTime>,
    pub(super) link: Linktype,
    /// As far as it was captured.
    pub(super) octets: &'a [u8],
    /// Octets that were sent.
    pub(super) length: usize,
}

/// Whether a file that begins with these octets is a capture.
pub(super) fn is_magic(beginning: &[u8]) -> bool {
    beginning.first_chunk().is_some_and(|&magic| pcap_version(magic).is_some())
        || beginning == SHB_MAGIC.to_be_bytes()
}

/// Whether a pcap file with this magic number is big-endian, and how many units a second has.
fn pcap_version(magic: [u8; 4]) -> Option<(bool, u32)> {
    match magic {
        [0xD4, 0xC3, 0xB2, 0xA1] => Some((false, 1_000_000)),
        [0xA1, 0xB2, 0xC3, 0xD4] => Some((true, 1_000_000)),
        [0x4D, 0x3C, 0xB2, 0xA1] => Some((false, 1_000_000_000)),
        [0xA1, 0xB2, 0x3C, 0x4D] => Some((true, 1_000_000_000)),
        _ => None,
    }
}

/// Calls `each` with every packet. Fails at a damaged block, or when the input ends inside one.
pub(super) fn read(
    input: impl BufRead,
    each: impl FnMut(Captured<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut blocks = Blocks { input, block: Vec::new(), read: 0 };
    ensure!(blocks.fill(4)?, "the capture is empty");
    match blocks.block.first_chunk().copied().and_then(pcap_version) {
        Some((big_endian, units)) => read_pcap(&mut blocks, big_endian, units, each),
        None => {
            // pcap-parser 0.17 takes the type of a block for another one there.
            ensure!(
                cfg!(target_endian = "little"),
                "this processor is big-endian, where pcapng is not read; `editcap -F pcap` makes pcap of it"
            );
            read_pcapng(&mut blocks, each)
        }
    }
}

fn read_pcap(
    blocks: &mut Blocks<impl BufRead>,
    big_endian: bool,
    units: u32,
    mut each: impl FnMut(Captured<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    blocks.fill(24)?;
    let (_, header) = parse_pcap_header(&blocks.block).ok().context("bad pcap header")?;
    // The upper bits describe what follows a frame: bit 26 says that the highest four count.
    let network = header.network.0 as u32;
    let fcs = if network & 1 << 26 == 0 { 0 } else { 2 * (network >> 28) as usize };
    for number in 1.. {
        blocks.block.clear();
        if !blocks.fill(16)? {
            break;
        }
        let length = [8, 9, 10, 11].map(|at| blocks.block[at]);
        let length =
            if big_endian { u32::from_be_bytes(length) } else { u32::from_le_bytes(length) };
        blocks.fill(16_usize.saturating_add(length as usize))?;
        let parse = if big_endian { parse_pcap_frame_be } else { parse_pcap_frame };
        let (_, frame) = parse(&blocks.block).ok().with_context(|| blocks.bad_block())?;
        let time = time(frame.ts_sec.into(), frame.ts_usec.into(), units.into());
        let (octets, length) = without_fcs(frame.data, frame.origlen, fcs);
        let link = Linktype(header.network.0 & 0xFFFF);
        each(Captured { number, time, link, octets, length })?;
    }
    Ok(())
}

fn read_pcapng(
    blocks: &mut Blocks<impl BufRead>,
    mut each: impl FnMut(Captured<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let (mut big_endian, mut number) = (false, 0);
    let mut interfaces: Vec<Interface> = Vec::new();
    while blocks.next_pcapng(&mut big_endian)? {
        let parse = if big_endian { parse_block_be } else { parse_block_le };
        let (_, block) = parse(&blocks.block).ok().with_context(|| blocks.bad_block())?;
        let (interface, time, octets, length) = match &block {
            Block::SectionHeader(_) => {
                interfaces.clear();
                continue;
            }
            Block::InterfaceDescription(description) => {
                ensure!(interfaces.len() < MOST_INTERFACES, "too many interfaces");
                interfaces.push(Interface::new(description, big_endian));
                continue;
            }
            Block::EnhancedPacket(packet) => {
                let interface = interfaces.get(packet.if_id as usize);
                let units = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
                let time = interface.and_then(|it| it.time(units));
                (interface, time, packet.packet_data(), packet.origlen)
            }
            Block::SimplePacket(packet) => {
                (interfaces.first(), None, packet.packet_data(), packet.origlen)
            }
            _ => continue,
        };
        number += 1;
        let interface = interface.with_context(|| blocks.bad_block())?;
        let (octets, length) = without_fcs(octets, length, interface.fcs);
        each(Captured { number, time, link: interface.link, octets, length })?;
    }
    Ok(())
}

/// The octets of a packet, and how many were sent, without the frame check sequence of so many octets. It
/// would be taken for the status behind cyclic data of PROFINET.
fn without_fcs(octets: &[u8], length: u32, fcs: usize) -> (&[u8], usize) {
    let length = (length as usize).saturating_sub(fcs);
    (&octets[..octets.len().min(length)], length)
}

/// An interface of a pcapng section.
#[derive(Debug)]
struct Interface {
    link: Linktype,
    /// Octets of the frame check sequence behind each packet.
    fcs: usize,
    units_per_second: Option<u64>,
    /// Seconds.
    offset: i64,
}

impl Interface {
    fn new(block: &InterfaceDescriptionBlock<'_>, big_endian: bool) -> Self {
        let option = |code| block.options.iter().find(|option| option.code == code);
        let offset = option(OptionCode::IfTsoffset).and_then(|option| option.value.first_chunk());
        let number = if big_endian { i64::from_be_bytes } else { i64::from_le_bytes };
        let (power, of_two) = (block.if_tsresol & 0x7F, block.if_tsresol & 0x80 != 0);
        let fcs = option(OptionCode(IF_FCSLEN)).and_then(|option| option.value.first());
        Self {
            link: block.linktype,
            fcs: fcs.map_or(0, |&octets| octets.into()),
            units_per_second: (if of_two { 2_u64 } else { 10 }).checked_pow(power.into()),
            offset: offset.map_or(0, |octets| number(*octets)),
        }
    }

    fn time(&self, units: u64) -> Option<SystemTime> {
        let per_second = self.units_per_second?;
        let seconds = (units / per_second).checked_add_signed(self.offset)?;
        time(seconds, units % per_second, per_second)
    }
}

/// A point in time; none when it cannot be printed.
fn time(seconds: u64, units: u64, per_second: u64) -> Option<SystemTime> {
    let nanoseconds = u128::from(units) * 1_000_000_000 / u128::from(per_second);
    let since = Duration::from_secs(seconds)
        .checked_add(Duration::from_nanos(nanoseconds.try_into().ok()?))?;
    (since.as_secs() <= LAST_SECOND).then(|| SystemTime::UNIX_EPOCH + since)
}

/// The input, split into blocks.
struct Blocks<R> {
    input: R,
    /// What was read of the current block.
    block: Vec<u8>,
    /// Octets read so far.
    read: u64,
}

impl<R: BufRead> Blocks<R> {
    /// Reads on until the current block has `length` octets. False when the input ends before its first
    /// octet.
    fn fill(&mut self, length: usize) -> anyhow::Result<bool> {
        ensure!(length <= LONGEST_BLOCK, "{}: it is too long", self.bad_block());
        while self.block.len() < length {
            let buffered = match self.input.fill_buf() {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                buffered => buffered?,
            };
            if buffered.is_empty() {
                break;
            }
            let taken = buffered.len().min(length - self.block.len());
            self.block.extend_from_slice(&buffered[..taken]);
            self.input.consume(taken);
            self.read += taken as u64;
        }
        if self.block.is_empty() {
            return Ok(false);
        }
        ensure!(self.block.len() >= length, "the capture ends inside a block");
        Ok(true)
    }

    /// Reads the next pcapng block of a kind that is needed, completely. False at the end.
    fn next_pcapng(&mut self, big_endian: &mut bool) -> anyhow::Result<bool> {
        loop {
            // Of the first block, four octets were read to find out the format.
            if self.read > 4 {
                self.block.clear();
            }
            if !self.fill(12)? {
                return Ok(false);
            }
            let field = |at: usize, big_endian: bool| {
                let octets = [0, 1, 2, 3].map(|octet| self.block[at + octet]);
                if big_endian { u32::from_be_bytes(octets) } else { u32::from_le_bytes(octets) }
            };
            let kind = field(0, *big_endian);
            if kind == SHB_MAGIC {
                *big_endian = match field(8, true) {
                    0x1A2B_3C4D => true,
                    0x4D3C_2B1A => false,
                    _ => bail!("{}", self.bad_block()),
                };
            }
            let length = field(4, *big_endian) as usize;
            ensure!(length >= 12, "{}", self.bad_block());
            if [SHB_MAGIC, IDB_MAGIC, EPB_MAGIC, SPB_MAGIC].contains(&kind) {
                return self.fill(length);
            }
            let rest = length as u64 - 12;
            let skipped = io::copy(&mut self.input.by_ref().take(rest), &mut io::sink())?;
            self.read += skipped;
            ensure!(skipped == rest, "the capture ends inside a block");
        }
    }

    fn bad_block(&self) -> String {
        let begins = self.read - self.block.len() as u64;
        format!("the capture has a damaged block at octet {begins}")
    }
}

#[cfg(test)]
mod tests;
