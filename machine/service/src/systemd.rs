//! Tells systemd how the service is: ready, watchdog, status, stopping. A thread of its own does,
//! because a systemd that does not read would block whoever writes; the thread of the lanes'
//! records only leaves a message.

use sd_notify::NotifyState;
use taktil_machine_console::background::BackgroundQueue;
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
pub(crate) type SystemdNotifier = BackgroundQueue<SystemdMessage>;

/// Starts the thread.
///
/// # Errors
/// The operating system gives no thread.
pub(crate) fn start_notifier() -> std::io::Result<SystemdNotifier> {
    let mut is_told = false;
    BackgroundQueue::start("notify", MESSAGES_MAX, move |message, _| {
        // Without systemd nobody receives them, which is no error.
        if let Err(error) = send(&message)
            && !std::mem::replace(&mut is_told, true)
        {
            out::warn(format_args!("systemd could not be told: {error}"));
        }
    })
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
