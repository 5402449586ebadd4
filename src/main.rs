//! `pnet-nat`: parses the command line and does what it says.

use std::process::ExitCode;

fn main() -> ExitCode {
    pnet_nat::cli::main()
}
