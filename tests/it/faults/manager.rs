//! The service manager's socket: one with an abstract name, and one that nobody listens at.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use crate::harness::{PATIENCE, Relay, Settings, Site, eventually, pnet_nat};

/// The confinement lets nobody connect to such a socket any more, and the manager hears all the same.
#[test]
fn a_manager_with_an_abstract_name_hears_everything() {
    let site = Site::claim();
    let name = format!("pnet-nat-{}", site.public_address());
    let address = SocketAddr::from_abstract_name(&name).unwrap();
    let manager = UnixDatagram::bind_addr(&address).unwrap();
    manager.set_read_timeout(Some(PATIENCE)).unwrap();
    let relay = start(&site, &format!("@{name}"));
    let hears = |what: &str| {
        eventually(what, || {
            let mut message = [0; 1024];
            let length = manager.recv(&mut message).unwrap();
            String::from_utf8_lossy(&message[..length]).contains(what).then_some(())
        });
    };
    hears("READY=1");
    hears("WATCHDOG=1");
    relay.reload();
    hears("RELOADING=1");
    hears("READY=1");
    hears("WATCHDOG=1");
    let log = relay.finish();
    assert_eq!(log.logged("the service manager cannot be told").len(), 0);
}

/// Told once, however often the watchdog would have to be pinged.
#[test]
fn a_manager_that_is_not_there_is_told_of_once() {
    let site = Site::claim();
    let relay = start(&site, "@pnet-nat-nobody");
    for _ in 0..3 {
        relay.reload();
    }
    let process = relay.finish();
    assert_eq!(process.logged("the service manager cannot be told").len(), 1);
}

fn start(site: &Site, socket: &str) -> Relay {
    let configuration = site.configuration(&Settings::default());
    Relay::start_as(&configuration, site.admin(), |arguments| {
        let mut command = pnet_nat(arguments);
        command.env("NOTIFY_SOCKET", socket).env("WATCHDOG_USEC", "400000");
        command
    })
}
