//! What each word of a client does. Questions are answered at once, and anyone may ask them;
//! commands need the role and the control lease.

use std::sync::atomic::Ordering;

use serde_json::{Value, json};
use taktil_machine::operator::command::OperatorCommand;
use taktil_rtcore::Nanos;
use taktil_rtcore::parameter::{Parameter, Transaction};
use taktil_signal::{JogFrame, OperatorMove, Verb};

use super::{Feed, Server};
use crate::PROTOCOL_VERSION;
use crate::access::Role;
use crate::answer::Answer;
use crate::client::Client;
use crate::model::model;
use crate::motion::Pending;
use crate::request::{Request, Word};
use crate::scope::Scope;
use crate::status::{faults, machine_status};
use crate::watch::Watch;

impl Server {
    /// Carries out a line that could be read.
    pub(super) fn carry_out(
        &mut self,
        client: &mut Client,
        Request { id, word }: Request,
        now: Nanos,
    ) {
        let told = match word {
            Word::Machine(OperatorCommand::Request(Verb::Stop)) => {
                // The stop itself was carried out when its line came in.
                let early = client.early_stops.pop_front();
                let (sequence, since) = early.unwrap_or_else(|| (self.feed.lane.stop(), now));
                Err(Pending::Stop { sequence, since })
            }
            Word::Machine(OperatorCommand::State) => {
                let line = self.feed.lane.state_line(&self.context);
                // Whoever looks at such a machine has to know that what it says is put on.
                let injected = self.about["fault_injection"] == json!(true);
                Ok(Answer::ok(if injected { format!("{line}; FAULT INJECTION") } else { line }))
            }
            Word::Machine(OperatorCommand::Wait) => Err(self.feed.lane.standstill()),
            Word::Machine(OperatorCommand::Jog(axes, frame)) => {
                Ok(self.jog(client, axes, frame, now))
            }
            Word::Machine(OperatorCommand::Request(verb)) => match self.command(client, now) {
                Err(refused) => Ok(refused),
                Ok(()) => Err(self.feed.lane.request(client.number, verb, now)),
            },
            Word::Machine(OperatorCommand::Move(typed)) => self.send_move(client, typed, now),
            Word::Set(values) => Ok(self.set(client, values, now)),
            Word::Record(on) => Ok(self.record(client, on)),
            Word::ControlTake => Ok(match self.command(client, now) {
                Err(refused) => refused,
                Ok(()) => Answer::ok("you have control"),
            }),
            Word::ControlRelease => {
                let held = self.lease.release(client.number);
                Ok(Answer::ok(if held { "control is free" } else { "you had no control" }))
            }
            word => Ok(self.tell(client, word, now)),
        };
        match told {
            Ok(answer) => client.answer(id.as_ref(), &answer),
            Err(pending) => client.pending = Some((id, pending)),
        }
    }

    /// The answer to a question, which everyone may ask.
    fn tell(&mut self, client: &mut Client, word: Word, now: Nanos) -> Answer {
        match word {
            Word::Status => Answer::data(self.status(client)),
            Word::Model => Answer::data(model(&self.context)),
            Word::Signals => Answer::data(self.feed.table.list()),
            Word::Parameters => Answer::data(self.parameters()),
            Word::Watch { rate_hz, paths } => {
                match Watch::begin(rate_hz, &paths, &self.feed.table, now) {
                    Ok(watch) => {
                        client.watch = Some(watch);
                        Answer::ok("")
                    }
                    Err(bad) => refused(&bad),
                }
            }
            Word::WatchOff => {
                client.watch = None;
                Answer::ok("")
            }
            Word::Scope(request) => match Scope::arm(&request, &self.feed.table) {
                Ok(scope) => {
                    client.scope = Some(scope);
                    Answer::ok("armed")
                }
                Err(bad) => refused(&bad),
            },
            Word::ScopeOff => {
                client.scope = None;
                Answer::ok("")
            }
            Word::FaultList => Answer::data(faults(&self.feed.lane.status, &self.feed.table)),
            Word::ControlState => Answer::data(self.control(client)),
            Word::Help => Answer::data(help()),
            _ => Answer::data(json!({
                "protocol": PROTOCOL_VERSION,
                "taktil": env!("CARGO_PKG_VERSION"),
            })),
        }
    }

    /// Whether the client may command now; it then has the control lease.
    fn command(&mut self, client: &Client, now: Nanos) -> Result<(), Answer> {
        if client.role < Role::Control {
            let text = "this user may watch and stop; members of the control group may command";
            return Err(Answer::refused(text));
        }
        let (number, peer) = (client.number, (client.peer.pid, client.peer.uid));
        self.lease.take(number, peer, now).map_err(Answer::refused)
    }

    fn jog(&mut self, client: &mut Client, axes: [f64; 6], frame: JogFrame, now: Nanos) -> Answer {
        let held = axes.iter().any(|axis| *axis != 0.0);
        if held && (client.has_backlog || client.is_closed || client.has_line()) {
            return Answer::refused(
                "these keys were said too long ago; say them while they are held, and wait for \
                 each answer",
            );
        }
        if !held && !self.lease.is_held_by(client.number) {
            // Who has no control holds no keys.
            return Answer::ok("");
        }
        if let Err(refused) = self.command(client, now) {
            return refused;
        }
        let lane = &mut self.feed.lane;
        if !lane.jog(axes, frame) {
            return Answer::error("the machine does not listen; the word is lost");
        }
        if held && !lane.status.accepts_jog() {
            let place = lane.status.state_text();
            return Answer::ok(format!("but keys move the arm in MANUAL; it is in {place}"));
        }
        let obstacle = lane.status.jog_obstacle(|joint| self.context.robot.joint_label(joint));
        Answer::ok(obstacle.filter(|_| held).unwrap_or_default())
    }

    fn send_move(
        &mut self,
        client: &Client,
        typed: OperatorMove,
        now: Nanos,
    ) -> Result<Answer, Pending> {
        if let Err(refused) = self.command(client, now) {
            return Ok(refused);
        }
        let lane = &mut self.feed.lane;
        if !lane.status.accepts(&typed) {
            let place = lane.status.state_text();
            return Ok(Answer::refused(format!(
                "moves are taken in TRAJECTORY/USER, the machine is in {place}; ask for \
                 trajectory_user first"
            )));
        }
        match lane.send_move(typed, now) {
            Some(pending) => Err(pending),
            None => Ok(Answer::error("the machine does not listen; the word is lost")),
        }
    }

    fn set(&mut self, client: &Client, values: Vec<(String, f64)>, now: Nanos) -> Answer {
        if let Err(refused) = self.command(client, now) {
            return refused;
        }
        let Some(editor) = &mut self.editor else {
            return Answer::refused("this machine has no parameters that can be set while it runs");
        };
        let logical = Nanos(self.shared.now_ns.load(Ordering::Relaxed));
        let at = editor.earliest(logical);
        let transaction = Transaction { at, set: values };
        match editor.send(logical, &transaction) {
            Err(bad) => refused(&bad),
            Ok(()) => {
                self.shared.has_intervened.store(true, Ordering::Relaxed);
                for (name, value) in transaction.set {
                    self.set_values.retain(|(set, _)| *set != name);
                    self.set_values.push((name, value));
                }
                Answer::ok("").with(json!({ "at_ns": at.0 }))
            }
        }
    }

    fn record(&self, client: &Client, on: bool) -> Answer {
        if client.role < Role::Control {
            return Answer::refused("this user may watch and stop");
        }
        match &self.recording {
            None => Answer::refused("no recording is configured; give the service [log] path"),
            Some(recording) => match recording.set_recording(on) {
                Ok(()) => Answer::ok(if on { "recording" } else { "not recording" }),
                Err(bad) => refused(&bad),
            },
        }
    }

    fn control(&self, client: &Client) -> Value {
        let holder =
            self.lease.holding_process().map(|(pid, uid)| json!({ "pid": pid, "uid": uid }));
        json!({
            "role": client.role.name(),
            "yours": self.lease.is_held_by(client.number),
            "holder": holder,
        })
    }

    fn status(&self, client: &Client) -> Value {
        let Feed { table, lane } = &self.feed;
        let mut status = machine_status(&lane.status, table, &self.lanes, &self.context);
        status["protocol"] = json!(PROTOCOL_VERSION);
        status["taktil"] = json!(env!("CARGO_PKG_VERSION"));
        status["machine"] = self.about.clone();
        status["kernel"] = self.shared.attestation.get().cloned().unwrap_or_default();
        status["control"] = self.control(client);
        status["clients"] = json!(self.clients.len() + 1);
        status["recording"] = self.recording.as_ref().map(|r| r.report()).unwrap_or_default();
        status["records_lost"] = json!(self.shared.lost.load(Ordering::Relaxed));
        status
    }

    fn parameters(&self) -> Value {
        let Some(editor) = &self.editor else { return json!([]) };
        let parameter = |parameter: &Parameter| {
            let stem = parameter.name.split('[').next().unwrap_or_default();
            let set = self.set_values.iter().rev();
            let value = set
                .filter(|(name, _)| *name == parameter.name || *name == stem)
                .map(|(_, value)| *value)
                .next();
            json!({
                "name": parameter.name,
                "value": value.unwrap_or(parameter.initial),
                "low": parameter.low,
                "high": parameter.high,
            })
        };
        editor.parameters().iter().map(parameter).collect()
    }
}

/// Whether a request is a stop.
pub(super) fn is_stop(request: &Request) -> bool {
    matches!(request.word, Word::Machine(OperatorCommand::Request(Verb::Stop)))
}

fn refused(bad: &taktil_rtcore::Invalid) -> Answer {
    Answer::refused(format!("{}: {}; {}", bad.place, bad.what, bad.remedy))
}

/// Every word with what it does.
fn help() -> Value {
    let verbs: Vec<&str> = Verb::ALL[1..].iter().map(|verb| verb.name()).collect();
    json!({
        "verbs of the state machine": verbs,
        "stop": "controlled stop; heard from everyone",
        "jog joints|base|tool|outer A1 .. A6": "keys held, -1 to 1; said again every 10 ms",
        "release": "no keys held",
        "move joint Q1 .. QN [in S] [now]": "deg",
        "move to X Y Z [YAW PITCH ROLL] [straight] [in S] [now]": "mm, deg",
        "move by DX DY DZ [straight] [in S] [now]": "mm along the tool's axes",
        "pause | resume | clear": "the typed moves",
        "wait": "answered when the typed moves are done",
        "state": "one line",
        "status": "everything",
        "model": "the arm's frames and limits, for a drawing",
        "signals": "what can be watched",
        "watch HZ SIGNAL .. | watch off": "events at a rate",
        "scope CHANNEL .. trigger CHANNEL rises LEVEL before S after S": "or falls, above, below",
        "parameters": "with ranges and values",
        "set NAME VALUE ..": "one transaction",
        "fault list | fault reset": "latched faults",
        "record start | record stop": "the recording",
        "control [take | release]": "the control lease",
        "version": "of protocol and program",
    })
}
