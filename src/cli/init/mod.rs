//! `pnet-nat init`: a first configuration with its password and the client's sheet.
//!
//! `answers` asks or takes the options, `host` has what this host offers, `files` writes. Invariant: nothing
//! that is there is changed.

mod answers;
mod files;
mod host;

use std::io::{IsTerminal, Write, stdin, stdout};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::bail;
use clap::builder::BoolishValueParser;
use ipnet::IpNet;
use nix::unistd::geteuid;

use super::output::out;
use super::{BAD_USE, check, complain};
use crate::config::{NodeRange, shell_quoted};
use crate::pnet::wire::LAST_START_PORT;
use answers::{Allowed, Answers, By, Name, Nodes, Subnet};
use files::Files;

/// Make a first configuration: asks what it needs, or takes it from options.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat init --listen 203.0.113.5 --subnet 172.17.17.0 --nodes 1-4,33 \\\n\
    \x20                       --allow 198.51.100.0/24 /etc/pnet-nat\n\
    \x20         pnet-nat init --try\n\
    It writes pnet-nat.toml, secrets/NAME with 8 random characters, and client-sheet.html, checks the \
    configuration, and prints the next commands. It never changes a file that is there."
)]
pub(super) struct Args {
    /// Folder for the files; it is made if it is not there. [default: /etc/pnet-nat for root, otherwise
    /// ./pnet-nat; with --try, ./pnet-nat-try]
    #[arg(value_name = "FOLDER")]
    folder: Option<PathBuf>,

    /// A try-out on this machine alone, with simulated nodes: nothing is asked.
    #[arg(
        long = "try",
        conflicts_with_all = ["listen", "subnet", "nodes", "allow"],
        env = "PNET_NAT_TRY",
        value_parser = BoolishValueParser::new()
    )]
    try_out: bool,

    /// Addresses of this host that clients send to, separated by commas; 0.0.0.0 stands for all.
    #[arg(long, value_name = "ADDRESS", value_delimiter = ',', env = "PNET_NAT_LISTEN")]
    listen: Option<Vec<IpAddr>>,

    /// Subnet of the nodes, such as 172.17.17.0: node 3 is 172.17.17.3.
    #[arg(long, value_name = "ADDRESS", env = "PNET_NAT_SUBNET")]
    subnet: Option<Subnet>,

    /// Nodes that clients need, such as 1-4,33. The others cannot be reached.
    #[arg(long, value_name = "NODE[-LAST]", value_delimiter = ',', env = "PNET_NAT_NODES")]
    nodes: Option<Vec<NodeRange>>,

    /// Networks or addresses that clients send from, separated by commas.
    #[arg(long, value_name = "NETWORK", value_delimiter = ',', env = "PNET_NAT_ALLOW")]
    allow: Option<Vec<Allowed>>,

    /// Start port: node 3 is reached at this port + 3. [default: the first of 20000, 20200 and so on that is free
    /// and that Linux does not lend to other programs]
    #[arg(
        long,
        value_name = "PORT",
        value_parser = clap::value_parser!(u16).range(1..=i64::from(LAST_START_PORT)),
        env = "PNET_NAT_START_PORT"
    )]
    start_port: Option<u16>,

    /// Name of the plant section in metrics, logs and on the status page. [default: section-1]
    #[arg(long, value_name = "NAME", env = "PNET_NAT_NAME")]
    name: Option<Name>,

    /// Ask nothing: take what would be offered for each option that is left out. For --nodes and --allow,
    /// nothing is.
    #[arg(long, env = "PNET_NAT_YES", value_parser = BoolishValueParser::new())]
    yes: bool,
}

/// What the configuration says.
#[derive(Debug)]
struct Plan {
    listen: Vec<IpAddr>,
    subnet: Subnet,
    nodes: Nodes,
    allow: Vec<IpNet>,
    start_port: u16,
    name: Name,
    /// The port of the admin server, where it is not the usual one.
    admin_port: Option<u16>,
}

/// The exit code is that of `check`, or 2 when something is missing or there already.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    let try_out = args.try_out;
    let files = Files::of(&args.folder.clone().unwrap_or_else(|| default_folder(try_out)));
    if let Some(there) = files.already_there() {
        return Ok(refuse_to_overwrite(there));
    }
    let Some(plan) = plan(args)? else { return Ok(ExitCode::from(BAD_USE)) };
    let files = files.with_secret(&plan.name);
    if let Some(there) = files.already_there() {
        return Ok(refuse_to_overwrite(there));
    }
    files.write(&plan)?;
    let mut out = out();
    writeln!(out, "Written, in {}:\n\n{files}", shell_quoted(&files.folder))?;
    let config = shell_quoted(&files.config);
    let checked = match check::judged(&files.config) {
        Ok(checked) => checked,
        Err(code) => {
            complain(format_args!(
                "pnet-nat: the files are written. Correct {config}, then run: pnet-nat check --config {config}"
            ));
            return Ok(code);
        }
    };
    writeln!(
        out,
        "The configuration has no faults. The NAT table:\n\n{}\n\n{}",
        check::nat_table(&checked, false),
        next(&plan, &files, try_out)
    )?;
    Ok(ExitCode::SUCCESS)
}

fn default_folder(try_out: bool) -> PathBuf {
    match (try_out, geteuid().is_root()) {
        (true, _) => "pnet-nat-try",
        (false, true) => "/etc/pnet-nat",
        (false, false) => "pnet-nat",
    }
    .into()
}

fn refuse_to_overwrite(there: &Path) -> ExitCode {
    let path = shell_quoted(there);
    complain(format_args!(
        "pnet-nat: {path} is there already, and init changes no file. Name another folder, or move it away: \
         mv {path} {path}.before"
    ));
    ExitCode::from(BAD_USE)
}

/// What is asked, said or found; none when something is missing, which was told.
fn plan(args: Args) -> anyhow::Result<Option<Plan>> {
    if args.try_out {
        return Ok(Some(try_out(args)));
    }
    let by = match stdin().is_terminal() && stdout().is_terminal() {
        _ if args.yes => By::Consent,
        true => By::Asking,
        false => By::Default,
    };
    let mut answers = Answers::new(stdin().lock(), out(), by);
    let plan = answers.plan(args)?;
    let missing = answers.missing();
    if !missing.is_empty() {
        let options = missing.join(", ");
        let why = if by == By::Consent {
            "nothing fits for them"
        } else {
            "there is no terminal to ask at"
        };
        complain(format_args!(
            "pnet-nat: these options are missing, and {why}: {options}. See pnet-nat init --help; pnet-nat \
             init --try needs none"
        ));
        return Ok(None);
    }
    match plan {
        Some(plan) => Ok(Some(plan)),
        None => bail!("the input ended before all was answered; nothing was written"),
    }
}

/// All on loopback. Every address that begins with 127 is this machine's.
fn try_out(args: Args) -> Plan {
    let listen = vec![IpAddr::from([127, 0, 0, 1])];
    let nodes = Nodes::of(&[NodeRange(1..=4)]);
    Plan {
        start_port: args.start_port.unwrap_or_else(|| host::free_block(&listen, &nodes)),
        subnet: host::free_loopback_subnet(),
        nodes,
        allow: vec![IpNet::new_assert([127, 0, 0, 0].into(), 8)],
        name: args.name.unwrap_or_default(),
        admin_port: host::admin_port(),
        listen,
    }
}

/// The commands that come next, each on a line that can be pasted.
fn next(plan: &Plan, files: &Files, try_out: bool) -> String {
    let (config, secret) = (shell_quoted(&files.config), shell_quoted(&files.secret));
    let to = plan.listen.iter().find(|address| !address.is_unspecified()).copied();
    let to =
        to.or_else(|| host::Host::this().public()).map_or("ROUTER".into(), |it| it.to_string());
    let (start_port, nodes, subnet) = (plan.start_port, &plan.nodes, plan.subnet);
    let request = format!(
        "pnet-nat request --to {to} --start-port {start_port} --node {nodes} --password-file {secret}"
    );
    let test = match try_out {
        true => format!(
            "Then, in another terminal, a client's requests to simulated nodes:\n\n  \
             (pnet-nat node --listen {} --password-file {secret} > /dev/null & trap 'kill $!' EXIT; {request} \
             --retries 5)\n",
            subnet.of_nodes(nodes)
        ),
        false => format!(
            "Then, at a client that `allow` names, which has the 8 octets in a file of mode 600:\n\n  {request}\n"
        ),
    };
    let port = plan.admin_port.unwrap_or(host::ADMIN_PORT);
    let url =
        plan.admin_port.map_or(String::new(), |port| format!(" --target http://127.0.0.1:{port}"));
    format!(
        "Next:\n\n  pnet-nat run --config {config}\n\n{test}\n\
         Who answers and what is dropped: http://127.0.0.1:{port}/, or `pnet-nat status{url}`."
    )
}
