//! The commands of the pages, run as they are written, each page on a machine of its own (machine.sh).

use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::{env, fs, thread};

use crate::page::{self, Page};

/// Beside those of every Linux machine; `.ci/run` installs them.
const TOOLS: [&str; 9] =
    ["unshare", "nsenter", "ip", "nft", "ufw", "conntrack", "curl", "promtool", "man"];

/// Pages whose commands other tests run.
const ELSEWHERE: [&str; 2] = ["deploy", "benches"];

#[test]
fn every_command_works_as_it_is_written() {
    let wanted = env::var("PNET_NAT_TESTS").unwrap_or_default();
    let missing: Vec<_> = TOOLS.into_iter().filter(|tool| !is_there(tool)).collect();
    if !missing.is_empty() || !has_namespaces() {
        assert!(
            !["all", "nightly"].contains(&&wanted[..]),
            "there is a want of root, or of {missing:?}"
        );
        return println!("left out: it needs root and {missing:?}");
    }
    let pages = page::all();
    let mine = |page: &&Page| !ELSEWHERE.iter().any(|folder| page.path.starts_with(folder));
    let faults: Vec<_> = thread::scope(|scope| {
        let running: Vec<_> =
            pages.iter().filter(mine).map(|page| scope.spawn(|| run(page))).collect();
        running.into_iter().filter_map(|page| page.join().unwrap()).collect()
    });
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
}

/// A reason is a sentence for people, and stands above a command alone.
#[test]
fn what_is_not_run_says_why() {
    for page in page::all() {
        let text = fs::read_to_string(&page.path).unwrap();
        let marks =
            text.lines().filter(|line| line.trim_start().starts_with("<!-- not run")).count();
        let blocks = page.blocks.iter().filter(|block| block.language == "sh");
        let reasons: Vec<_> = blocks.filter_map(|block| block.not_run()).collect();
        assert_eq!(
            reasons.len(),
            marks,
            "{}: a mark is not right above a block",
            page.path.display()
        );
        assert!(reasons.iter().all(|reason| reason.split(' ').count() > 2), "{reasons:?}");
    }
}

/// What went wrong, if anything did.
fn run(page: &Page) -> Option<String> {
    let script = script(page)?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("page.sh");
    fs::write(&path, &script).unwrap();
    let machine = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/docs/machine.sh");
    let mut command = Command::new("timeout");
    command.args(["--signal", "KILL", "120", "unshare", "--net", "--mount", "--pid", "--fork"]);
    command
        .args(["--kill-child", "--mount-proc", "bash", machine])
        .arg(folder.path())
        .arg(&page.path);
    let program = Path::new(env!("CARGO_BIN_EXE_pnet-nat")).parent().unwrap();
    command.arg(program).env_remove("PNET_NAT_TESTS");
    let output = command.output().unwrap();
    let [stdout, stderr] =
        [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    let name = page.path.display();
    (!output.status.success()).then(|| format!("── {name}: {}\n{stdout}\n{stderr}", output.status))
}

/// What the page has its reader do: commands, and files that it has its reader write; none when there is
/// nothing to do.
fn script(page: &Page) -> Option<String> {
    let mut script = String::new();
    for block in &page.blocks {
        let words = block.above.split_once("Save this as `").map(|(_, rest)| (">", rest));
        let words = words.or(block.above.split_once("dd this to `").map(|(_, rest)| (">>", rest)));
        let name = page.path.display();
        if block.language == "sh" && block.not_run().is_none() {
            let (line, text) = (block.line, &block.text);
            writeln!(script, "settle\necho '== {name}:{line}' >&2\n{text}").unwrap();
        } else if let (false, Some((how, rest))) = (block.language == "sh", words) {
            let (path, _) = rest.split_once('`').unwrap();
            writeln!(script, "cat {how} {path} <<'END OF FILE'\n{}END OF FILE", block.text)
                .unwrap();
        }
    }
    script.contains("settle").then_some(script)
}

fn is_there(tool: &str) -> bool {
    let folders = env::var("PATH").unwrap();
    let mut folders = env::split_paths(&folders).chain(["/usr/sbin".into(), "/sbin".into()]);
    folders.any(|folder: std::path::PathBuf| folder.join(tool).exists())
}

fn has_namespaces() -> bool {
    let tried =
        Command::new("unshare").args(["--net", "--mount", "--pid", "--fork", "true"]).output();
    tried.is_ok_and(|tried| tried.status.success())
}
