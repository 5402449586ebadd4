//! How a station and its port are called: in the chassis ID and the port ID, in one of two ways.
//!
//! A device takes its neighbour's name and port as the alias name of its own port.

use std::fmt;

/// Station and port, as an LLDP frame names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Names<'a> {
    /// Which of the two ways.
    pub mode: NamesMode,
    /// `port-001`, or `port-001-00002` with the slot of the interface.
    pub port: &'a str,
    /// The name of station, or the MAC address as text where there is none.
    pub station: &'a str,
}

/// Where the name of station is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NamesMode {
    /// Up to PROFINET 2.2: it is the chassis ID.
    Legacy,
    /// Since PROFINET 2.3: it is in the port ID, behind the port. The chassis ID describes the device.
    Standard,
}

impl<'a> Names<'a> {
    /// None where they are no names of PROFINET.
    pub fn of(chassis_id: &'a [u8], port_id: &'a [u8]) -> Option<Self> {
        let port_id = str::from_utf8(port_id).ok()?;
        let (mode, port, station) = match port_id.split_once('.') {
            Some((port, station)) => (NamesMode::Standard, port, station),
            None => (NamesMode::Legacy, port_id, str::from_utf8(chassis_id).ok()?),
        };
        (is_port(port) && !station.is_empty()).then_some(Self { mode, port, station })
    }
}

/// `port-` and three digits; behind them `-` and five digits where there are several interfaces.
fn is_port(text: &str) -> bool {
    let digits =
        |text: &str, length| text.len() == length && text.bytes().all(|it| it.is_ascii_digit());
    let Some(numbers) = text.strip_prefix("port-") else { return false };
    match numbers.split_once('-') {
        Some((port, slot)) => digits(port, 3) && digits(slot, 5),
        None => digits(numbers, 3),
    }
}

impl fmt::Display for Names<'_> {
    /// The alias name that the neighbour's port has from them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.port, self.station)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_11_both_ways_give_the_same_alias_name() {
        let legacy = Names::of(b"b", b"port-003").unwrap();
        let standard = Names::of(b"device   order number  serial", b"port-003.b").unwrap();
        assert_eq!((legacy.mode, standard.mode), (NamesMode::Legacy, NamesMode::Standard));
        assert_eq!([legacy, standard].map(|names| names.to_string()), ["port-003.b"; 2]);
        // A name of station has points of its own.
        let names = Names::of(b"x", b"port-001-00002.plc.line-4").unwrap();
        assert_eq!((names.port, names.station), ("port-001-00002", "plc.line-4"));
    }

    #[test]
    fn p_11_other_names_are_none_of_profinet() {
        for (chassis, port) in [
            (&b"switch"[..], &b"eth0"[..]),
            (b"switch", b"port-1"),
            (b"switch", b"port-0001"),
            (b"switch", b"port-001-2"),
            (b"", b"port-001"),
            (b"x", b"port-001."),
            (b"x", b"port-00\xFF"),
        ] {
            assert_eq!(Names::of(chassis, port), None, "{port:?}");
        }
    }
}
