//! The status page in a real browser.

use crate::harness::{
    Browser, Process, Relay, Settings, Site, WRONG, datagram, eventually, folder, pnet_nat, request,
};
use crate::scale::large_relay;

const ENTER: &str = "\u{e007}";
const TAB: &str = "\u{e004}";

/// `pnet-nat node` for one node.
fn simulated_node(site: &Site, node_address: u8) -> Process {
    let folder = folder("");
    let password = folder.path().join("secrets/section-1");
    let listen = site.address(node_address).to_string();
    let arguments = [
        "node",
        "--listen",
        &listen,
        "--password-file",
        password.to_str().unwrap(),
        "--delay",
        "2ms",
    ];
    let node = Process::start(pnet_nat(&arguments));
    eventually("the node is there", || (node.stdout().lines().count() == 1).then_some(()));
    node
}

/// `pnet-nat request`, which polls the nodes 1 to 4 until it is dropped.
fn polling_client(site: &Site) -> Process {
    let folder = folder("");
    let password = folder.path().join("secrets/section-1");
    let (to, start_port) = (site.public_address().to_string(), site.start_port().to_string());
    let arguments = [
        &["request", "--to", &to, "--start-port", &start_port, "--node", "1-4"][..],
        &["--count", "100000", "--interval", "100ms", "--timeout", "200ms"],
        &["--password-file", password.to_str().unwrap()],
    ];
    let client = Process::start(pnet_nat(&arguments.concat()));
    eventually("it polls", || (client.stdout().lines().count() > 4).then_some(()));
    client
}

/// A relay whose clients may be anywhere on loopback.
fn relay(site: &Site) -> Relay {
    let configuration = site.configuration(&Settings::default());
    let allow = format!("allow = [\"{}/24\"]", site.address(0));
    Relay::start(&configuration.replace(&allow, "allow = [\"127.0.0.0/8\"]"), site.admin(), None)
}

fn state_of(node_address: u8) -> String {
    format!("[data-net=section-1] [data-node=\"{node_address}\"] td")
}

#[track_caller]
fn expect_no_accessibility_faults(browser: &Browser, state: &str) {
    assert_eq!(browser.accessibility_faults().unwrap_or_default(), [""; 0], "{state}");
}

#[test]
fn traffic_appears_and_a_node_that_dies_turns_silent() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let relay = relay(&site);
    browser.look(1280, 900, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    browser.expect(&state_of(1), "never asked");
    browser.expect("#drops-title ~ #no-drops", "Nothing was dropped.");

    let mut nodes: Vec<_> = (1..=4).map(|node| simulated_node(&site, node)).collect();
    let _client = polling_client(&site);
    browser.expect("#banner", "All 4 nodes that clients asked answer.");
    for node in 1..=4 {
        browser.expect(&state_of(node), "answering");
    }
    browser.expect(&state_of(33), "never asked");
    eventually("rate and response times are there", || {
        let figures = browser.text("[data-node=\"1\"]");
        (figures.contains("/s") && figures.matches(" ms").count() >= 2).then_some(())
    });
    let median = browser.text("[data-node=\"1\"] td:nth-of-type(4)");
    let median: f64 = median.strip_suffix(" ms").unwrap().parse().unwrap();
    assert!((2.0..=50.0).contains(&median), "{median} ms, and the nodes wait 2 ms");

    let wrong = request(4);
    let wrong = [&wrong[..wrong.len() - WRONG.len()], WRONG].concat();
    let stranger = site.client();
    for _ in 0..3 {
        stranger.send(site.public(4), &wrong);
    }
    stranger.send(site.public(4), &datagram(&[0x99; 8], &[2, 0], WRONG));
    browser.expect("#drops", "someone who guesses");
    browser.expect("#tiles .tile:last-child", "3\n\nfrom 1 address");

    nodes.remove(2);
    browser.expect(&state_of(3), "silent");
    browser.expect("#banner", "1 node is silent:\n\nsection-1, node 3");
    assert_eq!(browser.run("return document.title"), "1 silent · pnet-nat");
    for (name, width, is_phone, scheme) in [
        ("light", 1280, false, "light"),
        ("dark", 1280, false, "dark"),
        ("phone-light", 390, true, "light"),
        ("phone-dark", 390, true, "dark"),
    ] {
        browser.look(width, 2400, is_phone, scheme); // what is out of sight is not drawn
        browser.screenshot(name);
        let wide = browser.run("return document.documentElement.scrollWidth");
        assert!(wide.as_u64() <= Some(width.into()), "{name}: {wide} wide");
        expect_no_accessibility_faults(&browser, name);
    }

    nodes.push(simulated_node(&site, 3));
    browser.expect("#banner", "All 4 nodes that clients asked answer.");
    assert_eq!(browser.errors(), [""; 0]);

    browser.run("document.querySelector('#help').open = true");
    browser.expect("#help", "Does it take the password?");
    expect_no_accessibility_faults(&browser, "help");

    drop(relay);
    browser.expect("#banner", "The relay has not answered since");
    assert_eq!(browser.run("return document.querySelectorAll('.stale').length"), 1);
    for scheme in ["light", "dark"] {
        browser.look(1280, 2400, false, scheme);
        browser.screenshot(&format!("stale-{scheme}"));
        expect_no_accessibility_faults(&browser, "stale");
    }
}

#[test]
fn all_of_it_can_be_reached_by_keyboard() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let _relay = relay(&site);
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    let focused =
        || browser.run("return document.activeElement.closest('[data-net],#help')?.tagName");
    let is_open = || browser.run("return document.querySelector('[data-net]').open");
    eventually("the net has the focus", || {
        browser.press(TAB);
        (focused() == "DETAILS").then_some(())
    });
    assert_eq!(is_open(), true);
    browser.press(ENTER);
    assert_eq!(is_open(), false);
    browser.press(ENTER);
    browser.expect(&state_of(33), "never asked");
    assert_eq!(browser.errors(), [""; 0]);
}

#[test]
fn a_token_is_asked_for_and_kept_for_the_tab() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let admin = format!("listen = \"{}\"", site.admin());
    let configuration = site.configuration(&Settings::default());
    let with_token = format!("{admin}\ntoken_file = \"secrets/admin\"");
    let relay = Relay::start(&configuration.replace(&admin, &with_token), site.admin(), None);
    let url = format!("http://{}/", site.admin());
    browser.open(&url);
    browser.expect("#token-form", "Token");
    browser.look(390, 900, true, "dark");
    browser.screenshot("token");
    expect_no_accessibility_faults(&browser, "token");
    assert_eq!(browser.text("#status"), "", "nothing is shown without it");
    browser.press(&format!("0123456789abcdef{ENTER}"));
    browser.expect("#token-error", "This is not the token.");
    browser.press(&format!("s3cr3t-0123456789{ENTER}"));
    browser.expect("#banner", "No client has had an answer yet.");
    browser.open(&url);
    browser.expect("#banner", "No client has had an answer yet.");
    let kept = browser.run("return [localStorage.length, document.cookie, location.href]");
    assert_eq!(kept, serde_json::json!([0, "", url]));
    for error in browser.errors() {
        assert!(error.contains("401 (Unauthorized)"), "{error}");
    }
    drop(relay);
}

#[test]
fn eight_thousand_ports_do_not_hold_the_page_up() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let Some(_relay) = large_relay(&site) else { return };
    browser.look(1280, 900, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#tiles", "0 of 8,000");
    let watch = "window.tasks = []; new PerformanceObserver((list) =>
        tasks.push(...list.getEntries().map(({ duration }) => duration)))
        .observe({ type: 'longtask', buffered: true });
        const nets = document.querySelectorAll('[data-net]');
        for (const net of nets) net.open = true;
        return nets.length";
    assert_eq!(browser.run(watch), 64);
    browser.expect("[data-net] [data-node='125']", "125");
    let rows = browser.run("return document.querySelectorAll('[data-node]').length");
    assert!(rows.as_u64() < Some(8000 / 4), "{rows} rows, of which a screen has room for 20");
    let last = "document.querySelectorAll('[data-net]')[63]";
    eventually("what comes in sight is drawn", || {
        browser.run(&format!("{last}.scrollIntoView()"));
        let rows = browser.run(&format!("return {last}.querySelectorAll('[data-node]').length"));
        (rows == 125).then_some(())
    });
    let longest = browser.run("return Math.max(0, ...tasks)");
    println!("longest task: {longest} ms, rows drawn: {rows}");
    assert!(longest.as_f64() < Some(1000.0), "the page stood still for {longest} ms");
    assert_eq!(browser.errors(), [""; 0]);
}
