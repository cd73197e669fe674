//! One viewer: its WebSocket, what it is subscribed to, and what it has taken. Nothing here waits
//! for it; what it does not take in time is replaced.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};
use std::net::TcpStream;

use serde_json::json;
use taktil_rtcore::Nanos;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

use super::channels::{advertisement, withdrawal};
use super::request::{SUBSCRIPTIONS_MAX, Subscription, ViewerRequest, read};
use super::source::ViewSource;
use crate::feed::Feed;
use crate::message::TRACES_MAX;
use crate::page::is_later;

/// Largest message of a viewer (bytes).
const MESSAGE_BYTES_MAX: usize = 1 << 16;
/// Bytes that may wait for one viewer: a list of all channels is the longest message.
const WAITING_BYTES_MAX: usize = 8 << 20;
/// Texts that may wait for one viewer; one for which there are more is disconnected.
const TEXTS_MAX: usize = 64;
/// Rounds of messages that a viewer has not yet confirmed.
const UNCONFIRMED_MAX: u64 = 2;
/// Messages that are read from one viewer in one turn.
const MESSAGES_PER_TURN_MAX: usize = 16;
/// Messages a second beyond which a viewer is disconnected: it may say each subscription alone.
const MESSAGES_PER_S_MAX: u32 = 500;
/// How long a viewer may be silent, with a question of ours unanswered.
const SILENCE_MAX: Nanos = Nanos::from_secs(20);
/// Time between two questions whether an idle viewer is there.
const PING_INTERVAL: Nanos = Nanos::from_secs(5);
/// First byte of a message with values.
const MESSAGE_DATA_OPCODE: u8 = 1;
/// Levels of a status.
const LEVEL_WARNING_NUMBER: u8 = 1;
/// The name under which a viewer is told that the machine is not there.
const LINK_STATUS: &str = "link";

/// A subscription, and which version of what is told once it has.
#[derive(Clone, Copy, Debug)]
struct Subscribed {
    channel: u32,
    told: u64,
}

/// A viewer that is connected.
pub(crate) struct ViewerClient {
    socket: WebSocket<TcpStream>,
    subscribed: BTreeMap<u32, Subscribed>,
    texts: VecDeque<String>,
    has_info: bool,
    /// The list of channels that it has, and their numbers.
    channels_version: u64,
    channels: Vec<u32>,
    link_version: u64,
    values_sent: u64,
    /// Rounds that it was sent and that it has confirmed; each ends with a ping.
    rounds: u64,
    confirmed: u64,
    second: Nanos,
    messages: u32,
    heard: Nanos,
    next_ping: Nanos,
    is_flushed: bool,
    is_over: bool,
}

impl ViewerClient {
    pub(crate) fn new(stream: TcpStream, early: Vec<u8>, now: Nanos) -> ViewerClient {
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_BYTES_MAX))
            .max_frame_size(Some(MESSAGE_BYTES_MAX))
            .max_write_buffer_size(WAITING_BYTES_MAX);
        let socket = WebSocket::from_partially_read(stream, early, Role::Server, Some(config));
        ViewerClient {
            socket,
            subscribed: BTreeMap::new(),
            texts: VecDeque::new(),
            has_info: false,
            channels_version: 0,
            channels: Vec::new(),
            link_version: 0,
            values_sent: 0,
            rounds: 0,
            confirmed: 0,
            second: now,
            messages: 0,
            heard: now,
            next_ping: now + PING_INTERVAL,
            is_flushed: true,
            is_over: false,
        }
    }

    pub(crate) fn stream(&self) -> &TcpStream {
        self.socket.get_ref()
    }

    pub(crate) fn wants_output(&self) -> bool {
        !self.is_flushed
    }

    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    /// Signals and fields that it wants beyond those that every page gets.
    pub(crate) fn wanted(&self, source: &ViewSource) -> Vec<String> {
        let channel = |id: u32| source.channels.iter().find(|channel| channel.id == id);
        let subscribed = self.subscribed.values().filter_map(|one| channel(one.channel));
        subscribed.filter_map(|channel| channel.content.wanted()).take(TRACES_MAX).collect()
    }

    /// Hears the viewer.
    pub(crate) fn hear(&mut self, source: &ViewSource, now: Nanos) {
        for _ in 0..MESSAGES_PER_TURN_MAX {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.heard = now;
                    self.take_request(text.as_str(), source, now);
                }
                Ok(Message::Pong(count)) => {
                    self.heard = now;
                    if let Ok(count) = <[u8; 8]>::try_from(&count[..]) {
                        let count = u64::from_le_bytes(count).min(self.rounds);
                        self.confirmed = self.confirmed.max(count);
                    }
                }
                Ok(Message::Close(_)) => self.is_over = true,
                Ok(Message::Binary(_)) => self.warn("viewers watch here and send no values"),
                Ok(_) => self.heard = now,
                Err(tungstenite::Error::Io(error)) if is_later(&error) => return,
                Err(_) => self.is_over = true,
            }
            if self.is_over {
                return;
            }
        }
    }

    fn warn(&mut self, text: &str) {
        let status = json!({ "op": "status", "level": LEVEL_WARNING_NUMBER, "message": text });
        self.texts.push_back(status.to_string());
    }

    fn take_request(&mut self, text: &str, source: &ViewSource, now: Nanos) {
        if now - self.second >= Nanos::from_secs(1) {
            (self.second, self.messages) = (now, 0);
        }
        self.messages += 1;
        if self.messages > MESSAGES_PER_S_MAX {
            self.is_over = true;
            return;
        }
        match read(text) {
            Ok(ViewerRequest::Subscribe(all)) => {
                for one in all {
                    self.subscribe(one, source);
                }
            }
            Ok(ViewerRequest::Unsubscribe(all)) => {
                for id in all {
                    self.subscribed.remove(&id);
                }
            }
            Err(why) => self.warn(why),
        }
    }

    fn subscribe(&mut self, wish: Subscription, source: &ViewSource) {
        let Subscription { id, channel } = wish;
        let wants = |channel: u32| {
            let found = source.channels.iter().find(|one| one.id == channel);
            found.is_some_and(|one| one.content.wanted().is_some())
        };
        let traces = self.subscribed.values().filter(|one| wants(one.channel)).count();
        if !self.channels.contains(&channel) {
            self.warn(&format!("there is no channel {channel}"));
        } else if self.subscribed.len() >= SUBSCRIPTIONS_MAX {
            self.warn("a viewer may have 64 subscriptions");
        } else if wants(channel) && traces >= TRACES_MAX {
            self.warn("a viewer may have 12 signals as they are; give one up");
        } else if let Entry::Vacant(place) = self.subscribed.entry(id) {
            place.insert(Subscribed { channel, told: 0 });
        } else {
            self.warn(&format!("subscription {id} is there already"));
        }
    }

    /// Sends what waits, and the newest values when the viewer has taken those before. `wall` is
    /// the wall clock, which stands in front of each message.
    pub(crate) fn send(&mut self, feed: &Feed, source: &mut ViewSource, now: Nanos) {
        if now - self.heard > SILENCE_MAX || self.texts.len() > TEXTS_MAX {
            self.is_over = true;
            return;
        }
        self.flush();
        if !self.is_flushed || self.is_over {
            return;
        }
        self.send_news(feed, source);
        while let Some(text) = self.texts.pop_front() {
            self.write(Message::text(text));
        }
        self.send_values(source);
        if now >= self.next_ping {
            self.next_ping = now + PING_INTERVAL;
            self.write(Message::Ping(self.rounds.to_le_bytes().to_vec().into()));
        }
        self.flush();
    }

    /// Tells of the server, of the machine and of channels, where they are new.
    fn send_news(&mut self, feed: &Feed, source: &ViewSource) {
        if !self.has_info {
            self.has_info = true;
            self.texts.push_front(source.server_info());
        }
        if self.link_version != feed.link.version {
            let had_link = self.link_version > 0;
            self.link_version = feed.link.version;
            let text = match feed.is_up() {
                true if had_link => json!({ "op": "removeStatus", "statusIds": [LINK_STATUS] }),
                true => serde_json::Value::Null,
                false => json!({ "op": "status", "level": LEVEL_WARNING_NUMBER,
                    "message": "the machine is not there", "id": LINK_STATUS }),
            };
            if !text.is_null() {
                self.texts.push_back(text.to_string());
            }
        }
        if self.channels_version != source.channels_version {
            self.channels_version = source.channels_version;
            if !self.channels.is_empty() {
                self.texts.push_back(withdrawal(&self.channels));
                self.subscribed.clear();
            }
            self.channels = source.channels.iter().map(|channel| channel.id).collect();
            self.texts.push_back(advertisement(&source.channels));
        }
    }

    fn send_values(&mut self, source: &mut ViewSource) {
        if self.rounds - self.confirmed >= UNCONFIRMED_MAX || source.values_version == 0 {
            return;
        }
        let has_new_values = source.values_version > self.values_sent;
        let told_version = source.told_version;
        let mut messages = Vec::new();
        for (id, one) in &mut self.subscribed {
            let channel = source.channels.iter().find(|channel| channel.id == one.channel);
            let is_told_once = channel.is_some_and(|channel| channel.content.is_told_once());
            let is_due = if is_told_once { one.told < told_version } else { has_new_values };
            if !is_due {
                continue;
            }
            if let Some(message) = source.message(one.channel) {
                one.told = told_version;
                let mut bytes = Vec::with_capacity(13 + message.body.len());
                bytes.push(MESSAGE_DATA_OPCODE);
                bytes.extend_from_slice(&id.to_le_bytes());
                bytes.extend_from_slice(&message.at.0.to_le_bytes());
                bytes.extend_from_slice(&message.body);
                messages.push(Message::binary(bytes));
            }
        }
        self.values_sent = source.values_version;
        if messages.is_empty() {
            return;
        }
        for message in messages {
            self.write(message);
        }
        // Whoever answers this ping has taken what came before it.
        self.rounds += 1;
        self.write(Message::Ping(self.rounds.to_le_bytes().to_vec().into()));
    }

    fn write(&mut self, message: Message) {
        if self.is_over {
            return;
        }
        match self.socket.write(message) {
            Ok(()) => self.is_flushed = false,
            Err(tungstenite::Error::Io(error)) if is_later(&error) => self.is_flushed = false,
            Err(_) => self.is_over = true,
        }
    }

    fn flush(&mut self) {
        if self.is_over {
            return;
        }
        match self.socket.flush() {
            Ok(()) => self.is_flushed = true,
            Err(tungstenite::Error::Io(error)) if is_later(&error) => self.is_flushed = false,
            Err(_) => self.is_over = true,
        }
    }
}
