//! Capabilities: they are removed from every set, for the calling thread and the threads that it
//! starts later.

use caps::errors::CapsError;
use caps::{CapSet, Capability, CapsHashSet};

/// Keeps the capabilities for ports below 1024, for becoming another user, and for loading and
/// attaching the program that carries flows in the kernel, if the process has them. Gives up all
/// others.
pub(super) fn keep_for_the_start() -> Result<(), CapsError> {
    keep(CapsHashSet::from([
        Capability::CAP_BPF,
        Capability::CAP_NET_ADMIN,
        Capability::CAP_NET_BIND_SERVICE,
        // Without it, the kernel's verifier refuses arithmetic on pointers to packets.
        Capability::CAP_PERFMON,
        Capability::CAP_SETGID,
        Capability::CAP_SETUID,
    ]))
}

/// Gives up all capabilities that are left.
pub(super) fn keep_none() -> Result<(), CapsError> {
    keep(CapsHashSet::new())
}

fn keep(kept: CapsHashSet) -> Result<(), CapsError> {
    // A process needs a capability to shrink the bounding set, so this comes first. A process
    // without that capability cannot shrink the set, but it does not matter: the set limits what a
    // program that it starts may gain, and such a program gains nothing.
    let _ = caps::clear(None, CapSet::Bounding);
    caps::clear(None, CapSet::Ambient)?;
    caps::clear(None, CapSet::Inheritable)?;
    let permitted = caps::read(None, CapSet::Permitted)?;
    let kept = permitted.intersection(&kept).copied().collect();
    caps::set(None, CapSet::Effective, &kept)?;
    caps::set(None, CapSet::Permitted, &kept)
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// A user without capabilities has none to keep; root keeps these.
    #[test]
    fn what_the_start_needs_goes_last() {
        let needed = CapsHashSet::from([
            Capability::CAP_BPF,
            Capability::CAP_NET_ADMIN,
            Capability::CAP_NET_BIND_SERVICE,
            Capability::CAP_PERFMON,
            Capability::CAP_SETGID,
            Capability::CAP_SETUID,
        ]);
        // Only this thread gives anything up.
        let giving_up = thread::spawn(move || {
            let had = caps::read(None, CapSet::Permitted).unwrap();
            keep_for_the_start().unwrap();
            let expected: CapsHashSet = had.intersection(&needed).copied().collect();
            for set in [CapSet::Permitted, CapSet::Effective] {
                assert_eq!(caps::read(None, set).unwrap(), expected, "{set:?}");
            }
            keep_none().unwrap();
            for set in [CapSet::Permitted, CapSet::Effective] {
                assert_eq!(caps::read(None, set).unwrap(), CapsHashSet::new(), "{set:?}");
            }
        });
        giving_up.join().unwrap();
    }
}
