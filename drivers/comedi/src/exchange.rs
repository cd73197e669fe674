//! Executes lists of instructions and says what became of them: the one place where an error of the
//! system becomes an error of a half, and where failures are counted.

use std::sync::Arc;

use nix::errno::Errno;
use taktil_hal::{Error, ErrorKind, Nanos};

use crate::board::{Board, Instruction, InstructionList};
use crate::sharing::Shared;

/// What went wrong on an open board, counted since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Lists that the board refused, by any error of the system.
    pub lists_refused: u64,
    /// Lists that ended before their last instruction without an error.
    pub lists_short: u64,
    /// Samples that found the inputs in use by another lane.
    pub contentions: u64,
}

impl Statistics {
    fn add(&mut self, more: Statistics) {
        self.lists_refused += more.lists_refused;
        self.lists_short += more.lists_short;
        self.contentions += more.contentions;
    }
}

/// Reads the statistics of a board from outside its lanes.
#[derive(Clone, Debug)]
pub struct Monitor(pub(crate) Shared<Statistics>);

impl Monitor {
    /// The counts so far; `None` when a lane is adding to them this moment. A half hands on what it
    /// could not add at its next exchange.
    #[must_use]
    pub fn statistics(&self) -> Option<Statistics> {
        self.0.try_use(|statistics| *statistics)
    }
}

/// Counts of one half, on their way to those of the board.
#[derive(Debug)]
pub(crate) struct Tally {
    pending: Statistics,
    board: Shared<Statistics>,
}

impl Tally {
    pub(crate) fn new(board: Shared<Statistics>) -> Tally {
        Tally { pending: Statistics::default(), board }
    }

    /// Hands on what has been counted, unless the counts are in use.
    fn hand_on(&mut self) {
        let pending = self.pending;
        if pending != Statistics::default()
            && self.board.try_use(|board| board.add(pending)).is_some()
        {
            self.pending = Statistics::default();
        }
    }

    pub(crate) fn contention(&mut self) {
        self.pending.contentions += 1;
        self.hand_on();
    }
}

/// What a caller can do about an error of the system.
pub(crate) fn error_kind(errno: Errno) -> ErrorKind {
    match errno {
        // No board, no node, no Comedi: only opening it anew can help.
        Errno::ENODEV | Errno::ENXIO | Errno::EBADF | Errno::ENOTTY => ErrorKind::Lost,
        _ => ErrorKind::Transient,
    }
}

/// A list of instructions of one half, and the board that executes it.
#[derive(Debug)]
pub(crate) struct Exchange {
    board: Arc<dyn Board>,
    pub(crate) list: InstructionList,
    is_lost: bool,
    tally: Tally,
}

impl Exchange {
    pub(crate) fn new(
        board: Arc<dyn Board>,
        instructions: Vec<Instruction>,
        tally: Tally,
    ) -> Exchange {
        Exchange { board, list: InstructionList::new(instructions), is_lost: false, tally }
    }

    /// Executes the list once, whole or not at all as far as the caller may rely on it. A board
    /// that has been lost is not asked again.
    pub(crate) fn execute(&mut self) -> Result<(), ErrorKind> {
        if self.is_lost { Err(ErrorKind::Lost) } else { self.attempt() }
    }

    /// Executes the list even on a board that seems gone, and again as long as the board is busy,
    /// `attempts` times in all.
    pub(crate) fn insist(&mut self, attempts: usize) -> Result<(), ErrorKind> {
        let mut answer = Err(ErrorKind::Transient);
        for _ in 0..attempts {
            answer = self.attempt();
            if answer != Err(ErrorKind::Transient) {
                break;
            }
        }
        if self.is_lost { Err(ErrorKind::Lost) } else { answer }
    }

    fn attempt(&mut self) -> Result<(), ErrorKind> {
        let due = self.list.instructions().len();
        let answer = match self.board.execute(&mut self.list) {
            Ok(executed) if executed == due => Ok(()),
            Ok(_) => {
                self.tally.pending.lists_short += 1;
                Err(ErrorKind::Transient)
            }
            Err(errno) => {
                self.tally.pending.lists_refused += 1;
                Err(error_kind(errno))
            }
        };
        self.tally.hand_on();
        self.is_lost |= answer == Err(ErrorKind::Lost);
        answer
    }
}

/// All inputs of a board. Whoever samples with a new release executes the list; whoever samples
/// with the same release finds the words, or the refusal, of that execution.
#[derive(Debug)]
pub(crate) struct InputBank {
    exchange: Exchange,
    newest: Option<(Nanos, Result<(), ErrorKind>)>,
}

impl InputBank {
    pub(crate) fn new(exchange: Exchange) -> InputBank {
        InputBank { exchange, newest: None }
    }

    /// The instructions with the words that belong to `release`.
    pub(crate) fn at(&mut self, release: Nanos) -> Result<&[Instruction], ErrorKind> {
        let answer = match self.newest {
            Some((at, answer)) if at == release => answer,
            _ => {
                // No mask of lines may stay from an answer: an input list sets no line.
                let list = self.exchange.list.instructions_mut();
                list.iter_mut().for_each(|instruction| instruction.words_mut().fill(0));
                self.exchange.execute()
            }
        };
        self.newest = Some((release, answer));
        answer.map(|()| self.exchange.list.instructions())
    }
}

/// The error of a half as a whole.
pub(crate) fn whole(device: &'static str) -> impl Fn(ErrorKind) -> Error {
    move |kind| Error::whole(kind, device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_come_back_is_lost_and_all_else_may() {
        for errno in [Errno::ENODEV, Errno::ENXIO, Errno::EBADF, Errno::ENOTTY] {
            assert_eq!(error_kind(errno), ErrorKind::Lost, "{errno}");
        }
        for errno in [Errno::EBUSY, Errno::ETIMEDOUT, Errno::EIO, Errno::EACCES, Errno::EINTR] {
            assert_eq!(error_kind(errno), ErrorKind::Transient, "{errno}");
        }
    }

    #[test]
    fn counts_in_use_are_handed_on_later() {
        let board = Shared::new(Statistics::default());
        let mut tally = Tally::new(board.clone());
        board.try_use(|_| tally.contention());
        assert_eq!(Monitor(board.clone()).statistics().unwrap().contentions, 0);
        tally.contention();
        assert_eq!(Monitor(board).statistics().unwrap().contentions, 2);
    }
}
