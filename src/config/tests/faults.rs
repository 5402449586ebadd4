//! What is refused or warned of, where in the file, and with what advice.
//!
//! Each case changes one thing in [`SOUND`] and expects exactly one fault.

use super::*;

fn refuses(cases: &[Case]) {
    each_is_refused(SOUND, cases, read_in);
}

#[test]
fn refuses_what_is_no_toml_or_no_key() {
    refuses(&[
        ("name = \"press\"", "name = press", 15, "server[0].name", "in quotes"),
        ("node = 7", "node = 7\nnode = 8", 19, "server[0].node", "already in line 18"),
        (
            "subnet =",
            "sub_net = 1\nsubnet =",
            7,
            "udp_range_net[0].sub_net",
            "did you mean `subnet`?",
        ),
        (
            "node = 7",
            "node = 7\nspeed = 1",
            19,
            "server[0].speed",
            "keys here are name, public_port",
        ),
        ("[public]", "[publik]\n[public]", 1, "publik", "did you mean `public`?"),
        ("[public]", "[public]\n\"a\\nb\" = 1", 2, "public.\"a\\nb\"", "unknown key"),
        (
            "file = \"secrets/a\"",
            "file = \"secrets/a\"\nfiel = 1",
            13,
            "udp_range_net[0].password[0].fiel",
            "did you mean `file`?",
        ),
    ]);
}

#[test]
fn a_key_in_another_section_is_refused_with_its_own() {
    refuses(&[
        (
            "[public]",
            "[limits]\nprefilter = \"off\"\n[public]",
            2,
            "limits.prefilter",
            "it is a key of [datapath]: move it there",
        ),
        (
            "[public]",
            "[limits]\nbusy_poll = \"50us\"\n[public]",
            2,
            "limits.busy_poll",
            "it is a key of [datapath]: move it there",
        ),
        (
            "[public]",
            "[limits]\naudit_lines = 7\n[public]",
            2,
            "limits.audit_lines",
            "it is a key of [log]: move it there",
        ),
        (
            "[public]",
            "[runtime]\nreceive_buffer = 65536\n[public]",
            2,
            "runtime.receive_buffer",
            "it is a key of [datapath]: move it there",
        ),
    ]);
}

#[test]
fn refuses_values_of_the_wrong_kind() {
    refuses(&[
        (
            "listen = [\"192.0.2.1\"]",
            "listen = \"192.0.2.1\"",
            2,
            "public.listen",
            "expected a list in brackets, found a text",
        ),
        (
            "[\"192.0.2.1\"]",
            "[\"192.0.2.1\",\n 5]",
            3,
            "public.listen[1]",
            "expected a text in quotes, found a whole number",
        ),
        ("\"192.0.2.1\"", "\"router\"", 2, "public.listen[0]", "\"router\" cannot be read"),
        ("node = 7", "node = 7.5", 18, "server[0].node", "a number with a fraction"),
        (
            "node = 7",
            "node = 7\nidle_timeout = 300",
            19,
            "server[0].idle_timeout",
            "write it like `idle_timeout = \"5m\"`",
        ),
        (
            "node = 7",
            "node = 7\nidle_timeout = \"5 parsecs\"",
            19,
            "server[0].idle_timeout",
            "cannot be read",
        ),
        (
            "node = 7",
            "node = 7\nallow_without_password = \"no\"",
            19,
            "server[0].allow_without_password",
            "true or false",
        ),
        (
            "[public]",
            "[datapath]\nkernel = \"always\"\n[public]",
            2,
            "datapath.kernel",
            "choose \"auto\", \"off\" or \"required\"",
        ),
        (
            "[[server.password]]",
            "[server.password]",
            20,
            "server[0].password",
            "[[server.password]]",
        ),
    ]);
    let Err(Faults(faults)) = read(&changed("[public]", "[[public]]")) else { panic!("taken") };
    assert_eq!(faults[0].key, "public");
    assert!(faults[0].remedy.contains("[public]"), "{}", faults[0]);
}

#[test]
fn refuses_what_is_missing() {
    refuses(&[
        ("listen = [\"192.0.2.1\"]", "", 1, "public.listen", "add `listen = "),
        ("[\"192.0.2.1\"]", "[]", 2, "public.listen", "empty"),
        ("start_port = 20000", "", 4, "udp_range_net[0].start_port", "missing"),
        ("name = \"press\"", "", 14, "server[0].name", "missing"),
        ("allow = [\"198.51.100.7\"]", "", 14, "server[0].allow", "missing"),
        ("[\"198.51.100.7\"]", "[]", 19, "server[0].allow", "empty"),
        ("[\"1-4\", 33]", "[]", 8, "udp_range_net[0].nodes", "empty"),
        // A4
        (
            "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/a\"",
            "",
            4,
            "udp_range_net[0].password",
            "add [[udp_range_net.password]]",
        ),
    ]);
    let Err(Faults(faults)) = read("[public]\nlisten = [\"::\"]\n") else { panic!("taken") };
    assert!(faults[0].problem.contains("nothing to relay"), "{}", faults[0]);
    let Err(Faults(faults)) = read("") else { panic!("taken") };
    assert_eq!(faults.len(), 2, "{faults:?}");
}

#[test]
fn refuses_addresses_and_ports_that_cannot_be() {
    refuses(&[
        (
            "\"192.0.2.1\"",
            "\"192.0.2.1\", \"::ffff:192.0.2.1\"",
            2,
            "public.listen[1]",
            "listed twice",
        ),
        ("\"192.0.2.1\"", "\"192.0.2.1\", \"0.0.0.0\"", 2, "public.listen[1]", "overlap"),
        // A15
        (
            "= 20000",
            "= 65500",
            6,
            "udp_range_net[0].start_port",
            "65500 + 125 is over 65535; choose a start port up to 65410",
        ),
        ("= 20000", "= 65411", 6, "udp_range_net[0].start_port", "65410"),
        ("= 20000", "= 0", 6, "udp_range_net[0].start_port", "out of bounds"),
        ("= 20000", "= 70000", 6, "udp_range_net[0].start_port", "out of bounds"),
        ("17.0\"", "17.1\"", 7, "udp_range_net[0].subnet", "172.17.17.0"),
        ("172.17.17.0", "224.0.1.0", 7, "udp_range_net[0].subnet", "not a host address"),
        ("172.17.17.0", "fd00::", 7, "udp_range_net[0].subnet", "cannot be read"),
        ("nodes =", "server_port = 0\nnodes =", 8, "udp_range_net[0].server_port", "out of bounds"),
        // R-4
        ("nodes =", "server_port = 34378\nnodes =", 8, "udp_range_net[0].server_port", "34379"),
        (":34379", ":34378", 17, "server[0].address", "34379"),
        (":34379", ":0", 17, "server[0].address", "no server"),
        ("172.17.18.7:", "255.255.255.255:", 17, "server[0].address", "no server"),
        (":34379", "", 17, "server[0].address", "cannot be read"),
        (
            "198.51.100.0/24",
            "198.51.100.9/24",
            9,
            "udp_range_net[0].allow[0]",
            "write \"198.51.100.0/24\"",
        ),
        ("198.51.100.0/24", "::ffff:198.51.100.0/120", 9, "udp_range_net[0].allow[0]", "IPv4"),
        (
            "node = 7",
            "node = 7\nidle_timeout = \"0s\"",
            19,
            "server[0].idle_timeout",
            "out of bounds",
        ),
        (
            "node = 7",
            "node = 7\nmax_requests_per_second = 0",
            19,
            "server[0].max_requests_per_second",
            "from 1 to 1000000",
        ),
        ("node = 7", "node = 7\nidle_timeout = \"2days\"", 19, "server[0].idle_timeout", "1day"),
        (
            "[public]",
            "protocol.header = \"0200000\"\n[public]",
            1,
            "protocol.header",
            "8 hexadecimal",
        ),
        ("[public]", "runtime.workers = 0\n[public]", 1, "runtime.workers", "from 1 to"),
        ("[public]", "limits.max_flows = -1\n[public]", 1, "limits.max_flows", "from 1 to"),
        ("[public]", "admin.listen = \"localhost\"\n[public]", 1, "admin.listen", "127.0.0.1:9378"),
    ]);
}

#[test]
fn refuses_addresses_with_what_to_write_instead() {
    let listen = |to, part| ("192.0.2.1", to, 2, "public.listen[0]", part);
    let allow = |to, part| ("198.51.100.0/24", to, 9, "udp_range_net[0].allow[0]", part);
    let server = |to, part| ("172.17.18.7:34379", to, 17, "server[0].address", part);
    let subnet = |to, part| ("172.17.17.0", to, 7, "udp_range_net[0].subnet", part);
    refuses(&[
        allow("plc.example", "names are not looked up; write it like \"198.51.100.0/24\""),
        allow("any", "write \"0.0.0.0/0\" for every IPv4 address, \"::/0\" for"),
        allow("ALL", "write \"0.0.0.0/0\""),
        allow("198.51.100.7/24", "\"198.51.100.0/24\" for the network, \"198.51.100.7/32\" for"),
        allow("2001:db8::7/64", "\"2001:db8::/64\" for the network, \"2001:db8::7/128\" for"),
        allow("198.51.100.7/255.255.255.0", "write \"198.51.100.0/24\""),
        allow("198.51.100.7/33", "from 0 to 32: \"198.51.100.7/32\""),
        allow("198.51.100.7:4000", "write it without the port: \"198.51.100.7\""),
        allow("198.51.100.1-9", "write it like \"198.51.100.0/24\""),
        allow("::ffff:198.51.100.0/120", "write \"198.51.100.0/24\""),
        listen("router", "names are not looked up; write an address of this host"),
        listen("any", "write \"0.0.0.0\" for IPv4, \"::\" for IPv6"),
        listen("fe80::1", "another address of the interface, or \"::\""),
        listen("fe80::1%eth0", "another address of the interface, or \"::\""),
        listen("224.0.0.1", "224.0.0.1 is a multicast group"),
        listen("ff02::1", "ff02::1 is a multicast group"),
        listen("::ffff:224.0.0.1", "224.0.0.1 is a multicast group"),
        listen("255.255.255.255", "255.255.255.255 is not a host address"),
        listen("240.0.0.1", "not a host address"),
        listen("0.1.2.3", "not a host address"),
        server(
            "[fe80::7]:34379",
            "add the interface's number, which `ip link` shows: \"[fe80::7%2]",
        ),
        server("[fe80::7%eth0]:34379", "the zone is the interface's number"),
        server("[fd00::7%2]:34379", "write \"[fd00::7]:34379\""),
        server("172.17.18.7", "write it like \"172.17.18.7:34379\""),
        server("fd00::7", "write it like \"[fd00::7]:34379\""),
        server("plc:34379", "names are not looked up; write it like `address ="),
        server("[::ffff:224.0.0.1]:34379", "no server can be at 224.0.0.1:34379"),
        subnet("172.17.17.0/24", "write \"172.17.17.0\": its mask is always"),
        (
            "[public]",
            "admin.listen = \"localhost:9378\"\n[public]",
            1,
            "admin.listen",
            "names are not looked up; write it like `listen = \"127.0.0.1:9378\"`",
        ),
    ]);
}

/// In IPv6 clothes or not, an IPv4 address is the same.
#[test]
fn mapped_addresses_are_ipv4() {
    refuses(&[
        (
            "172.17.18.7:34379\"\nnode = 7",
            "[::ffff:172.17.17.3]:34379\"\nnode = 3",
            17,
            "server[0].address",
            "server 172.17.17.3:34379 belongs to udp_range_net[0]",
        ),
        (
            "172.17.18.7:34379\"\nnode = 7",
            "[::ffff:192.0.2.1]:20001\"\nnode = 1",
            17,
            "server[0].address",
            "loop",
        ),
    ]);
    let text = changed("172.17.18.7:34379", "[::ffff:172.17.18.7]:34379")
        .replace("\"192.0.2.1\"", "\"::ffff:192.0.2.1\"")
        .replace("198.51.100.7", "::ffff:198.51.100.7")
        + "[admin]\nlisten = \"[::ffff:127.0.0.1]:9378\"\n";
    let (config, warnings) = read(&text).unwrap();
    assert_eq!(warnings, []);
    assert_eq!(config.listen, ["192.0.2.1".parse::<IpAddr>().unwrap()]);
    assert_eq!(config.admin.unwrap().listen, "127.0.0.1:9378".parse().unwrap());
    let press = config.table.mappings()[5];
    assert_eq!(press.server, "172.17.18.7:34379".parse().unwrap());
    assert!(config.table.allows(press.net, "198.51.100.7".parse().unwrap()));
    let link_local = changed("172.17.18.7:", "[fe80::7%2]:");
    assert!(read(&link_local).is_ok(), "with its zone");
}

#[test]
fn warns_of_clients_that_no_listener_hears() {
    let told = |listen: &str, allow: &str| -> Vec<String> {
        let text = changed("\"192.0.2.1\"", listen).replace("\"198.51.100.0/24\"", allow);
        let (_, warnings) = read(&text).unwrap();
        warnings
            .into_iter()
            .map(|Warning(fault)| format!("{}: {}", fault.key, fault.problem))
            .collect()
    };
    let (range, server) = ("udp_range_net[0].allow", "server[0].allow");
    let both = "\"0.0.0.0\", \"::\"";
    assert_eq!(told(both, "\"0.0.0.0/0\", \"::/0\""), [""; 0]);
    let expected = "no IPv4 client can reach the relay: `[public] listen` has no IPv4 address";
    assert_eq!(
        told("\"::\"", "\"2001:db8::/32\", \"198.51.100.0/24\", \"203.0.113.0/24\""),
        [format!("{range}[1]: {expected}"), format!("{server}[0]: {expected}")]
    );
    assert_eq!(
        told("\"192.0.2.1\"", "\"0.0.0.0/0\", \"::/0\""),
        [format!(
            "{range}[1]: no IPv6 client can reach the relay: `[public] listen` has no IPv6 address"
        )]
    );
    assert_eq!(
        told(both, "\"0.0.0.0/0\""),
        ["public.listen[1]: no client can use ::, since no `allow` has IPv6 networks"]
    );
}

#[test]
fn r11_refuses_node_addresses_that_are_none() {
    refuses(&[
        ("33]", "0]", 8, "udp_range_net[0].nodes[1]", "from 1 to 125"),
        ("33]", "126]", 8, "udp_range_net[0].nodes[1]", "from 1 to 125"),
        ("33]", "3]", 8, "udp_range_net[0].nodes[1]", "node 3 is listed twice"),
        ("1-4", "4-1", 8, "udp_range_net[0].nodes[0]", "\"4-1\" is not a range"),
        ("1-4", "1-127", 8, "udp_range_net[0].nodes[0]", "1 to 125"),
        ("1-4", "4-", 8, "udp_range_net[0].nodes[0]", "\"1-4\""),
        ("node = 7", "node = 126", 18, "server[0].node", "from 1 to 125"),
    ]);
}

#[test]
fn refuses_names_that_metrics_could_not_carry() {
    refuses(&[
        ("\"press\"", "\"\"", 15, "server[0].name", "not a name"),
        ("\"press\"", "\"-press\"", 15, "server[0].name", "begin with a letter"),
        ("\"press\"", "\"la presse\"", 15, "server[0].name", "not a name"),
        ("\"press\"", "\"none\"", 15, "server[0].name", "choose another"),
        (
            "\"press\"",
            "\"section-1\"",
            15,
            "server[0].name",
            "udp_range_net[0] \"section-1\" (line 4)",
        ),
        (
            "name = \"service\"",
            "name = \"a\\nb\"",
            11,
            "udp_range_net[0].password[0].name",
            "not a name",
        ),
        (
            "[[server]]",
            "[[udp_range_net.password]]\nname = \"service\"\nfile = \"secrets/b\"\n[[server]]",
            15,
            "udp_range_net[0].password[1].name",
            "already a password",
        ),
    ]);
    let longest = "a".repeat(63);
    assert!(read(&changed("press", &longest)).is_ok());
    assert!(read(&changed("press", &(longest + "a"))).is_err());
}

#[test]
fn refuses_what_two_nets_cannot_share() {
    refuses(&[
        (
            "20200",
            "20003",
            16,
            "server[0].public_port",
            "public port 20003 belongs to udp_range_net[0] \"section-1\" (line 4) too",
        ),
        (
            "172.17.18.7:34379\"\nnode = 7",
            "172.17.17.33:34379\"\nnode = 33",
            17,
            "server[0].address",
            "server 172.17.17.33:34379 belongs to udp_range_net[0]",
        ),
        // R-11
        ("20200", "20126", 16, "server[0].public_port", "+ 126 or + 127"),
        ("20200", "20127", 16, "server[0].public_port", "+ 126 or + 127"),
    ]);
    assert!(read(&changed("20200", "20005")).is_ok(), "a port of the block that no node uses");
    let loops = changed("172.17.18.7:34379\"\nnode = 7", "192.0.2.1:20001\"\nnode = 1");
    let Err(Faults(faults)) = read(&loops) else { panic!("a loop is taken") };
    assert_eq!((faults.len(), faults[0].key.as_str()), (1, "server[0].address"));
    let everywhere = loops.replace("192.0.2.1:", "127.0.0.1:").replace("192.0.2.1", "0.0.0.0");
    assert!(read(&everywhere).unwrap_err().to_string().contains("loop"));
}

#[test]
fn two_ranges_that_overlap_are_one_fault_for_ports_and_one_for_servers() {
    let again = "[[udp_range_net]]\nname = \"section-2\"\nstart_port = 20002\nsubnet = \"172.17.17.0\"\nnodes = [\"1-2\", 31, 40]\nallow = [\"::/0\"]\nallow_without_password = true\n";
    let Err(Faults(faults)) = read(&(SOUND.to_owned() + again)) else { panic!("taken") };
    let [ports, servers] = faults.as_slice() else { panic!("{faults:#?}") };
    assert!(ports.problem.starts_with("public port 20003-20004, 20033 belongs to"), "{ports}");
    assert!(servers.problem.starts_with("server 172.17.17.1:34379 (and 1 more)"), "{servers}");
    assert_eq!((ports.line, servers.line), (Some(25), Some(26)));
}

#[test]
fn a11_refuses_password_files_that_are_not_8_private_octets() {
    let file = "udp_range_net[0].password[0].file";
    refuses(&[
        ("secrets/a", "secrets/seven", 12, file, "has 7 octets"),
        ("secrets/a", "secrets/nine", 12, file, "more than the 8 octets"),
        ("secrets/a", "secrets/newline", 12, file, "remove it: `truncate --size=8 "),
        ("secrets/a", "secrets/for-group", 12, file, "run `chmod 600 "),
        ("secrets/a", "secrets/for-others", 12, file, "mode 604"),
        ("secrets/a", "secrets/absent", 12, file, "secrets/absent\" cannot be read"),
        ("secrets/a", "secrets/a\\nb", 12, file, "a\\nb\" cannot be read"),
        ("secrets/a", "secrets", 12, file, "not a regular file"),
        ("secrets/a", "secrets/pipe", 12, file, "not a regular file"),
        (
            "secrets/a\"",
            "secrets/a\"\ndevice_file = \"secrets/seven\"",
            13,
            "udp_range_net[0].password[0].device_file",
            "has 7 octets",
        ),
        (
            "[[server]]",
            "[[udp_range_net.password]]\nname = \"old\"\nfile = \"secrets/same-as-a\"\n[[server]]",
            16,
            "udp_range_net[0].password[1].file",
            "the same password as \"service\"",
        ),
    ]);
    assert!(read(&changed("secrets/a", "secrets/link")).is_ok());
    assert!(read(&changed("secrets/a", "secrets/any-octets")).is_ok());
}

/// What is in backticks mends the fault when it is pasted.
#[test]
fn the_commands_of_remedies_work_as_they_are_told() {
    let told = |folder: &Path, text: &str| match read_in(folder, text) {
        Ok((_, warnings)) => warnings.into_iter().map(|warning| warning.0.remedy).next(),
        Err(Faults(faults)) => Some(faults[0].remedy.clone()),
    };
    for (file, command) in [
        ("newline", "truncate --size=8 "),
        ("crlf", "truncate --size=8 "),
        ("for-group", "chmod 600 -- "),
        ("for-others", "chmod 600 -- "),
    ] {
        let folder = folder();
        let text = changed("file = \"secrets/a\"", &format!("file = \"secrets/{file}\""));
        let remedy = told(folder.path(), &text).expect(file);
        let pasted = remedy.split('`').nth(1).expect("a command");
        assert!(pasted.starts_with(command), "{file}: {remedy}");
        let done = std::process::Command::new("sh").args(["-c", pasted]).status().unwrap();
        assert!(done.success() && told(folder.path(), &text).is_none(), "{pasted}");
    }
    // `tests/it/password.rs` pastes these, which need the program.
    for file in ["absent", "two/folders/absent", "seven", "nine", "marked", "guessable", "mistyped"]
    {
        let folder = folder();
        let text = changed("file = \"secrets/a\"", &format!("file = \"secrets/{file}\""));
        let remedy = told(folder.path(), &text).expect(file);
        let path = folder.path().join("secrets").join(file);
        let command = format!("`pnet-nat password {}`", path.display());
        assert!(remedy.contains(&command) && !remedy.contains("PASSWORD"), "{file}: {remedy}");
    }
    for (file, command) in [
        ("absent", "(umask 077; openssl rand -hex 16 > "),
        ("two/folders/absent", "(umask 077; mkdir -p -m 700 -- "),
        ("short-token", "(umask 077; openssl rand -hex 16 > "),
    ] {
        let folder = folder();
        let text = format!("admin.token_file = \"secrets/{file}\"\n{SOUND}");
        let remedy = told(folder.path(), &text).expect(file);
        assert!(remedy.contains(command), "{file}: {remedy}");
    }
}

/// The servers' own password is known already: no random one helps.
#[test]
fn a_device_password_is_typed() {
    use std::io::Write;
    let folder = folder();
    let key = "file = \"secrets/a\"\ndevice_file = \"secrets/own/device\"";
    let text = changed("file = \"secrets/a\"", key);
    let Err(Faults(faults)) = read_in(folder.path(), &text) else { panic!("taken") };
    let pasted = faults[0].remedy.split('`').nth(1).expect("a command");
    let mut shell = std::process::Command::new("sh");
    let shell = shell.args(["-c", pasted]).stdin(std::process::Stdio::piped());
    let mut shell = shell.spawn().unwrap();
    shell.stdin.take().unwrap().write_all(b"s3cr3t\\A\n").unwrap();
    assert!(shell.wait().unwrap().success());
    let (config, _) = read_in(folder.path(), &text).unwrap();
    let password = config.table.nets()[0].credentials[0].at_server();
    assert!(bool::from(password.matches(b"s3cr3t\\A")));
}

#[test]
fn warns_of_a_password_that_looks_mistyped() {
    let text = changed("secrets/a", "secrets/mistyped");
    let (_, warnings) = read(&text).unwrap();
    let [Warning(warning)] = &warnings[..] else { panic!("{warnings:?}") };
    assert_eq!(warning.key, "udp_range_net[0].password[0].file");
    assert!(warning.problem.ends_with("octet 8 is a line break (LF)"), "{warning}");
    assert!(!warning.to_string().contains("s3cr3t"), "{warning}");
}

#[test]
fn warns_of_what_is_probably_not_meant() {
    let cases: [Case; 7] = [
        ("= 20000", "= 34378", 6, "udp_range_net[0].start_port", "34379"),
        ("= 20000", "= 1000", 6, "udp_range_net[0].start_port", "CAP_NET_BIND_SERVICE"),
        ("node = 7", "node = 8", 17, "server[0].address", "last octet"),
        ("node = 7", "node = 7\nidle_timeout = \"119s\"", 19, "server[0].idle_timeout", "RFC 4787"),
        (
            "[[server.password]]\nname = \"service\"\nfile = \"secrets/a\"",
            "allow_without_password = true",
            20,
            "server[0].allow_without_password",
            "PAS 7",
        ),
        (
            "public_port = 20200",
            "public_port = 7",
            16,
            "server[0].public_port",
            "no IPNetTable row",
        ),
        // A15
        (
            "public_port = 20200",
            "public_port = 65418",
            16,
            "server[0].public_port",
            "65418 - 7, which is over 65410; choose a public port up to 65417",
        ),
    ];
    for (from, to, line, key, part) in cases {
        let (_, warnings) = read(&changed(from, to)).unwrap();
        let Warning(warning) = &warnings[0];
        assert_eq!((warning.line, warning.key.as_str()), (Some(line), key), "{warning}");
        assert!(warning.to_string().contains(part) && !warning.remedy.is_empty(), "{warning}");
    }
}

#[test]
fn refuses_an_admin_server_that_answers_strangers() {
    let listen =
        |listen: &str| changed("[public]", &format!("admin.listen = \"{listen}\"\n[public]"));
    for beyond in ["0.0.0.0:9378", "192.0.2.1:9378", "[::]:9378", "[::ffff:192.0.2.1]:9378"] {
        let Err(Faults(faults)) = read(&listen(beyond)) else { panic!("{beyond}") };
        let [fault] = faults.as_slice() else { panic!("{faults:#?}") };
        assert_eq!((fault.line, fault.key.as_str()), (Some(1), "admin.listen"), "{beyond}");
        assert!(fault.remedy.contains("set `token_file`"), "{fault}");
    }
    for own in ["127.0.0.1:9378", "127.9.9.9:1", "[::1]:9378", "[::ffff:127.0.0.1]:9378"] {
        assert!(read(&listen(own)).is_ok(), "{own}");
    }
    let off = "admin.enabled = false\nadmin.listen = \"0.0.0.0:9378\"\n[public]";
    assert!(read(&changed("[public]", off)).is_ok());
}

#[test]
fn refuses_a_title_that_no_tab_has_room_for() {
    let title = |title: &str| format!("admin.title = \"{title}\"\n[public]");
    for wrong in ["", "a\\nb", &"x".repeat(61)] {
        let Err(Faults(faults)) = read(&changed("[public]", &title(wrong))) else {
            panic!("{wrong}")
        };
        let [fault] = faults.as_slice() else { panic!("{faults:#?}") };
        assert_eq!((fault.line, fault.key.as_str()), (Some(1), "admin.title"), "{wrong}");
    }
    for right in ["Molkerei <b>Süd</b>", &"ä".repeat(60)] {
        let (config, _) = read(&changed("[public]", &title(right))).unwrap();
        assert_eq!(config.admin.unwrap().title.as_deref(), Some(right));
    }
}

#[test]
fn refuses_a_token_that_is_none() {
    let token = |file: &str| format!("admin.token_file = \"secrets/{file}\"\n[public]");
    for (file, part) in [
        ("absent", "openssl rand -hex 16"),
        ("short-token", "16 to 256 letters"),
        ("two-lines", "16 to 256 letters"),
        ("any-octets", "16 to 256 letters"),
        ("for-others", "chmod 600"),
    ] {
        let Err(Faults(faults)) = read(&changed("[public]", &token(file))) else {
            panic!("{file}")
        };
        let [fault] = faults.as_slice() else { panic!("{faults:#?}") };
        assert_eq!((fault.line, fault.key.as_str()), (Some(1), "admin.token_file"), "{file}");
        let message = fault.to_string();
        assert!(message.contains(part) && !message.contains("s3cr3t"), "{message}");
    }
    for file in ["token", "token-with-newline", "token-with-crlf"] {
        let (config, _) = read(&changed("[public]", &token(file))).unwrap();
        assert!(!format!("{config:?}").contains("s3cr3t"));
        let token = config.admin.unwrap().token.unwrap();
        assert!(token.matches(b"s3cr3t-0123456789") && !token.matches(b"s3cr3t-012345678"));
        assert!(config.files.iter().any(|path| path.ends_with(format!("secrets/{file}"))));
    }
}

#[test]
fn a_file_that_cannot_be_read_is_a_fault_too() {
    let folder = folder();
    let absent = load(&folder.path().join("absent.toml")).unwrap_err();
    assert!(absent.to_string().contains("absent.toml: cannot be read"), "{absent}");
    let binary = folder.path().join("binary.toml");
    fs::write(&binary, b"[public]\n\xff").unwrap();
    let binary = load(&binary).unwrap_err();
    assert!(binary.to_string().contains("binary.toml:2: is not UTF-8"), "{binary}");
}

#[test]
fn all_faults_in_one_run() {
    let text = r#"
[public]
listen = ["0.0.0.0", "192.0.2.1", 7]
[protocol]
header = "0200000"
[[udp_range_net]]
name = "section 1"
start_port = 65500
subnet = "172.17.17.1"
nodes = ["1-4", 126, 3, "x"]
alow = ["198.51.100.0/24"]
idle_timeout = 300
  [[udp_range_net.password]]
  name = "service"
  file = "secrets/seven"
  [[udp_range_net.password]]
  name = "service"
  file = "secrets/newline"
[[server]]
name = "press"
public_port = "20200"
address = "172.17.18.7"
node = 7
allow = ["198.51.100.7/24"]
[limits]
max_flow = 5
[admin]
enabled = "yes"
"#;
    let faults = parse(text, Path::new("pnet-nat.toml")).unwrap_err();
    insta::assert_snapshot!(faults.to_string().replace(" (os error 2)", ""));
}
