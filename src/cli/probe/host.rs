//! What this host says of itself: its interfaces, its routes, its files in /proc. Only read here; the
//! checks are elsewhere.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::net::IpAddr;
use std::path::Path;
use std::process::{Command, Stdio};

use ipnet::IpNet;
use nix::ifaddrs::{InterfaceAddress, getifaddrs};
use nix::net::if_::InterfaceFlags;
use nix::sys::socket::SockaddrStorage;

/// Where commands of the system are, beside those of `PATH`.
const FOLDERS: [&str; 4] = ["/usr/sbin", "/usr/bin", "/sbin", "/bin"];

/// An interface of this host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Interface {
    pub(super) name: String,
    /// It was switched on.
    pub(super) is_up: bool,
    /// Its cable is in.
    pub(super) has_link: bool,
    /// Its addresses, with the length of their networks.
    pub(super) addresses: Vec<IpNet>,
}

/// All interfaces.
pub(super) fn interfaces() -> io::Result<Vec<Interface>> {
    let mut found: Vec<Interface> = Vec::new();
    for entry in getifaddrs()? {
        let name = &entry.interface_name;
        let index = found.iter().position(|known| known.name == *name).unwrap_or_else(|| {
            found.push(Interface {
                name: name.clone(),
                is_up: entry.flags.contains(InterfaceFlags::IFF_UP),
                has_link: entry.flags.contains(InterfaceFlags::IFF_RUNNING),
                addresses: Vec::new(),
            });
            found.len() - 1
        });
        found[index].addresses.extend(network(&entry));
    }
    Ok(found)
}

fn network(entry: &InterfaceAddress) -> Option<IpNet> {
    let address = ip(entry.address.as_ref()?)?;
    IpNet::with_netmask(address, ip(entry.netmask.as_ref()?)?).ok()
}

fn ip(address: &SockaddrStorage) -> Option<IpAddr> {
    let v4 = address.as_sockaddr_in().map(|v4| IpAddr::V4(v4.ip()));
    v4.or_else(|| address.as_sockaddr_in6().map(|v6| IpAddr::V6(v6.ip())))
}

/// The text of a file below /proc.
pub(super) fn read(path: &str) -> Option<String> {
    fs::read_to_string(path).ok()
}

/// The number that a file holds.
pub(super) fn number(path: &str) -> Option<u64> {
    read(path)?.trim().parse().ok()
}

/// What a command prints; none where it is not there, or fails.
pub(super) fn output(command: &str, arguments: &[&str]) -> Option<String> {
    let folder = FOLDERS.into_iter().find(|folder| Path::new(folder).join(command).exists())?;
    let mut command = Command::new(Path::new(folder).join(command));
    let output = command.args(arguments).stdin(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// A process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) pid: u32,
    pub(super) name: String,
}

/// The processes that have sockets open, by the inodes of these. Only root sees those of others.
pub(super) fn socket_owners() -> HashMap<u64, Owner> {
    let mut owners = HashMap::new();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    for process in processes {
        let Ok(pid) = process.file_name().to_string_lossy().parse() else { continue };
        let Ok(descriptors) = fs::read_dir(process.path().join("fd")) else { continue };
        let name = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
        for descriptor in descriptors.flatten() {
            let link = fs::read_link(descriptor.path()).unwrap_or_default();
            let link = link.to_string_lossy();
            let inode = link.strip_prefix("socket:[").and_then(|rest| rest.strip_suffix(']'));
            if let Some(inode) = inode.and_then(|inode| inode.parse().ok()) {
                owners.insert(inode, Owner { pid, name: name.trim_end().to_owned() });
            }
        }
    }
    owners
}
