//! The tools of the scenarios: a relay as a process, simulated servers and clients as sockets, and
//! octets written by hand.
//!
//! To wait for something, a scenario polls for it, always with the same time limit. Invariant:
//! whatever was started ends with its owner, even when the test fails.

mod browser;
mod capture;
mod io_device;
mod machine;
mod metrics;
mod network;
mod octets;
mod pcap;
mod process;
mod profinet;
mod relay;
mod site;
mod somebody;
mod terminal;
mod yaml;

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

pub use browser::Browser;
pub use capture::{Capture, Packet};
pub use io_device::{DEVICE_ID, IDENTIFICATION, IoDevice, PNIO_PORT, Received};
pub use machine::Machine;
pub use metrics::Metrics;
pub use network::{Namespace, Network};
pub use octets::{
    DEVICE, FIGURE_10, PASSWORD, PASSWORDS, SECOND, WRONG, datagram, request, response,
};
pub use pcap::{frame, header, pcap, udp};
pub use process::{Process, pnet_nat, pnet_nat_within, resident};
pub use profinet::{has_profinet_peers, profinet_peer};
pub use relay::{ANNOTATED, Place, Relay, Settings, folder, on_the_path};
pub use site::{Peer, Site, close, exchange};
pub use somebody::Somebody;
pub use terminal::Terminal;
pub use yaml::{TOOLS, feed, has_yaml, yaml};

/// How long a step may take that should take no time. A busy machine is not a fault.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// Calls `probe` until it finds something, and returns that.
pub fn eventually<T>(what: &str, mut probe: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = probe() {
            return found;
        }
        assert!(Instant::now() < end, "not within {PATIENCE:?}: {what}");
        pause(Duration::from_millis(5));
    }
}

/// Lets time pass. A test needs this only to see that nothing happens.
#[expect(clippy::disallowed_methods, reason = "the one place where tests sleep")]
pub fn pause(time: Duration) {
    std::thread::sleep(time);
}

/// Sets the flag when it is dropped. So threads that wait for the flag end even when the test
/// fails.
#[derive(Debug)]
pub struct Over<'a>(pub &'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

/// Says that a scenario is left out because something is missing. Fails where all scenarios have to
/// run.
pub fn left_out(want: &str) {
    let all = ["all", "nightly"].contains(&tests_wanted().as_str());
    assert!(!all, "PNET_NAT_TESTS={}, and there is a want: {want}", tests_wanted());
    println!("left out: {want}");
}

/// Whether nft can control the kernel's packet filter. Says so if it cannot.
pub fn has_nft() -> bool {
    let has = std::process::Command::new("nft").arg("--version").output().is_ok();
    if !has {
        left_out("nft, of the package nftables");
    }
    has
}

/// Whether tests that take minutes have to run as well. Says so if not.
pub fn nightly() -> bool {
    let nightly = tests_wanted() == "nightly";
    if !nightly {
        println!("left out: it takes minutes; PNET_NAT_TESTS=nightly runs it, beside all others");
    }
    nightly
}

fn tests_wanted() -> String {
    std::env::var("PNET_NAT_TESTS").unwrap_or_default()
}
