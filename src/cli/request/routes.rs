//! Where the requests go: by the client's IPNetTable, or to a router that the user names.

use std::net::{IpAddr, SocketAddr};
use std::process::ExitCode;

use anyhow::Context;

use super::{Args, bad_use};
use crate::cli::load_ip_net_table;
use crate::pnet::endpoint::client::{Arep, DestinationRoute, NoWay, Source, Way};
use crate::pnet::ip_net_table::Destination;
use crate::pnet::wire::{Elements, NodeAddress};

/// What all requests have in common, and a route for each node; otherwise says what is wrong with the
/// command line or the table, and returns the exit code.
pub(super) async fn find(
    args: &Args,
) -> anyhow::Result<Result<(Arep, Vec<DestinationRoute>), ExitCode>> {
    let found = match (&args.way.table, &args.way.to) {
        (Some(_), _) => by_table(args),
        (None, Some(host)) => by_router(args, resolve(host).await?),
        (None, None) => Err(bad_use("--to or --table says where to send the requests")),
    };
    Ok(found.map(|(source, mut routes)| {
        for route in &mut routes {
            route.beyond = args.beyond.clone().unwrap_or_default();
        }
        let arep = Arep {
            response_timeout: args.pace.timeout,
            max_retries: args.pace.retries,
            max_outstanding_requests: args.pace.window.into(),
            ..Arep::new(source)
        };
        (arep, routes)
    }))
}

fn nodes(args: &Args) -> impl Iterator<Item = NodeAddress> {
    args.node.iter().flat_map(|nodes| nodes.0.clone()).filter_map(NodeAddress::new)
}

fn by_table(args: &Args) -> Result<(Source, Vec<DestinationRoute>), ExitCode> {
    let (Some(path), Some(net)) = (&args.way.table, args.way.net) else {
        return Err(bad_use("--table needs --net, the number of a row"));
    };
    let (table, passwords) = load_ip_net_table(path)?;
    let source = Source { ip_net_id: table.own_net(), node_address: table.node_address() };
    let password = args.password_file.as_ref().or_else(|| passwords.get(&net));
    let route = |node| DestinationRoute::by_table(&table, net, Destination::Node(node), password);
    let routes = nodes(args).map(route).collect::<Result<_, NoWay>>();
    let routes = routes.map_err(|error| {
        let remedy = match error {
            NoWay::NoPassword(_) => "add `password_file` to the row, or name it as --password-file",
            NoWay::Translate(_) => "`pnet-nat translate` shows the ways of a table",
        };
        bad_use(format_args!("{}: {error}; {remedy}", path.display()))
    })?;
    Ok((source, routes))
}

fn by_router(args: &Args, router: SocketAddr) -> Result<(Source, Vec<DestinationRoute>), ExitCode> {
    let source = Source::FIGURE_10;
    if args.way.port.is_some() && nodes(args).count() > 1 {
        return Err(bad_use("--port is that of one node: name one with --node"));
    }
    let route = |node: NodeAddress| {
        let by_start_port = args.way.start_port.map(|start| start + u16::from(node.get()));
        let mut address = router;
        address.set_port(args.way.port.or(by_start_port)?);
        Some(DestinationRoute {
            way: Way { address, password: args.password_file.clone() },
            ip_net_id: source.ip_net_id,
            node: Destination::Node(node),
            beyond: Elements::new(),
        })
    };
    Ok((source, nodes(args).filter_map(route).collect()))
}

/// The address of a host. Of several, it is an IPv4 one if there is any, as in an IPNetTable (PAS 8).
async fn resolve(host: &str) -> anyhow::Result<SocketAddr> {
    let addresses = tokio::net::lookup_host((host, 0)).await;
    let addresses = addresses.with_context(|| format!("--to {host:?} cannot be looked up"))?;
    let address = addresses.min_by_key(|address| !address.is_ipv4());
    let address = address.with_context(|| format!("--to {host:?} has no address"))?;
    Ok(match address.ip().to_canonical() {
        IpAddr::V4(v4) => (v4, address.port()).into(),
        IpAddr::V6(_) => address,
    })
}
