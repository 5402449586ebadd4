//! What a package and a terminal see of the command line: version, completions, manual, colours.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::harness::{
    Process, Relay, Settings, Site, Terminal, eventually, folder, left_out, pnet_nat,
};

fn stdout(arguments: &[&str]) -> String {
    let mut process = Process::start(pnet_nat(arguments));
    assert_eq!(process.end(), Some(0), "{}", process.stderr());
    process.stdout()
}

/// The commands of the program, as its help lists them.
fn commands() -> Vec<String> {
    let help = stdout(&["--help"]);
    let (_, list) = help.split_once("Commands:\n").unwrap();
    let list = list.split("\n\n").next().unwrap().lines();
    let names = list.filter_map(|line| line.strip_prefix("  ").filter(|it| !it.starts_with(' ')));
    names.map(|line| line.split(' ').next().unwrap().to_owned()).collect()
}

/// What `build.rs` tells of a folder of sources.
fn told_of(folder: &Path, build: &Path, commit: Option<&str>) -> String {
    let mut command = Command::new(build);
    command.current_dir(folder).env("CARGO_MANIFEST_DIR", folder).env_remove("PNET_NAT_COMMIT");
    command.envs(commit.map(|commit| ("PNET_NAT_COMMIT", commit)));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let output = String::from_utf8(output.stdout).unwrap();
    let version =
        output.lines().find_map(|line| line.strip_prefix("cargo::rustc-env=PNET_NAT_VERSION="));
    version.unwrap().to_owned()
}

#[test]
fn the_version_tells_the_commit_where_it_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let build = folder.path().join("build");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/build.rs");
    let mut rustc = Command::new("rustc");
    rustc.args(["--edition", "2024", "-o"]).arg(&build).arg(script);
    assert!(rustc.env("CARGO_PKG_VERSION", "1.2.3").status().unwrap().success());
    let sources = folder.path().join("sources");
    fs::create_dir_all(sources.join("inner")).unwrap();

    assert_eq!(told_of(&sources, &build, None), "1.2.3", "a tarball");
    assert_eq!(told_of(&sources, &build, Some("")), "1.2.3");
    assert_eq!(told_of(&sources, &build, Some("0123abc")), "1.2.3 (0123abc)");

    if Command::new("git").arg("--version").output().is_err() {
        return left_out("git");
    }
    let git = |arguments: &[&str]| {
        let identity = ["-c", "user.name=pnet-nat", "-c", "user.email=pnet-nat@example.org"];
        let mut git = Command::new("git");
        let output = git.current_dir(&sources).args(identity).args(arguments).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    git(&["init", "--quiet"]);
    assert_eq!(told_of(&sources, &build, None), "1.2.3", "no commit yet");
    git(&["commit", "--quiet", "--allow-empty", "--message", "First"]);
    let commit = git(&["rev-parse", "--short=12", "HEAD"]);
    assert_eq!(told_of(&sources, &build, None), format!("1.2.3 ({commit})"));
    assert_eq!(told_of(&sources.join("inner"), &build, None), "1.2.3", "someone else's commit");
    assert_eq!(told_of(&sources, &build, Some("0123abc")), "1.2.3 (0123abc)");
}

/// Also after a commit: cargo sees that there is another.
#[test]
fn the_program_tells_the_commit_that_it_is_built_from() {
    let of_git = |arguments: &[&str]| {
        let mut git = Command::new("git");
        let output = git.arg("-C").arg(env!("CARGO_MANIFEST_DIR")).args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).unwrap();
        output.status.success().then(|| text.trim().to_owned())
    };
    let is_repository =
        of_git(&["rev-parse", "--show-toplevel"]).as_deref() == Some(env!("CARGO_MANIFEST_DIR"));
    let said = std::env::var("PNET_NAT_COMMIT").ok().filter(|commit| !commit.is_empty());
    let commit =
        said.or_else(|| of_git(&["rev-parse", "--short=12", "HEAD"]).filter(|_| is_repository));
    let version = match commit {
        Some(commit) => format!(concat!("pnet-nat ", env!("CARGO_PKG_VERSION"), " ({})\n"), commit),
        None => concat!("pnet-nat ", env!("CARGO_PKG_VERSION"), "\n").to_owned(),
    };
    assert_eq!(stdout(&["--version"]), version);
}

#[test]
fn bash_completes_commands_and_options() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("pnet-nat");
    fs::write(&script, stdout(&["completions", "bash"])).unwrap();
    let complete = |words: &[&str]| {
        let question = r#"source "$0" && COMP_WORDS=("$@") && COMP_CWORD=$(($# - 1)) &&
            $(complete -p pnet-nat | sed 's/.*-F \([^ ]*\).*/\1/') pnet-nat "${@: -1}" "${@: -2:1}"
            echo "${COMPREPLY[@]}""#;
        let mut bash = Command::new("bash");
        let output = bash.args(["-c", question]).arg(&script).args(words).output().unwrap();
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    assert_eq!(complete(&["pnet-nat", "dec"]), "decode");
    assert_eq!(complete(&["pnet-nat", "decode", "--po"]), "--ports");
    assert_eq!(complete(&["pnet-nat", "decode", "--format", ""]), "text json");
}

#[test]
fn every_shell_is_told_every_command() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = stdout(&["completions", shell]);
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
    }
}

#[test]
fn every_command_has_a_manual_page_without_faults() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man/man1");
    assert_eq!(stdout(&["man", pages.to_str().unwrap()]), "");
    let names = commands().into_iter().filter(|name| name != "help");
    let names: Vec<_> = names.map(|name| format!("pnet-nat-{name}.1")).collect();
    assert!(names.len() >= 9 && pages.join("pnet-nat.1").exists(), "{names:?}");
    for name in &names {
        let page = fs::read_to_string(pages.join(name)).unwrap();
        assert!(page.contains("Example:") && page.contains(".SH OPTIONS"), "{page}");
    }
    let mut groff = Command::new("groff");
    groff.args(["-man", "-Tascii", "-P-c", "-ww"]).args(names.iter().map(|name| pages.join(name)));
    let Ok(output) = groff.output() else { return left_out("groff") };
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    let alone = |example: &str| text.lines().any(|line| line.trim() == example);
    assert!(alone("Example: pnet-nat demo --seconds 10"), "{text}");
    assert!(alone("pnet-nat status --watch --net section-1"), "{text}");
}

/// What a command writes to a terminal.
fn on_a_terminal(arguments: &[&str], no_color: &str) -> String {
    let mut terminal = Terminal::start(pnet_nat(arguments).env("NO_COLOR", no_color));
    assert_eq!(terminal.end(), Some(0));
    terminal.text()
}

#[test]
fn no_color_is_heeded_by_help_log_and_tables() {
    let demo = ["demo", "--seconds", "1", "--log-level", "info"];
    for arguments in [&["--help"][..], &demo] {
        let (usual, plain) = (on_a_terminal(arguments, ""), on_a_terminal(arguments, "1"));
        assert!(Terminal::has_colours(&usual), "{arguments:?}: {usual:?}");
        assert!(!Terminal::has_colours(&plain), "{arguments:?}: {plain:?}");
        assert!(plain.contains("pnet-nat"), "{plain:?}");
    }
}

/// As shells, Compose and Kubernetes write them.
#[test]
fn a_flag_in_the_environment_is_said_in_any_usual_way() {
    let site = Site::claim();
    let mut configuration = site.configuration(&Settings::default());
    configuration = configuration.replace("\"1-4\", 33", "\"1-125\"");
    let relay = Relay::start(&configuration, site.admin(), None);
    let url = format!("http://{}", site.admin());
    let config = relay.folder.path().join("pnet-nat.toml");
    let commands =
        [&["status", "--url", &url][..], &["check", "--config", config.to_str().unwrap()]];
    for arguments in commands {
        let lines = |full: &str| {
            let mut command = pnet_nat(arguments);
            command.env("PNET_NAT_FULL", full);
            let mut process = Process::start(command);
            assert_eq!(process.end(), Some(0), "{full}: {}", process.stderr());
            process.stdout().lines().count()
        };
        for (yes, no) in [("1", "0"), ("yes", "no"), ("true", "false"), ("on", "off")] {
            assert!(lines(yes) > 125, "{arguments:?}: {yes}");
            assert!(lines(no) < 100, "{arguments:?}: {no}");
        }
    }
    // It goes on to read its configuration, which is not there.
    for said in ["1", "0", "yes", "no"] {
        let mut command = pnet_nat(&["run", "--config", "/nowhere/pnet-nat.toml"]);
        command.env("PNET_NAT_NO_SANDBOX", said);
        let mut run = Process::start(command);
        assert_eq!(run.end(), Some(2));
        assert!(run.stderr().contains("/nowhere/pnet-nat.toml"), "{said}: {}", run.stderr());
    }
}

/// An output that nobody reads any more, as with `| head`, is no fault; one that cannot be written,
/// such as a file on a full disk, is one.
#[test]
fn an_output_that_is_closed_and_one_that_is_full() {
    let site = Site::claim();
    let relay = site.relay(Settings::default());
    let url = format!("http://{}", site.admin());
    let nobody = format!("http://{}/", site.address(4));
    let (config, hex) =
        (relay.folder.path().join("pnet-nat.toml"), relay.folder.path().join("hex"));
    fs::write(&hex, "00\n").unwrap();
    let (config, hex) = (config.to_str().unwrap(), hex.to_str().unwrap());
    let password = relay.folder.path().join("secrets/section-1");
    let password = password.to_str().unwrap();
    let (node, port) = (site.address(1).to_string(), site.start_port().to_string());
    let pid = relay.process.id().to_string();
    let request = ["request", "--to", &node, "--start-port", &port, "--node", "1"];
    let request = [&request[..], &["--password-file", password]].concat();
    // What it exits with when its output is closed: 0 unless its exit code tells more.
    for (arguments, closed) in [
        (&["check", "--config", config][..], 0),
        (&["completions", "bash"], 0),
        (&["decode", hex], 0),
        (&["decode", "--format", "json", hex], 0),
        (&["--help"], 0),
        (&["help", "run"], 0),
        (&["--version"], 0),
        (&["node", "--listen", &node, "--password-file", password], 0),
        (&["status", "--url", &url], 0),
        (&["status", "--url", &url, "--format", "json"], 0),
        (&["status", "--url", &url, "--watch"], 0),
        (&["reload", "--url", &url, "--pid", &pid], 0),
        (&["demo", "--seconds", "1"], 1),
        (&request, 1),
    ] {
        assert_eq!(
            written_to(nobody_reads(), arguments),
            (Some(closed), String::new()),
            "{arguments:?}"
        );
        let (code, said) = written_to(full(), arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {said}");
        let why = "cannot write to the standard output: No space left on device (os error 28)\n";
        assert!(said.starts_with("pnet-nat: ") && said.ends_with(why), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{arguments:?}: {said}");
    }

    // Whatever becomes of what they write, these say no to whoever asked.
    fs::write(config, "[public").unwrap();
    let reload = ["reload", "--url", &url, "--pid", &pid];
    for arguments in [&reload[..], &["healthcheck", "--url", &nobody]] {
        for output in [nobody_reads(), full()] {
            assert_eq!(written_to(output, arguments), (Some(1), String::new()), "{arguments:?}");
        }
    }
}

fn nobody_reads() -> Stdio {
    std::io::pipe().unwrap().1.into()
}

fn full() -> Stdio {
    fs::File::create("/dev/full").unwrap().into()
}

/// The exit code of a command that writes there, and what it says on stderr.
fn written_to(output: Stdio, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = pnet_nat(arguments);
    let mut child = command.stdout(output).stderr(Stdio::piped()).spawn().unwrap();
    drop(command);
    let ended = eventually("it ends", || child.try_wait().unwrap());
    let mut stderr = String::new();
    child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    (ended.code(), stderr)
}

/// Whoever collects the log of a relay gets JSON from its first line on, also when there is no more
/// to come; text where text is wanted.
#[test]
fn what_keeps_a_relay_from_starting_is_json_among_json() {
    let site = Site::claim();
    let sound = site.configuration(&Settings::default());
    let _taken = std::net::UdpSocket::bind(site.public(4)).unwrap();
    for (configuration, key, text) in [
        ("[public".to_owned(), "problem", "pnet-nat.toml:1: "),
        (
            sound.replace("[runtime]", "[runtime]\nuser = \"nobody-of-this-name\""),
            "message",
            "pnet-nat: ",
        ),
        (sound, "error", "pnet-nat: "),
    ] {
        let folder = folder(&configuration);
        let path = folder.path().join("pnet-nat.toml");
        let run = |format: &str| {
            let arguments = ["run", "--config", path.to_str().unwrap(), "--log-format", format];
            let mut process = Process::start(pnet_nat(&arguments));
            assert_ne!(process.end(), Some(0));
            process
        };
        for format in ["auto", "json"] {
            let lines: Vec<_> = run(format).log().collect();
            let told = |line: &serde_json::Value| line["level"] == "ERROR" && line[key].is_string();
            assert!(lines.iter().any(told), "{lines:?}");
        }
        let said = run("text").stderr();
        assert!(said.contains(text) && !said.contains('{'), "{said}");
    }
}

#[test]
fn a_level_that_would_say_no_more_is_not_offered() {
    for level in ["debug", "trace", "loud"] {
        let mut process = Process::start(pnet_nat(&["demo", "--log-level", level]));
        assert_eq!(process.end(), Some(2));
        let said = process.stderr();
        assert!(said.contains(level) && said.contains("error, warn, info"), "{said}");
    }
}

/// A name of a file comes from outside as well.
#[test]
fn no_complaint_does_anything_to_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let name = "\x1b]0;title\x07\u{9b}31m\u{202e}\rforged";
    let absent = folder.path().join(name).join("absent.toml");
    let bad = folder.path().join(name);
    fs::write(&bad, format!("\"{}\" = 1\n", "a\\u001b[2J\\nforged")).unwrap();
    let (absent, bad) = (absent.to_str().unwrap(), bad.to_str().unwrap());
    for arguments in [
        &["check", "--config", absent][..],
        &["check", "--config", bad],
        &["run", "--config", bad],
        &["--log-format", "text", "run", "--config", absent],
        &["--log-format", "json", "run", "--config", bad],
        &["decode", absent],
    ] {
        let mut process = Process::start(pnet_nat(arguments));
        assert_ne!(process.end(), Some(0), "{arguments:?}");
        let said = process.stdout() + &process.stderr();
        assert!(said.contains("forged"), "{arguments:?}: {said:?}");
        let is_harmful = |c: char| c != '\n' && (c.is_control() || c == '\u{202e}');
        assert!(
            !said.contains(is_harmful) && !said.contains("\nforged"),
            "{arguments:?}: {said:?}"
        );
    }
}
