//! Learned models: their header sets sizes before anything is allocated.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = place::file("model.safetensors", bytes);
    let fused = hydrograd::config::scene::Kernels::Fused;
    if let Err(error) = hydrograd::surrogate::load_learned(&path, fused, candle_core::DType::F32) {
        place::is_message(&error.to_string());
    }
});
