//! The kernel's part of the checks: a classic BPF program on a public socket, the request filter.
//! It refuses a datagram that cannot pass before the datagram is queued or copied, or wakes the
//! worker.
//!
//! The program looks at lengths, header and password. On a socket of all addresses it also looks at
//! the address that a datagram was sent to. It never looks at the sender. It never refuses what the
//! relay would accept: where it cannot decide, it lets the datagram through. It needs no privilege.

use std::mem;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use libc::{
    BPF_ABS, BPF_ADD, BPF_ALU, BPF_AND, BPF_B, BPF_IMM, BPF_IND, BPF_JA, BPF_JEQ, BPF_JGE, BPF_JGT,
    BPF_JMP, BPF_JSET, BPF_K, BPF_LD, BPF_LDX, BPF_LEN, BPF_MEM, BPF_MISC, BPF_ST, BPF_SUB,
    BPF_TAX, BPF_W, BPF_X,
};

use crate::nat::{Credential, DropReason, Net, NetId, NetKind, Table};
use crate::pnet::wire::{self, Header, Password};

use crate::datapath::kernel_filter::assembler::{Program, To};
use crate::datapath::kernel_filter::rpc;

/// The most passwords that the kernel compares. With more of them the program would be too long.
const MOST_PASSWORDS: usize = 40;

/// Offset of the destination address, counted from the IPv4 header and from the IPv6 header.
const IPV4_DESTINATION: u32 = libc::SKF_NET_OFF as u32 + 16;
const IPV6_DESTINATION: u32 = libc::SKF_NET_OFF as u32 + 24;
/// Offset of the datagram. What the program sees begins with the UDP header.
const DATAGRAM: u32 = 8;
const ROUTE: u32 = DATAGRAM + Header::LEN as u32;
/// Offset of the data-field-format, to which the length of the route is added: it stands behind the
/// route and the one octet of control-status.
const DATA_FIELD_FORMAT: u32 = ROUTE + 1;
/// Octets of control-status and data-field-format.
const CONTROL: u32 = 2;
const PASSWORD: u32 = Password::LEN as u32;

/// Bit 8 of a route octet. It marks a source address.
const SOURCE: u32 = 0x80;
/// Bits of the data-field-format that count data octets.
const DATA_SIZE: u32 = 0x3f;

/// Whether a net of one table and a net of another have the same program.
pub(in crate::datapath) fn is_same(one: (&Table, NetId), other: (&Table, NetId)) -> bool {
    let (net, other_net) = (one.0.net(one.1), other.0.net(other.1));
    let same = |(one, other): (&Credential, &Credential)| {
        bool::from(one.password.matches(other.password.octets()))
    };
    one.0.header == other.0.header
        && mem::discriminant(&net.kind) == mem::discriminant(&other_net.kind)
        && net.allow_without_password == other_net.allow_without_password
        && net.credentials.len() == other_net.credentials.len()
        && net.credentials.iter().zip(&other_net.credentials).all(same)
}

/// Whether the request filter keeps most of the datagrams that are dropped for this reason from the
/// worker. The filter does not look at the sender, but a sender that is not allowed or is throttled
/// hardly ever has a right password.
pub(in crate::datapath) fn is_refused_by_filter(reason: DropReason) -> bool {
    match reason {
        DropReason::NotUnicast
        | DropReason::TooShort
        | DropReason::TooLong
        | DropReason::BadHeader
        | DropReason::BadRoute
        | DropReason::RouteFormat
        | DropReason::BadLength
        | DropReason::PasswordMissing
        | DropReason::PasswordUnexpected
        | DropReason::PacketType
        | DropReason::RpcInterface
        | DropReason::RpcConnect
        | DropReason::RpcRelease
        | DropReason::RpcRead
        | DropReason::RpcWrite
        | DropReason::RpcControl
        | DropReason::Unanswerable
        | DropReason::SourceNotAllowed
        | DropReason::Throttled
        | DropReason::PasswordWrong => true,
        DropReason::Broadcast
        | DropReason::Loop
        | DropReason::NodeMismatch
        | DropReason::BadNdr
        | DropReason::RecordNotAllowed
        | DropReason::UnknownExchange
        | DropReason::RequestLimit
        | DropReason::FlowLimit
        | DropReason::UpstreamExhausted
        | DropReason::SendFailed
        | DropReason::UnknownFlow
        | DropReason::PasswordMismatch => false,
    }
}

/// Makes the program that refuses, on a public socket, what its net would refuse. `listen` is the
/// address of the socket. The program checks the destination only on a socket of all addresses,
/// because a socket of one address gets no datagram that was sent to another.
pub(in crate::datapath) fn program(header: Header, net: &Net, listen: IpAddr) -> Program {
    if let NetKind::ProfinetDevice { .. } = net.kind {
        return rpc::program(listen);
    }
    let is_remote = net.kind.is_remote();
    let without_password = net.allow_without_password || is_remote;
    let shortest = if without_password { wire::MIN_DATAGRAM } else { wire::MIN_SECURE_DATAGRAM };
    let mut program = Program::new();
    refuse_many(&mut program, listen);
    // The length of the datagram. It is kept in M[0].
    program.step(BPF_LD | BPF_W | BPF_LEN, 0);
    program.step(BPF_ALU | BPF_SUB | BPF_K, DATAGRAM);
    program.compare(BPF_JGE, shortest as u32, To::Next, To::Refuse);
    program.compare(BPF_JGT, wire::MAX_DATAGRAM as u32, To::Refuse, To::Next);
    program.step(BPF_ST, 0);
    // Header.
    program.step(BPF_LD | BPF_W | BPF_ABS, DATAGRAM);
    program.compare(BPF_JEQ, u32::from_be_bytes(header.0), To::Next, To::Refuse);
    // Two destinations, then two sources (Extended) or the remaining-route-length (IP).
    for octet in 0..2 {
        program.step(BPF_LD | BPF_B | BPF_ABS, ROUTE + octet);
        program.compare(BPF_JSET, SOURCE, To::Refuse, To::Next);
    }
    program.step(BPF_LD | BPF_B | BPF_ABS, ROUTE + 2);
    program.compare(BPF_JSET, SOURCE, To::Skip(4), To::Next);
    // IP: the length of the route goes to X.
    program.compare(BPF_JGT, (wire::MAX_ROUTE - 3) as u32, To::Refuse, To::Next);
    program.step(BPF_ALU | BPF_ADD | BPF_K, 3);
    program.step(BPF_MISC | BPF_TAX, 0);
    program.step(BPF_JMP | BPF_JA, 3);
    // Extended: the length of the route goes to X too.
    program.step(BPF_LD | BPF_B | BPF_ABS, ROUTE + 3);
    program.compare(BPF_JSET, SOURCE, To::Next, To::Refuse);
    program.step(BPF_LDX | BPF_IMM, 4);
    // The length of header, route, control and data octets goes to X. It is the offset of the
    // octets behind them.
    program.step(BPF_LD | BPF_B | BPF_IND, DATA_FIELD_FORMAT);
    program.step(BPF_ALU | BPF_AND | BPF_K, DATA_SIZE);
    program.step(BPF_ALU | BPF_ADD | BPF_X, 0);
    program.step(BPF_ALU | BPF_ADD | BPF_K, Header::LEN as u32 + CONTROL);
    program.step(BPF_MISC | BPF_TAX, 0);
    // A password stands behind them, or nothing where the net allows or demands that.
    program.step(BPF_LD | BPF_MEM, 0);
    program.step(BPF_ALU | BPF_SUB | BPF_X, 0);
    if without_password {
        program.compare(BPF_JEQ, 0, To::Accept, To::Next);
    }
    if is_remote {
        return program;
    }
    if net.credentials.len() > MOST_PASSWORDS {
        program.compare(BPF_JEQ, PASSWORD, To::Accept, To::Refuse);
        return program;
    }
    program.compare(BPF_JEQ, PASSWORD, To::Next, To::Refuse);
    for credential in &net.credentials {
        let [a, b, c, d, e, f, g, h] = *credential.password.octets();
        program.step(BPF_LD | BPF_W | BPF_IND, DATAGRAM);
        program.compare(BPF_JEQ, u32::from_be_bytes([a, b, c, d]), To::Next, To::Skip(2));
        program.step(BPF_LD | BPF_W | BPF_IND, DATAGRAM + 4);
        program.compare(BPF_JEQ, u32::from_be_bytes([e, f, g, h]), To::Accept, To::Next);
    }
    // No password fits: the program goes on to the end that refuses.
    program
}

/// Refuses what was sent to many, on a socket that listens at this address.
pub(super) fn refuse_many(program: &mut Program, listen: IpAddr) {
    // The broadcast address of a single network cannot be told from other addresses here.
    match listen {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => {
            program.step(BPF_LD | BPF_W | BPF_ABS, IPV4_DESTINATION);
            program.compare(BPF_JEQ, Ipv4Addr::BROADCAST.to_bits(), To::Refuse, To::Next);
            program.step(BPF_ALU | BPF_AND | BPF_K, 0xf000_0000);
            program.compare(BPF_JEQ, 0xe000_0000, To::Refuse, To::Next);
        }
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => {
            program.step(BPF_LD | BPF_B | BPF_ABS, IPV6_DESTINATION);
            program.compare(BPF_JEQ, 0xff, To::Refuse, To::Next);
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests;
