//! Tests batches on sockets of the real kernel.

use std::net::UdpSocket;
use std::os::fd::AsFd;
use std::time::Duration;

use super::fake::destination;
use super::*;
use crate::datapath::socket::sys::options;

const TAG: Tag =
    Tag { mapping: MappingId(0), direction: Direction::Response, octets: 0, asks: None };

fn receiver(address: &str) -> UdpSocket {
    let socket = UdpSocket::bind((address, 0)).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    socket
}

/// Queues datagrams of these lengths. Each octet holds the number of its datagram.
fn queue(batch: &mut Batch, key: u64, lengths: &[u8], from: Option<IpAddr>, to: SocketAddr) {
    for (number, &len) in (0..).zip(lengths) {
        let octets = usize::from(len);
        batch.octets[batch.used].0[..octets].fill(number);
        batch.queue(batch.used, key, from, to, Tag { octets, ..TAG });
        batch.used += 1;
    }
}

/// Sends what is queued. Returns how many datagrams the system took and how many it refused.
fn flush(batch: &mut Batch, socket: &UdpSocket) -> (usize, usize) {
    let (mut taken, mut refused) = (0, 0);
    batch.flush(
        |_| Some(socket.as_fd()),
        |_, outcome| match outcome {
            Ok(()) => taken += 1,
            Err(_) => refused += 1,
        },
    );
    (taken, refused)
}

fn expect(receiver: &UdpSocket, lengths: &[u8], from: IpAddr) {
    for (number, &len) in (0..).zip(lengths) {
        let mut octets = [0; SHORT];
        let (got, sender) = receiver.recv_from(&mut octets).unwrap();
        assert_eq!(octets[..got], vec![number; usize::from(len)]);
        assert_eq!(sender.ip(), from);
    }
}

#[test]
fn bursts_arrive_as_they_were_queued() {
    let lengths: Vec<u8> = [&[38, 38, 38, 20, 38, 38, 60, 16][..], &[30; 70]].concat();
    for (any, address) in [("0.0.0.0", "127.0.0.3"), ("::", "::1")] {
        let from: IpAddr = address.parse().unwrap();
        let socket = UdpSocket::bind((any, 0)).unwrap();
        let (one, other) = (receiver(address), receiver(address));
        for (segments, messages) in [(true, 5), (false, lengths.len())] {
            let mut batch: Batch = Batch::new();
            batch.segments &= segments;
            queue(&mut batch, 1, &lengths, Some(from), one.local_addr().unwrap());
            let queue_of_one = mem::take(&mut batch.queue);
            assert_eq!(batch.prepare(&queue_of_one), messages);
            batch.queue = queue_of_one;
            queue(&mut batch, 1, &lengths, Some(from), other.local_addr().unwrap());
            queue(&mut batch, 2, &lengths, Some(from), one.local_addr().unwrap());
            assert_eq!(flush(&mut batch, &socket), (3 * lengths.len(), 0));
            expect(&one, &lengths, from);
            expect(&one, &lengths, from);
            expect(&other, &lengths, from);
        }
    }
}

/// The result is the same however many datagrams are asked for, and whether or not the socket tells
/// their destination.
#[test]
fn what_is_received_is_told_alike() {
    for (bound, address, tells) in [
        ("127.0.0.5", "127.0.0.5", false),
        ("0.0.0.0", "127.0.0.6", true),
        ("::1", "::1", false),
        ("::", "::1", true),
    ] {
        let bound: IpAddr = bound.parse().unwrap();
        let socket = options::public((bound, 0).into(), 1, 1 << 16).unwrap().remove(0);
        let port = socket.local_addr().unwrap().as_socket().unwrap().port();
        let sender = receiver(address);
        let mut batch: Batch = Batch::new();
        for most in [1, 2, 1, AT_ONCE] {
            let received = batch.receive(socket.as_fd(), most, destination(tells)).unwrap();
            assert_eq!(received.count(), 0);
            drop(received);
            for octets in [&[9; 38][..], &[]] {
                sender.send_to(octets, (address, port)).unwrap();
                let mut received = batch.receive(socket.as_fd(), most, destination(tells)).unwrap();
                assert_eq!(received.count(), 1);
                let incoming = received.next_datagram().unwrap();
                assert_eq!(&*incoming.payload, octets);
                assert_eq!(incoming.from, sender.local_addr().unwrap());
                assert_eq!(incoming.to, tells.then(|| address.parse().unwrap()));
            }
        }
    }
}

#[test]
fn a_refused_burst_hurts_nobody_else() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let good = receiver("127.0.0.1");
    let mut batch: Batch = Batch::new();
    queue(&mut batch, 1, &[38; 3], None, "127.0.0.1:0".parse().unwrap());
    queue(&mut batch, 1, &[38; 4], None, good.local_addr().unwrap());
    assert_eq!(flush(&mut batch, &socket), (4, 3), "nobody listens on port 0");
    expect(&good, &[38; 4], "127.0.0.1".parse().unwrap());
    assert!(batch.segments);
}
