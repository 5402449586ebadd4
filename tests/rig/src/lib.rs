//! What several tests and benchmarks share. It is compiled once for all of them.

pub mod isolated_core;
