use super::*;

#[test]
fn an_address_comes_back_as_it_was_set() {
    for text in ["198.51.100.7:20004", "[2001:db8::7]:20004", "[fe80::1%3]:1"] {
        let address: SocketAddr = text.parse().unwrap();
        let mut name = Name::default();
        let len = name.set(address);
        assert_eq!(name.address(len), Some(address));
        for short in 0..len {
            assert_eq!(name.address(short), None, "{short} of {len} octets");
        }
        assert_eq!(name.address(Name::CAPACITY + 1), None, "longer than the room");
        name.family = libc::AF_UNIX as libc::sa_family_t;
        assert_eq!(name.address(len), None, "another family");
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
        let with_segments = control.add_segment_len(len, 42);
        assert!(len < with_segments && with_segments <= Control::CAPACITY);
        assert_eq!(control.local_address(len), Some(source), "still there");
        assert_eq!(control.local_address(Control::CAPACITY + 1), Some(source));
    }
}

#[test]
fn a_broadcast_or_multicast_address_is_not_local() {
    let mut control = Control::default();
    let info = libc::in_pktinfo {
        ipi_ifindex: 3,
        ipi_spec_dst: in_addr("203.0.113.1".parse().unwrap()),
        ipi_addr: in_addr("203.0.113.255".parse().unwrap()),
    };
    let len = control.put(0, libc::IPPROTO_IP, libc::IP_PKTINFO, info);
    assert_eq!(control.local_address(len), None);
    let group = in6_addr("ff02::1".parse().unwrap());
    let info = libc::in6_pktinfo { ipi6_addr: group, ipi6_ifindex: 3 };
    let len = control.put(0, libc::IPPROTO_IPV6, libc::IPV6_PKTINFO, info);
    assert_eq!(control.local_address(len), None);
}

#[test]
fn a_message_that_was_cut_short_tells_no_address() {
    for text in ["198.51.100.7", "2001:db8::7"] {
        let mut control = Control::default();
        control.set_source(text.parse().unwrap());
        let whole = control.messages(Control::CAPACITY).next().unwrap().content.len();
        for room in 0..CONTENT + whole {
            assert_eq!(control.local_address(room), None, "{room} octets");
        }
        // The kernel cuts the message itself, and what was there before stays behind it.
        for content in 0..whole {
            control.set_len(CONTENT + content);
            assert_eq!(control.local_address(Control::CAPACITY), None, "{content} octets");
        }
        for absurd in [0, 1, CONTENT - 1, Control::CAPACITY + 1, isize::MAX as usize] {
            control.set_len(absurd);
            assert_eq!(control.local_address(Control::CAPACITY), None, "{absurd} octets");
        }
    }
}

#[test]
fn the_address_is_found_behind_other_messages() {
    let source: IpAddr = "2001:db8::7".parse().unwrap();
    let info =
        libc::in6_pktinfo { ipi6_addr: in6_addr("2001:db8::7".parse().unwrap()), ipi6_ifindex: 3 };
    // One octet less than what messages are aligned to.
    const ODD: usize = size_of::<usize>() - 1;
    for first in [0, 1, ODD] {
        let mut control = Control::default();
        let at = match first {
            0 => control.put(0, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, ()),
            1 => control.put(0, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, [1_u8; 1]),
            _ => control.put(0, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, [1_u8; ODD]),
        };
        let end = control.put(at, libc::IPPROTO_IPV6, libc::IPV6_PKTINFO, info);
        assert_eq!(control.local_address(end), Some(source));
        assert_eq!(control.local_address(at + CONTENT + 19), None, "cut short");
        assert_eq!(control.messages(end).count(), 2);
    }
}

impl Control {
    /// What [`add_segment_len`](Self::add_segment_len) wrote.
    pub(crate) fn segment_len(&self, len: usize) -> Option<u16> {
        let is_it = |m: &Message<'_>| (m.level, m.kind) == (libc::SOL_UDP, libc::UDP_SEGMENT);
        // SAFETY: any two octets are a number.
        unsafe { self.messages(len).find(is_it)?.content() }
    }

    /// Changes the length that the first message has in its header.
    fn set_len(&mut self, len: usize) {
        let header = self.0.as_mut_ptr().cast::<libc::cmsghdr>();
        // SAFETY: a header stands at the beginning, aligned as `Control` is.
        unsafe { (*header).cmsg_len = len as _ };
    }
}
