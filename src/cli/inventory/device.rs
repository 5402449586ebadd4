//! What is known of a device. Texts of devices are cleaned here, before anybody prints them.

use std::net::{Ipv4Addr, SocketAddrV4};

use serde::{Serialize, Serializer};

use crate::profinet::MacAddress;

/// Submodules that are kept of one device; of the others, their number.
pub(super) const MOST_SUBMODULES: usize = 256;
/// Ports and neighbours that are kept of one device.
pub(super) const MOST_NEIGHBOURS: usize = 32;
/// Parts of others (I&M5) that are kept of one submodule.
pub(super) const MOST_PARTS: usize = 16;

/// One device.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Device {
    pub(super) address: Option<Ipv4Addr>,
    /// Where it was asked.
    pub(super) asked: Option<SocketAddrV4>,
    /// The port that its answers came from.
    pub(super) answered_from: Option<u16>,
    #[serde(serialize_with = "shown")]
    pub(super) mac: Option<MacAddress>,
    pub(super) station_name: Option<String>,
    /// What its endpoint mapper or DCP calls its kind.
    pub(super) annotation: Option<String>,
    pub(super) vendor_id: Option<u16>,
    pub(super) device_id: Option<u16>,
    pub(super) submodules: Vec<Submodule>,
    /// Submodules that were too many.
    pub(super) submodules_left_out: usize,
    /// Ports that its LLDP frames named.
    pub(super) ports: Vec<String>,
    pub(super) neighbours: Vec<Neighbour>,
    /// Why it told less than others.
    pub(super) error: Option<String>,
}

/// A slot and subslot, and the I&M there.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Submodule {
    /// The application process: 0, or that of a profile.
    pub(super) api: u32,
    pub(super) slot: u16,
    pub(super) subslot: u16,
    pub(super) module_ident: Option<u32>,
    pub(super) submodule_ident: Option<u32>,
    #[serde(flatten)]
    pub(super) product: Product,
    pub(super) function: Option<String>,
    pub(super) location: Option<String>,
    pub(super) installed: Option<String>,
    pub(super) descriptor: Option<String>,
    /// Hexadecimal digits.
    pub(super) signature: Option<String>,
    pub(super) parts: Vec<Part>,
}

/// Which product something is: I&M0, and each part of I&M5.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Product {
    pub(super) vendor_id: Option<u16>,
    pub(super) order_id: Option<String>,
    pub(super) serial_number: Option<String>,
    pub(super) hardware_revision: Option<u16>,
    pub(super) software_revision: Option<String>,
}

/// A part that another vendor made (I&M5).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Part {
    pub(super) annotation: Option<String>,
    #[serde(flatten)]
    pub(super) product: Product,
}

/// What is at the other end of a cable, as LLDP tells.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Neighbour {
    /// The device's own port.
    pub(super) port: Option<String>,
    pub(super) station_name: Option<String>,
    pub(super) their_port: Option<String>,
}

impl Device {
    /// What devices are ordered by.
    pub(super) fn place(&self) -> (Option<Ipv4Addr>, Option<SocketAddrV4>, Option<MacAddress>) {
        (self.address, self.asked, self.mac)
    }

    /// The submodule at this place. None when there are too many.
    pub(super) fn submodule(&mut self, slot: u16, subslot: u16) -> Option<&mut Submodule> {
        let is_there =
            |submodule: &Submodule| (submodule.slot, submodule.subslot) == (slot, subslot);
        if let Some(index) = self.submodules.iter().position(is_there) {
            return self.submodules.get_mut(index);
        }
        if self.submodules.len() == MOST_SUBMODULES {
            self.submodules_left_out += 1;
            return None;
        }
        self.submodules.push(Submodule { slot, subslot, ..Submodule::default() });
        self.submodules.last_mut()
    }

    /// Takes what else is known of the same device. What is newer counts.
    pub(super) fn absorb(&mut self, other: Self) {
        fn newer<T>(old: &mut Option<T>, new: Option<T>) {
            if new.is_some() {
                *old = new;
            }
        }
        newer(&mut self.address, other.address);
        newer(&mut self.mac, other.mac);
        newer(&mut self.station_name, other.station_name);
        newer(&mut self.annotation, other.annotation);
        newer(&mut self.vendor_id, other.vendor_id);
        newer(&mut self.device_id, other.device_id);
        if self.submodules.is_empty() {
            self.submodules = other.submodules;
        }
        other.ports.into_iter().for_each(|port| self.port(port));
        other.neighbours.into_iter().for_each(|neighbour| self.neighbour(neighbour));
    }

    /// Notes a port, unless it is known or there are too many.
    pub(super) fn port(&mut self, port: String) {
        if self.ports.len() < MOST_NEIGHBOURS && !self.ports.contains(&port) {
            self.ports.push(port);
        }
    }

    /// Notes a neighbour, unless it is known or there are too many.
    pub(super) fn neighbour(&mut self, neighbour: Neighbour) {
        if self.neighbours.len() < MOST_NEIGHBOURS && !self.neighbours.contains(&neighbour) {
            self.neighbours.push(neighbour);
        }
    }
}

fn shown<S: Serializer>(mac: &Option<MacAddress>, serializer: S) -> Result<S::Ok, S::Error> {
    match mac {
        Some(mac) => serializer.collect_str(mac),
        None => serializer.serialize_none(),
    }
}

/// A text of a device: without padding, on one line, without anything that steers a terminal. `None` if
/// nothing is left.
pub(super) fn text(octets: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(octets);
    let text = text.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    let clean = |c: char| if is_shown(c) { c } else { char::REPLACEMENT_CHARACTER };
    (!text.is_empty()).then(|| text.chars().map(clean).collect())
}

/// Letters that turn the direction of a line, or have no width, could hide what a text says.
fn is_shown(c: char) -> bool {
    !c.is_control()
        && !matches!(c, '\u{200B}'..='\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2060}'..='\u{206F}' | '\u{FEFF}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_lose_their_padding_and_what_steers_a_terminal() {
        assert_eq!(text(b"PUMP 4711   \0\0").as_deref(), Some("PUMP 4711"));
        assert_eq!(text(b"    \0"), None);
        assert_eq!(
            text(b"\x1b[31mred\r\n\x07").as_deref(),
            Some("\u{FFFD}[31mred\r\n\u{FFFD}".replace(['\r', '\n'], "\u{FFFD}").as_str())
        );
        assert_eq!(text("a\u{202E}b".as_bytes()).as_deref(), Some("a\u{FFFD}b"));
        assert_eq!(text(&[b'K', 0xFC, b'h', b'l']).as_deref(), Some("K\u{FFFD}hl"));
        assert_eq!(text("Kühler".as_bytes()).as_deref(), Some("Kühler"));
    }

    #[test]
    fn a_device_keeps_so_many_submodules() {
        let mut device = Device::default();
        for slot in 0..MOST_SUBMODULES as u16 + 5 {
            device.submodule(slot, 1);
        }
        assert_eq!((device.submodules.len(), device.submodules_left_out), (MOST_SUBMODULES, 5));
        device.submodule(3, 1).unwrap().function = Some("pump".to_owned());
        assert_eq!(device.submodules[3].function.as_deref(), Some("pump"));
    }
}
