#![no_main]

mod reads_or_errs;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| reads_or_errs::reads_or_errs("dataflash", bytes));
