use std::net::Ipv4Addr;

use super::*;
use crate::profinet::MacAddress;

/// A frame with these blocks, and padding behind it.
fn frame(service_id: u8, service_type: u8, blocks: &[u8]) -> Vec<u8> {
    let length = [0, blocks.len() as u8];
    let head = [service_id, service_type, 1, 0, 0, 2, 0, 128];
    [&head[..], &length, blocks, &[0; 8]].concat()
}

#[track_caller]
fn blocks(octets: &[u8]) -> Vec<DcpBlock<'_>> {
    let dcp = Dcp::parse(Octets::new(octets)).unwrap();
    assert_eq!((dcp.xid, dcp.response_delay), (0x0100_0002, 128));
    dcp.blocks().map(Result::unwrap).collect()
}

/// The only block of an answer to get, behind its block info 0.
#[track_caller]
fn answer(option: u8, suboption: u8, contents: &[u8], right: DcpValue<'_>) {
    let length = contents.len() as u8 + 2;
    let octets = frame(3, 1, &[&[option, suboption, 0, length, 0, 0][..], contents].concat());
    let all = blocks(&octets);
    assert_eq!((all.len(), all[0].value), (1, right));
    assert_eq!(
        (all[0].info, all[0].qualifier, all[0].length),
        (Some(0), None, Some(length.into()))
    );
}

#[test]
fn p_1_the_header_has_ten_octets() {
    let octets = frame(5, 0, &[255, 255, 0, 0]);
    let dcp = Dcp::parse(Octets::new(&octets)).unwrap();
    assert_eq!((dcp.service_id, dcp.service_type), (ServiceId::Identify, ServiceType::Request));
    assert_eq!((dcp.data_length, Dcp::HEADER_LEN), (4, octets.len() - 4 - 8));
    let all = blocks(&octets);
    assert_eq!((all[0].option, all[0].suboption, all[0].value), (255, 255, DcpValue::None));
    assert_eq!(suboption_name(255, 255), "all");
}

#[test]
fn p_3_identify_has_names_without_qualifier_or_info() {
    // An odd length, one octet of padding, and the next block.
    let octets =
        frame(5, 0, &[&[2, 2, 0, 3][..], b"plc\0", &[2, 6, 0, 10], b"port-001.a"].concat());
    let all = blocks(&octets);
    assert_eq!(all[0].value, DcpValue::Text(b"plc"));
    assert_eq!((all[1].value, all[1].info), (DcpValue::Text(b"port-001.a"), None));
    assert_eq!(suboption_name(2, 6), "alias name");
}

#[test]
fn p_3_answers_say_what_a_device_is() {
    let ip = IpParameter {
        address: Ipv4Addr::new(192, 168, 0, 5),
        netmask: Ipv4Addr::new(255, 255, 255, 0),
        gateway: Ipv4Addr::new(192, 168, 0, 1),
    };
    let octets = [192, 168, 0, 5, 255, 255, 255, 0, 192, 168, 0, 1];
    answer(1, 1, &[2, 0, 0, 0, 0, 9], DcpValue::MacAddress(MacAddress([2, 0, 0, 0, 0, 9])));
    answer(1, 2, &octets, DcpValue::Ip(ip));
    let servers = [1, 2, 3, 4].map(|last| Ipv4Addr::new(10, 0, 0, last));
    let suite = [&octets[..], &servers.map(|it| it.octets()).concat()].concat();
    answer(1, 3, &suite, DcpValue::IpSuite(ip, servers));
    answer(2, 1, b"ET200SP", DcpValue::Text(b"ET200SP"));
    answer(2, 2, b"", DcpValue::Text(b""));
    let device = DcpValue::DeviceId { vendor_id: 0x2A, device_id: 0x0313 };
    answer(2, 3, &[0, 0x2A, 3, 0x13], device);
    answer(2, 4, &[3, 0], DcpValue::DeviceRole(3));
    answer(2, 5, &[1, 2, 5, 3], DcpValue::DeviceOptions(&[1, 2, 5, 3]));
    answer(2, 7, &[1, 2], DcpValue::DeviceInstance { high: 1, low: 2 });
    answer(2, 8, &[0, 0x2A, 3, 0x13], device);
    answer(3, 61, &[61, 3, 1, 2, 3], DcpValue::Dhcp { code: 61, value: &[1, 2, 3] });
    answer(6, 1, &[0, 1], DcpValue::DeviceInitiative(1));
    answer(7, 1, b"tsn", DcpValue::Text(b"tsn"));
    answer(200, 9, &[1, 2, 3], DcpValue::Octets(&[1, 2, 3]));
    assert_eq!(
        role_names(0x0B).collect::<Vec<_>>(),
        ["IO device", "IO controller", "IO supervisor"]
    );
}

#[test]
fn p_3_a_hello_has_the_info_of_its_address() {
    let octets = frame(6, 0, &[1, 2, 0, 14, 0, 0x81, 10, 0, 0, 1, 255, 0, 0, 0, 10, 0, 0, 1]);
    let info = blocks(&octets)[0].info;
    assert_eq!(info.map(ip_block_info_name), Some("set, address conflict"));
}

#[test]
fn p_3_a_get_names_what_it_wants() {
    let octets = frame(3, 0, &[2, 2, 1, 2]);
    let names: Vec<_> = blocks(&octets).iter().map(|it| (it.option, it.suboption)).collect();
    assert_eq!(names, [(2, 2), (1, 2)]);
}

#[test]
fn p_3_a_set_is_permanent_or_temporary_and_its_answer_says_what_became_of_it() {
    let control = [5, 1, 0, 2, 0, 0];
    let name = [&[2, 2, 0, 5, 0, 1][..], b"plc\0"].concat();
    let signal = [5, 3, 0, 4, 0, 0, 1, 0];
    let reset = [5, 6, 0, 2, 0, 4];
    let octets = frame(4, 0, &[&control[..], &name, &signal, &reset].concat());
    let all = blocks(&octets);
    let found: Vec<_> = all.iter().map(|it| (it.qualifier, it.value)).collect();
    assert_eq!(
        found,
        [
            (Some(0), DcpValue::None),
            (Some(1), DcpValue::Text(b"plc")),
            (Some(0), DcpValue::Signal(0x0100)),
            (Some(4), DcpValue::None),
        ]
    );
    assert_eq!(reset_name(4), "communication parameters");

    let octets = frame(4, 1, &[5, 4, 0, 3, 2, 2, 6, 0]);
    let all = blocks(&octets);
    assert_eq!(all[0].value, DcpValue::Response { option: 2, suboption: 2, error: 6 });
    assert_eq!(block_error_name(6), "cannot be set during operation");
}

#[test]
fn a_last_block_without_padding_is_whole() {
    let octets = frame(4, 1, &[5, 4, 0, 3, 2, 2, 0]);
    assert_eq!(blocks(&octets).len(), 1);
}

#[test]
fn what_is_wrong_is_told_with_its_place() {
    let errors = |octets: &[u8]| {
        let dcp = Dcp::parse(Octets::new(octets)).unwrap();
        let errors = dcp.blocks().filter_map(Result::err);
        errors.map(|error| error.offset).collect::<Vec<_>>()
    };
    // A block that is longer than the data, contents that are too short, half a head.
    assert_eq!(errors(&frame(5, 0, &[2, 2, 0, 9, b'a'])), [15]);
    assert_eq!(errors(&frame(3, 1, &[1, 2, 0, 5, 0, 0, 10, 0, 0, 0])), [19]);
    assert_eq!(errors(&frame(5, 0, &[2])), [11]);
    // A header that promises more than the frame has.
    let mut octets = frame(5, 0, &[]);
    octets[9] = 200;
    assert_eq!(Dcp::parse(Octets::new(&octets)).unwrap_err().offset, octets.len());
}

#[test]
fn numbers_and_names_belong_together() {
    for (number, name) in [(3, "get"), (4, "set"), (5, "identify"), (6, "hello")] {
        let service = ServiceId::from(number);
        assert_eq!((service.number(), service.name()), (number, name));
    }
    for (number, name) in [(0, "request"), (1, "response"), (5, "response, not supported")] {
        let service = ServiceType::from(number);
        assert_eq!((service.number(), service.name()), (number, name));
    }
    let options = [1, 2, 3, 5, 6, 200, 255].map(option_name);
    let right =
        ["IP", "device properties", "DHCP", "control", "device initiative", "manufacturer", "all"];
    assert_eq!(options, right);
}
