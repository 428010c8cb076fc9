//! Tables of walls: columns of finite numbers, or one error.
#![no_main]

mod place;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    match hydrograd::io::csv::read_columns(&place::file("wall.csv", bytes), &["x", "offset"]) {
        Ok(columns) => assert!(columns.len() == 2 && columns.iter().flatten().all(|number| number.is_finite())),
        Err(error) => place::is_message(&error.to_string()),
    }
});
