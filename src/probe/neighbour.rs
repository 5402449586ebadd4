//! The kernel's table of neighbours: who has answered ARP on a wire of this router.

use std::fs;
use std::net::{IpAddr, SocketAddr};

/// The table. The path is below /proc/self, because a confined process can read that.
const TABLE: &str = "/proc/self/net/arp";
/// The flag of an entry whose hardware address is known.
const COMPLETE: u8 = 0x02;

/// What the table says of an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Neighbour {
    /// It has answered.
    Answers {
        /// Its hardware address.
        hardware: String,
        /// The interface that it is on.
        interface: String,
    },
    /// It was asked, and has not answered.
    Silent,
    /// Nothing: it is not on a wire of this router, or its addresses are IPv6.
    Unlisted,
}

impl Neighbour {
    /// Looks an address up. A datagram has to be sent there first.
    pub fn look_up(server: SocketAddr) -> Self {
        Self::find(&fs::read_to_string(TABLE).unwrap_or_default(), server.ip())
    }

    fn find(table: &str, address: IpAddr) -> Self {
        let is_it = |line: &&str| line.split_whitespace().next() == Some(&address.to_string());
        let entry = |line: &str| {
            let mut columns = line.split_whitespace().skip(2);
            let flags = u8::from_str_radix(columns.next()?.strip_prefix("0x")?, 16).ok()?;
            if flags & COMPLETE == 0 {
                return Some(Self::Silent);
            }
            let (hardware, interface) = (columns.next()?.to_owned(), columns.nth(1)?.to_owned());
            Some(Self::Answers { hardware, interface })
        };
        // It may be on several interfaces, and has to answer on one.
        let found = table.lines().skip(1).filter(is_it).filter_map(entry);
        found.fold(Self::Unlisted, |before, found| match before {
            Self::Answers { .. } => before,
            Self::Silent | Self::Unlisted => found,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_tells_who_has_answered() {
        let table = "IP address       HW type     Flags       HW address            Mask     Device\n\
            172.17.17.1      0x1         0x2         02:00:00:00:00:01     *        plant0\n\
            172.17.17.2      0x1         0x0         00:00:00:00:00:00     *        plant0\n\
            172.17.17.3      0x1         0x6         02:00:00:00:00:03     *        plant0\n\
            172.17.17.4      0x1         0x0         00:00:00:00:00:00     *        wan0\n\
            172.17.17.4      0x1         0x2         02:00:00:00:00:04     *        plant0\n\
            172.17.17.5      odd\n";
        let find = |last: u8| Neighbour::find(table, [172, 17, 17, last].into());
        let answers = |last: u8| Neighbour::Answers {
            hardware: format!("02:00:00:00:00:0{last}"),
            interface: "plant0".into(),
        };
        assert_eq!(find(1), answers(1));
        assert_eq!(find(2), Neighbour::Silent);
        assert_eq!(find(3), answers(3));
        assert_eq!(find(4), answers(4));
        for unlisted in [5, 6, 17] {
            assert_eq!(find(unlisted), Neighbour::Unlisted);
        }
        assert_eq!(Neighbour::find("", [172, 17, 17, 1].into()), Neighbour::Unlisted);
    }
}
