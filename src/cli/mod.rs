//! The command line: a file for each command.
//!
//! Exit codes: 0 done, 1 failed at run time, 2 bad command line or configuration, 75 not started for a
//! reason that may go away by itself.

mod admin_server;
mod check;
mod decode;
mod demo;
mod documentation;
mod flows;
mod healthcheck;
mod init;
mod inventory;
mod node;
mod output;
mod password;
mod probe;
mod progress;
mod reload;
mod request;
mod run;
mod screen;
mod signals;
mod status;
mod translate;
mod values;

use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;

use anyhow::anyhow;
use clap::{Parser, Subcommand};

use crate::config::{self, Config, Faults, Passwords, Source, Warning};
use crate::logging::{self, LogFormat, LogLevel, complain};
use crate::pnet::ip_net_table::IpNetTable;
use crate::pnet::wire::Password;

/// The NAT router of P-NET on IP (IEC PAS 62412): lets remote clients reach the server nodes of a
/// plant, checks every datagram and its password, and counts everything.
#[derive(Parser)]
#[command(name = "pnet-nat", version = env!("PNET_NAT_VERSION"), propagate_version = true)]
#[command(after_help = "To try it without any set-up:  pnet-nat demo\n\
    To set it up:  pnet-nat init\n\
    Exit codes: 0 done, 1 failed at run time, 2 bad command line or configuration, 75 not started \
    for a reason that may go away by itself, such as a port in use: try again later.")]
struct Cli {
    /// Format of the log on stderr: text, json, or auto (text on a terminal, otherwise JSON).
    #[arg(
        long,
        global = true,
        env = "PNET_NAT_LOG_FORMAT",
        value_name = "FORMAT",
        value_enum,
        default_value_t,
        hide_possible_values = true,
        help_heading = LOGGING
    )]
    log_format: LogFormat,
    /// What is logged: error, warn or info; info includes the audit log [default: info for run, warn
    /// for other commands].
    #[arg(
        long,
        global = true,
        env = "PNET_NAT_LOG_LEVEL",
        value_name = "LEVEL",
        value_enum,
        ignore_case = true,
        hide_possible_values = true,
        help_heading = LOGGING
    )]
    log_level: Option<LogLevel>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Init(init::Args),
    Run(run::Args),
    Check(check::Args),
    Password(password::Args),
    Demo(demo::Args),
    Node(node::Args),
    Request(request::Args),
    Translate(translate::Args),
    Decode(decode::Args),
    Inventory(inventory::Args),
    Status(status::Args),
    Flows(flows::Args),
    Probe(probe::Args),
    Reload(reload::Args),
    Healthcheck(healthcheck::Args),
    Completions(documentation::Completions),
    Man(documentation::Man),
}

/// Bad command line or configuration.
const BAD_USE: u8 = 2;

/// Not started for a reason that may go away by itself (EX_TEMPFAIL of sysexits.h).
const TRY_AGAIN: u8 = 75;

/// What run and check say of a configuration without a file.
const WITHOUT_FILE: &str = "Without a file, PNET_NAT_SUBNET, PNET_NAT_NODES, PNET_NAT_ALLOW and others in \
    the environment configure a small relay; docs/container.md has them all.";

/// Heading of the options that every command has.
const LOGGING: &str = "Logging";

/// Runs the program.
pub fn main() -> ExitCode {
    signals::hold_back();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(said) => return told_by_clap(&said),
    };
    let service = matches!(cli.command, Command::Run(_));
    if !service {
        signals::let_hangup_through();
    }
    let usual = if service { LogLevel::Info } else { LogLevel::Warn };
    logging::init(cli.log_format, cli.log_level.unwrap_or(usual), service);
    // The exit code of these is a verdict, which must not be lost with the output.
    let judges = matches!(cli.command, Command::Demo(_) | Command::Request(_) | Command::Probe(_));
    let done = match cli.command {
        Command::Init(args) => init::run(args),
        Command::Run(args) => run::run(&args),
        Command::Check(args) => check::run(args),
        Command::Password(args) => password::run(&args),
        Command::Demo(args) => demo::run(args),
        Command::Node(args) => node::run(args),
        Command::Request(args) => request::run(args),
        Command::Translate(args) => translate::run(&args),
        Command::Decode(args) => decode::run(args),
        Command::Inventory(args) => inventory::run(&args),
        Command::Status(args) => status::run(args),
        Command::Flows(args) => flows::run(&args),
        Command::Probe(args) => probe::run(&args),
        Command::Reload(args) => reload::run(&args),
        Command::Healthcheck(args) => healthcheck::run(args),
        Command::Completions(args) => documentation::completions(&args),
        Command::Man(args) => documentation::man(&args),
    };
    let done = done.and_then(|code| match output::out().flush() {
        Err(error) if code == ExitCode::SUCCESS => Err(error.into()),
        _ => Ok(code),
    });
    let code = done.unwrap_or_else(|error| failed(&error, judges));
    logging::flush();
    code
}

/// Tells why a command failed and returns its exit code.
fn failed(error: &anyhow::Error, judges: bool) -> ExitCode {
    if is_broken_pipe(error) {
        // The reader of the output has seen enough, as with `| head`.
        return if judges { ExitCode::FAILURE } else { ExitCode::SUCCESS };
    }
    complain(format_args!("pnet-nat: {error:#}"));
    ExitCode::FAILURE
}

/// Prints what clap has to say: a help text, or what is wrong with the command line.
fn told_by_clap(said: &clap::Error) -> ExitCode {
    match said.print() {
        Err(error) if !said.use_stderr() => failed(&output::Out::error(error).into(), false),
        _ => ExitCode::from(u8::try_from(said.exit_code()).unwrap_or(BAD_USE)),
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let mut io_errors = error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>());
    io_errors.any(|error| error.kind() == ErrorKind::BrokenPipe)
}

/// Where the configuration is; otherwise says why that is not clear, and returns the exit code.
fn source(config: Option<&Path>) -> Result<Source, ExitCode> {
    Source::choose(config).map_err(|two| {
        complain(format_args!("pnet-nat: {two}"));
        ExitCode::from(BAD_USE)
    })
}

/// Reads a configuration; otherwise prints its faults and returns the exit code.
fn load(source: &Source) -> Result<(Config, Vec<Warning>), ExitCode> {
    told(source.load())
}

/// What was read; otherwise prints the faults and returns the exit code.
fn told<T>(read: Result<T, Faults>) -> Result<T, ExitCode> {
    read.map_err(|faults| {
        logging::complain_of_faults(&faults);
        exit_code_of(&faults)
    })
}

fn exit_code_of(faults: &Faults) -> ExitCode {
    ExitCode::from(if faults.pass() { TRY_AGAIN } else { BAD_USE })
}

/// Reads a client's IPNetTable with its passwords, and prints the warnings; otherwise prints its faults
/// and returns the exit code.
fn load_ip_net_table(path: &Path) -> Result<(IpNetTable, Passwords), ExitCode> {
    let (found, warnings) = told(config::load_ip_net_table(path))?;
    for warning in warnings {
        complain(format_args!("warning: {warning}"));
    }
    Ok(found)
}

/// The value parser of options that name a password file.
fn password_file(path: &str) -> anyhow::Result<Password> {
    config::read_password(path.into()).map_err(|error| anyhow!("{error}; {}", error.remedy()))
}
