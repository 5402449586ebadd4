//! `config/pnet-nat.schema.json`, as an editor applies it: each configuration in the repository is right, and
//! what the reader refuses for its kind is wrong. That it has the reader's keys, `config::tests::schema` shows.
//!
//! Needs kubernetes-validate, whose Python has a validator.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;

use crate::harness::{ANNOTATED, TOOLS, feed, has_yaml};

const SCHEMA: &str = include_str!("../../config/pnet-nat.schema.json");

/// Answers a list of texts with what is wrong with each.
const JUDGE: &str = "
import json, sys, tomllib, jsonschema
schema, texts = json.load(sys.stdin)
kind = jsonschema.validators.validator_for(schema)
kind.check_schema(schema)
judge = lambda text: [fault.json_path + ': ' + fault.message for fault in kind(schema).iter_errors(tomllib.loads(text))]
json.dump([judge(text) for text in texts], sys.stdout)
";

/// What is wrong with each text.
fn judged(texts: &[String]) -> Vec<Vec<String>> {
    let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
    let mut python = Command::new(format!("{TOOLS}/python"));
    let output = feed(python.args(["-c", JUDGE]), &json!([schema, texts]).to_string());
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The annotated configuration with all its keys.
fn switched_on() -> String {
    let line = |line: &'static str| match line.trim_start().strip_prefix('#') {
        Some(key) if key.starts_with(|c: char| c.is_ascii_lowercase() || c == '[') => key,
        _ => line,
    };
    ANNOTATED.lines().map(line).collect::<Vec<_>>().join("\n")
}

#[test]
fn each_configuration_in_the_repository_is_right() {
    if !has_yaml() {
        return;
    }
    let mut named = vec![("switched on".to_owned(), switched_on())];
    let mut files = vec![PathBuf::from("config/pnet-nat.toml")];
    let folders = fs::read_dir("deploy").unwrap().map(|entry| entry.unwrap().path());
    files.extend(folders.map(|folder| folder.join("pnet-nat.toml")).filter(|file| file.exists()));
    assert!(files.len() >= 4, "{files:?}");
    named.extend(files.iter().map(|file| (file.display().to_string(), text(file))));
    let pages = fs::read_dir("docs").unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    for page in pages.chain([PathBuf::from("README.md")]) {
        let text = text(&page);
        let blocks = text.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next());
        // Others are parts of a configuration, or an IPNetTable.
        let whole = blocks.filter(|block| block.contains("[public]"));
        named.extend(whole.map(|block| (page.display().to_string(), block.to_owned())));
    }
    assert!(named.len() > files.len() + 1, "README.md has one");
    let texts: Vec<_> = named.iter().map(|(_, text)| text.clone()).collect();
    for ((name, _), faults) in named.iter().zip(judged(&texts)) {
        assert_eq!(faults, [""; 0], "{name}");
    }
}

fn text(file: &Path) -> String {
    fs::read_to_string(file).unwrap()
}

#[test]
fn what_is_of_another_kind_is_wrong() {
    if !has_yaml() {
        return;
    }
    let cases = [
        ("server_port = 34379", "sever_port = 34379", "sever_port"),
        ("subnet = \"172.17.17.0\"\n", "", "'subnet' is a required property"),
        ("server_port = 34379", "server_port = 65536", "greater than the maximum of 65535"),
        ("node = 7", "node = 0", "less than the minimum of 1"),
        ("node = 7", "node = \"7\"", "is not of type 'integer'"),
        ("nodes = [\"1-4\", 33]", "nodes = [\"1-4\", 126]", "126 is not valid"),
        ("nodes = [\"1-4\", 33]", "nodes = []", "[]"),
        ("prefilter = \"auto\"", "prefilter = \"on\"", "'on' is not one of"),
        ("kernel = \"auto\"", "kernel = \"always\"", "'always' is not one of"),
        ("idle_timeout = \"5m\"", "idle_timeout = 300", "is not of type 'string'"),
        ("enabled = true", "enabled = \"yes\"", "is not of type 'boolean'"),
        ("[[server]]", "[server]", "is not of type 'array'"),
        ("[[udp_range_net.password]]", "[[udp_range_net.passwords]]", "passwords"),
    ];
    let sound = switched_on();
    let changed = cases.map(|(from, to, _)| {
        assert!(sound.contains(from), "{from}");
        sound.replacen(from, to, 1)
    });
    for ((_, to, part), faults) in cases.iter().zip(judged(&changed)) {
        let is_told = faults.iter().any(|fault| fault.contains(part));
        assert!(is_told && faults.len() == 1, "{to}: {faults:?}");
    }
}
