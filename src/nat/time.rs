//! Time as the NAT keeps it.

/// Nanoseconds since the relay's start, and one more: 0 stands for never. Half the room of an
/// `Instant`, and quicker to compare.
pub(super) type Nanos = u64;
