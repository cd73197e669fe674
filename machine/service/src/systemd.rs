//! Tells systemd how the service is: ready, watchdog, status, stopping. A thread of its own does,
//! because a systemd that does not read would block whoever writes; the thread of the lanes' records
//! only leaves a message.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

use sd_notify::NotifyState;
use taktil_machine_console::out;

/// Messages that wait for systemd; those beyond are dropped.
const MESSAGES_MAX: usize = 16;

/// A message to systemd.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SystemdMessage {
    /// The service is ready, with its status.
    Ready(String),
    /// The status in words.
    Status(String),
    /// The lanes are alive.
    Watchdog,
    /// The service is about to end, with its status.
    Stopping(String),
}

/// The way to systemd.
pub(crate) struct SystemdNotifier {
    messages: SyncSender<SystemdMessage>,
    waiting: Arc<AtomicUsize>,
}

impl SystemdNotifier {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub(crate) fn start() -> std::io::Result<SystemdNotifier> {
        let (messages, receiver) = sync_channel::<SystemdMessage>(MESSAGES_MAX);
        let waiting = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&waiting);
        std::thread::Builder::new().name("notify".into()).spawn(move || {
            let mut is_told = false;
            for message in receiver {
                // Without systemd nobody receives them, which is no error.
                if let Err(error) = send(&message)
                    && !std::mem::replace(&mut is_told, true)
                {
                    out::warn(format_args!("systemd could not be told: {error}"));
                }
                counted.fetch_sub(1, Ordering::SeqCst);
            }
        })?;
        Ok(SystemdNotifier { messages, waiting })
    }

    /// Leaves a message; it is dropped when systemd has not read those before it.
    pub(crate) fn send(&self, message: SystemdMessage) {
        self.waiting.fetch_add(1, Ordering::SeqCst);
        if self.messages.try_send(message).is_err() {
            self.waiting.fetch_sub(1, Ordering::SeqCst);
        }
    }

    /// Waits until all messages are read, for `patience` at most.
    pub(crate) fn flush(&self, patience: Duration) {
        let begin = Instant::now();
        while self.waiting.load(Ordering::SeqCst) > 0 && begin.elapsed() < patience {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn send(message: &SystemdMessage) -> std::io::Result<()> {
    match message {
        SystemdMessage::Ready(status) => {
            sd_notify::notify(&[NotifyState::Ready, NotifyState::Status(status)])
        }
        SystemdMessage::Status(status) => sd_notify::notify(&[NotifyState::Status(status)]),
        SystemdMessage::Watchdog => sd_notify::notify(&[NotifyState::Watchdog]),
        SystemdMessage::Stopping(status) => {
            sd_notify::notify(&[NotifyState::Stopping, NotifyState::Status(status)])
        }
    }
}
