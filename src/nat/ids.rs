//! Indices of nets, mappings, flows and sockets. The index of a closed flow or socket is given to a
//! later one.

/// Index of a net in its [`Table`](super::Table).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NetId(pub u16);

/// Index of a mapping in its [`Table`](super::Table).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MappingId(pub u32);

/// Index of a flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FlowId(pub(super) u32);

impl FlowId {
    /// The flow with this key in a slab. The budget counts flows in a `u32`, so every key fits.
    pub(super) fn new(key: usize) -> Self {
        Self(key as u32)
    }

    pub(super) fn key(self) -> usize {
        self.0 as usize
    }
}

/// Index of a public socket. It stays the same in a reload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ListenerId(pub u32);

/// Index of an upstream socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct UpstreamId(pub u32);

impl UpstreamId {
    pub(super) fn key(self) -> usize {
        self.0 as usize
    }
}
