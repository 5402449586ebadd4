//! From captured packets and lines of text to what is printed.

use std::cell::RefCell;
use std::io::{self, Write};

use super::capture::Captured;
use super::line::{Fields, Line, Locator};
use super::ports::Ports;
use super::row::{self, InRow};
use super::{complain, packet};
use crate::cli::output::{Format, print_json};
use crate::pnet::wire::Header;

/// What is looked at, and how it is shown.
pub(super) struct Settings {
    pub(super) ports: Ports,
    pub(super) header: Header,
    pub(super) format: Format,
}

/// Shows the datagrams of one input.
pub(super) struct Decoder<'a, W> {
    settings: Settings,
    output: &'a RefCell<W>,
    shown: u64,
    unknown_link: Option<i32>,
}

impl<'a, W: Write> Decoder<'a, W> {
    pub(super) fn new(settings: Settings, output: &'a RefCell<W>) -> Self {
        Self { settings, output, shown: 0, unknown_link: None }
    }

    /// Shows a datagram that was written as text.
    pub(super) fn text(&mut self, line: u64, octets: &[u8]) -> io::Result<()> {
        self.payload(Locator::Text { line }, octets, octets.len())
    }

    /// Shows what is in a captured packet.
    pub(super) fn packet(&mut self, captured: &Captured<'_>) -> io::Result<()> {
        let Ok(found) = packet::datagram(captured.link, captured.octets) else {
            self.unknown_link = Some(captured.link.0);
            return Ok(());
        };
        let Some(udp) = found else { return Ok(()) };
        let (from, to) = (udp.from, udp.to);
        let ports = &self.settings.ports;
        if !ports.contains(to.port()) && !ports.contains(from.port()) {
            return Ok(());
        }
        let place = Locator::Capture { packet: captured.number, time: captured.time, from, to };
        self.payload(place, udp.octets, udp.length)
    }

    /// Says what was left out of a capture.
    pub(super) fn finish(self) {
        if let Some(link) = self.unknown_link {
            complain(format_args!(
                "packets of link type {link} were left out; Ethernet, raw IP, Linux cooked and \
                 loopback are read"
            ));
        }
        if self.shown == 0 {
            complain("no datagram on these ports; --ports adds others");
        }
    }

    /// A payload of `length` octets: one datagram, or a row of them.
    fn payload(&mut self, place: Locator, octets: &[u8], length: usize) -> io::Result<()> {
        let row = row::datagrams(octets, self.settings.header);
        let Some(row) = row.filter(|_| octets.len() == length) else {
            return self.datagram(place, None, octets, length);
        };
        let datagrams = row.len();
        (1..).zip(row).try_for_each(|(datagram, octets)| {
            self.datagram(place, Some(InRow { datagram, datagrams }), octets, octets.len())
        })
    }

    fn datagram(
        &mut self,
        place: Locator,
        in_row: Option<InRow>,
        octets: &[u8],
        length: usize,
    ) -> io::Result<()> {
        self.shown += 1;
        let line = Line { place, in_row, fields: Fields::of(octets, length, self.settings.header) };
        let mut output = self.output.borrow_mut();
        match self.settings.format {
            Format::Text => writeln!(output, "{line}"),
            Format::Json => print_json(&line, &mut *output),
        }
    }
}
