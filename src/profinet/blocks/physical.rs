//! Blocks about interface and ports (PDev): neighbours, link, addresses, statistics.
//!
//! Fields are padded to multiples of four from the beginning of the block.

use std::net::Ipv4Addr;

use super::super::MacAddress;
use super::super::view::{Align, List, PADDED, Rest, Text, view};
use super::{Block, words};

view! {
    /// 0x0400: blocks about one submodule, so that a record can hold those of many.
    pub struct MultipleBlock<'a> {
        /// Padding.
        padding: Align,
        /// The application process.
        api: u32,
        /// The slot.
        slot: u16,
        /// The subslot.
        subslot: u16,
        /// The blocks.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x0200 and 0x0202: what is checked or set at a port.
    pub struct PortBlocks<'a> {
        /// Padding.
        padding: Align,
        /// The slot.
        slot: u16,
        /// The subslot of the port.
        subslot: u16,
        /// One block for each check or setting.
        blocks: Rest<'a, Block<'a>>,
    }
}

view! {
    /// 0x020F: a port as it is.
    pub struct PdPortDataReal<'a> {
        /// Padding.
        padding: Align,
        /// The slot.
        slot: u16,
        /// The subslot of the port.
        subslot: u16,
        /// The name of the port.
        own_port_id: Text<'a, 1>,
        /// Its neighbours, as LLDP found them.
        peers: List<'a, Peer<'a>, { PADDED }>,
        /// Medium and speed (RFC 4836).
        mau_type: u16 => words::mau_type,
        /// Padding.
        padding2: Align,
        /// Where the domain of a class of real time ends.
        domain_boundary: u32,
        /// Where multicast frames end.
        multicast_boundary: u32,
        /// What the port does with frames.
        link_state_port: u8 => words::link_state_port,
        /// Whether the link is up.
        link_state_link: u8 => words::link_state_link,
        /// Padding.
        padding3: Align,
        /// The medium.
        media_type: u32 => words::media_type,
    }
}

view! {
    /// A neighbour of a port.
    pub struct Peer<'a> {
        /// Its port's name.
        peer_port_id: Text<'a, 1>,
        /// Its name.
        peer_chassis_id: Text<'a, 1>,
        /// Padding.
        padding: Align,
        /// How long the line takes, in ns.
        line_delay: u32,
        /// Its interface.
        peer_mac_address: MacAddress,
        /// Padding.
        padding2: Align,
    }
}

view! {
    /// 0x0240: the interface as it is.
    pub struct PdInterfaceDataReal<'a> {
        /// Its name: the station name.
        own_chassis_id: Text<'a, 1>,
        /// Padding.
        padding: Align,
        /// Its MAC address.
        mac_address: MacAddress,
        /// Padding.
        padding2: Align,
        /// Its IP address.
        ip_address: Ipv4Addr,
        /// Its subnet mask.
        subnetmask: Ipv4Addr,
        /// Its gateway.
        standard_gateway: Ipv4Addr,
    }
}

view! {
    /// 0x0250: how names are sent with LLDP.
    pub struct InterfaceAdjust {
        /// Padding.
        padding: Align,
        /// 0: as before version 2.3, 1: as since then.
        multiple_interface_mode: u32 => words::multiple_interface_mode,
    }
}

view! {
    /// 0x0251: what a port has sent and received.
    pub struct PdPortStatistic {
        /// Which counters are not valid.
        counter_status: u16,
        /// Octets received.
        if_in_octets: u32,
        /// Octets sent.
        if_out_octets: u32,
        /// Received frames that were left out.
        if_in_discards: u32,
        /// Frames to send that were left out.
        if_out_discards: u32,
        /// Received frames that were wrong.
        if_in_errors: u32,
        /// Frames that could not be sent.
        if_out_errors: u32,
    }
}

view! {
    /// 0x020A: which neighbours a port should have.
    pub struct CheckPeers<'a> {
        /// The neighbours.
        peers: List<'a, CheckPeer<'a>, 1>,
    }
}

view! {
    /// A neighbour that is expected.
    pub struct CheckPeer<'a> {
        /// Its port's name.
        peer_port_id: Text<'a, 1>,
        /// Its name.
        peer_chassis_id: Text<'a, 1>,
    }
}

view! {
    /// 0x020C: which medium and speed a port should have.
    pub struct CheckMauType {
        /// Medium and speed (RFC 4836).
        mau_type: u16 => words::mau_type,
    }
}

view! {
    /// 0x020E: which medium and speed a port is to use.
    pub struct AdjustMauType {
        /// Padding.
        padding: Align,
        /// Medium and speed (RFC 4836).
        mau_type: u16 => words::mau_type,
        /// Reserved.
        adjust_properties: u16,
    }
}
