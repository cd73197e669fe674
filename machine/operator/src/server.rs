//! The server's turns: hear, carry out stops, take in records, answer, serve lines, write. No turn
//! waits for anybody, and the work of one is bounded.

mod commands;

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use serde_json::Value;
use taktil_machine::operator::command::CommandContext;
use taktil_rtcore::live::Heartbeat;
use taktil_rtcore::parameter::Editor;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::record_ring::RecordReader;
use taktil_rtcore::{Nanos, linux};
use taktil_signal::JogFrame;

use commands::is_stop;

use crate::access::{AccessPolicy, Peer, Role};
use crate::answer::Answer;
use crate::client::Client;
use crate::lease::ControlLease;
use crate::listener::Listener;
use crate::motion::{LaneChannel, ServerClock};
use crate::request::{self, Request};
use crate::setup::{RecordingControl, ServerSetup, SharedState};
use crate::signals::SignalTable;
use crate::status::LaneTiming;

/// Clients that are served.
const SERVED_MAX: usize = 16;
/// Connections beyond those, of which only `stop` is heard.
const STOP_ONLY_MAX: usize = 112;
/// Connections that are accepted in one turn.
const ACCEPTED_PER_TURN_MAX: usize = 16;
/// Lines of one client that are served in one turn.
const LINES_PER_TURN_MAX: usize = 16;
/// A served client that has been idle for this long gives its place to a new one.
const IDLE_GIVES_WAY: Nanos = Nanos::from_secs(5);
/// A client without a place that says nothing for this long is disconnected.
const STOP_ONLY_IDLE_MAX: Nanos = Nanos::from_secs(60);
/// A served client that says nothing and watches nothing for this long is disconnected.
const IDLE_MAX: Nanos = Nanos::from_secs(600);
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
    lanes: Vec<LaneTiming>,
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
            lanes: LaneTiming::of(&catalog, shared.lateness.clone()),
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
            self.turn(&mut reader, linux::monotonic());
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
    fn turn(&mut self, reader: &mut RecordReader, now: Nanos) {
        self.accept(now);
        for client in &mut self.clients {
            for _ in 0..client.read(now) {
                let sequence = self.feed.lane.stop();
                client.early_stops.push_back((sequence, now));
            }
        }
        reader.drain(&mut FeedObserver { feed: &mut self.feed, clients: &mut self.clients });
        let mut clients = std::mem::take(&mut self.clients);
        for (place, client) in clients.iter_mut().enumerate() {
            self.serve_client(client, place < SERVED_MAX, now);
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
        if self.feed.lane.has_sent {
            self.shared.has_intervened.store(true, Ordering::Relaxed);
        }
    }

    /// Accepts connections. Where all places are taken one that has been idle gives way.
    fn accept(&mut self, now: Nanos) {
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
    fn make_room(&mut self, now: Nanos) {
        let idle = |client: &Client| {
            let is_busy = client.pending.is_some() || client.watch.is_some();
            let quiet = now - client.heard;
            (!is_busy && !self.lease.is_held_by(client.number)).then_some(quiet)
        };
        let longest = |from: usize, to: usize, least: Nanos| {
            let candidates = self.clients.iter().enumerate().take(to).skip(from);
            let idle = candidates.filter_map(|(at, client)| Some((at, idle(client)?)));
            idle.filter(|(_, quiet)| *quiet >= least).max_by_key(|(_, quiet)| *quiet)
        };
        let full = self.clients.len() >= SERVED_MAX + STOP_ONLY_MAX;
        let beyond = || longest(SERVED_MAX, self.clients.len(), Nanos::ZERO);
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
    fn serve_client(&mut self, client: &mut Client, has_place: bool, now: Nanos) {
        for _ in 0..LINES_PER_TURN_MAX {
            if let Some((id, pending)) = client.pending.clone() {
                self.lease.keep(client.number, now);
                let origin = Nanos(self.shared.origin_ns.load(Ordering::Relaxed));
                let clock = ServerClock { now, origin };
                let Feed { lane, table } = &mut self.feed;
                match lane.answer_to(client.number, &pending, clock, &self.context, table) {
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
                    self.carry_out(client, request, now);
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

    fn dismiss_idle(&self, client: &mut Client, has_place: bool, now: Nanos) {
        let quiet = now - client.heard;
        let limit = if has_place { IDLE_MAX } else { STOP_ONLY_IDLE_MAX };
        if quiet > limit && client.watch.is_none() && client.scope.is_none() {
            client.dismiss("nothing was said for too long");
        }
    }

    fn send_events(&self, client: &mut Client, now: Nanos) {
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
}

#[cfg(test)]
mod tests;
