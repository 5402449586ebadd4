//! The header of acknowledged RT frames (RTA), which carry alarms (P-2, P-10).
//!
//! The contents of a DATA frame are PNIO blocks, with views of their own.

use super::octets::{Malformed, Octets};

/// A frame of an alarm connection.
#[derive(Clone, Copy, Debug)]
pub struct AlarmFrame<'a> {
    /// The receiver's number of the connection.
    pub destination_endpoint: u16,
    /// The sender's number of the connection.
    pub source_endpoint: u16,
    /// What it is.
    pub pdu_type: PduType,
    /// The version of the protocol: 1, or 2.
    pub version: u8,
    /// How many DATA frames may be on their way without an acknowledgement. It is 1.
    pub window_size: u8,
    /// The sender wants an acknowledgement at once. The four bits as they are: 0 or 1.
    pub immediate_acknowledge: u8,
    /// The number of this DATA frame; the next one after 0xFFFF is 0.
    pub send_sequence: u16,
    /// The number of the DATA frame that was received last.
    pub acknowledge_sequence: u16,
    /// Blocks in a DATA frame, the status in an ERR frame, nothing in the others. Offsets count from
    /// the frame ID on.
    pub contents: Octets<'a>,
}

/// The kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PduType {
    /// An alarm, or the application's answer to one.
    Data,
    /// A DATA frame had another number than the expected one.
    NegativeAcknowledge,
    /// A DATA frame was received.
    Acknowledge,
    /// The connection ends, for the reason of its contents.
    Error,
    /// A frame of the security functions, or a number that is not in use.
    Other(u8),
}

impl<'a> AlarmFrame<'a> {
    /// Octets of the header.
    pub const HEADER_LEN: usize = 12;

    /// Reads what is behind the frame ID. Padding behind the contents is left out.
    pub fn parse(mut octets: Octets<'a>) -> Result<Self, Malformed> {
        let [destination_endpoint, source_endpoint] = [octets.u16()?, octets.u16()?];
        let (kind, flags) = (octets.u8()?, octets.u8()?);
        let [send_sequence, acknowledge_sequence] = [octets.u16()?, octets.u16()?];
        let length = octets.u16()?;
        Ok(Self {
            destination_endpoint,
            source_endpoint,
            pdu_type: PduType::from(kind & 0x0F),
            version: kind >> 4,
            window_size: flags & 0x0F,
            immediate_acknowledge: flags >> 4,
            send_sequence,
            acknowledge_sequence,
            contents: octets.part(length.into())?,
        })
    }

    /// Why the connection ends: the PNIO status of an ERR frame. None in other frames.
    pub fn error_status(&self) -> Result<Option<[u8; 4]>, Malformed> {
        match self.pdu_type {
            PduType::Error => self.contents.clone().array().map(Some),
            _ => Ok(None),
        }
    }
}

impl From<u8> for PduType {
    fn from(number: u8) -> Self {
        match number {
            1 => Self::Data,
            2 => Self::NegativeAcknowledge,
            3 => Self::Acknowledge,
            4 => Self::Error,
            other => Self::Other(other),
        }
    }
}

impl PduType {
    /// The number in the frame.
    pub fn number(self) -> u8 {
        match self {
            Self::Data => 1,
            Self::NegativeAcknowledge => 2,
            Self::Acknowledge => 3,
            Self::Error => 4,
            Self::Other(number) => number,
        }
    }

    /// Its name in the standard.
    pub fn name(self) -> &'static str {
        match self {
            Self::Data => "DATA-RTA",
            Self::NegativeAcknowledge => "NACK-RTA",
            Self::Acknowledge => "ACK-RTA",
            Self::Error => "ERR-RTA",
            Self::Other(5) => "FREQ-RTA",
            Self::Other(6) => "FRSP-RTA",
            Self::Other(_) => "reserved",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_10_an_alarm_has_its_connection_and_its_contents() {
        let octets = [0, 1, 0, 2, 0x11, 0x11, 0, 5, 0xFF, 0xFE, 0, 3, 0xAA, 0xBB, 0xCC, 0, 0];
        let frame = AlarmFrame::parse(Octets::new(&octets)).unwrap();
        assert_eq!((frame.destination_endpoint, frame.source_endpoint), (1, 2));
        assert_eq!((frame.pdu_type, frame.version), (PduType::Data, 1));
        assert_eq!((frame.window_size, frame.immediate_acknowledge), (1, 1));
        assert_eq!((frame.send_sequence, frame.acknowledge_sequence), (5, 0xFFFE));
        // The padding of the frame is not part of the contents.
        assert_eq!(frame.contents.rest(), [0xAA, 0xBB, 0xCC]);
        assert_eq!(frame.contents.offset(), AlarmFrame::HEADER_LEN);
        assert_eq!(frame.error_status(), Ok(None));
    }

    #[test]
    fn p_10_an_error_has_its_status() {
        let octets = [0, 1, 0, 2, 0x14, 0x01, 0, 5, 0, 4, 0, 4, 0xCF, 0x81, 0xFD, 5];
        let frame = AlarmFrame::parse(Octets::new(&octets)).unwrap();
        assert_eq!(frame.pdu_type.name(), "ERR-RTA");
        assert_eq!(frame.error_status(), Ok(Some([0xCF, 0x81, 0xFD, 5])));
        let mut short = octets;
        short[11] = 2;
        let frame = AlarmFrame::parse(Octets::new(&short)).unwrap();
        assert_eq!(frame.error_status().unwrap_err().offset, 14);
    }

    #[test]
    fn numbers_and_names_belong_together() {
        let names = ["DATA-RTA", "NACK-RTA", "ACK-RTA", "ERR-RTA", "FREQ-RTA", "FRSP-RTA"];
        for (number, name) in (1..).zip(names) {
            let kind = PduType::from(number);
            assert_eq!((kind.number(), kind.name()), (number, name));
        }
        assert_eq!(PduType::from(0).name(), "reserved");
    }

    #[test]
    fn contents_that_are_longer_than_the_frame_are_told() {
        let octets = [0, 1, 0, 2, 0x11, 0x11, 0, 5, 0xFF, 0xFE, 0, 9, 0xAA];
        assert_eq!(AlarmFrame::parse(Octets::new(&octets)).unwrap_err().offset, 13);
    }
}
