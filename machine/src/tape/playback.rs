//! The entries of one tape in the order of their releases, and the note of the first that is asked
//! for and missing.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};

use taktil_hal::{Error, ErrorKind, Nanos};

/// Entries with their releases.
pub(super) type Entries<E> = VecDeque<(Nanos, E)>;

/// The first answer that was requested and is on no tape.
#[derive(Clone, Debug, Default)]
pub struct MissingEntry(Arc<OnceLock<(&'static str, Nanos)>>);

impl MissingEntry {
    fn note(&self, device: &'static str, release: Nanos) {
        // Only the first missing entry is kept.
        let _ = self.0.set((device, release));
    }

    /// Device and release of the missing entry, if there is one.
    #[must_use]
    pub fn first(&self) -> Option<(&'static str, Nanos)> {
        self.0.get().copied()
    }
}

/// A device half that reads a tape.
pub(super) struct Player<E> {
    entries: Entries<E>,
    pub(super) device: &'static str,
    missing: MissingEntry,
}

/// A half that reads these entries.
pub(super) fn player<E>(
    entries: Entries<E>,
    device: &'static str,
    missing: MissingEntry,
) -> Player<E> {
    Player { entries, device, missing }
}

impl<E> Player<E> {
    /// The entry for this release.
    pub(super) fn next(&mut self, release: Nanos) -> Result<E, Error> {
        let here = self.entries.front().is_some_and(|entry| entry.0 == release);
        match here.then(|| self.entries.pop_front()).flatten() {
            Some((_, entry)) => Ok(entry),
            None => {
                self.missing.note(self.device, release);
                Err(Error::whole(ErrorKind::Lost, self.device))
            }
        }
    }
}
