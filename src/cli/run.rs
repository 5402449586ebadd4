//! `pnet-nat run`: the relay, until a signal ends it.

use std::future;
use std::io;
use std::net::TcpListener;
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Notify;
use tokio::time::timeout;

use super::signals::{Signals, let_hangup_through};
use super::{BAD_USE, TRY_AGAIN, WITHOUT_FILE, complain, load, source, told};
use crate::admin::control::{self, ControlError, ControlFile};
use crate::admin::{self, Listeners};
use crate::config::{Admin, Config, KernelFlows, Source, Warning};
use crate::datapath::{Bound, OffloadState, Router, StartError};
use crate::listen::{self, ListenError};
use crate::logging;
use crate::observe::{DropReport, Observer};
use crate::reload::Reloader;
use crate::sandbox::{self, Sandbox, User};
use crate::service;
use crate::thread::ThreadError;

/// How long to wait for an IPv6 address that is tentative: for a second or two the kernel asks whether
/// another machine has it.
const ADDRESS_TIME: Duration = Duration::from_secs(5);
/// How long to wait between two tries.
const ADDRESS_LOOK: Duration = Duration::from_millis(100);

/// Relay between clients on the Internet and the server nodes of a plant.
///
/// SIGTERM or SIGINT stops it: it says that it is not ready, goes on for as long as `[runtime] pre_drain`
/// says, takes no more requests, waits for answers that are still due, and exits
/// 0. A second signal stops it at once. On SIGHUP it reads its configuration again.
#[derive(clap::Args)]
#[command(after_help = format!(
    "Example:  pnet-nat run --config /etc/pnet-nat/pnet-nat.toml\n{WITHOUT_FILE}"
))]
pub(super) struct Args {
    /// The configuration file; config/pnet-nat.toml explains every key [default:
    /// /etc/pnet-nat/pnet-nat.toml].
    #[arg(short, long, value_name = "FILE", env = "PNET_NAT_CONFIG")]
    config: Option<PathBuf>,
    /// Run without confinement: for debugging, and to find out whether the confinement causes a fault.
    #[arg(
        long,
        env = "PNET_NAT_NO_SANDBOX",
        value_parser = clap::builder::BoolishValueParser::new()
    )]
    no_sandbox: bool,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    // Starts no thread yet. From here on SIGHUP is handled.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let hangup = {
        let _context = runtime.enter();
        signal(SignalKind::hangup())?
    };
    let_hangup_through();
    service::connect();
    let prepared = (!args.no_sandbox).then(sandbox::prepare);
    let source = match source(args.config.as_deref()) {
        Ok(source) => source,
        Err(code) => return Ok(code),
    };
    let (config, warnings, user) = match read(&source, prepared.is_some()) {
        Ok(sound) => sound,
        Err(code) => return Ok(code),
    };
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    let files = config.files.clone();
    let control = config.control.clone().or_else(control::of_the_service);
    let (router, admin) = match bind(config) {
        Ok(bound) => bound,
        Err(error) => return Ok(refuse(error)),
    };
    if let Some(user) = user {
        user.become_for_good()?;
    }
    // Made now, so that it belongs to this user, who may then remove it.
    let control = match control.as_deref().map(ControlFile::bind).transpose() {
        Ok(control) => control,
        Err(error) => return Ok(refuse(error)),
    };
    // Every thread inherits the confinement, since this is still the only one.
    let sandbox = prepared.map_or_else(
        || Sandbox::off("--no-sandbox"),
        |prepared| prepared.confine(&files, router.has_offload()),
    );
    sandbox.announce();
    let start_threads = || -> anyhow::Result<_> {
        logging::in_background()?;
        let router = Arc::new(router.start()?);
        let reloader = Reloader::start(source, Arc::clone(&router))?;
        Ok((router, reloader))
    };
    let (router, reloader) = match start_threads() {
        Ok(started) => started,
        Err(error) => return Ok(refuse(error)),
    };
    relay(runtime, hangup, router, Sockets { admin, control }, reloader, sandbox)
}

/// The configuration, its warnings, and the user to become, if there is one. Then the configuration is read
/// with that user's rights.
fn read(
    source: &Source,
    becomes_user: bool,
) -> Result<(Config, Vec<Warning>, Option<User>), ExitCode> {
    let Some(name) = told(source.user())?.filter(|_| becomes_user) else {
        let (config, warnings) = load(source)?;
        return Ok((config, warnings, None));
    };
    let user = User::find(&name).map_err(refuse)?;
    // Each reload will read it with these rights.
    let (config, warnings) = user.act(|| load(source)).map_err(refuse)??;
    Ok((config, warnings, Some(user)))
}

/// Tells why the relay does not start; the exit code says whether another try may succeed.
fn refuse(error: impl Into<anyhow::Error>) -> ExitCode {
    let error = error.into();
    complain(format_args!("pnet-nat: {error:#}"));
    ExitCode::from(if may_pass(&error) { TRY_AGAIN } else { BAD_USE })
}

fn may_pass(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let start = cause.downcast_ref::<StartError>().map(StartError::may_pass);
        let listen = || cause.downcast_ref::<ListenError>().map(ListenError::may_pass);
        let thread = || cause.is::<ThreadError>().then_some(true);
        let control = || cause.downcast_ref::<ControlError>().map(ControlError::may_pass);
        let system = || cause.downcast_ref::<io::Error>().map(listen::may_pass);
        start.or_else(listen).or_else(control).or_else(thread).or_else(system).unwrap_or(false)
    })
}

/// Binds all sockets or none. Waits for addresses that are still tentative.
#[expect(
    clippy::disallowed_methods,
    reason = "nothing reports when an address is no longer tentative"
)]
fn bind(config: Config) -> anyhow::Result<(Bound, Option<TcpListener>)> {
    let end = Instant::now() + ADDRESS_TIME;
    let mut told = false;
    loop {
        match try_to_bind(config.clone()) {
            Err(error) if passes_soon(&error) && Instant::now() < end => {
                if !told {
                    tracing::warn!("{error:#}: waiting for it");
                }
                told = true;
                thread::sleep(ADDRESS_LOOK);
            }
            outcome => return outcome,
        }
    }
}

fn passes_soon(error: &anyhow::Error) -> bool {
    let start = error.downcast_ref::<StartError>().is_some_and(StartError::passes_soon);
    start || error.downcast_ref::<ListenError>().is_some_and(ListenError::passes_soon)
}

fn try_to_bind(config: Config) -> anyhow::Result<(Bound, Option<TcpListener>)> {
    let listen = |admin: &Admin| listen::tcp(admin.listen, "[admin] listen");
    let admin = config.admin.as_ref().map(listen).transpose();
    let admin = admin.context("the admin server cannot start; see [admin] listen")?;
    Ok((Router::bind(config)?, admin))
}

/// What the admin server listens on.
struct Sockets {
    admin: Option<TcpListener>,
    control: Option<(UnixListener, ControlFile)>,
}

fn relay(
    runtime: Runtime,
    mut hangup: Signal,
    router: Arc<Router>,
    Sockets { admin, control }: Sockets,
    reloader: Reloader,
    sandbox: Sandbox,
) -> anyhow::Result<ExitCode> {
    runtime.block_on(async {
        let mut signals = Signals::new()?;
        let mut noise = DropReport::new(Arc::clone(&router));
        let mut observer = Observer::new(Arc::clone(&router));
        let stopped = Arc::new(Notify::new());
        let (control, control_file) = control.unzip();
        let serving = (admin.is_some() || control.is_some()).then(|| {
            let listeners = Listeners::from_std(admin, control)?;
            let (router, reloader) = (Arc::clone(&router), reloader.clone());
            let stopped = Arc::clone(&stopped);
            io::Result::Ok(tokio::spawn(async move {
                let reloader = Some(reloader);
                admin::serve(listeners, router, reloader, sandbox, stopped.notified()).await;
            }))
        });
        let serving = serving.transpose()?;
        announce(&router, control_file.as_ref());
        service::ready(&router);
        let reloading = async {
            // Any number of signals during the start or a reload cause one more reload.
            while hangup.recv().await.is_some() {
                // The reload logs its outcome.
                let _ = reloader.reload().await;
            }
            future::pending().await
        };
        let leaving = async {
            let name = signals.next().await;
            tracing::info!(signal = name, "stopping");
            service::stopping();
            // A second signal ends this.
            timeout(router.announce_end(), signals.next()).await.ok()
        };
        let again = tokio::select! {
            again = leaving => again,
            never = observer.run(Some(&mut noise)) => never,
            never = reloading => never,
            never = service::watchdog(Arc::clone(&router)) => never,
        };
        let stopped_at_once = match again {
            Some(name) => Some(name),
            None => tokio::select! {
                () = router.shut_down() => None,
                name = signals.next() => Some(name),
            },
        };
        if let Some(signal) = stopped_at_once {
            tracing::warn!(signal, "stopping at once");
            return Ok(ExitCode::FAILURE);
        }
        noise.report_rest();
        stopped.notify_one();
        if let Some(serving) = serving {
            serving.await?;
        }
        tracing::info!("stopped");
        Ok(ExitCode::SUCCESS)
    })
}

fn announce(router: &Router, control: Option<&ControlFile>) {
    let active = router.active_config();
    let config = &active.config;
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        listen = logging::list(&config.listen),
        nets = config.table.nets().len(),
        public_ports = config.table.mappings().len(),
        workers = active.workers,
        admin = config.admin.as_ref().map(|admin| tracing::field::display(admin.listen)),
        control = control.map(|control| tracing::field::display(control.path().display())),
        "relaying"
    );
    // Whoever has switched it off knows it.
    if config.datapath.kernel != KernelFlows::Off {
        announce_kernel(router.offload());
    }
}

fn announce_kernel(state: OffloadState) {
    match state.why_not {
        None => {
            let interfaces = logging::list(state.interfaces);
            tracing::info!(interfaces, "the kernel carries open flows");
        }
        Some(why) => tracing::info!(why, "open flows stay on the sockets"),
    }
}
