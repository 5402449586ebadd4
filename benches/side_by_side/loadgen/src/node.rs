//! The simulated nodes: every datagram goes back to where it came from, from the address that it
//! was sent to.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use loadgen::datagram::{NODE_ADDRESS, PASSWORD};
use loadgen::net::{self, BATCH, Batch, Epoll, To};

#[derive(clap::Args)]
pub struct Args {
    /// The port of every node; their addresses are all that the host has
    #[arg(long)]
    port: u16,
}

static STOP: AtomicBool = AtomicBool::new(false);

extern "C" fn stop(_: i32) {
    STOP.store(true, Relaxed);
}

/// What the nodes got.
#[derive(Default)]
struct Tally {
    received: usize,
    answered: usize,
    empty: usize,
    wrong_password: usize,
    /// The route names another node.
    wrong_node: usize,
}

pub fn run(args: &Args) -> io::Result<()> {
    net::on_sigterm(stop);
    let socket = net::socket(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, args.port))?;
    net::tell_local_address(&socket)?;
    let mut epoll = Epoll::new()?;
    epoll.add(&socket, 0)?;
    let mut batch = Batch::new(true);
    let mut tally = Tally::default();
    while !STOP.load(Relaxed) {
        if epoll.wait(None) == 0 {
            continue;
        }
        loop {
            let received = batch.receive(&socket);
            tally.received += received;
            (0..received).for_each(|index| tally.look_at(&mut batch, index));
            // An empty datagram is no request and gets no answer.
            let mut from = 0;
            for index in 0..=received {
                if index == received || batch.octets(index).is_empty() {
                    tally.answered += batch.send(&socket, from..index, To::Each);
                    from = index + 1;
                }
            }
            if received < BATCH {
                break;
            }
        }
    }
    let Tally { received, answered, empty, wrong_password, wrong_node } = tally;
    println!(
        "{}",
        serde_json::json!({
            "received": received,
            "answered": answered,
            "empty": empty,
            "wrong_password": wrong_password,
            "wrong_node": wrong_node,
        })
    );
    Ok(())
}

impl Tally {
    fn look_at(&mut self, batch: &mut Batch, index: usize) {
        let node_address = batch.local_address(index).octets()[3];
        let octets = batch.octets(index);
        if octets.is_empty() {
            self.empty += 1;
            return;
        }
        self.wrong_password += usize::from(!octets.ends_with(&PASSWORD));
        self.wrong_node += usize::from(octets.get(NODE_ADDRESS) != Some(&node_address));
    }
}
