//! The demo's traffic: a remote client that polls every node, and a stranger without the password.
//!
//! Both run until they are told to end. The client waits for its last answer, and the stranger listens a
//! little longer. Invariant: every datagram is counted before it is sent.

use std::cell::{Cell, RefCell};
use std::time::Duration;

use anyhow::Context;
use tokio::net::UdpSocket;

use crate::peer::{Client, ExchangeError, Request, Target};
use crate::pnet::endpoint::client::{self as endpoint, Arep, Attributes};
use crate::pnet::wire::{MAX_DATAGRAM, Password};

use super::plant::{Plant, reading};

/// Time between two rounds of the client.
const POLL_PAUSE: Duration = Duration::from_millis(20);
/// How long the client waits for an answer.
const POLL_WAIT: Duration = Duration::from_secs(2);
/// Time between two datagrams of the stranger.
const INTRUSION_PAUSE: Duration = Duration::from_millis(25);
/// How long the stranger still listens at the end.
const LISTEN: Duration = Duration::from_millis(300);
/// The stranger has a loopback address of its own, so that its wrong passwords do not throttle the client.
const STRANGER: &str = "127.0.0.2:0";

/// What the client has seen of one node.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Polled {
    /// Requests sent.
    pub(super) requests: u64,
    /// Right answers.
    pub(super) right: u64,
    /// Wrong answers.
    pub(super) wrong: u64,
    /// Round-trip times of all answers together.
    pub(super) round_trips: Duration,
}

/// What the stranger has done.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Intrusions {
    /// Valid requests with a wrong password.
    pub(super) wrong_passwords: u64,
    /// Datagrams that are not valid.
    pub(super) garbage: u64,
    /// Datagrams that came back.
    pub(super) answered: u64,
}

/// The client and the stranger.
pub(super) struct Traffic {
    target: Target,
    node_addresses: Vec<u8>,
    polled: RefCell<Vec<Polled>>,
    intrusions: Cell<Intrusions>,
}

impl Traffic {
    pub(super) fn new(plant: &Plant) -> Self {
        let node_addresses: Vec<u8> = plant.nodes().iter().map(|node| node.node_address).collect();
        Self {
            target: plant.target(),
            polled: RefCell::new(vec![Polled::default(); node_addresses.len()]),
            node_addresses,
            intrusions: Cell::default(),
        }
    }

    /// What the client has seen, node by node in the plant's order.
    pub(super) fn polled(&self) -> Vec<Polled> {
        self.polled.borrow().clone()
    }

    /// What the stranger has done.
    pub(super) fn intrusions(&self) -> Intrusions {
        self.intrusions.get()
    }

    /// Polls all nodes over and over, one request at a time.
    pub(super) async fn poll(&self, ended: &Cell<bool>) -> anyhow::Result<()> {
        let mut client = Client::bind(self.target.clone()).await?;
        let mut number: u32 = 0;
        while !ended.get() {
            for (index, &node_address) in self.node_addresses.iter().enumerate() {
                let octets = number.to_be_bytes();
                let request = request(node_address, &octets);
                self.polled.borrow_mut()[index].requests += 1;
                let outcome = client.exchange(&request, POLL_WAIT).await;
                let polled = &mut self.polled.borrow_mut()[index];
                match outcome {
                    Ok((answer, round_trip)) => {
                        let right = answer.data_octets[..] == reading(node_address, &octets)[..];
                        *(if right { &mut polled.right } else { &mut polled.wrong }) += 1;
                        polled.round_trips += round_trip;
                    }
                    Err(ExchangeError::Lost(_)) => {}
                    Err(error) => return Err(error.into()),
                }
                number = number.wrapping_add(1);
            }
            tokio::time::sleep(POLL_PAUSE).await;
        }
        Ok(())
    }

    /// Sends wrong passwords and garbage to all nodes and counts whatever comes back.
    pub(super) async fn intrude(&self, ended: &Cell<bool>) -> anyhow::Result<()> {
        let socket = UdpSocket::bind(STRANGER).await?;
        let mut numbers = 0..;
        let mut targets = self.node_addresses.iter().cycle();
        while let (false, Some(number), Some(&node_address)) =
            (ended.get(), numbers.next(), targets.next())
        {
            let octets = self.intrusion(number, node_address)?;
            socket.send_to(&octets, self.target.socket_address(node_address)).await?;
            self.listen(&socket, INTRUSION_PAUSE).await?;
        }
        self.listen(&socket, LISTEN).await
    }

    async fn listen(&self, socket: &UdpSocket, time: Duration) -> anyhow::Result<()> {
        let listening = async {
            loop {
                socket.recv(&mut [0; MAX_DATAGRAM]).await?;
                self.count(|intrusions| intrusions.answered += 1);
            }
        };
        match tokio::time::timeout(time, listening).await {
            Ok(failed) => failed,
            Err(_) => Ok(()),
        }
    }

    /// Makes and counts a datagram of the stranger: every second one is a valid request with a wrong
    /// password, the others are garbage of several kinds.
    fn intrusion(&self, number: u32, node_address: u8) -> anyhow::Result<Vec<u8>> {
        let guess = Password::new(fastrand::u64(..).to_ne_bytes());
        let stranger = Target { password: Some(guess), ..self.target.clone() };
        let Request { control_status, data_octets, .. } = request(node_address, b"open");
        let route = stranger.route(&request(node_address, &[]))?;
        let mut octets = [0; MAX_DATAGRAM];
        let mut client = endpoint::Client::new(Arep::new(stranger.source));
        let endpoint = client.reserve(Attributes::new(route))?;
        client.request(endpoint, &endpoint::Request::Data { control_status, data_octets })?;
        let transmit = client.poll_transmit(Duration::ZERO, &mut octets).context("no request")?;
        let mut octets = octets[..transmit.length].to_vec();
        let sound = number.is_multiple_of(2);
        self.count(|intrusions| {
            *(if sound { &mut intrusions.wrong_passwords } else { &mut intrusions.garbage }) += 1;
        });
        if !sound {
            spoil(&mut octets, number / 2);
        }
        Ok(octets)
    }

    fn count(&self, count: impl FnOnce(&mut Intrusions)) {
        let mut intrusions = self.intrusions.get();
        count(&mut intrusions);
        self.intrusions.set(intrusions);
    }
}

/// The request of PAS Figure 10: through the node to node 33 on its port 2.
fn request(node_address: u8, data_octets: &[u8]) -> Request<'_> {
    Request { node_address, beyond: &[2, 33], control_status: 0, data_octets }
}

/// Turns a valid request into garbage, in a different way for each number.
fn spoil(octets: &mut Vec<u8>, way: u32) {
    match way % 5 {
        0 => octets.as_mut_slice().fill_with(|| fastrand::u8(..)),
        1 => octets.truncate(fastrand::usize(..16)),
        2 => octets.resize_with(fastrand::usize(108..512), || fastrand::u8(..)),
        3 => octets.truncate(octets.len() - Password::LEN),
        _ => octets[4..].fill_with(|| fastrand::u8(..)),
    }
}
