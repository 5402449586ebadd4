//! Any octets, through every view of PROFINET. What a view shows is in the octets, and so is the place
//! of each error. Every list ends. What can be emitted is emitted as it was read.

pub mod seeds;
mod shown;

use pnet_nat::profinet::alarm::{AlarmFrame, PduType};
use pnet_nat::profinet::blocks::{Block, Blocks, IodReadReqHeader, Record};
use pnet_nat::profinet::dcp::{self, Dcp, DcpBlock, DcpValue, ServiceId, ServiceType};
use pnet_nat::profinet::diagnosis::{self, DiagnosisEntry};
use pnet_nat::profinet::endpoint_mapper::{HANDLE_FREE, LOOKUP, Message};
use pnet_nat::profinet::lldp::{self, Address, Lldp, LldpValue, Names, OrganisationValue};
use pnet_nat::profinet::mrp::{self, Mrp, MrpValue};
use pnet_nat::profinet::ptcp::{Ptcp, PtcpValue};
use pnet_nat::profinet::rpc::{Body, Header, Interface, PacketType, ReadImplicit, Rpc};
use pnet_nat::profinet::rt::{CyclicData, FrameId, FrameKind, PtcpFrame, RtFrame};
use pnet_nat::profinet::{ByteOrder, ObjectUuid, Octets, PnioStatus, Uuid, ndr, records, rpc};

use shown::Frame;

const ORDERS: [ByteOrder; 2] = [ByteOrder::Big, ByteOrder::Little];

/// What the first octet chooses among.
const PARSERS: [fn(&Frame<'_>) -> bool; 11] = [
    rt_frame,
    dcp_frame,
    alarm_frame,
    lldp_frame,
    mrp_frame,
    ptcp_frame,
    rpc_datagram,
    ndr_stub,
    endpoint_mapper_stub,
    row_of_blocks,
    diagnosis_entries,
];

/// Gives all octets but the first one to the parser that the first one chooses.
pub fn holds(octets: &[u8]) {
    reads(octets);
}

/// The same. True if nothing of it is malformed.
pub fn reads(octets: &[u8]) -> bool {
    let Some((&parser, octets)) = octets.split_first() else { return false };
    let frame = Frame::new(octets);
    PARSERS[usize::from(parser) % PARSERS.len()](&frame) && !frame.has_fault()
}

fn rt_frame(frame: &Frame<'_>) -> bool {
    let Some(rt) = frame.read(RtFrame::parse(frame.octets)) else { return false };
    assert!(!rt.frame_id.name().is_empty());
    match rt.frame_id.kind() {
        FrameKind::Cyclic(_) => cyclic_data(frame, rt.behind),
        FrameKind::Alarm(_) => alarm(frame, rt.behind),
        FrameKind::Dcp(_) => dcp(frame, rt.behind),
        FrameKind::Ptcp(kind) => ptcp(frame, kind, rt.behind),
        FrameKind::Fragment | FrameKind::Reserved => false,
    }
}

fn cyclic_data(frame: &Frame<'_>, behind: Octets<'_>) -> bool {
    let Some(cyclic) = frame.read(CyclicData::parse(behind)) else { return false };
    frame.has(cyclic.data);
    assert!(cyclic.status.transfer_status.faults().count() <= 5);
    true
}

fn dcp_frame(frame: &Frame<'_>) -> bool {
    dcp(frame, Octets::new(frame.octets))
}

fn dcp(frame: &Frame<'_>, behind: Octets<'_>) -> bool {
    let Some(dcp) = frame.read(Dcp::parse(behind)) else { return false };
    assert_eq!(ServiceId::from(dcp.service_id.number()), dcp.service_id);
    assert_eq!(ServiceType::from(dcp.service_type.number()), dcp.service_type);
    assert!(!dcp.service_id.name().is_empty() && !dcp.service_type.name().is_empty());
    frame.all(dcp.blocks()).iter().for_each(|block| dcp_block(frame, block));
    true
}

fn dcp_block(frame: &Frame<'_>, block: &DcpBlock<'_>) {
    dcp::option_name(block.option);
    dcp::suboption_name(block.option, block.suboption);
    block.qualifier.map(dcp::reset_name);
    block.info.map(dcp::ip_block_info_name);
    match block.value {
        DcpValue::Text(shown)
        | DcpValue::DeviceOptions(shown)
        | DcpValue::Octets(shown)
        | DcpValue::Dhcp { value: shown, .. } => frame.has(shown),
        DcpValue::DeviceRole(roles) => assert!(dcp::role_names(roles).count() <= 8),
        DcpValue::Response { error, .. } => drop(dcp::block_error_name(error).to_owned()),
        _ => {}
    }
}

fn alarm_frame(frame: &Frame<'_>) -> bool {
    alarm(frame, Octets::new(frame.octets))
}

fn alarm(frame: &Frame<'_>, behind: Octets<'_>) -> bool {
    let Some(alarm) = frame.read(AlarmFrame::parse(behind)) else { return false };
    assert_eq!(PduType::from(alarm.pdu_type.number()), alarm.pdu_type);
    assert!(!alarm.pdu_type.name().is_empty());
    frame.has(alarm.contents.rest());
    if let Some(Some(status)) = frame.read(alarm.error_status()) {
        pnio_status(frame, u32::from_be_bytes(status));
    }
    if alarm.pdu_type == PduType::Data {
        blocks(frame, Blocks::new(alarm.contents));
    }
    true
}

fn pnio_status(frame: &Frame<'_>, number: u32) {
    let status = PnioStatus::from(number);
    assert_eq!(u32::from(status), number);
    frame.show(&status);
}

fn lldp_frame(frame: &Frame<'_>) -> bool {
    let tlvs = frame.all(Lldp::new(frame.octets).tlvs());
    let mut names = [&[][..]; 2];
    for tlv in &tlvs {
        assert!((1..=127).contains(&tlv.kind) && !tlv.name().is_empty());
        match tlv.value {
            LldpValue::ChassisId(id) | LldpValue::PortId(id) => {
                names[usize::from(tlv.kind == 2)] = lldp_address(frame, id.value);
            }
            LldpValue::Text(shown) | LldpValue::Octets(shown) => frame.has(shown),
            LldpValue::TimeToLive(_) => {}
            LldpValue::Capabilities { supported, enabled } => {
                assert!(lldp::capability_names(supported | enabled).count() <= 8);
            }
            LldpValue::ManagementAddress { address, object_id, .. } => {
                lldp_address(frame, address);
                frame.has(object_id);
            }
            LldpValue::Organisation { oui, subtype, value } => {
                assert!(!OrganisationValue::name(oui, subtype).is_empty());
                organisation(frame, value);
            }
        }
    }
    if let Some(names) = Names::of(names[0], names[1]) {
        assert!(names.port.starts_with("port-") && !names.station.is_empty());
        assert!(names.to_string().contains(names.station));
    }
    !tlvs.is_empty()
}

/// Its characters, if it is made of them.
fn lldp_address<'a>(frame: &Frame<'_>, address: Address<'a>) -> &'a [u8] {
    match address {
        Address::Text(shown) | Address::Other { octets: shown, .. } => {
            frame.has(shown);
            shown
        }
        Address::Mac(_) | Address::V4(_) | Address::V6(_) => &[],
    }
}

fn organisation(frame: &Frame<'_>, value: OrganisationValue<'_>) {
    match value {
        OrganisationValue::Alias(shown) | OrganisationValue::Octets(shown) => frame.has(shown),
        OrganisationValue::PortStatus { class_2, class_3 } => {
            lldp::class_2_name(class_2);
            lldp::class_3_name(class_3);
        }
        OrganisationValue::MacPhy { advertised, mau_type, .. } => {
            lldp::mau_type_name(mau_type);
            assert!(lldp::advertised_speeds(advertised).count() <= 16);
        }
        _ => {}
    }
}

fn mrp_frame(frame: &Frame<'_>) -> bool {
    let Some(mrp) = frame.read(Mrp::parse(frame.octets)) else { return false };
    let tlvs = frame.all(mrp.tlvs());
    for tlv in &tlvs {
        assert!(tlv.kind != 0 && !tlv.name().is_empty());
        tlv.sender_role();
        match tlv.value {
            MrpValue::Octets(shown) => frame.has(shown),
            MrpValue::Option { octets: shown, auto_manager, .. } => {
                frame.has(shown);
                assert!(auto_manager.is_none_or(|it| (1..=3).contains(&it.kind)));
                auto_manager.map(|it| it.name());
            }
            MrpValue::Test(test) => {
                mrp::priority_name(test.priority);
                mrp::port_role_name(test.port_role);
                test.state_name();
            }
            _ => {}
        }
    }
    !tlvs.is_empty()
}

/// Octet 0 chooses the frame ID, the rest comes behind it.
fn ptcp_frame(frame: &Frame<'_>) -> bool {
    const FRAME_IDS: [u16; 7] = [0x0020, 0x0080, 0xFF00, 0xFF20, 0xFF40, 0xFF41, 0xFF42];
    let mut behind = Octets::new(frame.octets);
    let Some(choice) = frame.read(behind.u8()) else { return false };
    let frame_id = FrameId(FRAME_IDS[usize::from(choice) % FRAME_IDS.len()]);
    match frame_id.kind() {
        FrameKind::Ptcp(kind) => ptcp(frame, kind, behind),
        kind => panic!("{kind:?}"),
    }
}

fn ptcp(frame: &Frame<'_>, kind: PtcpFrame, behind: Octets<'_>) -> bool {
    assert!(!kind.name().is_empty());
    let Some(Some(ptcp)) = frame.read(Ptcp::parse(kind, behind)) else { return false };
    for tlv in frame.all(ptcp.tlvs()) {
        assert!((1..=127).contains(&tlv.kind) && !tlv.name().is_empty());
        if let PtcpValue::Octets(shown) = tlv.value {
            frame.has(shown);
        }
    }
    true
}

fn rpc_datagram(frame: &Frame<'_>) -> bool {
    let Some(rpc) = frame.read(Rpc::parse(frame.octets)) else { return false };
    let (header, body) = (rpc.header(), rpc.body());
    let mut buffer = vec![0; frame.octets.len()];
    assert_eq!(rpc.emit(&mut buffer), Ok(frame.octets.len()));
    assert_eq!(buffer, frame.octets, "it is emitted as it was");
    let too_small = frame.octets.len() - 1;
    assert!(rpc.emit(&mut buffer[..too_small]).is_err());
    frame.show(header);
    frame.show(&body);
    body.status_words();
    if let Some(node) = ObjectUuid::of(header.object) {
        assert_eq!(node.to_uuid(), header.object);
    }
    let Some(interface) = Interface::of(header.interface) else { return false };
    assert_eq!(interface.uuid(), header.interface);
    rpc::operation_name(interface, header.operation);
    match body {
        Body::Stub(stub) => stub_data(frame, &rpc, stub),
        _ => true,
    }
}

fn stub_data(frame: &Frame<'_>, rpc: &Rpc<'_>, stub: Octets<'_>) -> bool {
    frame.has(stub.rest());
    read_implicit(frame, rpc);
    if let Some(message) = frame.read(Message::of(rpc)).flatten() {
        mapper_message(frame, rpc.header(), &message);
        return true;
    }
    if rpc.header().packet_type == PacketType::Request {
        ndr_request(frame, stub)
    } else {
        ndr_response(frame, stub)
    }
}

/// What is not the call's own, such as hints of the header, is not emitted. What is, is.
fn read_implicit(frame: &Frame<'_>, rpc: &Rpc<'_>) {
    let Some(Some(read)) = frame.read(ReadImplicit::parse(rpc)) else { return };
    let mut buffer = [0; ReadImplicit::LEN];
    assert_eq!(read.emit(&mut buffer), Ok(ReadImplicit::LEN));
    assert!(read.emit(&mut [0; ReadImplicit::LEN - 1]).is_err());
    let emitted = Rpc::parse(&buffer).unwrap();
    assert_eq!(ReadImplicit::parse(&emitted), Ok(Some(read)));
}

fn mapper_message(frame: &Frame<'_>, header: &Header, message: &Message<'_>) {
    frame.show(message);
    let (order, mut buffer) = (header.representation.order, [0; 200]);
    let (activity, sequence) = (header.activity, header.sequence);
    let emitted = match message {
        Message::Lookup(lookup) => lookup.emit(order, activity, sequence, &mut buffer),
        Message::HandleFree(free) => free.emit(order, activity, sequence, &mut buffer),
        Message::LookupAnswer(answer) => {
            for tower in answer.entries().filter_map(|entry| entry.tower) {
                assert!(tower.floors().count() <= frame.octets.len());
                let _ = (tower.udp_port(), tower.interface());
            }
            return;
        }
        Message::HandleFreeAnswer(..) => return,
    };
    let emitted = Rpc::parse(&buffer[..emitted.unwrap()]).unwrap();
    assert_eq!((emitted.header().activity, emitted.header().sequence), (activity, sequence));
    match (Message::of(&emitted), message) {
        (Ok(Some(Message::Lookup(is))), Message::Lookup(was)) => assert_eq!(is, *was),
        (Ok(Some(Message::HandleFree(is))), Message::HandleFree(was)) => assert_eq!(is, *was),
        other => panic!("{other:?}"),
    }
}

fn ndr_stub(frame: &Frame<'_>) -> bool {
    let mut is_read = false;
    for order in ORDERS {
        let stub = Octets::new(frame.octets).in_order(order);
        uuid(frame, stub);
        is_read |= ndr_request(frame, stub);
        is_read |= ndr_response(frame, stub);
    }
    is_read
}

fn uuid(frame: &Frame<'_>, mut octets: Octets<'_>) {
    let order = octets.order();
    if let Some(uuid) = frame.attempt(Uuid::read(&mut octets)) {
        assert_eq!(uuid.on_wire(order), frame.octets[..16]);
        assert_eq!(uuid.to_string().len(), 36);
    }
}

fn ndr_request(frame: &Frame<'_>, stub: Octets<'_>) -> bool {
    let Some(request) = frame.attempt(ndr::Request::read(stub)) else { return false };
    if let Some(header) = frame.attempt(IodReadReqHeader::parse(&mut { request.args })) {
        let (is, was) = (header.to_octets(), request.args.rest());
        // The version and the padding, before the index and at the end, are not part of it.
        for part in [0..4, 6..32, 34..56] {
            assert_eq!(is[part.clone()], was[part]);
        }
    }
    blocks(frame, Blocks::new(request.args))
}

fn ndr_response(frame: &Frame<'_>, stub: Octets<'_>) -> bool {
    let Some(response) = frame.attempt(ndr::Response::read(stub)) else { return false };
    pnio_status(frame, response.status.into());
    blocks(frame, Blocks::new(response.args))
}

fn endpoint_mapper_stub(frame: &Frame<'_>) -> bool {
    let mut is_read = false;
    for order in ORDERS {
        let stub = Octets::new(frame.octets).in_order(order);
        for operation in [LOOKUP, HANDLE_FREE] {
            for packet_type in [PacketType::Request, PacketType::Response] {
                let uuid = Interface::EndpointMapper.uuid();
                let header = Header { packet_type, ..Header::request(order, uuid, operation) };
                let message = frame.attempt(Message::read(&header, stub));
                if let Some(message) = message {
                    mapper_message(frame, &header, &message.expect("the mapper is asked"));
                    is_read = true;
                }
            }
        }
    }
    is_read
}

fn row_of_blocks(frame: &Frame<'_>) -> bool {
    blocks(frame, Blocks::new(Octets::new(frame.octets)))
}

fn blocks(frame: &Frame<'_>, blocks: Blocks<'_>) -> bool {
    assert!(blocks.len() <= frame.octets.len());
    let all = frame.all(blocks);
    all.iter().for_each(|it| block(frame, it));
    true
}

fn block(frame: &Frame<'_>, block: &Block<'_>) {
    frame.has(block.octets().rest());
    assert!(block.offset + 6 <= block.octets().offset());
    frame.read(block.contents());
    frame.show(block);
    if let Some(place) = block.record_place() {
        records::Scope::of(place.index);
        records::subslot_words(place.subslot).map(|words| words.to_string());
    }
    match block.record() {
        None => {}
        Some(Record::Octets(octets)) => frame.has(octets.rest()),
        // They are inside the one that `show` has walked through.
        Some(Record::Blocks(blocks)) => assert!(blocks.len() <= frame.octets.len()),
    }
}

/// Octets 0 and 1 say how the rest is to be read.
fn diagnosis_entries(frame: &Frame<'_>) -> bool {
    let mut octets = Octets::new(frame.octets);
    let Some(usi) = frame.read(octets.u16()) else { return false };
    let mut read = 0;
    while !octets.is_empty() {
        let before = octets.len();
        let Some(Some(entry)) = frame.read(DiagnosisEntry::read(usi, &mut octets)) else { break };
        assert!(octets.len() < before, "an entry without octets");
        let error = entry.channel_error_type;
        diagnosis::channel_error(error);
        entry
            .extended
            .map(|extended| diagnosis::extended_channel_error(error, extended.error_type));
        frame.show(&entry);
        read += 1;
    }
    read > 0
}
