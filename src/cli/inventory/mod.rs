//! `pnet-nat inventory`: which PROFINET devices there are, by asking them or from a capture.
//!
//! `targets` are the addresses, `scan` says what is sent when, `conversation` what one device is asked,
//! `asking` is the socket; `passive` reads captures. `assembly` puts answers together, `identification`
//! reads them into a `device`, and `print` is what is printed. Invariants: a device is read and never written, and a text of a device
//! cannot steer a terminal or a spreadsheet.

mod asking;
mod assembly;
mod conversation;
mod device;
mod identification;
mod passive;
mod print;
mod scan;
mod targets;
#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use super::decode::read_capture;
use super::output::out;
use super::{BAD_USE, complain, screen};
use crate::profinet::rpc::PORT;
use device::Device;
use passive::Passive;
use print::Format;
use scan::Pace;
use targets::Source;

/// List PROFINET devices with their identification (I&M): by asking them, or from a capture.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat inventory 172.17.17.0/24\n\
    \x20         pnet-nat inventory 198.51.100.1:20104 --format json\n\
    \x20         pnet-nat inventory capture.pcapng --format csv\n\
    Each device is asked for the list of its endpoint mapper, for I&M0FilterData, for I&M0 to I&M5 of each \
    submodule that has them, and for the neighbours of its ports, all by Read Implicit: without a connection, and nothing is written. An answer counts from \
    any port of the device, with the Activity UUID and the sequence number of the request. In CSV, a text \
    that a spreadsheet would take for a formula begins with an apostrophe. Ctrl-C ends it, and what was found \
    is printed. Exit codes: 0 there is a device, 1 there is none, 2 bad command line.")]
pub(super) struct Args {
    /// Addresses to ask: 172.17.17.7, 172.17.17.1-20, 172.17.17.0/24, or one with its port, such as a
    /// relay's public port: 198.51.100.1:20104. Or a capture (pcap, pcapng; - is the standard input) of
    /// others who ask: then nothing is sent.
    #[arg(value_name = "ADDRESS|FILE", required = true, value_parser = targets::source)]
    sources: Vec<Source>,

    /// UDP port of all devices whose port is not written.
    #[arg(
        long,
        value_name = "PORT",
        default_value_t = PORT,
        value_parser = clap::value_parser!(u16).range(1..),
        env = "PNET_NAT_PORT"
    )]
    port: u16,

    /// How long to wait for each answer.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_TIMEOUT"
    )]
    timeout: Duration,

    /// How often a request is sent again that has no answer.
    #[arg(long, value_name = "N", default_value = "1", env = "PNET_NAT_RETRIES")]
    retries: u32,

    /// The most requests in a second, to all devices together.
    #[arg(
        long,
        value_name = "N",
        default_value = "100",
        value_parser = clap::value_parser!(u32).range(1..=10_000),
        env = "PNET_NAT_RATE"
    )]
    rate: u32,

    /// Output: a table for people, one JSON object a device and line, or CSV with a line for each submodule.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// Asks or reads, and prints. The exit code is 1 when there is no device.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let files: Vec<_> = args.sources.iter().filter_map(Source::file).collect();
    let (mut devices, summary) = match files.len() {
        0 => {
            let targets = match targets::targets(&args.sources, args.port) {
                Ok(targets) => targets,
                Err(error) => return Ok(bad_use(error)),
            };
            let pace = Pace {
                interval: Duration::from_secs(1) / args.rate,
                timeout: args.timeout,
                retries: args.retries,
            };
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
            let (devices, asked) = runtime.block_on(asking::ask(targets, pace))?;
            let summary = format!("Answered: {} of {asked}", devices.len());
            (devices, summary)
        }
        1 if args.sources.len() == 1 => read(files[0])?,
        _ => return Ok(bad_use("name addresses, or one capture")),
    };
    devices.sort_by_key(Device::place);
    for device in &mut devices {
        device.submodules.sort_by_key(|submodule| (submodule.slot, submodule.subslot));
    }
    let mut out = out();
    print::print(&devices, args.format, screen::width(), &mut out)?;
    if args.format == Format::Text {
        writeln!(out, "{summary}")?;
    }
    Ok(if devices.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// The devices of a capture.
fn read(path: &Path) -> anyhow::Result<(Vec<Device>, String)> {
    let mut passive = Passive::default();
    read_capture(path, |seen| passive.note(&seen))?;
    let left_out = passive.left_out;
    let devices = passive.into_devices();
    let mut summary = format!("Devices: {}", devices.len());
    if left_out > 0 {
        summary += &format!(
            "; there was no room for more, and {left_out} answers of others were left out"
        );
    }
    Ok((devices, summary))
}

/// Says what is wrong with the command line, and returns the exit code.
fn bad_use(message: impl std::fmt::Display) -> ExitCode {
    complain(format_args!("pnet-nat: {message}"));
    ExitCode::from(BAD_USE)
}
