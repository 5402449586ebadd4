//! Socket addresses and control messages in the memory layout of the kernel.

use std::iter;
use std::mem;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, SocketAddrV6};
use std::ptr;

/// A sender's or receiver's address, IPv4 or IPv6.
#[derive(Clone, Copy)]
#[repr(C)]
pub(in crate::datapath) union Name {
    family: libc::sa_family_t,
    v4: libc::sockaddr_in,
    v6: libc::sockaddr_in6,
}

impl Default for Name {
    fn default() -> Self {
        // SAFETY: the largest variant is plain integers; all zero is a valid value.
        Self { v6: unsafe { mem::zeroed() } }
    }
}

impl Name {
    pub(in crate::datapath) const CAPACITY: libc::socklen_t = size_of::<Self>() as libc::socklen_t;

    pub(in crate::datapath) fn as_ptr(&self) -> *const libc::c_void {
        ptr::from_ref(self).cast()
    }

    pub(in crate::datapath) fn as_mut_ptr(&mut self) -> *mut libc::c_void {
        ptr::from_mut(self).cast()
    }

    /// Reads the address that the kernel wrote in `len` octets.
    #[inline]
    pub(in crate::datapath) fn address(&self, len: libc::socklen_t) -> Option<SocketAddr> {
        if len > Self::CAPACITY {
            return None; // cut short: of a family that is not known here
        }
        // SAFETY: every variant begins with the family, and all octets are initialised.
        let family = libc::c_int::from(unsafe { self.family });
        if family == libc::AF_INET && len as usize >= size_of::<libc::sockaddr_in>() {
            // SAFETY: plain integers, initialised; the family says which variant was written.
            let v4 = unsafe { self.v4 };
            let address = Ipv4Addr::from(v4.sin_addr.s_addr.to_ne_bytes());
            return Some(SocketAddrV4::new(address, u16::from_be(v4.sin_port)).into());
        }
        if family == libc::AF_INET6 && len as usize >= size_of::<libc::sockaddr_in6>() {
            // SAFETY: as above.
            let v6 = unsafe { self.v6 };
            let (address, port) = (v6.sin6_addr.s6_addr.into(), u16::from_be(v6.sin6_port));
            return Some(SocketAddrV6::new(address, port, 0, v6.sin6_scope_id).into());
        }
        None
    }

    /// Writes an address and returns the number of octets that it takes.
    #[inline]
    pub(in crate::datapath) fn set(&mut self, address: SocketAddr) -> libc::socklen_t {
        match address {
            SocketAddr::V4(address) => {
                self.v4 = libc::sockaddr_in {
                    sin_family: libc::AF_INET as libc::sa_family_t,
                    sin_port: address.port().to_be(),
                    sin_addr: in_addr(*address.ip()),
                    sin_zero: [0; 8],
                };
                size_of::<libc::sockaddr_in>() as libc::socklen_t
            }
            SocketAddr::V6(address) => {
                self.v6 = libc::sockaddr_in6 {
                    sin6_family: libc::AF_INET6 as libc::sa_family_t,
                    sin6_port: address.port().to_be(),
                    sin6_flowinfo: 0,
                    sin6_addr: in6_addr(*address.ip()),
                    sin6_scope_id: address.scope_id(),
                };
                size_of::<libc::sockaddr_in6>() as libc::socklen_t
            }
        }
    }
}

/// Room for control messages. One tells the local address of a datagram, in or out. On the way out,
/// another tells the length of the datagrams that leave as one message.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
pub(in crate::datapath) struct Control([u8; Control::CAPACITY]);

/// Where the content of a control message begins, counted from the message.
const CONTENT: usize = message_len(0);

// The kernel reads and writes headers in place, and nothing that the relay writes goes beyond the
// room.
const _: () = {
    assert!(align_of::<Control>() >= align_of::<libc::cmsghdr>());
    assert!(size_of::<Control>() == Control::CAPACITY);
    assert!(CONTENT >= size_of::<libc::cmsghdr>());
    assert!(size_of::<libc::in_pktinfo>() == 12 && size_of::<libc::in6_pktinfo>() == 20);
};

/// Octets of a control message with this much content, without what follows it.
const fn message_len(content: usize) -> usize {
    // SAFETY: it only computes.
    (unsafe { libc::CMSG_LEN(content as libc::c_uint) }) as usize
}

/// Octets from a control message with this much content to the next message.
const fn message_space(content: usize) -> usize {
    // SAFETY: as above.
    (unsafe { libc::CMSG_SPACE(content as libc::c_uint) }) as usize
}

/// One control message.
struct Message<'a> {
    level: libc::c_int,
    kind: libc::c_int,
    content: &'a [u8],
}

impl Default for Control {
    fn default() -> Self {
        Self([0; Self::CAPACITY])
    }
}

impl Control {
    pub(in crate::datapath) const CAPACITY: usize =
        message_space(size_of::<libc::in6_pktinfo>()) + message_space(size_of::<u16>());

    pub(in crate::datapath) fn as_mut_ptr(&mut self) -> *mut libc::c_void {
        ptr::from_mut(self).cast()
    }

    /// The first `len` octets.
    #[inline]
    pub(in crate::datapath) fn octets(&self, len: usize) -> &[u8] {
        &self.0[..len.min(Self::CAPACITY)]
    }

    /// Reads the local address that a datagram was sent to, from the `len` octets that the kernel
    /// wrote.
    ///
    /// There is none when the socket was not asked to tell it, when the message was cut short, or
    /// when the datagram was sent to a broadcast or multicast address. For such a datagram, IPv4
    /// names another address to answer from than the one in the datagram's header.
    #[inline]
    pub(in crate::datapath) fn local_address(&self, len: usize) -> Option<IpAddr> {
        self.messages(len).find_map(|message| match (message.level, message.kind) {
            (libc::IPPROTO_IP, libc::IP_PKTINFO) => {
                // SAFETY: plain integers.
                let info = unsafe { message.content::<libc::in_pktinfo>() }?;
                let (local, header) = (info.ipi_spec_dst.s_addr, info.ipi_addr.s_addr);
                (local == header).then(|| Ipv4Addr::from(local.to_ne_bytes()).into())
            }
            (libc::IPPROTO_IPV6, libc::IPV6_PKTINFO) => {
                // SAFETY: plain integers.
                let info = unsafe { message.content::<libc::in6_pktinfo>() }?;
                let header = Ipv6Addr::from(info.ipi6_addr.s6_addr);
                (!header.is_multicast()).then(|| header.into())
            }
            _ => None,
        })
    }

    /// The control messages in the first `len` octets, up to one that does not lie within them.
    fn messages(&self, len: usize) -> impl Iterator<Item = Message<'_>> {
        let mut rest = self.octets(len);
        iter::from_fn(move || {
            let header = rest.get(..size_of::<libc::cmsghdr>())?.as_ptr().cast::<libc::cmsghdr>();
            // SAFETY: the header lies within `rest`; it is plain integers, and need not be aligned.
            let header = unsafe { header.read_unaligned() };
            let len: usize = header.cmsg_len as _; // the C libraries disagree on the type
            let content = rest.get(CONTENT..len)?;
            rest = rest.get(message_space(content.len())..).unwrap_or_default();
            Some(Message { level: header.cmsg_level, kind: header.cmsg_type, content })
        })
    }

    /// Writes the message that makes a datagram leave from `source`, and returns the number of
    /// octets that it takes. Routing picks the interface.
    #[inline]
    pub(in crate::datapath) fn set_source(&mut self, source: IpAddr) -> usize {
        match source {
            IpAddr::V4(source) => {
                let info = libc::in_pktinfo {
                    ipi_ifindex: 0,
                    ipi_spec_dst: in_addr(source),
                    ipi_addr: in_addr(source), // the kernel ignores it
                };
                self.put(0, libc::IPPROTO_IP, libc::IP_PKTINFO, info)
            }
            IpAddr::V6(source) => {
                let info = libc::in6_pktinfo { ipi6_addr: in6_addr(source), ipi6_ifindex: 0 };
                self.put(0, libc::IPPROTO_IPV6, libc::IPV6_PKTINFO, info)
            }
        }
    }

    /// Adds the message that makes the kernel cut what is sent into datagrams of `octets` octets.
    /// It stands behind the `len` octets of [`set_source`](Self::set_source). Returns the number of
    /// octets that both messages take.
    #[inline]
    pub(in crate::datapath) fn add_segment_len(&mut self, len: usize, octets: u16) -> usize {
        self.put(len, libc::SOL_UDP, libc::UDP_SEGMENT, octets)
    }

    /// Writes a message behind the first `at` octets, and returns where the next message would
    /// begin.
    #[inline]
    fn put<T: Copy>(&mut self, at: usize, level: i32, kind: i32, content: T) -> usize {
        let end = at + message_space(size_of::<T>());
        let room = &mut self.0[at..end];
        // SAFETY: a header of plain integers, for which all zero is valid.
        let mut header: libc::cmsghdr = unsafe { mem::zeroed() };
        header.cmsg_level = level;
        header.cmsg_type = kind;
        header.cmsg_len = message_len(size_of::<T>()) as _;
        let place = room.as_mut_ptr();
        // SAFETY: `room` holds a header, and behind it the content; neither need be aligned.
        unsafe {
            place.cast::<libc::cmsghdr>().write_unaligned(header);
            place.add(CONTENT).cast::<T>().write_unaligned(content);
        }
        end
    }
}

impl Message<'_> {
    /// The content of the message, if the message is long enough.
    ///
    /// # Safety
    ///
    /// Any octets are a valid `T`.
    #[inline]
    unsafe fn content<T: Copy>(&self) -> Option<T> {
        let content = self.content.get(..size_of::<T>())?;
        // SAFETY: as many octets as `T` has are there, which need not be aligned; the caller
        // promises the rest.
        Some(unsafe { content.as_ptr().cast::<T>().read_unaligned() })
    }
}

pub(in crate::datapath) fn in_addr(address: Ipv4Addr) -> libc::in_addr {
    libc::in_addr { s_addr: u32::from_ne_bytes(address.octets()) }
}

pub(in crate::datapath) fn in6_addr(address: Ipv6Addr) -> libc::in6_addr {
    libc::in6_addr { s6_addr: address.octets() }
}

#[cfg(test)]
mod tests;
