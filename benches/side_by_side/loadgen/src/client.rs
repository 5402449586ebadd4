//! The clients: so many requests under way at once (closed loop), or so many a second (open loop).
//!
//! Prints `begin` and `end` when the measured part begins and ends, and the result behind them.

use std::collections::VecDeque;
use std::io::{self, Error};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::Duration;

use hdrhistogram::Histogram;
use loadgen::datagram::{self, PASSWORD};
use loadgen::net::{self, BATCH, Batch, Epoll, To};

use crate::odd::{self, Number, Odd};
use crate::targets::{Target, Targets};

#[derive(clap::Args)]
pub struct Args {
    /// The public ports, comma separated
    #[arg(long, value_delimiter = ',', required = true)]
    targets: Vec<Targets>,
    /// Client ports
    #[arg(long)]
    sockets: usize,
    /// Let each socket talk to so many targets in turn; without it, to one, connected to it. The
    /// measured part begins when every node has answered every socket that talks to it
    #[arg(long)]
    targets_per_socket: Option<usize>,
    /// Closed loop: requests under way for each socket
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    window: u8,
    /// Closed loop: so many sockets at once send a window and wait for all its answers, then it
    /// is the turn of others
    #[arg(long)]
    at_once: Option<usize>,
    /// Open loop: requests a second, over all sockets
    #[arg(long)]
    rate: Option<f64>,
    /// Seconds before the measured part
    #[arg(long)]
    warm_up: f64,
    /// Seconds measured
    #[arg(long)]
    seconds: f64,
}

/// Closed loop: a request without an answer for this long is lost.
const LOST_AFTER: u64 = 250_000_000;
const SCAN_INTERVAL: u64 = 20_000_000;
/// Open loop: shortest time between two rounds of sending.
const TICK: u64 = 50_000;
/// Open loop: answers are waited for so long at the end.
const STRAGGLERS: u64 = 500_000_000;
/// Flows that are not all open by then never will be.
const PATIENCE: u64 = 60_000_000_000;
const SECOND: f64 = 1e9;

struct Load {
    epoll: Epoll,
    sockets: Vec<Socket>,
    flows: Vec<Flow>,
    connected: bool,
    /// Flows that never had an answer.
    silent: usize,
    outgoing: Batch,
    incoming: Batch,
    /// Sockets with room in their windows, to be filled.
    due: Vec<usize>,
    /// Sockets that wait for their turn; none without turns.
    waiting: Option<VecDeque<usize>>,
    /// When the measured part began; far in the future before.
    begin: u64,
    tally: Tally,
}

struct Socket {
    socket: UdpSocket,
    /// The first of its flows, which follow each other, and which of them is next.
    first_flow: usize,
    flows: usize,
    next: usize,
    counter: u64,
    /// Number and time of what is under way.
    slots: Vec<Option<(u64, u64)>>,
    free: Vec<usize>,
}

struct Flow {
    target: Target,
    answered: bool,
}

/// What is counted: the measured part, but for `answers`.
struct Tally {
    sent: u64,
    received: u64,
    lost: u64,
    late: u64,
    refused: u64,
    /// From the first datagram on.
    answers: u64,
    odd: Odd,
    round_trip: Histogram<u64>,
}

pub fn run(args: &Args) -> io::Result<()> {
    net::prepare_process()?;
    let mut load = Load::new(args)?;
    let start = net::now();
    let (warm_up, seconds) = ((args.warm_up * SECOND) as u64, (args.seconds * SECOND) as u64);
    let mut schedule = args.rate.map(|rate| Schedule { start, rate, produced: 0, turn: 0 });
    let mut next_scan = start + SCAN_INTERVAL;
    loop {
        let now = net::now();
        if load.begin == u64::MAX && now >= start + warm_up && load.is_open(args) {
            load.begin = now;
            println!("begin");
        }
        if now >= load.begin.saturating_add(seconds) {
            break;
        }
        if now > start + warm_up + PATIENCE && load.begin == u64::MAX {
            return Err(Error::other(format!("{} flows without an answer", load.silent)));
        }
        let wait = match &mut schedule {
            Some(schedule) => load.send_due(schedule, now),
            None => {
                if now >= next_scan {
                    load.give_up_lost(now);
                    next_scan = now + SCAN_INTERVAL;
                }
                load.fill_windows();
                SCAN_INTERVAL
            }
        };
        load.receive(Duration::from_nanos(wait));
    }
    println!("end");
    let stop = net::now() + STRAGGLERS;
    while args.rate.is_some() && net::now() < stop {
        load.receive(Duration::from_millis(50));
    }
    if args.rate.is_some() {
        load.tally.lost = load.tally.sent.saturating_sub(load.tally.received);
    }
    println!("{}", load.tally.result(args.seconds));
    Ok(())
}

/// The open loop's: datagram n is due n / rate after the start.
struct Schedule {
    start: u64,
    rate: f64,
    produced: u64,
    turn: usize,
}

impl Load {
    fn new(args: &Args) -> io::Result<Self> {
        let targets: Vec<_> = args.targets.iter().flat_map(|targets| &targets.0).collect();
        let window = if args.rate.is_some() { 0 } else { usize::from(args.window) };
        let epoll = Epoll::new()?;
        let (mut sockets, mut flows) = (Vec::new(), Vec::new());
        for index in 0..args.sockets {
            let socket = net::socket(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
            epoll.add(&socket, index)?;
            let first_flow = flows.len();
            let many = args.targets_per_socket.unwrap_or(1);
            for target in targets.iter().cycle().skip(index * many % targets.len()).take(many) {
                flows.push(Flow { target: **target, answered: false });
            }
            if args.targets_per_socket.is_none() {
                socket.connect(flows[first_flow].target.address)?;
            }
            let (slots, free) = (vec![None; window], (0..window).collect());
            sockets.push(Socket {
                socket,
                first_flow,
                flows: many,
                next: 0,
                counter: 0,
                slots,
                free,
            });
        }
        let at_once = args.at_once.unwrap_or(args.sockets).min(args.sockets);
        Ok(Self {
            epoll,
            silent: flows.len(),
            sockets,
            flows,
            connected: args.targets_per_socket.is_none(),
            outgoing: Batch::new(false),
            incoming: Batch::new(false),
            due: (0..at_once).collect(),
            waiting: args.at_once.map(|_| (at_once..args.sockets).collect()),
            begin: u64::MAX,
            tally: Tally::new(),
        })
    }

    fn is_open(&self, args: &Args) -> bool {
        args.targets_per_socket.is_none() || self.silent == 0
    }

    /// Sends what is due and tells how long there is nothing to send.
    fn send_due(&mut self, schedule: &mut Schedule, now: u64) -> u64 {
        let elapsed = |now: u64| (now - schedule.start) as f64 / SECOND;
        let due = (elapsed(now) * schedule.rate) as u64;
        for _ in schedule.produced..due {
            self.put(schedule.turn, 0, 0, net::now());
            self.send(schedule.turn, 1);
            self.sockets[schedule.turn].next_flow();
            schedule.turn = (schedule.turn + 1) % self.sockets.len();
        }
        schedule.produced = schedule.produced.max(due);
        let next = schedule.start + (schedule.produced as f64 / schedule.rate * SECOND) as u64;
        next.saturating_sub(net::now()).max(TICK)
    }

    fn give_up_lost(&mut self, now: u64) {
        for index in 0..self.sockets.len() {
            let socket = &mut self.sockets[index];
            let before = socket.free.len();
            for (slot, under_way) in socket.slots.iter_mut().enumerate() {
                if let Some((_, time)) = *under_way
                    && now.saturating_sub(time) > LOST_AFTER
                {
                    self.tally.lost += u64::from(time >= self.begin);
                    *under_way = None;
                    socket.free.push(slot);
                }
            }
            if socket.free.len() > before {
                self.has_room(index);
            }
        }
    }

    fn fill_windows(&mut self) {
        while let Some(index) = self.due.pop() {
            let (mut put, now) = (0, net::now());
            while let Some(slot) = self.sockets[index].free.pop() {
                let number = self.put(index, put, slot, now);
                let socket = &mut self.sockets[index];
                socket.slots[slot] = Some((number, now));
                put += 1;
                // To open the flows, a datagram to each; later a window to each: the same bursts,
                // however many flows a socket has.
                if self.silent > 0 || socket.free.is_empty() {
                    socket.next_flow();
                }
            }
            self.send(index, put);
        }
    }

    /// A socket has room in its window: it sends on, or it is another one's turn.
    fn has_room(&mut self, index: usize) {
        let socket = &self.sockets[index];
        match &mut self.waiting {
            None => self.due.push(index),
            Some(waiting) if socket.free.len() == socket.slots.len() => {
                waiting.push_back(index);
                self.due.extend(waiting.pop_front());
            }
            Some(_) => {}
        }
    }

    /// Puts a socket's next request into the batch and tells its number.
    fn put(&mut self, index: usize, place: usize, slot: usize, now: u64) -> u64 {
        let socket = &mut self.sockets[index];
        let flow = socket.first_flow + socket.next;
        socket.counter += 1;
        let number = Number { flow, slot, counter: socket.counter }.packed();
        let target = &self.flows[flow].target;
        let octets = self.outgoing.room(place, datagram::LEN);
        datagram::write(octets, target.node_address, number, now, PASSWORD);
        self.outgoing.set_peer(place, target.address);
        self.tally.sent += u64::from(now >= self.begin);
        number
    }

    fn send(&mut self, index: usize, datagrams: usize) {
        let to = if self.connected { To::Peer } else { To::Each };
        let taken = self.outgoing.send(&self.sockets[index].socket, 0..datagrams, to);
        if self.begin != u64::MAX {
            self.tally.refused += (datagrams - taken) as u64;
        }
    }

    fn receive(&mut self, wait: Duration) {
        for event in 0..self.epoll.wait(Some(wait)) {
            let index = self.epoll.index(event);
            let mut room = false;
            loop {
                let received = self.incoming.receive(&self.sockets[index].socket);
                let now = net::now();
                for place in 0..received {
                    room |= self.take(index, place, now);
                }
                if received < BATCH {
                    break;
                }
            }
            if room {
                self.has_room(index);
            }
        }
    }

    /// Takes an answer and tells whether it made room in the window.
    fn take(&mut self, index: usize, place: usize, now: u64) -> bool {
        let (socket, flows) = (&mut self.sockets[index], &mut self.flows);
        let own = socket.first_flow..socket.first_flow + socket.flows;
        let asked = |flow| own.contains(&flow).then(|| flows[flow].target.address);
        let (octets, peer) = (self.incoming.octets(place), self.incoming.peer(place));
        let Some((number, time)) = self.tally.odd.sort(octets, peer, asked) else { return false };
        let closed = !socket.slots.is_empty();
        if closed {
            let slot = odd::slot(number);
            let mine = |under_way: &mut (u64, u64)| under_way.0 == number;
            if socket.slots.get_mut(slot).and_then(|place| place.take_if(mine)).is_none() {
                self.tally.late += 1;
                return false;
            }
            socket.free.push(slot);
        }
        let flow = &mut flows[odd::flow(number)];
        self.silent -= usize::from(!flow.answered);
        flow.answered = true;
        self.tally.answers += 1;
        // Closed loop: answers within the measured time; open loop: to requests within it.
        if (if closed { now } else { time }) >= self.begin {
            self.tally.received += 1;
            self.tally.round_trip.saturating_record(now.saturating_sub(time));
        }
        closed
    }
}

impl Socket {
    fn next_flow(&mut self) {
        self.next = (self.next + 1) % self.flows;
    }
}

impl Tally {
    fn new() -> Self {
        Self {
            sent: 0,
            received: 0,
            lost: 0,
            late: 0,
            refused: 0,
            answers: 0,
            odd: Odd::default(),
            round_trip: Histogram::new_with_max(60_000_000_000, 3).expect("sound bounds"),
        }
    }

    fn result(&self, seconds: f64) -> serde_json::Value {
        let micros = |quantile| {
            let none = self.round_trip.is_empty();
            (!none).then(|| self.round_trip.value_at_quantile(quantile) as f64 / 1000.0)
        };
        serde_json::json!({
            "sent": self.sent,
            "received": self.received,
            "rate": self.received as f64 / seconds,
            "lost": self.lost,
            "loss_percent": self.lost as f64 / self.sent.max(1) as f64 * 100.0,
            "late": self.late,
            "refused": self.refused,
            "answers": self.answers,
            "malformed": self.odd.malformed,
            "stale": self.odd.stale,
            "foreign": self.odd.foreign,
            "wrong_port": self.odd.wrong_port,
            "p50_us": micros(0.5),
            "p99_us": micros(0.99),
            "p999_us": micros(0.999),
        })
    }
}
