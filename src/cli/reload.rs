//! `pnet-nat reload`: makes a running relay read its configuration again, and prints the outcome that the
//! relay reports.

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use axum::http::Method;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use tokio::time::sleep;

use super::BAD_USE;
use super::admin_server::{self, AdminServer};
use super::output::out;
use crate::config::{self, Fault, USUAL_FILE};
use crate::harmless::harmless_lines;
use crate::logging::{complain, complain_of_faults};

/// How long one answer may take. The reload itself may take longer.
const ANSWER_TIME: Duration = Duration::from_secs(5);
/// How long to wait before asking again whether the reload is over.
const PAUSE: Duration = Duration::from_millis(50);

/// The lists of what a reload changes, and how each is called.
const CHANGES: [(&str, &str); 10] = [
    ("settings_changed", "settings changed"),
    ("nets_added", "nets added"),
    ("nets_removed", "nets removed"),
    ("nets_changed", "nets changed"),
    ("mappings_added", "nodes added"),
    ("mappings_removed", "nodes removed"),
    ("mappings_changed", "nodes changed"),
    ("credentials_added", "passwords added"),
    ("credentials_withdrawn", "passwords withdrawn"),
    ("credentials_changed", "passwords changed"),
];

/// Make a running relay read its configuration again, and wait for the outcome.
///
/// A file that has faults is not given to the relay. Whether the password files are right is the relay's
/// to say, since often only its user may read them. The relay is asked over its control socket, or over its
/// admin server where [admin] reload = true. With --pid it gets SIGHUP, and is asked for the outcome only.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat reload\n\
    \x20         pnet-nat reload --config /etc/pnet-nat-2/pnet-nat.toml\n\
    Exit codes: 0 all of the configuration is in force; 1 it is not, or the outcome is not known; 2 the \
    file has faults, and the relay was not asked.")]
pub(super) struct Args {
    /// Process ID of the relay.
    #[arg(long, value_name = "PID", env = "PNET_NAT_PID")]
    pid: Option<i32>,

    #[command(flatten)]
    relay: admin_server::Options,

    /// How long to wait for the outcome.
    #[arg(
        long,
        env = "PNET_NAT_RELOAD_TIMEOUT",
        value_name = "TIME",
        default_value = "60s",
        value_parser = humantime::parse_duration
    )]
    timeout: Duration,
}

/// Reloads once.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if has_faults(args) {
        return Ok(ExitCode::from(BAD_USE));
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let verdict = runtime.block_on(async {
        let relay = Relay::of(args);
        match args.pid {
            Some(pid) => signal(pid, relay, args.timeout).await,
            None => relay?.post(args.timeout).await,
        }
    })?;
    let shown = out().write_all(harmless_lines(&verdict.text).as_bytes());
    if !verdict.successful {
        return Ok(ExitCode::FAILURE); // even if the reason cannot be written
    }
    shown?;
    Ok(ExitCode::SUCCESS)
}

/// Whether the file has faults that the relay would find as well; prints them. What depends on who reads
/// the file, or on the host, is left to the relay.
fn has_faults(args: &Args) -> bool {
    let admin_server::Options { target, files } = &args.relay;
    let file = match (&files.config, target) {
        (Some(file), _) => file.as_path(),
        (None, None) => Path::new(USUAL_FILE),
        (None, Some(_)) => return false,
    };
    let Ok(text) = config::read_text(file) else { return false };
    let Err(faults) = config::parse(&text, file) else { return false };
    let of_the_text = |fault: &Fault| !fault.passes && !fault.key.ends_with("file");
    if !faults.0.iter().any(of_the_text) {
        return false;
    }
    complain_of_faults(&faults);
    complain("pnet-nat: the relay was not asked, and goes on with the configuration in force");
    true
}

/// The outcome of a reload.
struct Verdict {
    successful: bool,
    text: String,
}

/// Sends SIGHUP and waits for the end of a reload that began afterwards.
async fn signal(pid: i32, relay: anyhow::Result<Relay>, time: Duration) -> anyhow::Result<Verdict> {
    let before = async {
        let relay = relay?;
        let begun = number(&relay.state().await?, "begun")?;
        anyhow::Ok((relay, begun))
    };
    let before = before.await;
    // Even if nobody can report the outcome: a password that is withdrawn must not stay in force.
    kill(Pid::from_raw(pid), Signal::SIGHUP).with_context(|| {
        format!("process {pid} cannot be signalled; is it the relay, and are you its user or root?")
    })?;
    let told = "the outcome is not known; SIGHUP was sent, see the log of the relay";
    let (relay, before) = before.context(told)?;
    let end = Instant::now() + time;
    while Instant::now() < end {
        sleep(PAUSE).await;
        // It may be slow to answer while the reload runs.
        let Ok(state) = relay.state().await else { continue };
        if number(&state, "number")? > before {
            return Ok(Verdict::of(&state));
        }
    }
    bail!("the reload took more than {}: {told}", humantime::format_duration(time))
}

fn number(state: &Value, key: &str) -> anyhow::Result<u64> {
    state[key].as_u64().context("this relay does not number its reloads; is it an older version?")
}

impl Verdict {
    /// From the state of the last reload.
    fn of(state: &Value) -> Self {
        let mut text = String::new();
        match state["error"].as_str() {
            Some(error) => {
                text += &format!("reload failed, the configuration in force stays: {error}\n");
            }
            None => text += &changes(&state["changes"], &state["flows_closed"]),
        }
        for fault in state["faults"].as_array().into_iter().flatten() {
            text += &format!("{}\n", fault.as_str().unwrap_or_default());
        }
        Self::with_items(text, state, state["successful"] == true)
    }

    /// From the answer to a `POST` that brought a configuration into force.
    fn of_answer(answer: &Value, successful: bool) -> Self {
        Self::with_items(changes(answer, &answer["flows_closed"]), answer, successful)
    }

    fn with_items(mut text: String, state: &Value, successful: bool) -> Self {
        text += &items(state);
        if successful {
            text += "all of the configuration is in force\n";
        }
        Self { successful, text }
    }
}

/// A line for each kind of change, and one for the flows that were closed.
fn changes(changes: &Value, flows_closed: &Value) -> String {
    let Some(changes) = changes.as_object() else {
        return String::new(); // an older relay does not tell
    };
    let mut text = String::new();
    for (key, name) in CHANGES {
        let items = changes.get(key).and_then(Value::as_array).into_iter().flatten();
        let items: Vec<_> = items.filter_map(Value::as_str).collect();
        if !items.is_empty() {
            // An item of nodes has commas itself.
            text += &format!("{name}: {}\n", items.join("; "));
        }
    }
    if text.is_empty() {
        text += "nothing changed\n";
    }
    match flows_closed.as_u64() {
        None | Some(0) => {}
        Some(1) => text += "1 flow closed\n",
        Some(flows) => text += &format!("{flows} flows closed\n"),
    }
    text
}

/// A line for each item that is not in force.
fn items(state: &Value) -> String {
    let items = state["not_in_force"].as_array().into_iter().flatten();
    let line = |item: &Value| {
        let text = |key: &str| item[key].as_str().unwrap_or_default().to_owned();
        format!("not in force: {}: {}\n", text("what"), text("why"))
    };
    items.map(line).collect()
}

/// The relay to reload.
struct Relay(AdminServer);

impl Relay {
    fn of(args: &Args) -> anyhow::Result<Self> {
        AdminServer::new(&args.relay, ANSWER_TIME).map(Self)
    }

    /// The relay's last reload, as its API has it.
    async fn state(&self) -> anyhow::Result<Value> {
        self.0.get("/api/v1/status").await?.remove("reload").with_context(|| self.0.no_api())
    }

    /// Asks for a reload and waits for the outcome.
    async fn post(&self, time: Duration) -> anyhow::Result<Verdict> {
        let (status, text) = self.0.ask(Method::POST, "/-/reload", time).await?;
        let url = &self.0.url;
        match status.as_u16() {
            status @ (200 | 409) => {
                let answer = serde_json::from_str(&text).with_context(|| self.0.no_api())?;
                Ok(Verdict::of_answer(&answer, status == 200))
            }
            422 => Ok(Verdict { successful: false, text: format!("reload failed\n{text}") }),
            403 => bail!("{url}: {}; or use --pid", text.trim_end()),
            status => bail!("{url} answered {status}: {}", text.trim_end()),
        }
    }
}
