//! The command line: one file a command.
//!
//! Exit codes: 0 done, 1 failed at run time, 2 bad command line or configuration, 75 not started, but
//! another try may succeed.

mod admin_server;
mod check;
mod decode;
mod demo;
mod documentation;
mod healthcheck;
mod node;
mod output;
mod reload;
mod request;
mod run;
mod signals;
mod status;

use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;

use anyhow::anyhow;
use clap::{Parser, Subcommand};

use crate::config::{self, Config, Faults, Warning};
use crate::logging::{self, LogFormat, LogLevel, complain};
use crate::pnet::wire::Password;

/// The NAT router of P-NET on IP (IEC PAS 62412): lets remote clients reach the server nodes of a
/// plant, checks every datagram and its password, and counts everything.
#[derive(Parser)]
#[command(name = "pnet-nat", version = env!("PNET_NAT_VERSION"), propagate_version = true)]
#[command(after_help = "Try it with nothing set up:  pnet-nat demo\n\
    Exit codes: 0 done, 1 failed at run time, 2 bad command line or configuration, 75 not started \
    because of something that may pass by itself, such as a port in use: try again.")]
struct Cli {
    /// How log lines are written to stderr: text, json, or auto: text on a terminal, else JSON.
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
    /// What is logged: error, warn or info, which has the audit log [default: info for run, warn
    /// elsewhere].
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
    Run(run::Args),
    Check(check::Args),
    Demo(demo::Args),
    Node(node::Args),
    Request(request::Args),
    Decode(decode::Args),
    Status(status::Args),
    Reload(reload::Args),
    Healthcheck(healthcheck::Args),
    Completions(documentation::Completions),
    Man(documentation::Man),
}

/// Bad command line or configuration.
const BAD_USE: u8 = 2;

/// Not started because of something that may pass by itself (EX_TEMPFAIL of sysexits.h).
const TRY_AGAIN: u8 = 75;

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
    // Their exit code judges what was not seen to its end.
    let judges = matches!(cli.command, Command::Demo(_) | Command::Request(_));
    let done = match cli.command {
        Command::Run(args) => run::run(&args),
        Command::Check(args) => check::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Node(args) => node::run(args),
        Command::Request(args) => request::run(args),
        Command::Decode(args) => decode::run(args),
        Command::Status(args) => status::run(args),
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

/// Tells why a command failed, and what to exit with.
fn failed(error: &anyhow::Error, judges: bool) -> ExitCode {
    if is_broken_pipe(error) {
        // Whoever reads the output has seen enough of it.
        return if judges { ExitCode::FAILURE } else { ExitCode::SUCCESS };
    }
    complain(format_args!("pnet-nat: {error:#}"));
    ExitCode::FAILURE
}

/// Tells what was asked of the command line itself, such as its help, or what is wrong with it.
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

/// Reads a configuration, or tells all of its faults and what to exit with.
fn load(path: &Path) -> Result<(Config, Vec<Warning>), ExitCode> {
    told(config::load(path))
}

/// What was read, or what to exit with once all faults are told.
fn told<T>(read: Result<T, Faults>) -> Result<T, ExitCode> {
    read.map_err(|faults| {
        let code = if faults.pass() { TRY_AGAIN } else { BAD_USE };
        logging::complain_of_faults(&faults);
        ExitCode::from(code)
    })
}

/// The password in a file: a value parser of options.
fn password_file(path: &str) -> anyhow::Result<Password> {
    config::read_password(path.into()).map_err(|error| anyhow!("{error}; {}", error.remedy()))
}
