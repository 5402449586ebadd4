//! What is printed: a line for each request, and statistics.

use std::io::{self, Write};
use std::net::SocketAddr;
use std::time::Duration;

use serde::Serialize;

use crate::cli::output::{Dotted, Format, Hex, print_json};
use crate::peer::Share;
use crate::pnet::endpoint::client::{Outcome, Response};

/// One request, as it is printed.
#[derive(Debug, Serialize)]
pub(super) struct Line {
    pub(super) node: u8,
    pub(super) to: SocketAddr,
    #[serde(flatten)]
    pub(super) result: Result,
    /// How often it was sent again.
    pub(super) retries: u32,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Result {
    Answered {
        round_trip_seconds: f64,
        destinations: Vec<u8>,
        sources: Vec<u8>,
        control_status: u8,
        data: String,
    },
    Sent {
        unconfirmed: bool,
    },
    Failed {
        error: String,
    },
}

impl From<&Outcome> for Result {
    fn from(outcome: &Outcome) -> Self {
        match outcome {
            Outcome::Answered(response) => {
                let Response { destinations, sources, control_status, data_octets, round_trip } =
                    response;
                Self::Answered {
                    round_trip_seconds: round_trip.as_secs_f64(),
                    destinations: destinations.to_vec(),
                    sources: sources.to_vec(),
                    control_status: *control_status,
                    data: Hex(data_octets).to_string(),
                }
            }
            Outcome::Sent => Self::Sent { unconfirmed: true },
            Outcome::Lost(loss) => Self::Failed { error: loss.to_string() },
        }
    }
}

impl Line {
    pub(super) fn print(&self, format: Format, out: &mut impl Write) -> io::Result<()> {
        if format == Format::Json {
            return print_json(self, out);
        }
        write!(out, "node {} ({}): ", self.node, self.to)?;
        match &self.result {
            Result::Answered {
                round_trip_seconds,
                destinations,
                sources,
                control_status,
                data,
            } => {
                write!(
                    out,
                    "{:.3} ms, control-status ${control_status:02X}, data {}, route to {} from {}",
                    round_trip_seconds * 1e3,
                    if data.is_empty() { "none" } else { data },
                    Dotted(destinations),
                    Dotted(sources),
                )?;
                match self.retries {
                    0 => writeln!(out),
                    1 => writeln!(out, ", sent again once"),
                    times => writeln!(out, ", sent again {times} times"),
                }
            }
            Result::Sent { .. } => writeln!(out, "sent; nobody answers a broadcast"),
            Result::Failed { error } => writeln!(out, "{error}"),
        }
    }
}

/// What became of requests, of one node or of all.
#[derive(Clone, Debug, Default)]
pub(super) struct Statistics {
    sent: u64,
    unconfirmed: u64,
    lost: u64,
    retried: u64,
    round_trips: Vec<Duration>,
}

impl Statistics {
    /// Notes what became of a request; none if it was given up before anything did.
    pub(super) fn note(&mut self, outcome: Option<&Outcome>, retries: u32) {
        self.sent += 1;
        self.retried += u64::from(retries);
        match outcome {
            Some(Outcome::Answered(response)) => self.round_trips.push(response.round_trip),
            Some(Outcome::Sent) => self.unconfirmed += 1,
            Some(Outcome::Lost(_)) | None => self.lost += 1,
        }
    }

    pub(super) fn sum(all: &[Self]) -> Self {
        Self {
            sent: all.iter().map(|it| it.sent).sum(),
            unconfirmed: all.iter().map(|it| it.unconfirmed).sum(),
            lost: all.iter().map(|it| it.lost).sum(),
            retried: all.iter().map(|it| it.retried).sum(),
            round_trips: all.iter().flat_map(|it| it.round_trips.iter().copied()).collect(),
        }
    }

    /// Requests that have come to an end.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Whether requests were sent, and no more of them lost than this share.
    pub(super) fn is_good(&self, tolerate: Share) -> bool {
        let most = tolerate.get() * (self.sent - self.unconfirmed) as f64;
        self.sent > 0 && self.lost as f64 <= most + 1e-9 // 0.29 × 100 is a little less than 29
    }

    /// As it is printed; `of` names the node.
    pub(super) fn summary(mut self, of: Option<(u8, SocketAddr)>) -> Summary {
        self.round_trips.sort_unstable();
        let times = &self.round_trips;
        let answered = times.len();
        let at = |index: usize| times[index].as_secs_f64();
        Summary {
            node: of.map(|(node, _)| node),
            to: of.map(|(_, to)| to),
            sent: self.sent,
            answered,
            lost: self.lost,
            retried: self.retried,
            unconfirmed: self.unconfirmed,
            round_trips: (answered > 0).then(|| RoundTrips {
                min_seconds: at(0),
                median_seconds: (at((answered - 1) / 2) + at(answered / 2)) / 2.0,
                p99_seconds: at((answered * 99).div_ceil(100) - 1),
                max_seconds: at(answered - 1),
            }),
        }
    }
}

/// Statistics, as they are printed.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    #[serde(skip_serializing_if = "Option::is_none")]
    node: Option<u8>,
    #[serde(skip_serializing_if = "Option::is_none")]
    to: Option<SocketAddr>,
    sent: u64,
    answered: usize,
    lost: u64,
    retried: u64,
    unconfirmed: u64,
    #[serde(flatten)]
    round_trips: Option<RoundTrips>,
}

/// Round-trip times of all answers.
#[derive(Debug, Serialize)]
struct RoundTrips {
    min_seconds: f64,
    median_seconds: f64,
    p99_seconds: f64,
    max_seconds: f64,
}

impl Summary {
    pub(super) fn print(&self, format: Format, out: &mut impl Write) -> io::Result<()> {
        if format == Format::Json {
            return print_json(self, out);
        }
        if let (Some(node), Some(to)) = (self.node, self.to) {
            write!(out, "node {node} ({to}): ")?;
        }
        write!(out, "sent {}, answered {}, lost {}", self.sent, self.answered, self.lost)?;
        for (what, number) in [("retried", self.retried), ("unconfirmed", self.unconfirmed)] {
            if number > 0 {
                write!(out, ", {what} {number}")?;
            }
        }
        if let Some(times) = &self.round_trips {
            write!(
                out,
                "; min {:.3} ms, median {:.3} ms, p99 {:.3} ms, max {:.3} ms",
                times.min_seconds * 1e3,
                times.median_seconds * 1e3,
                times.p99_seconds * 1e3,
                times.max_seconds * 1e3
            )?;
        }
        writeln!(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pnet::endpoint::client::Loss;
    use crate::pnet::wire::Elements;

    fn statistics(millis: impl IntoIterator<Item = u64>, lost: usize) -> Statistics {
        let mut statistics = Statistics::default();
        for millis in millis {
            let response = Response {
                destinations: Elements::new(),
                sources: Elements::new(),
                control_status: 0,
                data_octets: Vec::new(),
                round_trip: Duration::from_millis(millis),
            };
            statistics.note(Some(&Outcome::Answered(response)), 0);
        }
        let loss = Loss::NoAnswer { waited: Duration::from_secs(1), sent: 2 };
        for _ in 0..lost {
            statistics.note(Some(&Outcome::Lost(loss)), 1);
        }
        statistics
    }

    #[test]
    fn a_summary_takes_the_middle_of_the_round_trips() {
        let summary = |statistics: Statistics| {
            let mut out = Vec::new();
            statistics.summary(None).print(Format::Text, &mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert_eq!(
            summary(statistics([9, 1, 2], 1)),
            "sent 4, answered 3, lost 1, retried 1; min 1.000 ms, median 2.000 ms, p99 9.000 ms, \
             max 9.000 ms\n"
        );
        assert_eq!(
            summary(statistics((1..=200).rev(), 0)),
            "sent 200, answered 200, lost 0; min 1.000 ms, median 100.500 ms, p99 198.000 ms, \
             max 200.000 ms\n"
        );
        assert_eq!(summary(statistics([], 4)), "sent 4, answered 0, lost 4, retried 4\n");
        let mut unconfirmed = Statistics::default();
        unconfirmed.note(Some(&Outcome::Sent), 0);
        assert!(unconfirmed.is_good(Share::default()));
        assert_eq!(summary(unconfirmed), "sent 1, answered 0, lost 0, unconfirmed 1\n");
    }

    #[test]
    fn the_verdict_is_good_when_all_were_answered_or_enough() {
        let is_good = |answered: usize, lost, tolerate: &str| {
            statistics(vec![1; answered], lost).is_good(tolerate.parse().unwrap())
        };
        assert!(is_good(10, 0, "0%") && is_good(9, 1, "10%") && is_good(71, 29, "29%"));
        assert!(is_good(0, 1, "100%"));
        assert!(!is_good(9, 1, "0%") && !is_good(9, 1, "9.9%") && !is_good(0, 0, "100%"));
    }
}
