//! Tests batches on a kernel that the tests play. It does what the real kernel does seldom or only
//! on other machines.
//!
//! It follows the pointers that it is handed as the real kernel does. It makes no system call, so
//! that Miri can watch it.

use std::cell::RefCell;
use std::collections::VecDeque;

use libc::{c_void, mmsghdr, socklen_t};

use super::send::segments;
use super::*;

const TAG: Tag =
    Tag { mapping: MappingId(0), direction: Direction::Response, octets: 0, asks: None };

/// What a receive gets.
enum Arrival {
    Datagram { name: Vec<u8>, control: Vec<u8>, octets: Vec<u8> },
    Error(Errno),
}

/// What becomes of a send.
#[derive(Clone, Copy)]
enum Outcome {
    /// This many messages are taken.
    Takes(usize),
    /// One message is taken without its last octet.
    CutsOne,
    Error(Errno),
}

/// A datagram that left: its destination, its source and its octets.
type Sent = (SocketAddr, Option<IpAddr>, Vec<u8>);

#[derive(Default)]
struct Fake {
    cuts_messages: bool,
    arrivals: RefCell<VecDeque<Arrival>>,
    /// When no outcome is left, everything is taken.
    outcomes: RefCell<VecDeque<Outcome>>,
    sent: RefCell<Vec<Sent>>,
    /// Number of messages in each call to send.
    calls: RefCell<Vec<usize>>,
}

impl Kernel for Fake {
    fn cuts_messages(&self) -> bool {
        self.cuts_messages
    }

    unsafe fn recvmmsg(
        &self,
        _: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize> {
        for index in 0..count {
            let Some((name, control, octets)) = self.arrival(index == 0)? else { return Ok(index) };
            // SAFETY: there are `count` messages, whose pointers lead to so much room.
            unsafe {
                let message = &mut *messages.add(index);
                let header = &mut message.msg_hdr;
                assert_eq!(header.msg_iovlen, 1);
                let room = *header.msg_iov;
                message.msg_len = fill(room.iov_base, room.iov_len, &octets) as _;
                fill(header.msg_name, header.msg_namelen as usize, &name);
                header.msg_namelen = name.len() as socklen_t;
                let written = fill(header.msg_control, header.msg_controllen as _, &control);
                header.msg_controllen = written as _;
            }
        }
        Ok(count)
    }

    unsafe fn recvfrom(
        &self,
        _: BorrowedFd<'_>,
        octets: *mut c_void,
        len: usize,
        name: *mut c_void,
        name_len: *mut socklen_t,
    ) -> nix::Result<usize> {
        let Some((its_name, _, its_octets)) = self.arrival(true)? else {
            return Err(Errno::EAGAIN);
        };
        // SAFETY: there is so much room.
        unsafe {
            fill(name, *name_len as usize, &its_name);
            *name_len = its_name.len() as socklen_t;
            Ok(fill(octets, len, &its_octets))
        }
    }

    unsafe fn sendmmsg(
        &self,
        _: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize> {
        self.calls.borrow_mut().push(count);
        let (taken, cut) = match self.outcomes.borrow_mut().pop_front() {
            None => (count, 0),
            Some(Outcome::Takes(taken)) => (taken, 0),
            Some(Outcome::CutsOne) => (1, 1),
            Some(Outcome::Error(error)) => return Err(error),
        };
        for index in 0..taken.min(count) {
            // SAFETY: there are `count` messages, whose pointers lead to so much.
            unsafe {
                let message = &mut *messages.add(index);
                let header = &message.msg_hdr;
                let name = read(header.msg_name, header.msg_namelen as usize);
                let control = read(header.msg_control, header.msg_controllen as _);
                let mut octets = Vec::new();
                for part in 0..segments(message) {
                    let part = *header.msg_iov.add(part);
                    octets.extend(read(part.iov_base, part.iov_len));
                }
                octets.truncate(octets.len() - cut);
                message.msg_len = octets.len() as _;
                self.note(&name, &control, &octets);
            }
        }
        Ok(taken)
    }

    unsafe fn sendto(
        &self,
        _: BorrowedFd<'_>,
        octets: *const c_void,
        len: usize,
        name: *const c_void,
        name_len: socklen_t,
    ) -> nix::Result<usize> {
        self.calls.borrow_mut().push(1);
        let cut = match self.outcomes.borrow_mut().pop_front() {
            None | Some(Outcome::Takes(_)) => 0,
            Some(Outcome::CutsOne) => 1,
            Some(Outcome::Error(error)) => return Err(error),
        };
        // SAFETY: there is so much to read.
        let (octets, name) = unsafe { (read(octets, len), read(name, name_len as usize)) };
        self.note(&name, &[], &octets[..len - cut]);
        Ok(len - cut)
    }
}

/// Name, control messages and octets of an arrival.
type Came = (Vec<u8>, Vec<u8>, Vec<u8>);

impl Fake {
    /// The next arrival. An error is returned at once when nothing arrived before it, otherwise at
    /// the next call.
    fn arrival(&self, first: bool) -> nix::Result<Option<Came>> {
        let mut arrivals = self.arrivals.borrow_mut();
        match arrivals.pop_front() {
            Some(Arrival::Datagram { name, control, octets }) => Ok(Some((name, control, octets))),
            Some(Arrival::Error(error)) if first => Err(error),
            Some(error) => {
                arrivals.push_front(error);
                Ok(None)
            }
            None if first => Err(Errno::EAGAIN),
            None => Ok(None),
        }
    }

    /// Records what left, cut into datagrams where that was asked for.
    fn note(&self, name: &[u8], control: &[u8], octets: &[u8]) {
        let mut its_name = Name::default();
        // SAFETY: a name of ours fits in a name.
        unsafe { fill(its_name.as_mut_ptr(), Name::CAPACITY as usize, name) };
        let to = its_name.address(name.len() as socklen_t).unwrap();
        let mut its_control = Control::default();
        // SAFETY: control messages of ours fit in a `Control` too.
        unsafe { fill(its_control.as_mut_ptr(), Control::CAPACITY, control) };
        let from = its_control.local_address(control.len());
        let segment = its_control.segment_len(control.len()).map_or(octets.len(), usize::from);
        let mut sent = self.sent.borrow_mut();
        match segment {
            0 => sent.push((to, from, Vec::new())),
            _ => sent.extend(octets.chunks(segment).map(|octets| (to, from, octets.to_vec()))),
        }
    }
}

/// Writes as many octets as there is room for, and returns how many.
unsafe fn fill(room: *mut c_void, len: usize, octets: &[u8]) -> usize {
    let len = len.min(octets.len());
    // SAFETY: the caller promises room for `len` octets.
    unsafe { ptr::copy_nonoverlapping(octets.as_ptr(), room.cast(), len) };
    len
}

unsafe fn read(octets: *const c_void, len: usize) -> Vec<u8> {
    if len == 0 {
        return Vec::new();
    }
    // SAFETY: the caller promises `len` octets.
    unsafe { std::slice::from_raw_parts(octets.cast::<u8>(), len) }.to_vec()
}

fn socket() -> BorrowedFd<'static> {
    // SAFETY: the kernel that is played here looks at no socket.
    unsafe { BorrowedFd::borrow_raw(1) }
}

/// A datagram from `from` to `to`.
fn datagram(from: &str, to: &str, octets: &[u8]) -> Arrival {
    let (mut name, mut control) = (Name::default(), Control::default());
    let name_len = name.set(from.parse().unwrap()) as usize;
    let control_len = control.set_source(to.parse().unwrap());
    // SAFETY: both are as long.
    let name = unsafe { read(name.as_ptr(), name_len) };
    Arrival::Datagram {
        name,
        control: control.octets(control_len).to_vec(),
        octets: octets.to_vec(),
    }
}

fn batch(arrivals: impl IntoIterator<Item = Arrival>) -> Batch<Fake> {
    let arrivals = RefCell::new(arrivals.into_iter().collect());
    Batch::on(Fake { arrivals, cuts_messages: true, ..Fake::default() })
}

/// What a receive of at most so many gets: sender, local address and octets.
fn received(batch: &mut Batch<Fake>, most: usize, destination: Destination) -> Vec<Sent> {
    let mut received = batch.receive(socket(), most, destination).unwrap();
    let mut told = Vec::new();
    while let Some(Incoming { from, to, payload }) = received.next_datagram() {
        told.push((from, to, payload.to_vec()));
    }
    told
}

fn came(from: &str, to: Option<&str>, octets: &[u8]) -> Sent {
    (from.parse().unwrap(), to.map(|to| to.parse().unwrap()), octets.to_vec())
}

#[test]
fn many_are_received_at_once() {
    let v4 = || datagram("198.51.100.7:1", "198.51.100.1", &[4; 38]);
    let v6 = || datagram("[2001:db8::7]:1", "2001:db8::1", &[]);
    let mut batch =
        batch([v4(), v6(), datagram("198.51.100.7:1", "198.51.100.1", &[7; 300]), v4()]);
    let first = came("198.51.100.7:1", Some("198.51.100.1"), &[4; 38]);
    let expected = [
        first.clone(),
        came("[2001:db8::7]:1", Some("2001:db8::1"), &[]),
        came("198.51.100.7:1", Some("198.51.100.1"), &[7; SHORT]),
    ];
    assert_eq!(received(&mut batch, 3, Destination::FromControl), expected);
    assert_eq!(received(&mut batch, AT_ONCE, Destination::FromControl), [first]);
    assert_eq!(received(&mut batch, AT_ONCE, Destination::FromControl), []);
    assert_eq!(batch.used, 4, "all stay in their slots");
}

#[test]
fn one_is_received_like_many() {
    let v6 = || datagram("[2001:db8::7]:1", "2001:db8::1", &[6; 38]);
    let mut batch = batch([v6(), Arrival::Error(Errno::EINTR), v6()]);
    for tells in [false, true] {
        let to = tells.then_some("2001:db8::1");
        let expected = came("[2001:db8::7]:1", to, &[6; 38]);
        assert_eq!(received(&mut batch, 1, destination(tells)), [expected]);
    }
    for tells in [false, true] {
        assert_eq!(received(&mut batch, 1, destination(tells)), []);
    }
}

/// What the slot held before is not taken for part of the new datagram.
#[test]
fn what_the_kernel_cut_short_tells_nothing() {
    let whole = datagram("[2001:db8::7]:1", "2001:db8::1", &[6; 38]);
    let Arrival::Datagram { name, control, octets } = whole else { unreachable!() };
    let with = |name: &[u8], control: &[u8]| Arrival::Datagram {
        name: name.to_vec(),
        control: control.to_vec(),
        octets: octets.clone(),
    };
    for len in [0, 1, control.len() - 9] {
        let mut batch = batch([with(&name, &control), with(&name, &control[..len])]);
        assert_eq!(received(&mut batch, 1, Destination::FromControl).len(), 1);
        flush(&mut batch); // frees the slot
        let unknown = came("[2001:db8::7]:1", None, &octets);
        let second = received(&mut batch, 1, Destination::FromControl);
        assert_eq!(second, [unknown], "{len} octets of control messages");
    }
    let other_family = [&[1, 0][..], &name[2..]].concat();
    for name_now in
        [&name[..0], &name[..2], &name[..27], &[&name[..], &[0; 8]].concat(), &other_family]
    {
        for tells in [false, true] {
            let mut batch = batch([with(&name, &control), with(name_now, &control)]);
            assert_eq!(received(&mut batch, 1, destination(tells)).len(), 1);
            flush(&mut batch);
            let mut second = batch.receive(socket(), 1, destination(tells)).unwrap();
            assert_eq!(second.count(), 1);
            assert!(second.next_datagram().is_none(), "{name_now:?}");
        }
    }
}

#[test]
fn errors_of_a_receive_come_after_what_was_received() {
    let v4 = || datagram("198.51.100.7:1", "198.51.100.1", &[4; 38]);
    let error = |error| Arrival::Error(error);
    let mut batch = batch([error(Errno::EINTR), v4(), error(Errno::ENOMEM), v4()]);
    assert_eq!(received(&mut batch, AT_ONCE, Destination::FromControl).len(), 1);
    let refused = batch.receive(socket(), AT_ONCE, Destination::FromControl).err().unwrap();
    assert_eq!(refused.raw_os_error(), Some(libc::ENOMEM));
    assert_eq!(received(&mut batch, AT_ONCE, Destination::FromControl).len(), 1);
}

/// The batch receives until it is full, from one turn to the next, and may be moved in memory
/// before it sends.
#[test]
fn what_was_received_is_sent_on() {
    let number = |n: usize| [(n >> 8) as u8, n as u8];
    let octets = |n: usize| [&number(n)[..], &vec![9; n % 100]].concat();
    let arrivals =
        (0..Batch::<Fake>::SLOTS).map(|n| datagram("198.51.100.7:1", "198.51.100.1", &octets(n)));
    let mut batch = batch(arrivals);
    let (server, source): (SocketAddr, IpAddr) =
        ("172.17.17.4:34379".parse().unwrap(), "198.51.100.1".parse().unwrap());
    let mut expected = Vec::new();
    for turn in 0.. {
        let most = [1, 4, 16, AT_ONCE][turn % 4];
        let mut received = batch.receive(socket(), most, destination(turn % 3 > 0)).unwrap();
        let is_over = received.count() == 0;
        while let Some(Incoming { payload: mut octets, .. }) = received.next_datagram() {
            octets[0] ^= 0x80; // as a password is replaced
            let (key, len) = (u64::from(octets[1] & 1), octets.len());
            expected.push((key, octets.to_vec()));
            let from = (key == 1).then_some(source);
            received.queue(key, from, server, Tag { octets: len, ..TAG });
        }
        drop(received);
        if batch.is_full() || is_over {
            batch = *Box::new(batch);
            assert_eq!(flush(&mut batch), vec![Ok(()); expected.len()]);
            expected.sort_by_key(|(key, _)| *key);
            let expected = mem::take(&mut expected).into_iter();
            let expected: Vec<Sent> = expected
                .map(|(key, octets)| (server, (key == 1).then_some(source), octets))
                .collect();
            assert_eq!(batch.kernel.sent.take(), expected);
        }
        if is_over {
            break;
        }
    }
}

/// Sends what is queued, and returns what was reported.
fn flush(batch: &mut Batch<Fake>) -> Vec<Result<(), Option<i32>>> {
    let mut outcomes = Vec::new();
    let report = |_: Tag, outcome: io::Result<()>| {
        outcomes.push(outcome.map_err(|error| error.raw_os_error()));
    };
    batch.flush(|_| Some(socket()), report);
    outcomes
}

/// Queues datagrams of these lengths to one receiver, with a source address. Each is filled with
/// its number.
fn queue(batch: &mut Batch<Fake>, to: &str, lengths: &[usize]) {
    for (number, &octets) in (0..).zip(lengths) {
        let slot = batch.used;
        batch.octets[slot].0[..octets].fill(number);
        let from = Some("198.51.100.1".parse().unwrap());
        batch.queue(slot, 1, from, to.parse().unwrap(), Tag { octets, ..TAG });
        batch.used += 1;
    }
}

const OTHER: [&str; 4] = ["192.0.2.1:1", "192.0.2.2:1", "192.0.2.3:1", "192.0.2.4:1"];

#[test]
fn a_send_that_takes_some_goes_on_with_the_rest() {
    let eagain = Err(Some(libc::EAGAIN));
    for (outcomes, expected, calls) in [
        (vec![], vec![Ok(()); 4], vec![4]),
        (vec![Outcome::Takes(1), Outcome::Takes(2)], vec![Ok(()); 4], vec![4, 3, 1]),
        (vec![Outcome::Error(Errno::EINTR); 2], vec![Ok(()); 4], vec![4, 4, 4]),
        (
            vec![Outcome::Takes(1), Outcome::Error(Errno::EAGAIN)],
            vec![Ok(()), eagain, Ok(()), Ok(())],
            vec![4, 3, 2],
        ),
        (vec![Outcome::Error(Errno::EAGAIN); 4], vec![eagain; 4], vec![4, 3, 2, 1]),
        // The real kernel has never been seen to do this.
        (vec![Outcome::Takes(0)], vec![eagain, Ok(()), Ok(()), Ok(())], vec![4, 3]),
        (vec![Outcome::Takes(5)], vec![Ok(()); 4], vec![4]),
        (
            vec![Outcome::Takes(2), Outcome::CutsOne],
            vec![Ok(()), Ok(()), Err(Some(libc::EMSGSIZE)), Ok(())],
            vec![4, 2, 1],
        ),
    ] {
        let mut batch = batch([]);
        batch.kernel.outcomes = RefCell::new(outcomes.into());
        for to in OTHER {
            queue(&mut batch, to, &[38]);
        }
        assert_eq!(flush(&mut batch), expected);
        assert_eq!(batch.kernel.calls.take(), calls);
        let sent = expected.iter().filter(|outcome| **outcome != eagain).count();
        assert_eq!(batch.kernel.sent.borrow().len(), sent);
    }
}

#[test]
fn one_alone_is_sent_like_many() {
    for (outcomes, expected) in [
        (vec![], Ok(())),
        (vec![Outcome::Error(Errno::EINTR)], Ok(())),
        (vec![Outcome::Error(Errno::EPERM)], Err(Some(libc::EPERM))),
        (vec![Outcome::CutsOne], Err(Some(libc::EMSGSIZE))),
    ] {
        let mut batch = batch([]);
        batch.kernel.outcomes = RefCell::new(outcomes.into());
        batch.queue(0, 1, None, OTHER[0].parse().unwrap(), Tag { octets: 38, ..TAG });
        batch.used += 1;
        assert_eq!(flush(&mut batch), [expected]);
    }
}

#[test]
fn a_burst_leaves_as_one_message() {
    let mut batch = batch([]);
    queue(&mut batch, OTHER[0], &[38, 38, 38, 20, 38, 0, 0]);
    assert_eq!(flush(&mut batch), [Ok(()); 7]);
    assert_eq!(*batch.kernel.calls.borrow(), [4], "one that is empty has a message of its own");
    let lengths: Vec<_> = batch.kernel.sent.borrow().iter().map(|sent| sent.2.clone()).collect();
    let expected: Vec<Vec<u8>> =
        (0..).zip([38, 38, 38, 20, 38, 0, 0]).map(|(n, len)| vec![n; len]).collect();
    assert_eq!(lengths, expected);
}

/// After a refusal each datagram is tried alone. The next burst leaves as one message again, unless
/// the error says that some way out does not compute checksums.
#[test]
fn a_burst_that_is_refused_leaves_one_by_one() {
    for (error, again) in
        [(Errno::EIO, false), (Errno::EMSGSIZE, true), (Errno::EPERM, true), (Errno::ENOBUFS, true)]
    {
        let mut batch = batch([]);
        let outcomes = [Outcome::Takes(1), Outcome::Error(error), Outcome::Takes(2)];
        batch.kernel.outcomes = RefCell::new(outcomes.into());
        queue(&mut batch, OTHER[0], &[38; 2]);
        queue(&mut batch, OTHER[1], &[38; 3]);
        assert_eq!(flush(&mut batch), [Ok(()); 5]);
        assert_eq!(batch.kernel.calls.take(), [2, 1, 3, 1]);
        let sent: Vec<_> = batch.kernel.sent.take().into_iter().map(|sent| sent.2).collect();
        let octets = |n: u8| vec![n; 38];
        assert_eq!(sent, [octets(0), octets(1), octets(0), octets(1), octets(2)]);

        queue(&mut batch, OTHER[0], &[38; 3]);
        assert_eq!(flush(&mut batch), [Ok(()); 3]);
        assert_eq!(batch.kernel.calls.take(), [if again { 1 } else { 3 }]);
    }
}

#[test]
fn what_has_no_socket_any_more_is_reported() {
    let mut batch = batch([]);
    queue(&mut batch, OTHER[0], &[38; 2]);
    let mut refused = 0;
    batch.flush(|_| None, |_, outcome| refused += usize::from(outcome.is_err()));
    assert_eq!(refused, 2);
    assert!(batch.kernel.sent.borrow().is_empty());
}

/// How a socket is asked: one that tells the destination, or one that does not.
pub(super) fn destination(tells: bool) -> Destination {
    if tells { Destination::FromControl } else { Destination::Bound }
}
