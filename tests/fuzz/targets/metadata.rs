//! Metadata of data sets, ours and LagrangeBench's.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = place::file("metadata.json", bytes);
    match hydrograd::dataset::Metadata::read(path.parent().unwrap()) {
        // What is accepted can be asked for everything.
        Ok(metadata) => drop((metadata.origin(), metadata.size(), metadata.domain(), metadata.periodic())),
        Err(error) => place::is_message(&error.to_string()),
    }
});
