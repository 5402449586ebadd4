//! Sends the requests, as the schedule and the window let it, and prints what comes of them.

use std::net::SocketAddr;
use std::process::ExitCode;
use std::{io, mem};

use tokio::time::Instant;

use super::report::{Line, Result as Printed, Statistics};
use super::schedule::Schedule;
use super::{Args, Octets, bad_use};
use crate::cli::output::{Out, out};
use crate::cli::progress::{ProgressLine, bar};
use crate::cli::signals::Signals;
use crate::peer::{ClientNode, until};
use crate::pnet::endpoint::client::{
    Attributes, DestinationRoute, EndpointId, FlatAddressing, Request, RequestError, RouteEndpoint,
};

/// The client at work.
pub(super) struct Asking<'a> {
    args: &'a Args,
    client: ClientNode,
    routes: Vec<DestinationRoute>,
    schedule: Schedule,
    /// The requests that wait for their answers, with the index of their route.
    waiting: Vec<(EndpointId, usize)>,
    /// The number of the next request.
    number: u32,
    statistics: Vec<Statistics>,
    progress: ProgressLine,
    out: Out,
}

/// What happens next.
enum Event {
    Finished(EndpointId),
    TimeToAsk,
    TimeToDraw,
    /// No more is asked, and nothing is waited for. This says why.
    Over(&'static str),
}

impl<'a> Asking<'a> {
    pub(super) fn new(args: &'a Args, client: ClientNode, routes: Vec<DestinationRoute>) -> Self {
        let (nodes, pace) = (routes.len(), &args.pace);
        Self {
            args,
            client,
            schedule: Schedule::new(nodes, pace.count, pace.interval, Instant::now()),
            routes,
            waiting: Vec::new(),
            number: 0,
            statistics: vec![Statistics::default(); nodes],
            progress: ProgressLine::new(true),
            out: out(),
        }
    }

    /// Asks until all is done, the deadline has come, or a signal ends it. Returns the exit code.
    pub(super) async fn run(mut self) -> anyhow::Result<ExitCode> {
        let mut signals = Signals::new()?;
        let deadline = self.args.pace.deadline.map(|time| Instant::now().checked_add(time));
        let deadline = deadline.flatten();
        loop {
            while self.window_is_open()
                && let Some(route) = self.schedule.next(Instant::now())
            {
                if let Err(error) = self.ask(route) {
                    self.progress.clear();
                    return Ok(bad_use(error));
                }
            }
            if self.schedule.is_over() && self.waiting.is_empty() {
                break;
            }
            match self.next_event(&mut signals, deadline).await? {
                Event::Finished(endpoint) => self.end(endpoint, "it was not sent")?,
                Event::TimeToAsk => {}
                Event::TimeToDraw => self.draw(),
                Event::Over(why) => {
                    while let Some((endpoint, _)) = self.waiting.first() {
                        self.end(*endpoint, why)?;
                    }
                    break;
                }
            }
        }
        self.progress.clear();
        Ok(self.print_statistics()?)
    }

    fn window_is_open(&self) -> bool {
        self.waiting.len() < self.args.pace.window.into()
    }

    fn ask(&mut self, route: usize) -> Result<(), RequestError> {
        let content = &self.args.content;
        let number = self.number.to_be_bytes();
        // In a capture, the number tells requests apart.
        let data_octets = content.data.as_ref().map_or(&number[..], |Octets(data)| data);
        let control_status = content.control;
        let request = match (content.offset, content.size) {
            (Some(offset), Some(size)) => Request::Read { offset, size },
            (Some(offset), None) => Request::Write { offset, data_octets },
            (None, _) => Request::Data { control_status, data_octets },
        };
        let codes = FlatAddressing { read: Some(control_status), write: Some(control_status) };
        let attributes = Attributes {
            flat_addressing: content.offset.map(|_| codes),
            ..Attributes::new(self.routes[route].clone())
        };
        let client = self.client.client();
        let endpoint = client.reserve(attributes).expect("the window is smaller");
        client.request(endpoint, &request)?;
        self.number = self.number.wrapping_add(1);
        self.waiting.push((endpoint, route));
        Ok(())
    }

    async fn next_event(
        &mut self,
        signals: &mut Signals,
        deadline: Option<Instant>,
    ) -> anyhow::Result<Event> {
        let next_round = self.schedule.due().filter(|_| self.window_is_open());
        Ok(tokio::select! {
            biased;
            _ = signals.next() => Event::Over("no answer before it was stopped"),
            () = until(deadline) => Event::Over("no answer before the deadline"),
            finished = self.client.finished() => Event::Finished(finished?),
            () = until(next_round) => Event::TimeToAsk,
            () = until(self.progress.due().map(Instant::from)) => Event::TimeToDraw,
        })
    }

    /// Notes and prints what became of a request. If nothing has yet, this says why it is given up.
    fn end(&mut self, endpoint: EndpointId, given_up: &str) -> io::Result<()> {
        let Some(index) = self.waiting.iter().position(|(other, _)| *other == endpoint) else {
            return Ok(());
        };
        let (_, route) = self.waiting.remove(index);
        let client = self.client.client();
        let outcome = client.take_outcome(endpoint);
        let retries = client.get(endpoint).map_or(0, RouteEndpoint::retries);
        client.free(endpoint);
        self.statistics[route].note(outcome.as_ref(), retries);
        let result = match &outcome {
            Some(outcome) => outcome.into(),
            None => Printed::Failed { error: given_up.to_owned() },
        };
        let (node, to) = self.name(route);
        self.progress.clear();
        Line { node, to, result, retries }.print(self.args.format, &mut self.out)
    }

    fn draw(&mut self) {
        let ended: u64 = self.statistics.iter().map(Statistics::sent).sum();
        let client = self.client.client();
        let endpoints = self.waiting.iter().filter_map(|(endpoint, _)| client.get(*endpoint));
        let parts: f64 = endpoints.map(|endpoint| endpoint.progress().fraction()).sum();
        let all = u64::from(self.args.pace.count.get()) * self.routes.len() as u64;
        let share = (ended as f64 + parts) / all as f64;
        self.progress.draw(&format!("{}, {ended} of {all}", bar(share)));
    }

    /// Node address, and where requests to it go.
    fn name(&self, route: usize) -> (u8, SocketAddr) {
        let route = &self.routes[route];
        (route.node.number(), route.way.address)
    }

    /// The statistics of each node and of all, if there was more than one request to each. Returns the
    /// exit code.
    fn print_statistics(mut self) -> io::Result<ExitCode> {
        let format = self.args.format;
        let all = Statistics::sum(&self.statistics);
        let is_good = all.is_good(self.args.pace.tolerate);
        if self.args.pace.count.get() > 1 {
            for (route, statistics) in mem::take(&mut self.statistics).into_iter().enumerate() {
                // One node alone is all of them.
                if self.routes.len() > 1 {
                    let summary = statistics.summary(Some(self.name(route)));
                    summary.print(format, &mut self.out)?;
                }
            }
            all.summary(None).print(format, &mut self.out)?;
        }
        Ok(if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}
