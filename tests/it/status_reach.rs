//! How one gets around the status page: by the banner, by keyboard, with a token, among 8,000 nodes.

use std::time::Duration;

use serde_json::json;

use crate::harness::{Browser, Relay, Settings, Site, eventually, pause, request};
use crate::scale::large_relay;
use crate::status_page::{
    ENTER, configuration, errors, expect_no_accessibility_faults, relay, screenshot, state_of,
};

const ESCAPE: &str = "\u{e00c}";
const TAB: &str = "\u{e004}";

/// From the banner to a node among many, however its net stands.
#[test]
fn the_banner_leads_to_the_node_itself() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let configuration = configuration(&site).replace("\"1-4\", 33", "\"1-125\"");
    let _relay = Relay::start(&configuration, site.admin(), None);
    browser.look(1280, 700, false, "light");
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    let client = site.client();
    for node in [80, 81] {
        client.send(site.public(node), &request(node));
    }
    browser.expect("#banner", "2 nodes are silent:\n\nsection-1, node 80");
    eventually("the silent ones come first", || {
        let first = browser.run(
            "return [...document.querySelectorAll('[data-node]')].slice(0, 4).map((row) => row.dataset.node)",
        );
        (first == json!(["80", "81", "1", "2"])).then_some(())
    });
    for (button, node, is_open) in [(1, 80, true), (2, 81, true), (2, 81, false), (1, 80, false)] {
        browser.run(&format!(
            "scrollTo(0, 0);
            const net = document.querySelector('[data-net=section-1]');
            if (!{is_open}) net.open = false;"
        ));
        if !is_open {
            eventually("the net is folded up", || {
                let rows = browser.run("return document.querySelectorAll('[data-node]').length");
                (rows == 0).then_some(())
            });
        }
        browser.run(&format!(
            "document.querySelector('#banner button:nth-of-type({button})').focus()"
        ));
        browser.press(ENTER);
        eventually(&format!("node {node} is in sight and has the focus"), || {
            let there = browser.run(&format!(
                "const row = document.querySelector('[data-node=\"{node}\"]');
                const {{ top, bottom }} = row?.getBoundingClientRect() ?? {{ top: -1, bottom: -1 }};
                return top >= 0 && bottom <= innerHeight && document.activeElement === row"
            ));
            (there == true).then_some(())
        });
    }
    assert_eq!(errors(&browser), [""; 0]);
}

#[test]
fn all_of_it_can_be_reached_by_keyboard() {
    let Some(browser) = Browser::start() else { return };
    let site = Site::claim();
    let _relay = relay(&site);
    browser.open(&format!("http://{}/", site.admin()));
    browser.expect("#banner", "No client has had an answer yet.");
    site.client().send(site.public(3), &request(3));
    browser.expect("#banner", "1 node is silent:\n\nsection-1, node 3");
    let wanted = browser.run(
        "window.wanted = [...document.querySelectorAll(
            'a, button, input:not([type=radio]:not(:checked)), summary, [tabindex]')]
            .filter((element) => element.checkVisibility());
        window.reached = new Set();
        return wanted.map((element) => element.tagName)",
    );
    for tag in ["A", "BUTTON", "SUMMARY", "DIV"] {
        assert!(wanted.as_array().unwrap().contains(&tag.into()), "{tag}: {wanted}");
    }
    for _ in wanted.as_array().unwrap() {
        browser.press(TAB);
        browser.run("reached.add(document.activeElement)");
    }
    let missed = browser
        .run("return wanted.filter((element) => !reached.has(element)).map((e) => e.outerHTML)");
    assert_eq!(missed, json!([]));

    let is_open = || browser.run("return document.querySelector('[data-net]').open");
    let focused = || browser.run("return document.activeElement.parentElement.dataset.net");
    eventually("the net has the focus", || {
        browser.press(TAB);
        (focused() == "section-1").then_some(())
    });
    assert_eq!(is_open(), true);
    browser.press(ENTER);
    assert_eq!(is_open(), false);
    browser.press(ENTER);
    browser.expect(&state_of(33), "never asked");
    assert_eq!(errors(&browser), [""; 0]);
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
    screenshot(&browser, "token");
    expect_no_accessibility_faults(&browser, "token");
    assert_eq!(browser.text("#status"), "", "nothing is shown without it");
    browser.press(&format!("0123456789abcdef{ENTER}"));
    browser.expect("#token-error", "This is not the token.");
    browser.run("document.dispatchEvent(new Event('visibilitychange'))"); // to another tab, and back
    pause(Duration::from_millis(500));
    assert_eq!(browser.text("#token-error"), "This is not the token.");
    browser.press(&format!("s3cr3t-0123456789{ENTER}"));
    browser.expect("#banner", "No client has had an answer yet.");
    browser.open(&url);
    browser.expect("#banner", "No client has had an answer yet.");
    for (path, part) in [("metrics", "pnet_nat_build_info"), ("api/v1/config", "section-1")] {
        browser.run(&format!("document.querySelector('footer [href=\"{path}\"]').focus()"));
        browser.press(ENTER);
        browser.expect("#viewer-title", &format!("/{path}"));
        browser.expect("#viewer-text", part);
        browser.expect("#viewer-file", "Download");
        expect_no_accessibility_faults(&browser, path);
        screenshot(&browser, "viewer");
        browser.press(ESCAPE);
        assert_eq!(browser.text("#viewer"), "");
    }
    let kept = browser.run("return [localStorage.length, document.cookie, location.href]");
    assert_eq!(kept, json!([0, "", url]));
    for error in errors(&browser) {
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
    browser.run("scrollTo(0, 0); document.querySelector('#filter').focus()");
    browser.press("125");
    browser.expect("#filter-note", "64 nodes in 64 nets");
    let longest = browser.run("return Math.max(0, ...tasks)");
    println!("longest task: {longest} ms, rows drawn: {rows}");
    assert!(longest.as_f64() < Some(1000.0), "the page stood still for {longest} ms");
    assert_eq!(errors(&browser), [""; 0]);
}
