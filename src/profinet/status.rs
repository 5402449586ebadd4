//! PNIO status and the status of a fault or reject, as numbers and as words (P-5).
//!
//! Four octets say whether a call succeeded: which service, how the next two are to be read, and what went
//! wrong. A code without words keeps its number.

mod words;

pub use words::nca_words;

use std::fmt;

/// Whether a call succeeded, and if not, why not. All octets are 0 after success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct PnioStatus {
    /// Which service failed.
    pub code: u8,
    /// How the next two are to be read: 0x80 reading or writing, 0x81 a connection, 0x82 as the
    /// manufacturer says.
    pub decode: u8,
    /// What went wrong.
    pub code1: u8,
    /// What went wrong in detail.
    pub code2: u8,
}

impl PnioStatus {
    /// The call succeeded.
    pub const OK: Self = Self { code: 0, decode: 0, code1: 0, code2: 0 };

    /// Whether the call succeeded.
    pub fn is_ok(self) -> bool {
        self == Self::OK
    }

    /// Which service failed; none if the code is not known.
    pub fn service(self) -> Option<&'static str> {
        words::service(self.code)
    }

    /// What went wrong; none if it is not known.
    pub fn cause(self) -> Option<&'static str> {
        match self.decode {
            0x80 => words::record(self.code1),
            0x81 => words::connection(self.code1),
            _ => None,
        }
    }

    /// What went wrong in detail; none if it is not known.
    pub fn detail(self) -> Option<&'static str> {
        match self.decode {
            0x81 => words::detail(self.code1, self.code2),
            _ => None,
        }
    }
}

/// From its value as one number, the service in the highest octet.
impl From<u32> for PnioStatus {
    fn from(number: u32) -> Self {
        let [code, decode, code1, code2] = number.to_be_bytes();
        Self { code, decode, code1, code2 }
    }
}

impl From<PnioStatus> for u32 {
    fn from(PnioStatus { code, decode, code1, code2 }: PnioStatus) -> Self {
        Self::from_be_bytes([code, decode, code1, code2])
    }
}

impl fmt::Display for PnioStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_ok() {
            return f.write_str("OK");
        }
        match self.service() {
            Some(service) => f.write_str(service)?,
            None => write!(f, "service {:#04x}", self.code)?,
        }
        match (self.cause(), self.decode) {
            (Some(cause), _) => write!(f, ": {cause}")?,
            (None, 0x82) => write!(f, ": manufacturer's error {:#04x}", self.code1)?,
            (None, decode) => write!(f, ": error {:#04x} (decode {decode:#04x})", self.code1)?,
        }
        match self.detail() {
            Some(detail) => write!(f, ", {detail}"),
            None if self.is_parameter() => write!(f, ", parameter {}", self.code2),
            None if self.code2 != 0 => write!(f, ", detail {:#04x}", self.code2),
            None => Ok(()),
        }
    }
}

impl PnioStatus {
    /// Whether the last octet counts the fields of the block that is wrong, from its type on as 0.
    fn is_parameter(self) -> bool {
        self.decode == 0x81 && matches!(self.code1, 1..=56)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_5_a_status_is_said_in_words() {
        for (number, words) in [
            (0, "OK"),
            (0xDE80_B000, "Read failed: invalid index"),
            (0xDF80_B500, "Write failed: state conflict"),
            (0xDB81_0104, "Connect failed: ARBlockReq is wrong, parameter 4"),
            (0xDB81_4004, "Connect failed: CMRPC, no resources for another AR"),
            (0xDD81_3D00, "Control failed: CMDEV, state conflict"),
            (
                0xCF81_FD05,
                "alarm connection ended: RTA protocol, consumer of cyclic data timed out",
            ),
            (0xDF82_1202, "Write failed: manufacturer's error 0x12, detail 0x02"),
            (0x1281_EE01, "service 0x12: error 0xee (decode 0x81), detail 0x01"),
        ] {
            let status = PnioStatus::from(number);
            assert_eq!(status.to_string(), words);
            assert_eq!(u32::from(status), number);
        }
    }

    #[test]
    fn p_4_why_a_call_was_rejected_is_said_in_words() {
        assert_eq!(nca_words(0x1C01_0003), Some("nca_unk_if: the interface is not known"));
        assert_eq!(nca_words(0x1C00_00FF), None);
    }
}
