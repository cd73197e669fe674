//! Shares a value between the halves of a board without ever waiting for its owner. A lock that
//! another lane holds is an answer like any other. Taking a free lock and giving it back is one
//! atomic exchange each and no call of the kernel, as nobody ever waits for it.

#[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
use std::sync::Mutex;
use std::sync::{Arc, TryLockError};

/// A value that several halves use, one at a time.
#[derive(Debug)]
#[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
pub(crate) struct Shared<T>(Arc<Mutex<T>>);

impl<T> Clone for Shared<T> {
    fn clone(&self) -> Shared<T> {
        Shared(Arc::clone(&self.0))
    }
}

impl<T> Shared<T> {
    #[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
    pub(crate) fn new(value: T) -> Shared<T> {
        Shared(Arc::new(Mutex::new(value)))
    }

    /// Uses the value now, or answers `None` when another thread is using it. A thread that
    /// panicked while it had the value leaves it usable: every use starts from a whole exchange.
    pub(crate) fn try_use<R>(&self, action: impl FnOnce(&mut T) -> R) -> Option<R> {
        match self.0.try_lock() {
            Ok(mut value) => Some(action(&mut value)),
            Err(TryLockError::Poisoned(value)) => Some(action(&mut value.into_inner())),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_in_use_is_not_waited_for() {
        let shared = Shared::new(1);
        let other = shared.clone();
        let inner = shared.try_use(|value| {
            *value += 1;
            other.try_use(|value| *value)
        });
        assert_eq!(inner, Some(None));
        assert_eq!(other.try_use(|value| *value), Some(2));
    }

    #[test]
    fn a_panic_of_the_owner_leaves_the_value_usable() {
        let shared = Shared::new(1);
        let other = shared.clone();
        let thread = std::thread::spawn(move || other.try_use(|_| panic!("on purpose")));
        assert!(thread.join().is_err());
        assert_eq!(shared.try_use(|value| *value), Some(1));
    }
}
