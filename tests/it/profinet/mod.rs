//! PROFINET's DCE/RPC between controllers and devices that others wrote: directly, and through the
//! kernel's port forward, and through the relay. docs/profinet.md shows what works, and has to show it
//! as it is.
//!
//! Needs root, nft, and profinet-py and scapy, which `.ci/run` installs.

mod hostile;
mod through;

use std::collections::BTreeSet;
use std::fmt::{self, Write};
use std::thread;

use serde_json::{Value, json};
use through::{DEVICE, Through, start_relay};

use crate::harness::{
    IDENTIFICATION, IoDevice, Network, PNIO_PORT, Packet, Process, eventually, has_nft,
    has_profinet_peers, pnet_nat, profinet_peer,
};

/// One thing that controllers do.
struct Exchange {
    what: &'static str,
    device: Device,
    controller: Controller,
    direct: Outcome,
    port_forward: Outcome,
    masquerade: Outcome,
    relay: Outcome,
}

enum Device {
    /// The crate `pnio`, which answers from this port.
    Pnio(u16),
    /// `scapy_peer.py serve` with these arguments.
    Scapy(&'static str),
}

enum Controller {
    /// `controller.py` with these arguments behind the address.
    ProfinetPy(&'static str),
    /// `scapy_peer.py` in this role, with these arguments.
    Scapy(&'static str, &'static str),
    /// `scapy_peer.py` reads at the port that the endpoint mapper tells.
    Mapped,
    /// `pnet-nat inventory`.
    Inventory,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Works,
    /// The answer came, with the device's own address and port.
    FromInside,
    NoAnswer,
}
use Outcome::{FromInside, NoAnswer, Works};

const EXCHANGES: [Exchange; 11] = [
    Exchange {
        what: "a device that answers from port 34964",
        device: Device::Pnio(PNIO_PORT),
        controller: Controller::ProfinetPy(""),
        direct: Works,
        port_forward: Works,
        masquerade: Works,
        relay: Works,
    },
    Exchange {
        what: "a device that answers from another port; the controller asks on at 34964",
        device: Device::Pnio(9001),
        controller: Controller::ProfinetPy("--any-port"),
        direct: Works,
        port_forward: FromInside,
        masquerade: NoAnswer,
        relay: Works,
    },
    Exchange {
        what: "the same; the controller asks on at the port that answered",
        device: Device::Pnio(49200),
        controller: Controller::ProfinetPy("--follow"),
        direct: Works,
        port_forward: FromInside,
        masquerade: NoAnswer,
        relay: Works,
    },
    Exchange {
        what: "a request in little-endian, its answer in big-endian",
        device: Device::Pnio(PNIO_PORT),
        controller: Controller::Scapy("read", "--little"),
        direct: Works,
        port_forward: Works,
        masquerade: Works,
        relay: Works,
    },
    Exchange {
        what: "a request in big-endian, its answer in little-endian and in fragments",
        device: Device::Scapy("--answer-from 34964 --little --fragment 200"),
        controller: Controller::Scapy("read", "--record 0xF000"),
        direct: Works,
        port_forward: Works,
        masquerade: Works,
        relay: Works,
    },
    Exchange {
        what: "request and answer in fragments, from another port",
        device: Device::Scapy("--answer-from 49200 --fragment 200"),
        controller: Controller::Scapy("read", "--record 0xF000 --fragments 3 --follow"),
        direct: Works,
        port_forward: FromInside,
        masquerade: NoAnswer,
        relay: Works,
    },
    Exchange {
        what: "ping and cancel",
        device: Device::Scapy("--answer-from 34964"),
        controller: Controller::Scapy("cancel", "--little"),
        direct: Works,
        port_forward: Works,
        masquerade: Works,
        relay: Works,
    },
    Exchange {
        what: "ping and cancel, answered from another port",
        device: Device::Scapy("--answer-from 9001"),
        controller: Controller::Scapy("cancel", "--any-port"),
        direct: Works,
        port_forward: FromInside,
        masquerade: NoAnswer,
        relay: Works,
    },
    Exchange {
        what: "the endpoint mapper is asked for the device's port",
        device: Device::Scapy("--answer-from 49200 --mapper"),
        controller: Controller::Scapy("lookup", ""),
        direct: Works,
        port_forward: Works,
        masquerade: Works,
        relay: Works,
    },
    Exchange {
        what: "and the device is asked at that port",
        device: Device::Scapy("--answer-from 49200 --mapper"),
        controller: Controller::Mapped,
        direct: Works,
        port_forward: NoAnswer,
        masquerade: NoAnswer,
        relay: NoAnswer,
    },
    Exchange {
        what: "`pnet-nat inventory` asks a device that answers from another port",
        device: Device::Pnio(9001),
        controller: Controller::Inventory,
        direct: Works,
        port_forward: NoAnswer,
        masquerade: NoAnswer,
        relay: Works,
    },
];

impl Exchange {
    fn expected(&self, through: Through) -> Outcome {
        match through {
            Through::Direct => self.direct,
            Through::PortForward => self.port_forward,
            Through::Masquerade => self.masquerade,
            Through::Relay => self.relay,
        }
    }

    /// Runs it, and says what is not as expected.
    fn surprise(&self, through: Through, network: &Network) -> Option<String> {
        let expected = self.expected(through);
        let _device = self.device.start(network);
        let printed = self.controller.run(through, network, expected != NoAnswer);
        let outcome = Outcome::of(&printed);
        let surprise = || format!("{through:?}, {}: {outcome:?}: {printed}", self.what);
        (outcome != Some(expected)).then(surprise)
    }
}

/// A device at work.
enum Running {
    Pnio { _device: IoDevice },
    Scapy { _process: Process },
}

impl Device {
    fn start(&self, network: &Network) -> Running {
        match self {
            Self::Pnio(port) => {
                let start = || IoDevice::start(DEVICE.into(), *port).unwrap();
                Running::Pnio { _device: network.plant.enter(start) }
            }
            Self::Scapy(arguments) => {
                let arguments = format!("serve {DEVICE} {arguments}");
                let start = || Process::start(profinet_peer("scapy_peer", &arguments));
                let process = network.plant.enter(start);
                let is_ready = || process.stdout().contains("ready").then_some(());
                eventually("the device is ready", is_ready);
                Running::Scapy { _process: process }
            }
        }
    }
}

impl Controller {
    /// What the controller prints. Where no answer is expected, there is less to wait for.
    fn run(&self, through: Through, network: &Network, answers: bool) -> Value {
        let timeout = if answers { 20 } else { 2 };
        let run = |script, arguments: &str| {
            let arguments = format!("{arguments} --timeout {timeout}");
            let start = || Process::start(profinet_peer(script, &arguments));
            let mut process = through.controllers(network).enter(start);
            process.end();
            serde_json::from_str(&process.stdout()).unwrap_or_else(|_| panic!("{process:?}"))
        };
        let asked = through.asked();
        match self {
            Self::ProfinetPy(arguments) => run("controller", &format!("{asked} {arguments}")),
            Self::Scapy(role, arguments) => {
                run("scapy_peer", &format!("{role} {asked} {arguments}"))
            }
            Self::Mapped => {
                let told: Value = run("scapy_peer", &format!("lookup {asked}"));
                let endpoints = told["found"]["endpoints"].as_array().unwrap();
                let is_device =
                    |entry: &&Value| entry["interface"].as_str().unwrap().starts_with("dea00001-");
                let port = endpoints.iter().find(is_device).unwrap()["port"].as_u64().unwrap();
                assert_eq!(port, 49200);
                run("scapy_peer", &format!("read {}", through.asked_at(port as u16)))
            }
            Self::Inventory => {
                let arguments = ["inventory", &asked, "--timeout", "2s", "--format", "json"];
                let start = || Process::start(pnet_nat(&arguments));
                let mut process = through.controllers(network).enter(start);
                process.end();
                let is_found = process.stdout().contains("\"PUMP-4711\"");
                json!({ "problems": if is_found { json!([]) } else { json!(["no answer"]) } })
            }
        }
    }
}

impl Outcome {
    /// What comes of an exchange; `None` if the peers do not understand each other.
    fn of(printed: &Value) -> Option<Self> {
        let problems: Vec<_> = printed["problems"].as_array()?.iter().collect();
        let last = printed["exchanges"].as_array().and_then(|exchanges| exchanges.last());
        let from = last.unwrap_or(&printed["found"])["answered_from"].as_str();
        match problems[..] {
            [] => Some(Works),
            [problem] if problem == "no answer" => Some(NoAnswer),
            [problem] if problem == "the source of an answer is wrong" => {
                from?.starts_with(&format!("{DEVICE}:")).then_some(FromInside)
            }
            _ => None,
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Works => "yes",
            FromInside => "no: the answer has an address of the plant",
            NoAnswer => "no: no answer",
        })
    }
}

fn can_run() -> bool {
    has_profinet_peers() && has_nft()
}

#[test]
fn every_exchange_works_directly_and_as_the_table_says_through_the_kernel() {
    if !can_run() || Network::build().is_none() {
        return;
    }
    let surprises = |through: Through| {
        let network = Network::build().unwrap();
        let relay = through.prepare(&network);
        let surprise = |exchange: &Exchange| exchange.surprise(through, &network);
        let surprises = EXCHANGES.iter().filter_map(surprise).collect::<Vec<_>>();
        if let Some(relay) = relay {
            network.edge.enter(|| {
                relay.expect_drops(&[]);
                relay.finish();
            });
        }
        surprises
    };
    let surprises: Vec<_> = thread::scope(|scope| {
        let running = Through::ALL.map(|through| scope.spawn(move || surprises(through)));
        running.into_iter().flat_map(|all| all.join().unwrap()).collect()
    });
    assert!(surprises.is_empty(), "not as docs/profinet.md says:\n{}", surprises.join("\n"));
}

/// What a controller reads is what the device holds, and the device received nothing else.
#[test]
fn a_controller_reads_the_identification_and_does_nothing_else() {
    if !can_run() {
        return;
    }
    let Some(network) = Network::build() else { return };
    let device = network.plant.enter(|| IoDevice::start(DEVICE.into(), 9001).unwrap());
    let controller = Controller::ProfinetPy("--follow");
    let printed = controller.run(Through::Direct, &network, true);
    for (name, text) in IDENTIFICATION {
        assert_eq!(printed["found"][name], text, "{printed}");
    }
    let log: Vec<_> = device.received().iter().map(|datagram| datagram.log()).collect();
    let activities: BTreeSet<_> = log.iter().map(|line| line["activity"].to_string()).collect();
    assert_eq!(activities.len(), 1);
    for ((sequence, line), port) in (0..).zip(&log).zip([PNIO_PORT, 9001, 9001, 9001]) {
        assert_eq!((&line["kind"], &line["opnum"]), (&"request".into(), &5.into()));
        assert_eq!((&line["sequence"], &line["port"]), (&sequence.into(), &port.into()));
    }
    assert_eq!(log.len(), 4);
}

/// The same through the relay: the device that answers from another port is read, and what is not a read
/// does not reach it.
#[test]
fn through_the_relay_a_controller_reads_and_cannot_connect() {
    if !can_run() {
        return;
    }
    let Some(network) = Network::build() else { return };
    let relay = start_relay(&network);
    let device = network.plant.enter(|| IoDevice::start(DEVICE.into(), 9001).unwrap());
    let printed = Controller::ProfinetPy("").run(Through::Relay, &network, true);
    for (name, text) in IDENTIFICATION {
        assert_eq!(printed["found"][name], text, "{printed}");
    }
    let refused = Controller::ProfinetPy("--connect").run(Through::Relay, &network, false);
    assert!(refused["problems"][0].as_str().unwrap().contains("No response"), "{refused}");
    let log: Vec<_> = device.received().iter().map(|datagram| datagram.log()).collect();
    assert_eq!(log.len(), 4, "the Connect did not arrive");
    assert!(log.iter().all(|line| line["opnum"] == 5), "{log:?}");
    network.edge.enter(|| {
        relay.expect_drops(&[("request", "rpc_connect", 1)]);
        relay.finish();
    });
}

/// The device's log would show it: a Connect arrives, and is refused by the device itself.
#[test]
fn what_a_controller_should_not_send_is_in_the_log() {
    if !can_run() {
        return;
    }
    let Some(network) = Network::build() else { return };
    let device = network.plant.enter(|| IoDevice::start(DEVICE.into(), PNIO_PORT).unwrap());
    let printed = Controller::ProfinetPy("--connect").run(Through::Direct, &network, true);
    assert!(printed["problems"].to_string().contains("rejected by device"), "{printed}");
    let log: Vec<_> = device.received().iter().map(|datagram| datagram.log()).collect();
    assert_eq!(log.len(), 1);
    assert_eq!((&log[0]["kind"], &log[0]["opnum"]), (&"request".into(), &0.into()));
}

/// Some endpoint mappers look at the sequence number: one that does not begin at 0 has no answer.
#[test]
fn a_mapper_that_counts_is_silent_when_a_look_up_does_not_begin_at_0() {
    if !can_run() {
        return;
    }
    let Some(network) = Network::build() else { return };
    let _device = Device::Scapy("--answer-from 34964 --mapper").start(&network);
    for (arguments, outcome) in [("--from-sequence 5", NoAnswer), ("", Works)] {
        let lookup = Controller::Scapy("lookup", arguments);
        let printed = lookup.run(Through::Direct, &network, outcome != NoAnswer);
        assert_eq!(Outcome::of(&printed), Some(outcome), "{printed}");
    }
}

/// The router has no flow for an answer from another port: it takes it for itself and refuses it.
#[test]
fn with_masquerade_the_router_refuses_an_answer_from_another_port() {
    if !can_run() {
        return;
    }
    let Some(network) = Network::build() else { return };
    Through::Masquerade.prepare(&network);
    let _device = network.plant.enter(|| IoDevice::start(DEVICE.into(), 9001).unwrap());
    let (outside, inside) = (network.internet.capture(), network.plant.capture());
    let controller = Controller::ProfinetPy("--any-port");
    let printed = controller.run(Through::Masquerade, &network, false);
    assert_eq!(Outcome::of(&printed), Some(NoAnswer), "{printed}");
    let router = "172.17.17.254".parse().unwrap();
    let refused = Packet::PortUnreachable { from: router, to: DEVICE.into() };
    eventually("the refusal is seen", || inside.so_far().contains(&refused).then_some(()));
    assert!(inside.so_far().iter().any(|packet| matches!(packet,
        Packet::Udp { from, to, .. } if from.port() == 9001 && to.ip() == router)));
    let outside = outside.end();
    assert!(matches!(&outside[..], [Packet::Udp { .. }]), "the request alone: {outside:?}");
}

#[test]
fn the_page_has_the_table() {
    let mut table = "| | directly | port forward | port forward and masquerade | relay |\n\
        |---|---|---|---|---|\n"
        .to_owned();
    for Exchange { what, direct, port_forward, masquerade, relay, .. } in &EXCHANGES {
        writeln!(table, "| {what} | {direct} | {port_forward} | {masquerade} | {relay} |").unwrap();
    }
    assert!(
        include_str!("../../../docs/profinet.md").contains(&format!("\n\n{table}\n")),
        "the table of docs/profinet.md has to be:\n\n{table}"
    );
}
