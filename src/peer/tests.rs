//! Tests node and client against each other, over loopback sockets.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use tokio::net::UdpSocket;

use super::*;
use crate::pnet::endpoint::client::{
    Arep, Attributes, EndpointId, FlatAddressing, Loss, Outcome, Request as Data, RequestError,
    Source,
};
use crate::pnet::endpoint::{Echo, Indicated, Memory, Service};
use crate::pnet::wire::Password;

const PASSWORD: &[u8; 8] = b"PNETPASS";
/// Longer than any answer in these tests takes.
const LONG: Duration = Duration::from_secs(5);
/// How long a client waits for an answer that must not come.
const SHORT: Duration = Duration::from_millis(100);

/// The request of PAS Figure 10, with four data octets, with flags in the data-field-format, and
/// with the password.
const FIGURE_10: [u8; 26] = [
    0x02, 0x00, 0x00, 0x00, // header
    0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F, // route
    0x55, 0xC4, 0xDE, 0xAD, 0xBE, 0xEF, // control-status, data-field-format, data
    b'P', b'N', b'E', b'T', b'P', b'A', b'S', b'S',
];

/// The answer goes back to 31 at the first place of net 125, for the node does not know the client.
/// It comes from 11, 4, 2, 33, with NCNA last. These are eight elements, six of them behind the
/// route length.
const ANSWER_TO_FIGURE_10: [u8; 27] = [
    0x02, 0x00, 0x00, 0x00, // header
    0x7D, 0x01, 0x06, 0x1F, 0x8B, 0x84, 0x82, 0xA1, 0x80, // route
    0x55, 0xC4, 0xDE, 0xAD, 0xBE, 0xEF, // control-status, data-field-format, data
    b'P', b'N', b'E', b'T', b'P', b'A', b'S', b'S',
];

/// Node 4, serving on free ports of an address that no other test uses.
struct Node {
    settings: NodeSettings,
    counts: Arc<NodeCounts>,
}

impl Node {
    async fn serving(third_octet: u8) -> Self {
        Self::with(settings(third_octet), Echo).await
    }

    async fn with(settings: NodeSettings, service: impl Service + Send + 'static) -> Self {
        let node = ServerNode::bind(settings, service).unwrap();
        let (settings, counts) = (node.settings().clone(), node.counts());
        tokio::spawn(node.serve());
        Self { settings, counts }
    }

    /// A client with a start port that makes the given port the public port of node 4.
    async fn client(&self, port: u16, password: Option<&[u8; 8]>) -> Client {
        let password = password.map(|octets| Password::new(*octets));
        let target = Target::new(self.settings.address.into(), port - 4, password);
        Client::bind(target).await.unwrap()
    }

    /// Sends these octets, and returns the answer and its sender.
    async fn raw(&self, port: u16, octets: &[u8]) -> (Vec<u8>, SocketAddr) {
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        socket.send_to(octets, (self.settings.address, port)).await.unwrap();
        let mut answer = [0; 200];
        let received = tokio::time::timeout(LONG, socket.recv_from(&mut answer)).await;
        let (length, from) = received.expect("an answer").unwrap();
        (answer[..length].to_vec(), from)
    }

    /// The node's counts: received, answered, refused.
    fn counts(&self) -> (u64, u64, u64) {
        (self.counts.received(), self.counts.answered(), self.counts.refused_total())
    }
}

/// Node 4 on any free ports of an address that no other test uses.
fn settings(third_octet: u8) -> NodeSettings {
    let address = Ipv4Addr::new(127, 17, third_octet, 4);
    let settings = NodeSettings::new(address, vec![Password::new(*PASSWORD)]);
    NodeSettings { normal_port: 0, secure_port: 0, ..settings }
}

fn request(data_octets: &[u8]) -> Request<'_> {
    Request { node_address: 4, beyond: &[2, 33], control_status: 0x55, data_octets }
}

#[tokio::test]
async fn the_answer_to_figure_10_is_right_octet_for_octet() {
    let node = Node::serving(1).await;
    let (secure, normal) = (node.settings.secure_port, node.settings.normal_port);
    // The answer comes from the port that received the request (A14), with the password that came
    //
    let answer = node.raw(secure, &FIGURE_10).await;
    assert_eq!(answer.0, ANSWER_TO_FIGURE_10);
    assert_eq!(answer.1, SocketAddr::from((node.settings.address, secure)));
    // The Normal port needs no password. Another client has another place in net 125.
    let answer = node.raw(normal, &FIGURE_10[..18]).await;
    let mut expected = ANSWER_TO_FIGURE_10;
    expected[5] = 2;
    assert_eq!(answer.0, expected[..19]);
    assert_eq!(answer.1, SocketAddr::from((node.settings.address, normal)));
}

#[tokio::test]
async fn an_extended_request_is_answered_with_ncna_last() {
    let node = Node::serving(2).await;
    let request = [0x02, 0, 0, 0, 0x0B, 0x04, 0x8B, 0x83, 0x00, 0x03, 1, 2, 3];
    let answer = node.raw(node.settings.normal_port, &request).await;
    let route = [0x7D, 0x01, 0x03, 0x8B, 0x84, 0x80];
    assert_eq!(answer.0, [&[2, 0, 0, 0], &route[..], &[0x00, 0x03, 1, 2, 3]].concat());
}

#[tokio::test]
async fn a_client_gets_the_answers_to_its_requests() {
    let node = Node::serving(3).await;
    let mut client = node.client(node.settings.secure_port, Some(PASSWORD)).await;
    for number in 0..300u32 {
        let octets = number.to_be_bytes();
        let (answer, round_trip) = client.exchange(&request(&octets), LONG).await.unwrap();
        assert_eq!(answer.data_octets[..], octets);
        assert_eq!(answer.control_status, 0x55);
        assert_eq!(answer.sources[..], [11, 4, 2, 33, 0]);
        assert_eq!(answer.destinations[..2], [125, 1], "R-40");
        assert!(round_trip > Duration::ZERO && round_trip < LONG);
    }
    assert_eq!(node.counts(), (300, 300, 0));
}

#[tokio::test]
async fn a_node_takes_its_time_and_gives_its_own_answer() {
    let delay = Duration::from_millis(30);
    let faults = Faults { delay, ..Faults::default() };
    let service = |request: &Indicated<'_>| Some([4, request.data_octets[2]].into_iter().collect());
    let node = Node::with(NodeSettings { faults, ..settings(4) }, service).await;
    let mut client = node.client(node.settings.secure_port, Some(PASSWORD)).await;
    let (answer, round_trip) = client.exchange(&request(&[7, 8, 9]), LONG).await.unwrap();
    assert_eq!(answer.data_octets[..], [4, 9]);
    assert!(round_trip >= delay, "{round_trip:?}");
}

#[tokio::test]
async fn everything_else_meets_silence() {
    let node = Node::serving(5).await;
    let secure = node.settings.secure_port;
    let changed = |at: usize, to: u8| {
        let mut octets = FIGURE_10.to_vec();
        octets[at] = to;
        octets
    };
    let silent = [
        ("no octets", vec![]),
        ("no password", FIGURE_10[..18].to_vec()),
        ("wrong password", changed(25, b'Z')),
        ("other node's address", changed(5, 5)),
        ("wrong header", changed(0, 3)),
        ("route length beyond the end", changed(6, 27)),
        ("one source: Complex", [&FIGURE_10[..9], &[0x0B, 0x03], &FIGURE_10[11..]].concat()),
        ("cut", FIGURE_10[..25].to_vec()),
        ("one octet over", [&FIGURE_10[..], &[0]].concat()),
        ("longer than any datagram", [&FIGURE_10[..], &[0; 100]].concat()),
    ];
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    for (number, (what, octets)) in (1..).zip(&silent) {
        for sent in [octets, &FIGURE_10[..]] {
            socket.send_to(sent, (node.settings.address, secure)).await.unwrap();
        }
        let mut answer = [0; 200];
        let length = socket.recv(&mut answer).await.unwrap();
        assert_eq!(answer[..length], ANSWER_TO_FIGURE_10, "{what}");
        assert_eq!(node.counts(), (2 * number, number, number), "{what}");
    }
}

/// It serves what nobody waits for, and says nothing.
#[tokio::test]
async fn what_is_unconfirmed_gets_no_answer() {
    let node = Node::serving(9).await;
    let mut octets = FIGURE_10;
    for (number, (at, to)) in (1..).zip([(5, 126), (8, 126), (11, 0x80)]) {
        octets[at] = to;
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        for sent in [&octets, &FIGURE_10] {
            socket.send_to(sent, (node.settings.address, node.settings.secure_port)).await.unwrap();
        }
        let mut answer = [0; 200];
        socket.recv(&mut answer).await.unwrap();
        assert_eq!(answer[4..6], [125, number], "the answer to the second");
        assert_eq!(node.counts.unconfirmed(), u64::from(number));
        octets = FIGURE_10;
    }
}

/// Responses that leave twice, from a wrong port, with a wrong password, or never.
#[tokio::test]
async fn faults_are_made_as_asked() {
    let bad = |faults| Node::with(NodeSettings { faults, ..settings(10) }, Echo);
    let twice = bad(Faults { duplicate: Share::ALL, ..Faults::default() }).await;
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let to = |node: &Node| (node.settings.address, node.settings.secure_port);
    socket.send_to(&FIGURE_10, to(&twice)).await.unwrap();
    for _ in 0..2 {
        let mut answer = [0; 200];
        let length = socket.recv(&mut answer).await.unwrap();
        assert_eq!(answer[..length], ANSWER_TO_FIGURE_10);
    }
    let elsewhere = bad(Faults { answer_from_other_port: true, ..Faults::default() }).await;
    let (answer, from) = elsewhere.raw(elsewhere.settings.secure_port, &FIGURE_10).await;
    assert_eq!(answer, ANSWER_TO_FIGURE_10);
    assert!(from.ip() == elsewhere.settings.address && from.port() != to(&elsewhere).1);
    let wrong = bad(Faults { wrong_password: true, ..Faults::default() }).await;
    let (answer, _) = wrong.raw(wrong.settings.secure_port, &FIGURE_10).await;
    assert_eq!(answer[..19], ANSWER_TO_FIGURE_10[..19]);
    assert_ne!(answer[19..], *PASSWORD);
    let lost = bad(Faults { drop: Share::ALL, ..Faults::default() }).await;
    let mut client = lost.client(lost.settings.secure_port, Some(PASSWORD)).await;
    client.exchange(&request(&[1, 2, 3]), SHORT).await.unwrap_err();
    assert_eq!((lost.counts.lost(), lost.counts.answered()), (1, 0));
}

/// One of two responses takes longer, so the other one comes first.
#[tokio::test]
async fn responses_overtake_each_other() {
    let faults = Faults { jitter: Duration::from_millis(30), ..Faults::default() };
    let node = Node::with(NodeSettings { faults, ..settings(11) }, Echo).await;
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    for number in 0..50 {
        let mut octets = FIGURE_10;
        octets[14] = number;
        socket.send_to(&octets, (node.settings.address, node.settings.secure_port)).await.unwrap();
    }
    let mut came = Vec::new();
    for _ in 0..50 {
        let mut answer = [0; 200];
        socket.recv(&mut answer).await.unwrap();
        came.push(answer[15]);
    }
    assert!(!came.is_sorted(), "{came:?}");
    came.sort_unstable();
    assert_eq!(came, (0..50).collect::<Vec<_>>(), "all came, each once");
}

#[tokio::test]
async fn a_route_with_no_room_for_ncna_meets_silence() {
    let node = Node::serving(6).await;
    let mut client = node.client(node.settings.normal_port, None).await;
    // 2 + 23 destinations and 3 sources are 28 elements. The NCNA makes 29.
    let fits = Request { beyond: &[1; 23], ..request(&[1, 2, 3]) };
    client.exchange(&fits, LONG).await.unwrap();
    let full = Request { beyond: &[1; 24], ..fits };
    let silence = client.exchange(&full, SHORT).await.unwrap_err();
    assert!(matches!(silence, ExchangeError::Lost(Loss::NoAnswer { waited: SHORT, sent: 1 })));
    assert_eq!(node.counts.refused_total(), 1);
    let too_long = Request { beyond: &[1; 25], ..fits };
    let refused = client.exchange(&too_long, SHORT).await.unwrap_err();
    assert!(matches!(refused, ExchangeError::Request(RequestError::Route(_))));
}

#[tokio::test]
async fn a_wrong_password_gets_no_answer_and_the_client_says_so() {
    let node = Node::serving(7).await;
    let mut client = node.client(node.settings.secure_port, Some(b"PNETPASZ")).await;
    let error = client.exchange(&request(&[1, 2, 3]), SHORT).await.unwrap_err();
    assert_eq!(error.to_string(), "no answer within 100ms");
}

/// The client learns this at once, however long it would wait. The next request still works.
#[tokio::test]
async fn a_client_is_told_where_nothing_listens() {
    const FOR_EVER: Duration = Duration::from_secs(3600);
    for address in ["127.17.8.4", "::1"] {
        let address: std::net::IpAddr = address.parse().unwrap();
        // The machine may have no IPv6.
        let Ok(there) = UdpSocket::bind((address, 0)).await else { continue };
        let port = there.local_addr().unwrap().port();
        let mut client = Client::bind(Target::new(address, port - 4, None)).await.unwrap();
        let ask = |node_address| Request { node_address, ..request(&[1, 2, 3]) };
        for node_address in [5, 6, 5] {
            // No socket has these ports, unless the system has given one of them to another test.
            let error = client.exchange(&ask(node_address), FOR_EVER).await.unwrap_err();
            assert_eq!(error.to_string(), "nothing listens there");
        }
        let silent = client.exchange(&ask(4), SHORT).await.unwrap_err();
        assert!(matches!(silent, ExchangeError::Lost(Loss::NoAnswer { .. })), "{silent}");
        drop(there);
        let error = client.exchange(&ask(4), FOR_EVER).await.unwrap_err();
        assert_eq!(error.to_string(), "nothing listens there");
    }
}

/// Answers each request with the responses that the function makes from it, in their order.
async fn forger(responses: fn(&[u8]) -> Vec<Vec<u8>>) -> Client {
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let port = socket.local_addr().unwrap().port();
    tokio::spawn(async move {
        let mut octets = [0; 200];
        loop {
            let (length, client) = socket.recv_from(&mut octets).await.unwrap();
            for response in responses(&octets[..length]) {
                socket.send_to(&response, client).await.unwrap();
            }
        }
    });
    let password = Some(Password::new(*PASSWORD));
    Client::bind(Target::new(Ipv4Addr::LOCALHOST.into(), port - 4, password)).await.unwrap()
}

/// The answer to the request of PAS Figure 10, for the endpoint of the given request, with one
/// octet changed.
fn answer_to(request: &[u8], at: usize, to: u8) -> Vec<u8> {
    let mut answer = ANSWER_TO_FIGURE_10.to_vec();
    answer[7] = request[11] & 0x7F;
    answer[at] = to;
    answer
}

#[tokio::test]
async fn a_client_passes_over_what_does_not_answer_its_request() {
    let mut client = forger(|request| {
        vec![
            answer_to(request, 0, 3),                // header
            answer_to(request, 7, 99),               // endpoint of an earlier request
            answer_to(request, 9, 0x85),             // another node
            answer_to(request, 12, 0x81),            // confirmed, so not a response
            answer_to(request, 26, b'Z'),            // another password
            answer_to(request, 0, 2)[..19].to_vec(), // no password
            answer_to(request, 0, 2)[..26].to_vec(), // cut
            answer_to(request, 15, 0xAA),            // the right answer
        ]
    })
    .await;
    let (answer, _) = client.exchange(&request(&[1, 2, 3]), LONG).await.unwrap();
    assert_eq!(answer.data_octets[..], [0xAA, 0xAD, 0xBE, 0xEF]);
}

#[tokio::test]
async fn a_client_takes_a_response_to_its_net_125_address() {
    // The destination has IPNetID 125 and a node address that the server chose (R-40, PAS 9).
    let mut client = forger(|request| {
        let mut answer = answer_to(request, 4, 125);
        answer[5] = 17;
        vec![answer]
    })
    .await;
    let (answer, _) = client.exchange(&request(&[1, 2, 3]), LONG).await.unwrap();
    assert_eq!(answer.destinations[..2], [125, 17]);
}

#[tokio::test]
async fn a_port_in_use_is_named() {
    let node = Node::serving(8).await;
    let error = ServerNode::bind(node.settings.clone(), Echo).unwrap_err();
    let address = SocketAddr::from((node.settings.address, node.settings.normal_port));
    assert!(error.to_string().contains(&format!("UDP port {address} is in use")), "{error}");
    assert!(!format!("{error:?} {:?}", node.settings).contains("PNETPASS"));
}

/// A client node that may send `window` requests to node 4 at a time, each `max_retries` times again.
async fn client_node(node: &Node, window: usize, max_retries: u32) -> ClientNode {
    let arep = Arep {
        max_outstanding_requests: window,
        max_retries,
        response_timeout: SHORT,
        ..Arep::new(Source::FIGURE_10)
    };
    ClientNode::bind(arep, node.settings.address.into()).await.unwrap()
}

/// Has the client send some requests, each with its number as data, and returns their outcomes in the
/// order of the requests.
async fn ask_all(client: &mut ClientNode, attributes: &Attributes, number: u8) -> Vec<Outcome> {
    let ids: Vec<EndpointId> = (0..number)
        .map(|data| {
            let id = client.client().reserve(attributes.clone()).unwrap();
            let request = Data::Data { control_status: 0x55, data_octets: &[data; 3] };
            client.client().request(id, &request).unwrap();
            id
        })
        .collect();
    for _ in 0..number {
        tokio::time::timeout(LONG, client.finished()).await.expect("an outcome").unwrap();
    }
    let take = |id| {
        let outcome = client.client().take_outcome(id).unwrap();
        client.client().free(id);
        outcome
    };
    ids.into_iter().map(take).collect()
}

fn attributes(node: &Node) -> Attributes {
    let password = Some(Password::new(*PASSWORD));
    let start_port = node.settings.secure_port - 4;
    let target = Target::new(node.settings.address.into(), start_port, password);
    Attributes::new(target.route(&request(&[])).unwrap())
}

/// Each answer goes to its request, whatever the node does on the way.
#[track_caller]
fn all_answered(outcomes: &[Outcome]) {
    for (number, outcome) in (0_u8..).zip(outcomes) {
        let Outcome::Answered(response) = outcome else { panic!("{number}: {outcome:?}") };
        assert_eq!(response.data_octets, [number; 3]);
    }
}

#[tokio::test]
async fn a_window_of_requests_is_answered_in_spite_of_faults() {
    let millis = Duration::from_millis;
    for (faults, window) in [
        (Faults::default(), 1),
        (Faults::default(), 32),
        (Faults { duplicate: Share::ALL, ..Faults::default() }, 32),
        (Faults { jitter: millis(40), ..Faults::default() }, 32),
        (Faults { reorder: "50%".parse().unwrap(), ..Faults::default() }, 32),
    ] {
        let settings = NodeSettings { faults: faults.clone(), ..settings(12) };
        let node = Node::with(settings, Echo).await;
        // A machine that is busy may be slow, and that is not a fault.
        let mut client = client_node(&node, window, 50).await;
        for _ in 0..3 {
            all_answered(&ask_all(&mut client, &attributes(&node), 60).await);
        }
    }
}

#[tokio::test]
async fn r44_what_is_lost_on_the_way_is_asked_again() {
    let faults = Faults { drop: "50%".parse().unwrap(), ..Faults::default() };
    let node = Node::with(NodeSettings { faults, ..settings(13) }, Echo).await;
    let mut client = client_node(&node, 32, 50).await;
    all_answered(&ask_all(&mut client, &attributes(&node), 32).await);
    assert!(node.counts.lost() > 0);
    assert!(node.counts.received() >= 32 + node.counts.lost());
}

/// All responses are wrong in the same way: the client says in which.
#[tokio::test]
async fn a_client_tells_why_it_has_no_answer() {
    let loss = async |third_octet, response_timeout, faults| {
        let settings = NodeSettings { faults, ..settings(third_octet) };
        let node = Node::with(settings, Echo).await;
        let mut client = client_node(&node, 8, 0).await;
        let arep = Arep { response_timeout, ..client.client().arep().clone() };
        client.client().set_arep(arep).unwrap();
        let outcomes = ask_all(&mut client, &attributes(&node), 2).await;
        assert_eq!(outcomes[0], outcomes[1]);
        match outcomes[0] {
            Outcome::Lost(loss) => loss.to_string(),
            _ => panic!("{outcomes:?}"),
        }
    };
    // Long enough for a response to come, however busy the machine.
    let long = Duration::from_secs(2);
    let faults = Faults { answer_from_other_port: true, ..Faults::default() };
    let told = loss(14, long, faults).await;
    assert!(told.starts_with("answers came from another port, 127.17.14.4:"), "{told}");
    let told = loss(15, long, Faults { wrong_password: true, ..Faults::default() }).await;
    assert_eq!(told, "answers with a wrong password");
    for faults in [
        Faults { drop: Share::ALL, ..Faults::default() },
        Faults { delay: LONG, ..Faults::default() },
    ] {
        assert_eq!(loss(16, SHORT, faults).await, "no answer within 100ms");
    }
}

/// The report about one node does not hit the requests to another.
#[tokio::test]
async fn a_node_that_is_off_ends_only_its_own_requests() {
    let node = Node::serving(18).await;
    let mut client = client_node(&node, 32, 0).await;
    let arep = Arep { response_timeout: LONG, ..client.client().arep().clone() };
    client.client().set_arep(arep).unwrap();
    let on = attributes(&node);
    let mut off = on.clone();
    // No socket has this port, unless the system has given it to another test.
    off.destination.way.address.set_port(1);
    let mut ids = Vec::new();
    for number in 0..20_u8 {
        let attributes = if number % 2 == 0 { &on } else { &off };
        let id = client.client().reserve(attributes.clone()).unwrap();
        let request = Data::Data { control_status: 0, data_octets: &[number; 3] };
        client.client().request(id, &request).unwrap();
        ids.push(id);
    }
    for _ in &ids {
        client.finished().await.unwrap();
    }
    for (number, id) in (0..).zip(ids) {
        match client.client().take_outcome(id).unwrap() {
            Outcome::Answered(response) => assert_eq!(response.data_octets, [number; 3]),
            Outcome::Lost(loss) => {
                assert_eq!((number % 2, loss.to_string().as_str()), (1, "nothing listens there"));
            }
            Outcome::Sent => panic!("it is confirmed"),
        }
    }
}

#[tokio::test]
async fn r44_a_memory_is_written_and_read_through_the_network() {
    let faults =
        Faults { duplicate: Share::ALL, drop: "20%".parse().unwrap(), ..Faults::default() };
    let settings = NodeSettings { faults, ..settings(19) };
    let node = Node::with(settings, Memory::new(2000, Some(1), Some(2))).await;
    let mut client = client_node(&node, 1, 50).await;
    let flat_addressing = Some(FlatAddressing { read: Some(1), write: Some(2) });
    let attributes = Attributes { flat_addressing, ..attributes(&node) };
    let id = client.client().reserve(attributes).unwrap();
    let octets: Vec<u8> = (0..=255).cycle().take(1000).collect();
    let write = Data::Write { offset: 500, data_octets: &octets };
    for (request, expected) in [(write, &[][..]), (Data::Read { offset: 500, size: 1000 }, &octets)]
    {
        client.client().request(id, &request).unwrap();
        assert_eq!(client.finished().await.unwrap(), id);
        let Some(Outcome::Answered(response)) = client.client().take_outcome(id) else { panic!() };
        assert_eq!(response.data_octets, expected);
    }
}
