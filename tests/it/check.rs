//! `pnet-nat check` as a user meets it: exit codes, and what goes to stdout and to stderr.

use std::fs;
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::Path;
use std::process::Command;

use nix::unistd::geteuid;
use serde_json::{Value, json};

use crate::harness::{ANNOTATED, Process, folder, left_out, pnet_nat};

/// The annotated configuration with servers on loopback, which has no way to check.
fn annotated() -> String {
    ANNOTATED.replace("\"172.17.", "\"127.17.")
}

/// The command, where `folder` is the current one.
fn check(folder: &Path, options: &[&str]) -> Process {
    let mut command = pnet_nat(&["check"]);
    command.current_dir(folder).args(options);
    Process::start(command)
}

#[test]
fn a_sound_configuration_shows_its_tables() {
    let folder = folder(&annotated());
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(0));
    assert_eq!(checked.stderr(), "");
    insta::assert_snapshot!(checked.stdout());
}

#[test]
fn for_scripts_it_is_one_object() {
    let folder = folder(&annotated());
    let json = ["--config", "pnet-nat.toml", "--format", "json"];
    let mut checked = check(folder.path(), &json);
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(0), ""));
    let object: Value = serde_json::from_str(&checked.stdout()).unwrap();
    assert_eq!((&object["sound"], &object["faults"]), (&json!(true), &json!([])));
    let line = json!({
        "net": "section-1", "node": 33, "public_address": null, "public_port": 20033,
        "server": "127.17.17.33:34379",
    });
    assert_eq!(object["nat_table"][4], line);
    let net = &object["nets"][0];
    assert_eq!((&net["kind"], &net["passwords"]), (&json!("udp_range_net"), &json!(["service"])));
    let row = json!({
        "net": "press", "IPAddr": [], "UDPPort": 20193, "UsePW": 1, "Nettype": "UDPRange", "node": 7,
    });
    assert_eq!(object["clients"][1], row);

    let faulty = annotated().replace("nodes = [\"1-4\", 33]", "nodes = [\"1-500\"]");
    fs::write(folder.path().join("pnet-nat.toml"), &faulty).unwrap();
    let mut checked = check(folder.path(), &json);
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(2), ""));
    let object: Value = serde_json::from_str(&checked.stdout()).unwrap();
    let lines = faulty.lines().position(|line| line.starts_with("nodes = "));
    let fault = &object["faults"][0];
    assert_eq!(object["sound"], false);
    assert_eq!(
        (&fault["file"], &fault["line"]),
        (&json!("pnet-nat.toml"), &json!(lines.unwrap() + 1))
    );
    assert_eq!(
        (&fault["key"], &fault["passes"]),
        (&json!("udp_range_net[0].nodes[0]"), &json!(false))
    );
    assert!(fault["remedy"].as_str().unwrap().contains("1 to 125"), "{fault}");
    assert!(object.get("nat_table").is_none());

    // What there is no file for is a fault, too.
    let mut checked = check(folder.path(), &["--config", "absent.toml", "--format", "json"]);
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(2), ""));
    let object: Value = serde_json::from_str(&checked.stdout()).unwrap();
    assert_eq!(object["faults"][0]["line"], Value::Null);
}

#[test]
fn a_remote_net_is_shown_with_its_addresses_here_and_there() {
    let folder = folder(
        "[[remote_net]]\nname = \"plant-2\"\nrouter = \"127.0.113.5\"\nstart_port = 20000\n\
         nodes = [\"1-4\", 33]\nlocal_subnet = \"127.17.2.0\"\nallow = [\"127.0.0.0/8\"]\n\
         [[remote_net.password]]\nname = \"service\"\nfile = \"secrets/section-1\"\n",
    );
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(0), ""));
    insta::assert_snapshot!(checked.stdout());
}

#[test]
fn a_profinet_device_is_shown_with_its_records() {
    let folder = folder(
        "[public]\nlisten = [\"192.0.2.1\"]\n[[profinet_device]]\nname = \"drive-7\"\n\
         public_port = 45007\naddress = \"127.17.17.7\"\nallow = [\"198.51.100.0/28\"]\n",
    );
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!((checked.end(), checked.stderr().as_str()), (Some(0), ""));
    insta::assert_snapshot!(checked.stdout());
}

#[test]
fn full_shows_a_line_for_each_node() {
    let folder = folder(&annotated());
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml", "--full"]);
    assert_eq!(checked.end(), Some(0));
    let stdout = checked.stdout();
    for node in [1, 2, 3, 4, 33] {
        let server = format!("127.17.17.{node}:34379");
        let line = stdout.lines().find(|line| line.contains(&server)).unwrap();
        assert!(line.contains(&format!(" {} ", 20000 + node)), "{line}");
    }
}

#[test]
fn warnings_do_not_refuse_and_rows_that_cannot_be_are_left_out() {
    let configuration = annotated()
        .replace("public_port = 20200", "public_port = 7")
        .replace("[\"0.0.0.0\"]", "[\"192.0.2.1\", \"2001:db8::1\"]")
        .replace("= \"5m\"", "= \"1m\"");
    let folder = folder(&configuration);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(0));
    insta::assert_snapshot!(checked.stderr() + "\n" + &checked.stdout());
}

#[test]
fn every_fault_is_shown_and_the_exit_code_is_2() {
    let configuration = annotated()
        .replace("start_port = 20000", "start_port = 20199")
        .replace("file = \"secrets/section-1\"", "file = \"secrets/absent\"")
        .replace("node = 7", "node = 126\nnodes = 5")
        .replace("drain = \"5s\"", "drain = 5");
    let folder = folder(&configuration);
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(2));
    assert_eq!(checked.stdout(), "");
    insta::assert_snapshot!(checked.stderr());
}

#[test]
fn the_configuration_can_be_named_by_the_environment() {
    let folder = folder(&annotated());
    let mut command = pnet_nat(&["check"]);
    command.current_dir(folder.path()).env("PNET_NAT_CONFIG", "pnet-nat.toml");
    assert_eq!(Process::start(command).end(), Some(0));
}

#[test]
fn a_configuration_that_is_not_there_is_exit_code_2() {
    let folder = folder(&annotated());
    let mut checked = check(folder.path(), &["--config", "absent.toml"]);
    assert_eq!(checked.end(), Some(2));
    let stderr = checked.stderr();
    assert!(stderr.starts_with("absent.toml: cannot be read: "), "{stderr}");
    assert_eq!(check(folder.path(), &[]).end(), Some(2));
}

#[test]
fn a_user_that_is_not_there_is_exit_code_2() {
    let folder =
        folder(&annotated().replace("#user = \"pnet-nat\"", "user = \"nobody-of-this-name\""));
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(2));
    let stderr = checked.stderr();
    assert!(stderr.contains("\"nobody-of-this-name\"") && stderr.contains("useradd"), "{stderr}");
}

/// A network around the plant's subnet does not name it.
#[test]
fn clients_inside_the_plant_that_are_not_let_in_are_told_of() {
    let remark = "section-1: 127.17.0.0/16 does not let in clients from the plant's own subnet; if there \
                  are some, add \"127.17.17.0/24\" to `allow`.";
    let told = |allow: &str| {
        let folder = folder(&annotated().replace("\"198.51.100.0/24\"", allow));
        let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
        assert_eq!(checked.end(), Some(0), "{}", checked.stderr());
        checked.stdout().matches(remark).count()
    };
    assert_eq!(told("\"127.17.0.0/16\""), 1);
    assert_eq!(told("\"127.17.0.0/16\", \"127.17.17.0/24\""), 0);
    assert_eq!(told("\"127.17.0.0/16\", \"127.17.17.8/32\""), 0);
    assert_eq!(told("\"0.0.0.0/0\""), 0);
}

/// On a router, in a network of its own: one address on the Internet side, one in the plant.
#[test]
fn the_routes_to_the_servers_are_checked() {
    if !geteuid().is_root() {
        return left_out("root, for a network");
    }
    let folder = folder(ANNOTATED);
    let two_interfaces = "ip link add wan type veth peer name w && ip link set w up && \
                          ip link add plant type veth peer name p && ip link set p up && \
                          ip link set wan up && ip link set plant up && \
                          ip address add 203.0.113.5/24 dev wan && \
                          ip address add 172.17.17.250/24 dev plant && \
                          ip route add default via 203.0.113.1";
    // As a container has it in a network of Docker's own.
    let one_interface = "ip link add eth0 type veth peer name e && ip link set e up && \
                         ip link set eth0 up && ip address add 172.19.0.2/16 dev eth0 && \
                         ip route add default via 172.19.0.1";
    let checked = |network: &str, configuration: &str| {
        fs::write(folder.path().join("pnet-nat.toml"), configuration).unwrap();
        let network = format!("{network} && exec \"$0\" check --config pnet-nat.toml");
        let mut command = Command::new("unshare");
        command.args(["--net", "sh", "-c", &network, env!("CARGO_BIN_EXE_pnet-nat")]);
        command.current_dir(folder.path());
        let mut checked = Process::start(command);
        (checked.end(), checked.stderr())
    };
    let sound = ANNOTATED.replace("172.17.18.7", "172.17.17.7");
    assert_eq!(checked(two_interfaces, &sound), (Some(0), String::new()));
    let mistyped = sound.replace("= \"172.17.17.0\"", "= \"172.71.17.0\"");
    let (code, stderr) = checked(two_interfaces, &mistyped);
    assert_eq!(code, Some(75), "{stderr}");
    assert!(stderr.contains("the route to 172.71.17.1 leaves by the Internet side"), "{stderr}");

    let (code, stderr) = checked(one_interface, &sound);
    assert_eq!(code, Some(75), "{stderr}");
    assert!(stderr.contains("set `servers_beyond_gateway = true`"), "{stderr}");
    let meant = sound.replace("servers_beyond_gateway = false", "servers_beyond_gateway = true");
    assert_eq!(checked(one_interface, &meant), (Some(0), String::new()));
}

/// As Docker, Podman and CSI drivers mount secrets: no `chmod` can change them there.
#[test]
fn a_secret_on_a_read_only_mount_is_to_be_mounted_otherwise() {
    if !geteuid().is_root() {
        return left_out("root, for a mount");
    }
    let folder = folder(&annotated().replace("#user = \"pnet-nat\"", "user = 65534"));
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let checked = |mode: &str, owner: &str| {
        let mount = format!(
            "cp -r secrets all && mount -t tmpfs -o mode=755 none secrets && cp all/* secrets && \
             chmod {mode} secrets/* && chown {owner} secrets/* && rm -r all && \
             mount -o remount,ro secrets && exec \"$0\" check --config pnet-nat.toml"
        );
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-c", &mount, env!("CARGO_BIN_EXE_pnet-nat")]);
        command.current_dir(folder.path());
        let mut checked = Process::start(command);
        (checked.end(), checked.stderr())
    };
    for (mode, owner) in [("0444", "65534"), ("0444", "0"), ("0400", "0")] {
        let (code, stderr) = checked(mode, owner);
        assert_eq!(code, Some(2), "{mode} {owner}: {stderr}");
        assert!(stderr.contains("mode=0400,uid=65534"), "{mode} {owner}: {stderr}");
        assert!(!stderr.contains("chmod") && !stderr.contains("chown"), "{stderr}");
    }
    assert_eq!(checked("0400", "65534"), (Some(0), String::new()));
}

/// What the relay could not read with the rights of its user, `check` finds.
#[test]
fn files_are_read_with_the_rights_of_the_user() {
    if !geteuid().is_root() {
        return left_out("root, which becomes another user");
    }
    let folder = folder(&annotated().replace("#user = \"pnet-nat\"", "user = 65534"));
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755)).unwrap();
    let mut checked = check(folder.path(), &["--config", "pnet-nat.toml"]);
    assert_eq!(checked.end(), Some(2), "{}", checked.stdout());
    let stderr = checked.stderr();
    assert!(stderr.contains("Permission denied") && stderr.contains("chown 65534"), "{stderr}");
    for file in ["secrets", "secrets/section-1", "secrets/press"] {
        chown(folder.path().join(file), Some(65534), Some(65534)).unwrap();
    }
    assert_eq!(check(folder.path(), &["--config", "pnet-nat.toml"]).end(), Some(0));

    let mut other = Command::new("setpriv");
    other.args(["--reuid=65533", "--regid=65533", "--clear-groups"]);
    other.args([env!("CARGO_BIN_EXE_pnet-nat"), "check", "--config", "pnet-nat.toml"]);
    other.current_dir(folder.path());
    let mut other = Process::start(other);
    assert_eq!(other.end(), Some(2));
    assert!(other.stderr().contains("check as root"), "{}", other.stderr());
}

/// A file that is made of it holds the sheet alone; what there is to say goes to stderr.
#[test]
fn the_clients_sheet_is_all_that_is_printed() {
    let folder = folder(&annotated().replace("public_port = 20200", "public_port = 7"));
    for (options, beginning) in [
        (&["--client-sheet"][..], "# Set up a P-NET client\n\n| Net "),
        (&["--client-sheet", "csv"], "Net,IPAddr,UDPPort,UsePW,Router,Nettype,"),
        (&["--client-sheet", "html"], "<!DOCTYPE html>\n"),
    ] {
        let options = [&["--config", "pnet-nat.toml"][..], options].concat();
        let mut checked = check(folder.path(), &options);
        assert_eq!(checked.end(), Some(0));
        let (sheet, said) = (checked.stdout(), checked.stderr());
        assert!(sheet.starts_with(beginning) && sheet.contains("--start-port 20000"), "{sheet}");
        assert!(!sheet.contains("press") && !sheet.contains("NAT table"), "{sheet}");
        assert!(said.contains("note: press: no row reaches node 7"), "{said}");
    }
}
