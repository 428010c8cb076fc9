//! The allocator's memory.

/// `mi_option_purge_delay` of mimalloc.h: milliseconds until unused pages go back, -1 for never.
const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;

/// The allocator gives unused pages back to the system after a moment, and gets them again, cleared, for the next step's
/// tensors: from 100 000 particles on that took a quarter to a half of a gradient. From now on it keeps them. To be called
/// before there is a thread that allocates by it.
pub fn keep_freed() {
    // SAFETY: sets a number of the allocator's; not thread safe, and there is no other thread that uses it yet.
    unsafe { libmimalloc_sys::mi_option_set(PURGE_DELAY, -1) }
}

/// From now on the allocator gives unused pages back again. Where tables are large and of different sizes it finds no use for what is freed:
/// a flow with sound of 10^6 particles in space took 10.9 GB instead of 8.9, for it kept the room of the matrix of its first steps.
pub fn give_back_freed() {
    // SAFETY: sets one number of the allocator's, which other threads only read when they free something.
    unsafe { libmimalloc_sys::mi_option_set(PURGE_DELAY, 10) }
}
