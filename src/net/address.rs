//! Socket addresses and control messages in the kernel's layout.

use std::mem;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, SocketAddrV6};
use std::ptr;

/// A sender's or receiver's address, IPv4 or IPv6.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) union Name {
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
    pub(super) const CAPACITY: libc::socklen_t = size_of::<Self>() as libc::socklen_t;

    pub(super) fn as_mut_ptr(&mut self) -> *mut libc::c_void {
        ptr::from_mut(self).cast()
    }

    /// The address that the kernel wrote in `len` octets.
    #[inline]
    pub(super) fn address(&self, len: libc::socklen_t) -> Option<SocketAddr> {
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

    /// Writes an address and returns the octets it takes.
    #[inline]
    pub(super) fn set(&mut self, address: SocketAddr) -> libc::socklen_t {
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

/// Room for control messages: the local address of a datagram, in or out, and on the way out the
/// length of the datagrams that leave as one.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Control {
    header: libc::cmsghdr,
    local: Local,
    /// Room for [`add_segment_len`](Self::add_segment_len), whose place depends on what stands
    /// before it.
    more: [libc::cmsghdr; 2],
}

#[derive(Clone, Copy)]
#[repr(C)]
union Local {
    v4: libc::in_pktinfo,
    v6: libc::in6_pktinfo,
}

/// Where a control message's content begins: right behind its header, on this and every other
/// platform whose header is a multiple of the alignment.
const CONTENT: usize = size_of::<libc::cmsghdr>();

impl Default for Control {
    fn default() -> Self {
        // SAFETY: plain integers; all zero is a valid value.
        unsafe { mem::zeroed() }
    }
}

impl Control {
    pub(super) const CAPACITY: usize = size_of::<Self>();

    pub(super) fn as_mut_ptr(&mut self) -> *mut libc::c_void {
        ptr::from_mut(self).cast()
    }

    /// The local address in the `len` octets that the kernel wrote; none for a socket that was not
    /// asked to tell.
    #[inline]
    pub(super) fn local_address(&self, len: usize) -> Option<IpAddr> {
        if len < CONTENT + size_of::<libc::in_pktinfo>() {
            return None;
        }
        match (self.header.cmsg_level, self.header.cmsg_type) {
            (libc::IPPROTO_IP, libc::IP_PKTINFO) => {
                // SAFETY: plain integers, initialised; level and type say which variant it is.
                let info = unsafe { self.local.v4 };
                Some(Ipv4Addr::from(info.ipi_spec_dst.s_addr.to_ne_bytes()).into())
            }
            (libc::IPPROTO_IPV6, libc::IPV6_PKTINFO) => {
                // SAFETY: as above.
                let info = unsafe { self.local.v6 };
                Some(Ipv6Addr::from(info.ipi6_addr.s6_addr).into())
            }
            _ => None,
        }
    }

    /// Writes the message that makes a datagram leave from `source`, by whichever interface routing
    /// picks, and returns the octets it takes.
    #[inline]
    pub(super) fn set_source(&mut self, source: IpAddr) -> usize {
        let (level, kind, len) = match source {
            IpAddr::V4(source) => {
                self.local.v4 = libc::in_pktinfo {
                    ipi_ifindex: 0,
                    ipi_spec_dst: in_addr(source),
                    ipi_addr: in_addr(Ipv4Addr::UNSPECIFIED),
                };
                (libc::IPPROTO_IP, libc::IP_PKTINFO, size_of::<libc::in_pktinfo>())
            }
            IpAddr::V6(source) => {
                self.local.v6 = libc::in6_pktinfo { ipi6_addr: in6_addr(source), ipi6_ifindex: 0 };
                (libc::IPPROTO_IPV6, libc::IPV6_PKTINFO, size_of::<libc::in6_pktinfo>())
            }
        };
        self.header.cmsg_level = level;
        self.header.cmsg_type = kind;
        self.header.cmsg_len = (CONTENT + len) as _;
        (CONTENT + len).next_multiple_of(align_of::<libc::cmsghdr>())
    }

    /// Adds, behind the `len` octets of [`set_source`](Self::set_source), the message that makes
    /// the kernel cut what is sent into datagrams of so many octets, and returns the octets that
    /// both take.
    #[inline]
    pub(super) fn add_segment_len(&mut self, len: usize, octets: u16) -> usize {
        const LEN: usize = CONTENT + size_of::<u16>();
        let end = len + LEN.next_multiple_of(align_of::<libc::cmsghdr>());
        assert!(end <= Self::CAPACITY);
        // SAFETY: a header of plain integers, for which all zero is valid.
        let mut header: libc::cmsghdr = unsafe { mem::zeroed() };
        header.cmsg_level = libc::SOL_UDP;
        header.cmsg_type = libc::UDP_SEGMENT;
        header.cmsg_len = LEN as _;
        // SAFETY: both writes end before `end`, which lies within `self`, as was just seen; they
        // need no alignment, and any octets are valid where they go.
        unsafe {
            let place = ptr::from_mut(self).cast::<u8>().add(len);
            place.cast::<libc::cmsghdr>().write_unaligned(header);
            place.add(CONTENT).cast::<u16>().write_unaligned(octets);
        }
        end
    }
}

fn in_addr(address: Ipv4Addr) -> libc::in_addr {
    libc::in_addr { s_addr: u32::from_ne_bytes(address.octets()) }
}

fn in6_addr(address: Ipv6Addr) -> libc::in6_addr {
    libc::in6_addr { s6_addr: address.octets() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_comes_back_as_it_was_set() {
        for text in ["198.51.100.7:40004", "[2001:db8::7]:40004", "[fe80::1%3]:1"] {
            let address: SocketAddr = text.parse().unwrap();
            let mut name = Name::default();
            let len = name.set(address);
            assert_eq!(name.address(len), Some(address));
            assert_eq!(name.address(2), None, "cut short");
        }
        assert_eq!(Name::default().address(Name::CAPACITY), None, "no family");
    }

    #[test]
    fn a_source_comes_back_as_the_local_address() {
        for text in ["198.51.100.7", "2001:db8::7"] {
            let source: IpAddr = text.parse().unwrap();
            let mut control = Control::default();
            let len = control.set_source(source);
            assert!(len <= Control::CAPACITY);
            assert_eq!(control.local_address(len), Some(source));
            assert_eq!(control.local_address(0), None);
            let with_segments = control.add_segment_len(len, 42);
            assert!(len < with_segments && with_segments <= Control::CAPACITY);
            assert_eq!(control.local_address(len), Some(source), "still there");
        }
    }
}
