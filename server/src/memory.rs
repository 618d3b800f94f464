//! Memory that was given up goes back to the system.

/// Gives pages that hold nothing any more back to the system.
///
/// What a session frees lies between what others hold, and glibc's allocator keeps it unless it is asked, for
/// a few milliseconds of work (figures: docs/operations.md, "Memory"). Elsewhere the allocator does as it
/// likes.
pub fn give_back() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: may be called at any time, from any thread.
        unsafe { libc::malloc_trim(0) };
    }
}
