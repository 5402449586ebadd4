//! `pnet-nat decode`: shows the datagrams of hex text or of a capture.
//!
//! `input` is the stream, `capture` reads pcap and pcapng, `packet` finds the UDP payload in a packet,
//! `fragments` puts it together, `hex` reads text, `row` splits a packet that the kernel would have split
//! later. `pairing` joins answers with their requests. `decoder` calls them all; what it prints is in
//! `line`, `fields` and `summary`. Invariants: no password is ever printed, and memory has a bound, whatever the
//! input holds.

mod capture;
mod decoder;
mod fields;
mod fragments;
mod hex;
mod input;
mod line;
mod packet;
mod pairing;
mod ports;
mod printer;
mod profinet;
mod progress;
mod row;
mod seen;
mod settings;
mod stop;
mod summary;

pub(super) use hex::octets;
pub(super) use seen::{Seen, read_capture};

use std::cell::RefCell;
use std::io::{BufRead, BufReader, BufWriter, Cursor, Read, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::builder::BoolishValueParser;

use super::complain;
use super::output::{Format, out};
use crate::pnet::wire::Header;
use decoder::Decoder;
use input::Input;
use ports::PortRange;
use profinet::Protocol;
use settings::Settings;
use stop::Stop;

/// Octets that are read, and written, at once.
const BUFFER: usize = 1 << 18;

/// Show the datagrams of hex text or of a capture (pcap, pcapng), without their passwords, and the PROFINET of a
/// capture.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat decode capture.pcapng --ports 20001-20125\n\
    Example:  tcpdump -i eth0 -U -w - udp | pnet-nat decode --format json -\n\
    Example:  pnet-nat decode plant.pcapng --protocol profinet-dcp,profinet-alarm,lldp -v\n\
    Hex text has one datagram a line: 02000000 04830000. Spaces and colons between octets are\n\
    ignored, and so is everything after #. A capture on the router itself can show a burst as one\n\
    packet, because the kernel splits it later: then each datagram has a line, marked like 1 of 11.\n\
    Datagrams in IP fragments are put together. In a capture, an answer shows its request and the time\n\
    since then. A request without an answer has a line of its own after 10 s of the capture, or at its\n\
    end. Then comes a summary. Ctrl-C ends a capture like its end.\n\
    Exit code 1: the input cannot be read to its end.")]
pub(super) struct Args {
    /// Hex text, pcap or pcapng; - is the standard input.
    #[arg(value_name = "FILE", default_value = "-")]
    file: PathBuf,

    /// UDP ports to show in addition to 34378 and 34379, separated by commas: the public ports.
    #[arg(long, value_name = "PORT[-LAST]", value_delimiter = ',', env = "PNET_NAT_PORTS")]
    ports: Vec<PortRange>,

    /// Protocols to show, separated by commas; all where this is left out. A plant sends thousands of RT
    /// frames a second.
    #[arg(long, value_enum, value_delimiter = ',', env = "PNET_NAT_PROTOCOL")]
    protocol: Vec<Protocol>,

    /// A configuration of the relay: its public ports, the ports of its servers and its header are taken
    /// from there, and the summary has the names of its nets.
    #[arg(short, long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,

    /// The four octets that every datagram begins with [default: that of --config, otherwise 02000000].
    #[arg(long, value_name = "OCTETS", env = "PNET_NAT_HEADER")]
    header: Option<Header>,

    /// Output: text for people, or one JSON object a line.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,

    /// Show each datagram as a tree, with a line for each field. JSON has all fields in any case.
    #[arg(short, long, env = "PNET_NAT_VERBOSE", value_parser = BoolishValueParser::new())]
    verbose: bool,
}

/// Shows all datagrams of the input.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let settings = match Settings::new(&args) {
        Ok(settings) => settings,
        Err(code) => return Ok(code),
    };
    let (file, name) = input::open(&args.file)?;
    let stop = Stop::at_signals()?;
    let output = RefCell::new(BufWriter::with_capacity(BUFFER, out()));
    let input = BufReader::with_capacity(BUFFER, Input::new(file, &output, stop.clone()));
    decode(input, Decoder::new(settings, &output), &stop).context(name)?;
    output.into_inner().flush()?;
    Ok(ExitCode::SUCCESS)
}

fn decode(
    mut input: impl BufRead,
    mut decoder: Decoder<'_, impl Write>,
    stop: &Stop,
) -> anyhow::Result<()> {
    let mut beginning = Vec::new();
    input.by_ref().take(4).read_to_end(&mut beginning)?;
    let is_capture = capture::is_magic(&beginning);
    let input = Cursor::new(beginning).chain(input);
    let read = if is_capture {
        capture::read(input, |captured| Ok(decoder.packet(&captured)?))
    } else {
        hex::read(input, |line, octets| Ok(decoder.text(line, octets)?))
    };
    // Of a capture that is damaged or cut off, what there was is still told.
    if is_capture {
        decoder.finish(stop)?;
    }
    // A signal may have ended the input inside a block or a line.
    if !stop.has_come() {
        read?;
    }
    if is_capture {
        decoder.tell_what_was_left_out();
    }
    Ok(())
}
