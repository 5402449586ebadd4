//! The socket of an inventory, and its progress line. What is asked is in `scan` and `conversation`.

use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Instant;

use anyhow::Context;
use tokio::net::UdpSocket;

use super::device::Device;
use super::scan::{Pace, Scan};
use crate::cli::progress::{ProgressLine, bar};
use crate::cli::signals::Signals;
use crate::peer::until;
use crate::profinet::Uuid;

/// Octets of the longest datagram.
const LONGEST: usize = 1 << 16;

/// Asks all targets, until each has answered or not, or a signal ends it. Also returns how many were
/// asked.
pub(super) async fn ask(
    targets: BTreeSet<SocketAddrV4>,
    pace: Pace,
) -> anyhow::Result<(Vec<Device>, usize)> {
    let mut signals = Signals::new()?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).await?;
    getrandom::u64().context("the system has no random numbers")?;
    let mut scan = Scan::new(targets, pace, Instant::now(), random);
    let mut progress = ProgressLine::new(true);
    let mut octets = vec![0; LONGEST];
    loop {
        while let Some((to, length)) = scan.transmit(Instant::now(), &mut octets) {
            // What the system refuses to send has no answer.
            let _ = socket.send_to(&octets[..length], to).await;
        }
        if scan.is_over() {
            break;
        }
        let due = scan.next_timeout();
        tokio::select! {
            biased;
            _ = signals.next() => break,
            came = socket.recv_from(&mut octets) => {
                // An error tells of a datagram that was sent before.
                if let Ok((length, SocketAddr::V4(from))) = came {
                    scan.receive(Instant::now(), from, &octets[..length]);
                }
            }
            () = until(due.map(Into::into)) => scan.handle_timeout(Instant::now()),
            () = until(progress.due().map(Into::into)) => {
                let (done, total, devices) = scan.progress();
                let share = done as f64 / total as f64;
                progress.draw(&format!("{}, {done} of {total} addresses, {devices} devices", bar(share)));
            }
        }
    }
    let (asked, ..) = scan.progress();
    Ok((scan.into_devices(), asked))
}

/// A random UUID (version 4).
fn random() -> Uuid {
    let mut octets = [0; 16];
    // It was asked for before, and does not fail later.
    let _ = getrandom::fill(&mut octets);
    octets[6] = octets[6] & 0x0F | 0x40;
    octets[8] = octets[8] & 0x3F | 0x80;
    Uuid::from_octets(octets)
}
