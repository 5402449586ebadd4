//! Time as the NAT keeps it.

/// Nanoseconds since the relay's start, plus one: 0 stands for never. It takes half the memory of
/// an `Instant`, and is quicker to compare.
pub(super) type Nanos = u64;
