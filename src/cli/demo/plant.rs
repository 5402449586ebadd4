//! The demo's plant: simulated server nodes on loopback, and the configuration of the relay in front of
//! them. All addresses and ports are chosen so that they are free.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use tokio::task::JoinSet;

use crate::config::{Admin, Config, Datapath, Log, Runtime};
use crate::nat::{Credential, Limits, Mapping, Net, NetId, NetKind, Table};
use crate::peer::{Faults, NodeCounts, NodeError, NodeSettings, ServerNode, Target};
use crate::pnet::endpoint::{Data, Indicated};
use crate::pnet::wire::{Header, MAX_DATA, Password};

/// Node addresses of the plant.
const NODES: std::ops::RangeInclusive<u8> = 1..=4;
/// The relay's public address: loopback stands for the Internet.
const PUBLIC: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// The plant; its nodes serve until it is dropped.
pub(super) struct Plant {
    password: Password,
    start_port: u16,
    nodes: Vec<PlantNode>,
    _serving: JoinSet<io::Result<()>>,
}

/// One server node of the plant.
pub(super) struct PlantNode {
    /// Its node address.
    pub(super) node_address: u8,
    /// The relay's address and port for it.
    pub(super) public: SocketAddr,
    /// Its own address and Secure port.
    pub(super) server: SocketAddr,
    /// What it has seen.
    pub(super) counts: Arc<NodeCounts>,
}

impl Plant {
    /// Starts the nodes and finds public ports for them.
    pub(super) async fn build() -> anyhow::Result<Self> {
        let password = random_password()?;
        let (nodes, start_port) = bind_nodes(&password)?;
        let mut serving = JoinSet::new();
        let nodes = nodes.into_iter().map(|node| {
            let settings = node.settings();
            let node_address = settings.node_address();
            let plant_node = PlantNode {
                node_address,
                public: SocketAddr::new(PUBLIC, start_port + u16::from(node_address)),
                server: SocketAddr::from((settings.address, settings.secure_port)),
                counts: node.counts(),
            };
            serving.spawn(node.serve());
            plant_node
        });
        Ok(Self { nodes: nodes.collect(), password, start_port, _serving: serving })
    }

    /// The server nodes, in the order of the relay's table.
    pub(super) fn nodes(&self) -> &[PlantNode] {
        &self.nodes
    }

    /// The plant as its remote client knows it.
    pub(super) fn target(&self) -> Target {
        Target::new(PUBLIC, self.start_port, Some(self.password.clone()))
    }

    /// The configuration of the relay in front of the plant.
    pub(super) fn config(&self, admin: SocketAddr) -> Config {
        let net = Net {
            allow: vec!["127.0.0.0/8".parse().expect("a network")],
            credentials: vec![Credential {
                name: "demo".into(),
                password: self.password.clone(),
                device_password: None,
            }],
            require_response_password: true,
            max_flows: 64,
            ..Net::new("demo", NetKind::UdpRange { start_port: self.start_port })
        };
        let mapping = |node: &PlantNode| Mapping {
            net: NetId(0),
            node_address: node.node_address,
            local_address: None,
            public_port: node.public.port(),
            server: node.server,
        };
        let mappings = self.nodes.iter().map(mapping).collect();
        Config {
            listen: vec![PUBLIC],
            table: Arc::new(Table::new(Header::default(), vec![net], mappings)),
            beyond_gateway: Vec::new(),
            limits: Limits {
                max_flows: 64,
                wrong_password_burst: 10,
                wrong_password_address_burst: 5120,
                wrong_password_interval: Duration::from_millis(200),
            },
            datapath: Datapath::default(),
            log: Log::default(),
            runtime: Runtime::default(),
            admin: Some(Admin {
                listen: admin,
                token: None,
                metrics_without_token: false,
                reload: false,
                probe: true,
                title: None,
            }),
            control: None,
            files: Vec::new(),
        }
    }
}

/// What a node of the plant answers: the data of the request and its node address. So an answer to another
/// request or from another node is recognised.
pub(super) fn reading(node_address: u8, request: &[u8]) -> Data {
    request.iter().copied().take(MAX_DATA - 1).chain([node_address]).collect()
}

/// The nodes are in one of the subnets 127.17.x.0 with these numbers.
const SUBNETS: std::ops::RangeInclusive<u8> = 17..=116;

/// Binds the nodes in the first subnet where their ports are free, and so is the block of public ports
/// that goes with it. Nobody else can bind these nodes then, so no other demo takes the same block.
/// The relay's sockets alone would not keep it off, for relays may share their ports.
fn bind_nodes(password: &Password) -> anyhow::Result<(Vec<ServerNode>, u16)> {
    for subnet in SUBNETS {
        let nodes = match bind_subnet(subnet, password) {
            Err(NodeError::Listen(error)) if error.is_in_use() => continue,
            nodes => nodes?,
        };
        let start_port = 20_000 + 127 * u16::from(subnet - SUBNETS.start());
        let is_free = |node: u8| UdpSocket::bind((PUBLIC, start_port + u16::from(node))).is_ok();
        if NODES.into_iter().all(is_free) {
            return Ok((nodes, start_port));
        }
    }
    bail!("no block of free UDP ports on {PUBLIC} between 20000 and 32700; end another program")
}

fn bind_subnet(subnet: u8, password: &Password) -> Result<Vec<ServerNode>, NodeError> {
    let mut nodes = Vec::new();
    for node_address in NODES {
        let address = Ipv4Addr::new(127, 17, subnet, node_address);
        let delay = Duration::from_millis(node_address.into());
        let settings = NodeSettings {
            faults: Faults { delay, ..Faults::default() },
            ..NodeSettings::new(address, vec![password.clone()])
        };
        let service =
            move |request: &Indicated<'_>| Some(reading(node_address, request.data_octets));
        nodes.push(ServerNode::bind(settings, service)?);
    }
    Ok(nodes)
}

fn random_password() -> anyhow::Result<Password> {
    let mut octets = [0; Password::LEN];
    getrandom::fill(&mut octets).context("the system has no random numbers")?;
    Ok(Password::new(octets))
}
