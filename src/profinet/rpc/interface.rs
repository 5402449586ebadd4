//! Which kind of node a call is for, and what its operations are called (P-4, P-7).

use super::super::Uuid;

/// What can be called at a PROFINET node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Interface {
    /// An IO device.
    Device,
    /// An IO controller.
    Controller,
    /// An IO supervisor.
    Supervisor,
    /// A parameter server.
    ParameterServer,
    /// The list of what a node offers.
    EndpointMapper,
}

impl Interface {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Device,
        Self::Controller,
        Self::Supervisor,
        Self::ParameterServer,
        Self::EndpointMapper,
    ];

    /// The interface with this UUID.
    pub fn of(uuid: Uuid) -> Option<Self> {
        Self::ALL.into_iter().find(|interface| interface.uuid() == uuid)
    }

    /// Its UUID.
    pub const fn uuid(self) -> Uuid {
        Uuid::new(match self {
            Self::Device => 0xDEA00001_6C97_11D1_8271_00A02442DF7D,
            Self::Controller => 0xDEA00002_6C97_11D1_8271_00A02442DF7D,
            Self::Supervisor => 0xDEA00003_6C97_11D1_8271_00A02442DF7D,
            Self::ParameterServer => 0xDEA00004_6C97_11D1_8271_00A02442DF7D,
            Self::EndpointMapper => 0xE1AF8308_5D1F_11C9_91A4_08002B14A0FA,
        })
    }

    /// Its name in a sentence.
    pub fn name(self) -> &'static str {
        match self {
            Self::Device => "IO device",
            Self::Controller => "IO controller",
            Self::Supervisor => "IO supervisor",
            Self::ParameterServer => "parameter server",
            Self::EndpointMapper => "endpoint mapper",
        }
    }

    /// The version of the interface that nodes have: the major one in the low half.
    pub fn version(self) -> u32 {
        if self == Self::EndpointMapper { 3 } else { 1 }
    }

    /// Whether its calls carry blocks of PROFINET.
    pub fn has_blocks(self) -> bool {
        self != Self::EndpointMapper
    }
}

/// What an operation of an interface is called; none if it is not known.
pub fn operation_name(interface: Interface, operation: u16) -> Option<&'static str> {
    const BLOCKS: [&str; 6] = ["Connect", "Release", "Read", "Write", "Control", "Read Implicit"];
    const ENDPOINTS: [&str; 7] = [
        "ept_insert",
        "ept_delete",
        "ept_lookup",
        "ept_map",
        "ept_lookup_handle_free",
        "ept_inq_object",
        "ept_mgmt_delete",
    ];
    let names = if interface.has_blocks() { &BLOCKS[..] } else { &ENDPOINTS };
    names.get(usize::from(operation)).copied()
}
