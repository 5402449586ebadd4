//! What an inventory is made of, as people write it: addresses to ask, or captures.

use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::{Path, PathBuf};

use ipnet::{Ipv4AddrRange, Ipv4Net};

/// Addresses in one inventory: those of a /16.
const MOST_ADDRESSES: usize = 1 << 16;

/// One argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// Devices that are asked, at this port if one is written.
    Addresses(Ipv4AddrRange, Option<u16>),
    /// A capture, or `-`.
    File(PathBuf),
}

impl Source {
    pub(super) fn file(&self) -> Option<&Path> {
        match self {
            Self::Addresses(..) => None,
            Self::File(path) => Some(path),
        }
    }
}

/// Why a text is no source, or too many of them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum BadSource {
    #[error(
        "{0:?} is no address: write 172.17.17.7, 172.17.17.1-20, 172.17.17.0/24 or \
         198.51.100.1:20104; a file whose name looks like one can be written as ./{0}"
    )]
    NoAddress(String),
    #[error("{0} is not the address of one device")]
    NotUnicast(Ipv4Addr),
    #[error("more than {MOST_ADDRESSES} addresses: name fewer at once")]
    TooMany,
}

/// An argument is an address if it begins with a digit and nothing else is in it than what addresses are
/// made of.
pub(super) fn source(text: &str) -> Result<Source, BadSource> {
    let is_address = text.starts_with(|c: char| c.is_ascii_digit())
        && text.contains('.')
        && text.chars().all(|c| "0123456789.-/:".contains(c));
    if !is_address {
        return Ok(Source::File(text.into()));
    }
    let (range, port) = addresses(text).ok_or_else(|| BadSource::NoAddress(text.to_owned()))?;
    let mut inside = range;
    for end in [inside.next(), inside.next_back()].into_iter().flatten() {
        if end.is_unspecified() || end.is_multicast() || end.is_broadcast() {
            return Err(BadSource::NotUnicast(end));
        }
    }
    Ok(Source::Addresses(range, port))
}

fn addresses(text: &str) -> Option<(Ipv4AddrRange, Option<u16>)> {
    if text.contains('/') {
        return Some((text.parse::<Ipv4Net>().ok()?.hosts(), None));
    }
    if let Some((first, last)) = text.split_once('-') {
        let first: Ipv4Addr = first.parse().ok()?;
        let [a, b, c, _] = first.octets();
        let last = match last.parse() {
            Ok(node) => Ipv4Addr::new(a, b, c, node),
            Err(_) => last.parse().ok()?,
        };
        return (first <= last).then(|| (Ipv4AddrRange::new(first, last), None));
    }
    if text.contains(':') {
        let one: SocketAddrV4 = text.parse().ok()?;
        return Some((Ipv4AddrRange::new(*one.ip(), *one.ip()), Some(one.port())))
            .filter(|_| one.port() != 0);
    }
    let one = text.parse().ok()?;
    Some((Ipv4AddrRange::new(one, one), None))
}

/// All addresses that are to be asked, each once, in their order.
pub(super) fn targets(
    sources: &[Source],
    usual_port: u16,
) -> Result<BTreeSet<SocketAddrV4>, BadSource> {
    let mut targets = BTreeSet::new();
    for source in sources {
        let Source::Addresses(range, port) = source else { continue };
        for address in *range {
            targets.insert(SocketAddrV4::new(address, port.unwrap_or(usual_port)));
            if targets.len() > MOST_ADDRESSES {
                return Err(BadSource::TooMany);
            }
        }
    }
    Ok(targets)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(texts: &[&str]) -> Vec<String> {
        let sources: Vec<_> = texts.iter().map(|text| source(text).unwrap()).collect();
        targets(&sources, 34964).unwrap().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn addresses_are_written_in_four_ways() {
        assert_eq!(all(&["172.17.17.7"]), ["172.17.17.7:34964"]);
        assert_eq!(all(&["198.51.100.1:20104"]), ["198.51.100.1:20104"]);
        let some = ["172.17.17.9:34964", "172.17.17.10:34964"];
        assert_eq!(all(&["172.17.17.9-10"]), some);
        assert_eq!(all(&["172.17.17.9-172.17.17.10"]), some);
        assert_eq!(all(&["172.17.17.8/30"]), some);
        assert_eq!(all(&["172.17.17.10/32", "172.17.17.9-10"]), some);
        let net = all(&["172.17.17.0/24"]);
        assert_eq!(
            (net.len(), &*net[0], &*net[253]),
            (254, "172.17.17.1:34964", "172.17.17.254:34964")
        );
    }

    #[test]
    fn what_is_no_address_is_a_file_or_refused() {
        for file in ["-", "capture.pcap", "2024-05-17.pcapng", "./172.17.17.7", "17"] {
            assert_eq!(source(file), Ok(Source::File(file.into())));
        }
        for bad in [
            "172.17.17",
            "172.17.17.300",
            "172.17.17.9-8",
            "1.2.3.4/33",
            "1.2.3.4:0",
            "1.2.3.4-5:6",
        ] {
            assert_eq!(source(bad), Err(BadSource::NoAddress(bad.to_owned())));
        }
        for (bad, end) in [
            ("0.0.0.0", "0.0.0.0"),
            ("239.0.0.1", "239.0.0.1"),
            ("255.255.255.250-255", "255.255.255.255"),
            ("224.0.0.0/8", "224.0.0.1"),
        ] {
            assert_eq!(source(bad), Err(BadSource::NotUnicast(end.parse().unwrap())));
        }
    }

    #[test]
    fn more_addresses_than_a_16_has_are_too_many() {
        let net = |text| source(text).unwrap();
        assert_eq!(targets(&[net("10.0.0.0/16")], 34964).unwrap().len(), 65534);
        assert_eq!(targets(&[net("10.0.0.0/15")], 34964), Err(BadSource::TooMany));
    }
}
