//! `loadgen`: the load and the nodes behind the relay. Each prints one line of JSON at its end.

mod client;
mod flood;
mod node;
mod odd;
mod targets;

use clap::{Parser, Subcommand};

/// Load and simulated nodes for the side-by-side benchmark.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    role: Role,
}

#[derive(Subcommand)]
enum Role {
    /// Ask nodes and measure their answers
    Client(client::Args),
    /// Send wrong passwords as fast as it goes
    Flood(flood::Args),
    /// Answer every datagram with itself
    Node(node::Args),
}

fn main() -> std::io::Result<()> {
    match Cli::parse().role {
        Role::Client(args) => client::run(&args),
        Role::Flood(args) => flood::run(&args),
        Role::Node(args) => node::run(&args),
    }
}
