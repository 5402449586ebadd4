//! `pnet-nat decode`: shows the datagrams of hex text or of a capture.
//!
//! `capture` reads pcap and pcapng, `packet` finds the UDP payload in a packet, `hex` reads text, `row`
//! splits a packet that the kernel would have split later, `line` is what is printed. Invariants: no
//! password is ever printed, and any input is read as a stream with a bounded buffer.

mod capture;
mod hex;
mod line;
mod packet;
mod row;

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write, stdin};
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use anyhow::{Context, ensure};

use super::complain;
use super::output::{Format, out, print_json};
use crate::pnet::wire::{Header, NORMAL_PORT, SECURE_PORT};
use line::{Fields, Line, Locator};
use row::InRow;

/// Show the datagrams of hex text or of a capture (pcap, pcapng), without their passwords.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat decode capture.pcapng --ports 40001-40125\n\
    Example:  tcpdump -i eth0 -U -w - udp | pnet-nat decode --format json -\n\
    Hex text has one datagram a line: 02000000 04830000. Spaces and colons between octets are\n\
    ignored, and so is everything after #. A capture on the router itself can show a burst as one\n\
    packet, because the kernel splits it later: then each datagram has a line, marked like 1 of 11.\n\
    Exit code 1: the input cannot be read to its end.")]
pub(super) struct Args {
    /// Hex text, pcap or pcapng; - is the standard input.
    #[arg(value_name = "FILE", default_value = "-")]
    file: PathBuf,

    /// UDP ports to show in addition to 34378 and 34379, separated by commas: the public ports.
    #[arg(long, value_name = "PORT[-LAST]", value_delimiter = ',', env = "PNET_NAT_PORTS")]
    ports: Vec<PortRange>,

    /// The four octets that every datagram begins with.
    #[arg(long, value_name = "OCTETS", default_value_t, env = "PNET_NAT_HEADER")]
    header: Header,

    /// Output: text for people, or one JSON object a line.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// A range of ports: `40001-40125`, or one port: `40200`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PortRange {
    first: u16,
    last: u16,
}

impl PortRange {
    /// The Normal and the Secure port (PAS 11).
    const P_NET: Self = Self { first: NORMAL_PORT, last: SECURE_PORT };

    fn contains(self, port: u16) -> bool {
        (self.first..=self.last).contains(&port)
    }
}

impl FromStr for PortRange {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        let port = |text: &str| text.parse::<u16>().context("a port is 1 to 65535");
        let (first, last) = (port(first)?, port(last)?);
        ensure!(0 < first && first <= last, "write ports like 40001-40125, the lower one first");
        Ok(Self { first, last })
    }
}

/// Shows all datagrams of the input.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let (input, name): (Box<dyn Read>, _) = if args.file.as_os_str() == "-" {
        (Box::new(stdin()), "standard input".to_owned())
    } else {
        let name = args.file.display().to_string();
        (Box::new(File::open(&args.file).with_context(|| name.clone())?), name)
    };
    decode(BufReader::new(input), &args, &mut out()).context(name)?;
    Ok(ExitCode::SUCCESS)
}

fn decode(mut input: impl BufRead, args: &Args, out: &mut impl Write) -> anyhow::Result<()> {
    let mut print = |place, in_row, octets: &[u8], length| {
        let line = Line { place, in_row, fields: Fields::of(octets, length, args.header) };
        match args.format {
            Format::Text => writeln!(out, "{line}"),
            Format::Json => print_json(&line, out),
        }
    };
    let mut show = |place, octets: &[u8], length| -> io::Result<()> {
        let row = row::datagrams(octets, args.header).filter(|_| octets.len() == length);
        let Some(row) = row else {
            return print(place, None, octets, length);
        };
        let datagrams = row.len();
        (1..).zip(row).try_for_each(|(datagram, octets)| {
            print(place, Some(InRow { datagram, datagrams }), octets, octets.len())
        })
    };
    let mut beginning = Vec::new();
    input.by_ref().take(4).read_to_end(&mut beginning)?;
    let is_capture = capture::is_magic(&beginning);
    let input = io::Cursor::new(beginning).chain(input);
    if !is_capture {
        return hex::read(input, |line, octets| {
            Ok(show(Locator::Text { line }, octets, octets.len())?)
        });
    }

    let (mut shown, mut unknown_link) = (0_u64, None);
    capture::read(input, |captured| {
        let Ok(found) = packet::datagram(captured.link, captured.octets) else {
            unknown_link = Some(captured.link.0);
            return Ok(());
        };
        let ports = || args.ports.iter().copied().chain([PortRange::P_NET]);
        let is_wanted = |port| ports().any(|range| range.contains(port));
        if let Some(udp) =
            found.filter(|udp| is_wanted(udp.to.port()) || is_wanted(udp.from.port()))
        {
            shown += 1;
            let (packet, time) = (captured.number, captured.time);
            let place = Locator::Capture { packet, time, from: udp.from, to: udp.to };
            show(place, udp.octets, udp.length)?;
        }
        Ok(())
    })?;
    if let Some(link) = unknown_link {
        complain(format_args!(
            "packets of link type {link} were left out; Ethernet, raw IP, Linux cooked and \
             loopback are read"
        ));
    }
    if shown == 0 {
        complain("no datagram on these ports; --ports adds others");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_read_as_ranges() {
        let range = |text: &str| text.parse::<PortRange>();
        assert_eq!(range("40001-40125").unwrap(), PortRange { first: 40001, last: 40125 });
        assert_eq!(range("40200").unwrap(), PortRange { first: 40200, last: 40200 });
        for bad in ["", "0", "40125-40001", "40001-", "65536", "40001-40002-3"] {
            assert!(range(bad).is_err(), "{bad:?}");
        }
    }
}
