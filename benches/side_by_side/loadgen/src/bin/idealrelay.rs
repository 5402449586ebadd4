//! A yardstick, not a product: a relay on plain sockets without checks, limits or expiry, as lean as
//! one can be. What it reaches is what this machine gives.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::ops::Range;

use clap::Parser;
use loadgen::net::{self, BATCH, Batch, Epoll, To};

/// Relays each public port to a node, unchecked.
#[derive(Parser)]
struct Args {
    /// Public address and first port
    #[arg(long)]
    listen: SocketAddrV4,
    /// First node's address and port; the next public port goes to the next address
    #[arg(long)]
    node: SocketAddrV4,
    /// Public ports
    #[arg(long)]
    count: u16,
    /// Drop a wrong header or password by a filter in the kernel, before it is queued
    #[arg(long)]
    filter: bool,
}

struct Relay {
    epoll: Epoll,
    batch: Batch,
    listeners: Vec<(UdpSocket, SocketAddrV4)>,
    flows: Vec<Flow>,
    by_client: HashMap<(SocketAddrV4, usize), usize>,
}

/// A client on a listener, and its connected socket towards the node.
struct Flow {
    upstream: UdpSocket,
    listener: usize,
    client: SocketAddrV4,
}

/// Accepts what begins with 02 00 00 00 and ends with PNETPASS. The UDP header comes first.
const FILTER: [(u16, u8, u8, u32); 11] = [
    (0x20, 0, 0, 8),           // a = the four octets of the header
    (0x15, 0, 8, 0x0200_0000), // another one: drop
    (0x80, 0, 0, 0),           // a = length
    (0x14, 0, 0, 8),           // a -= 8
    (0x07, 0, 0, 0),           // x = a, where the password begins
    (0x40, 0, 0, 0),           // a = its first half
    (0x15, 0, 3, 0x504e_4554), // another one: drop
    (0x40, 0, 0, 4),           // a = its second half
    (0x15, 0, 1, 0x5041_5353), // another one: drop
    (0x06, 0, 0, 0xffff),      // accept
    (0x06, 0, 0, 0),           // drop
];

fn main() -> io::Result<()> {
    net::prepare_process()?;
    let mut relay = Relay::new(&Args::parse())?;
    loop {
        for event in 0..relay.epoll.wait(None) {
            let index = relay.epoll.index(event);
            match index.checked_sub(relay.listeners.len()) {
                None => relay.take_requests(index)?,
                Some(flow) => relay.take_responses(flow),
            }
        }
    }
}

impl Relay {
    fn new(args: &Args) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        let mut listeners = Vec::new();
        for index in 0..args.count {
            let listen = SocketAddrV4::new(*args.listen.ip(), args.listen.port() + index);
            let address = Ipv4Addr::from_bits(args.node.ip().to_bits() + u32::from(index));
            let socket = net::socket(listen)?;
            if args.filter {
                net::attach_filter(&socket, &FILTER)?;
            }
            epoll.add(&socket, listeners.len())?;
            listeners.push((socket, SocketAddrV4::new(address, args.node.port())));
        }
        let (batch, flows) = (Batch::new(false), Vec::new());
        Ok(Self { epoll, batch, listeners, flows, by_client: HashMap::new() })
    }

    fn take_requests(&mut self, listener: usize) -> io::Result<()> {
        loop {
            let received = self.batch.receive(&self.listeners[listener].0);
            let mut from = 0;
            while from < received {
                let client = self.batch.peer(from);
                let same = |&index: &usize| self.batch.peer(index) == client;
                let to = from + (from..received).take_while(same).count();
                self.forward(client, listener, from..to)?;
                from = to;
            }
            if received < BATCH {
                return Ok(());
            }
        }
    }

    fn take_responses(&mut self, flow: usize) {
        let Flow { upstream, listener, client } = &self.flows[flow];
        loop {
            let received = self.batch.receive(upstream);
            (0..received).for_each(|index| self.batch.set_peer(index, *client));
            self.batch.send(&self.listeners[*listener].0, 0..received, To::Each);
            if received < BATCH {
                break;
            }
        }
    }

    fn forward(
        &mut self,
        client: SocketAddrV4,
        listener: usize,
        datagrams: Range<usize>,
    ) -> io::Result<()> {
        let flow = match self.by_client.get(&(client, listener)) {
            Some(&flow) => flow,
            None => self.open(client, listener)?,
        };
        self.batch.send(&self.flows[flow].upstream, datagrams, To::Peer);
        Ok(())
    }

    fn open(&mut self, client: SocketAddrV4, listener: usize) -> io::Result<usize> {
        let upstream = net::socket(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
        upstream.connect(self.listeners[listener].1)?;
        let flow = self.flows.len();
        self.epoll.add(&upstream, self.listeners.len() + flow)?;
        self.flows.push(Flow { upstream, listener, client });
        self.by_client.insert((client, listener), flow);
        Ok(flow)
    }
}
