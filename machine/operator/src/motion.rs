//! The server's side of the lane: what was sent there, and the machine's decision about it, read
//! from the records of the supervisor and of the typed moves. One request is under way at a time,
//! so that each decision belongs to exactly one request.

use std::collections::VecDeque;

use serde_json::json;
use taktil_machine::operator::command::CommandContext;
use taktil_machine::operator::status::{Status, refusal_text};
use taktil_machine::operator::{
    FIRST_SEQUENCE, FIRST_STOP_SEQUENCE, OperatorMessage, OperatorSender, SEQUENCE_COUNT,
};
use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Record};
use taktil_signal::{JogFrame, OperatorMove, Request, Verb};
use taktil_tasks_trajectory::typed;

use crate::answer::Answer;
use crate::signals::SignalTable;
use crate::status::refusal_reason;

/// Time that the machine may take to answer a request.
const ANSWER_TIMEOUT: Nanos = Nanos::from_secs(2);

/// The instants between which the server translates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ServerClock {
    /// The kernel's monotonic clock.
    pub(crate) now: Nanos,
    /// The kernel's monotonic clock at logical time zero.
    pub(crate) origin: Nanos,
}

/// What a client waits for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Pending {
    /// The supervisor's decision about this request, once it is sent.
    Request { verb: Verb, since: Nanos },
    /// The supervisor's decision about a stop, whose line came in at `since`.
    Stop { sequence: u32, since: Nanos },
    /// The check of this move.
    MoveCheck { sequence: u32, since: Nanos },
    /// The acceptance of a pause, a resumption or a clearing.
    Acceptance { sequence: u32, since: Nanos },
    /// The end of all moves up to this one.
    Standstill { sequence: u32 },
}

/// A request that the lane has been given.
#[derive(Clone, Copy, Debug)]
struct SentRequest {
    client: u64,
    sequence: u32,
    since: Nanos,
}

/// The decision about a request.
#[derive(Clone, Copy, Debug)]
struct Decision {
    is_granted: bool,
    /// Release of the job that took it.
    release: Nanos,
}

/// The channel into the lane, with what was sent through it.
#[derive(Debug)]
pub(crate) struct LaneChannel {
    sender: OperatorSender,
    /// The machine's state as its records tell it.
    pub(crate) status: Status,
    control_signal: Option<usize>,
    waiting: VecDeque<(u64, Verb)>,
    sent: Option<SentRequest>,
    /// The newest stop that has not been decided.
    stop: Option<u32>,
    decided_stop: Option<(u32, Decision)>,
    requests: u32,
    moves: u32,
    decided: Vec<(u64, Decision)>,
    /// Whether anything was sent.
    pub(crate) has_sent: bool,
}

impl LaneChannel {
    /// A channel into a machine with this catalog.
    pub(crate) fn new(sender: OperatorSender, catalog: &Catalog) -> LaneChannel {
        LaneChannel {
            sender,
            status: Status::new(catalog),
            control_signal: catalog.find("supervisor.control"),
            waiting: VecDeque::new(),
            sent: None,
            stop: None,
            decided_stop: None,
            requests: 0,
            moves: 0,
            decided: Vec::new(),
            has_sent: false,
        }
    }

    /// Takes in a record: the decision about a request is in the first state that names it.
    pub(crate) fn record(&mut self, record: &Record<'_>) {
        let before = (self.status.control.request, self.status.control.refused);
        self.status.record(record);
        if self.control_signal != Some(record.signal) {
            return;
        }
        let control = &self.status.control;
        if control.request == before.0 {
            return;
        }
        let is_granted = control.refused == before.1;
        let decision = Decision { is_granted, release: record.release };
        if control.request >= FIRST_STOP_SEQUENCE {
            self.decided_stop = Some((control.request, decision));
            if self.stop.is_some_and(|stop| is_at_or_after(control.request, stop)) {
                self.stop = None;
            }
        } else if let Some(sent) = self.sent.filter(|sent| sent.sequence == control.request) {
            self.sent = None;
            self.decided.push((sent.client, decision));
        }
    }

    /// Stops the machine. Every request and key that was said before is void.
    pub(crate) fn stop(&mut self) -> u32 {
        let sequence = self.sender.stop();
        self.has_sent = true;
        self.stop = Some(sequence);
        (self.sent, self.waiting) = (None, VecDeque::new());
        sequence
    }

    /// Puts a request behind those that wait.
    pub(crate) fn request(&mut self, client: u64, verb: Verb, now: Nanos) -> Pending {
        self.waiting.push_back((client, verb));
        Pending::Request { verb, since: now }
    }

    /// Sends the next request, when the one before it is decided.
    pub(crate) fn send_next(&mut self, now: Nanos) {
        if self.sent.is_some_and(|sent| now - sent.since > ANSWER_TIMEOUT) {
            self.sent = None;
        }
        if self.sent.is_some() || self.stop.is_some() {
            return;
        }
        let Some((client, verb)) = self.waiting.pop_front() else { return };
        self.requests = (self.requests + 1) % SEQUENCE_COUNT;
        let sequence = FIRST_SEQUENCE | self.requests;
        let request = Request { verb: verb as u32, sequence };
        if self.sender.send(OperatorMessage::Request(request)).is_ok() {
            self.has_sent = true;
            self.sent = Some(SentRequest { client, sequence, since: now });
        }
    }

    /// The client has gone or waits no more.
    pub(crate) fn forget(&mut self, client: u64) {
        self.waiting.retain(|(waiting, _)| *waiting != client);
        self.decided.retain(|(decided, _)| *decided != client);
    }

    /// Holds keys, or lets go of them; false when the machine does not listen.
    pub(crate) fn jog(&mut self, axes: [f64; 6], frame: JogFrame) -> bool {
        let sent =
            self.stop.is_none() && self.sender.send(OperatorMessage::Jog { axes, frame }).is_ok();
        self.has_sent |= sent;
        sent
    }

    /// Sends a move; `None` when the machine does not listen.
    pub(crate) fn send_move(&mut self, typed: OperatorMove, now: Nanos) -> Option<Pending> {
        if self.stop.is_some() {
            return None;
        }
        self.moves = (self.moves + 1) % SEQUENCE_COUNT;
        let sequence = FIRST_SEQUENCE | self.moves;
        self.sender.send(OperatorMessage::Move(OperatorMove { sequence, ..typed })).ok()?;
        self.has_sent = true;
        let since = now;
        Some(match typed::is_move(&typed) {
            true => Pending::MoveCheck { sequence, since },
            false => Pending::Acceptance { sequence, since },
        })
    }

    /// Waits for the end of all moves so far.
    pub(crate) fn standstill(&self) -> Pending {
        Pending::Standstill { sequence: FIRST_SEQUENCE | self.moves }
    }

    /// The state of the machine, and what prevents jog motion.
    pub(crate) fn state_line(&self, context: &CommandContext) -> String {
        let obstacle = self.status.jog_obstacle(|joint| context.robot.joint_label(joint));
        let obstacle = obstacle.map_or_else(String::new, |obstacle| format!("; {obstacle}"));
        format!("{}{obstacle}", self.status.summary())
    }

    /// The answer for a client, once the records contain it.
    pub(crate) fn answer_to(
        &mut self,
        client: u64,
        pending: &Pending,
        ServerClock { now, origin }: ServerClock,
        context: &CommandContext,
        table: &SignalTable,
    ) -> Option<Answer> {
        let since = match *pending {
            Pending::Request { verb, since } => {
                if let Some(at) = self.decided.iter().position(|(decided, _)| *decided == client) {
                    let decision = self.decided.swap_remove(at).1;
                    return Some(self.request_answer(verb, decision, origin, table));
                }
                let is_known = self.sent.is_some_and(|sent| sent.client == client)
                    || self.waiting.iter().any(|(waiting, _)| *waiting == client);
                if !is_known && (now - since) <= ANSWER_TIMEOUT {
                    return Some(Answer::refused("a stop came first"));
                }
                since
            }
            Pending::Stop { sequence, since } => {
                if let Some((decided, decision)) = self.decided_stop
                    && is_at_or_after(decided, sequence)
                {
                    return Some(self.stop_answer(decision, since, origin));
                }
                since
            }
            Pending::MoveCheck { sequence, since } => {
                if let Some(answer) = self.check_answer(sequence, context) {
                    return Some(answer);
                }
                // The moves before it are still checked or executed, which may take any time.
                if self.status.typed.received == sequence {
                    return None;
                }
                since
            }
            Pending::Acceptance { sequence, since } => {
                if self.status.typed.received == sequence {
                    return Some(Answer::ok(""));
                }
                since
            }
            Pending::Standstill { sequence } => return self.standstill_answer(sequence, context),
        };
        let is_late = (now - since) > ANSWER_TIMEOUT;
        is_late.then(|| {
            self.forget(client);
            Answer::error("the machine does not answer")
        })
    }

    /// The answer about a request that was decided.
    fn request_answer(
        &self,
        verb: Verb,
        decision: Decision,
        origin: Nanos,
        table: &SignalTable,
    ) -> Answer {
        let place = self.status.state_text();
        let answer = if decision.is_granted {
            Answer::ok(place)
        } else {
            // The machine may have gone on since the decision.
            let why = refusal_reason(&self.status, table, verb).map(|why| format!(": {why}"));
            let why = why.unwrap_or_default();
            Answer::refused(format!("{} is not possible in {place}{why}", verb.name()))
        };
        answer.with(json!({ "taken_ns": (origin + decision.release).0 }))
    }

    fn stop_answer(&self, decision: Decision, received: Nanos, origin: Nanos) -> Answer {
        let place = self.status.state_text();
        let text = if decision.is_granted { place } else { format!("nothing to stop: {place}") };
        let taken = origin + decision.release;
        Answer::ok(text).with(json!({ "received_ns": received.0, "taken_ns": taken.0 }))
    }

    fn left(&self) -> Answer {
        Answer::refused(format!("TRAJECTORY/USER was left: {}", self.status.state_text()))
    }

    fn check_answer(&self, sequence: u32, context: &CommandContext) -> Option<Answer> {
        let Status { typed, check, .. } = &self.status;
        if typed.refused == sequence {
            let why = refusal_text(check, |joint| context.robot.joint_label(joint));
            return Some(Answer::refused(why));
        }
        if typed.checked == sequence {
            let text = format!(
                "{:.2} s, at most {:.0} % of a joint's speed, {:.0} % of its torque",
                check.duration_s,
                100.0 * check.speed_share,
                100.0 * check.torque_share
            );
            return Some(Answer::ok(text));
        }
        (!self.status.accepts_moves()).then(|| self.left())
    }

    fn standstill_answer(&self, sequence: u32, context: &CommandContext) -> Option<Answer> {
        if !self.status.accepts_moves() {
            return Some(self.left());
        }
        let typed = &self.status.typed;
        let over = typed.queued == 0 && typed.moving == 0;
        let nothing = sequence == FIRST_SEQUENCE;
        (over && (nothing || typed.received == sequence))
            .then(|| Answer::ok(self.state_line(context)))
    }
}

/// Whether stop number `a` is number `b` or a later one; the numbers go round.
fn is_at_or_after(a: u32, b: u32) -> bool {
    (a.wrapping_sub(b) % SEQUENCE_COUNT) < SEQUENCE_COUNT / 2
}
