#![no_main]

libfuzzer_sys::fuzz_target!(|octets: &[u8]| pnet_nat::datapath::offload_holds(octets));
