//! `pnet-nat`: parses the command line and does what it says.

use std::process::ExitCode;

use pnet_nat::datapath::LargeBlocksApart;

#[global_allocator]
static ALLOCATOR: LargeBlocksApart = LargeBlocksApart;

fn main() -> ExitCode {
    pnet_nat::cli::main()
}
