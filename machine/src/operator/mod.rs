//! Somebody who asks, from outside the lanes: words typed, sent through a socket or read from a
//! script become requests, held keys and typed moves. The lane takes a few words a job out of a
//! ring and never waits for one. Refuses to believe in a hand that has fallen silent: keys are
//! confirmed by every word that says them, and by nothing else.
//!
//! One sender at a time is served as it comes; who may command whom is not decided here.

pub mod socket;
pub mod speech;
pub mod status;

use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, Sender, link};
use taktil_rtcore::{Cycle, FaultCode, Io, Output, Ports, StateHash, Task};
use taktil_signal::{JogCommand, JogFrame, Request, TypedMove};

/// Words that wait for the lane.
const WORDS: usize = 64;
/// Words that the lane takes in one job.
const WORDS_A_JOB: usize = 8;
/// Requests and moves from outside are numbered from here on, a script's from 1.
pub const FIRST_SEQUENCE: u32 = 1 << 31;

/// What enters the lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Word {
    /// Something is asked for.
    Ask(Request),
    /// Keys are seen to be held, or let go.
    Keys {
        /// How far the axes are pushed, -1 to 1.
        axes: [f64; 6],
        /// What the axes are.
        frame: JogFrame,
    },
    /// A move is typed.
    Move(TypedMove),
}

/// The lane's end: what was said last.
#[derive(Debug)]
pub struct Hand {
    words: Receiver<Word>,
}

/// The end of whoever talks to people.
pub type Mouth = Sender<Word>;

/// A mouth and the hand that does what it says.
#[must_use]
pub fn pair() -> (Mouth, Hand) {
    let (mouth, words) = link(WORDS);
    (mouth, Hand { words })
}

/// What an operator's task writes each job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Said {
    /// The newest request.
    pub request: Request,
    /// The keys.
    pub keys: JogCommand,
    /// The newest typed move.
    pub typed: TypedMove,
}

impl Hand {
    /// Takes what was said since the last job into `said`: at most one request and one move, so
    /// that none is overwritten before it was seen.
    pub fn hear(&mut self, said: &mut Said) {
        for _ in 0..WORDS_A_JOB {
            // Words are for the job that finds them.
            match self.words.next(Nanos(i64::MAX)).map(|word| word.value) {
                None => return,
                Some(Word::Keys { axes, frame }) => {
                    let sequence = said.keys.sequence.wrapping_add(1);
                    said.keys = JogCommand { axes, frame: frame as u32, sequence };
                }
                Some(Word::Ask(request)) => {
                    said.request = request;
                    return;
                }
                Some(Word::Move(typed)) => {
                    said.typed = typed;
                    return;
                }
            }
        }
    }
}

/// The operator of a machine without a script: a hand, or nobody.
pub struct Remote {
    hand: Option<Hand>,
    said: Said,
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<TypedMove>,
}

impl Remote {
    /// Declares `request`, `jog` and `moves`. Without a hand it never asks for anything.
    pub fn new(hand: Option<Hand>, ports: &mut Ports) -> Remote {
        Remote {
            hand,
            said: Said::default(),
            request: ports.output("request"),
            jog: ports.output("jog"),
            moves: ports.output("moves"),
        }
    }
}

impl Task for Remote {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some(hand) = &mut self.hand {
            hand.hear(&mut self.said);
        }
        io.write(&self.request, self.said.request);
        io.write(&self.jog, self.said.keys);
        io.write(&self.moves, self.said.typed);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.said.request).add(&self.said.keys).add(&self.said.typed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_signal::{MoveKind, Verb};

    fn say(mouth: &mut Mouth, word: Word) {
        mouth.send(word, Nanos::ZERO, Nanos::ZERO).unwrap();
    }

    #[test]
    fn one_request_or_move_a_job_and_the_newest_keys() {
        let (mut mouth, mut hand) = pair();
        let ask = |sequence| Word::Ask(Request { verb: Verb::Enable as u32, sequence });
        let keys = |x| Word::Keys { axes: [x; 6], frame: JogFrame::Tool };
        let typed = TypedMove { kind: MoveKind::Pause as u32, sequence: 5, ..Default::default() };
        for word in [keys(0.1), keys(0.2), ask(1), ask(2), Word::Move(typed), keys(0.3)] {
            say(&mut mouth, word);
        }
        let mut said = Said::default();
        hand.hear(&mut said);
        assert_eq!((said.keys.axes[0], said.keys.sequence, said.request.sequence), (0.2, 2, 1));
        hand.hear(&mut said);
        assert_eq!((said.request.sequence, said.typed.sequence), (2, 0));
        hand.hear(&mut said);
        assert_eq!((said.typed.sequence, said.keys.sequence), (5, 2));
        hand.hear(&mut said);
        let before = said;
        assert_eq!((said.keys.axes[0], said.keys.sequence), (0.3, 3));
        hand.hear(&mut said);
        assert_eq!(said, before, "silence confirms nothing");
    }

    #[test]
    fn a_flood_of_keys_does_not_make_a_job_long() {
        let (mut mouth, mut hand) = pair();
        for _ in 0..WORDS {
            say(&mut mouth, Word::Keys { axes: [1.0; 6], frame: JogFrame::Joints });
        }
        let mut said = Said::default();
        hand.hear(&mut said);
        assert_eq!(said.keys.sequence as usize, WORDS_A_JOB);
    }
}
