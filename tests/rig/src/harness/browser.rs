//! A headless Chromium. The tests control it over WebDriver (W3C) and ask it what it shows.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::{Process, eventually, left_out};

/// A browser with one window. It ends when it is dropped.
#[derive(Debug)]
pub struct Browser {
    session: String,
    /// The driver. It ends its browser when the session ends.
    _driver: Process,
}

impl Browser {
    /// Starts a browser. Where there is no chromedriver, says so and returns `None`.
    pub fn start() -> Option<Self> {
        if Command::new("chromedriver").arg("--version").output().is_err() {
            left_out("chromedriver, of the package chromium-driver");
            return None;
        }
        let mut command = Command::new("chromedriver");
        command.arg("--port=0");
        let driver = Process::start(command);
        let port = eventually("the driver tells its port", || {
            let stdout = driver.stdout();
            let (_, rest) = stdout.split_once("successfully on port ")?;
            Some(rest.split_once('.')?.0.to_owned())
        });
        // The tests run as root, and Chromium's own sandbox does not work for root. /dev/shm is
        // small in containers.
        let arguments = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage"];
        let capabilities = json!({ "alwaysMatch": {
            "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        } });
        let url = format!("http://127.0.0.1:{port}/session");
        let session = post(&url, &json!({ "capabilities": capabilities }));
        let session = format!("{url}/{}", session["sessionId"].as_str().unwrap());
        Some(Self { session, _driver: driver })
    }

    /// Loads a page.
    pub fn open(&self, url: &str) {
        self.say("url", json!({ "url": url }));
    }

    /// Sets the size of the window, whether it is a phone's, and the colour scheme.
    pub fn look(&self, width: u16, height: u16, is_phone: bool, scheme: &str) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1,
            "mobile": is_phone });
        self.devtools("Emulation.setDeviceMetricsOverride", &size);
        let scheme = json!({ "name": "prefers-color-scheme", "value": scheme });
        self.devtools("Emulation.setEmulatedMedia", &json!({ "features": [scheme] }));
    }

    /// Runs the body of a function in the page and returns its result.
    pub fn run(&self, body: &str) -> Value {
        self.say("execute/sync", json!({ "script": body, "args": [] }))
    }

    /// The visible text of the first element that matches. Empty if no element matches.
    pub fn text(&self, selector: &str) -> String {
        let text = self.run(&format!(
            "const found = document.querySelector(`{selector}`);
            return found?.checkVisibility() ? found.innerText : ''"
        ));
        text.as_str().unwrap().to_owned()
    }

    /// Waits until an element shows this text.
    #[track_caller]
    pub fn expect(&self, selector: &str, text: &str) {
        let mut shown = String::new();
        let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            eventually("the page shows it", || {
                shown = self.text(selector);
                shown.contains(text).then_some(())
            });
        }));
        assert!(found.is_ok(), "{selector} shows {shown:?}, not {text:?}");
    }

    /// Has what the API says replaced in part in all pages that are opened from now on: by path, the
    /// members that take the place of those of the answer.
    pub fn pretend(&self, answers: &Value) {
        let script = format!(
            "const pretended = {answers};
            const askTheRelay = window.fetch;
            window.fetch = async (path, options) => {{
                const answer = await askTheRelay(path, options);
                const members = pretended[new URL(path, location).pathname];
                if (!members) return answer;
                const all = answer.ok ? await answer.json() : {{}};
                return Response.json({{ ...all, ...members }});
            }};"
        );
        self.devtools("Page.addScriptToEvaluateOnNewDocument", &json!({ "source": script }));
    }

    /// Presses a key or types a text, wherever the focus is (WebDriver, 17.4.2).
    pub fn press(&self, keys: &str) {
        let press = |key: char| {
            let key = key.to_string();
            [json!({ "type": "keyDown", "value": key }), json!({ "type": "keyUp", "value": key })]
        };
        let actions: Vec<_> = keys.chars().flat_map(press).collect();
        let keyboard = json!({ "type": "key", "id": "keyboard", "actions": actions });
        self.say("actions", json!({ "actions": [keyboard] }));
    }

    /// The errors in the console since the last call.
    pub fn errors(&self) -> Vec<String> {
        let log = self.say("se/log", json!({ "type": "browser" }));
        let errors = log.as_array().unwrap().iter().filter(|line| line["level"] == "SEVERE");
        errors.map(|line| line["message"].as_str().unwrap().to_owned()).collect()
    }

    /// Writes a picture of the whole page to a file, for people to look at.
    pub fn screenshot(&self, path: &Path) {
        let whole = json!({ "captureBeyondViewport": true });
        let shot = self.devtools("Page.captureScreenshot", &whole);
        let script = format!(
            "return Array.from(atob('{}'), (c) => c.charCodeAt(0))",
            shot["data"].as_str().unwrap()
        );
        let octets: Vec<u8> = serde_json::from_value(self.run(&script)).unwrap();
        fs::write(path, octets).unwrap();
        println!("{}", path.display());
    }

    /// The faults that axe-core, an accessibility checker, finds in the page: rules, and the
    /// elements that break them. Where its file is not there, says so and returns `None`.
    pub fn accessibility_faults(&self, axe: &Path) -> Option<Vec<String>> {
        let Ok(axe) = fs::read_to_string(axe) else {
            left_out(&format!("axe-core in {}; see .ci/run", axe.display()));
            return None;
        };
        self.run(&axe);
        let script = "const done = arguments[0]; axe.run().then((result) => done(
            result.violations.flatMap(({ id, nodes }) => nodes.map((node) =>
                `${id}: ${node.html} ${node.failureSummary}`))), (error) => done([`${error}`]));";
        let faults = self.say("execute/async", json!({ "script": script, "args": [] }));
        Some(serde_json::from_value(faults).unwrap())
    }

    fn devtools(&self, command: &str, parameters: &Value) -> Value {
        self.say("goog/cdp/execute", json!({ "cmd": command, "params": parameters }))
    }

    fn say(&self, command: &str, parameters: Value) -> Value {
        post(&format!("{}/{command}", self.session), &parameters)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Without this call the browser would outlive its driver.
        let _ = ureq::delete(&self.session).call();
    }
}

fn post(url: &str, body: &Value) -> Value {
    let agent: ureq::Agent =
        ureq::Agent::config_builder().http_status_as_error(false).proxy(None).build().into();
    let mut answer = agent.post(url).send(body.to_string()).unwrap();
    let text = answer.body_mut().with_config().limit(64 << 20).read_to_string().unwrap();
    let mut answer: Value = serde_json::from_str(&text).expect(&text);
    let value = answer["value"].take();
    assert!(value["error"].is_null(), "{url}: {value}");
    value
}
