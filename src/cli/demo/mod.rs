//! `pnet-nat demo`: the whole picture in one process on loopback, with nothing to set up.
//!
//! `plant` sets up the server nodes and the relay's configuration, `traffic` is the remote client and the
//! stranger, `figures` collects and checks, `table` shows. Here they are started and stopped. Invariant:
//! the exit code is 0 only if `figures` finds no fault.

mod figures;
mod plant;
mod table;
mod traffic;

use std::cell::Cell;
use std::future;
use std::net::Ipv4Addr;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use tokio::sync::oneshot;

use super::signals::Signals;
use crate::admin::{self, Listeners};
use crate::config::AdminPlace;
use crate::datapath::Router;
use crate::listen;
use crate::logging;
use crate::observe::Observer;
use crate::sandbox::Sandbox;

use figures::Figures;
use plant::Plant;
use table::Display;
use traffic::Traffic;

/// Show four simulated server nodes, the relay, a remote client and a stranger, all on loopback.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat demo --seconds 10\n\
    At the end, or at Ctrl-C, it prints a summary. It exits 0 only if every answer was right.")]
pub(super) struct Args {
    /// End after this many seconds; otherwise it ends at Ctrl-C.
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u64).range(1..),
        env = "PNET_NAT_SECONDS"
    )]
    seconds: Option<u64>,
}

/// Runs the demo; the exit code is 0 only if every answer was right and the stranger got none.
pub(super) fn run(args: Args) -> anyhow::Result<ExitCode> {
    logging::in_background()?;
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(demo(args))
}

async fn demo(args: Args) -> anyhow::Result<ExitCode> {
    let plant = Plant::build().await?;
    let listen = |port| listen::tcp((Ipv4Addr::LOCALHOST, port).into(), "the demo's address");
    let usual = AdminPlace::default().listen.port();
    let admin = listen(usual).or_else(|_| listen(0))?;
    let admin_address = admin.local_addr()?;
    let router = Router::start(plant.config(admin_address)).context("the relay does not start")?;
    let router = Arc::new(router);
    let (stop_admin, admin_stopped) = oneshot::channel::<()>();
    let admin_stopped = async { _ = admin_stopped.await };
    let admin = Listeners::from_std(Some(admin), None)?;
    let serving =
        admin::serve(admin, Arc::clone(&router), None, Sandbox::off("in the demo"), admin_stopped);
    let admin = tokio::spawn(serving);

    let mut observer = Observer::new(Arc::clone(&router));
    let observing = tokio::spawn(async move { observer.run(None).await });

    let traffic = Traffic::new(&plant);
    let started = Instant::now();
    let figures = || Figures::take(started.elapsed(), &plant, &router, &traffic);
    let mut display = Display::open(admin_address)?;
    let ended = Cell::new(false);
    let showing = async {
        let end = end(args.seconds)?;
        tokio::pin!(end);
        while !ended.get() {
            display.show(&figures())?;
            tokio::select! {
                () = &mut end => ended.set(true),
                () = tokio::time::sleep(display.interval()) => {}
            }
        }
        Ok(())
    };
    tokio::try_join!(traffic.poll(&ended), traffic.intrude(&ended), showing)?;

    // The nodes still answer while the relay stops; after that the figures are final.
    router.shut_down().await;
    let figures = figures();
    let faults = figures.faults();
    display.close(&figures, &faults)?;
    observing.abort();
    let _ = stop_admin.send(());
    admin.await?;
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Resolves after this many seconds, at SIGINT or at SIGTERM.
fn end(seconds: Option<u64>) -> anyhow::Result<impl Future<Output = ()>> {
    let mut signals = Signals::new()?;
    Ok(async move {
        let time_over = async {
            match seconds {
                Some(seconds) => tokio::time::sleep(Duration::from_secs(seconds)).await,
                None => future::pending().await,
            }
        };
        tokio::select! {
            () = time_over => {}
            _ = signals.next() => {}
        }
    })
}
