//! The clock protocol of PROFINET (PTCP): header and TLVs, by name.
//!
//! The frame ID tells which frame it is: [`PtcpFrame`]. Invariant: at most one TLV is read at a time, so
//! nothing is stored.

use super::MacAddress;
use super::octets::{Malformed, Octets};
use super::rt::PtcpFrame;

/// A PTCP frame.
#[derive(Clone, Copy, Debug)]
pub struct Ptcp<'a> {
    /// Counts the frames of one kind.
    pub sequence_id: u16,
    /// Delay so far, in nanoseconds; none in an announce. A follow-up's delay is signed, so it is kept as
    /// it came.
    pub delay: Option<Delay>,
    tlvs: Octets<'a>,
}

/// The delay that a frame tells of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delay {
    /// Sync: a whole number of 10 ns, one octet of 1 ns, and 1 ns in full.
    Sync {
        /// In units of 10 ns.
        tens: u32,
        /// The rest, in ns.
        ones: u8,
        /// In ns.
        nanoseconds: u32,
    },
    /// Delay frames, in ns.
    Line(u32),
    /// A follow-up corrects its sync by these ns.
    FollowUp(i32),
}

/// A part of a frame.
#[derive(Clone, Copy, Debug)]
pub struct PtcpTlv<'a> {
    /// What it is.
    pub kind: u8,
    /// Its octets.
    pub value: PtcpValue<'a>,
}

/// What a TLV says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PtcpValue<'a> {
    /// The clock's source, and its domain.
    Subdomain {
        /// The clock master.
        master: MacAddress,
        /// The domain's UUID, the highest octet first.
        uuid: [u8; 16],
    },
    /// Time since the epoch.
    Time {
        /// Which epoch.
        epoch: u16,
        /// Seconds in it.
        seconds: u32,
        /// Of the second.
        nanoseconds: u32,
    },
    /// What belongs to the time.
    TimeExtension {
        /// Bits of leap seconds.
        flags: u16,
        /// Seconds that UTC is behind.
        utc_offset: u16,
    },
    /// How good a master is.
    Master {
        /// Role, level and activity.
        priority_1: u8,
        /// 255 by default.
        priority_2: u8,
        /// 255: it never is a master.
        clock_class: u8,
        /// As in IEEE 1588: 0x20 is 25 ns.
        clock_accuracy: u8,
        /// As in IEEE 1588.
        clock_variance: i16,
    },
    /// Delays inside a port, in ns.
    PortParameter {
        /// From the line to the time stamp.
        receive_delay: u32,
        /// From the time stamp to the line.
        transmit_delay: u32,
    },
    /// The port that asked.
    DelayParameter {
        /// Its address.
        port: MacAddress,
    },
    /// When the request was received, in ns.
    PortTime {
        /// The responder's clock.
        received: u32,
    },
    /// An option of PROFINET, with the UUID of an IR configuration.
    IrData {
        /// The UUID, the highest octet first.
        uuid: [u8; 16],
    },
    /// Any other TLV.
    Octets(&'a [u8]),
}

impl<'a> Ptcp<'a> {
    /// Reads what is behind the frame ID. None for a reserved frame ID: its layout is not known.
    pub fn parse(frame: PtcpFrame, mut octets: Octets<'a>) -> Result<Option<Self>, Malformed> {
        let (sequence_id, delay);
        match frame {
            PtcpFrame::Sync { .. } => {
                octets.take(8)?;
                let tens = octets.u32()?;
                sequence_id = octets.u16()?;
                let ones = octets.u8()?;
                octets.take(1)?;
                delay = Some(Delay::Sync { tens, ones, nanoseconds: octets.u32()? });
            }
            PtcpFrame::Reserved => return Ok(None),
            _ => {
                octets.take(12)?;
                sequence_id = octets.u16()?;
                octets.take(2)?;
                let nanoseconds = octets.u32()?;
                delay = match frame {
                    PtcpFrame::Announce => None,
                    PtcpFrame::FollowUp => Some(Delay::FollowUp(nanoseconds.cast_signed())),
                    _ => Some(Delay::Line(nanoseconds)),
                };
            }
        }
        Ok(Some(Self { sequence_id, delay, tlvs: octets }))
    }

    /// The TLVs up to the one that ends them. After an error come no more.
    pub fn tlvs(&self) -> PtcpTlvs<'a> {
        PtcpTlvs { left: Some(self.tlvs) }
    }
}

/// The TLVs of a frame, one after the other.
#[derive(Clone, Debug)]
pub struct PtcpTlvs<'a> {
    left: Option<Octets<'a>>,
}

impl<'a> Iterator for PtcpTlvs<'a> {
    type Item = Result<PtcpTlv<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut octets = self.left.take()?;
        let tlv = PtcpTlv::read(&mut octets).transpose()?;
        self.left = tlv.is_ok().then_some(octets);
        Some(tlv)
    }
}

impl<'a> PtcpTlv<'a> {
    /// None at the TLV that ends the frame.
    fn read(octets: &mut Octets<'a>) -> Result<Option<Self>, Malformed> {
        let head = octets.u16()?;
        let (kind, length) = ((head >> 9) as u8, head & 0x01FF);
        if kind == 0 {
            return Ok(None);
        }
        let mut value = octets.part(length.into())?;
        let value = match kind {
            1 => PtcpValue::Subdomain { master: MacAddress(value.array()?), uuid: value.array()? },
            2 => PtcpValue::Time {
                epoch: value.u16()?,
                seconds: value.u32()?,
                nanoseconds: value.u32()?,
            },
            3 => PtcpValue::TimeExtension { flags: value.u16()?, utc_offset: value.u16()? },
            4 => PtcpValue::Master {
                priority_1: value.u8()?,
                priority_2: value.u8()?,
                clock_class: value.u8()?,
                clock_accuracy: value.u8()?,
                clock_variance: value.u16()?.cast_signed(),
            },
            5 => {
                // Numbers of four octets stand on a multiple of four.
                value.take(2)?;
                PtcpValue::PortParameter {
                    receive_delay: value.u32()?,
                    transmit_delay: value.u32()?,
                }
            }
            6 => PtcpValue::DelayParameter { port: MacAddress(value.array()?) },
            7 => {
                value.take(2)?;
                PtcpValue::PortTime { received: value.u32()? }
            }
            0x7F if value.rest().starts_with(&[0x00, 0x0E, 0xCF, 1]) && value.len() >= 20 => {
                value.take(4)?;
                PtcpValue::IrData { uuid: value.array()? }
            }
            _ => PtcpValue::Octets(value.rest()),
        };
        Ok(Some(Self { kind, value }))
    }

    /// Its name in the standard.
    pub fn name(&self) -> &'static str {
        match self.kind {
            1 => "Subdomain",
            2 => "Time",
            3 => "TimeExtension",
            4 => "Master",
            5 => "PortParameter",
            6 => "DelayParameter",
            7 => "PortTime",
            0x7F => "Option",
            _ => "unknown",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PORT: MacAddress = MacAddress([2, 0, 0, 0, 0, 9]);

    /// Octets behind the frame ID: 12 of padding, the sequence, 2 of padding, the delay, these TLVs.
    fn frame(tlvs: &[u8]) -> Vec<u8> {
        [&[0; 12][..], &[0x23, 0xAD, 0, 0], &[0xFF, 0xFF, 0xFF, 0xFE], tlvs, &[0, 0, 0xEE]].concat()
    }

    fn values<'a>(ptcp: &Ptcp<'a>) -> Vec<PtcpValue<'a>> {
        ptcp.tlvs().map(|tlv| tlv.unwrap().value).collect()
    }

    #[test]
    fn a_delay_request_names_its_port() {
        let octets = frame(&[0x0C, 6, 2, 0, 0, 0, 0, 9]);
        let ptcp = Ptcp::parse(PtcpFrame::DelayRequest, Octets::new(&octets)).unwrap().unwrap();
        assert_eq!((ptcp.sequence_id, ptcp.delay), (0x23AD, Some(Delay::Line(0xFFFF_FFFE))));
        assert_eq!(values(&ptcp), [PtcpValue::DelayParameter { port: PORT }]);
        assert_eq!(ptcp.tlvs().next().unwrap().unwrap().name(), "DelayParameter");
    }

    #[test]
    fn a_follow_up_has_a_signed_delay_and_an_announce_has_none() {
        let octets = frame(&[]);
        let of = |frame| Ptcp::parse(frame, Octets::new(&octets)).unwrap().unwrap().delay;
        assert_eq!(of(PtcpFrame::FollowUp), Some(Delay::FollowUp(-2)));
        assert_eq!(of(PtcpFrame::Announce), None);
        assert!(Ptcp::parse(PtcpFrame::Reserved, Octets::new(&octets)).unwrap().is_none());
    }

    #[test]
    fn a_sync_has_its_domain_and_its_time() {
        let head = [&[0; 8][..], &[0, 0, 0, 7], &[0, 5, 3, 0], &[0, 0, 0, 73]].concat();
        let subdomain = [&[0x02, 22][..], &PORT.0, &[0xAB; 16]].concat();
        let time = [&[0x04, 10][..], &[0, 1, 0, 0, 0, 2, 0, 0, 0, 3]].concat();
        let octets = [head, subdomain, time, vec![0, 0]].concat();
        let sync = PtcpFrame::Sync { has_follow_up: true };
        let ptcp = Ptcp::parse(sync, Octets::new(&octets)).unwrap().unwrap();
        let delay = Delay::Sync { tens: 7, ones: 3, nanoseconds: 73 };
        assert_eq!((ptcp.sequence_id, ptcp.delay), (5, Some(delay)));
        let subdomain = PtcpValue::Subdomain { master: PORT, uuid: [0xAB; 16] };
        let time = PtcpValue::Time { epoch: 1, seconds: 2, nanoseconds: 3 };
        assert_eq!(values(&ptcp), [subdomain, time]);
    }

    #[test]
    fn the_other_tlvs_have_their_numbers() {
        let octets = frame(
            &[
                &[0x06, 4, 0, 1, 0, 37][..],
                &[0x08, 6, 1, 255, 255, 0x21, 0xFF, 0xFE],
                &[0x0A, 10, 0, 0, 0, 0, 0, 11, 0, 0, 0, 12],
                &[0x0E, 6, 0, 0, 0, 0, 0, 13],
                &[0xFE, 20, 0, 0x0E, 0xCF, 1],
                &[0xCD; 16],
                &[0xFE, 4, 0, 0x0E, 0xCF, 2],
                &[0x10, 1, 9],
            ]
            .concat(),
        );
        let ptcp = Ptcp::parse(PtcpFrame::Announce, Octets::new(&octets)).unwrap().unwrap();
        assert_eq!(
            values(&ptcp),
            [
                PtcpValue::TimeExtension { flags: 1, utc_offset: 37 },
                PtcpValue::Master {
                    priority_1: 1,
                    priority_2: 255,
                    clock_class: 255,
                    clock_accuracy: 0x21,
                    clock_variance: -2,
                },
                PtcpValue::PortParameter { receive_delay: 11, transmit_delay: 12 },
                PtcpValue::PortTime { received: 13 },
                PtcpValue::IrData { uuid: [0xCD; 16] },
                PtcpValue::Octets(&[0, 0x0E, 0xCF, 2]),
                PtcpValue::Octets(&[9]),
            ]
        );
    }

    #[test]
    fn a_tlv_that_is_cut_off_ends_them_with_an_error() {
        let octets = frame(&[0x0C, 200, 2]);
        let ptcp = Ptcp::parse(PtcpFrame::DelayRequest, Octets::new(&octets)).unwrap().unwrap();
        let all: Vec<_> = ptcp.tlvs().collect();
        assert!(matches!(&all[..], [Err(Malformed { offset: 26, .. })]), "{all:?}");
    }
}
