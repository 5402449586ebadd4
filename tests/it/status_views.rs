//! What the status page shows besides nets and nodes: who is refused, who is connected, what happened,
//! how it was over the day. The figures are made up where they would take a day to come about.

use serde_json::{Value, json};

use crate::harness::{Browser, Relay, Site, eventually, request};
use crate::status_page::{
    ENTER, configuration, errors, expect_no_accessibility_faults, relay, screenshot, state_of,
};

const ARROW_RIGHT: &str = "\u{e014}";

/// The history of a day in which `node` was silent for 25 minutes.
fn history(node: u8) -> Value {
    let series = |steps: usize, seconds: u32| {
        let figures = |figure: f64| vec![Some(figure); steps];
        let mut requests = figures(138.0);
        requests[0] = None;
        json!({
            "step_seconds": seconds, "requests": requests, "answers": figures(137.5),
            "dropped": figures(0.0), "wrong_passwords": figures(0.0), "flows": figures(7.0),
            "answering_nodes": figures(4.0), "median_seconds": figures(0.005),
            "p99_seconds": figures(0.026),
        })
    };
    let strip =
        format!("{}{}{}{}", "-".repeat(400), "a".repeat(500), "s".repeat(25), "a".repeat(515));
    json!({
        "now": 1_795_770_000.0, "hour": series(360, 10), "day": series(1440, 60),
        "nodes": { node.to_string(): strip },
    })
}

fn everything() -> Value {
    let flow = |node: u8, idle: f64| {
        json!({
            "net": "section-1", "node": node, "client": "198.51.100.9:50000", "credential": "service",
            "age_seconds": 7300.0, "idle_seconds": idle, "requests": 700, "responses": 699,
            "octets": 45_000,
        })
    };
    let event = |number: u32, kind: &str, text: &str| {
        json!({ "number": number, "time": 1_795_770_000.0 + f64::from(number), "kind": kind,
            "net": null, "node": null, "text": text })
    };
    let check = |verdict: &str, text: &str, remedy: Value| {
        json!({ "check": "answer", "subject": "node 3 of section-1", "verdict": verdict,
            "text": text, "remedy": remedy })
    };
    json!({
        "/api/v1/status": { "probe": true, "offload": {
            "state": "on", "why": null, "flows": 0, "interfaces": ["eth0", "eth1"],
        } },
        "/api/v1/refused": { "not_listed": 4, "refused": [
            { "source": "198.51.100.9", "direction": "request", "net": "section-1", "node": 3, "reason": "source_not_allowed",
                "count": 138, "first_age_seconds": 840.0, "last_age_seconds": 3.1 },
            { "source": "2001:db8::7", "direction": "request", "net": "section-1", "node": 3, "reason": "password_wrong",
                "count": 5, "first_age_seconds": 9000.0, "last_age_seconds": 7300.0 },
        ] },
        "/api/v1/flows": {
            "flows": [flow(1, 5.0), flow(2, 0.5), flow(3, 9.0), flow(33, 9.0)],
            "complete": false,
            "credentials": [
                { "net": "section-1", "credential": "service", "accepted_requests": 2800, "flows": 4 },
            ],
        },
        "/api/v1/events": { "events": [
            event(2, "node_silent", "node 3 of section-1 is silent"),
            event(1, "start", "the relay has started"),
        ] },
        "/api/v1/history": history(3),
        "/api/v1/probe": { "verdict": "bad", "checks": [
            check("bad", "no answer within 1 s", json!("Look at its power and its cable.")),
            check("good", "the router knows its MAC address", json!(null)),
        ] },
    })
}

/// The pictures of a view, and what the accessibility checker says of it.
fn look_at(browser: &Browser, view: &str) {
    for (name, width, is_phone, scheme) in [
        ("light", 1280, false, "light"),
        ("dark", 1280, false, "dark"),
        ("phone", 390, true, "light"),
    ] {
        browser.look(width, 3000, is_phone, scheme);
        screenshot(browser, &format!("{view}-{name}"));
        let wide = browser.run("return document.documentElement.scrollWidth");
        assert!(wide.as_u64() <= Some(width.into()), "{view}-{name}: {wide} wide");
        expect_no_accessibility_faults(browser, view);
    }
    browser.look(1280, 3000, false, "light");
}

#[test]
fn who_is_refused_connected_and_what_happened_is_told() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let with_probe = configuration(&site).replace("[admin]", "[admin]\nprobe = true");
    let _relay = Relay::start(&with_probe, site.admin(), None);
    browser.pretend(&everything());
    browser.look(1280, 3000, false, "light");
    browser.open(&format!("http://{}/", site.admin()));

    browser.expect("#banner.doubtful", "138 requests refused: source_not_allowed. The last ");
    assert_eq!(browser.run("return document.title"), "requests refused · pnet-nat");
    browser.expect("#relay", "0 of 0 flows, at eth0, eth1");
    browser.expect("#refused tbody tr:first-child th", "198.51.100.9");
    browser.expect("#refused tbody tr:first-child", "is not in allow of section-1");
    browser.expect("#refused tbody tr:first-child", "138");
    browser.expect("#refused tbody tr:last-child", "sends a wrong password to node 3 of section-1");
    browser.expect("#refused-note", "4 more requests were refused");
    browser.run("document.querySelector('#refused-link').focus()");
    browser.press(ENTER);
    assert_eq!(browser.run("return document.activeElement.id"), "refused-place");

    browser.run("document.querySelector('#connected summary').focus()");
    browser.press(ENTER);
    browser.expect("#clients tbody", "198.51.100.9:50000\tsection-1\t1–3, 33\tservice\t2 h\t0.5 s");
    browser.expect("#clients tbody", "2,800\t180 kB");
    browser.expect("#credentials tbody", "service\tsection-1\t2,800\t4");
    browser.expect("#clients-note", "Of the first 1,000 flows; pnet-nat flows has all.");
    browser.expect("#events tbody tr:first-child", "node 3 of section-1 is silent");
    browser.expect("#events tbody tr:last-child", "the relay has started");
    eventually("it is asked for again, and each event stands once", || {
        let rows = browser.run("return document.querySelectorAll('#events tbody tr').length");
        assert_eq!(rows, 2);
        let asked = "return performance.getEntriesByType('resource')
            .filter(({ name }) => name.includes('/api/v1/events')).length";
        (browser.run(asked).as_u64() > Some(2)).then_some(())
    });

    browser.run("document.querySelector('[data-node=\"3\"] button').focus()");
    browser.press(ENTER);
    browser.expect(".probe", "▲ bad node 3 of section-1: no answer within 1 s");
    browser.expect(".probe", "Look at its power and its cable.");
    browser.expect(".probe", "● good");
    look_at(&browser, "views");
    browser.run("document.querySelector('.probe button').focus()");
    browser.press(ENTER);
    assert_eq!(browser.text(".probe"), "");
    assert_eq!(browser.run("return document.activeElement.textContent"), "Probe");
    assert_eq!(errors(&browser), [""; 0]);
}

#[test]
fn plots_are_full_at_once_and_nodes_have_their_day() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let _relay = relay(&site);
    browser.pretend(&everything());
    browser.look(1280, 1800, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "138 requests refused");
    let points = || {
        let path =
            browser.run("return document.querySelectorAll('.plot path')[1].getAttribute('d')");
        path.as_str().unwrap_or_default().split('L').count()
    };
    eventually("five minutes are there", || ((29..=35).contains(&points())).then_some(()));
    let tile = "#tiles .tile:nth-child(2)";
    browser.expect(&format!("{tile} .values"), "200 /s");
    browser.expect(&format!("{tile} .times"), "−5 min");
    browser.run("document.querySelector('#range input').focus()");
    browser.press(ARROW_RIGHT);
    eventually("an hour is there", || (points() == 359).then_some(()));
    browser.press(ARROW_RIGHT);
    eventually("a day is there", || (points() == 1439).then_some(()));
    let times = browser.text(&format!("{tile} .times"));
    assert!(times.contains(':') && times.contains("now"), "{times}");

    let strip = "[data-node=\"3\"] .strip";
    eventually("the day of a node is there", || {
        let title =
            browser.run(&format!("return document.querySelector(`{strip} title`).textContent"));
        let title = title.as_str().unwrap_or_default();
        let is_there = title.contains("the relay runs since ") && title.contains("silent from ");
        is_there.then_some(())
    });
    browser.expect("[data-node=\"3\"] .day", "silent ");
    expect_no_accessibility_faults(&browser, "day");
    screenshot(&browser, "day");
}

#[test]
fn the_filter_leaves_what_one_looks_for() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let configuration = configuration(&site);
    let (general, net) = configuration.split_once("[[udp_range_net]]").unwrap();
    let port = format!("start_port = {}", site.start_port());
    let other =
        net.replace("section-1", "section-2").replace("secrets/section-2", "secrets/section-1");
    let other = other.replace(&port, &format!("start_port = {}", site.start_port() + 200));
    let other = other.replace("\"1-4\", 33", "50");
    let net = net.replace("\"1-4\", 33", "\"1-40\"");
    let configuration = format!("{general}[[udp_range_net]]{net}[[udp_range_net]]{other}");
    let _relay = Relay::start(&configuration, site.admin(), None);
    browser.look(1280, 3000, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    site.client().send(site.public(7), &request(7));
    browser.expect("#banner", "1 node is silent:");
    let address = site.address(12).to_string();
    for (words, nodes) in [
        ("50", vec![50]),
        ("node 3", vec![3]),
        ("silent", vec![7]),
        ("SECTION-2 never", vec![50]),
        (address.as_str(), vec![12]),
        ("silent 50", vec![]),
    ] {
        browser.run("const box = document.querySelector('#filter'); box.focus(); box.select()");
        browser.press(words);
        eventually(&format!("{words} leaves {nodes:?}"), || {
            let shown = browser.run(
                "return [...document.querySelectorAll('[data-node]')]
                    .filter((row) => row.checkVisibility()).map((row) => +row.dataset.node)",
            );
            (shown == json!(nodes)).then_some(())
        });
    }
    browser.expect("#filter-note", "0 nodes in 0 nets");
    // What the banner leads to is there, whatever the filter leaves.
    browser.run("document.querySelector('#silent-links button').focus()");
    browser.press(ENTER);
    eventually("the node has the focus", || {
        (browser.run("return document.activeElement.dataset.node") == "7").then_some(())
    });
    browser.expect(&state_of(33), "never asked");
    assert_eq!(errors(&browser), [""; 0]);
}

#[test]
fn the_title_is_in_head_and_tab_and_never_markup() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let untitled = configuration(&site);
    let titled =
        |title: &str| untitled.replace("[admin]", &format!("[admin]\ntitle = \"{title}\""));
    let relay = Relay::start(&titled("Dairy <b>north</b>"), site.admin(), None);
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("h1", "Dairy <b>north</b>");
    assert_eq!(browser.run("return document.title"), "Dairy <b>north</b>");
    browser.expect("#process", "pnet-nat ");
    relay.reload_to(&titled("South"));
    browser.expect("h1", "South");
    relay.reload_to(&untitled);
    browser.expect("h1", "pnet-nat");
    assert_eq!(errors(&browser), [""; 0]);
}
