//! Capabilities: given up in every set, of the calling thread and of those it starts.

use caps::errors::CapsError;
use caps::{CapSet, Capability, CapsHashSet};

/// Keeps the capabilities for ports below 1024 and for becoming another user, as far as they are
/// there, and gives up all others.
pub(super) fn keep_for_the_start() -> Result<(), CapsError> {
    keep(CapsHashSet::from([
        Capability::CAP_NET_BIND_SERVICE,
        Capability::CAP_SETGID,
        Capability::CAP_SETUID,
    ]))
}

/// Gives up all that is left.
pub(super) fn keep_none() -> Result<(), CapsError> {
    keep(CapsHashSet::new())
}

fn keep(kept: CapsHashSet) -> Result<(), CapsError> {
    // The bounding set takes a capability to shrink, so it is first. Who has none cannot shrink it,
    // and has no use for it: it bounds what a started program may gain, which is nothing.
    let _ = caps::clear(None, CapSet::Bounding);
    caps::clear(None, CapSet::Ambient)?;
    caps::clear(None, CapSet::Inheritable)?;
    let permitted = caps::read(None, CapSet::Permitted)?;
    let kept = permitted.intersection(&kept).copied().collect();
    caps::set(None, CapSet::Effective, &kept)?;
    caps::set(None, CapSet::Permitted, &kept)
}
