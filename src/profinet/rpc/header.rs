//! The 80 octets that every datagram of DCE/RPC begins with (C706 12.5.2.12).

use super::super::writer::Writer;
use super::super::{ByteOrder, Malformed, Octets, Uuid};

/// The version of the protocol without connections.
const VERSION: u8 = 4;

/// What a datagram is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PacketType {
    /// A client calls.
    Request = 0,
    /// A client asks what became of its call.
    Ping = 1,
    /// A server answers.
    Response = 2,
    /// The call failed while it ran.
    Fault = 3,
    /// The server is still at work.
    Working = 4,
    /// The server does not know the call.
    Nocall = 5,
    /// The server did not begin the call.
    Reject = 6,
    /// A client has the response.
    Ack = 7,
    /// A client gives its call up.
    ClCancel = 8,
    /// Which fragments have come.
    Fack = 9,
    /// The server has given the call up.
    CancelAck = 10,
}

impl PacketType {
    /// All packet types, in the order of their numbers.
    pub const ALL: [Self; 11] = [
        Self::Request,
        Self::Ping,
        Self::Response,
        Self::Fault,
        Self::Working,
        Self::Nocall,
        Self::Reject,
        Self::Ack,
        Self::ClCancel,
        Self::Fack,
        Self::CancelAck,
    ];

    /// The name in C706.
    pub fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Ping => "ping",
            Self::Response => "response",
            Self::Fault => "fault",
            Self::Working => "working",
            Self::Nocall => "nocall",
            Self::Reject => "reject",
            Self::Ack => "ack",
            Self::ClCancel => "cl_cancel",
            Self::Fack => "fack",
            Self::CancelAck => "cancel_ack",
        }
    }

    /// Whether a client sends it. The others come from the server, and a fack from either.
    pub fn is_from_client(self) -> bool {
        matches!(self, Self::Request | Self::Ping | Self::Ack | Self::ClCancel)
    }
}

/// The first octet of flags, bit by bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags1(pub u8);

impl Flags1 {
    /// The last fragment of a call.
    pub const LAST_FRAGMENT: u8 = 0x02;
    /// One of several fragments.
    pub const FRAGMENT: u8 = 0x04;
    /// No fack is wanted for this fragment.
    pub const NO_FACK: u8 = 0x08;
    /// No response is wanted.
    pub const MAYBE: u8 = 0x10;
    /// The call may be repeated.
    pub const IDEMPOTENT: u8 = 0x20;
    /// The call goes to many.
    pub const BROADCAST: u8 = 0x40;

    /// Whether this is the last fragment.
    pub fn is_last_fragment(self) -> bool {
        self.0 & Self::LAST_FRAGMENT != 0
    }

    /// Whether this is one of several fragments.
    pub fn is_fragment(self) -> bool {
        self.0 & Self::FRAGMENT != 0
    }

    /// Whether no fack is wanted.
    pub fn is_no_fack(self) -> bool {
        self.0 & Self::NO_FACK != 0
    }

    /// Whether no response is wanted.
    pub fn is_maybe(self) -> bool {
        self.0 & Self::MAYBE != 0
    }

    /// Whether the call may be repeated.
    pub fn is_idempotent(self) -> bool {
        self.0 & Self::IDEMPOTENT != 0
    }

    /// Whether the call goes to many.
    pub fn is_broadcast(self) -> bool {
        self.0 & Self::BROADCAST != 0
    }
}

/// The second octet of flags. All bits but one are reserved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags2(pub u8);

impl Flags2 {
    /// The call had been cancelled when it ended.
    pub const CANCEL_PENDING: u8 = 0x02;

    /// Whether the call had been cancelled when it ended.
    pub fn is_cancel_pending(self) -> bool {
        self.0 & Self::CANCEL_PENDING != 0
    }
}

/// How the numbers of a datagram are written (DREP).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Representation {
    /// The order of the octets of a number, in the header and behind it.
    pub order: ByteOrder,
    /// Characters are EBCDIC and not ASCII.
    pub ebcdic: bool,
    /// Floating-point numbers: 0 IEEE, 1 VAX, 2 Cray, 3 IBM.
    pub floating_point: u8,
}

impl Representation {
    fn read(octets: &mut Octets<'_>) -> Result<Self, Malformed> {
        let wrong = octets.wrong("a data representation that is reserved");
        let [numbers, floating_point, reserved] = octets.array()?;
        let order = match numbers >> 4 {
            0 => ByteOrder::Big,
            1 => ByteOrder::Little,
            _ => return Err(wrong),
        };
        let ebcdic = numbers & 0x0F;
        if ebcdic > 1 || floating_point > 3 || reserved != 0 {
            return Err(wrong);
        }
        Ok(Self { order, ebcdic: ebcdic == 1, floating_point })
    }

    fn octets(self) -> [u8; 3] {
        let order = if self.order == ByteOrder::Little { 0x10 } else { 0 };
        [order | u8::from(self.ebcdic), self.floating_point, 0]
    }
}

/// The fields of the header, numbers as values. The length of the body is that of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// What the datagram is for.
    pub packet_type: PacketType,
    /// The first octet of flags.
    pub flags1: Flags1,
    /// The second octet of flags.
    pub flags2: Flags2,
    /// How numbers are written.
    pub representation: Representation,
    /// Counts the datagrams of a fragmented call. Its octets stand apart on the wire.
    pub serial: u16,
    /// The node that is called.
    pub object: Uuid,
    /// The kind of node that is called.
    pub interface: Uuid,
    /// The conversation: the same in a request and what answers it.
    pub activity: Uuid,
    /// When the server started; 0 if the client does not know.
    pub server_boot: u32,
    /// The version of the interface: the major one in the low half.
    pub interface_version: u32,
    /// Counts the calls of an activity.
    pub sequence: u32,
    /// The operation of the interface (opnum).
    pub operation: u16,
    /// Where the server should look for the interface first; 0xFFFF: no hint.
    pub interface_hint: u16,
    /// Where the server should look for the activity first; 0xFFFF: no hint.
    pub activity_hint: u16,
    /// Which fragment this is, from 0. Of a fack or nocall: the last one before a gap.
    pub fragment_number: u16,
    /// Who proves who they are; 0: nobody, as always in PROFINET.
    pub auth_protocol: u8,
}

impl Header {
    /// Octets of every header (P-1).
    pub const LEN: usize = 80;

    /// A request without fragments, hints and proofs.
    pub fn request(order: ByteOrder, interface: Uuid, operation: u16) -> Self {
        Self {
            packet_type: PacketType::Request,
            flags1: Flags1(Flags1::IDEMPOTENT),
            flags2: Flags2(0),
            representation: Representation { order, ..Default::default() },
            serial: 0,
            object: Uuid::NIL,
            interface,
            activity: Uuid::NIL,
            server_boot: 0,
            interface_version: 1,
            sequence: 0,
            operation,
            interface_hint: 0xFFFF,
            activity_hint: 0xFFFF,
            fragment_number: 0,
            auth_protocol: 0,
        }
    }

    /// Reads a header, and how many octets it says come behind it.
    pub fn read(octets: &mut Octets<'_>) -> Result<(Self, u16), Malformed> {
        let version = octets.wrong("the version of DCE/RPC is not 4");
        if octets.u8()? != VERSION {
            return Err(version);
        }
        let unknown = octets.wrong("an unknown packet type");
        let packet_type = usize::from(octets.u8()?);
        let packet_type = *PacketType::ALL.get(packet_type).ok_or(unknown)?;
        let (flags1, flags2) = (Flags1(octets.u8()?), Flags2(octets.u8()?));
        let representation = Representation::read(octets)?;
        let serial_high = octets.u8()?;
        let mut ordered = octets.in_order(representation.order);
        let mut header = Self {
            packet_type,
            flags1,
            flags2,
            representation,
            serial: 0,
            object: Uuid::read(&mut ordered)?,
            interface: Uuid::read(&mut ordered)?,
            activity: Uuid::read(&mut ordered)?,
            server_boot: ordered.u32()?,
            interface_version: ordered.u32()?,
            sequence: ordered.u32()?,
            operation: ordered.u16()?,
            interface_hint: ordered.u16()?,
            activity_hint: ordered.u16()?,
            fragment_number: 0,
            auth_protocol: 0,
        };
        let body_len = ordered.u16()?;
        header.fragment_number = ordered.u16()?;
        header.auth_protocol = ordered.u8()?;
        header.serial = u16::from_be_bytes([serial_high, ordered.u8()?]);
        *octets = ordered;
        Ok((header, body_len))
    }

    /// A call in one piece is its fragment 0. Other packet types use the number for what they answer.
    pub(super) fn check_fragment(&self) -> Result<(), Malformed> {
        let is_call = matches!(self.packet_type, PacketType::Request | PacketType::Response);
        if is_call && !self.flags1.is_fragment() && self.fragment_number != 0 {
            return Err(Malformed { offset: 76, what: "a fragment number without fragments" });
        }
        Ok(())
    }

    pub(super) fn write(&self, body_len: u16, writer: &mut Writer<'_>) {
        let [serial_high, serial_low] = self.serial.to_be_bytes();
        writer.octets(&[VERSION, self.packet_type as u8, self.flags1.0, self.flags2.0]);
        writer.octets(&self.representation.octets());
        writer.octets(&[serial_high]);
        for uuid in [self.object, self.interface, self.activity] {
            writer.uuid(uuid);
        }
        for number in [self.server_boot, self.interface_version, self.sequence] {
            writer.u32(number);
        }
        for number in [self.operation, self.interface_hint, self.activity_hint] {
            writer.u16(number);
        }
        writer.u16(body_len);
        writer.u16(self.fragment_number);
        writer.octets(&[self.auth_protocol, serial_low]);
    }
}
