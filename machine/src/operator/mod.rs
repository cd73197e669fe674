//! The operator's channel into a lane. Commands that are typed, sent through a socket or read from
//! a script become requests, held keys and typed moves. The lane takes a few messages out of a ring
//! in each job and never waits for one. Held keys count only as long as messages confirm them.
//!
//! A stop does not go through the ring: it is a word of its own that the lane looks at in each job,
//! and it discards every message that was sent before it.
//!
//! One sender is served at a time; this module does not decide who may command.

pub mod command;
pub mod status;

use core::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;

use taktil_hal::Nanos;
use taktil_hal::link::{Full, Receiver, Sender, link};
use taktil_rtcore::{Cycle, FaultCode, Io, Output, Ports, StateHash, Task};
use taktil_signal::{JogCommand, JogFrame, OperatorMove, Request, Verb};

/// Number of messages that can wait for the lane; further messages are refused.
const CHANNEL_CAPACITY: usize = 64;
/// Largest number of messages that the lane takes in one job.
const MESSAGES_PER_JOB_MAX: usize = 8;
/// First sequence number of requests and moves from outside; those of a script begin at 1.
pub const FIRST_SEQUENCE: u32 = 1 << 31;
/// First sequence number of stops, which have numbers of their own among the requests.
pub const FIRST_STOP_SEQUENCE: u32 = 3 << 30;
/// Number of sequence numbers of each kind.
pub const SEQUENCE_COUNT: u32 = 1 << 30;

/// Default path of the service's socket.
pub const SERVICE_SOCKET: &str = "/run/taktil/operator.sock";

/// A message from an operator into the lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OperatorMessage {
    /// A request to the supervisor.
    Request(Request),
    /// The operator holds keys, or has let them go.
    Jog {
        /// Deflection of each axis, -1 to 1.
        axes: [f64; 6],
        /// The frame of the axes.
        frame: JogFrame,
    },
    /// The operator typed a move.
    Move(OperatorMove),
}

/// The receiving end of the operator's channel, in the lane.
#[derive(Debug)]
pub struct OperatorReceiver {
    messages: Receiver<OperatorMessage>,
    stops: Arc<AtomicU32>,
    stops_taken: u32,
}

/// The sending end of the operator's channel, outside the lanes.
#[derive(Debug)]
pub struct OperatorSender {
    messages: Sender<OperatorMessage>,
    stops: Arc<AtomicU32>,
}

impl OperatorSender {
    /// Sends a message.
    ///
    /// # Errors
    /// [`Full`] when the lane has not taken those before it; the message is lost.
    pub fn send(&mut self, message: OperatorMessage) -> Result<(), Full> {
        self.messages.send(message, Nanos::ZERO, Nanos::ZERO)
    }

    /// Asks for a stop, which cannot fail; returns the sequence number of its request. The lane
    /// takes the newest of several.
    pub fn stop(&self) -> u32 {
        // Release: messages that were sent before the stop are in the ring when the lane sees it.
        let stops = self.stops.fetch_add(1, Ordering::Release).wrapping_add(1);
        stop_sequence(stops)
    }
}

fn stop_sequence(stops: u32) -> u32 {
    FIRST_STOP_SEQUENCE | (stops % SEQUENCE_COUNT)
}

/// Makes an operator's channel and returns both ends.
#[must_use]
pub fn channel() -> (OperatorSender, OperatorReceiver) {
    let (sender, messages) = link(CHANNEL_CAPACITY);
    let stops = Arc::new(AtomicU32::new(0));
    let sender = OperatorSender { messages: sender, stops: Arc::clone(&stops) };
    (sender, OperatorReceiver { messages, stops, stops_taken: 0 })
}

/// The newest input of each kind; an operator's task writes it in each job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OperatorInput {
    /// The newest request.
    pub request: Request,
    /// The held keys.
    pub jog: JogCommand,
    /// The newest typed move.
    pub typed: OperatorMove,
}

impl OperatorReceiver {
    /// Takes the messages that came since the last job into `input`: at most one request or move in
    /// each job, so that none is overwritten before the tasks see it. A stop comes first, lets go
    /// of all keys and discards what waits.
    pub fn receive_into(&mut self, input: &mut OperatorInput) {
        // Acquire: pairs with the addition in `OperatorSender::stop`.
        let stops = self.stops.load(Ordering::Acquire);
        if stops != self.stops_taken {
            self.stops_taken = stops;
            for _ in 0..CHANNEL_CAPACITY {
                if self.messages.next(Nanos(i64::MAX)).is_none() {
                    break;
                }
            }
            input.jog.axes = [0.0; 6];
            input.request = Request { verb: Verb::Stop as u32, sequence: stop_sequence(stops) };
            return;
        }
        for _ in 0..MESSAGES_PER_JOB_MAX {
            // A message belongs to the job that receives it, whatever its time stamp.
            match self.messages.next(Nanos(i64::MAX)).map(|word| word.value) {
                None => return,
                Some(OperatorMessage::Jog { axes, frame }) => {
                    let sequence = input.jog.sequence.wrapping_add(1);
                    input.jog = JogCommand { axes, frame: frame as u32, sequence };
                }
                Some(OperatorMessage::Request(request)) => {
                    input.request = request;
                    return;
                }
                Some(OperatorMessage::Move(typed)) => {
                    input.typed = typed;
                    return;
                }
            }
        }
    }
}

/// The operator task of a machine without a script: it passes on what the channel brings.
pub struct RemoteOperator {
    receiver: Option<OperatorReceiver>,
    input: OperatorInput,
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
}

impl RemoteOperator {
    /// Declares `request`, `jog` and `moves`. Without a receiver the task never requests anything.
    pub fn new(receiver: Option<OperatorReceiver>, ports: &mut Ports) -> RemoteOperator {
        RemoteOperator {
            receiver,
            input: OperatorInput::default(),
            request: ports.output("request"),
            jog: ports.output("jog"),
            moves: ports.output("moves"),
        }
    }
}

impl Task for RemoteOperator {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some(receiver) = &mut self.receiver {
            receiver.receive_into(&mut self.input);
        }
        io.write(&self.request, self.input.request);
        io.write(&self.jog, self.input.jog);
        io.write(&self.moves, self.input.typed);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.input.request).add(&self.input.jog).add(&self.input.typed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_signal::MoveKind;

    fn say(sender: &mut OperatorSender, word: OperatorMessage) {
        sender.send(word).unwrap();
    }

    #[test]
    fn one_request_or_move_a_job_and_the_newest_keys() {
        let (mut sender, mut receiver) = channel();
        let ask =
            |sequence| OperatorMessage::Request(Request { verb: Verb::Enable as u32, sequence });
        let keys = |x| OperatorMessage::Jog { axes: [x; 6], frame: JogFrame::Tool };
        let typed =
            OperatorMove { kind: MoveKind::Pause as u32, sequence: 5, ..Default::default() };
        for word in [keys(0.1), keys(0.2), ask(1), ask(2), OperatorMessage::Move(typed), keys(0.3)]
        {
            say(&mut sender, word);
        }
        let mut input = OperatorInput::default();
        receiver.receive_into(&mut input);
        assert_eq!((input.jog.axes[0], input.jog.sequence, input.request.sequence), (0.2, 2, 1));
        receiver.receive_into(&mut input);
        assert_eq!((input.request.sequence, input.typed.sequence), (2, 0));
        receiver.receive_into(&mut input);
        assert_eq!((input.typed.sequence, input.jog.sequence), (5, 2));
        receiver.receive_into(&mut input);
        let before = input;
        assert_eq!((input.jog.axes[0], input.jog.sequence), (0.3, 3));
        receiver.receive_into(&mut input);
        assert_eq!(input, before, "silence confirms nothing");
    }

    #[test]
    fn a_stop_overtakes_what_waits_and_discards_it() {
        let (mut sender, mut receiver) = channel();
        let enable = Request { verb: Verb::Enable as u32, sequence: 1 };
        while sender.send(OperatorMessage::Request(enable)).is_ok() {}
        let first = sender.stop();
        let second = sender.stop();
        let mut input = OperatorInput::default();
        input.jog.axes = [1.0; 6];
        receiver.receive_into(&mut input);
        let stop = Request { verb: Verb::Stop as u32, sequence: second };
        assert_eq!((input.request, input.jog.axes), (stop, [0.0; 6]));
        assert_eq!(second, first + 1);
        receiver.receive_into(&mut input);
        assert_eq!(input.request, stop, "nothing that was sent before it is left");
        say(&mut sender, OperatorMessage::Request(enable));
        receiver.receive_into(&mut input);
        assert_eq!(input.request, enable);
    }

    #[test]
    fn a_flood_of_keys_does_not_make_a_job_long() {
        let (mut sender, mut receiver) = channel();
        for _ in 0..CHANNEL_CAPACITY {
            say(&mut sender, OperatorMessage::Jog { axes: [1.0; 6], frame: JogFrame::Joints });
        }
        let mut input = OperatorInput::default();
        receiver.receive_into(&mut input);
        assert_eq!(input.jog.sequence as usize, MESSAGES_PER_JOB_MAX);
    }
}
