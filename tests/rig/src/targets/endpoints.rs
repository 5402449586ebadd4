//! Any datagrams for a server and for a client, in any order and at any time: the server answers to
//! the sender alone and only whom it may, and the client takes no answer that is not to its request.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use pnet_nat::pnet::endpoint::client::{
    Arep, Attributes, Client, DestinationRoute, EndpointId, FlatAddressing, Outcome, RepState,
    Request, Source, Way,
};
use pnet_nat::pnet::endpoint::{Echo, Memory, Port, Server, Service};
use pnet_nat::pnet::ip_net_table::{Destination, Fields, IpNetTable};
use pnet_nat::pnet::wire::{
    Datagram, DatagramRepr, Elements, Header, IpNetId, MAX_DATAGRAM, NCNA, NodeAddress, Password,
};

const PASSWORD: &[u8; 8] = b"PNETPASS";
const SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 17, 17, 4), 34379);
const WINDOW: usize = 2;

/// Takes the octets as steps: each has a kind, a length, and as many octets.
pub fn holds(octets: &[u8]) {
    let mut world = World::new();
    let mut rest = octets;
    while let [kind, length, tail @ ..] = rest {
        let (octets, tail) = tail.split_at(usize::from(*length).min(tail.len()));
        world.step(*kind, octets);
        rest = tail;
    }
}

struct World {
    now: Duration,
    server: Server,
    memory: Memory,
    client: Client,
    endpoints: Vec<EndpointId>,
    /// Requests that left and have not been given to the server.
    sent: Vec<Vec<u8>>,
    /// Datagrams that the client took as an answer.
    taken: usize,
    answered: usize,
}

impl World {
    fn new() -> Self {
        let device = IpNetTable::of_device(*SERVER.ip(), 0, &[Fields::UNUSED; 124]).unwrap();
        let passwords = vec![Password::new(*PASSWORD)];
        let arep = Arep {
            max_outstanding_requests: WINDOW,
            max_retries: 1,
            ..Arep::new(Source::FIGURE_10)
        };
        let mut client = Client::new(arep);
        let endpoints = [false, true, false].map(|is_flat| {
            let mut attributes = Attributes::new(destination());
            attributes.flat_addressing =
                is_flat.then_some(FlatAddressing { read: Some(1), write: Some(2) });
            client.reserve(attributes).unwrap()
        });
        Self {
            now: Duration::ZERO,
            server: Server::new(device, Header::default(), passwords),
            memory: Memory::new(200, Some(1), Some(2)),
            client,
            endpoints: endpoints.into(),
            sent: Vec::new(),
            taken: 0,
            answered: 0,
        }
    }

    fn step(&mut self, kind: u8, octets: &[u8]) {
        let (what, which) = (kind & 7, usize::from(kind >> 3));
        match what {
            0 => self.request(which, octets),
            1 => self.transmit(),
            2 => self.deliver(which),
            3 => self.hear(stranger(which).into(), octets),
            4 => self.hear(SERVER.into(), octets),
            5 => {
                let port = if which.is_multiple_of(2) { Port::Normal } else { Port::Secure };
                self.serve(port, stranger(which), octets);
            }
            6 => self.wait(Duration::from_millis(250 * which as u64)),
            _ => self.look(which),
        }
        assert!(self.server.dynamic_clients().len() <= 125, "A13");
        let waits = |id: &&EndpointId| self.client.state(**id) == RepState::WaitingForResponse;
        assert!(self.endpoints.iter().filter(waits).count() <= self.endpoints.len());
    }

    fn request(&mut self, which: usize, octets: &[u8]) {
        let id = self.endpoints[which % self.endpoints.len()];
        let size = octets.len() as u16;
        let request = match which / self.endpoints.len() % 3 {
            0 => Request::Data { control_status: which as u8, data_octets: octets },
            1 => Request::Read { offset: 3 * size, size },
            _ => Request::Write { offset: size, data_octets: octets },
        };
        // It may be busy, or the request may be too large.
        let _ = self.client.request(id, &request);
    }

    fn transmit(&mut self) {
        let mut buffer = [0; MAX_DATAGRAM];
        while let Some(transmit) = self.client.poll_transmit(self.now, &mut buffer) {
            assert_eq!(transmit.to, SERVER.into());
            let octets = &buffer[..transmit.length];
            let datagram = Datagram::parse(octets, Header::default()).expect("R-5");
            assert_eq!(datagram.password(), Some(PASSWORD), "R-3");
            if self.sent.len() < 64 {
                self.sent.push(octets.to_vec());
            }
        }
    }

    /// A request of the client reaches the server, and the answer the client.
    fn deliver(&mut self, which: usize) {
        if self.sent.is_empty() {
            return;
        }
        let request = match which % 4 {
            3 => self.sent[which % self.sent.len()].clone(), // it will come again
            _ => self.sent.remove(which % self.sent.len()),
        };
        if let Some(answer) = self.serve(Port::Secure, stranger(0), &request) {
            self.hear(SERVER.into(), &answer);
        }
    }

    fn serve(&mut self, port: Port, from: SocketAddrV4, octets: &[u8]) -> Option<Vec<u8>> {
        let indicated = self.server.receive(self.now, port, from, octets).ok()?;
        let data = match indicated.control_status {
            1 | 2 => self.memory.serve(&indicated)?,
            _ => Echo.serve(&indicated)?,
        };
        let requester = indicated.requester?;
        assert_eq!(requester.address(), from);
        let mut buffer = [0; MAX_DATAGRAM];
        let length = requester.respond(&data, &mut buffer).expect("there is room");
        let (asked, answer) = (parse(octets), parse(&buffer[..length]));
        assert_eq!(answer.route().sources().last(), Some(NCNA), "R-34");
        assert_eq!(answer.password(), asked.password(), "R-39");
        assert!(port == Port::Normal || answer.password() == Some(PASSWORD), "R-7");
        Some(buffer[..length].to_vec())
    }

    fn hear(&mut self, from: SocketAddr, octets: &[u8]) {
        if let Ok(id) = self.client.receive(self.now, from, octets) {
            assert_eq!(from, SERVER.into(), "A14");
            assert!(self.endpoints.contains(&id));
            let response = parse(octets);
            assert_eq!(response.password(), Some(PASSWORD), "R-39");
            assert_eq!(response.route().sources().last(), Some(NCNA), "R-34");
            self.taken += 1;
        }
    }

    fn wait(&mut self, time: Duration) {
        self.now += time;
        self.client.handle_timeout(self.now);
        if let Some(next) = self.client.next_timeout() {
            assert!(next > self.now, "what is over was handled");
        }
    }

    fn look(&mut self, which: usize) {
        if which.is_multiple_of(2) {
            while let Some(id) = self.client.poll_finished() {
                assert_ne!(self.client.state(id), RepState::WaitingForResponse);
            }
        }
        let id = self.endpoints[which % self.endpoints.len()];
        if let Some(Outcome::Answered(response)) = self.client.take_outcome(id) {
            self.answered += 1;
            assert!(self.answered <= self.taken, "an answer that nobody gave");
            assert!(response.round_trip <= self.now);
        }
        assert_ne!(self.client.state(id), RepState::NotInUse);
    }
}

fn parse(octets: &[u8]) -> Datagram<'_> {
    let datagram = Datagram::parse(octets, Header::default()).expect("it was taken");
    assert!(DatagramRepr::parse(&datagram).buffer_len() == octets.len());
    datagram
}

fn destination() -> DestinationRoute {
    DestinationRoute {
        way: Way { address: SERVER.into(), password: Some(Password::new(*PASSWORD)) },
        ip_net_id: IpNetId::new(11).unwrap(),
        node: Destination::Node(NodeAddress::new(4).unwrap()),
        beyond: Elements::from_iter([2, 33]),
    }
}

fn stranger(which: usize) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::new(198, 51, 100, 9), 50_000 + which as u16)
}
