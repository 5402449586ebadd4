//! The table: its rows, and the rules that need more than one of them.

use std::fmt;
use std::net::Ipv4Addr;

use super::row::Row;
use super::{Fields, Nettype, RowFault};
use crate::pnet::wire::{IpNetId, NORMAL_PORT, NodeAddress};

/// The IPNetTable of one node: legal rows, of which one is the node's own net (R-15, PAS 8).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IpNetTable {
    node_address: NodeAddress,
    own_net: IpNetId,
    /// The row of IPNetID 1 is the first; the last one, at most 124, is used.
    rows: Vec<Row>,
}

/// One thing that keeps rows from being an [`IpNetTable`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TableError {
    /// A row is not legal.
    #[error("row {row}, {}: {fault} ({})", .fault.field(), .fault.clause())]
    Row {
        /// The index of the row.
        row: IpNetId,
        /// What is wrong with it.
        fault: RowFault,
    },
    /// No row has router 0, so no router could be reached.
    #[error("no IP Range net has router 0, so the node has no own net (PAS 8)")]
    NoOwnNet,
}

/// All that keeps rows from being an [`IpNetTable`], in the order of the rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IllegalTable(pub Vec<TableError>);

impl fmt::Display for IllegalTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, error) in self.0.iter().enumerate() {
            write!(f, "{}{error}", if index == 0 { "" } else { "; " })?;
        }
        Ok(())
    }
}

impl std::error::Error for IllegalTable {}

/// Why what a device holds is no [`IpNetTable`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// The device counts more rows than a table has.
    #[error("NoOfIPNets is {0}, and a table has at most 124 rows (PAS 8)")]
    TooManyNets(u16),
    /// The address of the device is not that of a node.
    #[error("the last octet of {0} is no node address (PAS 7)")]
    NotANode(Ipv4Addr),
    /// The rows that it counts are not legal.
    #[error(transparent)]
    Rows(#[from] IllegalTable),
}

impl IpNetTable {
    /// The table of a node. Rows that are not named are unused.
    ///
    /// Fails with every fault of every row.
    pub fn new(
        node_address: NodeAddress,
        rows: impl IntoIterator<Item = (IpNetId, Fields)>,
    ) -> Result<Self, IllegalTable> {
        let mut table: Vec<Option<Row>> = Vec::new();
        let mut own_net = None;
        let mut errors = Vec::new();
        for (id, fields) in rows {
            let mut note = |fault| errors.push(TableError::Row { row: id, fault });
            if id > IpNetId::LAST_ROW {
                note(RowFault::DynamicClients);
                continue;
            }
            let index = usize::from(id.get()) - 1;
            table.resize(table.len().max(index + 1), None);
            if table[index].is_some() {
                note(RowFault::Repeated);
                continue;
            }
            // Also when the row has a fault: it does not make the node's own net another one.
            if fields.nettype == Nettype::IpRange && fields.router == 0 {
                match own_net {
                    None => own_net = Some(id),
                    Some(first) => note(RowFault::SecondOwnNet(first)),
                }
            }
            match Row::new(&fields, node_address) {
                Ok(row) => table[index] = Some(row),
                Err(faults) => {
                    faults.into_iter().for_each(note);
                    table[index] = Some(Row::Unused); // taken; there will be no table
                }
            }
        }
        if own_net.is_none() {
            errors.push(TableError::NoOwnNet);
        }
        match own_net {
            Some(own_net) if errors.is_empty() => {
                let mut rows: Vec<_> =
                    table.into_iter().map(|row| row.unwrap_or(Row::Unused)).collect();
                let used = rows.iter().rposition(|row| *row != Row::Unused);
                rows.truncate(used.map_or(0, |last| last + 1));
                Ok(Self { node_address, own_net, rows })
            }
            _ => Err(IllegalTable(errors)),
        }
    }

    /// The table in a device with this address, as its `IPNetTable` variable holds it.
    ///
    /// A device whose NoOfIPNets is 0 or $FFFF was never set up, and knows its own subnet alone, as
    /// net 1 at the Normal port. Fails if the last octet of the address is no node address,
    /// if NoOfIPNets is over 124, and with every fault of the rows that it counts.
    pub fn of_device(
        ip_address: Ipv4Addr,
        no_of_ip_nets: u16,
        ip_nets: &[Fields; IpNetId::LAST_ROW.get() as usize],
    ) -> Result<Self, DeviceError> {
        let node = NodeAddress::new(ip_address.octets()[3]);
        let node = node.ok_or(DeviceError::NotANode(ip_address))?;
        let ids = (1..=IpNetId::LAST_ROW.get()).filter_map(IpNetId::new);
        if matches!(no_of_ip_nets, 0 | u16::MAX) {
            let own = Fields {
                nettype: Nettype::IpRange,
                ip_address,
                udp_port: NORMAL_PORT,
                ..Fields::UNUSED
            };
            return Ok(Self::new(node, ids.take(1).map(|id| (id, own)))?);
        }
        let counted = ip_nets.get(..no_of_ip_nets.into());
        let counted = counted.ok_or(DeviceError::TooManyNets(no_of_ip_nets))?;
        Ok(Self::new(node, ids.zip(counted.iter().copied()))?)
    }

    /// The node whose table this is.
    pub const fn node_address(&self) -> NodeAddress {
        self.node_address
    }

    /// The net that the node itself is in.
    pub const fn own_net(&self) -> IpNetId {
        self.own_net
    }

    /// The rows of the nets that are used, by their index. They make the same table again.
    pub fn rows(&self) -> impl Iterator<Item = (IpNetId, Fields)> {
        let ids = (1..=IpNetId::LAST_ROW.get()).filter_map(IpNetId::new);
        let rows = ids.zip(self.rows.iter().map(Row::fields));
        rows.filter(|(_, fields)| fields.nettype != Nettype::Unused)
    }

    /// The row of a net.
    pub(super) fn row(&self, net: IpNetId) -> &Row {
        self.rows.get(usize::from(net.get()) - 1).unwrap_or(&Row::Unused)
    }
}
