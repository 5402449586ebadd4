//! What the [core](super::Core) asks a protocol about a datagram. Nothing else in the NAT reads
//! octets, or knows which protocol a net has.

mod pnet;
mod profinet;

use super::net::{Credential, Net, NetKind};
use super::payload::Payload;
use super::reason::DropReason;
use super::time::Nanos;
use crate::pnet::wire;

pub(super) use pnet::{Header, Password};
#[cfg(test)]
pub(crate) use profinet::is_sound_call;
pub use profinet::{NoSuchRecord, Record, Records};

/// A well-formed request: what the core needs to know about it.
#[derive(Debug)]
pub(super) enum Request<'a> {
    PNet(pnet::Request),
    Profinet(profinet::Request<'a>),
}

/// A well-formed response.
#[derive(Debug)]
pub(super) struct Response {
    /// Its password, if it has one.
    pub password: Option<[u8; 8]>,
    /// Whether the request has its answer with it. There may be datagrams before.
    pub is_answer: bool,
}

/// What a protocol keeps of a flow besides its passwords.
#[derive(Debug)]
pub(super) enum Conversation {
    /// P-NET: a response says nothing about its request.
    PNet,
    Profinet(Box<profinet::Exchanges>),
}

impl<'a> Request<'a> {
    /// Checks the structure of a request, and what of it can be checked without a flow.
    #[inline]
    pub(super) fn parse(octets: &'a [u8], header: Header, net: &Net) -> Result<Self, DropReason> {
        match net.kind {
            NetKind::ProfinetDevice { records } => {
                profinet::Request::parse(octets, records).map(Self::Profinet)
            }
            NetKind::UdpRange { .. } | NetKind::Server | NetKind::Remote { .. } => {
                pnet::Request::parse(octets, header, net).map(Self::PNet)
            }
        }
    }

    /// The password, if it has one.
    #[inline]
    pub(super) fn password(&self) -> Option<&[u8; 8]> {
        match self {
            Self::PNet(request) => request.password.as_ref(),
            Self::Profinet(_) => None,
        }
    }

    /// Checks that the request is meant for the one node behind its public port, and that it goes on
    /// with what the flow of its client knows, if it does not begin something.
    #[inline]
    pub(super) fn is_for(
        &self,
        node_address: u8,
        conversation: Option<&Conversation>,
        now: Nanos,
    ) -> Result<(), DropReason> {
        match self {
            Self::PNet(request) => request.is_for(node_address),
            Self::Profinet(request) => {
                let exchanges = match conversation {
                    Some(Conversation::Profinet(exchanges)) => Some(&**exchanges),
                    _ => None,
                };
                request.goes_on(exchanges, now)
            }
        }
    }

    /// Whether it wants an answer.
    #[inline]
    pub(super) fn wants_answer(&self) -> bool {
        match self {
            Self::PNet(request) => request.confirmed,
            Self::Profinet(request) => request.wants_answer(),
        }
    }

    /// Notes the request in its flow. Returns the port of the server to send it to, where that is not
    /// the server's own.
    #[inline]
    pub(super) fn note(&self, conversation: &mut Conversation, now: Nanos) -> Option<u16> {
        match (self, conversation) {
            (Self::Profinet(request), Conversation::Profinet(exchanges)) => {
                exchanges.asked(request, now)
            }
            _ => None,
        }
    }
}

impl Conversation {
    /// That of a flow that begins.
    #[inline]
    pub(super) fn of(kind: NetKind) -> Self {
        match kind {
            NetKind::ProfinetDevice { .. } => Self::Profinet(Box::default()),
            NetKind::UdpRange { .. } | NetKind::Server | NetKind::Remote { .. } => Self::PNet,
        }
    }
}

/// Checks a response, which came from this port of the server, and notes it in its flow.
#[inline]
pub(super) fn response(
    octets: &[u8],
    header: Header,
    conversation: &mut Conversation,
    port: u16,
    now: Nanos,
) -> Result<Response, DropReason> {
    match conversation {
        Conversation::PNet => {
            let password = pnet::response(octets, header)?;
            Ok(Response { password, is_answer: true })
        }
        Conversation::Profinet(exchanges) => {
            let is_answer = profinet::response(octets, exchanges, port, now)?;
            Ok(Response { password: None, is_answer })
        }
    }
}

/// Gives a request the password that its server expects.
#[inline]
pub(super) fn for_server(
    payload: &mut Payload<'_>,
    net: &Net,
    credential: &Credential,
) -> Result<(), DropReason> {
    if net.kind.is_remote() {
        // A package without a password is never so long that there is no room.
        let has_room = payload.append(credential.password.octets());
        return if has_room { Ok(()) } else { Err(DropReason::TooLong) };
    }
    if let Some(device) = &credential.device_password {
        wire::replace_password(payload, device);
    }
    Ok(())
}

/// Gives a response, which has a password, the one that its client expects.
#[inline]
pub(super) fn for_client(payload: &mut Payload<'_>, net: &Net, credential: &Credential) {
    if net.kind.is_remote() {
        payload.cut(Password::LEN);
    } else if credential.device_password.is_some() {
        wire::replace_password(payload, &credential.password);
    }
}
