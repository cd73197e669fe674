//! Sends messages of the service to systemd: ready, watchdog, status, stopping.

use sd_notify::NotifyState;
use taktil_machine_console::out;

/// Sends states to systemd. Without systemd nobody receives them, which is no error.
pub(crate) fn notify_systemd(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        out::warn(format_args!("systemd could not be told: {error}"));
    }
}
