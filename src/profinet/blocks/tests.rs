//! Blocks octet by octet, and any octets at all.

use proptest::collection::vec;
use proptest::prelude::*;

use super::super::view::tests::{hex, shown};
use super::*;

const AR: &str = "00112233445566778899AABBCCDDEEFF";

/// A block's header and contents.
fn block(block_type: u16, version: u16, contents: &[u8]) -> Vec<u8> {
    let len = contents.len() as u16 + 2;
    [&block_type.to_be_bytes()[..], &len.to_be_bytes(), &version.to_be_bytes(), contents].concat()
}

/// How a block of these contents is shown, behind type, name, version and length.
fn contents(block_type: u16, version: u16, digits: &str) -> String {
    let octets = block(block_type, version, &hex(digits));
    let block = Block::read(&mut Octets::new(&octets)).unwrap();
    shown(&block.contents().unwrap())
}

fn only(octets: &[u8]) -> Block<'_> {
    let mut blocks = Blocks::new(Octets::new(octets));
    let block = blocks.next().unwrap().unwrap();
    assert!(blocks.next().is_none());
    block
}

#[test]
fn p_6_blocks_follow_each_other_with_their_places() {
    let octets = [block(0x7777, 0x0203, &[1, 2, 3]), block(0x001A, 0x0100, &[0, 0])].concat();
    let blocks: Vec<_> = Blocks::new(Octets::new(&octets)).map(Result::unwrap).collect();
    let heads: Vec<_> =
        blocks.iter().map(|block| (block.offset, block.block_type, block.name())).collect();
    assert_eq!(heads, [(0, 0x7777, None), (9, 0x001A, Some("APIData"))]);
    let unknown = "{type: 30583, version: 2.3, length: 5, octets: [01, 02, 03]}";
    assert_eq!(shown(&blocks[0]), unknown);
    assert_eq!(shown(&blocks[1]), "{type: 26, name: APIData, version: 1.0, length: 4, apis: []}");
}

#[test]
fn p_6_a_block_that_is_cut_ends_the_blocks_with_its_place() {
    let good = block(0x001A, 0x0100, &[0, 0]);
    for (bad, offset, what) in [
        (&[0x01][..], 9, "the octets end too early"),
        (&[0x01, 0x01, 0x00, 0x01, 0x01, 0x00], 10, "a block is shorter than its version"),
        (&[0x01, 0x01, 0xFF, 0xFF, 0x01, 0x00], 14, "the octets end too early"),
    ] {
        let octets = [&good, bad].concat();
        let mut blocks = Blocks::new(Octets::new(&octets));
        assert!(blocks.next().unwrap().is_ok());
        assert_eq!(blocks.next().unwrap().unwrap_err(), Malformed { offset, what });
        assert!(blocks.next().is_none());
    }
    // Contents that end too early are told beside the octets.
    let octets = block(0x001A, 0x0100, &[0, 2, 0, 0, 0, 7]);
    assert_eq!(
        shown(&only(&octets)),
        "{type: 26, name: APIData, version: 1.0, length: 8, octets: [00, 02, 00, 00, 00, 07], \
         error: the octets end too early at octet 12}"
    );
    let fault = super::super::view::first_fault(&only(&octets)).unwrap();
    assert_eq!(fault.offset, 12);
}

#[test]
fn p_6_connect_asks_for_an_ar() {
    let initiator = "DEA000006C9711D1827100010203002A";
    assert_eq!(
        contents(
            0x0101,
            0x0100,
            &format!("0001 {AR} 0002 020000000001 {initiator} 40000011 0258 8892 0003 706C63")
        ),
        "{ar_type: 1 (IO controller AR), ar_uuid: 00112233-4455-6677-8899-aabbccddeeff, \
         session_key: 2, cm_initiator_mac_add: 02:00:00:00:00:01, \
         cm_initiator_object_uuid: dea00000-6c97-11d1-8271-00010203002a, \
         ar_properties: 0x40000011 state=1 parameterization_server=1 startup_mode=1, \
         cm_initiator_activity_timeout_factor: 600, cm_initiator_udp_rt_port: 34962, \
         cm_initiator_station_name: \"plc\"}"
    );
    assert_eq!(
        contents(0x8101, 0x0100, &format!("0006 {AR} 0002 020000000002 8892")),
        "{ar_type: 6 (IO supervisor AR), ar_uuid: 00112233-4455-6677-8899-aabbccddeeff, \
         session_key: 2, cm_responder_mac_add: 02:00:00:00:00:02, cm_responder_udp_rt_port: 34962}"
    );
    assert_eq!(
        contents(0x8106, 0x0100, "0003 616263 0000"),
        "{cm_responder_station_name: \"abc\", padding: [00, 00]}"
    );
}

#[test]
fn p_6_connect_asks_for_cyclic_data_and_alarms() {
    assert_eq!(
        contents(
            0x0102,
            0x0100,
            "0001 0001 8892 00000001 0028 8001 0020 0010 0001 0000 FFFFFFFF 0003 0003 C000 \
             000000000000 0001 00000000 0001 0001 0001 0004 0001 0002 8000 0009"
        ),
        "{iocr_type: 1 (input), iocr_reference: 1, lt: 34962, \
         iocr_properties: 0x1 rt_class=1, data_length: 40, frame_id: 32769, \
         send_clock_factor: 32, reduction_ratio: 16, phase: 1, sequence: 0, \
         frame_send_offset: 4294967295, watchdog_factor: 3, data_hold_factor: 3, \
         iocr_tag_header: 0xc000 priority=6, iocr_multicast_mac_add: 00:00:00:00:00:00, \
         apis: [{api: 0, io_data_objects: [{slot: 1, subslot: 1, frame_offset: 4}], \
         iocs: [{slot: 2, subslot: 32768, frame_offset: 9}]}]}"
    );
    assert_eq!(
        contents(0x8102, 0x0100, "0002 0002 8000"),
        "{iocr_type: 2 (output), iocr_reference: 2, frame_id: 32768}"
    );
    assert_eq!(
        contents(0x0103, 0x0100, "0001 8892 00000002 0001 0003 0001 00C8 C000 A000"),
        "{alarmcr_type: 1, lt: 34962, alarmcr_properties: 0x2 transport=1, \
         rta_timeout_factor: 1, rta_retries: 3, local_alarm_reference: 1, \
         max_alarm_data_length: 200, alarmcr_tag_header_high: 0xc000 priority=6, \
         alarmcr_tag_header_low: 0xa000 priority=5}"
    );
    assert_eq!(
        contents(0x8103, 0x0100, "0001 0005 00C8"),
        "{alarmcr_type: 1, local_alarm_reference: 5, max_alarm_data_length: 200}"
    );
}

#[test]
fn p_6_connect_says_what_modules_are_expected_and_hears_what_differs() {
    assert_eq!(
        contents(
            0x0104,
            0x0100,
            "0001 00000000 0001 00000030 0000 0002 \
             0001 00000130 0003 0001 0001 01 01 0002 0002 01 01 \
             0002 00000131 0000 0001 0000 01 01"
        ),
        "{apis: [{api: 0, slot: 1, module_ident_number: 48, module_properties: 0, \
         submodules: [{subslot: 1, submodule_ident_number: 304, \
         submodule_properties: 0x3 type=3, data_descriptions: [\
         {data_description: 1 (input), submodule_data_length: 1, length_iocs: 1, length_iops: 1}, \
         {data_description: 2 (output), submodule_data_length: 2, length_iocs: 1, length_iops: 1}]}, \
         {subslot: 2, submodule_ident_number: 305, submodule_properties: 0x0, \
         data_descriptions: [{data_description: 1 (input), submodule_data_length: 0, \
         length_iocs: 1, length_iops: 1}]}]}]}"
    );
    assert_eq!(
        contents(
            0x8104,
            0x0100,
            "0001 00000000 0001 0001 00000031 0001 0002 0001 00000131 0002 0002 00000132 9005"
        ),
        "{apis: [{api: 0, modules: [{slot: 1, module_ident_number: 49, \
         module_state: 1 (wrong module), submodules: [\
         {subslot: 1, submodule_ident_number: 305, submodule_state: 0x2 detail=2}, \
         {subslot: 2, submodule_ident_number: 306, \
         submodule_state: 0x9005 add_info=5 ident_info=2 format_indicator=1}]}]}]}"
    );
}

#[test]
fn p_6_connect_may_name_others() {
    let server = "DEA000006C9711D1827100010203002A";
    assert_eq!(
        contents(0x0105, 0x0100, &format!("{server} 00000000 0258 0002 7071")),
        "{parameter_server_object_uuid: dea00000-6c97-11d1-8271-00010203002a, \
         parameter_server_properties: 0, cm_initiator_activity_timeout_factor: 600, \
         parameter_server_station_name: \"pq\"}"
    );
    assert_eq!(
        contents(0x0106, 0x0100, "0003 00000001 0003 0001 78"),
        "{iocr_reference: 3, address_resolution_properties: 1, mci_timeout_factor: 3, \
         provider_station_name: \"x\"}"
    );
    assert_eq!(contents(0x8107, 0x0100, "C001"), "{rpc_server_port: 49153}");
    assert_eq!(
        contents(0x0108, 0x0100, "0007 00000001 AABB"),
        "{ap_structure_identifier: 7, api: 1, data: [aa, bb]}"
    );
}

#[test]
fn p_6_control_has_one_layout_for_all_steps() {
    for block_type in (0x0110..=0x0118).filter(|block_type| *block_type != 0x0115) {
        for block_type in [block_type, block_type | 0x8000] {
            assert_eq!(
                contents(block_type, 0x0100, &format!("0000 {AR} 0002 0003 0009 0001")),
                "{ar_uuid: 00112233-4455-6677-8899-aabbccddeeff, session_key: 2, \
                 alarm_sequence_number: 3, \
                 control_command: 0x9 prm_end=1 done=1, control_block_properties: 1}"
            );
        }
    }
    assert_eq!(
        contents(0x0119, 0x0100, "0001 00000000 0001 0002"),
        "{entries: [{api: 0, slot: 1, subslot: 2}]}"
    );
}

#[test]
fn p_12_rings_have_a_name_and_parameters() {
    let ring = "mrp_domain_uuid: 00112233-4455-6677-8899-aabbccddeeff";
    assert_eq!(
        contents(
            0x0211,
            0x0100,
            &format!("0000 {AR} 0001 0000 03 6D7270 0217 0008 0100 0014 0015 0004")
        ),
        format!(
            "{{{ring}, mrp_role: 1 (client), mrp_domain_name: \"mrp\", blocks: [{{type: 535, \
             name: MrpClientParams, version: 1.0, length: 8, mrp_lnkdownt: 20, mrp_lnkupt: 21, \
             mrp_lnknrmax: 4}}]}}"
        )
    );
    let instance = format!(
        "0231 0030 0100 00 01 {AR} 0002 0000 03 6D7270 \
         0216 0010 0100 8000 0001 0003 0014 0032 0005 0000"
    );
    assert_eq!(
        contents(0x0211, 0x0101, &format!("00 01 {instance}")),
        format!(
            "{{number_of_mrp_instances: 1, blocks: [{{type: 561, name: MrpInstanceDataAdjust, \
             version: 1.0, length: 48, mrp_instance: 1, {ring}, mrp_role: 2 (manager), \
             mrp_domain_name: \"mrp\", blocks: [{{type: 534, name: MrpManagerParams, version: 1.0, \
             length: 16, mrp_prio: 32768, mrp_topchgt: 1, mrp_topnrmax: 3, mrp_tstshortt: 20, \
             mrp_tstdefaultt: 50, mrp_tstnrmax: 5}}]}}]}}"
        )
    );
    for (block_type, version, digits, text) in [
        (0x0213, 0x0100, "0000 AR 00000003", "{RING, mrp_check: 0x3 mrm=1 domain_uuid=1}"),
        (0x0233, 0x0100, "00 02 AR 00000001", "{mrp_instance: 2, RING, mrp_check: 0x1 mrm=1}"),
        (0x0214, 0x0100, "0000 AR", "{RING}"),
        (0x0215, 0x0101, "00 03 AR", "{mrp_instance: 3, RING}"),
        (0x0219, 0x0100, "0001", "{mrp_ring_state: 1 (closed)}"),
    ] {
        let shown = contents(block_type, version, &digits.replace("AR", AR));
        assert_eq!(shown, text.replace("RING", ring));
    }
}

#[test]
fn p_6_connect_may_ask_for_more_than_rt() {
    assert_eq!(
        contents(0x0109, 0x0100, &format!("0000 {AR} 0000 0001 0001 000D 00000102")),
        "{ir_data_uuid: 00112233-4455-6677-8899-aabbccddeeff, iocrs: [{iocr_reference: 1, \
         subframe_offset: 13, subframe_data: 0x102 position=2 length=1}]}"
    );
    assert_eq!(
        contents(0x010A, 0x0100, "0096 00000005"),
        "{redundancy_data_hold_factor: 150, \
         sr_properties: 0x5 input_valid_on_backup_ar=1 mode=1}"
    );
    assert_eq!(contents(0x010C, 0x0100, "0000 00000001"), "{rs_properties: 1}");
    let hello = "0600 0014 0100 0000 00000002 00000064 00000003 00000032";
    let parameter = format!("0601 0018 0100 0000 00000001 {AR}");
    for block_type in [0x010B, 0x0608, 0x0609] {
        assert_eq!(
            contents(block_type, 0x0100, &format!("0000 {hello} {parameter}")),
            "{blocks: [{type: 1536, name: FSHelloBlock, version: 1.0, length: 20, \
             fs_hello_mode: 2 (when a link comes up, after a delay), fs_hello_interval: 100, \
             fs_hello_retry: 3, fs_hello_delay: 50}, {type: 1537, name: FSParameterBlock, \
             version: 1.0, length: 24, fs_parameter_mode: 1 (on), \
             fs_parameter_uuid: 00112233-4455-6677-8899-aabbccddeeff}]}"
        );
    }
}

/// The contents of a header up to the length of its record.
fn record_header(index: &str, len: u32) -> String {
    format!("0007 {AR} 00000000 0001 8001 0000 {index} {len:08X}")
}

#[test]
fn p_9_a_record_follows_its_header() {
    let im1 = [&b"pump"[..], &[b' '; 28], b"hall 3", &[b' '; 16]].concat();
    let im1 = block(0x0021, 0x0100, &im1);
    let header = hex(&format!("{} 0001 0002 {}", record_header("AFF1", 60), "00".repeat(20)));
    let octets = [block(0x8009, 0x0100, &header), im1].concat();
    let read = only(&octets);
    assert_eq!(octets.len(), 64 + 60);
    assert_eq!(
        shown(&read.contents().unwrap()),
        "{sequence: 7, ar_uuid: 00112233-4455-6677-8899-aabbccddeeff, api: 0, slot: 1, \
         subslot: 32769, index: 45041 (I&M1), record_data_length: 60, \
         additional_value1: 1, additional_value2: 2}"
    );
    let Some(Record::Blocks(mut blocks)) = read.record() else { panic!("{read:?}") };
    let im1 = blocks.next().unwrap().unwrap();
    assert_eq!((im1.offset, blocks.next().is_none()), (64, true));
    let Contents::Im1(im1) = im1.contents().unwrap() else { panic!("{im1:?}") };
    assert_eq!(im1.im_tag_location.0, b"hall 3                ");

    // A record of the device's own is octets, and one that is cut ends the blocks.
    let header = hex(&format!("{} {}", record_header("1234", 3), "00".repeat(24)));
    let octets = [&block(0x0008, 0x0100, &header), &[1, 2, 3][..]].concat();
    let Some(Record::Octets(record)) = only(&octets).record() else { panic!() };
    assert_eq!((record.rest(), record.offset()), (&[1, 2, 3][..], 64));
    let cut = Blocks::new(Octets::new(&octets[..66])).next().unwrap().unwrap_err();
    assert_eq!(cut.offset, 66);
}

#[test]
fn p_9_a_header_says_which_record_of_what_it_is_for() {
    let place = |slot, subslot, index| RecordPlace { slot, subslot, index }.to_string();
    assert_eq!(place(0, 1, 0xAFF0), "I&M0 of slot 0 subslot 1");
    assert_eq!(place(0, 0x8002, 0x802A), "PDPortDataReal of slot 0 port 2 of interface 1");
    assert_eq!(place(3, 1, 0x0064), "0x0064 of slot 3 subslot 1");
    assert_eq!(place(3, 1, 0xC001), "RealIdentificationData of slot 3");
    assert_eq!(place(0, 1, 0xF841), "PDRealData");
    let header = hex(&record_header("AFF1", 0));
    for block_type in [0x0008, 0x0009, 0x8008, 0x8009] {
        let octets = block(block_type, 0x0100, &header);
        let place = Some(RecordPlace { slot: 1, subslot: 0x8001, index: 0xAFF1 });
        assert_eq!(only(&octets).record_place(), place);
    }
    assert_eq!(only(&block(0x0101, 0x0100, &header)).record_place(), None);
}

#[test]
fn p_9_several_records_are_written_at_once_each_padded() {
    let write = |len: usize| {
        let header = hex(&format!("{} {}", record_header("0001", len as u32), "00".repeat(24)));
        [block(0x0008, 0x0100, &header), vec![0xAA; len]].concat()
    };
    let writes = [&write(3), &[0][..], &write(4), &write(1)].concat();
    let header = record_header("E040", writes.len() as u32);
    let header = hex(&format!("{header} {}", "00".repeat(24)));
    let octets = [block(0x0008, 0x0100, &header), writes].concat();
    let Some(Record::Blocks(blocks)) = only(&octets).record() else { panic!() };
    let places: Vec<_> = blocks
        .map(|block| block.unwrap())
        .map(|block| match block.record() {
            Some(Record::Octets(record)) => (block.offset, record.len()),
            record => panic!("{record:?}"),
        })
        .collect();
    assert_eq!(places, [(64, 3), (132, 4), (200, 1)]);
}

#[test]
fn p_9_what_was_written_has_a_status() {
    let header = format!("{} 0000 0000 DF80B500 {}", record_header("0001", 4), "00".repeat(16));
    let text = contents(0x8008, 0x0100, &header);
    assert!(text.ends_with(
        "additional_value1: 0, additional_value2: 0, status: {code: 223, decode: 128, \
         code1: 181, code2: 0, words: Write failed: state conflict}}"
    ));
    let header = format!("{} {}", record_header("F821", 4), AR);
    assert!(contents(0x0009, 0x0100, &header).ends_with(
        "index: 63521 (APIData), record_data_length: 4, \
         target_ar_uuid: 00112233-4455-6677-8899-aabbccddeeff}"
    ));
}

#[test]
fn p_6_identification_says_what_is_plugged() {
    let order = "41".repeat(20);
    assert_eq!(
        contents(
            0x0020,
            0x0100,
            &format!("002A {order} {} 0003 56 010203 0004 F600 0005 0101 001E", "31".repeat(16))
        ),
        format!(
            "{{vendor_id: 42, order_id: \"{}\", im_serial_number: \"{}\", \
             im_hardware_revision: 3, im_revision_prefix: \"V\", \
             im_sw_revision_functional_enhancement: 1, im_revision_bugfix: 2, \
             im_sw_revision_internal_change: 3, im_revision_counter: 4, im_profile_id: 62976, \
             im_profile_specific_type: 5, im_version_major: 1, im_version_minor: 1, \
             im_supported: 0x1e im1=1 im2=1 im3=1 im4=1}}",
            "A".repeat(20),
            "1".repeat(16)
        )
    );
    let slots = "0001 0001 00000030 0001 0001 00000130";
    let shown_slots = "slots: [{slot: 1, module_ident_number: 48, \
         subslots: [{subslot: 1, submodule_ident_number: 304}]}]";
    for block_type in [0x0012, 0x0013] {
        assert_eq!(contents(block_type, 0x0100, slots), format!("{{{shown_slots}}}"));
        assert_eq!(
            contents(block_type, 0x0101, &format!("0001 00000007 {slots}")),
            format!("{{apis: [{{api: 7, {shown_slots}}}]}}")
        );
    }
    for block_type in [0x0030, 0x0031, 0x0032] {
        assert_eq!(
            contents(block_type, 0x0100, &format!("0001 00000000 {slots}")),
            "{apis: [{api: 0, modules: [{slot: 1, module_ident_number: 48, \
             submodules: [{subslot: 1, submodule_ident_number: 304}]}]}]}"
        );
    }
    assert_eq!(contents(0x001A, 0x0100, "0002 00000000 00003A00"), "{apis: [0, 14848]}");
    assert_eq!(
        contents(0x0022, 0x0100, "323032362D31312D32372030373A3030"),
        "{im_date: \"2026-11-27 07:00\"}"
    );
    assert_eq!(
        contents(0x0023, 0x0100, &"78".repeat(54)),
        format!("{{im_descriptor: \"{}\"}}", "x".repeat(54))
    );
    assert_eq!(contents(0x0024, 0x0100, "0102"), "{im_signature: [01, 02]}");
}

#[test]
fn p_6_im5_lists_parts_of_others() {
    let part = format!(
        "0034 009A 0100 {} {} 002A {} 0001 56 000102",
        "61".repeat(64),
        "62".repeat(64),
        "63".repeat(16)
    );
    let text = contents(0x0025, 0x0100, &format!("0001 {part}"));
    assert!(text.starts_with("{entries: [{type: 52, name: I&M5Data, version: 1.0, length: 154"));
    assert!(text.contains("vendor_id: 42") && text.ends_with("internal_change: 2}]}"), "{text}");
}

#[test]
fn p_6_ports_are_padded_from_the_beginning_of_the_block() {
    let real = "0000 0000 8001 03 706F72 01 000000 \
         04 706F7274 01 78 00 00000005 020000000003 0000 \
         0010 0000 00000000 00000000 05 01 0000 00000001";
    let expected = "slot: 0, subslot: 32769, own_port_id: \"por\", \
         peers: [{peer_port_id: \"port\", peer_chassis_id: \"x\", line_delay: 5, \
         peer_mac_address: 02:00:00:00:00:03}], mau_type: 16 (100BASE-TX full duplex), \
         domain_boundary: 0, multicast_boundary: 0, link_state_port: 5 (forwarding), \
         link_state_link: 1 (up), media_type: 1 (copper)}";
    assert_eq!(contents(0x020F, 0x0100, real), format!("{{{expected}"));

    // The same behind one octet that moves it, and inside the block of many submodules.
    let port = block(0x020F, 0x0100, &hex(real));
    let octets = [&[0], &port[..]].concat();
    let mut moved = Octets::new(&octets);
    moved.take(1).unwrap();
    let moved = Block::read(&mut moved).unwrap();
    assert_eq!((moved.offset, shown(&moved.contents().unwrap())), (1, format!("{{{expected}")));
    let many = [&hex("0000 00000000 0000 8001")[..], &port].concat();
    let many = block(0x0400, 0x0100, &many);
    assert_eq!(
        shown(&only(&many).contents().unwrap()),
        format!(
            "{{api: 0, slot: 0, subslot: 32769, blocks: [{{type: 527, name: PDPortDataReal, \
             version: 1.0, length: {}, {expected}]}}",
            port.len() - 4
        )
    );
}

#[test]
fn p_6_interfaces_have_a_name_and_addresses() {
    assert_eq!(
        contents(0x0240, 0x0100, "03 616263 0000 020000000004 0000 C0000207 FFFFFF00 C0000201"),
        "{own_chassis_id: \"abc\", mac_address: 02:00:00:00:00:04, ip_address: 192.0.2.7, \
         subnetmask: 255.255.255.0, standard_gateway: 192.0.2.1}"
    );
    assert_eq!(
        contents(0x0251, 0x0101, "0001 00000001 00000002 00000003 00000004 00000005 00000006"),
        "{counter_status: 1, if_in_octets: 1, if_out_octets: 2, if_in_discards: 3, \
         if_out_discards: 4, if_in_errors: 5, if_out_errors: 6}"
    );
    assert_eq!(
        contents(0x0250, 0x0100, "0000 00000001"),
        "{multiple_interface_mode: 0x1 name_of_device=1}"
    );
    assert_eq!(
        contents(0x0200, 0x0100, "0000 0000 8001 020A 0008 0100 01 01 70 02 7171"),
        "{slot: 0, subslot: 32769, blocks: [{type: 522, name: CheckPeers, version: 1.0, \
         length: 8, peers: [{peer_port_id: \"p\", peer_chassis_id: \"qq\"}]}]}"
    );
    assert_eq!(contents(0x020C, 0x0100, "001E"), "{mau_type: 30 (1000BASE-T full duplex)}");
    assert_eq!(
        contents(0x020E, 0x0100, "0000 0010 0000"),
        "{mau_type: 16 (100BASE-TX full duplex), adjust_properties: 0}"
    );
}

#[test]
fn p_6_a_device_in_service_has_a_log_and_substitute_values() {
    assert_eq!(
        contents(
            0x0019,
            0x0100,
            &format!("0000000000000009 0001 0000000000000008 {AR} CF81FD05 00000007")
        ),
        "{actual_local_time_stamp: 9, entries: [{local_time_stamp: 8, \
         ar_uuid: 00112233-4455-6677-8899-aabbccddeeff, status: {code: 207, decode: 129, \
         code1: 253, code2: 5, words: alarm connection ended: RTA protocol, consumer of cyclic \
         data timed out}, entry_detail: 7}]}"
    );
    assert_eq!(
        contents(0x0014, 0x0100, "0002 80 AABB80"),
        "{substitution_mode: 2 (replacement value), iocs: 0x80 data_state=1, data: [aa, bb, 80]}"
    );
}

#[test]
fn p_10_an_alarm_says_what_happened_in_every_structure() {
    let head = "0001 00000000 0001 0002 00000030 00000130 A807";
    let shown_head = "{alarm_type: 1 (diagnosis), api: 0, slot: 1, subslot: 2, \
         module_ident_number: 48, submodule_ident_number: 304, alarm_specifier: 0xa807 \
         sequence_number=7 channel_diagnosis=1 submodule_diagnosis_state=1 ar_diagnosis_state=1, \
         items: [";
    let channel = "channel_number: 32768 (whole submodule), channel_properties: {value: 2048, \
         type: 0 (no size), accumulative: 0, maintenance: 0 (failure), specifier: 1 (appears), \
         direction: 0 (manufacturer's)}, channel_error_type: 6 (line break)";
    let items = "8100 0F00 0008 0100 0000 00000001 8000 8000 0800 0006 1234 AABB";
    for block_type in [0x0001, 0x0002] {
        assert_eq!(
            contents(block_type, 0x0100, &format!("{head} {items}")),
            format!(
                "{shown_head}{{user_structure_identifier: 33024 (maintenance), block: {{type: 3840, \
                 name: MaintenanceItem, version: 1.0, length: 8, \
                 maintenance_status: 0x1 required=1}}}}, \
                 {{user_structure_identifier: 32768 (channel diagnosis), {channel}}}, \
                 {{user_structure_identifier: 4660 (manufacturer's), data: [aa, bb]}}]}}"
            )
        );
    }
    for block_type in [0x8001, 0x8002] {
        assert_eq!(
            contents(block_type, 0x0100, "000C 00000000 0001 0002 0007 00000000"),
            "{alarm_type: 12 (diagnosis disappears), api: 0, slot: 1, subslot: 2, \
             alarm_specifier: 0x7 sequence_number=7, \
             status: {code: 0, decode: 0, code1: 0, code2: 0, words: OK}}"
        );
    }
}

#[test]
fn blocks_inside_blocks_have_a_limit() {
    let mut octets = block(0x001A, 0x0100, &[0, 0]);
    for _ in 0..1000 {
        octets = block(0x0400, 0x0100, &[&[0; 10], &octets[..]].concat());
    }
    let text = shown(&only(&octets));
    assert_eq!(text.matches("MultipleBlockHeader").count(), usize::from(MAX_DEPTH) + 1);
}

/// Blocks of any contents, one inside a record sometimes, with octets changed.
fn hostile_blocks() -> impl Strategy<Value = Vec<u8>> {
    let known = prop_oneof![
        0x0000u16..0x0120,
        0x8000u16..0x8120,
        0x0200u16..0x0260,
        Just(0x0400),
        Just(0x0F00),
        any::<u16>()
    ];
    // Small octets are counts and lengths that fit more often than any octets.
    let octet = prop_oneof![3 => 0u8..4, 1 => any::<u8>()];
    let any_block = (known, 0u16..2, vec(octet, 0..120))
        .prop_map(|(block_type, version, contents)| block(block_type, 0x0100 | version, &contents));
    let changes = vec((any::<prop::sample::Index>(), any::<u8>()), 0..3);
    (vec(any_block, 1..4), changes).prop_map(|(blocks, changes)| {
        let mut octets = blocks.concat();
        for (index, value) in changes {
            *index.get_mut(&mut octets) = value;
        }
        octets
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_octets_panic(octets in prop_oneof![hostile_blocks(), vec(any::<u8>(), 0..200)]) {
        for block in Blocks::new(Octets::new(&octets)).flatten() {
            prop_assert!(block.offset + block.length() + 4 <= octets.len());
            shown(&block);
        }
    }

    #[test]
    fn every_block_of_any_contents_is_shown_or_refused(
        block_type in prop_oneof![0u16..0x0500, 0x8000u16..0x8200, Just(0x0F00)],
        version in 0u16..2,
        octets in vec(0u8..3, 0..200),
    ) {
        let octets = block(block_type, 0x0100 | version, &octets);
        let mut blocks = Blocks::new(Octets::new(&octets));
        if let Some(Ok(block)) = blocks.next() {
            if let Err(fault) = block.contents() {
                prop_assert!(fault.offset <= octets.len());
            }
            shown(&block);
        }
    }
}
