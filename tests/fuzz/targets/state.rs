//! Final states in HDF5.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    match hydrograd::io::state_file::read_state(&place::file("state.h5", bytes), &["position", "velocity"]) {
        Ok(state) => drop(state.count()),
        Err(error) => place::is_message(&error.to_string()),
    }
});
