//! The status page in a real browser.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::harness::{
    Browser, Process, Relay, Settings, Site, WRONG, datagram, eventually, folder, pnet_nat, request,
};

pub(crate) const ENTER: &str = "\u{e007}";

/// The accessibility checker axe-core, at the place where `.ci/run` puts it.
pub(crate) const AXE: &str =
    concat!(env!("CARGO_TARGET_TMPDIR"), "/axe/axe_playwright_python/axe.min.js");
const SCREENSHOTS: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/status-page");

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

/// Of a relay whose clients may be anywhere on loopback, and whose buffers are soon full.
pub(crate) fn configuration(site: &Site) -> String {
    let configuration = site.configuration(&Settings::default());
    let configuration =
        configuration.replace("[admin]", "[datapath]\nreceive_buffer = 4096\n\n[admin]");
    // Its own clients stand among the nodes, which has to be said by name.
    let own = format!("\"{}/24\"", site.address(0));
    configuration.replace(&format!("[{own}]"), &format!("[\"127.0.0.0/8\", {own}]"))
}

pub(crate) fn relay(site: &Site) -> Relay {
    Relay::start(&configuration(site), site.admin(), None)
}

pub(crate) fn state_of(node_address: u8) -> String {
    format!("[data-net=section-1] [data-node=\"{node_address}\"] td")
}

/// The errors in the console.
pub(crate) fn errors(browser: &Browser) -> Vec<String> {
    browser.errors()
}

/// Confinement, flows in the kernel, and a reload that fails.
fn the_relay_itself_is_shown(browser: &Browser, relay: &Relay) {
    let status: Value = serde_json::from_str(&relay.get("/api/v1/status").unwrap().1).unwrap();
    let layers = status["sandbox"].as_array().unwrap();
    assert_eq!(layers.len(), 5);
    for layer in layers {
        let [layer, state] = ["layer", "state"].map(|key| layer[key].as_str().unwrap());
        browser.expect("#relay", &format!("{layer} {state}"));
    }
    match status["offload"]["why"].as_str() {
        Some(why) => browser.expect("#relay", &format!("no: {why}")),
        None => browser.expect("#relay", "4 of 4 flows, at lo"),
    }
    browser.expect("#relay", "successful; the configuration in force is ");
    let file = relay.folder.path().join("pnet-nat.toml");
    let right = fs::read_to_string(&file).unwrap();
    relay.configure(&right.replace("start_port", "start_prot"));
    relay.reload();
    browser.expect("#banner.bad", "The last reload failed, and the configuration before it");
    browser.expect("#relay", "failed; the configuration in force is ");
    relay.reload_to(&right);
    browser.expect("#banner.good", "All 4 nodes that clients asked answer.");
}

#[test]
fn a_reload_puts_nodes_and_nets_where_they_belong() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let relay = relay(&site);
    browser.look(1280, 2400, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    let expect_nodes = |expected: &[u8]| {
        eventually(&format!("the nodes are {expected:?}"), || {
            let rows = "[data-net=section-1] [data-node]";
            let nodes = browser.run(&format!(
                "return Array.from(document.querySelectorAll('{rows}'), (row) => +row.dataset.node)"
            ));
            (nodes == json!(expected)).then_some(())
        });
    };
    expect_nodes(&[1, 2, 3, 4, 33]);
    let configuration = configuration(&site);
    let (general, net) = configuration.split_once("[[udp_range_net]]").unwrap();
    let port = format!("start_port = {}", site.start_port());
    let first = net.replace("section-1", "section-0").replace("secrets/section-0", "secrets/press");
    let first = first.replace(&port, &format!("start_port = {}", site.start_port() + 200));
    let first = first.replace("\"1-4\", 33", "50");
    let more = net.replace("\"1-4\", 33", "\"2-6\", 33");
    relay.reload_to(&format!("{general}[[udp_range_net]]{first}[[udp_range_net]]{more}"));
    expect_nodes(&[2, 3, 4, 5, 6, 33]);
    let nets = browser.run(
        "return Array.from(document.querySelectorAll('[data-net]'), (net) => net.dataset.net)",
    );
    assert_eq!(nets, json!(["section-0", "section-1"]));
    relay.reload_to(&configuration);
    expect_nodes(&[1, 2, 3, 4, 33]);
    let mut errors = errors(&browser);
    // It may have been on its way when the reload took the net.
    errors.retain(|error| !error.contains("/api/v1/history?net=section-0 "));
    assert_eq!(errors, [""; 0]);
}

/// While a tab is hidden, nobody asks.
#[test]
fn a_rate_is_not_of_the_time_before_a_pause() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let _relay = relay(&site);
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    let rates = browser.run(
        "const rate = new Rate();
        return [[0, 0], [2, 20], [3600, 60], [3602, 64]].map(([time, count]) => rate.add(time, count))",
    );
    assert_eq!(rates, json!([null, 10, null, 2]));
    let times = browser.run(
        "const times = new Times();
        const answers = (first, second) => [
            { up_to_seconds: 0.5, answers: first, sum_seconds: 0.45 * first },
            { up_to_seconds: null, answers: second, sum_seconds: 12 * second },
        ].filter(({ answers }) => answers);
        times.add(answers(0, 0), 0);
        times.add(answers(4, 0), 2);
        times.add(answers(4, 1000), 3600);
        return times.quantile(0.5)",
    );
    let times = times.as_f64().unwrap();
    assert!(
        (times - 0.45).abs() < 1e-9,
        "{times}: what was answered in the meantime is not of now"
    );
}

/// A node whose answers take 5.24 ms, and another net's that take 26.5 ms: each as it is, and so of
/// all together.
#[test]
fn response_times_have_no_more_digits_than_are_true() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let _relay = relay(&site);
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    let shown = browser.run(
        "const node = { up_to_seconds: 0.0056, answers: 400, sum_seconds: 400 * 0.00524 };
        const other = { up_to_seconds: 0.028, answers: 500, sum_seconds: 500 * 0.0265 };
        const shown = (...times) => {
            const all = new Times();
            all.add(times, 0);
            return [0.5, 0.99].map((share) => duration(all.quantile(share)));
        };
        return [shown(node), shown(node, node, node), shown(node, other), shown()]",
    );
    let one = ["5.2 ms", "5.2 ms"];
    assert_eq!(shown, json!([one, one, ["27 ms", "27 ms"], ["–", "–"]]));
}

/// A client whose requests are refused is no reason for a green page.
#[test]
fn refused_requests_are_seen_with_their_cause() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let relay = site.relay(Settings { net: "max_flows = 9", ..Settings::default() });
    let other = Site::claim();
    browser.look(1280, 2400, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner.good", "No client has had an answer yet.");
    for _ in 0..3 {
        other.client().send(site.public(3), &request(3));
    }
    relay.expect_drops(&[("request", "source_not_allowed", 3)]);
    browser.expect("#banner.doubtful", "3 requests refused: source_not_allowed");
    browser.expect(&state_of(3), "3 requests refused: source_not_allowed");
    browser.expect(&state_of(4), "never asked");
    expect_no_accessibility_faults(&browser, "refused");

    let (node, client) = (site.node(4), site.client());
    client.send(site.public(4), &request(4));
    let (asked, router) = node.receive();
    node.send(router, &asked);
    client.receive();
    let whole = request(4);
    let (package, _) = whole.split_at(whole.len() - 8);
    client.send(site.public(4), package);
    client.send(site.public(4), &request(3));
    other.client().send(site.public(4), &datagram(&[0x99; 8], &[2, 0], WRONG)); // a scanner
    site.client().send(site.public(4), &[package, WRONG].concat());
    browser.expect("#banner.doubtful", "6 requests refused: ");
    for told in [
        "is not in allow of section-1",
        "sends no password to node 4 of section-1",
        "names another node on the port of node 4 of section-1",
        "sends a wrong password to node 4 of section-1",
        "sends to node 4 of section-1",
    ] {
        browser.expect("#refused tbody", told);
    }
    assert_eq!(errors(&browser), [""; 0]);
}

/// A PROFINET device has no node address.
#[test]
fn a_device_is_called_by_its_name() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let (device, port) = (site.address(40), site.start_port() + 150);
    let configuration = configuration(&site).replace("[admin]\n", "[admin]\nprobe = true\n");
    let allow = format!("[\"127.0.0.0/8\", \"{}/24\"]", site.address(0));
    let _relay = Relay::start(
        &format!(
            "{configuration}\n[[profinet_device]]\nname = \"drive-7\"\npublic_port = {port}\n\
             address = \"{device}\"\nallow = {allow}\n"
        ),
        site.admin(),
        None,
    );
    browser.look(1280, 2400, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    let public = format!("{}:{port}", site.public_address());
    // There is no device.
    let asking = ["inventory", &public, "--timeout", "100ms", "--retries", "0"];
    assert_eq!(pnet_nat(&asking).output().unwrap().status.code(), Some(1));
    site.client().send(public.parse().unwrap(), &request(1));

    browser.expect("#silent-links button", "drive-7");
    assert_eq!(browser.text("#silent-links"), "drive-7");
    browser.expect("[data-net=drive-7] [data-node] th", &format!("–\nProbe\n{port} → {device}"));
    let label = "return document.querySelector('[data-net=drive-7] [data-node] button').ariaLabel";
    assert_eq!(browser.run(label), "Probe drive-7");
    browser.expect("#refused tbody", "sends to drive-7");
    browser.run("document.getElementById('connected').open = true");
    let nodes = "#clients tbody td:nth-of-type(2)";
    browser.expect(nodes, "–");
    assert_eq!(browser.text(nodes), "–");
    assert_eq!(errors(&browser), [""; 0]);
}

#[track_caller]
pub(crate) fn expect_no_accessibility_faults(browser: &Browser, state: &str) {
    assert_eq!(
        browser.accessibility_faults(Path::new(AXE)).unwrap_or_default(),
        [""; 0],
        "{state}"
    );
}

pub(crate) fn screenshot(browser: &Browser, name: &str) {
    fs::create_dir_all(SCREENSHOTS).unwrap();
    let path = Path::new(SCREENSHOTS).join(format!("{name}.png"));
    browser.screenshot(&path);
}

fn the_answering_ones_are_folded_on_a_phone(browser: &Browser) {
    let shown = || {
        browser.run(
            "return [...document.querySelectorAll('[data-node]')]
                .filter((row) => row.checkVisibility()).map((row) => +row.dataset.node)",
        )
    };
    assert_eq!(shown(), json!([1, 2, 3, 4, 33]));
    browser.look(390, 900, true, "light");
    assert_eq!(shown(), json!([33]));
    let fold = "document.querySelector('.fold')";
    browser.expect(".fold", "4 answering");
    expect_no_accessibility_faults(browser, "folded");
    browser.run(&format!("{fold}.focus()"));
    browser.press(ENTER);
    assert_eq!(shown(), json!([1, 2, 3, 4, 33]));
    assert_eq!(browser.run(&format!("return {fold}.ariaExpanded")), "true");
    browser.look(1280, 900, false, "light");
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
    the_answering_ones_are_folded_on_a_phone(&browser);
    eventually("rate and response times are there", || {
        let figures = browser.text("[data-node=\"1\"]");
        (figures.contains("/s") && figures.matches(" ms").count() >= 2).then_some(())
    });
    let figure = |column, unit| {
        let text = browser.text(&format!("[data-node=\"1\"] td:nth-of-type({column})"));
        text.strip_suffix(unit).expect(&text).parse::<f64>().unwrap()
    };
    let median = figure(5, " ms");
    assert!((2.0..=50.0).contains(&median), "{median} ms, and the nodes wait 2 ms");
    assert!(figure(3, " /s") > 0.0 && figure(4, " /s") > 0.0);
    browser.expect("#tiles .tile:nth-child(4)", "Flows\n\n4\n\nof 65,536 at most");
    eventually("every plot has a line", || {
        let lines = browser.run(
            "return Array.from(document.querySelectorAll('.plot path'), (path) =>
                path.getAttribute('d').split('L').length)",
        );
        let points = lines.as_array().unwrap().iter().map(|points| points.as_u64().unwrap());
        (lines.as_array().unwrap().len() == 7 && points.min() > Some(1)).then_some(())
    });
    the_relay_itself_is_shown(&browser, &relay);

    let wrong = request(4);
    let wrong = [&wrong[..wrong.len() - WRONG.len()], WRONG].concat();
    let stranger = site.client();
    for _ in 0..3 {
        stranger.send(site.public(4), &wrong);
    }
    stranger.send(site.public(4), &datagram(&[0x99; 8], &[2, 0], WRONG));
    browser.expect("#drops", "someone who guesses");
    browser.expect("#tiles .tile:last-child", "3\n\nfrom 1 address");
    browser.expect("[data-node=\"4\"] td:last-child", "4\nbad_length: 1, password_wrong: 3");
    relay.process.hold();
    (0..200).for_each(|_| stranger.send(site.public(4), &wrong));
    relay.process.go_on();
    browser.expect("#drops", "kernel: overflow");
    browser.expect(
        "#drops",
        "Lost before the relay saw it: the receive buffer of a public port was full.",
    );

    nodes.remove(2);
    browser.expect(&state_of(3), "silent");
    browser.expect("#banner", "1 node is silent:\n\nsection-1, node 3");
    assert_eq!(browser.run("return document.title"), "1 silent · requests refused · pnet-nat");
    let of_silent = browser.text("[data-node=\"3\"]");
    assert!(of_silent.contains("last answer "), "{of_silent}");
    assert_eq!(browser.text("#help li"), "", "it is closed");
    browser.run("document.querySelector('#silent-help').click()");
    browser.expect("#help", "Does it take the password?");
    expect_no_accessibility_faults(&browser, "help");
    browser.run("document.querySelector('#help').open = false");
    for (name, width, is_phone, scheme) in [
        ("light", 1280, false, "light"),
        ("dark", 1280, false, "dark"),
        ("phone-light", 390, true, "light"),
        ("phone-dark", 390, true, "dark"),
    ] {
        browser.look(width, 2400, is_phone, scheme); // what is out of sight is not drawn
        screenshot(&browser, name);
        let wide = browser.run("return document.documentElement.scrollWidth");
        assert!(wide.as_u64() <= Some(width.into()), "{name}: {wide} wide");
        let hidden = browser.run(
            "return Array.from(document.querySelectorAll('.net td, #drops td')).filter((cell) => {
                // What was never asked has no figures.
                if (innerWidth < 500 && cell.closest('[data-state=never_asked]')) return false;
                const { right } = cell.getBoundingClientRect();
                return !cell.checkVisibility() || right > innerWidth;
            }).length",
        );
        assert_eq!(hidden, 0, "{name}: figures that one does not see");
        expect_no_accessibility_faults(&browser, name);
    }

    nodes.push(simulated_node(&site, 3));
    browser.expect("#banner", "All 4 nodes that clients asked answer.");
    assert_eq!(errors(&browser), [""; 0]);

    drop(relay);
    browser.expect("#banner", "The relay has not answered since");
    assert_eq!(browser.run("return document.querySelectorAll('.stale').length"), 1);
    for scheme in ["light", "dark"] {
        browser.look(1280, 2400, false, scheme);
        screenshot(&browser, &format!("stale-{scheme}"));
        expect_no_accessibility_faults(&browser, "stale");
    }
}
