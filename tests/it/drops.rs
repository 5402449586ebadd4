//! Every reason to drop a datagram, provoked from outside: counted once, and nothing comes of it on
//! either side.
//!
//! Silence is not waited for: a good exchange follows, and has to be the very next thing that the
//! node and the client see. One worker handles both, in this order.

use std::fs;
use std::net::{SocketAddr, UdpSocket};

use crate::harness::{
    FIGURE_10, PASSWORD, Peer, Relay, SECOND, Settings, Site, WRONG, datagram, eventually,
    exchange, request, response,
};

#[test]
fn requests_that_are_not_in_order() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, stranger, node) = (site.client(), site.client(), site.node(4));
    let complex = [0x0B, 0x04, 0x03, 0x02, 0x21, 0x8B];
    let to = |elements: [u8; 2]| {
        let mut route = FIGURE_10;
        route[..2].copy_from_slice(&elements);
        datagram(&route, &[], PASSWORD)
    };
    let beyond = |element| {
        let mut route = FIGURE_10;
        route[4] = element;
        datagram(&route, &[], PASSWORD)
    };
    let good = request(4);
    let with = |index: usize, octet| {
        let mut octets = good.clone();
        octets[index] = octet;
        octets
    };
    let longer = |by: usize| [good.clone(), vec![0; by]].concat();

    let reasons: [(&str, &[Vec<u8>]); 10] = [
        ("too_short", &[vec![], vec![0x02], good[..15].to_vec()]),
        ("too_long", &[longer(108 - good.len()), longer(600), longer(1400)]),
        ("bad_header", &[with(0, 0x03), with(3, 1), [0x20, 0, 0, 0].repeat(5)]),
        // A remaining-route-length of nothing, one beyond the end, a destination behind a source.
        ("bad_route", &[with(6, 0), with(6, 27), with(10, 0x03)]),
        (
            "route_format",
            &[
                datagram(&[0x04, 0x9F], &[], PASSWORD), // Simple, 16 octets
                datagram(&[0x84, 0x9F], &[], PASSWORD), // Immediate
                datagram(&complex, &[], PASSWORD),
            ],
        ),
        ("bad_length", &[longer(1), good[..good.len() - 1].to_vec(), with(13, 4), with(13, 2)]),
        ("password_missing", &[good[..good.len() - 8].to_vec()]),
        ("password_wrong", &[datagram(&FIGURE_10, &[], WRONG), datagram(&FIGURE_10, &[], SECOND)]),
        // node address, IPNetID, and behind the node.
        ("broadcast", &[to([11, 126]), to([11, 127]), to([126, 4]), beyond(126), beyond(127)]),
        ("node_mismatch", &[to([11, 3]), to([11, 0]), to([11, 125])]),
    ];
    let mut expected = Vec::new();
    for (reason, datagrams) in reasons {
        for octets in datagrams {
            stranger.send(site.public(4), octets);
            exchange(&client, site.public(4), &node, 4);
            assert_eq!(stranger.waiting(), None, "{reason}: {octets:02x?}");
        }
        expected.push(("request", reason, datagrams.len() as u64));
        relay.expect_drops(&expected);
    }
    let metrics = relay.at_rest();
    let of_node_4 = [("net", "section-1"), ("node", "4"), ("direction", "request")];
    let dropped = metrics.sum("pnet_nat_dropped_datagrams_total", &of_node_4);
    assert_eq!(dropped, expected.iter().map(|(.., count)| count).sum::<u64>());
    assert_eq!(metrics.sum("pnet_nat_flows_opened_total", &[]), 1, "none for the stranger");
    relay.finish();
}

#[test]
fn a_source_that_is_not_allowed() {
    let (site, elsewhere) = (Site::claim(), Site::claim());
    let relay = site.relay(Settings::default());
    let (client, stranger, node) = (site.client(), elsewhere.client(), site.node(4));
    stranger.send(site.public(4), &request(4));
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(stranger.waiting(), None);
    relay.expect_drops(&[("request", "source_not_allowed", 1)]);
    relay.finish();
}

/// Guessing is hopeless, also for who guesses right in the end; who is known is served meanwhile.
#[test]
fn a_source_with_too_many_wrong_passwords() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 3\nwrong_password_interval = \"1h\"";
    let relay = site.relay(Settings { sections: limits, ..Settings::default() });
    let (client, stranger, node) = (site.client(), site.client(), site.node(4));
    for _ in 0..5 {
        stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    }
    stranger.send(site.public(4), &request(4));
    exchange(&client, site.public(4), &node, 4);
    for _ in 0..5 {
        // Under a client's address, guesses cannot lock the client out.
        client.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    }
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(stranger.waiting(), None);
    relay.expect_drops(&[("request", "password_wrong", 8), ("request", "throttled", 3)]);
    relay.finish();
}

/// Of each flow one passes, of the net one; whoever has no password uses nothing up.
#[test]
fn more_requests_than_a_flow_or_a_net_may_have() {
    for (limit, passed) in [("max_flow_requests_per_second", 2), ("max_requests_per_second", 1)] {
        let site = Site::claim();
        let net = format!("{limit} = 1");
        let relay = site.relay(Settings { net: &net, ..Settings::default() });
        let (clients, stranger) = ([site.client(), site.client()], site.client());
        let node = site.node(4);
        // Held, so that all of it comes at one moment.
        relay.process.hold();
        for _ in 0..5 {
            stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
        }
        for _ in 0..3 {
            clients.iter().for_each(|client| client.send(site.public(4), &request(4)));
        }
        relay.process.go_on();
        for _ in 0..passed {
            node.expect(&request(4));
        }
        let limited = 6 - passed;
        relay.expect_drops(&[
            ("request", "password_wrong", 5),
            ("request", "request_limit", limited),
        ]);
        assert_eq!(node.waiting(), None);
        assert_eq!(relay.at_rest().sum("pnet_nat_flows_opened_total", &[]), passed);
        relay.finish();
    }
}

/// neither by a port of its own nor by the port or the route of another node.
#[test]
fn a_node_that_is_not_listed() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, listed, unlisted) = (site.client(), site.node(4), site.node(5));
    exchange(&client, site.public(4), &listed, 4);
    UdpSocket::bind(site.public(5)).expect("nobody listens there");
    client.send(site.public(4), &request(5));
    relay.expect_drops(&[("request", "node_mismatch", 1)]);
    exchange(&client, site.public(4), &listed, 4);
    assert_eq!((unlisted.waiting(), listed.waiting()), (None, None));
    relay.finish();
}

/// Who holds one password of a net is not slowed down when he tries others on his open flow, but each
/// is counted; from a port without a flow he is slowed down like everybody.
#[test]
fn guesses_on_an_open_flow_are_not_slowed() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 3\nwrong_password_interval = \"1h\"\n\
                  [datapath]\nprefilter = \"off\"";
    let passwords = "[[udp_range_net.password]]\nname = \"first\"\nfile = \"secrets/section-1\"\n\
                     [[udp_range_net.password]]\nname = \"second\"\nfile = \"secrets/press\"";
    let relay = site.relay(Settings { sections: limits, passwords, ..Settings::default() });
    let (holder, stranger, node) = (site.client(), site.client(), site.node(4));
    exchange(&holder, site.public(4), &node, 4);
    let (wrong, second) = (datagram(&FIGURE_10, &[], WRONG), datagram(&FIGURE_10, &[], SECOND));
    for _ in 0..20 {
        holder.send(site.public(4), &wrong);
        stranger.send(site.public(4), &wrong);
    }
    stranger.send(site.public(4), &second);
    holder.send(site.public(4), &second);
    node.expect(&second);
    relay.expect_drops(&[("request", "password_wrong", 20 + 3), ("request", "throttled", 17 + 1)]);
    assert_eq!(node.waiting(), None);
    relay.finish();
}

/// Who guesses under the address of a client that was right of late shuts it out of nothing: neither
/// its open flow nor a new one. Its neighbours, of whom nothing is known, are throttled as ever.
#[test]
fn a_forged_sender_does_not_lock_out_a_client() {
    let site = Site::claim();
    let limits = "[limits]\nwrong_password_burst = 1\nwrong_password_address_burst = 4\n\
                  wrong_password_interval = \"1h\"\n[datapath]\nprefilter = \"off\"";
    let runtime = "workers = 2";
    let relay = site.relay(Settings { sections: limits, runtime, ..Settings::default() });
    let (client, neighbour, node) = (site.client(), site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    // What a forger sends looks like it came from the client's address, whatever the port.
    let wrong = datagram(&FIGURE_10, &[], WRONG);
    let guess = |address: &Peer, guesses: u64| {
        for _ in 0..guesses {
            Peer::bind((address.address().ip(), 0).into()).send(site.public(4), &wrong);
        }
    };
    guess(&client, 50);
    guess(&neighbour, 50);
    let dropped =
        |reason| relay.metrics().sum("pnet_nat_dropped_datagrams_total", &[("reason", reason)]);
    let judged = || dropped("password_wrong") + dropped("throttled");
    eventually("all guesses are judged", || (judged() == 100).then_some(()));
    // Each worker counts the neighbour's for itself.
    assert!((54..=58).contains(&dropped("password_wrong")), "{}", dropped("password_wrong"));
    let elsewhere = Peer::bind((client.address().ip(), 0).into());
    for client in [&client, &elsewhere] {
        exchange(client, site.public(4), &node, 4);
    }
    relay.finish();
}

/// One node's clients need a socket each. With this limit there are 32 for them.
#[test]
fn no_upstream_socket_left() {
    let site = Site::claim();
    let relay = site.relay(Settings { descriptors: Some(168), ..Settings::default() });
    let node = site.node(4);
    let address = site.client().address().ip();
    let clients: Vec<_> = (0..33).map(|_| Peer::bind((address, 0).into())).collect();
    let (last, served) = clients.split_last().unwrap();
    for client in served {
        exchange(client, site.public(4), &node, 4);
    }
    last.send(site.public(4), &request(4));
    for client in served {
        exchange(client, site.public(4), &node, 4);
    }
    assert_eq!(last.waiting(), None);
    relay.expect_drops(&[("request", "upstream_exhausted", 1)]);
    // The same socket does for another node.
    let other = site.node(3);
    exchange(last, site.public(3), &other, 3);
    relay.finish();
}

/// N-9: the port of a flow that ended rests. So may as many as may be open, and no more, however fast
/// clients come and go.
#[test]
fn sockets_that_rest_are_bounded_too() {
    let site = Site::claim();
    let net = "idle_timeout = \"1ms\"\nmax_flows = 10";
    let server = format!(
        "[[server]]\nname = \"press\"\npublic_port = 20200\naddress = \"{}:34379\"\nnode = 9\n\
         allow = [\"{}/24\"]\n[[server.password]]\nname = \"service\"\n\
         file = \"secrets/section-1\"",
        site.address(9),
        site.address(0)
    );
    let relay = site.relay(Settings { net, sections: &server, ..Settings::default() });
    let (node, press) = (site.node(4), site.node(9));
    let address = site.client().address().ip();
    let clients: Vec<_> = (0..50).map(|_| Peer::bind((address, 0).into())).collect();
    for (asked, clients) in (0..).step_by(10).zip(clients.chunks(10)) {
        eventually("the flows before have ended", || {
            let metrics = relay.metrics();
            let judged = metrics.sum("pnet_nat_received_datagrams_total", &[]) == asked;
            (judged && metrics.sum("pnet_nat_flows", &[]) == 0).then_some(())
        });
        clients.iter().for_each(|client| client.send(site.public(4), &request(4)));
    }
    relay.expect_drops(&[("request", "flow_limit", 30)]);
    let sockets = fs::read_dir(format!("/proc/{}/fd", relay.process.id())).unwrap();
    let sockets = sockets.filter(|fd| {
        let to = fs::read_link(fd.as_ref().unwrap().path());
        to.is_ok_and(|to| to.to_string_lossy().starts_with("socket:"))
    });
    let public = 6;
    let others = 10; // the admin server, with its connections
    assert!(sockets.count() <= public + others + 2 * 10);
    // Whose port rests has it again; other nets have ports of their own.
    (0..20).for_each(|_| drop(node.receive()));
    let again = &clients[0];
    exchange(again, site.public(4), &node, 4);
    exchange(&site.client(), (site.public_address(), 20200).into(), &press, 9);
    relay.expect_drops(&[("request", "flow_limit", 30)]);
    relay.finish();
}

/// Clients of one net use up all sockets that it may have. The clients of others find theirs.
#[test]
fn a_net_that_takes_all_sockets_leaves_those_of_others() {
    let site = Site::claim();
    let press = Peer::bind("[::1]:0".parse().unwrap());
    let server = format!(
        "[[server]]\nname = \"press\"\npublic_port = 20200\naddress = \"{}\"\nnode = 4\n\
         allow = [\"{}/24\"]\n[[server.password]]\nname = \"service\"\n\
         file = \"secrets/section-1\"",
        press.address(),
        site.address(0)
    );
    let relay =
        site.relay(Settings { sections: &server, descriptors: Some(168), ..Settings::default() });
    let (node, other) = (site.node(4), site.node(3));
    let address = site.client().address().ip();
    for _ in 0..150 {
        let client = Peer::bind((address, 0).into());
        client.send(site.public(4), &request(4));
    }
    eventually("all are judged", || {
        let received = relay.metrics().sum("pnet_nat_received_datagrams_total", &[]);
        (received >= 150).then_some(())
    });
    let public = SocketAddr::from((site.public_address(), 20200));
    exchange(&site.client(), site.public(3), &other, 3);
    exchange(&site.client(), public, &press, 4);
    drop(node);
    relay.finish();
}

/// Loopback's broadcast address stands for a server that the system refuses to send to.
#[test]
fn a_server_that_cannot_be_sent_to() {
    let site = Site::claim();
    let server = |name, public_port, secure_port| {
        format!(
            "[[server]]\nname = \"{name}\"\npublic_port = {public_port}\n\
             address = \"127.255.255.255:{secure_port}\"\nnode = 4\nallow = [\"{}/24\"]\n\
             [[server.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n",
            site.address(0)
        )
    };
    let servers = server("press", 20200, 34379) + &server("oven", 20201, 34380);
    let relay = site.relay(Settings { sections: &servers, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    for public_port in [20200, 20200, 20201] {
        client.send((site.public_address(), public_port).into(), &request(4));
        exchange(&client, site.public(4), &node, 4);
    }
    relay.expect_drops(&[("request", "send_failed", 3)]);
    // The press was not asked, so it is not silent.
    let since = "pnet_nat_unanswered_since_timestamp_seconds";
    assert_eq!(relay.at_rest().sum(since, &[("net", "press")]), 0);
    let log = relay.finish();
    let told = log.logged("cannot send to a server").into_iter().map(|line| line["net"].clone());
    assert_eq!(told.collect::<Vec<_>>(), ["press", "oven"], "{}", log.stderr());
}

#[test]
fn responses_that_are_not_in_order() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));
    let good = response(4);
    let with = |index: usize, octet| {
        let mut octets = good.clone();
        octets[index] = octet;
        octets
    };
    let longer = |by: usize| [good.clone(), vec![0; by]].concat();
    let wrong = [&good[..good.len() - 8], WRONG].concat();
    let others = [&good[..good.len() - 8], SECOND].concat();
    let reasons: [(&str, &[Vec<u8>]); 6] = [
        ("too_short", &[vec![], vec![0x02], good[..7].to_vec()]),
        ("too_long", &[longer(108 - good.len()), longer(1400)]),
        ("bad_header", &[with(0, 0x03), with(3, 1)]),
        // The last three: formats that IP does not carry.
        (
            "bad_route",
            &[
                with(6, 0),
                with(6, 27),
                datagram(&[0x04, 0x9F], &[], PASSWORD),
                datagram(&[0x84, 0x9F], &[], PASSWORD),
                datagram(&[0x0B, 0x04, 0x03, 0x02, 0x21, 0x8B], &[], PASSWORD),
            ],
        ),
        ("bad_length", &[longer(1), good[..good.len() - 1].to_vec()]),
        ("password_mismatch", &[wrong, others]),
    ];
    let mut expected = Vec::new();
    for (reason, datagrams) in reasons {
        for octets in datagrams {
            node.send(from_relay, octets);
            exchange(&client, site.public(4), &node, 4);
        }
        expected.push(("response", reason, datagrams.len() as u64));
        relay.expect_drops(&expected);
    }
    relay.finish();
}

/// From a node that was not asked over this socket, from a node's other port, from anywhere else.
#[test]
fn responses_that_nobody_waits_for() {
    let (site, elsewhere) = (Site::claim(), Site::claim());
    let relay = site.relay(Settings::default());
    let (client, node, other) = (site.client(), site.node(4), site.node(3));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));
    let other_port = Peer::bind((site.address(4), 34380).into());
    for (sender, net, node_address) in
        [(&other, "section-1", "3"), (&other_port, "none", "0"), (&elsewhere.client(), "none", "0")]
    {
        let before = unknown(&relay, net, node_address);
        sender.send(from_relay, &response(4));
        exchange(&client, site.public(4), &node, 4);
        assert_eq!(unknown(&relay, net, node_address), before + 1);
    }
    relay.expect_drops(&[("response", "unknown_flow", 3)]);
    relay.finish();
}

fn unknown(relay: &Relay, net: &str, node: &str) -> u64 {
    let labels = [("net", net), ("node", node), ("reason", "unknown_flow")];
    relay.metrics().sum("pnet_nat_dropped_datagrams_total", &labels)
}

/// A16: passed on without a password, unless the net wants one.
#[test]
fn a_response_without_the_password_that_its_net_requires() {
    for (net, required) in [("", false), ("require_response_password = true", true)] {
        let site = Site::claim();
        let relay = site.relay(Settings { net, ..Settings::default() });
        let (client, node) = (site.client(), site.node(4));
        client.send(site.public(4), &request(4));
        let from_relay = node.expect(&request(4));
        let bare = &response(4)[..response(4).len() - 8];
        node.send(from_relay, bare);
        if required {
            exchange(&client, site.public(4), &node, 4);
            relay.expect_drops(&[("response", "password_mismatch", 1)]);
        } else {
            client.expect(bare);
            relay.expect_drops(&[]);
        }
        relay.finish();
    }
}
