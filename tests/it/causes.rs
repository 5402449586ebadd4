//! Why a client gets no answer: each cause is named by a command, and on the status page in a real
//! browser. Needs root.

use crate::harness::{
    Browser, FIGURE_10, Network, Process, Relay, WRONG, datagram, eventually, pnet_nat, request,
};
use crate::probe::{configuration, node, probe};
use crate::status_page::{errors, expect_no_accessibility_faults, screenshot};

/// What `pnet-nat status --refused` prints.
fn refused(url: &str) -> String {
    let mut status = Process::start(pnet_nat(&["status", "--refused", "--full", "--url", url]));
    assert_eq!(status.end(), Some(0), "{}", status.stderr());
    status.stdout()
}

/// Presses the button beside a node until what its probe finds is shown: one a second is answered.
fn expect_probed(browser: &Browser, node_address: u8, told: &str) {
    let row = format!("[data-net=section-1] [data-node=\"{node_address}\"]");
    let mut found = String::new();
    eventually("the node is probed", || {
        browser.run(&format!("document.querySelector('{row} button').click()"));
        eventually("the probe has an end", || {
            found = browser.text(&format!("{row} + .probe"));
            (!found.is_empty() && !found.contains("Asking the node")).then_some(())
        });
        (!found.contains("429")).then_some(())
    });
    assert!(found.contains(told), "{told}: {found}");
}

#[test]
fn each_cause_is_named_by_a_command_and_on_the_page() {
    let Some(network) = Network::build() else { return };
    network.plant.ip("address delete 172.17.17.2/24 dev eth0"); // node 2 is off
    network.at_the_edge(|| {
        let Some(browser) = Browser::start() else { return };
        let _nodes = [(1, "section-1"), (4, "section-1"), (3, "press")]
            .map(|(address, password)| node(&network, address, password));
        let admin = network.place("").admin;
        let relay = Relay::start(&configuration(&network, "probe = true"), admin, None);
        let url = format!("http://{admin}/");
        browser.look(1280, 2400, false, "light");
        browser.open(&url);
        browser.expect("#banner.good", "No client has had an answer yet.");

        what_clients_do_wrong(&network, &relay);
        let table = refused(&url);
        for (in_table, on_page) in [
            ("a mistyped one", "sends a wrong password to node 4 of section-1"),
            ("allow networks", "is not in allow of section-1"),
            ("start port", "names another node on the port of node 2 of section-1"),
            ("node address is off", "names another node on the port of node 33 of section-1"),
        ] {
            assert!(table.contains(in_table), "{in_table}: {table}");
            browser.expect("#refused tbody", on_page);
        }

        let probed = probe(relay.folder.path(), &[]);
        let of = |node_address: u8| format!("node {node_address} of section-1");
        for (node_address, check, verdict, told) in [
            (2, "neighbour", "bad", "does not answer ARP"),
            (3, "answer", "doubtful", "compare the password with the node's PasswordTable"),
        ] {
            probed.expect(check, &of(node_address), verdict, told);
            expect_probed(&browser, node_address, told);
        }
        expect_probed(&browser, 1, "answers in ");

        flood(&network, &relay);
        browser.expect("#events tbody", "flood of section-1: the kernel refuses it");
        browser.expect("#drops", "kernel: prefilter");
        let told = "as in a flood";
        probe(relay.folder.path(), &[]).expect("flood", "section-1", "doubtful", told);

        network.edge.ip("link set eth1 down");
        let told = "no route leads to 172.17.17.1";
        probe(relay.folder.path(), &[]).expect("route", "section-1", "bad", told);
        expect_probed(&browser, 1, "the request did not get to 172.17.17.1");
        for (name, width, is_phone, scheme) in [
            ("causes-light", 1280, false, "light"),
            ("causes-dark", 1280, false, "dark"),
            ("causes-phone", 390, true, "light"),
        ] {
            browser.look(width, 2400, is_phone, scheme);
            screenshot(&browser, name);
            expect_no_accessibility_faults(&browser, name);
        }
        let mut errors = errors(&browser);
        errors.retain(|error| !error.contains("429 (Too Many Requests)"));
        assert_eq!(errors, [""; 0]);
        relay.finish();
    });
}

fn what_clients_do_wrong(network: &Network, relay: &Relay) {
    let public = |node_address| network.public("198.51.100.1", node_address);
    let [client, other] = ["198.51.100.7", "198.51.100.8"].map(|address| network.client(address));
    let wrong_password = datagram(&FIGURE_10, &[], WRONG);
    (0..3).for_each(|_| other.send(public(4), &wrong_password));
    network.client("203.0.113.7").send(public(1), &request(1));
    // A start port that is one too high.
    (1..=3).for_each(|node_address| client.send(public(node_address + 1), &request(node_address)));
    // The address of one node is entered wrong.
    other.send(public(33), &request(3));
    relay.expect_drops(&[
        ("request", "password_wrong", 3),
        ("request", "source_not_allowed", 1),
        ("request", "node_mismatch", 4),
    ]);
}

fn flood(network: &Network, relay: &Relay) {
    let stranger = network.client("198.51.100.7");
    let wrong = datagram(&FIGURE_10, &[1, 2, 3], WRONG);
    eventually("the kernel refuses", || {
        (0..1000).for_each(|_| stranger.send(network.public("198.51.100.1", 4), &wrong));
        let metrics = relay.metrics();
        let refused =
            metrics.sum("pnet_nat_kernel_dropped_datagrams_total", &[("cause", "prefilter")]);
        (refused > 0).then_some(())
    });
}
