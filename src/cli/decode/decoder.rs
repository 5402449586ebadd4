//! From captured packets and lines of text to what is printed.

use std::cell::RefCell;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::time::SystemTime;

use serde::Serialize;

use super::capture::Captured;
use super::complain;
use super::fields::Fields;
use super::fragments::{Broken, Fragments, Outcome, Partial};
use super::line::{Line, Locator, Reason, Unanswered};
use super::packet::{self, Found, Udp};
use super::pairing::{Asked, Pairing, Request};
use super::printer::Printer;
use super::profinet::{
    self, Connections, Ethernet, FrameLine, ProfinetReport, ProfinetSummary, Protocol, RpcFields,
    RpcFragments, Shown,
};
use super::row::{self, InRow};
use super::settings::Settings;
use super::stop::Stop;
use super::summary::{Report, Summary};
use crate::cli::output::{Format, print_json};
use crate::pnet::wire::Datagram;

/// Shows the datagrams of one input.
pub(super) struct Decoder<'a, W> {
    settings: Settings,
    output: &'a RefCell<W>,
    fragments: Fragments,
    pairing: Pairing,
    summary: Summary,
    profinet: ProfinetSummary,
    rpc_fragments: RpcFragments,
    connections: Connections,
    printer: Printer<'a, W>,
    unknown_link: Option<i32>,
}

impl<'a, W: Write> Decoder<'a, W> {
    pub(super) fn new(settings: Settings, output: &'a RefCell<W>) -> Self {
        let printer = Printer::new(&settings, output);
        Self {
            settings,
            output,
            fragments: Fragments::default(),
            pairing: Pairing::default(),
            summary: Summary::default(),
            profinet: ProfinetSummary::default(),
            rpc_fragments: RpcFragments::default(),
            connections: Connections::default(),
            printer,
            unknown_link: None,
        }
    }

    /// Shows a datagram that was written as text.
    pub(super) fn text(&mut self, line: u64, octets: &[u8]) -> io::Result<()> {
        self.payload(Place { at: Locator::Text { line }, fragments: None }, octets, octets.len())
    }

    /// Shows what is in a captured packet.
    pub(super) fn packet(&mut self, captured: &Captured<'_>) -> io::Result<()> {
        let &Captured { number, time, link, octets, .. } = captured;
        while let Some(partial) = self.fragments.overdue(time) {
            self.broken(&partial, Broken::Missing)?;
        }
        while let Some(request) = self.pairing.overdue(time) {
            self.unanswered(&request, Reason::Time)?;
        }
        if let Some(frame) = profinet::frame(captured) {
            return self.frame(captured, &frame);
        }
        // RPC says which submodules cyclic data is of.
        let on_ip = [Protocol::PNet, Protocol::ProfinetRpc, Protocol::ProfinetRt];
        if !on_ip.iter().any(|protocol| self.settings.shows(*protocol)) {
            return Ok(());
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

    /// Shows a frame of PROFINET, or of a protocol beside it.
    fn frame(&mut self, captured: &Captured<'_>, frame: &Ethernet<'_>) -> io::Result<()> {
        let (protocol, fields) = profinet::Fields::of(frame, &self.connections);
        if !self.settings.shows(protocol) {
            return Ok(());
        }
        self.profinet.frame(frame, (protocol, &fields), captured.time);
        self.printer.print(&FrameLine {
            frame: captured.number,
            time: captured.time,
            from: Shown(frame.from),
            to: frame.to.map(Shown),
            vlan: frame.vlan,
            protocol,
            fields,
        })
    }

    fn udp(
        &mut self,
        captured: &Captured<'_>,
        udp: &Udp<'_>,
        fragments: Option<u64>,
    ) -> io::Result<()> {
        let &Udp { from, to, octets, length } = udp;
        if !self.is_wanted(from, to)
            && let Some(fields) = RpcFields::of(octets, [from.port(), to.port()])
        {
            return self.rpc(captured, [from, to], fields);
        }
        if !self.settings.shows(Protocol::PNet) {
            return Ok(());
        }
        if !self.is_wanted(from, to) {
            // It may still be an answer from another port than was asked.
            let Ok(datagram) = Datagram::parse(octets, self.settings.header) else { return Ok(()) };
            let (packet, time) = (captured.number, captured.time);
            if self.pairing.answer(&datagram, packet, time, [from, to]).is_none() {
                return Ok(());
            }
        }
        let at = Locator::Capture { packet: captured.number, time: captured.time, from, to };
        self.payload(Place { at, fragments }, octets, length)
    }

    /// Shows a datagram of PROFINET's RPC, with the whole call if this is the fragment that was missing.
    fn rpc(
        &mut self,
        captured: &Captured<'_>,
        [from, to]: [SocketAddr; 2],
        fields: RpcFields<'_>,
    ) -> io::Result<()> {
        let whole = self.rpc_fragments.add(&fields);
        let fields = match &whole {
            Some(stub) => fields.with_call(stub),
            None => fields,
        };
        fields.teach(&mut self.connections);
        if !self.settings.shows(Protocol::ProfinetRpc) {
            return Ok(());
        }
        self.profinet.rpc(&fields);
        self.printer.print(&FrameLine {
            frame: captured.number,
            time: captured.time,
            from: Shown(from),
            to: Some(Shown(to)),
            vlan: None,
            protocol: Protocol::ProfinetRpc,
            fields,
        })
    }

    /// Names a datagram that was not put together.
    fn broken(&mut self, partial: &Partial, why: Broken) -> io::Result<()> {
        let Some(head) = partial.head else {
            self.summary.lost_fragments += partial.fragments;
            return Ok(());
        };
        if !self.is_wanted(head.from, head.to) {
            return Ok(());
        }
        let Partial { packet, time, .. } = *partial;
        let at = Locator::Capture { packet, time, from: head.from, to: head.to };
        self.datagram(Place { at, fragments: None }, None, Fields::of_broken(head, why))
    }

    fn is_wanted(&self, from: SocketAddr, to: SocketAddr) -> bool {
        self.is_server(to) || self.is_server(from)
    }

    fn is_server(&self, address: SocketAddr) -> bool {
        self.settings.ports.contains(address.port())
    }

    /// Shows what was still open at the end of a capture, and then the summary.
    pub(super) fn finish(&mut self, stop: &Stop) -> io::Result<()> {
        while let Some(partial) = self.fragments.next() {
            self.broken(&partial, Broken::Missing)?;
        }
        while let Some(request) = self.pairing.next() {
            self.unanswered(&request, Reason::End)?;
        }
        if !self.profinet.is_empty() {
            let report = self.profinet.report();
            let mut output = self.output.borrow_mut();
            match self.settings.format {
                Format::Text => write!(output, "{report}")?,
                Format::Json => print_json(&InJson::ProfinetSummary(&report), &mut *output)?,
            }
        }
        if self.summary.datagrams > 0 {
            let report = self.summary.report(stop.has_come(), |server| self.settings.name(server));
            let mut output = self.output.borrow_mut();
            match self.settings.format {
                Format::Text => write!(output, "{report}")?,
                Format::Json => print_json(&InJson::Summary(&report), &mut *output)?,
            }
        }
        Ok(())
    }

    /// Says on stderr what of a capture was not shown.
    pub(super) fn tell_what_was_left_out(&self) {
        if let Some(link) = self.unknown_link {
            complain(format_args!(
                "packets of link type {link} were left out; Ethernet, raw IP, Linux cooked and \
                 loopback are read"
            ));
        }
        if self.summary.datagrams == 0 && self.profinet.is_empty() {
            complain("no datagram on these ports; --ports adds others");
        }
    }

    /// A payload of `length` octets: one datagram, or a row of them.
    fn payload(&mut self, place: Place, octets: &[u8], length: usize) -> io::Result<()> {
        let header = self.settings.header;
        let row = row::datagrams(octets, header).filter(|_| octets.len() == length);
        let Some(row) = row else {
            return self.datagram(place, None, Fields::of(octets, length, header));
        };
        let datagrams = row.len();
        (1..).zip(row).try_for_each(|(datagram, octets)| {
            let in_row = Some(InRow { datagram, datagrams });
            self.datagram(place, in_row, Fields::of(octets, octets.len(), header))
        })
    }

    fn datagram(
        &mut self,
        Place { at, fragments }: Place,
        in_row: Option<InRow>,
        fields: Fields<'_>,
    ) -> io::Result<()> {
        let mut asked = None;
        if let Locator::Capture { packet, time, from, to } = at {
            self.summary.datagrams += 1;
            match fields.datagram() {
                Some(datagram) => asked = self.pair(datagram, packet, time, [from, to])?,
                None => self.summary.malformed(if self.is_server(to) { to } else { from }),
            }
        }
        let answer = asked.map(Into::into);
        let (frame, protocol) = (at.packet(), Protocol::PNet);
        let line = Line { place: at, frame, protocol, fragments, in_row, fields, answer };
        let mut output = self.output.borrow_mut();
        match self.settings.format {
            Format::Text if self.settings.is_verbose => line.write_tree(&mut *output),
            Format::Text => line.write_text(&mut *output),
            Format::Json => print_json(&line, &mut *output),
        }
    }

    /// The request that a datagram answers, if it answers one. A request itself is noted.
    fn pair(
        &mut self,
        datagram: &Datagram<'_>,
        packet: u64,
        time: Option<SystemTime>,
        ends: [SocketAddr; 2],
    ) -> io::Result<Option<Asked>> {
        let [is_from_server, is_to_server] = ends.map(|end| self.is_server(end));
        let request = Request::of(datagram, packet, time, ends);
        // Two nodes may ask each other from port to port, so there a request is never an answer.
        if request.is_none() || !is_to_server {
            let asked = self.pairing.answer(datagram, packet, time, ends);
            if let Some(asked) = asked {
                self.summary.answer(&asked);
                return Ok(Some(asked));
            }
        }
        match request {
            Some(request) => {
                self.summary.request(&request);
                if let Some(evicted) = self.pairing.ask(request) {
                    self.unanswered(&evicted, Reason::Room)?;
                }
            }
            None if is_from_server && !is_to_server => self.summary.unasked += 1,
            None => {}
        }
        Ok(None)
    }

    fn unanswered(&mut self, request: &Request, reason: Reason) -> io::Result<()> {
        self.summary.unanswered(request);
        let unanswered = Unanswered::new(request, reason);
        let mut output = self.output.borrow_mut();
        match self.settings.format {
            Format::Text => writeln!(output, "{unanswered}"),
            Format::Json => print_json(&InJson::Unanswered(&unanswered), &mut *output),
        }
    }
}

/// Where a payload was found, and how many fragments it came in, if it did.
#[derive(Clone, Copy)]
struct Place {
    at: Locator,
    fragments: Option<u64>,
}

/// What stands in JSON beside datagrams: an object of one field, which is its kind.
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum InJson<'a> {
    Unanswered(&'a Unanswered),
    Summary(&'a Report<'a>),
    ProfinetSummary(&'a ProfinetReport),
}

#[cfg(test)]
mod tests;
