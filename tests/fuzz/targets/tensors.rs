//! Checkpoints as safetensors: tensors, or one error.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Err(error) = hydrograd::io::tensor_file::TensorFile::parse("fuzzed.safetensors".as_ref(), bytes) {
        place::is_message(&error.to_string());
    }
});
