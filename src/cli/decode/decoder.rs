//! From captured packets and lines of text to what is printed.

use std::cell::RefCell;
use std::io::{self, Write};
use std::net::SocketAddr;

use super::capture::Captured;
use super::complain;
use super::fragments::{Broken, Fragments, Outcome, Partial};
use super::line::{Fields, Line, Locator};
use super::packet::{self, Found, Udp};
use super::ports::Ports;
use super::row::{self, InRow};
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
    fragments: Fragments,
    shown: u64,
    unknown_link: Option<i32>,
}

impl<'a, W: Write> Decoder<'a, W> {
    pub(super) fn new(settings: Settings, output: &'a RefCell<W>) -> Self {
        Self { settings, output, fragments: Fragments::default(), shown: 0, unknown_link: None }
    }

    /// Shows a datagram that was written as text.
    pub(super) fn text(&mut self, line: u64, octets: &[u8]) -> io::Result<()> {
        self.payload(Place { at: Locator::Text { line }, fragments: None }, octets, octets.len())
    }

    /// Shows what is in a captured packet.
    pub(super) fn packet(&mut self, captured: &Captured<'_>) -> io::Result<()> {
        let &Captured { number, time, link, octets } = captured;
        while let Some(partial) = self.fragments.overdue(time) {
            self.broken(&partial, Broken::Missing)?;
        }
        match packet::find(link, octets) {
            Ok(Some(Found::Datagram(udp))) => self.udp(captured, &udp, None),
            Ok(Some(Found::Fragment(fragment))) => {
                match self.fragments.add(number, time, &fragment) {
                    Outcome::Waits => Ok(()),
                    Outcome::Broken(partial, why) => self.broken(&partial, why),
                    Outcome::Whole(whole) => match whole.udp() {
                        Some(udp) => self.udp(captured, &udp, Some(whole.fragments)),
                        None => Ok(()),
                    },
                }
            }
            Ok(None) => Ok(()),
            Err(packet::UnknownLink) => {
                self.unknown_link = Some(link.0);
                Ok(())
            }
        }
    }

    fn udp(
        &mut self,
        captured: &Captured<'_>,
        udp: &Udp<'_>,
        fragments: Option<usize>,
    ) -> io::Result<()> {
        let &Udp { from, to, octets, length } = udp;
        if !self.is_wanted(from, to) {
            return Ok(());
        }
        let at = Locator::Capture { packet: captured.number, time: captured.time, from, to };
        self.payload(Place { at, fragments }, octets, length)
    }

    /// Names a datagram that was not put together.
    fn broken(&mut self, partial: &Partial, why: Broken) -> io::Result<()> {
        let Some(head) = partial.head.filter(|head| self.is_wanted(head.from, head.to)) else {
            return Ok(());
        };
        let Partial { packet, time, .. } = *partial;
        let at = Locator::Capture { packet, time, from: head.from, to: head.to };
        let fields = Fields::of_broken(head, why);
        self.print(&Line { place: at, fragments: None, in_row: None, fields })
    }

    fn is_wanted(&self, from: SocketAddr, to: SocketAddr) -> bool {
        let ports = &self.settings.ports;
        ports.contains(to.port()) || ports.contains(from.port())
    }

    /// Shows what was still open, and says what was left out of a capture.
    pub(super) fn finish(mut self) -> io::Result<()> {
        while let Some(partial) = self.fragments.next() {
            self.broken(&partial, Broken::Missing)?;
        }
        if let Some(link) = self.unknown_link {
            complain(format_args!(
                "packets of link type {link} were left out; Ethernet, raw IP, Linux cooked and \
                 loopback are read"
            ));
        }
        if self.shown == 0 {
            complain("no datagram on these ports; --ports adds others");
        }
        Ok(())
    }

    /// A payload of `length` octets: one datagram, or a row of them.
    fn payload(&mut self, place: Place, octets: &[u8], length: usize) -> io::Result<()> {
        let header = self.settings.header;
        let Place { at, fragments } = place;
        let row = row::datagrams(octets, header).filter(|_| octets.len() == length);
        let Some(row) = row else {
            let fields = Fields::of(octets, length, header);
            return self.print(&Line { place: at, fragments, in_row: None, fields });
        };
        let datagrams = row.len();
        (1..).zip(row).try_for_each(|(datagram, octets)| {
            let in_row = Some(InRow { datagram, datagrams });
            let fields = Fields::of(octets, octets.len(), header);
            self.print(&Line { place: at, fragments, in_row, fields })
        })
    }

    fn print(&mut self, line: &Line<'_>) -> io::Result<()> {
        self.shown += 1;
        let mut output = self.output.borrow_mut();
        match self.settings.format {
            Format::Text => writeln!(output, "{line}"),
            Format::Json => print_json(line, &mut *output),
        }
    }
}

/// Where a payload was found, and how many fragments it came in, if it did.
struct Place {
    at: Locator,
    fragments: Option<usize>,
}
