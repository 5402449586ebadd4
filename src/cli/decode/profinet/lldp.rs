//! LLDP frames.

use std::fmt::{self, Display};

use serde::{Serialize, Serializer};

use super::Fault;
use super::lldp_tlv::{AddressShown, TlvFields};
use super::words::{List, Shown};
use crate::profinet::lldp::{Address, Id, Lldp, LldpTlv, LldpValue, Names, NamesMode};

/// What such a frame says.
#[derive(Debug, Serialize)]
pub(in crate::cli::decode) struct LldpFields<'a> {
    chassis_id: Option<Shown<AddressShown<'a>>>,
    port_id: Option<Shown<AddressShown<'a>>>,
    ttl: Option<u16>,
    /// Null where they are no names of PROFINET.
    names: Option<NamesFields<'a>>,
    #[serde(serialize_with = "tlvs")]
    tlvs: Lldp<'a>,
    #[serde(flatten)]
    pub(super) fault: Option<Fault>,
}

#[derive(Debug, Serialize)]
struct NamesFields<'a> {
    mode: &'static str,
    port: &'a str,
    station: &'a str,
    /// What the neighbour's port is called for it.
    alias_name: Shown<Names<'a>>,
}

impl<'a> LldpFields<'a> {
    pub(super) fn of(octets: &'a [u8]) -> Self {
        let lldp = Lldp::new(octets);
        let [mut chassis, mut port] = [None::<Id<'a>>; 2];
        let (mut ttl, mut fault) = (None, None);
        for tlv in lldp.tlvs() {
            match tlv.map(|tlv| tlv.value) {
                Ok(LldpValue::ChassisId(id)) => chassis = Some(id),
                Ok(LldpValue::PortId(id)) => port = Some(id),
                Ok(LldpValue::TimeToLive(seconds)) => ttl = Some(seconds),
                Ok(_) => {}
                Err(error) => fault = Some(error.into()),
            }
        }
        let shown = |id: Id<'a>| Shown(AddressShown(id.value));
        Self {
            names: chassis.zip(port).and_then(|(chassis, port)| NamesFields::of(&chassis, &port)),
            chassis_id: chassis.map(shown),
            port_id: port.map(shown),
            ttl,
            tlvs: lldp,
            fault,
        }
    }
}

impl<'a> NamesFields<'a> {
    fn of(chassis: &Id<'a>, port: &Id<'a>) -> Option<Self> {
        let Address::Text(port) = port.value else { return None };
        let chassis = if let Address::Text(chassis) = chassis.value { chassis } else { b"" };
        let names = Names::of(chassis, port)?;
        // A name of station has no other characters (and no terminal takes orders from them).
        if names.station.chars().any(|it| it.is_control()) {
            return None;
        }
        let mode = match names.mode {
            NamesMode::Legacy => "legacy",
            NamesMode::Standard => "standard",
        };
        Some(Self { mode, port: names.port, station: names.station, alias_name: Shown(names) })
    }
}

/// The TLVs up to the first one that cannot be read.
fn sound<'a>(lldp: &Lldp<'a>) -> impl Iterator<Item = LldpTlv<'a>> + Clone {
    lldp.tlvs().map_while(Result::ok)
}

fn tlvs<S: Serializer>(lldp: &Lldp<'_>, serializer: S) -> Result<S::Ok, S::Error> {
    List(sound(lldp).map(|tlv| TlvFields::of(&tlv))).serialize(serializer)
}

impl Display for LldpFields<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LLDP")?;
        match (&self.names, &self.chassis_id, &self.port_id) {
            (Some(names), ..) => write!(f, " of {} ({} names)", names.alias_name, names.mode)?,
            (None, Some(chassis_id), Some(port_id)) => write!(f, " of {port_id} at {chassis_id}")?,
            _ => {}
        }
        if let Some(ttl) = self.ttl {
            write!(f, ", for {ttl} s")?;
        }
        let mut others = sound(&self.tlvs).filter(|tlv| tlv.kind > 3);
        others.try_for_each(|tlv| TlvFields::of(&tlv).brief(f))
    }
}
