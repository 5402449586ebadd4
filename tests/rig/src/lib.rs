//! What several tests, benchmarks and fuzz targets share. It is compiled once for all of them.

#[cfg(feature = "scenarios")]
pub mod harness;
pub mod isolated_core;
pub mod targets;
