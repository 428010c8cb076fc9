//! Peak memory of this process, from Linux's /proc.

/// Largest resident memory so far, in bytes (`VmHWM`); 0 where the system does not tell.
pub fn peak_memory_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").ok().and_then(|status| peak_from_status(&status)).unwrap_or(0)
}

/// Starts the peak anew from the present use. Best effort: does nothing where the system does not allow it.
pub fn reset_peak_memory() {
    // 5 resets VmHWM, see proc_pid_clear_refs(5).
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// The line `VmHWM:     1234 kB`, in bytes.
pub fn peak_from_status(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
