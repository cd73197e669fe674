//! A thread that does work which may wait for others, such as writing to a pipe, for threads that
//! may not. Work that finds no room is dropped and counted.
#![expect(clippy::disallowed_types, reason = "the thread behind the queue is there to wait")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use taktil_rtcore::{Nanos, linux};

/// The way to the thread.
#[derive(Debug)]
pub struct BackgroundQueue<T> {
    items: SyncSender<T>,
    waiting: Arc<AtomicUsize>,
    dropped: Arc<AtomicU64>,
}

impl<T: Send + 'static> BackgroundQueue<T> {
    /// Starts a thread of this name that calls `work` with every item, and with how many were
    /// dropped since the last one. At most `capacity` items wait.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn start(
        name: &str,
        capacity: usize,
        mut work: impl FnMut(T, u64) + Send + 'static,
    ) -> std::io::Result<BackgroundQueue<T>> {
        let (items, receiver) = sync_channel::<T>(capacity);
        let (waiting, dropped) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicU64::new(0)));
        let (counted, lost) = (Arc::clone(&waiting), Arc::clone(&dropped));
        std::thread::Builder::new().name(name.into()).spawn(move || {
            for item in receiver {
                work(item, lost.swap(0, Ordering::SeqCst));
                counted.fetch_sub(1, Ordering::SeqCst);
            }
        })?;
        Ok(BackgroundQueue { items, waiting, dropped })
    }

    /// Leaves an item, without waiting; it is dropped when those before it take too long.
    pub fn send(&self, item: T) {
        self.waiting.fetch_add(1, Ordering::SeqCst);
        if self.items.try_send(item).is_err() {
            self.waiting.fetch_sub(1, Ordering::SeqCst);
            self.dropped.fetch_add(1, Ordering::SeqCst);
        }
    }

    /// Waits until everything is done, for `patience` at most.
    pub fn flush(&self, patience: Nanos) {
        let begin = linux::monotonic();
        while self.waiting.load(Ordering::SeqCst) > 0 && linux::monotonic() - begin < patience {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;

    #[test]
    fn a_thread_that_waits_holds_nobody_up_and_what_it_missed_is_counted() {
        let go = Arc::new(AtomicBool::new(false));
        let seen = Arc::new(AtomicU64::new(0));
        let (wait, all) = (Arc::clone(&go), Arc::clone(&seen));
        let queue = BackgroundQueue::start("background", 4, move |item: u64, dropped| {
            while !wait.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(1));
            }
            all.fetch_add(item + 1000 * dropped, Ordering::SeqCst);
        });
        let queue = queue.unwrap();
        for _ in 0..100 {
            queue.send(1);
        }
        queue.flush(Nanos::from_millis(20));
        assert_eq!(seen.load(Ordering::SeqCst), 0, "it has waited in vain, and gone on");
        go.store(true, Ordering::SeqCst);
        queue.flush(Nanos::from_secs(60));
        queue.send(1);
        queue.flush(Nanos::from_secs(60));
        let seen = seen.load(Ordering::SeqCst);
        assert_eq!(seen % 1000 + seen / 1000, 101, "each is done or counted: {seen}");
        assert!(seen / 1000 >= 90);
    }
}
