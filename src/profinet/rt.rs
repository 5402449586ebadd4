//! The RT frame of PROFINET: its frame ID, and the status behind cyclic data (P-1, P-2).
//!
//! What a frame holds is told by its frame ID alone. Alarms, DCP and PTCP have views of their own; they
//! begin behind the frame ID. Invariant: the padding of a short frame is part of cyclic data, since only
//! the configuration of the connection tells where the data end.

use super::octets::{Malformed, Octets};

/// The Ethertype of RT frames.
pub const ETHER_TYPE: u16 = 0x8892;

/// The first two octets of an RT frame: they say what it is, or whose cyclic data it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FrameId(pub u16);

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// Cyclic data, with an [`ApduStatus`] at the end.
    Cyclic(RtClass),
    /// An acknowledged alarm, or what answers it.
    Alarm(AlarmPriority),
    /// The discovery and configuration protocol.
    Dcp(DcpFrame),
    /// The clock protocol.
    Ptcp(PtcpFrame),
    /// A part of a frame that was cut up.
    Fragment,
    /// A number that is not in use.
    Reserved,
}

/// The real-time class of cyclic data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RtClass {
    /// RT class 1. Older devices have RT class 2 there.
    Class1,
    /// RT class 1 with the numbers of older devices, which is also RT over UDP.
    Class1Legacy,
    /// RT class 3: isochronous. Redundant where the same data goes both ways round a ring.
    Class3 {
        /// Frames of media redundancy with planned duplication.
        is_redundant: bool,
    },
}

/// Which of the two alarm queues a frame belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlarmPriority {
    /// Frame ID 0xFC01.
    High,
    /// Frame ID 0xFE01.
    Low,
}

/// The DCP services by frame ID.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DcpFrame {
    /// A device tells by itself that it is there.
    Hello,
    /// Get and Set, and their answers.
    GetSet,
    /// Who is there?
    IdentifyRequest,
    /// I am.
    IdentifyResponse,
}

/// The frames of the clock protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PtcpFrame {
    /// Sync, with or without a follow-up behind it.
    Sync {
        /// The exact delay comes in a frame of its own.
        has_follow_up: bool,
    },
    /// The exact delay of a sync frame.
    FollowUp,
    /// A clock master tells of itself.
    Announce,
    /// Asks the neighbour for the delay of the line.
    DelayRequest,
    /// The answer, with or without a follow-up behind it.
    DelayResponse {
        /// The exact delay comes in a frame of its own.
        has_follow_up: bool,
    },
    /// The exact delay of a response.
    DelayFollowUp,
    /// A number of the range that is not in use.
    Reserved,
}

impl FrameId {
    /// What a frame with this ID is.
    pub fn kind(self) -> FrameKind {
        use FrameKind::{Alarm, Cyclic, Dcp, Fragment, Ptcp, Reserved};
        match self.0 {
            0x0020 | 0x0021 => Ptcp(PtcpFrame::Sync { has_follow_up: true }),
            0x0080 | 0x0081 => Ptcp(PtcpFrame::Sync { has_follow_up: false }),
            0x0000..=0x00FF => Ptcp(PtcpFrame::Reserved),
            0x0100..=0x06FF => Cyclic(RtClass::Class3 { is_redundant: false }),
            0x0700..=0x0FFF => Cyclic(RtClass::Class3 { is_redundant: true }),
            0x8000..=0xBFFF => Cyclic(RtClass::Class1),
            0xC000..=0xFBFF => Cyclic(RtClass::Class1Legacy),
            0xFC01 => Alarm(AlarmPriority::High),
            0xFE01 => Alarm(AlarmPriority::Low),
            0xFEFC => Dcp(DcpFrame::Hello),
            0xFEFD => Dcp(DcpFrame::GetSet),
            0xFEFE => Dcp(DcpFrame::IdentifyRequest),
            0xFEFF => Dcp(DcpFrame::IdentifyResponse),
            0xFF00 | 0xFF01 => Ptcp(PtcpFrame::Announce),
            0xFF20 | 0xFF21 => Ptcp(PtcpFrame::FollowUp),
            0xFF40 => Ptcp(PtcpFrame::DelayRequest),
            0xFF41 => Ptcp(PtcpFrame::DelayResponse { has_follow_up: true }),
            0xFF42 => Ptcp(PtcpFrame::DelayFollowUp),
            0xFF43 => Ptcp(PtcpFrame::DelayResponse { has_follow_up: false }),
            0xFF00..=0xFF7F => Ptcp(PtcpFrame::Reserved),
            0xFF80..=0xFF8F => Fragment,
            _ => Reserved,
        }
    }

    /// The kind in words.
    pub fn name(self) -> &'static str {
        match self.kind() {
            FrameKind::Cyclic(class) => self.class_name(class),
            FrameKind::Alarm(AlarmPriority::High) => "alarm high",
            FrameKind::Alarm(AlarmPriority::Low) => "alarm low",
            FrameKind::Dcp(DcpFrame::Hello) => "DCP hello",
            FrameKind::Dcp(DcpFrame::GetSet) => "DCP get or set",
            FrameKind::Dcp(DcpFrame::IdentifyRequest) => "DCP identify request",
            FrameKind::Dcp(DcpFrame::IdentifyResponse) => "DCP identify response",
            FrameKind::Ptcp(frame) => frame.name(),
            FrameKind::Fragment => "RT fragment",
            FrameKind::Reserved => "reserved",
        }
    }

    fn class_name(self, class: RtClass) -> &'static str {
        match (class, self.0) {
            (RtClass::Class1, 0xBC00..) => "RT class 1 multicast",
            (RtClass::Class1, _) => "RT class 1",
            (RtClass::Class1Legacy, 0xF800..) => "RT class 1 legacy multicast",
            (RtClass::Class1Legacy, _) => "RT class 1 legacy",
            (RtClass::Class3 { is_redundant: false }, _) => "RT class 3",
            (RtClass::Class3 { is_redundant: true }, _) => "RT class 3 redundant",
        }
    }
}

impl PtcpFrame {
    /// The frame in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sync { has_follow_up: true } => "PTCP sync with follow-up",
            Self::Sync { has_follow_up: false } => "PTCP sync",
            Self::FollowUp => "PTCP follow-up",
            Self::Announce => "PTCP announce",
            Self::DelayRequest => "PTCP delay request",
            Self::DelayResponse { has_follow_up: true } => "PTCP delay response with follow-up",
            Self::DelayResponse { has_follow_up: false } => "PTCP delay response",
            Self::DelayFollowUp => "PTCP delay follow-up",
            Self::Reserved => "PTCP reserved",
        }
    }
}

/// An RT frame: its ID, and all behind it.
#[derive(Clone, Copy, Debug)]
pub struct RtFrame<'a> {
    /// What it is.
    pub frame_id: FrameId,
    /// Behind the frame ID. Offsets count from the frame ID on.
    pub behind: Octets<'a>,
}

impl<'a> RtFrame<'a> {
    /// The frame in the payload of an Ethernet frame.
    pub fn parse(octets: &'a [u8]) -> Result<Self, Malformed> {
        let mut behind = Octets::new(octets);
        Ok(Self { frame_id: FrameId(behind.u16()?), behind })
    }
}

/// Cyclic data and its status.
#[derive(Clone, Copy, Debug)]
pub struct CyclicData<'a> {
    /// The data with the provider and consumer status of each submodule, and the padding.
    pub data: &'a [u8],
    /// The last four octets.
    pub status: ApduStatus,
}

impl<'a> CyclicData<'a> {
    /// Reads what is behind the frame ID of a frame that was captured to its end.
    pub fn parse(mut behind: Octets<'a>) -> Result<Self, Malformed> {
        let Some(data) = behind.len().checked_sub(ApduStatus::LEN) else {
            return Err(behind.wrong("cyclic data has a status of four octets at its end"));
        };
        let data = behind.take(data)?;
        let cycle_counter = behind.u16()?;
        let data_status = DataStatus(behind.u8()?);
        let transfer_status = TransferStatus(behind.u8()?);
        Ok(Self { data, status: ApduStatus { cycle_counter, data_status, transfer_status } })
    }
}

/// The status at the end of cyclic data (P-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ApduStatus {
    /// When it was sent, in units of 31.25 µs, modulo 65536.
    pub cycle_counter: u16,
    /// What the data is worth.
    pub data_status: DataStatus,
    /// What went wrong on the way.
    pub transfer_status: TransferStatus,
}

impl ApduStatus {
    /// Octets of the status.
    pub const LEN: usize = 4;
}

/// What cyclic data is worth, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataStatus(pub u8);

impl DataStatus {
    /// Bit 0: from the primary of two redundant controllers, not from the backup.
    pub fn is_primary(self) -> bool {
        self.0 & 0x01 != 0
    }

    /// Bit 1: with redundant controllers, none or both are the primary.
    pub fn has_redundancy_fault(self) -> bool {
        self.0 & 0x02 != 0
    }

    /// Bit 2: the data is valid.
    pub fn is_valid(self) -> bool {
        self.0 & 0x04 != 0
    }

    /// Bit 4: the provider is in RUN, not in STOP.
    pub fn is_running(self) -> bool {
        self.0 & 0x10 != 0
    }

    /// Bit 5: the station has no problem. In the other case there is a diagnosis to read.
    pub fn is_without_problem(self) -> bool {
        self.0 & 0x20 != 0
    }

    /// Bit 7: the receiver ignores this data.
    pub fn is_ignored(self) -> bool {
        self.0 & 0x80 != 0
    }

    /// Bits 3 and 6, which are 0.
    pub fn reserved(self) -> u8 {
        self.0 & 0x48
    }
}

/// What went wrong on the way of cyclic data. It is 0 but for RT class 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransferStatus(pub u8);

impl TransferStatus {
    /// The bits that are set, in words.
    pub fn faults(self) -> impl Iterator<Item = &'static str> {
        const FAULTS: [(u8, &str); 4] = [
            (0x01, "alignment or checksum"),
            (0x02, "length"),
            (0x04, "receive buffer full"),
            (0x08, "outside its phase"),
        ];
        let known = FAULTS.into_iter().filter(move |(bit, _)| self.0 & bit != 0);
        known.map(|(_, name)| name).chain((self.0 > 0x0F).then_some("reserved bits"))
    }
}

/// The status of a submodule in cyclic data: of the provider behind its data, or of the consumer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IoStatus(pub u8);

impl IoStatus {
    /// Bit 7: the data can be used, or was used.
    pub fn is_good(self) -> bool {
        self.0 & 0x80 != 0
    }

    /// Bits 5 and 6: who says that it is bad.
    pub fn instance_name(self) -> &'static str {
        match self.0 >> 5 & 0x03 {
            0 => "subslot",
            1 => "slot",
            2 => "device",
            _ => "controller",
        }
    }
}

#[cfg(test)]
mod tests;
