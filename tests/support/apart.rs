//! Tests in processes of their own, for what changes or measures something of the whole process.

use std::process::Command;

/// Set in such a process.
const APART: &str = "HYDROGRAD_TEST_APART";

/// Whether this is a process for the test with this path (such as `all::adjoint::peak_memory_is_as_predicted::here`) alone. If not, the test
/// is run in one, and fails if it fails there.
pub fn is_apart(path: &str) -> bool {
    if std::env::var_os(APART).is_some() {
        return true;
    }
    let name = path.split("::").skip(1).take_while(|&part| part != "here").collect::<Vec<_>>().join("::");
    let mut command = Command::new(std::env::current_exe().unwrap());
    let output = command.args([&name, "--exact", "--nocapture", "--test-threads=1"]).env(APART, "1").output().unwrap();
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    println!("{said}");
    assert!(
        output.status.success() && said.contains("test result: ok. 1 passed"),
        "{name} fails in a process of its own"
    );
    false
}

/// Goes on with a test in a process of its own.
#[macro_export]
macro_rules! in_a_process_of_its_own {
    () => {
        fn here() {}
        if !$crate::support::apart::is_apart(std::any::type_name_of_val(&here)) {
            return;
        }
    };
}
