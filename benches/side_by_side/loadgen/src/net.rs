//! Linux' calls for many datagrams or many sockets at once. All unsafe code is here.
//!
//! Every pointer in a [`Batch`] leads into one of its own vectors, none of which ever grows.

use std::io;
use std::mem::{self, MaybeUninit};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::ops::Range;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::ptr;
use std::time::Duration;

/// Datagrams in a batch.
pub const BATCH: usize = 64;
/// Octets of a datagram that are kept.
const SLOT: usize = 128;
/// Room for one IP_PKTINFO.
const CONTROL: usize = 32;

/// A UDP socket that does not block, with room for bursts; root may go past rmem_max.
pub fn socket(address: SocketAddrV4) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    for option in [libc::SO_RCVBUFFORCE, libc::SO_SNDBUFFORCE] {
        set_option(&socket, libc::SOL_SOCKET, option, &(4 << 20))?;
    }
    Ok(socket)
}

/// Lets the local address of each datagram be told, and be chosen for the answer.
pub fn tell_local_address(socket: &UdpSocket) -> io::Result<()> {
    set_option(socket, libc::IPPROTO_IP, libc::IP_PKTINFO, &1)
}

/// Attaches a classic BPF program, given as (code, jump if true, jump if false, constant).
pub fn attach_filter(socket: &UdpSocket, program: &[(u16, u8, u8, u32)]) -> io::Result<()> {
    let step = |&(code, jt, jf, k): &_| libc::sock_filter { code, jt, jf, k };
    let mut steps: Vec<_> = program.iter().map(step).collect();
    let program = libc::sock_fprog { len: steps.len() as u16, filter: steps.as_mut_ptr() };
    set_option(socket, libc::SOL_SOCKET, libc::SO_ATTACH_FILTER, &program)
}

fn set_option<T>(socket: &UdpSocket, level: i32, option: i32, value: &T) -> io::Result<()> {
    // SAFETY: the value is readable for the length that is given.
    check(unsafe {
        let length = mem::size_of::<T>() as u32;
        libc::setsockopt(socket.as_raw_fd(), level, option, ptr::from_ref(value).cast(), length)
    })?;
    Ok(())
}

/// As many file descriptors as allowed, and timers that fire when asked.
pub fn prepare_process() -> io::Result<()> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the limit is written and read within the calls.
    unsafe {
        check(libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit))?;
        limit.rlim_cur = limit.rlim_max;
        check(libc::setrlimit(libc::RLIMIT_NOFILE, &limit))?;
        check(libc::prctl(libc::PR_SET_TIMERSLACK, 1000))?;
    }
    Ok(())
}

/// Nanoseconds of the monotonic clock.
pub fn now() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the time is written within the call, which cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) };
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Calls `handler` on SIGTERM. It may do nothing but set a flag.
pub fn on_sigterm(handler: extern "C" fn(libc::c_int)) {
    // SAFETY: an atomic store is all that the handler does. There is no SA_RESTART, so a wait ends.
    unsafe {
        let mut action: libc::sigaction = mem::zeroed();
        action.sa_sigaction = handler as *const () as usize;
        libc::sigaction(libc::SIGTERM, &action, ptr::null_mut());
    }
}

fn check(result: libc::c_int) -> io::Result<libc::c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

/// Waits for sockets.
pub struct Epoll {
    epoll: OwnedFd,
    events: [libc::epoll_event; 256],
}

impl Epoll {
    pub fn new() -> io::Result<Self> {
        // SAFETY: the descriptor is new and nobody else's.
        let epoll =
            unsafe { OwnedFd::from_raw_fd(check(libc::epoll_create1(libc::EPOLL_CLOEXEC))?) };
        Ok(Self { epoll, events: [libc::epoll_event { events: 0, u64: 0 }; 256] })
    }

    /// Watches a socket, which is called `index` from here on.
    pub fn add(&self, socket: &UdpSocket, index: usize) -> io::Result<()> {
        let mut event = libc::epoll_event { events: libc::EPOLLIN as u32, u64: index as u64 };
        let (epoll, socket) = (self.epoll.as_raw_fd(), socket.as_raw_fd());
        // SAFETY: the event is read within the call.
        check(unsafe { libc::epoll_ctl(epoll, libc::EPOLL_CTL_ADD, socket, &mut event) })?;
        Ok(())
    }

    /// Waits so long at most and tells how many sockets can be read.
    pub fn wait(&mut self, limit: Option<Duration>) -> usize {
        let limit = limit.map(|limit| libc::timespec {
            tv_sec: limit.as_secs() as i64,
            tv_nsec: limit.subsec_nanos().into(),
        });
        // SAFETY: the kernel writes at most as many events as there is room for.
        let ready = unsafe {
            libc::syscall(
                libc::SYS_epoll_pwait2,
                self.epoll.as_raw_fd(),
                self.events.as_mut_ptr(),
                self.events.len() as libc::c_int,
                limit.as_ref().map_or(ptr::null(), ptr::from_ref),
                ptr::null::<libc::sigset_t>(),
                8usize,
            )
        };
        ready.max(0) as usize
    }

    /// The socket behind one of these events.
    pub fn index(&self, event: usize) -> usize {
        self.events[event].u64 as usize
    }
}

/// Datagrams for one recvmmsg or sendmmsg.
pub struct Batch {
    headers: Vec<libc::mmsghdr>,
    parts: Vec<libc::iovec>,
    names: Vec<libc::sockaddr_in>,
    controls: Vec<[u64; CONTROL / 8]>,
    octets: Vec<u8>,
    /// Control messages are wanted.
    control: bool,
    /// So many of them are not as receiving needs them.
    used: usize,
}

/// Where datagrams are sent.
#[derive(Clone, Copy)]
pub enum To {
    /// To the peer of the connected socket.
    Peer,
    /// To the address that the batch has for each of them.
    Each,
}

impl Batch {
    /// An empty batch; with `control`, local addresses are received and sent along.
    pub fn new(control: bool) -> Self {
        // SAFETY: all three are plain C structures, for which zeros are a value.
        let (header, name) =
            unsafe { (MaybeUninit::zeroed().assume_init(), MaybeUninit::zeroed().assume_init()) };
        let mut batch = Self {
            headers: vec![header; BATCH],
            parts: vec![libc::iovec { iov_base: ptr::null_mut(), iov_len: 0 }; BATCH],
            names: vec![name; BATCH],
            controls: vec![[0; CONTROL / 8]; BATCH],
            octets: vec![0; BATCH * SLOT],
            control,
            used: BATCH,
        };
        for index in 0..BATCH {
            batch.parts[index].iov_base = batch.octets[index * SLOT..].as_mut_ptr().cast();
            let header = &mut batch.headers[index].msg_hdr;
            header.msg_iov = &mut batch.parts[index];
            header.msg_iovlen = 1;
            header.msg_control = batch.controls[index].as_mut_ptr().cast();
        }
        batch
    }

    /// Takes what the socket has, and tells how many datagrams that were.
    pub fn receive(&mut self, socket: &UdpSocket) -> usize {
        for index in 0..self.used {
            self.parts[index].iov_len = SLOT;
            self.address_to(index, To::Each);
        }
        let flags = libc::MSG_DONTWAIT as _;
        // SAFETY: every pointer leads to memory of this batch, of the length beside it.
        let received = unsafe {
            let headers = self.headers.as_mut_ptr();
            libc::recvmmsg(socket.as_raw_fd(), headers, BATCH as u32, flags, ptr::null_mut())
        };
        let received = received.max(0) as usize;
        self.used = received;
        for index in 0..received {
            self.parts[index].iov_len = self.headers[index].msg_len as usize;
        }
        received
    }

    /// Sends those datagrams and tells how many the kernel took. One that it refuses is skipped.
    pub fn send(&mut self, socket: &UdpSocket, range: Range<usize>, to: To) -> usize {
        self.used = self.used.max(range.end);
        range.clone().for_each(|index| self.address_to(index, to));
        let (mut next, mut taken, mut errors) = (range.start, 0, 0);
        while next < range.end {
            match self.send_some(socket.as_raw_fd(), next..range.end) {
                Ok(sent) => (next, taken) = (next + sent, taken + sent),
                // An earlier datagram's ICMP error is told once; this one was not tried yet.
                Err(libc::EINTR | libc::ECONNREFUSED) if errors < 4 => errors += 1,
                Err(_) => next += 1,
            }
        }
        taken
    }

    /// The datagram, as received or as set.
    pub fn octets(&self, index: usize) -> &[u8] {
        &self.octets[index * SLOT..][..self.parts[index].iov_len]
    }

    /// Room for a datagram of this length.
    pub fn room(&mut self, index: usize, length: usize) -> &mut [u8] {
        self.used = self.used.max(index + 1);
        self.parts[index].iov_len = length;
        &mut self.octets[index * SLOT..][..length]
    }

    /// Who sent the datagram.
    pub fn peer(&self, index: usize) -> SocketAddrV4 {
        let name = &self.names[index];
        let address = Ipv4Addr::from_bits(u32::from_be(name.sin_addr.s_addr));
        SocketAddrV4::new(address, u16::from_be(name.sin_port))
    }

    /// Sets where the datagram goes.
    pub fn set_peer(&mut self, index: usize, peer: SocketAddrV4) {
        let name = &mut self.names[index];
        name.sin_family = libc::AF_INET as u16;
        name.sin_port = peer.port().to_be();
        name.sin_addr.s_addr = peer.ip().to_bits().to_be();
    }

    /// The local address that a received datagram was sent to; its answer will leave from there.
    pub fn local_address(&mut self, index: usize) -> Ipv4Addr {
        // SAFETY: the one control message that was asked for is IP_PKTINFO, behind a header of 16
        // octets, and there is room for it. Zeros, too, are a value.
        let info =
            unsafe { &mut *self.controls[index].as_mut_ptr().add(2).cast::<libc::in_pktinfo>() };
        info.ipi_ifindex = 0; // by whatever interface leads back
        Ipv4Addr::from_bits(u32::from_be(info.ipi_spec_dst.s_addr))
    }

    fn address_to(&mut self, index: usize, to: To) {
        let header = &mut self.headers[index].msg_hdr;
        (header.msg_name, header.msg_namelen) = match to {
            To::Peer => (ptr::null_mut(), 0),
            To::Each => (
                ptr::from_mut(&mut self.names[index]).cast(),
                mem::size_of::<libc::sockaddr_in>() as u32,
            ),
        };
        header.msg_controllen = if self.control { CONTROL as _ } else { 0 };
        header.msg_flags = 0;
    }

    fn send_some(&mut self, socket: RawFd, range: Range<usize>) -> Result<usize, i32> {
        let headers = &mut self.headers[range];
        // SAFETY: every pointer leads to memory of this batch, of the length beside it.
        let sent = unsafe { libc::sendmmsg(socket, headers.as_mut_ptr(), headers.len() as u32, 0) };
        let error = || io::Error::last_os_error().raw_os_error().unwrap_or(0);
        if sent < 0 { Err(error()) } else { Ok(sent as usize) }
    }
}
