//! Which public ports are asked, and for which nodes.

use std::net::SocketAddrV4;
use std::str::FromStr;

/// A public port and the node behind it.
#[derive(Clone, Copy)]
pub struct Target {
    pub address: SocketAddrV4,
    pub node_address: u8,
}

/// `IP:FIRST-LAST` names ports, `A.B.C.FIRST-LAST:PORT` addresses. They stand for the nodes from 1
/// up, or from what is named behind an `@`.
#[derive(Clone)]
pub struct Targets(pub Vec<Target>);

impl FromStr for Targets {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (addresses, node) = text.split_once('@').unwrap_or((text, "1"));
        let wrong = || format!("{text:?} is not of the form A.B.C.D:FIRST-LAST@NODE");
        let (ip, ports) = addresses.rsplit_once(':').ok_or_else(wrong)?;
        let (net, hosts) = ip.rsplit_once('.').ok_or_else(wrong)?;
        let range = |part: &str| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            Some(first.parse::<u16>().ok()?..=last.parse::<u16>().ok()?)
        };
        let (hosts, ports) = (range(hosts).ok_or_else(wrong)?, range(ports).ok_or_else(wrong)?);
        let mut targets = Vec::new();
        for host in hosts {
            for port in ports.clone() {
                let first: usize = node.parse().map_err(|_| wrong())?;
                targets.push(Target {
                    address: format!("{net}.{host}:{port}").parse().map_err(|_| wrong())?,
                    node_address: u8::try_from(first + targets.len()).map_err(|_| wrong())?,
                });
            }
        }
        Ok(Self(targets))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_addresses_and_nodes() {
        let list = |text: &str| {
            let Targets(targets) = text.parse().unwrap();
            targets.iter().map(|t| (t.address.to_string(), t.node_address)).collect::<Vec<_>>()
        };
        assert_eq!(list("1.2.3.4:7"), [("1.2.3.4:7".into(), 1)]);
        assert_eq!(list("1.2.3.4:7-8"), [("1.2.3.4:7".into(), 1), ("1.2.3.4:8".into(), 2)]);
        assert_eq!(list("1.2.3.4-5:7@9"), [("1.2.3.4:7".into(), 9), ("1.2.3.5:7".into(), 10)]);
        for wrong in ["", "1.2.3.4", "1.2.3:x", "1.2.3.4:7@256", "1.2.3.300:7"] {
            assert!(wrong.parse::<Targets>().is_err(), "{wrong}");
        }
    }
}
