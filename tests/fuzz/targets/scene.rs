//! Scenes: any text is a configuration or one error.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = place::file("scene.toml", bytes);
    if let Err(error) = hydrograd::config::scene::Config::load(Some(&path.to_string_lossy()), None, &[]) {
        place::is_message(&error.to_string());
    }
});
