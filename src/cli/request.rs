//! `pnet-nat request`: asks server nodes behind a NAT router, as a remote client does.
//!
//! `peer::client` exchanges the datagrams; here are the options and the printed lines. Invariant: no
//! password is ever printed.

use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroU32;
use std::process::ExitCode;
use std::time::Duration;

use serde::Serialize;
use tokio::time::MissedTickBehavior;

use super::output::{Dotted, Format, Hex, out, print_json};
use super::password_file;
use crate::config::NodeRange;
use crate::peer::{Client, ExchangeError, Request, Target};
use crate::pnet::endpoint::client::Response;
use crate::pnet::wire::Password;

/// Ask server nodes behind a NAT router, as a remote client does.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat request --to 192.0.2.1 --start-port 40000 --node 1-4 \\\n\
    \x20                          --password-file secrets/section-1\n\
    Each request carries its number; a simulated node sends it back. Exit code 1: no answer came."
)]
pub(super) struct Args {
    /// Public address of the NAT router.
    #[arg(long, value_name = "ADDRESS", env = "PNET_NAT_TO")]
    to: IpAddr,

    /// Start port of the plant section: public port = start port + node address.
    #[arg(
        long,
        value_name = "PORT",
        value_parser = clap::value_parser!(u16).range(1..=65410),
        env = "PNET_NAT_START_PORT"
    )]
    start_port: u16,

    /// Node addresses, separated by commas: 4 or 1-4.
    #[arg(
        long,
        required = true,
        value_name = "NODE[-LAST]",
        value_delimiter = ',',
        env = "PNET_NAT_NODE"
    )]
    node: Vec<NodeRange>,

    /// File with exactly the 8 octets of the password, not accessible to others (mode 600).
    #[arg(
        long,
        value_name = "FILE",
        value_parser = password_file,
        env = "PNET_NAT_PASSWORD_FILE"
    )]
    password_file: Password,

    /// Number of requests to each node.
    #[arg(long, value_name = "N", default_value = "1", env = "PNET_NAT_COUNT")]
    count: NonZeroU32,

    /// Time from one round of requests to the next.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_INTERVAL"
    )]
    interval: Duration,

    /// How long to wait for each answer.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        value_parser = humantime::parse_duration,
        env = "PNET_NAT_TIMEOUT"
    )]
    timeout: Duration,

    /// Output: text for people, or one JSON object a line.
    #[arg(long, value_enum, default_value_t = Format::Text, env = "PNET_NAT_FORMAT")]
    format: Format,
}

/// Sends the requests; the exit code is 1 when no answer came.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(ask(args))
}

async fn ask(args: Args) -> anyhow::Result<ExitCode> {
    let target = Target::new(args.to.to_canonical(), args.start_port, Some(args.password_file));
    let mut client = Client::bind(target.clone()).await?;
    let mut rounds = tokio::time::interval(args.interval.max(Duration::from_micros(1)));
    rounds.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut out = out();
    let mut sent: u32 = 0;
    let mut round_trips = Vec::new();
    for _ in 0..args.count.get() {
        rounds.tick().await;
        for node_address in args.node.iter().flat_map(|nodes| nodes.0.clone()) {
            // In a capture, the number tells requests apart.
            let request = Request {
                node_address,
                beyond: &[],
                control_status: 0,
                data_octets: &sent.to_be_bytes(),
            };
            let outcome = client.exchange(&request, args.timeout).await;
            sent += 1;
            round_trips.extend(outcome.as_ref().ok().map(|(_, round_trip)| *round_trip));
            let to = target.socket_address(node_address);
            Line { node: node_address, to, outcome: (&outcome).into() }
                .print(args.format, &mut out)?;
        }
    }
    if args.count.get() > 1 {
        Summary::new(sent, &mut round_trips).print(args.format, &mut out)?;
    }
    Ok(if round_trips.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// One exchange, as it is printed.
#[derive(Debug, Serialize)]
struct Line {
    node: u8,
    to: SocketAddr,
    #[serde(flatten)]
    outcome: Outcome,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Outcome {
    Answered {
        round_trip_seconds: f64,
        destinations: Vec<u8>,
        sources: Vec<u8>,
        control_status: u8,
        data: String,
    },
    Failed {
        error: String,
    },
}

impl From<&Result<(Response, Duration), ExchangeError>> for Outcome {
    fn from(outcome: &Result<(Response, Duration), ExchangeError>) -> Self {
        match outcome {
            Ok((answer, round_trip)) => Self::Answered {
                round_trip_seconds: round_trip.as_secs_f64(),
                destinations: answer.destinations.to_vec(),
                sources: answer.sources.to_vec(),
                control_status: answer.control_status,
                data: Hex(&answer.data_octets).to_string(),
            },
            Err(error) => Self::Failed { error: error.to_string() },
        }
    }
}

impl Line {
    fn print(&self, format: Format, out: &mut impl Write) -> io::Result<()> {
        if format == Format::Json {
            return print_json(self, out);
        }
        write!(out, "node {} ({}): ", self.node, self.to)?;
        match &self.outcome {
            Outcome::Answered {
                round_trip_seconds,
                destinations,
                sources,
                control_status,
                data,
            } => {
                writeln!(
                    out,
                    "{:.3} ms, control-status ${control_status:02X}, data {}, route to {} from {}",
                    round_trip_seconds * 1e3,
                    if data.is_empty() { "none" } else { data },
                    Dotted(destinations),
                    Dotted(sources),
                )
            }
            Outcome::Failed { error } => writeln!(out, "{error}"),
        }
    }
}

/// All exchanges together, as they are printed.
#[derive(Debug, Serialize)]
struct Summary {
    sent: u32,
    answered: usize,
    lost: usize,
    #[serde(flatten)]
    round_trips: Option<RoundTrips>,
}

/// Round-trip times of all answers.
#[derive(Debug, Serialize)]
struct RoundTrips {
    min_seconds: f64,
    median_seconds: f64,
    max_seconds: f64,
}

impl Summary {
    fn new(sent: u32, round_trips: &mut [Duration]) -> Self {
        round_trips.sort_unstable();
        let answered = round_trips.len();
        let at = |index: usize| round_trips[index].as_secs_f64();
        Self {
            sent,
            answered,
            lost: sent as usize - answered,
            round_trips: (answered > 0).then(|| RoundTrips {
                min_seconds: at(0),
                median_seconds: (at((answered - 1) / 2) + at(answered / 2)) / 2.0,
                max_seconds: at(answered - 1),
            }),
        }
    }

    fn print(&self, format: Format, out: &mut impl Write) -> io::Result<()> {
        if format == Format::Json {
            return print_json(self, out);
        }
        write!(out, "sent {}, answered {}, lost {}", self.sent, self.answered, self.lost)?;
        if let Some(times) = &self.round_trips {
            write!(
                out,
                "; min {:.3} ms, median {:.3} ms, max {:.3} ms",
                times.min_seconds * 1e3,
                times.median_seconds * 1e3,
                times.max_seconds * 1e3
            )?;
        }
        writeln!(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_takes_the_middle_of_the_round_trips() {
        let summary = |millis: &[u64]| {
            let mut times: Vec<_> = millis.iter().copied().map(Duration::from_millis).collect();
            let mut out = Vec::new();
            Summary::new(4, &mut times).print(Format::Text, &mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert_eq!(
            summary(&[9, 1, 2]),
            "sent 4, answered 3, lost 1; min 1.000 ms, median 2.000 ms, max 9.000 ms\n"
        );
        assert_eq!(
            summary(&[9, 1, 2, 4]),
            "sent 4, answered 4, lost 0; min 1.000 ms, median 3.000 ms, max 9.000 ms\n"
        );
        assert_eq!(summary(&[]), "sent 4, answered 0, lost 4\n");
    }
}
