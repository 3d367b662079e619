#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::files::board_toml(data));
