//! The line between a board and its host: a plan of faults acts on messages, then they wait for
//! their transfer time. Messages of one line cannot overtake each other, so reordering is refused.

use std::collections::VecDeque;

use taktil_hal::fault::{FaultCounts, FaultKind, FaultPlan, SplitMix};
use taktil_hal::{Invalid, Nanos};

use crate::Board;

/// Scans that one call completes at most; a host that slept longer loses the rest.
const SCANS_A_CALL_MAX: usize = 10_000;

/// What passed over a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes that came from the host, those lost to a fault included.
    pub bytes_in: u64,
    /// Scans that were completed.
    pub scans: u64,
    /// Messages that arrived at the host.
    pub messages: u64,
    /// Messages and scans that faults befell.
    pub faults: FaultCounts,
}

/// A board behind a line with faults.
pub struct Line {
    board: Box<dyn Board>,
    name: String,
    plan: FaultPlan,
    random: SplitMix,
    /// Messages on their way and when their last byte is at the host.
    waiting: VecDeque<(Nanos, Vec<u8>)>,
    image: Vec<u16>,
    was_down: bool,
    restarts: usize,
    /// The newest instant at which the plan was looked at.
    looked: Nanos,
    traffic: Traffic,
}

/// The kinds of faults that a line executes: all but one message overtaking another.
pub const EXECUTED_FAULTS: [FaultKind; 9] = [
    FaultKind::Loss,
    FaultKind::Duplication,
    FaultKind::Delay,
    FaultKind::Corruption,
    FaultKind::Truncation,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
];

impl Line {
    /// A line to `board`, which the plan calls `name`; `seed` decides which messages are hit.
    ///
    /// # Errors
    /// The plan names a fault that a serial line cannot have.
    pub fn new(
        board: Box<dyn Board>,
        name: &str,
        plan: FaultPlan,
        seed: u64,
    ) -> Result<Line, Invalid> {
        plan.check_kinds(name, &EXECUTED_FAULTS)?;
        let image = vec![0; board.tactels()];
        Ok(Line {
            board,
            name: name.to_owned(),
            plan,
            random: SplitMix::new(seed),
            waiting: VecDeque::new(),
            image,
            was_down: false,
            restarts: 0,
            looked: Nanos(i64::MIN),
            traffic: Traffic::default(),
        })
    }

    /// Whether the cable is plugged in at `now`.
    #[must_use]
    pub fn is_plugged(&self, now: Nanos) -> bool {
        self.strength(FaultKind::Unplugged, now).is_none()
    }

    /// The next instant at which [`Line::poll`] may have something.
    #[must_use]
    pub fn next_due(&self) -> Nanos {
        let message = self.waiting.front().map_or(Nanos::MAX, |(at, _)| *at);
        message.min(self.board.scan_due()).min(self.board.greet_due()).min(self.next_change())
    }

    /// The next instant at which the plan takes the board's power away or gives it back.
    fn next_change(&self) -> Nanos {
        let mine = |target: &str| target.is_empty() || target == self.name;
        let changes = self.plan.faults().iter().filter(|fault| mine(&fault.target));
        let instants = changes.flat_map(|fault| {
            let end = Nanos(fault.at.0.saturating_add(fault.duration.0));
            match fault.kind {
                FaultKind::Unplugged => [fault.at, end],
                FaultKind::Restart => [fault.at; 2],
                _ => [Nanos::MAX; 2],
            }
        });
        instants.filter(|instant| *instant > self.looked).min().unwrap_or(Nanos::MAX)
    }

    /// Hands bytes of the host to the board.
    pub fn receive(&mut self, now: Nanos, bytes: &[u8]) {
        self.restart_if_due(now);
        self.traffic.bytes_in += bytes.len() as u64;
        if bytes.is_empty() || self.is_cut_off(now) {
            return;
        }
        let mut answers = Vec::new();
        self.board.receive(now, bytes, &mut answers);
        for answer in answers {
            self.dispatch(now, now, answer);
        }
    }

    /// Appends what has arrived at the host by `now`. `image` fills in the counts, row by row, at
    /// the instant of a scan.
    pub fn poll(
        &mut self,
        now: Nanos,
        image: &mut dyn FnMut(Nanos, &mut [u16]),
        out: &mut Vec<u8>,
    ) {
        self.restart_if_due(now);
        let mut messages = Vec::new();
        self.board.greet(now, &mut messages);
        for message in messages.drain(..) {
            self.dispatch(now, now, message);
        }
        for _ in 0..SCANS_A_CALL_MAX {
            let due = self.board.scan_due();
            if due > now {
                break;
            }
            if self.strength(FaultKind::Frozen, due).is_none() {
                image(due, &mut self.image);
            } else {
                self.traffic.faults.add(FaultKind::Frozen);
            }
            self.traffic.scans += 1;
            self.board.scan(&self.image, &mut messages);
            // A board that still sends leaves the scan out.
            if self.waiting.back().is_some_and(|(at, _)| *at > due) && !self.is_delayed(due) {
                messages.clear();
            }
            for message in messages.drain(..) {
                self.dispatch(due, due, message);
            }
        }
        while let Some((at, _)) = self.waiting.front()
            && *at <= now
        {
            let (_, bytes) = self.waiting.pop_front().unwrap_or_default();
            self.traffic.messages += 1;
            out.extend(bytes);
        }
    }

    fn strength(&self, kind: FaultKind, now: Nanos) -> Option<f64> {
        self.plan.strength(kind, &self.name, now)
    }

    /// Messages may wait because of a fault, also of one that has just ended.
    fn is_delayed(&self, now: Nanos) -> bool {
        let mine = |target: &str| target.is_empty() || target == self.name;
        self.plan.faults().iter().any(|fault| {
            let end = fault.at.0.saturating_add(fault.duration.0);
            let rest = Nanos(end.saturating_add((2e9 * fault.value) as i64));
            let kinds = [FaultKind::Delay, FaultKind::Duplication];
            kinds.contains(&fault.kind) && mine(&fault.target) && fault.at <= now && now <= rest
        })
    }

    fn hits(&mut self, kind: FaultKind, now: Nanos) -> bool {
        let strength = self.strength(kind, now);
        let hit = strength.is_some_and(|probability| self.random.unit() < probability);
        if hit {
            self.traffic.faults.add(kind);
        }
        hit
    }

    /// Whether a message at `now` cannot pass; counts it.
    fn is_cut_off(&mut self, now: Nanos) -> bool {
        let kinds = [FaultKind::Unplugged, FaultKind::Silence];
        let cut = kinds.into_iter().find(|kind| self.strength(*kind, now).is_some());
        cut.map(|kind| self.traffic.faults.add(kind)).is_some()
    }

    /// What passed over the line since the board was switched on.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Power goes with the cable; a restart of the plan happens once, at its begin.
    fn restart_if_due(&mut self, now: Nanos) {
        let mine = |target: &str| target.is_empty() || target == self.name;
        let begun = self.plan.faults().iter().filter(|fault| {
            fault.kind == FaultKind::Restart && mine(&fault.target) && fault.at <= now
        });
        let (begun, down) = (begun.count(), !self.is_plugged(now));
        (self.restarts..begun).for_each(|_| self.traffic.faults.add(FaultKind::Restart));
        if begun > self.restarts || (self.was_down && !down) {
            self.board.restart(now);
            self.waiting.clear();
        }
        if down {
            self.waiting.clear();
        }
        self.restarts = begun;
        self.was_down = down;
        self.looked = self.looked.max(now);
    }

    fn dispatch(&mut self, now: Nanos, sent: Nanos, mut message: Vec<u8>) {
        if message.is_empty() || self.is_cut_off(now) || self.hits(FaultKind::Loss, now) {
            return;
        }
        if self.hits(FaultKind::Corruption, now) {
            let bit = self.random.next_u64() as usize % (8 * message.len());
            message[bit / 8] ^= 1 << (bit % 8);
        }
        if self.hits(FaultKind::Truncation, now) {
            message.truncate(self.random.next_u64() as usize % message.len());
        }
        let twice = self.hits(FaultKind::Duplication, now);
        let delay = self.strength(FaultKind::Delay, now);
        if delay.is_some() {
            self.traffic.faults.add(FaultKind::Delay);
        }
        let delay = delay.unwrap_or(0.0);
        let transfer = self.board.byte_time() * message.len() as i64;
        let mut at = sent + transfer + Nanos((1e9 * delay) as i64);
        if let Some((last, _)) = self.waiting.back() {
            at = at.max(*last + transfer);
        }
        if twice {
            self.waiting.push_back((at, message.clone()));
            at += transfer;
        }
        self.waiting.push_back((at, message));
    }
}
