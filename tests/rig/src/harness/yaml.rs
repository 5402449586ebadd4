//! Reads YAML with the parser that comes with kubernetes-validate.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

use super::left_out;

/// The folder where `.ci/run` installs the validator, which comes with schemas and a parser.
pub const TOOLS: &str = "target/kubernetes-validate/bin";

/// Whether the validator is installed. Says so if it is not.
pub fn has_yaml() -> bool {
    let has = Path::new(TOOLS).exists();
    if !has {
        left_out(&format!("kubernetes-validate, of PyPI, in {TOOLS}"));
    }
    has
}

/// The documents of a YAML text.
#[track_caller]
pub fn yaml(text: &str) -> Vec<Value> {
    let mut python = Command::new(format!("{TOOLS}/python"));
    python.args([
        "-c",
        "import json, sys, yaml; json.dump([*yaml.safe_load_all(sys.stdin)], sys.stdout)",
    ]);
    let output = feed(&mut python, text);
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Runs a command with this on its standard input.
pub fn feed(command: &mut Command, input: &str) -> Output {
    let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}
