//! The allocator's memory.

/// The allocator gives unused pages back to the system after a moment, and gets them again, cleared, for the next step's
/// tensors: from 100 000 particles on that took a quarter to a half of a gradient. From now on it keeps them. To be called
/// before there is a thread that allocates by it.
pub fn keep_freed() {
    /// `mi_option_purge_delay` of mimalloc.h; milliseconds, -1 for never.
    const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;
    // SAFETY: sets a number of the allocator's; not thread safe, and there is no other thread that uses it yet.
    unsafe { libmimalloc_sys::mi_option_set(PURGE_DELAY, -1) }
}
