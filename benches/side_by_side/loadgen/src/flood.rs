//! A flood of wrong passwords, from many ports, as fast as one thread can send.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};

use loadgen::datagram::{self, WRONG_PASSWORD};
use loadgen::net::{self, BATCH, Batch, To};

use crate::targets::Targets;

#[derive(clap::Args)]
pub struct Args {
    /// The public ports, comma separated
    #[arg(long, value_delimiter = ',', required = true)]
    targets: Vec<Targets>,
    /// Ports to send from
    #[arg(long)]
    sockets: usize,
    #[arg(long)]
    seconds: f64,
}

pub fn run(args: &Args) -> io::Result<()> {
    let mut targets = args.targets.iter().flat_map(|targets| &targets.0).cycle();
    let mut sockets = Vec::new();
    for target in targets.by_ref().take(args.sockets) {
        let socket = net::socket(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
        socket.connect(target.address)?;
        sockets.push((socket, target.node_address));
    }
    let (mut outgoing, mut incoming) = (Batch::new(false), Batch::new(false));
    let end = net::now() + (args.seconds * 1e9) as u64;
    let (mut sent, mut answers) = (0, 0);
    for (socket, node_address) in sockets.iter().cycle() {
        let now = net::now();
        if now >= end {
            break;
        }
        for index in 0..BATCH {
            let octets = outgoing.room(index, datagram::LEN);
            datagram::write(octets, *node_address, 0, now, WRONG_PASSWORD);
        }
        sent += outgoing.send(socket, 0..BATCH, To::Peer);
        answers += incoming.receive(socket);
    }
    let rate = sent as f64 / args.seconds;
    println!("{}", serde_json::json!({ "sent": sent, "rate": rate, "answers": answers }));
    Ok(())
}
