//! Asks one node as a client does, with each password of its net, and tells from what comes what is wrong.

#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::time::Duration;

use super::{Check, Neighbour};
use crate::config::Config;
use crate::nat::{Mapping, NetKind};
use crate::peer::ClientNode;
use crate::pnet::endpoint::client::{
    self, Arep, Attributes, DestinationRoute, Loss, Request, Source, Undelivered, Way,
};
use crate::pnet::ip_net_table::Destination;
use crate::pnet::wire::{Elements, Header, Password};

/// The most passwords that a node is asked with.
const MOST_PASSWORDS: usize = 4;
/// The request has no data, so nothing can be written with it. It is the default of `pnet-nat request`.
const REQUEST: Request<'static> = Request::Data { control_status: 0, data_octets: &[] };

/// The name of the check whether a node answers.
const ANSWER: &str = "answer";
/// The name of the check whether it is on the wire.
const NEIGHBOUR: &str = "neighbour";

/// A node that is to be asked.
#[derive(Clone, Debug)]
pub struct Asked {
    /// The name of the node in checks.
    pub subject: String,
    server: SocketAddr,
    node_address: u8,
    header: Header,
    /// Each with the name of its credential.
    passwords: Vec<(String, Option<Password>)>,
}

/// What became of one request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The answer took this time.
    Answered(Duration),
    /// There was no answer that the relay would pass on.
    Lost(Loss),
    /// The system did not let it be sent.
    Failed(String),
}

/// What was seen of a node.
#[derive(Clone, Debug)]
pub struct Seen {
    /// What became of the requests, by the names of the credentials.
    pub with: Vec<(String, Outcome)>,
    /// What became of a request without a password; none: it was not sent.
    pub without: Option<Outcome>,
    /// What the table of neighbours says afterwards.
    pub neighbour: Neighbour,
}

impl Asked {
    /// The node behind a mapping.
    pub fn of(config: &Config, mapping: &Mapping) -> Self {
        let net = config.table.net(mapping.net);
        let subject = match net.kind {
            NetKind::ProfinetDevice { .. } => net.name.clone(),
            _ => format!("node {} of {}", mapping.node_address, net.name),
        };
        // To another plant's router, all requests go with the first password.
        let most = if net.kind.is_remote() { 1 } else { MOST_PASSWORDS };
        let credentials = net.credentials.iter().take(most);
        let mut passwords: Vec<_> = credentials
            .map(|credential| (credential.name.clone(), Some(credential.at_server().clone())))
            .collect();
        if passwords.is_empty() {
            passwords.push((String::new(), None));
        }
        Self {
            subject,
            server: mapping.server,
            node_address: mapping.node_address,
            header: config.table.header,
            passwords,
        }
    }

    /// Asks the node, with one request at a time. None where it has no node address: a PROFINET device.
    pub async fn ask(&self, answer_time: Duration) -> Option<Seen> {
        let node = Destination::try_from(self.node_address).ok()?;
        let mut seen = Seen { with: Vec::new(), without: None, neighbour: Neighbour::Unlisted };
        for (name, password) in &self.passwords {
            let outcome = self.exchange(node, password.clone(), answer_time).await;
            let is_over =
                matches!(&outcome, Outcome::Lost(Loss::Undelivered(_)) | Outcome::Failed(_));
            seen.with.push((name.clone(), outcome));
            seen.neighbour = Neighbour::look_up(self.server);
            if is_over || seen.neighbour == Neighbour::Silent {
                return Some(seen);
            }
        }
        let is_silent =
            |(_, outcome): &(_, Outcome)| matches!(outcome, Outcome::Lost(Loss::NoAnswer { .. }));
        let had_a_password = self.passwords.iter().any(|(_, password)| password.is_some());
        if had_a_password && seen.with.iter().all(is_silent) {
            seen.without = Some(self.exchange(node, None, answer_time).await);
        }
        Some(seen)
    }

    async fn exchange(
        &self,
        node: Destination,
        password: Option<Password>,
        answer_time: Duration,
    ) -> Outcome {
        let source = Source::FIGURE_10;
        let way = Way { address: self.server, password };
        let route =
            DestinationRoute { way, ip_net_id: source.ip_net_id, node, beyond: Elements::new() };
        let arep = Arep { header: self.header, response_timeout: answer_time, ..Arep::new(source) };
        let exchange = async {
            let mut client = ClientNode::bind(arep, self.server.ip()).await?;
            let endpoint = client.client().reserve(Attributes::new(route))?;
            client.client().request(endpoint, &REQUEST)?;
            client.finished().await?;
            Ok::<_, Box<dyn std::error::Error + Send + Sync>>(
                client.client().take_outcome(endpoint),
            )
        };
        match exchange.await {
            Ok(Some(client::Outcome::Answered(answer))) => Outcome::Answered(answer.round_trip),
            Ok(Some(client::Outcome::Lost(loss))) => Outcome::Lost(loss),
            Ok(_) => Outcome::Failed("the request was not sent".into()),
            Err(error) => Outcome::Failed(error.to_string()),
        }
    }

    /// The checks of what was seen.
    pub fn judge(&self, seen: Option<&Seen>) -> Vec<Check> {
        let subject = &self.subject;
        let Some(seen) = seen else {
            let text = "a PROFINET device is not asked here";
            let remedy = format!("ask it: pnet-nat inventory {}", self.server.ip());
            return vec![Check::unknown(ANSWER, subject, text).remedy(remedy)];
        };
        let answer = self.judge_answer(seen);
        let is_there = seen.with.iter().any(|(_, outcome)| {
            matches!(
                outcome,
                Outcome::Answered(_)
                    | Outcome::Lost(Loss::OtherPort(_) | Loss::WrongPassword)
                    | Outcome::Lost(Loss::Undelivered(Undelivered::NothingListens))
            )
        });
        let mut checks = if is_there { Vec::new() } else { self.judge_neighbour(&seen.neighbour) };
        checks.push(answer);
        checks
    }

    /// Whether it is on the wire: only of interest where nothing comes from it.
    fn judge_neighbour(&self, neighbour: &Neighbour) -> Vec<Check> {
        let (subject, ip) = (&self.subject, self.server.ip());
        match neighbour {
            Neighbour::Answers { hardware, interface } => {
                let text = format!("{ip} answers ARP: it is {hardware} on {interface}");
                vec![Check::good(NEIGHBOUR, subject, text)]
            }
            Neighbour::Silent => {
                let remedy =
                    "check the node's power, its cable and its IP address: subnet + node address";
                vec![
                    Check::bad(NEIGHBOUR, subject, format!("{ip} does not answer ARP"))
                        .remedy(remedy),
                ]
            }
            Neighbour::Unlisted => Vec::new(),
        }
    }

    fn judge_answer(&self, seen: &Seen) -> Check {
        let subject = &self.subject;
        let answered = seen.with.iter().filter_map(|(_, outcome)| match outcome {
            Outcome::Answered(time) => Some(*time),
            _ => None,
        });
        let times: Vec<Duration> = answered.collect();
        let Some(time) = times.first() else { return self.judge_silence(seen) };
        let text = format!("answers in {:.1} ms", time.as_secs_f64() * 1e3);
        let lost = seen.with.iter().find(|(_, outcome)| !matches!(outcome, Outcome::Answered(_)));
        match lost {
            None if times.len() > 1 => Check::good(
                ANSWER,
                subject,
                format!("{text}, to each of {} passwords", times.len()),
            ),
            None => Check::good(ANSWER, subject, text),
            Some((name, _)) => {
                let text = format!("{text}, but not to the password of {name:?}");
                Check::doubtful(ANSWER, subject, text).remedy(
                    "enter that password in the node's PasswordTable, or correct its `device_file`",
                )
            }
        }
    }

    /// No request was answered. The first tells why.
    fn judge_silence(&self, seen: &Seen) -> Check {
        let (subject, server) = (&self.subject, self.server);
        let port = server.port();
        let bad = |text: String| Check::bad(ANSWER, subject, text);
        if let Some(Outcome::Answered(_)) = seen.without {
            return bad("answers only without a password: the port is not a Secure one".into())
                .remedy(
                    "enter the password in the node's PasswordTable, or correct `server_port`",
                );
        }
        let outcomes = seen.with.iter().map(|(_, outcome)| outcome).chain(&seen.without);
        let telling = |outcome: &&Outcome| !matches!(outcome, Outcome::Lost(Loss::NoAnswer { .. }));
        match outcomes.into_iter().find(telling) {
            Some(Outcome::Lost(Loss::Undelivered(Undelivered::NothingListens))) => bad(format!(
                "the node is there, and its UDP port {port} is closed"
            ))
            .remedy(
                "start its Secure port, or correct the port: `server_port`, or that of `address`",
            ),
            Some(Outcome::Lost(Loss::Undelivered(Undelivered::Forbidden))) => {
                bad(format!("a firewall forbids datagrams to {server}"))
                    .remedy("let this router send to the nodes: `nft list ruleset`, hook output")
            }
            Some(Outcome::Lost(Loss::OtherPort(from))) => bad(format!(
                "answers from {from}, not from {server}: such answers are dropped"
            ))
            .remedy("let the node answer from the port that was asked, or correct `server_port`"),
            Some(Outcome::Lost(Loss::WrongPassword)) => {
                bad("answers with another password, or without one".into())
                    .remedy("compare the password with the node's PasswordTable")
            }
            Some(Outcome::Lost(Loss::Undelivered(why))) => bad(format!(
                "the request did not get to {server}: {why}"
            ))
            .remedy("check the node's power, its cable, its IP address, and the route to it"),
            Some(Outcome::Lost(loss)) => bad(loss.to_string()),
            Some(Outcome::Failed(why)) => bad(format!("cannot be asked: {why}")),
            Some(Outcome::Answered(_)) | None => self.judge_no_answer(&seen.neighbour),
        }
    }

    /// Nothing came at all.
    fn judge_no_answer(&self, neighbour: &Neighbour) -> Check {
        let (subject, port) = (&self.subject, self.server.port());
        match neighbour {
            Neighbour::Answers { .. } => {
                let text = "there, but silent: the password or the port";
                Check::doubtful(ANSWER, subject, text).remedy(format!(
                    "compare the password with the node's PasswordTable, and UDP port {port} with its \
                     Secure port; its node address has to be the last octet of its IP address"
                ))
            }
            Neighbour::Silent => Check::bad(ANSWER, subject, "no answer: nobody is at its address"),
            Neighbour::Unlisted => {
                let text = format!(
                    "no answer from {}, and no ARP table tells whether it is there",
                    self.server
                );
                Check::bad(ANSWER, subject, text)
                    .remedy("ping it; if that works, compare password and port with the node's own")
            }
        }
    }
}
