//! A PROFINET IO device for experiments: `io_device ADDRESS [--answer-from PORT]`. It prints a line of
//! JSON for each datagram that it receives, and goes on until it is stopped.

use std::net::IpAddr;
use std::time::Duration;
use std::{env, process};

use pnet_nat_rig::harness::{IoDevice, PNIO_PORT, pause};

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (address, port) = match arguments[..] {
        [address] => (address.parse::<IpAddr>().ok(), Some(PNIO_PORT)),
        [address, "--answer-from", port] => (address.parse().ok(), port.parse().ok()),
        _ => (None, None),
    };
    let (Some(address), Some(port)) = (address, port) else {
        println!("usage: io_device ADDRESS [--answer-from PORT]");
        process::exit(2);
    };
    let device = IoDevice::start(address, port).expect("its ports are free");
    let mut printed = 0;
    loop {
        for received in device.received().iter().skip(printed) {
            println!("{}", received.log());
            printed += 1;
        }
        pause(Duration::from_millis(50));
    }
}
