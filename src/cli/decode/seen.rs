//! A capture for other commands: what is in it, without anything that this one makes of it.

use std::cell::RefCell;
use std::io::{BufRead, BufReader, Cursor, Read, sink};
use std::net::SocketAddr;
use std::path::Path;

use anyhow::{Context, ensure};

use super::input::{self, Input};
use super::packet::{self, Found};
use super::stop::Stop;
use super::{BUFFER, capture, profinet};
use crate::profinet::MacAddress;

/// Something in a capture.
pub(in crate::cli) enum Seen<'a> {
    /// A UDP datagram that was captured whole, in one IP packet.
    Udp { from: SocketAddr, octets: &'a [u8] },
    /// The payload of a frame of RT or LLDP, behind its tags, as far as it was captured.
    Frame { from: MacAddress, ether_type: u16, octets: &'a [u8] },
}

/// Calls `each` with all that is in a capture, until its end or a signal. The calling thread must be the
/// only one.
pub(in crate::cli) fn read_capture(
    path: &Path,
    mut each: impl FnMut(Seen<'_>),
) -> anyhow::Result<()> {
    let (file, name) = input::open(path)?;
    let (stop, output) = (Stop::at_signals()?, RefCell::new(sink()));
    let input = BufReader::with_capacity(BUFFER, Input::new(file, &output, stop.clone()));
    let read = packets(input, |captured| {
        if let Some(profinet::Ethernet { from, ether_type, octets, .. }) =
            profinet::frame(&captured)
        {
            return each(Seen::Frame { from, ether_type, octets });
        }
        if let Ok(Some(Found::Datagram(udp))) = packet::find(captured.link, captured.octets)
            && udp.octets.len() == udp.length
        {
            each(Seen::Udp { from: udp.from, octets: udp.octets });
        }
    });
    // A signal may have ended the input inside a block.
    if stop.has_come() { Ok(()) } else { read.context(name) }
}

fn packets(
    mut input: impl BufRead,
    mut each: impl FnMut(capture::Captured<'_>),
) -> anyhow::Result<()> {
    let mut beginning = Vec::new();
    input.by_ref().take(4).read_to_end(&mut beginning)?;
    ensure!(capture::is_magic(&beginning), "neither pcap nor pcapng");
    capture::read(Cursor::new(beginning).chain(input), |captured| {
        each(captured);
        Ok(())
    })
}
