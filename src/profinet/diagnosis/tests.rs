//! Diagnosis octet by octet, in every structure.

use super::super::view::tests::{hex, shown};
use super::*;

fn data(digits: &str, has_api: bool) -> String {
    let octets = hex(digits);
    shown(&DiagnosisData::read(Octets::new(&octets), has_api).unwrap())
}

const HEAD: &str = "{api: 0, slot: 1, subslot: 2, channel_number: 32768 (whole submodule), \
     channel_properties: {value: 2048, type: 0 (no size), accumulative: 0, \
     maintenance: 0 (failure), specifier: 1 (appears), direction: 0 (manufacturer's)}, ";

const CHANNEL_3: &str = "channel_number: 3 (?), channel_properties: {value: 14853, type: 5 (16 bits), \
     accumulative: 0, maintenance: 1 (maintenance required), \
     specifier: 3 (disappears, others remain), direction: 1 (input)}, ";

#[test]
fn p_10_channel_properties_bit_by_bit() {
    let properties = ChannelProperties(0b0101_0101_0000_0011);
    assert_eq!((properties.channel_type(), properties.is_accumulative()), (3, true));
    assert_eq!((properties.maintenance(), properties.specifier()), (2, 2));
    assert_eq!(properties.direction(), 2);
}

#[test]
fn p_10_every_usi_has_its_entries() {
    let head = "00000000 0001 0002 8000 0800";
    assert_eq!(
        data(&format!("{head} 8000 0003 3A05 0001 0003 3A05 0006"), true),
        format!(
            "{HEAD}user_structure_identifier: 32768 (channel diagnosis), entries: [\
             {{{CHANNEL_3}channel_error_type: 1 (short circuit)}}, \
             {{{CHANNEL_3}channel_error_type: 6 (line break)}}]}}"
        )
    );
    assert_eq!(
        data(&format!("{head} 8002 0003 3A05 8001 8005 00000007"), true),
        format!(
            "{HEAD}user_structure_identifier: 32770 (extended channel diagnosis), entries: [\
             {{{CHANNEL_3}channel_error_type: 32769 (remote mismatch), \
             ext_channel_error_type: 32773 (no neighbour), ext_channel_error_add_value: 7}}]}}"
        )
    );
    assert_eq!(
        data(&format!("{head} 8003 0003 3A05 8002 8011 00000000 08000000"), true),
        format!(
            "{HEAD}user_structure_identifier: 32771 (qualified channel diagnosis), entries: [\
             {{{CHANNEL_3}channel_error_type: 32770 (media redundancy mismatch), \
             ext_channel_error_type: 32785 (ring is open), ext_channel_error_add_value: 0, \
             qualified_channel_qualifier: 134217728, severity: fault}}]}}"
        )
    );
    assert_eq!(
        data(&format!("{head} 7FFF 010203"), true),
        format!("{HEAD}user_structure_identifier: 32767 (manufacturer's), data: [01, 02, 03]}}")
    );
    assert_eq!(
        data("0001 0002 8000 0800 0000", false),
        HEAD.replace("api: 0, ", "") + "user_structure_identifier: 0 (manufacturer's), data: []}"
    );
}

#[test]
fn p_10_an_entry_that_is_cut_is_refused() {
    let octets = hex("0001 0002 8000 0800 8002 0003 3A05 8001 8005 000000");
    let error = DiagnosisData::read(Octets::new(&octets), false).unwrap_err();
    assert_eq!(error.offset, octets.len());
}

#[test]
fn p_10_the_most_urgent_severity_counts() {
    for (qualifier, severity) in [
        (0, None),
        (1, Some("reserved")),
        (1 << 3 | 1, Some("advice")),
        (1 << 7, Some("maintenance required")),
        (1 << 16 | 1 << 7, Some("maintenance required")),
        (1 << 17, Some("maintenance demanded")),
        (1 << 31 | 1 << 17, Some("fault")),
    ] {
        assert_eq!(ChannelQualifier(qualifier).severity(), severity, "{qualifier:#x}");
    }
}
