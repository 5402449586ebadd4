//! A Prometheus server that scrapes as `deploy/prometheus` says, to be asked over its HTTP API.

use std::collections::BTreeMap;
use std::fs;
use std::net::SocketAddr;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{PATIENCE, Process, Site, eventually, left_out};

const CONFIGURATION: &str = include_str!("../../../deploy/prometheus/prometheus.yml");
const RULES: &str = include_str!("../../../deploy/prometheus/pnet-nat.rules.yml");

/// Not the usual 9090: there the package's own server may listen, on all addresses.
const PORT: u16 = 19090;

/// Whether Prometheus is there; says so where it is not.
pub(super) fn has_prometheus() -> bool {
    let is_there = |tool: &&str| Command::new(tool).arg("--version").output().is_ok();
    let has = ["prometheus", "promtool"].iter().all(is_there);
    if !has {
        left_out("prometheus and promtool, of the package prometheus");
    }
    has
}

/// A sample of an answer: its labels and its value.
pub(super) type Sample = (BTreeMap<String, String>, f64);

/// A running server.
#[derive(Debug)]
pub(super) struct Prometheus {
    process: Process,
    address: SocketAddr,
    _folder: TempDir,
}

impl Prometheus {
    /// Starts one beside a site's relay. It scrapes each second, and calls a node silent after 5 s and
    /// configurations different after 1 s, since nobody waits for minutes.
    pub(super) fn start(site: &Site) -> Self {
        Self::start_with(site, &[])
    }

    /// Starts one after these changes to its configuration, with the file `token` beside it.
    pub(super) fn start_with(site: &Site, changes: &[(&str, &str)]) -> Self {
        let admin = site.admin().to_string();
        let usual = [("127.0.0.1:9378", admin.as_str()), ("_interval: 15s", "_interval: 1s")];
        let mut configuration = CONFIGURATION.to_owned();
        for (from, to) in usual.iter().chain(changes) {
            assert!(configuration.contains(from), "{from}");
            configuration = configuration.replace(from, to);
        }
        let rules = RULES.replace("offset 5m", "offset 5s").replace("for: 15m", "for: 1s");
        let folder = tempfile::tempdir().unwrap();
        for (file, text) in [
            ("prometheus.yml", configuration.as_str()),
            ("pnet-nat.rules.yml", &rules),
            ("token", "s3cr3t-0123456789"),
        ] {
            fs::write(folder.path().join(file), text).unwrap();
        }
        let address = SocketAddr::from((site.public_address(), PORT));
        let mut command = Command::new("prometheus");
        command
            .current_dir(folder.path())
            .args(["--config.file=prometheus.yml", "--storage.tsdb.path=data"])
            .arg(format!("--web.listen-address={address}"));
        let mut server = Self { process: Process::start(command), address, _folder: folder };
        eventually("Prometheus is ready", || {
            assert!(!server.process.has_ended(), "{}", server.process.stderr());
            server.get("/-/ready", &[]).ok()
        });
        server
    }

    /// What a query finds now, or what is wrong with it.
    pub(super) fn query(&self, query: &str) -> Result<Vec<Sample>, String> {
        let answer = self.get("/api/v1/query", &[("query", query)])?;
        let answer: Value = serde_json::from_str(&answer).map_err(|error| error.to_string())?;
        if answer["status"] != "success" {
            return Err(answer["error"].to_string());
        }
        let samples = answer["data"]["result"].as_array().ok_or("no samples")?;
        Ok(samples.iter().map(sample).collect())
    }

    /// The one value that a query finds; none where it finds nothing.
    #[track_caller]
    pub(super) fn value(&self, query: &str) -> Option<f64> {
        let found = self.query(query).unwrap_or_else(|error| panic!("{query}: {error}"));
        assert!(found.len() <= 1, "{query}: {found:?}");
        found.first().map(|(_, value)| *value)
    }

    /// Waits until a query finds something, be it not a number, and tells what.
    #[track_caller]
    pub(super) fn eventually(&self, query: &str) -> Vec<Sample> {
        eventually(&format!("there is an answer to {query}"), || {
            let found = self.query(query).unwrap_or_else(|error| panic!("{query}: {error}"));
            found.iter().any(|(_, value)| !value.is_nan()).then_some(found)
        })
    }

    /// The body of an answer; an error's too, where it is the API's.
    fn get(&self, path: &str, parameters: &[(&str, &str)]) -> Result<String, String> {
        let agent: ureq::Agent = ureq::Agent::config_builder()
            .http_status_as_error(path.starts_with("/-/"))
            .timeout_global(Some(PATIENCE))
            .build()
            .into();
        let mut request = agent.get(format!("http://{}{path}", self.address));
        for &(name, value) in parameters {
            request = request.query(name, value);
        }
        let mut answer = request.call().map_err(|error| error.to_string())?;
        answer.body_mut().read_to_string().map_err(|error| error.to_string())
    }
}

fn sample(sample: &Value) -> Sample {
    let labels = sample["metric"].as_object().unwrap().iter();
    let labels = labels.map(|(name, value)| (name.clone(), value.as_str().unwrap().to_owned()));
    (labels.collect(), sample["value"][1].as_str().unwrap().parse().unwrap())
}
