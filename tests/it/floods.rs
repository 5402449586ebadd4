//! What a flood does: the kernel takes it over, good clients go on, and it ends.

use crate::harness::{
    FIGURE_10, Relay, SECOND, Settings, Site, WRONG, datagram, eventually, exchange, request,
    response,
};

const KERNEL: &str = "pnet_nat_kernel_dropped_datagrams_total";

/// Floods one port with wrong passwords and lengths until the prefilter is on.
fn flood(site: &Site, relay: &Relay) -> u64 {
    let strangers: Vec<_> = (0..4).map(|_| site.client()).collect();
    let wrong = datagram(&FIGURE_10, &[1, 2, 3], WRONG);
    let mut sent = 0;
    eventually("the kernel refuses", || {
        // Fast enough on a slow machine too, where asking for the metrics takes its time.
        for stranger in strangers.iter().cycle().take(64) {
            for octets in [&wrong, &vec![0xFF; 40], &wrong, &vec![2, 0, 0, 0]] {
                stranger.send(site.public(4), octets);
                sent += 1;
            }
        }
        (relay.metrics().sum(KERNEL, &[("cause", "prefilter")]) > 0).then_some(())
    });
    for octets in std::iter::repeat_n(&wrong, 1000) {
        strangers[0].send(site.public(4), octets);
        sent += 1;
    }
    for stranger in strangers {
        assert_eq!(stranger.waiting(), None, "a stranger is answered");
    }
    sent
}

#[test]
fn a_flood_is_refused_by_the_kernel_and_good_clients_go_on() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);

    let sent = flood(&site, &relay);
    exchange(&client, site.public(4), &node, 4);
    // One who comes only now is known by the password alone, like everyone.
    exchange(&site.client(), site.public(4), &node, 4);

    let metrics = relay.metrics();
    let seen = metrics.drops().values().sum::<u64>();
    let refused = metrics.sum(KERNEL, &[("cause", "prefilter")]);
    assert!(refused >= 1000, "{refused} of {sent}");
    assert_eq!(seen + refused + metrics.sum(KERNEL, &[("cause", "overflow")]), sent);
    let log = relay.finish();
    assert_eq!(log.logged("flood: prefilter on").len(), 1, "{}", log.stderr());
}

/// The kernel knows the new password at once, and what it refused stays counted.
#[test]
fn a_password_that_is_added_during_a_flood_passes() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    flood(&site, &relay);
    let refused = || relay.metrics().sum(KERNEL, &[("cause", "prefilter")]);
    let before = refused();

    let passwords = "[[udp_range_net.password]]\nname = \"first\"\nfile = \"secrets/section-1\"\n\
                     [[udp_range_net.password]]\nname = \"second\"\nfile = \"secrets/press\"";
    relay.reload_to(&site.configuration(&Settings { passwords, ..Settings::default() }));
    let second = datagram(&FIGURE_10, &[], SECOND);
    client.send(site.public(4), &second);
    node.expect(&second);
    client.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    eventually("the prefilter is still on", || (refused() == before + 1).then_some(()));

    // Without the flooded port, and with it again.
    client.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    let all = site.configuration(&Settings::default());
    relay.reload_to(&all.replace("\"1-4\", 33", "\"1-3\", 33"));
    assert_eq!(refused(), before + 2);
    relay.reload_to(&all);
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(refused(), before + 2);
    relay.finish();
}

/// With every password of the net, and with a device's own password behind it.
#[test]
fn the_prefilter_lets_every_password_of_the_net_through() {
    let site = Site::claim();
    let passwords = r#"
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
device_file = "secrets/section-1-device"
[[udp_range_net.password]]
name = "second"
file = "secrets/press"
"#;
    let sections = "[datapath]\nprefilter = \"always\"";
    let relay = site.relay(Settings { passwords, sections, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    node.receive();
    client.send(site.public(4), &datagram(&FIGURE_10, &[], SECOND));
    node.receive();
    client.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    eventually("it is refused", || (relay.metrics().sum(KERNEL, &[]) == 1).then_some(()));
    relay.expect_drops(&[]);
    relay.finish();
}

/// Of datagrams that fail otherwise, or come from where nobody may send from.
#[test]
fn floods_of_other_kinds_are_refused_too() {
    let simple = [&[2, 0, 0, 0, 4, 0x83, 2, 0][..], WRONG].concat();
    let wrong = datagram(&FIGURE_10, &[1, 2, 3], WRONG);
    for (octets, stranger) in [(simple, true), (wrong, false)] {
        let (site, elsewhere) = (Site::claim(), Site::claim());
        let relay = site.relay(Settings::default());
        let (client, node) = (site.client(), site.node(4));
        let flooder = if stranger { site.client() } else { elsewhere.client() };
        eventually("the kernel refuses", || {
            (0..20).for_each(|_| flooder.send(site.public(4), &octets));
            (relay.metrics().sum(KERNEL, &[("cause", "prefilter")]) > 0).then_some(())
        });
        exchange(&client, site.public(4), &node, 4);
        assert_eq!(flooder.waiting(), None, "a stranger is answered");
        relay.finish();
    }
}

/// Then a mistyped password is told from noise again.
#[test]
fn the_prefilter_goes_when_the_flood_is_over() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    flood(&site, &relay);
    eventually("the prefilter is off", || {
        relay.process.logged("floods are over: prefilter off").pop()
    });
    let before = relay.metrics().drops();
    let stranger = site.client();
    stranger.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    let reason = ("request".to_owned(), "password_wrong".to_owned());
    eventually("it is counted by its reason", || {
        (relay.metrics().drops()[&reason] == before[&reason] + 1).then_some(())
    });
    relay.finish();
}

/// Towards the plant: what no server sent is refused by the kernel, and answers go on.
#[test]
fn a_flood_of_strays_at_an_upstream_port_is_refused_by_the_kernel() {
    let (site, elsewhere) = (Site::claim(), Site::claim());
    let relay = site.relay(Settings::default());
    let (client, node) = (site.client(), site.node(4));
    client.send(site.public(4), &request(4));
    let from_relay = node.expect(&request(4));

    let stranger = elsewhere.client();
    let upstream = [("net", "none"), ("cause", "prefilter")];
    let mut sent = 0;
    eventually("the kernel refuses", || {
        for _ in 0..20 {
            stranger.send(from_relay, &response(4));
            sent += 1;
        }
        (relay.metrics().sum(KERNEL, &upstream) > 0).then_some(())
    });
    node.send(from_relay, &response(4));
    client.expect(&response(4));
    exchange(&client, site.public(4), &node, 4);

    // A reload changes the program: the node is a server of another table.
    let all = site.configuration(&Settings::default());
    relay.reload_to(&all.replace("\"1-4\", 33", "\"4\""));
    exchange(&client, site.public(4), &node, 4);
    stranger.send(from_relay, &response(4));
    sent += 1;
    eventually("every one is counted", || {
        let metrics = relay.metrics();
        let seen: u64 = metrics.drops().values().sum();
        (seen + metrics.sum(KERNEL, &[("net", "none")]) == sent).then_some(())
    });
    let log = relay.finish();
    assert_eq!(log.logged("flood of what no server sent: refused by the kernel").len(), 1);
}

/// Spread over many ports, none of which sees much of it.
#[test]
fn a_flood_over_many_ports_is_refused_too() {
    let site = Site::claim();
    let all = site.configuration(&Settings::default()).replace("[\"1-4\", 33]", "[\"1-125\"]");
    let relay = Relay::start(&all, site.admin(), None);
    let (client, node) = (site.client(), site.node(4));
    let (stranger, wrong) = (site.client(), datagram(&FIGURE_10, &[1, 2, 3], WRONG));
    let mut sent = 0;
    let mut spread = || {
        for node_address in 1..=125 {
            stranger.send(site.public(node_address), &wrong);
            sent += 1;
        }
    };
    eventually("the kernel refuses most", || {
        let refused = || relay.metrics().sum(KERNEL, &[("cause", "prefilter")]);
        let before = refused();
        (0..8).for_each(|_| spread());
        (refused() - before > 900).then_some(())
    });
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(stranger.waiting(), None, "a stranger is answered");
    let metrics = relay.metrics();
    let counted = metrics.drops().values().sum::<u64>() + metrics.sum(KERNEL, &[]);
    assert_eq!(counted, sent);

    eventually("the prefilter is off", || {
        relay.process.logged("floods are over: prefilter off").pop()
    });
    let refused = relay.metrics().sum(KERNEL, &[("cause", "prefilter")]);
    (0..4).for_each(|_| stranger.send(site.public(1), &wrong));
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(relay.metrics().sum(KERNEL, &[("cause", "prefilter")]), refused);
    let log = relay.finish();
    assert_eq!(log.logged("flood: prefilter on").len(), 1, "{}", log.stderr());
}
