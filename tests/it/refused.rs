//! Who is refused, and why: on the API, in `pnet-nat status`, and in the log.

use std::net::Ipv4Addr;

use serde_json::{Value, json};

use crate::harness::{
    FIGURE_10, Network, Peer, Process, Relay, Settings, Site, WRONG, datagram, eventually,
    exchange, pnet_nat, request,
};

const NO_PREFILTER: &str = "[datapath]\nprefilter = \"off\"";

/// What `GET /api/v1/refused` says: the rows without their ages, and how many are not listed.
fn refused(relay: &Relay) -> (Vec<Value>, u64) {
    let (status, body) = relay.get("/api/v1/refused").unwrap();
    assert_eq!(status, 200, "{body}");
    let mut all: Value = serde_json::from_str(&body).unwrap();
    let mut rows: Vec<Value> = serde_json::from_value(all["refused"].take()).unwrap();
    for row in &mut rows {
        let row = row.as_object_mut().unwrap();
        let mut age = |key| row.remove(key).unwrap().as_f64().unwrap();
        let (first, last) = (age("first_age_seconds"), age("last_age_seconds"));
        assert!(0.0 <= last && last <= first && first < 600.0, "{first} {last}");
    }
    (rows, all["not_listed"].as_u64().unwrap())
}

fn row(sender: &Peer, node: u8, reason: &str, count: u64) -> Value {
    json!({ "source": sender.address().ip(), "net": "section-1", "node": node,
            "direction": "request", "reason": reason, "count": count })
}

/// What `pnet-nat status` prints.
fn status(site: &Site, arguments: &[&str]) -> String {
    let url = format!("http://{}/", site.admin());
    let mut status = Process::start(pnet_nat(&[&["status", "--url", &url], arguments].concat()));
    assert_eq!(status.end(), Some(0), "{}", status.stderr());
    status.stdout()
}

/// The cells of the line that begins with this address.
fn cells(table: &str, sender: &Peer) -> Vec<String> {
    let cells = |line: &str| -> Vec<String> {
        line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    let address = sender.address().ip().to_string();
    table.lines().map(cells).find(|cells| cells[0] == address).expect(table)
}

#[test]
fn whoever_is_refused_is_named_with_the_reason_and_what_to_do() {
    let (site, elsewhere) = (Site::claim(), Site::claim());
    let sections = format!("[limits]\nwrong_password_burst = 2\n{NO_PREFILTER}");
    let relay = site.relay(Settings { sections: &sections, ..Settings::default() });
    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    assert_eq!(refused(&relay), (vec![], 0));
    assert_eq!(status(&site, &["--refused"]), "Nobody was refused.\n");
    assert!(!status(&site, &[]).contains("--refused"));

    let outside = elsewhere.client();
    let [guesser, shifted, no_password, noise] = [(); 4].map(|()| site.client());
    for _ in 0..3 {
        outside.send(site.public(3), &request(3));
        guesser.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
        // Its start port is one too high.
        shifted.send(site.public(4), &request(3));
    }
    no_password.send(site.public(4), &datagram(&FIGURE_10, &[7; 4], &[]));
    noise.send(site.public(4), b"\x02\0\0\x07a datagram of another kind");
    let expected = [
        row(&outside, 3, "source_not_allowed", 3),
        row(&guesser, 4, "password_wrong", 2),
        row(&guesser, 4, "throttled", 1),
        row(&shifted, 4, "node_mismatch", 3),
        row(&no_password, 4, "password_missing", 1),
        row(&noise, 4, "bad_header", 1),
    ];
    let rows = eventually("all are judged", || {
        let (rows, not_listed) = refused(&relay);
        assert_eq!(not_listed, 0);
        let sum: u64 = rows.iter().map(|row| row["count"].as_u64().unwrap()).sum();
        (sum == 11).then_some(rows)
    });
    assert_eq!(rows.len(), expected.len());
    for row in &expected {
        assert!(rows.contains(row), "{row} is not in {rows:?}");
    }

    let table = status(&site, &["--refused"]);
    let first = cells(&table, &outside);
    assert_eq!(first[1..5], ["section-1", "3", "source_not_allowed", "3"]);
    assert!(first[5].ends_with(" s ago") && first[6].ends_with(" s ago"), "{table}");
    assert_eq!(cells(&table, &shifted)[3], "node_mismatch");
    assert!(table.contains("the client's start port or node address is off."), "{table}");
    assert!(table.contains("set UsePW in the client's IPNetTable."), "{table}");

    let hint = status(&site, &[]);
    let hint = hint.lines().find(|line| line.starts_with("Refused in the last 10 min")).unwrap();
    assert!(hint.contains(", and 3 other senders. pnet-nat status --refused"), "{hint}");
    let json = status(&site, &["--refused", "--format", "json", "--net", "section-1"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["refused"].as_array().unwrap().len(), expected.len());
    assert!(json["drop_reasons"]["node_mismatch"].is_string() && json["nets"].is_null());
    relay.finish();
}

/// They stay the same in a reload that brings other nets; a net that goes takes its own along.
#[test]
fn the_list_goes_on_over_a_reload() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let stranger = site.client();
    let wrong = datagram(&FIGURE_10, &[], WRONG);
    stranger.send(site.public(4), &wrong);
    relay.expect_drops(&[("request", "password_wrong", 1)]);
    let configuration = site.configuration(&Settings::default());
    let before = format!(
        "[[server]]\nname = \"press\"\npublic_port = 20200\naddress = \"{}:34379\"\nnode = 9\n\
         allow = [\"{}/24\"]\n[[server.password]]\nname = \"service\"\n\
         file = \"secrets/section-1\"\n\n[[udp_range_net]]",
        site.address(9),
        site.address(0)
    );
    relay.reload_to(&configuration.replacen("[[udp_range_net]]", &before, 1));
    stranger.send(site.public(4), &wrong);
    eventually("it is the same one", || {
        let (rows, _) = refused(&relay);
        (rows == [row(&stranger, 4, "password_wrong", 2)]).then_some(())
    });
    relay.reload_to(&configuration.replace("\"section-1\"", "\"section-2\""));
    assert_eq!(refused(&relay), (vec![], 0));
    relay.finish();
}

/// Two thousand senders, far more than the list has room for, beside a client that is refused for the
/// same reason again and again. The log names the client alone.
#[test]
fn a_flood_does_not_hide_who_is_refused() {
    let (site, elsewhere) = (Site::claim(), Site::claim());
    let relay = site.relay(Settings { sections: NO_PREFILTER, ..Settings::default() });
    let client = elsewhere.client();
    client.send(site.public(4), &request(4));
    let mut sent = 1;
    for batch in 0..20 {
        for last in 1..=100 {
            let stranger = Peer::bind((Ipv4Addr::new(127, 200, batch, last), 0).into());
            stranger.send(site.public(4), &request(4));
        }
        client.send(site.public(4), &request(4));
        sent += 101;
        relay.expect_drops(&[("request", "source_not_allowed", sent)]);
    }
    let (rows, not_listed) = refused(&relay);
    assert!(rows.contains(&row(&client, 4, "source_not_allowed", 21)), "{rows:?}");
    let listed: u64 = rows.iter().map(|row| row["count"].as_u64().unwrap()).sum();
    assert_eq!(listed + not_listed, sent);
    assert!(rows.len() < 500 && not_listed > 1000, "{} {not_listed}", rows.len());
    assert_eq!(cells(&status(&site, &["--refused", "--full"]), &client)[4], "21");

    let log = relay.finish();
    let lines: Vec<_> = log.log().filter(|line| line["reason"] == "source_not_allowed").collect();
    let of_client = json!(client.address().ip());
    let its = lines.iter().filter(|line| line["last_sender"] == of_client);
    assert!(its.count() >= 1 && lines.len() <= 5, "{}", log.stderr());
    let counted: u64 = lines.iter().map(|line| line["count"].as_u64().unwrap()).sum();
    assert_eq!(counted, sent, "{}", log.stderr());
}

#[test]
fn a_sender_is_named_by_its_ipv6_address() {
    let Some(network) = Network::build() else { return };
    network.at_the_edge(|| {
        let place = network.place(r#"["::"]"#);
        let relay = place.relay(&Settings { sections: NO_PREFILTER, ..Settings::default() });
        let client = network.client("2001:db8:1::7");
        let wrong = datagram(&FIGURE_10, &[], WRONG);
        (0..2).for_each(|_| client.send(network.public("2001:db8:1::1", 4), &wrong));
        relay.expect_drops(&[("request", "password_wrong", 2)]);
        let (rows, _) = refused(&relay);
        assert_eq!(rows, [row(&client, 4, "password_wrong", 2)]);
        assert_eq!(rows[0]["source"], "2001:db8:1::7");
        relay.finish();
    });
}
