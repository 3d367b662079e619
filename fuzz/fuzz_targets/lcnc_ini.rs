#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::files::lcnc_ini(data));
