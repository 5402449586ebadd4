//! What is looked at, and how it is shown.

use std::net::{IpAddr, SocketAddr};
use std::process::ExitCode;
use std::sync::Arc;

use super::Args;
use super::ports::Ports;
use super::profinet::Protocol;
use crate::cli::output::Format;
use crate::cli::told;
use crate::config::Source;
use crate::nat::Table;
use crate::pnet::wire::Header;

/// The arguments, and what the relay's configuration adds to them.
pub(super) struct Settings {
    pub(super) ports: Ports,
    pub(super) header: Header,
    pub(super) format: Format,
    /// Text has a line for each field.
    pub(super) is_verbose: bool,
    /// All where it is empty.
    protocols: Vec<Protocol>,
    /// That of the relay's configuration, if there is one.
    table: Option<Arc<Table>>,
}

impl Settings {
    /// Reads the configuration, if one is named. Its faults are printed, and are an exit code.
    pub(super) fn new(args: &Args) -> Result<Self, ExitCode> {
        let mut ports = Ports::of_p_net_and(&args.ports);
        let (mut header, mut table) = (args.header, None);
        if let Some(path) = &args.config {
            // A capture is often read on another machine, so the servers are not looked for here.
            let (config, _) = told(Source::File(path.clone()).load_without_host())?;
            for mapping in config.table.mappings() {
                ports.add(mapping.public_port);
                ports.add(mapping.server.port());
            }
            header = header.or(Some(config.table.header));
            table = Some(config.table);
        }
        let header = header.unwrap_or_default();
        let (format, protocols) = (args.format, args.protocol.clone());
        Ok(Self { ports, header, format, is_verbose: args.verbose, protocols, table })
    }

    /// Whether somebody wants to see it.
    pub(super) fn shows(&self, protocol: Protocol) -> bool {
        self.protocols.is_empty() || self.protocols.contains(&protocol)
    }

    /// The net and the node behind an address and port that was asked: that of a node in the plant, or a
    /// public port. The relay's address may be another one outside, so the port counts alone.
    pub(super) fn name(&self, server: SocketAddr) -> Option<(&str, u8)> {
        let table = self.table.as_ref()?;
        let node = table.mapping_of_server(server).map(|id| table.mapping(id));
        let public = || {
            let mappings = table.mappings().iter();
            let is_at = |address: IpAddr| address == server.ip();
            mappings.copied().find(|mapping| {
                mapping.public_port == server.port() && mapping.local_address.is_none_or(is_at)
            })
        };
        let mapping = node.or_else(public)?;
        Some((&table.net(mapping.net).name, mapping.node_address))
    }
}
