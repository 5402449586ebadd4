//! PROFINET peers that run as processes: the scripts of `tests/profinet`, on profinet-py and scapy.

use std::path::Path;
use std::process::Command;

use super::left_out;

/// Where `.ci/run` installs what the scripts need.
const PYTHON: &str = "target/profinet-peers/bin/python";

/// Whether the scripts can run. Says so if they cannot.
pub fn has_profinet_peers() -> bool {
    let has = Path::new(PYTHON).exists();
    if !has {
        left_out(&format!("profinet-py and scapy, of PyPI, for {PYTHON}"));
    }
    has
}

/// A script with its arguments, separated by blanks.
pub fn profinet_peer(script: &str, arguments: &str) -> Command {
    let mut command = Command::new(PYTHON);
    command.arg(format!("tests/profinet/{script}.py")).args(arguments.split_whitespace());
    command
}
