//! A core under any sequence of datagrams, pauses, limits of sockets and new configurations.
//!
//! The input is read as a list of steps. After each step, the core's public functions show whether
//! the rules hold: nothing passes without a password, no flow is left of a dropped datagram, an
//! answer reaches the one client that it belongs to, and every datagram is counted.

mod tables;

use std::collections::{BTreeSet, HashMap};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use pnet_nat::nat::{
    Arrival, Chance, Core, Counters, Credential, Direction, DropReason, FlowRecord, ListenerId,
    Mapping, Payload, Rules, Succession, Table, ToClient, Transition, UpstreamId,
};
use pnet_nat::pnet::wire::{BNA, Datagram, Header, Password};

use super::input::Input;
use super::sockets::Sockets;

/// N-9.
const REST: Duration = Duration::from_secs(120);
/// After this time, all wrong passwords are forgiven.
const LONGEST_THROTTLING: Duration = Duration::from_secs(3600);
const DIRECTIONS: [Direction; 2] = [Direction::Request, Direction::Response];

const CLIENTS: [&str; 8] = [
    "198.51.100.1:1000",
    "198.51.100.1:1001",
    "198.51.100.2:1000",
    "198.51.100.9:1000",
    "[2001:db8::1]:1000",
    "[2001:db8::2]:1000",
    "[::ffff:198.51.100.3]:1000",
    "203.0.113.1:1000", // outside every allow list
];
const PUBLIC: [&str; 2] = ["192.0.2.1", "2001:db8:1::1"];

/// Does the steps that the octets stand for, and checks everything after each.
pub fn holds(octets: &[u8]) {
    let mut input = Input::new(octets);
    let mut world = World::new(&mut input);
    while !input.is_over() {
        world.step(&mut input);
        world.check();
    }
    world.end();
}

struct World {
    core: Core,
    counters: Arc<Counters>,
    sockets: Sockets,
    now: Instant,
    rules: Rules,
    /// Whether some flows may not have gone over to the rules yet.
    going_over: bool,
    /// Flows that were open before the last reload, of each net and of all. A lower limit does not
    /// close them.
    flows_before_reload: Vec<usize>,
    /// What nodes received, and through which socket.
    at_nodes: Vec<(UpstreamId, SocketAddr, Vec<u8>)>,
    /// The last client of each (port, server), and until when it had the pair.
    users: HashMap<(u16, SocketAddr), (SocketAddr, Instant)>,
}

impl World {
    fn new(input: &mut Input<'_>) -> Self {
        let now = Instant::now();
        let rules = tables::rules(input);
        let counters = Arc::new(Counters::new(&rules.table));
        let core = Core::new(rules.clone(), Arc::clone(&counters), now, Chance::from_seed(1));
        let sockets = Sockets { limit: 8, ..Sockets::default() };
        let flows_before_reload = vec![0; rules.table.nets().len() + 1];
        let (at_nodes, users) = (Vec::new(), HashMap::new());
        Self {
            core,
            counters,
            sockets,
            now,
            rules,
            going_over: false,
            flows_before_reload,
            at_nodes,
            users,
        }
    }

    fn step(&mut self, input: &mut Input<'_>) {
        match input.octet() {
            0..=127 => self.request(input),
            128..=207 => self.response(input),
            208..=239 => self.pass_time(input),
            240..=243 => self.sockets.limit = usize::from(input.octet() % 12),
            244..=247 => self.go_over(),
            _ => self.reload(input),
        }
        self.give_up_pairs();
    }

    fn flows(&self) -> Vec<FlowRecord> {
        self.core.flows(self.now).collect()
    }

    fn request(&mut self, input: &mut Input<'_>) {
        let table = Arc::clone(&self.rules.table);
        let id = input.choice(&table.mapping_ids().collect::<Vec<_>>());
        let mapping = table.mapping(id);
        let listener = listener(&mapping);
        let net = table.net(mapping.net);
        let client: SocketAddr = input.choice(&CLIENTS).parse().unwrap();
        let public_address: IpAddr = input.choice(&PUBLIC).parse().unwrap();
        let arrival = Arrival { listener, mapping: id, public_address, client };
        let sent = input.datagram(mapping.node_address);

        let before = self.flows();
        let is_its = |flow: &FlowRecord| {
            (flow.client, flow.public_address, flow.mapping) == (client, public_address, id)
        };
        let known = before.iter().any(is_its);
        let mut room = [&sent[..], &[0; Password::LEN]].concat();
        let mut payload = Payload::new(&mut room, sent.len());
        let verdict = self.core.request(self.now, &arrival, &mut payload, &mut self.sockets);
        let got = payload.to_vec();
        let after = self.flows();
        let to = match verdict {
            Ok(to) => to,
            Err(reason) => {
                assert!(DropReason::REQUEST.contains(&reason), "{reason:?}");
                assert!(reason != DropReason::SendFailed, "nothing was sent");
                assert_eq!(got, sent, "a dropped datagram stays as it was");
                assert_eq!(after, before, "nothing is remembered of it");
                return;
            }
        };

        assert_eq!(to.server, mapping.server, "R-9");
        assert!(
            known || table.allows(mapping.net, client.ip()),
            "a flow of a source that is not allowed"
        );
        assert_eq!(after.len(), before.len() + usize::from(!known));
        let flow = after.iter().find(|flow| is_its(flow)).expect("it has a flow");
        assert_eq!((flow.upstream_port, flow.idle), (self.sockets.ports[&to.via], Duration::ZERO));
        let datagram = Datagram::parse(&sent, Header::default()).expect("R-5");
        let route = datagram.route();
        assert_eq!(route.node_address(), Some(mapping.node_address), "R-10");
        assert!(route.destinations().all(|element| element < BNA), "R-43");
        let credential = flow.credential.map(|index| &net.credentials[index]);
        if net.kind.is_remote() {
            assert_eq!(datagram.password(), None, "two passwords");
            assert_eq!(got, [&sent, &net.credentials[0].password.octets()[..]].concat(), "R-3");
        } else {
            assert_eq!(datagram.password(), credential.map(|is| is.password.octets()), "R-7");
            assert!(credential.is_some() || net.allow_without_password, "R-3");
            let expected = with_password(&sent, credential.map(|is| is.at_server()));
            assert_eq!(got, expected, "R-8");
        }

        self.use_pair(flow.upstream_port, to.server, client);
        if input.octet() % 16 == 15 {
            return self.core.send_failed(id, Direction::Request);
        }
        self.core.request_sent(self.now, id, to.asks, got.len());
        self.at_nodes.push((to.via, to.server, got));
    }

    fn response(&mut self, input: &mut Input<'_>) {
        let table = Arc::clone(&self.rules.table);
        let (via, server, sent) = if self.at_nodes.is_empty() || input.octet() % 8 == 7 {
            let servers: Vec<_> = table.mappings().iter().map(|mapping| mapping.server).collect();
            let stray: SocketAddr = "172.17.17.99:34379".parse().unwrap();
            let server = input.choice(&[&servers[..], &[stray]].concat());
            (UpstreamId(u32::from(input.octet() % 12)), server, input.datagram(1))
        } else {
            // The core checks only the format and the password of a response, so an echo will do.
            let index = usize::from(input.octet()) % self.at_nodes.len();
            let (via, server, mut octets) = self.at_nodes[index].clone();
            if input.octet() % 8 == 7 {
                octets.truncate(octets.len().saturating_sub(Password::LEN));
            }
            input.damage(&mut octets);
            (via, server, octets)
        };

        let before = self.flows();
        let port = self.sockets.ports.get(&via);
        let is_its = |flow: &&FlowRecord| {
            Some(&flow.upstream_port) == port && table.mapping(flow.mapping).server == server
        };
        let flow = before.iter().find(is_its);
        assert!(before.iter().filter(is_its).count() <= 1, "whose answer is it?");
        let mut room = sent.clone();
        let mut payload = Payload::from(&mut room[..]);
        let verdict = self.core.response(self.now, via, server, &mut payload);
        let got = payload.to_vec();
        let to = match verdict {
            Ok(to) => to,
            Err(reason) => {
                assert!(DropReason::RESPONSE.contains(&reason), "{reason:?}");
                assert_eq!(reason == DropReason::UnknownFlow, flow.is_none());
                assert_eq!(got, sent, "a dropped datagram stays as it was");
                assert_eq!(self.flows(), before, "nothing is remembered of it");
                return;
            }
        };

        let flow = flow.expect("it has a flow");
        let (public_address, client, mapping) = (flow.public_address, flow.client, flow.mapping);
        let via = listener(&table.mapping(mapping));
        let expected = ToClient { via, public_address, client, mapping };
        assert_eq!(to, expected, "an answer to another client, or from elsewhere");
        let net = table.net(table.mapping(mapping).net);
        match Datagram::parse(&sent, Header::default()).expect("R-5").password() {
            Some(password) => {
                let mut fit =
                    net.credentials.iter().filter(|is| is.at_server().octets() == password);
                let as_sent = |is: &Credential| match net.kind.is_remote() {
                    true => sent == [&got, &is.password.octets()[..]].concat(),
                    false => with_password(&sent, Some(&is.password)) == got,
                };
                assert!(fit.any(as_sent), "A16, R-8");
            }
            None => {
                assert!(!net.require_response_password, "A16");
                assert_eq!(got, sent, "R-8");
            }
        }
        self.use_pair(flow.upstream_port, server, client);
        match input.octet() % 16 {
            15 => self.core.send_failed(mapping, Direction::Response),
            _ => self.core.response_sent(mapping, got.len()),
        }
    }

    fn use_pair(&mut self, port: u16, server: SocketAddr, client: SocketAddr) {
        let previous = self.users.insert((port, server), (client, self.now));
        if let Some((other, last)) = previous.filter(|(other, _)| *other != client) {
            assert!(self.now - last >= REST, "N-9: the port of {other} for {client}");
        }
    }

    fn give_up_pairs(&mut self) {
        for (port, server, client) in std::mem::take(&mut self.sockets.just_closed) {
            self.users.insert((port, server), (client, self.now));
        }
    }

    fn pass_time(&mut self, input: &mut Input<'_>) {
        let unit = input.choice(&[1, 250, 5_000, 60_000, 3_600_000]);
        self.now += Duration::from_millis(unit * u64::from(input.octet()));
        let table = Arc::clone(&self.rules.table);
        let is_lively =
            |flow: &FlowRecord| flow.idle < table.net(table.mapping(flow.mapping).net).idle_timeout;
        let mut lively = self.flows();
        lively.retain(is_lively);
        self.expire();
        assert_eq!(self.flows(), lively, "N-2, N-3: closed too early or too late");
    }

    /// Flows that stay open keep client, port, server and passwords. No new one opens.
    fn reload(&mut self, input: &mut Input<'_>) {
        let rules = tables::followed_by(&self.rules, input);
        let (old, new) = (Arc::clone(&self.rules.table), Arc::clone(&rules.table));
        let listeners =
            |table: &Table| -> BTreeSet<_> { table.mappings().iter().map(listener).collect() };
        let gone = listeners(&old).difference(&listeners(&new)).copied().collect();
        let transition = Arc::new(Transition::new(&self.rules, &rules, gone));
        self.counters = Arc::new(self.counters.followed_by(&old, &new));
        let (rules, counters) = (rules.clone(), Arc::clone(&self.counters));
        let before: Vec<_> = self.flows().iter().map(|flow| lasting(&old, flow)).collect();
        self.rules = rules.clone();
        let succession = Succession { rules, counters, transition };
        self.core.reload(self.now, succession, &mut self.sockets);
        self.going_over = true;
        for flow in &self.flows() {
            assert!(before.contains(&lasting(&new, flow)), "{flow:?} was another one before");
            let net = new.mapping(flow.mapping).net;
            assert!(new.allows(net, flow.client.ip()), "{flow:?} has no right any more");
        }
        self.flows_before_reload = self.open_flows();
    }

    /// Lets all flows go over to the last new configuration.
    fn go_over(&mut self) {
        let before = self.flows();
        while self.going_over {
            self.going_over = self.core.go_over(self.now, &mut self.sockets).is_none();
        }
        assert_eq!(self.flows(), before, "it held from the first moment on");
    }

    fn expire(&mut self) {
        while self.core.expire(self.now, &mut self.sockets) {}
    }

    /// Flows of each net, and of all.
    fn open_flows(&self) -> Vec<usize> {
        let table = &self.rules.table;
        let mut open = vec![0; table.nets().len() + 1];
        for flow in self.core.flows(self.now) {
            open[usize::from(table.mapping(flow.mapping).net.0)] += 1;
            *open.last_mut().unwrap() += 1;
        }
        open
    }

    fn check(&self) {
        let (table, open) = (&self.rules.table, self.open_flows());
        let (all, told) =
            (open[table.nets().len()], self.sockets.opened_flows - self.sockets.closed_flows);
        // A flow that is withdrawn is not shown any more, but is closed only in its turn.
        assert!(all == told || (all < told && self.going_over), "{all} flows instead of {told}");
        for (net, &open) in table.net_ids().zip(&open) {
            let counted = self.counters.net(net).flows.get();
            assert!(counted == open as u64 || self.going_over, "{net:?}: {counted} of {open}");
        }
        let limits = table.nets().iter().map(|net| net.max_flows);
        let limits = limits.chain([self.rules.limits.max_flows]);
        for ((&open, limit), &before) in open.iter().zip(limits).zip(&self.flows_before_reload) {
            assert!(open <= before.max(limit as usize), "N-8: {open} flows, limit {limit}");
        }
        let nodes = table.mapping_ids().map(|id| self.counters.node(id));
        for node in nodes.chain([&*self.counters.stray]) {
            for direction in DIRECTIONS.map(|direction| node.direction(direction)) {
                let accounted = direction.forwarded.get() + direction.dropped_total();
                assert_eq!(direction.received.get(), accounted, "the law of the counters");
            }
        }
    }

    /// Nothing is left behind.
    fn end(mut self) {
        self.core.shut_down(self.now, &mut self.sockets);
        self.check();
        assert_eq!(self.flows(), []);
        self.now += REST;
        self.expire();
        assert!(self.sockets.ports.is_empty(), "sockets stay open");
        self.now += LONGEST_THROTTLING;
        self.expire();
        assert_eq!(self.sockets.throttled, 0, "throttled for ever");
        assert!(self.core.is_idle() && !self.core.awaits_answers(self.now));
        let nets = self.rules.table.net_ids();
        assert!(nets.into_iter().all(|net| self.counters.net(net).flows.get() == 0));
    }
}

/// The public socket of a port. It keeps its name as long as there is one.
fn listener(mapping: &Mapping) -> ListenerId {
    let node = if mapping.local_address.is_some() { mapping.node_address } else { 0 };
    ListenerId(u32::from(mapping.public_port) << 8 | u32::from(node))
}

/// The octets with this password instead of their own.
fn with_password(octets: &[u8], password: Option<&Password>) -> Vec<u8> {
    match password {
        Some(password) => [&octets[..octets.len() - Password::LEN], password.octets()].concat(),
        None => octets.to_vec(),
    }
}

/// What of a flow stays the same in a reload.
fn lasting(
    table: &Table,
    flow: &FlowRecord,
) -> (SocketAddr, IpAddr, String, [u16; 2], [[u8; 8]; 2]) {
    let mapping = table.mapping(flow.mapping);
    let net = table.net(mapping.net);
    let passwords = flow.credential.map_or([[0; 8]; 2], |index| {
        let is = &net.credentials[index];
        [is.password.octets(), is.at_server().octets()].map(|octets| *octets)
    });
    let way = format!("{} {} {}", net.name, mapping.node_address, mapping.server);
    let ports = [mapping.public_port, flow.upstream_port];
    (flow.client, flow.public_address, way, ports, passwords)
}
