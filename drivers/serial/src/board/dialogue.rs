//! A dialogue of steps: each has a request, which is repeated, and a deadline.

use taktil_hal::Nanos;

use super::{Phase, StartError};

/// Where a dialogue over steps `S` stands.
#[derive(Clone, Debug)]
pub(crate) struct Dialogue<S> {
    pub(crate) step: S,
    pub(crate) phase: Phase,
    /// When the step began; `None` until its first request went out.
    begun: Option<Nanos>,
    /// When the request was sent last.
    sent: Nanos,
    /// When the whole dialogue has failed.
    deadline: Nanos,
    timeout: Nanos,
}

impl<S: Copy> Dialogue<S> {
    pub(crate) fn new(first: S, timeout: Nanos) -> Dialogue<S> {
        Dialogue {
            step: first,
            phase: Phase::Starting,
            begun: None,
            sent: Nanos::ZERO,
            deadline: Nanos::MAX,
            timeout,
        }
    }

    pub(crate) fn restart(&mut self, first: S, now: Nanos) {
        *self = Dialogue::new(first, self.timeout);
        self.deadline = now + self.timeout;
    }

    pub(crate) fn enter(&mut self, step: S) {
        self.step = step;
        self.begun = None;
    }

    /// Enters a step whose request counts as sent just now.
    pub(crate) fn wait(&mut self, step: S, now: Nanos) {
        self.step = step;
        self.begun = Some(now);
        self.sent = now;
    }

    pub(crate) fn fail(&mut self, error: StartError) {
        self.phase = Phase::Failed(error);
    }

    /// Whether the request of this step is due: the first time, and again `pause` after the last.
    pub(crate) fn is_due(&mut self, now: Nanos, pause: Nanos) -> bool {
        let due = self.begun.is_none() || now - self.sent >= pause;
        if due {
            self.begun.get_or_insert(now);
            self.sent = now;
        }
        due
    }

    /// How long this step has gone on.
    pub(crate) fn elapsed(&self, now: Nanos) -> Nanos {
        self.begun.map_or(Nanos::ZERO, |begun| now - begun)
    }

    /// Whether the whole dialogue has taken too long.
    pub(crate) fn is_late(&self, now: Nanos) -> bool {
        now >= self.deadline
    }
}
