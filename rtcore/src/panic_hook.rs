//! Panics inside jobs: caught by the lane, and silent there. The process's panic hook would format,
//! lock and print on the lane's thread; the hook installed here only keeps the place of a panic
//! inside a job. Outside jobs the process's hook runs as before.
//!
//! A hook cannot avoid all heap calls: the standard library makes the panic's text before it calls
//! the hook (the payload that the hook gets is that text), and allocates the payload and the
//! exception afterwards. `panic_any` costs 2 heap calls, a panic with a fixed text 3, one with a
//! text that is put together, such as an index out of bounds, 5; `unwrap` on an `Err` puts `Debug`
//! of the error into it, so that code of the task's author runs there, for an unbounded time. This
//! happens once: the task is taken out of its lane. `tests/live.rs` holds the counts.

use core::cell::Cell;
use std::panic::PanicHookInfo;
use std::sync::Once;

use crate::guard;

/// Characters of a file's path that are kept.
const PATH_BYTES: usize = 120;

/// Where a job panicked: the end of the file's path, and the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PanicSite {
    path: [u8; PATH_BYTES],
    length: usize,
    line: u32,
}

impl core::fmt::Display for PanicSite {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let path = String::from_utf8_lossy(&self.path[..self.length]);
        write!(f, "{path}:{}", self.line)
    }
}

thread_local! {
    static FIRST_SITE: Cell<Option<PanicSite>> = const { Cell::new(None) };
}

static INSTALL_ONCE: Once = Once::new();

/// Installs the hook in front of the process's; a second call does nothing.
pub(crate) fn install() {
    INSTALL_ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if guard::in_job() {
                store_site(info);
            } else {
                before(info);
            }
        }));
    });
}

/// Unwinds once on this thread, outside jobs: what unwinding needs is then found and in memory.
pub(crate) fn warm_up_unwinding() {
    let _ = std::panic::catch_unwind(|| std::panic::resume_unwind(Box::new(())));
}

/// The place of the first panic inside a job of this thread since the last call.
pub(crate) fn take_first_site() -> Option<PanicSite> {
    FIRST_SITE.with(Cell::take)
}

fn store_site(info: &PanicHookInfo<'_>) {
    let Some(location) = info.location() else { return };
    let _ = FIRST_SITE.try_with(|first| {
        if first.get().is_none() {
            first.set(Some(site(location.file().as_bytes(), location.line())));
        }
    });
}

fn site(file: &[u8], line: u32) -> PanicSite {
    let tail = &file[file.len().saturating_sub(PATH_BYTES)..];
    let mut path = [0; PATH_BYTES];
    path[..tail.len()].copy_from_slice(tail);
    PanicSite { path, length: tail.len(), line }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_path_keeps_its_end() {
        assert_eq!(site(b"a/b.rs", 7).to_string(), "a/b.rs:7");
        assert_eq!(site(b"", 0).to_string(), ":0");
        let long = format!("{}/end.rs", "x".repeat(500));
        let text = site(long.as_bytes(), u32::MAX).to_string();
        assert!(text.ends_with("x/end.rs:4294967295"), "{text}");
        assert_eq!(text.len(), PATH_BYTES + ":4294967295".len());
    }
}
