//! The server's turns: hear, carry out stops, take in records, answer, serve lines, write. No turn
//! waits for anybody, and the work of one is bounded.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use serde_json::{Value, json};
use taktil_machine::operator::command::{CommandContext, OperatorCommand};
use taktil_rtcore::live::Heartbeat;
use taktil_rtcore::parameter::{Editor, Transaction};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::record_ring::RecordReader;
use taktil_rtcore::{Nanos, linux};
use taktil_signal::{JogFrame, OperatorMove, Verb};

use crate::PROTOCOL_VERSION;
use crate::access::{AccessPolicy, Peer, Role};
use crate::answer::Answer;
use crate::client::Client;
use crate::lease::ControlLease;
use crate::listener::Listener;
use crate::motion::{LaneChannel, Pending};
use crate::request::{self, Request, Word};
use crate::scope::Scope;
use crate::signals::SignalTable;
use crate::status::{faults, machine_status};
use crate::thread::{RecordingControl, ServerSetup, SharedState};
use crate::watch::Watch;

/// Clients that are served.
const SERVED_MAX: usize = 16;
/// Connections beyond those, of which only `stop` is heard.
const STOP_ONLY_MAX: usize = 112;
/// Connections that are accepted in one turn.
const ACCEPTED_PER_TURN_MAX: usize = 16;
/// Lines of one client that are served in one turn.
const LINES_PER_TURN_MAX: usize = 16;
/// A served client that has been idle for this long gives its place to a new one.
const IDLE_GIVES_WAY: Duration = Duration::from_secs(5);
/// A client without a place that says nothing for this long is disconnected.
const STOP_ONLY_IDLE_MAX: Duration = Duration::from_secs(60);
/// A served client that says nothing and watches nothing for this long is disconnected.
const IDLE_MAX: Duration = Duration::from_secs(600);
/// Pause between two turns: bounds what a flood of lines may cost.
const TURN_PAUSE: Duration = Duration::from_millis(1);
/// Longest wait for somebody to say something, with clients and without (ms).
const WAIT_WITH_CLIENTS_MS: u16 = 2;
const WAIT_ALONE_MS: u16 = 20;

/// What the records change.
struct Feed {
    table: SignalTable,
    lane: LaneChannel,
}

/// The server, in its thread.
pub(crate) struct Server {
    listener: Listener,
    policy: AccessPolicy,
    catalog: Catalog,
    context: CommandContext,
    about: Value,
    recording: Option<Arc<dyn RecordingControl>>,
    editor: Option<Editor>,
    /// Values of parameters that were set, by name.
    set_values: Vec<(String, f64)>,
    feed: Feed,
    lease: ControlLease,
    clients: Vec<Client>,
    next_number: u64,
    shared: Arc<SharedState>,
}

/// Takes records in for the server and for the captures of its clients.
struct FeedObserver<'a> {
    feed: &'a mut Feed,
    clients: &'a mut [Client],
}

impl Observer for FeedObserver<'_> {
    fn record(&mut self, record: &Record<'_>) {
        self.feed.table.record(record);
        self.feed.lane.record(record);
        for scope in self.clients.iter_mut().filter_map(|client| client.scope.as_mut()) {
            scope.record(record, &self.feed.table);
        }
    }
}

impl Server {
    pub(crate) fn new(
        listener: Listener,
        policy: AccessPolicy,
        setup: ServerSetup,
        catalog: Catalog,
        editor: Option<Editor>,
        shared: Arc<SharedState>,
    ) -> Server {
        let ServerSetup { sender, context, about, recording } = setup;
        let feed =
            Feed { table: SignalTable::new(&catalog), lane: LaneChannel::new(sender, &catalog) };
        let (set_values, lease, clients) = (Vec::new(), ControlLease::default(), Vec::new());
        Server {
            listener,
            policy,
            catalog,
            context,
            about,
            recording,
            editor,
            set_values,
            feed,
            lease,
            clients,
            next_number: 0,
            shared,
        }
    }

    /// Serves until the other end is dropped.
    pub(crate) fn serve(&mut self, mut reader: RecordReader, heartbeat: &Heartbeat) {
        while !self.shared.is_ended.load(Ordering::Relaxed) {
            self.wait();
            heartbeat.beat();
            self.turn(&mut reader, Instant::now());
            std::thread::sleep(TURN_PAUSE);
        }
    }

    /// Waits until somebody says something, or for a few milliseconds.
    fn wait(&self) {
        let mut polled = vec![PollFd::new(self.listener.socket().as_fd(), PollFlags::POLLIN)];
        for client in &self.clients {
            let mut flags = PollFlags::empty();
            flags.set(PollFlags::POLLIN, client.wants_input() && !client.has_line());
            flags.set(PollFlags::POLLOUT, client.wants_output());
            polled.push(PollFd::new(client.stream().as_fd(), flags));
        }
        let alone = self.clients.is_empty();
        let timeout = if alone { WAIT_ALONE_MS } else { WAIT_WITH_CLIENTS_MS };
        // An interrupted wait is a short one.
        let _ = poll(&mut polled, PollTimeout::from(timeout));
    }

    /// One turn.
    fn turn(&mut self, reader: &mut RecordReader, now: Instant) {
        self.accept(now);
        let received = linux::monotonic();
        for client in &mut self.clients {
            for _ in 0..client.read(now) {
                let sequence = self.feed.lane.stop();
                client.early_stops.push_back(sequence);
            }
        }
        reader.drain(&mut FeedObserver { feed: &mut self.feed, clients: &mut self.clients });
        let mut clients = std::mem::take(&mut self.clients);
        for (place, client) in clients.iter_mut().enumerate() {
            self.serve_client(client, place < SERVED_MAX, (now, received));
            self.send_events(client, now);
            client.flush(now);
        }
        clients.retain(|client| {
            if client.is_over() {
                self.forget(client);
            }
            !client.is_over()
        });
        self.clients = clients;
        self.feed.lane.send_next(now);
    }

    /// Accepts connections. Where all places are taken one that has been idle gives way.
    fn accept(&mut self, now: Instant) {
        for _ in 0..ACCEPTED_PER_TURN_MAX {
            let Some(stream) = self.listener.accept() else { return };
            let Some(peer) = Peer::of(&stream) else { continue };
            let role = self.policy.role(&peer);
            self.next_number += 1;
            let mut client = Client::new(self.next_number, (stream, peer, role), now);
            if role == Role::None {
                client.dismiss("this user may neither control nor view; ask for a group");
                client.flush(now);
                continue;
            }
            if self.clients.len() >= SERVED_MAX {
                self.make_room(now);
            }
            self.clients.push(client);
        }
    }

    /// Disconnects a client that has nothing to do, if there is one: a served one that has been
    /// idle for some time, and beyond all places the one that was heard last the longest ago.
    fn make_room(&mut self, now: Instant) {
        let idle = |client: &Client| {
            let is_busy = client.pending.is_some() || client.watch.is_some();
            let quiet = now.saturating_duration_since(client.heard);
            (!is_busy && !self.lease.is_held_by(client.number)).then_some(quiet)
        };
        let longest = |from: usize, to: usize, least: Duration| {
            let candidates = self.clients.iter().enumerate().take(to).skip(from);
            let idle = candidates.filter_map(|(at, client)| Some((at, idle(client)?)));
            idle.filter(|(_, quiet)| *quiet >= least).max_by_key(|(_, quiet)| *quiet)
        };
        let full = self.clients.len() >= SERVED_MAX + STOP_ONLY_MAX;
        let beyond = || longest(SERVED_MAX, self.clients.len(), Duration::ZERO);
        let found = longest(0, SERVED_MAX, IDLE_GIVES_WAY).or_else(|| beyond().filter(|_| full));
        if let Some((at, _)) = found {
            let mut client = self.clients.remove(at);
            client.dismiss("somebody else needed the place of a client that said nothing");
            client.flush(now);
            self.forget(&client);
        }
    }

    /// The client has gone: it commands no more, and holds no keys.
    fn forget(&mut self, client: &Client) {
        self.feed.lane.forget(client.number);
        if self.lease.release(client.number) {
            self.feed.lane.jog([0.0; 6], JogFrame::Joints);
        }
    }

    /// Answers what can be answered, then carries out further lines.
    fn serve_client(
        &mut self,
        client: &mut Client,
        has_place: bool,
        (now, received): (Instant, Nanos),
    ) {
        for _ in 0..LINES_PER_TURN_MAX {
            if let Some((id, pending)) = client.pending.clone() {
                self.lease.keep(client.number, now);
                let origin = Nanos(self.shared.origin_ns.load(Ordering::Relaxed));
                let clock = (now, origin);
                match self.feed.lane.answer_to(client.number, &pending, clock, &self.context) {
                    None => return,
                    Some(answer) => client.answer(id.as_ref(), &answer),
                }
            }
            let Some(line) = client.line(now) else {
                self.dismiss_idle(client, has_place, now);
                return;
            };
            self.lease.keep(client.number, now);
            match request::read(&line, &self.context) {
                Ok(None) => {}
                Ok(Some(request)) if has_place || is_stop(&request) => {
                    self.carry_out(client, request, (now, received));
                }
                Ok(Some(Request { id, .. })) => {
                    let why = "too many operators are connected; only `stop` is heard here";
                    client.answer(id.as_ref(), &Answer::error(why));
                }
                Err(bad) => {
                    let why = bad.why;
                    let place =
                        if why.place.is_empty() { why.place } else { format!("{}: ", why.place) };
                    let text = format!("{place}{}; {}", why.what, why.remedy);
                    client.answer(bad.id.as_ref(), &Answer::refused(text));
                }
            }
        }
    }

    fn dismiss_idle(&self, client: &mut Client, has_place: bool, now: Instant) {
        let quiet = now.saturating_duration_since(client.heard);
        let limit = if has_place { IDLE_MAX } else { STOP_ONLY_IDLE_MAX };
        if quiet > limit && client.watch.is_none() && client.scope.is_none() {
            client.dismiss("nothing was said for too long");
        }
    }

    fn send_events(&self, client: &mut Client, now: Instant) {
        let is_behind = client.is_behind();
        let watched = client.watch.as_mut();
        if let Some(event) = watched.and_then(|w| w.event(now, is_behind, &self.feed.table)) {
            client.event(&event);
        }
        let lost = u64::try_from(self.shared.lost.load(Ordering::Relaxed)).unwrap_or(0);
        if let Some(event) = client.scope.as_ref().and_then(|scope| scope.event(lost)) {
            client.scope = None;
            client.event(&event);
        }
    }

    fn carry_out(
        &mut self,
        client: &mut Client,
        Request { id, word }: Request,
        (now, received): (Instant, Nanos),
    ) {
        let told = match word {
            Word::Machine(OperatorCommand::Request(Verb::Stop)) => {
                // The stop itself was carried out when its line came in.
                let sequence = client.early_stops.pop_front();
                let sequence = sequence.unwrap_or_else(|| self.feed.lane.stop());
                Err(Pending::Stop { sequence, received, since: now })
            }
            Word::Machine(OperatorCommand::State) => {
                Ok(Answer::ok(self.feed.lane.state_line(&self.context)))
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
    fn tell(&mut self, client: &mut Client, word: Word, now: Instant) -> Answer {
        match word {
            Word::Status => Answer::data(self.status(client)),
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
            Word::FaultList => Answer::data(faults(&self.feed.lane.status)),
            Word::ControlState => Answer::data(self.control(client)),
            Word::Help => Answer::data(help()),
            _ => Answer::data(json!({
                "protocol": PROTOCOL_VERSION,
                "taktil": env!("CARGO_PKG_VERSION"),
            })),
        }
    }

    /// Whether the client may command now; it then has the control lease.
    fn command(&mut self, client: &Client, now: Instant) -> Result<(), Answer> {
        if client.role < Role::Control {
            let text = "this user may watch and stop; members of the control group may command";
            return Err(Answer::refused(text));
        }
        let (number, peer) = (client.number, (client.peer.pid, client.peer.uid));
        self.lease.take(number, peer, now).map_err(Answer::refused)
    }

    fn jog(
        &mut self,
        client: &mut Client,
        axes: [f64; 6],
        frame: JogFrame,
        now: Instant,
    ) -> Answer {
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
        now: Instant,
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

    fn set(&mut self, client: &Client, values: Vec<(String, f64)>, now: Instant) -> Answer {
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
        let holder = self.lease.holder().map(|(pid, uid)| json!({ "pid": pid, "uid": uid }));
        json!({
            "role": client.role.name(),
            "yours": self.lease.is_held_by(client.number),
            "holder": holder,
        })
    }

    fn status(&self, client: &Client) -> Value {
        let Feed { table, lane } = &self.feed;
        let mut status = machine_status(&lane.status, table, &self.catalog, &self.context);
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
        let parameter = |parameter: &taktil_rtcore::parameter::Parameter| {
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

fn is_stop(request: &Request) -> bool {
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
        "move joint Q1 .. QN | to X Y Z [YAW PITCH ROLL] | by DX DY DZ": "deg, mm; [straight] [in S] [now]",
        "pause | resume | clear": "the typed moves",
        "wait": "answered when the typed moves are done",
        "state": "one line",
        "status": "everything",
        "signals": "what can be watched",
        "watch HZ SIGNAL .. | watch off": "events at a rate",
        "scope CHANNEL .. trigger CHANNEL rises|falls|above|below LEVEL before S after S": "one event",
        "parameters": "with ranges and values",
        "set NAME VALUE ..": "one transaction",
        "fault list | fault reset": "latched faults",
        "record start | record stop": "the recording",
        "control [take | release]": "the control lease",
        "version": "of protocol and program",
    })
}

#[cfg(test)]
mod tests;
