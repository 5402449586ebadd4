#![no_main]

libfuzzer_sys::fuzz_target!(|octets: &[u8]| pnet_nat_rig::targets::profinet::holds(octets));
