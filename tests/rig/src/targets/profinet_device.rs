//! A PROFINET device behind a core, under any sequence of datagrams of clients and of the device, of
//! pauses, and of new configurations.
//!
//! The input is read as a list of steps. After each step, the core's public functions and the codec show
//! whether the rules hold: nothing but reading reaches the device, in one piece or in fragments; an
//! answer reaches the client that made the call; a dropped datagram leaves nothing behind; and
//! everything is counted.

mod calls;
mod datagrams;
mod reading;
pub mod seeds;

use std::collections::{BTreeSet, HashMap};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use pnet_nat::nat::{
    Arrival, Chance, Core, Counters, Direction, DropReason, FlowRecord, Limits, ListenerId,
    Mapping, MappingId, Net, NetId, NetKind, Payload, Record, Records, RequestRate, Rules,
    Succession, Table, ToClient, ToServer, Transition, UpstreamId,
};
use pnet_nat::pnet::wire;
use pnet_nat::profinet::rpc::Rpc;

use super::input::Input;
use super::sockets::Sockets;
use calls::Calls;
use datagrams::Sent;
use reading::Part;

const DEVICE: &str = "172.17.17.7:34964";
const LISTENER: ListenerId = ListenerId(0);
const MAPPING: MappingId = MappingId(0);
/// N-9.
const REST: Duration = Duration::from_secs(120);

const CLIENTS: [&str; 5] = [
    "198.51.100.1:1000",
    "198.51.100.1:1001",
    "198.51.100.9:1000", // not in the smaller allow list
    "[2001:db8::1]:1000",
    "203.0.113.1:1000", // outside every allow list
];
const PUBLIC: [&str; 2] = ["192.0.2.1", "192.0.2.2"];

/// Does the steps that the octets stand for, and checks everything after each.
pub fn holds(octets: &[u8]) {
    passed(octets);
}

/// The same. How many datagrams have passed, from clients and from the device.
pub fn passed(octets: &[u8]) -> [u64; 2] {
    let mut input = Input::new(octets);
    let mut world = World::new(&mut input);
    while !input.is_over() {
        world.step(&mut input);
        world.check();
    }
    world.end()
}

struct World {
    core: Core,
    counters: Arc<Counters>,
    sockets: Sockets,
    now: Instant,
    rules: Rules,
    records: Records,
    /// Whether some flows may not have gone over to the rules yet.
    going_over: bool,
    calls: Calls,
    /// The last client of each upstream port, and until when it had the port.
    users: HashMap<u16, (SocketAddr, Instant)>,
    passed: [u64; 2],
}

impl World {
    fn new(input: &mut Input<'_>) -> Self {
        let now = Instant::now();
        let (table, records) = table(input);
        let rules = Rules::new(table, LIMITS);
        let counters = Arc::new(Counters::new(&rules.table));
        let core = Core::new(rules.clone(), Arc::clone(&counters), now, Chance::from_seed(1));
        let sockets = Sockets { limit: 8, ..Sockets::default() };
        let (calls, users) = (Calls::default(), HashMap::new());
        Self {
            core,
            counters,
            sockets,
            now,
            rules,
            records,
            going_over: false,
            calls,
            users,
            passed: [0; 2],
        }
    }

    fn step(&mut self, input: &mut Input<'_>) {
        match input.octet() {
            0..=127 => self.request(input),
            128..=207 => self.response(input),
            208..=235 => self.pass_time(input),
            236..=239 => self.sockets.limit = usize::from(input.octet() % 12),
            240..=243 => self.go_over(),
            _ => self.reload(input),
        }
        self.forget_closed();
    }

    fn flows(&self) -> Vec<FlowRecord> {
        self.core.flows(self.now).collect()
    }

    /// The flow that a socket belongs to. There is one at most, since the device may answer from any
    /// port.
    fn flow_of(&self, via: UpstreamId) -> Option<FlowRecord> {
        let port = self.sockets.ports.get(&via)?;
        let mut flows = self.core.flows(self.now).filter(|flow| flow.upstream_port == *port);
        let flow = flows.next();
        assert!(flows.next().is_none(), "whose answer is it?");
        flow
    }

    /// What is known of the calls of a flow goes with it.
    fn forget_closed(&mut self) {
        for (port, _, client) in std::mem::take(&mut self.sockets.just_closed) {
            self.calls.forget(port);
            self.users.insert(port, (client, self.now));
        }
    }

    fn request(&mut self, input: &mut Input<'_>) {
        let client: SocketAddr = input.choice(&CLIENTS).parse().unwrap();
        let public_address: IpAddr = input.choice(&PUBLIC).parse().unwrap();
        let arrival = Arrival { listener: LISTENER, mapping: MAPPING, public_address, client };
        let Sent { mut octets, is_sound_read } = datagrams::of_client(input);
        let is_sent = input.octet() % 16 < 15;
        let sent = octets.clone();

        let before = self.flows();
        let is_its =
            |flow: &FlowRecord| (flow.client, flow.public_address) == (client, public_address);
        let known = before.iter().any(is_its);
        let mut payload = Payload::from(&mut octets[..]);
        let verdict = self.core.request(self.now, &arrival, &mut payload, &mut self.sockets);
        assert_eq!(*payload, sent[..], "octets stay as they are");
        self.forget_closed();
        let after = self.flows();
        let is_allowed = self.rules.table.allows(NetId(0), client.ip());
        let to = match verdict {
            Ok(to) => to,
            Err(reason) => {
                assert!(DropReason::RPC_REQUEST.contains(&reason), "{reason:?}");
                assert!(reason != DropReason::SendFailed, "nothing was sent");
                assert_eq!(after, before, "nothing is remembered of it");
                let is_limit = matches!(
                    reason,
                    DropReason::RequestLimit
                        | DropReason::FlowLimit
                        | DropReason::UpstreamExhausted
                );
                let may_pass =
                    is_sound_read.is_some_and(|index| reading::is_in(self.records, index));
                assert!(!may_pass || !is_allowed || is_limit, "{reason:?} of a read");
                return;
            }
        };

        assert!(known || is_allowed, "a flow of a source that is not allowed");
        assert_eq!(after.len(), before.len() + usize::from(!known));
        let flow = after.iter().find(|flow| is_its(flow)).expect("it has a flow");
        assert_eq!((flow.upstream_port, flow.idle), (self.sockets.ports[&to.via], Duration::ZERO));
        self.use_port(flow);
        self.reached(&sent, flow, &to);
        if !is_sent {
            return self.core.send_failed(MAPPING, Direction::Request);
        }
        self.core.request_sent(self.now, MAPPING, to.asks, sent.len());
        self.passed[0] += 1;
    }

    /// A port is for one client, and later for another one: a late answer must not reach that.
    fn use_port(&mut self, flow: &FlowRecord) {
        let previous = self.users.insert(flow.upstream_port, (flow.client, self.now));
        if let Some((other, last)) = previous.filter(|(other, _)| *other != flow.client) {
            assert!(self.now - last >= REST, "N-9: the port of {other} for {}", flow.client);
        }
    }

    /// What the device receives is a part of a read or of a look-up, and goes where its call is
    /// answered.
    fn reached(&mut self, octets: &[u8], flow: &FlowRecord, to: &ToServer) {
        let rpc = Rpc::parse(octets).expect("it is checked whole");
        let (header, part) = (rpc.header(), reading::part_of(&rpc, self.records));
        let device: SocketAddr = DEVICE.parse().unwrap();
        assert_eq!(to.server.ip(), device.ip());
        let call = self.calls.asked(self.now, flow, header, to.server.port());
        match (call.port, call.is_certain) {
            (0, true) => assert_eq!(to.server, device),
            (port, true) => assert_eq!(to.server.port(), port, "P-8"),
            (port, false) => assert!([device.port(), port].contains(&to.server.port()), "P-8"),
        }
        let goes_on = match &part {
            Part::Whole => false,
            Part::Fragment { number, .. } => *number > 0,
            Part::Signal => true,
        };
        assert!(!goes_on || call.was_known, "it belongs to no call");
        let is_last = match part {
            Part::Whole => true,
            Part::Signal => false,
            Part::Fragment { is_last, .. } => {
                self.calls.fragment(flow, header, call.is_certain, part, self.records);
                is_last
            }
        };
        assert_eq!(to.asks.is_some(), is_last && !header.flags1.is_maybe());
    }

    fn response(&mut self, input: &mut Input<'_>) {
        let stray = input.octet();
        let known = self.calls.known(input.octet());
        let (via, call) = match known {
            Some((port, call)) if stray % 8 != 7 => (self.sockets.id_of(port), Some(call)),
            _ => (None, None),
        };
        let via = via.unwrap_or(UpstreamId(u32::from(stray / 8 % 12)));
        let ip: IpAddr = if stray == 255 { "172.17.17.8" } else { "172.17.17.7" }.parse().unwrap();
        let from = SocketAddr::new(ip, input.choice(&[34_964, 49_153, 9_001, 1, 0]));
        let (mut octets, is_sound) = datagrams::of_device(input, call);
        let is_sent = input.octet() % 16 < 15;
        let sent = octets.clone();

        let before = self.flows();
        let flow = self.flow_of(via).filter(|_| stray != 255);
        let is_due = is_sound
            && flow.as_ref().zip(call).is_some_and(|(flow, call)| {
                self.calls.is_certain(self.now, flow.upstream_port, call)
            });
        let mut payload = Payload::from(&mut octets[..]);
        let verdict = self.core.response(self.now, via, from, &mut payload);
        assert_eq!(*payload, sent[..], "octets stay as they are");
        let to = match verdict {
            Ok(to) => to,
            Err(reason) => {
                assert!(DropReason::RPC_RESPONSE.contains(&reason), "{reason:?}");
                assert_eq!(reason == DropReason::UnknownFlow, flow.is_none());
                assert_eq!(self.flows(), before, "nothing is remembered of it");
                assert!(!is_due, "{reason:?} of an answer to the last call");
                return;
            }
        };

        let flow = flow.expect("it has a flow");
        let (public_address, client) = (flow.public_address, flow.client);
        let expected = ToClient { via: LISTENER, public_address, client, mapping: MAPPING };
        assert_eq!(to, expected, "an answer to another client, or from elsewhere");
        let rpc = Rpc::parse(&sent).expect("it is checked whole");
        assert!(!rpc.header().packet_type.is_from_client(), "a call of the device");
        self.use_port(&flow);
        self.calls.answered(self.now, &flow, rpc.header(), from.port());
        if !is_sent {
            return self.core.send_failed(MAPPING, Direction::Response);
        }
        self.core.response_sent(MAPPING, sent.len());
        self.passed[1] += 1;
    }

    /// All flows go over to a new configuration within moments, so its idle timeout holds by then.
    fn pass_time(&mut self, input: &mut Input<'_>) {
        self.go_over();
        self.forget_closed();
        let unit = input.choice(&[1, 250, 5_000, 60_000]);
        self.now += Duration::from_millis(unit * u64::from(input.octet()));
        let idle_timeout = self.rules.table.net(NetId(0)).idle_timeout;
        let mut lively = self.flows();
        lively.retain(|flow| flow.idle < idle_timeout);
        self.expire();
        assert_eq!(self.flows(), lively, "N-2, N-3: closed too early or too late");
    }

    /// Flows stay open where the records stay the same and their clients are still allowed.
    fn reload(&mut self, input: &mut Input<'_>) {
        let before = self.flows();
        let ((table, records), was) = (table(input), self.records);
        let rules = self.rules.followed_by(table, LIMITS);
        let transition = Arc::new(Transition::new(&self.rules, &rules, BTreeSet::new()));
        self.counters = Arc::new(self.counters.followed_by(&self.rules.table, &rules.table));
        (self.rules, self.records) = (rules.clone(), records);
        let counters = Arc::clone(&self.counters);
        let succession = Succession { rules, counters, transition };
        self.core.reload(self.now, succession, &mut self.sockets);
        self.going_over = true;
        let stays = |flow: &&FlowRecord| {
            records == was && self.rules.table.allows(NetId(0), flow.client.ip())
        };
        assert!(self.flows().iter().eq(before.iter().filter(stays)), "other flows than before");
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

    fn check(&self) {
        let (open, told) =
            (self.flows().len(), self.sockets.opened_flows - self.sockets.closed_flows);
        // A flow that is withdrawn is not shown any more, but is closed only in its turn.
        assert!(open == told || open < told && self.going_over, "{open} flows instead of {told}");
        let counted = self.counters.net(NetId(0)).flows.get();
        assert!(counted == open as u64 || self.going_over, "{counted} of {open}");
        for node in [self.counters.node(MAPPING), &*self.counters.stray] {
            for direction in Direction::ALL.map(|direction| node.direction(direction)) {
                let accounted = direction.forwarded.get() + direction.dropped_total();
                assert_eq!(direction.received.get(), accounted, "the law of the counters");
            }
        }
    }

    /// Nothing is left behind.
    fn end(mut self) -> [u64; 2] {
        self.core.shut_down(self.now, &mut self.sockets);
        self.check();
        assert_eq!(self.flows(), []);
        self.now += REST;
        self.expire();
        assert!(self.sockets.ports.is_empty(), "sockets stay open");
        assert!(self.core.is_idle() && !self.core.awaits_answers(self.now));
        self.passed
    }
}

const LIMITS: Limits = Limits {
    max_flows: 6,
    wrong_password_burst: 2,
    wrong_password_address_burst: 1024,
    wrong_password_interval: Duration::from_secs(60),
};

/// One device. Each bit of an octet is one difference.
fn table(input: &mut Input<'_>) -> (Arc<Table>, Records) {
    let variant = input.octet();
    let differs = |bit: u8| variant & (1 << bit) != 0;
    let near = if differs(0) { "198.51.100.0/29" } else { "198.51.100.0/24" };
    let records: Records = match (differs(1), differs(2)) {
        (false, false) => Records::default(),
        (true, false) => Records::all(),
        (false, true) => [Record::Im0].into_iter().collect(),
        (true, true) => [Record::Diagnosis, Record::ApiData].into_iter().collect(),
    };
    let net = Net {
        allow: vec![near.parse().unwrap(), "2001:db8::/64".parse().unwrap()],
        allow_without_password: true,
        idle_timeout: Duration::from_secs(if differs(3) { 30 } else { 150 }),
        max_flows: if differs(4) { 2 } else { 100 },
        max_flow_requests: differs(5).then(|| RequestRate::new(2)),
        ..Net::new("drive-7", NetKind::ProfinetDevice { records })
    };
    let mapping = Mapping {
        net: NetId(0),
        node_address: 0,
        local_address: None,
        public_port: 45_007,
        server: DEVICE.parse().unwrap(),
    };
    (Arc::new(Table::new(wire::Header::default(), vec![net], vec![mapping])), records)
}
