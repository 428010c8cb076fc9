//! Where a target puts what it is given, for readers that open files themselves.

use std::path::PathBuf;

/// The bytes as a file of this name, in memory, one per process.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let folder = PathBuf::from(format!("/dev/shm/hydrograd-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// A message as it is shown is short enough to be read, and has no control characters but for the ends of its lines.
pub fn is_message(text: &str) {
    let text = hydrograd::cli::shown(text);
    assert!(!text.is_empty() && text.len() < 20_000, "{} bytes: {text}", text.len());
    assert!(text.chars().all(|c| c == '\n' || !c.is_control()), "{text:?}");
}
