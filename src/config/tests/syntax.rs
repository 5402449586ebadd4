//! What is told of a text that is no TOML: one line with file, line, key and remedy, and below it the
//! place.

use super::*;

/// The faults of [`SOUND`] with one thing changed, without the excerpts.
fn told(text: &str) -> Vec<String> {
    let Err(Faults(faults)) = parse(text, Path::new("c.toml")) else { panic!("{text} is taken") };
    faults.iter().map(Fault::to_string).collect()
}

fn told_of(from: &str, to: &str) -> Vec<String> {
    told(&changed(from, to))
}

#[test]
fn values_without_quotes_are_shown_with_them() {
    for (from, to, expected) in [
        (
            "\"172.17.17.0\"",
            "172.17.17.0",
            "c.toml:7: udp_range_net[0].subnet: the value cannot be read; write it in quotes: \
             subnet = \"172.17.17.0\"",
        ),
        (
            "[\"192.0.2.1\"]",
            "[0.0.0.0]",
            "c.toml:2: public.listen: the value cannot be read; write it in quotes: \
             listen = [\"0.0.0.0\"]",
        ),
        (
            "[\"192.0.2.1\"]",
            "0.0.0.0",
            "c.toml:2: public.listen: the value cannot be read; write it in quotes: \
             listen = [\"0.0.0.0\"]",
        ),
        (
            "\"section-1\"",
            "section-1",
            "c.toml:5: udp_range_net[0].name: the value cannot be read; write it in quotes: \
             name = \"section-1\"",
        ),
        (
            "[\"1-4\", 33]",
            "[1-4, 33] # the press",
            "c.toml:8: udp_range_net[0].nodes: the value cannot be read; write it in quotes: \
             nodes = [\"1-4\", 33]",
        ),
        (
            "[\"198.51.100.0/24\"]",
            "[198.51.100.0/24, \"203.0.113.0/24\", 192.0.2.7]",
            "c.toml:9: udp_range_net[0].allow: the value cannot be read; write it in quotes: \
             allow = [\"198.51.100.0/24\", \"203.0.113.0/24\", \"192.0.2.7\"]",
        ),
        (
            "[\"198.51.100.0/24\"]",
            "[\n  \"203.0.113.0/24\",\n  198.51.100.0/24, # office\n]",
            "c.toml:11: udp_range_net[0].allow: the value cannot be read; write it in quotes: \
             \"198.51.100.0/24\"",
        ),
        (
            "\"secrets/a\"\n\n",
            "secrets/a\n\n",
            "c.toml:12: udp_range_net[0].password[0].file: the value cannot be read; write it in \
             quotes: file = \"secrets/a\"",
        ),
        (
            "\"172.17.18.7:34379\"",
            "172.17.18.7:34379",
            "c.toml:17: server[0].address: the value cannot be read; write it in quotes: \
             address = \"172.17.18.7:34379\"",
        ),
        (
            "\"press\"",
            "“press”",
            "c.toml:15: server[0].name: the value cannot be read; write it in quotes: \
             name = \"press\"",
        ),
        (
            "\"press\"",
            "\"press",
            "c.toml:15: server[0].name: the value cannot be read; write it in quotes: \
             name = \"press\"",
        ),
        (
            "node = 7",
            "node = 7\nidle_timeout = 5m",
            "c.toml:19: server[0].idle_timeout: the value cannot be read; write it in quotes: \
             idle_timeout = \"5m\"",
        ),
        (
            "node = 7",
            "node = 7\nallow_without_password = yes",
            "c.toml:19: server[0].allow_without_password: the value cannot be read; write it like this: \
             allow_without_password = true",
        ),
        (
            "node = 7",
            "node = 7\nidle_timeout: 5m,",
            "c.toml:19: server[0].idle_timeout: the value cannot be read; write it in quotes: \
             idle_timeout = \"5m\"",
        ),
        (
            "node = 7",
            "node: 7,",
            "c.toml:18: server[0].node: the value cannot be read; write it like this: node = 7",
        ),
    ] {
        assert_eq!(told_of(from, to), [expected], "{to}");
    }
    let several = SOUND.replace("\"172.17.17.0\"", "172.17.17.0").replace("\"press\"", "press");
    assert_eq!(told(&several).len(), 2, "each line has its own");
}

#[test]
fn what_is_shown_can_be_read_or_nothing_is_shown() {
    let told = told_of("\"press\"", "= !");
    assert!(told[0].contains("correct the TOML"), "{told:?}");
    let told = told_of("\"press\"", "\"a\"b\"");
    assert!(told[0].contains("correct the TOML"), "{told:?}");
    // A tab may stand in a text, but a terminal would take it for blanks.
    let told = told_of("[\"192.0.2.1\"]", "[\"192.0.2.1\t\", 192.0.2.2]");
    assert!(told[0].contains("correct the TOML"), "{told:?}");
}

#[test]
fn no_message_shows_what_a_terminal_obeys() {
    let quotes: Vec<_> = SOUND.match_indices('"').map(|(at, _)| at).collect();
    for harmful in ['\t', '\u{7f}', '\u{85}', '\u{202e}', '\u{feff}'] {
        for &at in &quotes {
            // Inside of a text, after it, and where its end is missing.
            for (inserted, rest) in [(at + 1, at + 1), (at, at), (at, at + 1)] {
                let text = format!("{}{harmful}{}", &SOUND[..inserted], &SOUND[rest..]);
                let Err(Faults(faults)) = parse(&text, Path::new("c.toml")) else { continue };
                for fault in faults {
                    let told = fault.to_string();
                    assert!(!told.contains(crate::harmless::is_harmful), "{text:?}: {told:?}");
                }
            }
        }
    }
}

#[test]
fn blocks_in_the_wrong_order_are_named_with_their_lines() {
    let password = |of: &str| format!("[[{of}.password]]\nname = \"a\"\nfile = \"secrets/a\"\n");
    for of in ["server", "udp_range_net"] {
        assert_eq!(
            told(&(password(of) + &format!("\n[[{of}]]\nname = \"b\"\n"))),
            [format!(
                "c.toml:5: {of}: [[{of}.password]] in line 1 stands before the [[{of}]] that it \
                 belongs to; [[{of}]] and its keys must come first: move [[{of}.password]] with its \
                 keys below them"
            )]
        );
    }
    assert_eq!(
        told("[server]\nname = \"b\"\n[[server]]\nname = \"c\"\n"),
        ["c.toml:3: server: [server] in line 1 is written differently; write both as [[server]]"]
    );
    assert_eq!(
        told("[limits]\nmax_flows = 5\n[public]\n[limits]\nmax_flows = 6\n"),
        [
            "c.toml:4: limits: [limits] is already in line 1; move its keys to line 1, below the first \
          [limits]"
        ]
    );
    assert_eq!(
        told_of("node = 7", "node = 7\nnode = 8"),
        ["c.toml:19: server[0].node: is already in line 18; keep one of the two lines"]
    );
}

/// To add what stands below, as if it were missing, would be the wrong advice.
#[test]
fn keys_below_the_password_block_belong_above_it() {
    let folder = folder();
    let text = SOUND.replace("node = 7\nallow = [\"198.51.100.7\"]\n", "");
    let text = text + "node = 7\nallow = [\"198.51.100.7\"]\n";
    let Err(Faults(faults)) = read_in(folder.path(), &text) else { panic!("taken") };
    let told = |fault: &Fault| format!("{:?}: {}: {}", fault.line, fault.key, fault.remedy);
    let remedy =
        "it is a key of [[server]]: move it above line 18, where [[server.password]] begins";
    assert_eq!(
        faults.iter().map(told).collect::<Vec<_>>(),
        [
            format!("Some(21): server[0].password[0].node: {remedy}"),
            format!("Some(22): server[0].password[0].allow: {remedy}"),
        ]
    );
}

#[test]
fn signs_that_nobody_sees_are_named() {
    assert!(read(&format!("\u{feff}{SOUND}")).is_ok(), "the mark at the beginning is common");
    let unseen = |line, place, code| {
        format!(
            "c.toml:{line}: character {place} of the line is invisible (U+{code}); delete it, or \
             replace it with a plain space"
        )
    };
    assert_eq!(told_of("[[server]]", "\u{feff}[[server]]"), [unseen(14, 1, "FEFF")]);
    assert_eq!(told_of("node = 7", "node =\u{a0}7"), [unseen(18, 7, "00A0")]);
    assert_eq!(told_of("node = 7", "\u{200b}node = 7"), [unseen(18, 1, "200B")]);
}

#[test]
fn utf_16_is_named() {
    let folder = folder();
    let path = folder.path().join("c.toml");
    let little: Vec<u8> = SOUND.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> = SOUND.encode_utf16().flat_map(u16::to_be_bytes).collect();
    for (octets, encoding) in [
        ([b"\xff\xfe", &little[..]].concat(), "UTF-16"),
        ([b"\xfe\xff", &big[..]].concat(), "UTF-16"),
        (little, "UTF-16LE"),
        (big, "UTF-16BE"),
    ] {
        fs::write(&path, octets).unwrap();
        let told = load(&path).unwrap_err().to_string();
        let file = path.display();
        assert_eq!(
            told,
            format!(
                "{file}:1: is UTF-16 text; save the file as UTF-8; `iconv -f {encoding} -t UTF-8` \
                 converts it"
            )
        );
    }
}
