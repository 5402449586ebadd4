//! The checks: what RFC 4787, 5508, 6056, 6888 and 8085 ask of a NAT that forwards ports.

use std::time::{Duration, Instant};

use super::Check;
use super::Expected::{Fails, Passes};
use super::systems::{Settings, Tested};
use crate::harness::{
    FIGURE_10, PASSWORD, Packet, WRONG, close, datagram, eventually, pause, request, response,
};

const AS_IT_IS: Settings = Settings { idle: None, max_flows: None };
const SHORT: Settings = Settings { idle: Some(1), max_flows: None };

pub(super) const CHECKS: [Check; 16] = [
    Check {
        requirement: "N-1",
        passes_when: "two clients with the same port each get their own answers, from the \
                      address and port that they asked",
        settings: AS_IT_IS,
        run: own_answers,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-1",
        passes_when: "a client comes from one port to all nodes, also when another client \
                      has the same port",
        settings: AS_IT_IS,
        run: one_port_a_client,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-2",
        passes_when: "an answer comes through after 119 s of silence, without any setting",
        settings: AS_IT_IS,
        run: late_answer,
        relay: Passes,
        kernel: Fails("after 30 s it is lost"),
        nightly: true,
    },
    Check {
        requirement: "N-2",
        passes_when: "how long a silent flow is kept is a setting",
        settings: SHORT,
        run: idle_flow_ends,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-3",
        passes_when: "what the server sends keeps the flow open",
        settings: Settings { idle: Some(4), max_flows: None },
        run: server_keeps_it_open,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-4",
        passes_when: "a client in the plant reaches a node by its public address and port",
        settings: AS_IT_IS,
        run: hairpin,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-5",
        passes_when: "datagrams of every length come out as they went in, both ways",
        settings: AS_IT_IS,
        run: same_octets,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-6",
        passes_when: "with its flow table full, and wrong passwords coming in, it serves \
                      a known client as ever",
        settings: Settings { idle: None, max_flows: Some(2) },
        run: known_client_in_a_flood,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-6",
        passes_when: "strangers without the password take no room from a new client",
        settings: Settings { idle: None, max_flows: Some(8) },
        run: new_client_in_a_flood,
        relay: Passes,
        kernel: Fails("each has a flow"),
        nightly: false,
    },
    Check {
        requirement: "N-7",
        passes_when: "a node was down, ICMP said so: its flows stay, and the next \
                      exchange works",
        settings: AS_IT_IS,
        run: icmp_closes_nothing,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-8",
        passes_when: "a new flow that finds the table full is dropped, open ones do not \
                      notice",
        settings: Settings { idle: None, max_flows: Some(2) },
        run: full_table,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-9",
        passes_when: "the port that a closed flow had is not the next client's",
        settings: SHORT,
        run: ports_rest,
        relay: Passes,
        kernel: Fails("it may have it at once"),
        nightly: false,
    },
    Check {
        requirement: "N-9",
        passes_when: "its ports towards the plant cannot be guessed",
        settings: AS_IT_IS,
        run: random_ports,
        relay: Passes,
        kernel: Fails("they are the clients' own where these are free"),
        nightly: false,
    },
    Check {
        requirement: "N-10",
        passes_when: "start and end of a flow are on record: client, public port, whose \
                      password",
        settings: SHORT,
        run: on_record,
        relay: Passes,
        kernel: Fails("while it is open, without password, and not afterwards"),
        nightly: false,
    },
    Check {
        requirement: "N-11",
        passes_when: "a request that gets no answer is neither repeated nor answered",
        settings: AS_IT_IS,
        run: nothing_by_itself,
        relay: Passes,
        kernel: Passes,
        nightly: false,
    },
    Check {
        requirement: "N-11",
        passes_when: "what strangers send causes not one octet on either side",
        settings: AS_IT_IS,
        run: silence_for_strangers,
        relay: Passes,
        kernel: Fails("it passes everything on"),
        nightly: false,
    },
];

const CLIENT: &str = "198.51.100.7:50000";
/// The same port at another address.
const TWIN: &str = "198.51.100.8:50000";

fn numbered(n: u8) -> Vec<u8> {
    datagram(&FIGURE_10, &[n], PASSWORD)
}

/// RFC 4787 REQ-1, REQ-3.
fn own_answers(tested: &Tested<'_>) -> bool {
    let node = tested.network.node(4);
    let clients = [CLIENT, TWIN].map(|client| tested.client(client));
    let mut routers = Vec::new();
    for (n, client) in (0..).zip(&clients) {
        client.send(tested.public(4), &numbered(n));
        routers.extend(tested.comes(&node, &numbered(n)));
    }
    let [first, second] = routers[..] else { return false };
    node.send(second, &numbered(1));
    node.send(first, &numbered(0));
    (0..).zip(&clients).all(|(n, client)| {
        tested.comes(client, &numbered(n)) == Some(tested.public(4)) && client.waiting().is_none()
    })
}

/// RFC 4787 REQ-1; R-41.
fn one_port_a_client(tested: &Tested<'_>) -> bool {
    let nodes = [1, 2, 3, 4, 33].map(|node_address| tested.network.node(node_address));
    [CLIENT, TWIN].into_iter().all(|client| {
        let client = tested.client(client);
        let ports: Vec<_> = nodes.iter().map(|node| tested.exchange(&client, node)).collect();
        ports[0].is_some() && ports.iter().all(|port| *port == ports[0])
    })
}

/// RFC 4787 REQ-5.
fn late_answer(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    client.send(tested.public(4), &request(4));
    let Some(router) = tested.comes(&node, &request(4)) else { return false };
    pause(Duration::from_secs(119));
    node.send(router, &response(4));
    tested.comes(&client, &response(4)) == Some(tested.public(4))
}

/// RFC 4787 REQ-5.
fn idle_flow_ends(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    tested.exchange(&client, &node).is_some() && tested.idle_flows_end()
}

/// RFC 4787 REQ-6: over more than twice as long as a silent flow is kept.
fn server_keeps_it_open(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    client.send(tested.public(4), &request(4));
    let Some(router) = tested.comes(&node, &request(4)) else { return false };
    let end = Instant::now() + Duration::from_secs(10);
    while Instant::now() < end {
        node.send(router, &response(4));
        if tested.comes(&client, &response(4)) != Some(tested.public(4)) {
            return false;
        }
        pause(Duration::from_millis(200));
    }
    tested.idle_flows_end()
}

/// RFC 4787 REQ-9.
fn hairpin(tested: &Tested<'_>) -> bool {
    let client = tested.network.plant.peer("172.17.17.100:50000".parse().unwrap());
    tested.exchange(&client, &tested.network.node(4)).is_some()
}

/// RFC 4787 REQ-10.
fn same_octets(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    let (outside, inside) = (tested.network.internet.capture(), tested.network.plant.capture());
    let mut random = fastrand::Rng::with_seed(4);
    let mut sent = Vec::new();
    for length in 0..=63 {
        let mut data_octets = vec![0; length];
        random.fill(&mut data_octets);
        let octets = datagram(&FIGURE_10, &data_octets, PASSWORD);
        client.send(tested.public(4), &octets);
        let Some(router) = tested.comes(&node, &octets) else { return false };
        node.send(router, &octets);
        if tested.comes(&client, &octets).is_none() {
            return false;
        }
        sent.extend([octets.clone(), octets]); // the request and its answer
    }
    [outside, inside].into_iter().all(|capture| {
        let seen = capture.end();
        seen.iter().map(Packet::octets).eq(sent.iter().map(Vec::as_slice))
    })
}

/// RFC 4787 REQ-11.
fn known_client_in_a_flood(tested: &Tested<'_>) -> bool {
    let (client, twin, node) = (tested.client(CLIENT), tested.client(TWIN), tested.network.node(4));
    let Some(port) = tested.exchange(&client, &node) else { return false };
    if tested.exchange(&twin, &node).is_none() {
        return false;
    }
    let strangers: Vec<_> = (0..10).map(|_| tested.network.client("198.51.100.8")).collect();
    (0..30).all(|_| {
        for stranger in &strangers {
            stranger.send(tested.public(4), &datagram(&FIGURE_10, &[], WRONG));
        }
        tested.exchange(&client, &node) == Some(port)
    })
}

/// RFC 4787 REQ-11.
fn new_client_in_a_flood(tested: &Tested<'_>) -> bool {
    for _ in 0..20 {
        let stranger = tested.network.client("198.51.100.8");
        stranger.send(tested.public(4), &datagram(&FIGURE_10, &[], WRONG));
    }
    tested.exchange(&tested.client(CLIENT), &tested.network.node(3)).is_some()
}

/// RFC 4787 REQ-12, RFC 5508.
fn icmp_closes_nothing(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    let port = tested.exchange(&client, &node);
    tested.network.plant.enter(|| close(node));
    let inside = tested.network.plant.capture();
    client.send(tested.public(4), &request(4));
    eventually("ICMP is seen", || {
        let refusal = |packet: &Packet| matches!(packet, Packet::PortUnreachable { .. });
        inside.so_far().iter().any(refusal).then_some(())
    });
    let stays = tested.flows() == 1;
    stays && port.is_some() && tested.exchange(&client, &tested.network.node(4)) == port
}

/// RFC 6888 REQ-11.
fn full_table(tested: &Tested<'_>) -> bool {
    let node = tested.network.node(4);
    let known = [CLIENT, TWIN].map(|client| tested.client(client));
    let all_served = || known.iter().all(|client| tested.exchange(client, &node).is_some());
    let served_before = all_served();
    tested.client("198.51.100.7:50001").send(tested.public(4), &request(4));
    // The next that comes to the node is a known client's, so the new one's was dropped.
    let mark = numbered(9);
    known[0].send(tested.public(4), &mark);
    served_before && tested.comes(&node, &mark).is_some() && all_served()
}

/// RFC 6888 REQ-8. That it rests for 120 s is shown in simulated time.
fn ports_rest(tested: &Tested<'_>) -> bool {
    let node = tested.network.node(4);
    let before = tested.exchange(&tested.client(CLIENT), &node);
    tested.idle_flows_end();
    let after = tested.exchange(&tested.client(TWIN), &node);
    before.is_some() && after.is_some() && before != after
}

/// RFC 6056: neither the clients' own nor one after the other.
fn random_ports(tested: &Tested<'_>) -> bool {
    let node = tested.network.node(4);
    let theirs = 50000..50010;
    let ports: Vec<_> = theirs
        .clone()
        .filter_map(|port| tested.exchange(&tested.client(&format!("198.51.100.7:{port}")), &node))
        .collect();
    let own = ports.iter().zip(theirs).filter(|&(&port, theirs)| port == theirs).count();
    let next = ports.windows(2).filter(|pair| pair[0].abs_diff(pair[1]) < 10).count();
    ports.len() == 10 && own + next < 3 // by chance
}

/// RFC 6888 section 4.
fn on_record(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    let exchanged = tested.exchange(&client, &node).is_some() && tested.idle_flows_end();
    let tells = |line: &&str| {
        ["198.51.100.7", "50000", "20004", "service"].iter().all(|what| line.contains(what))
    };
    // A log is written a little later than things happen.
    let told = (0..200).any(|_| {
        pause(Duration::from_millis(10));
        tested.records().lines().filter(tells).count() == 2
    });
    exchanged && told
}

/// RFC 8085.
fn nothing_by_itself(tested: &Tested<'_>) -> bool {
    let (client, _node) = (tested.client(CLIENT), tested.network.node(4));
    let (outside, inside) = (tested.network.internet.capture(), tested.network.plant.capture());
    client.send(tested.public(4), &request(4));
    pause(Duration::from_millis(2500));
    [outside, inside]
        .into_iter()
        .all(|capture| capture.end().iter().map(Packet::octets).eq([request(4).as_slice()]))
}

/// RFC 8085.
fn silence_for_strangers(tested: &Tested<'_>) -> bool {
    let (client, node) = (tested.client(CLIENT), tested.network.node(4));
    let stranger = tested.network.client("198.51.100.8");
    let (outside, inside) = (tested.network.internet.capture(), tested.network.plant.capture());
    let noise =
        [datagram(&FIGURE_10, &[], WRONG), vec![], vec![0xFF; 40], request(4)[..20].to_vec()];
    for octets in &noise {
        stranger.send(tested.public(4), octets);
    }
    // What follows is the first thing that the node sees, and all that is seen of an answer.
    let served = tested.exchange(&client, &node).is_some();
    let good = [request(4), response(4)];
    let seen = |packets: Vec<Packet>, expected: &[Vec<u8>]| {
        packets.len() == expected.len()
            && packets.iter().map(Packet::octets).eq(expected.iter().map(Vec::as_slice))
    };
    served && seen(inside.end(), &good) && seen(outside.end(), &[&noise[..], &good].concat())
}
