//! One page: its WebSocket, what it may do, what it has seen, and its own connection to the
//! machine. Nothing here waits for the browser; what it does not take in time is replaced.

use std::collections::VecDeque;
use std::io::ErrorKind;
use std::net::TcpStream;
use std::path::Path;

use serde_json::{Value, json};
use taktil_machine_client::OperatorSocket;
use taktil_rtcore::Nanos;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

use crate::feed::{Document, Feed};
use crate::hold::{Hold, HoldAction};
use crate::message::{PageMessage, is_for_viewers, is_stop, read_message};
use crate::token::ControlToken;

/// Largest message of a page (bytes).
const MESSAGE_BYTES_MAX: usize = 1 << 16;
/// Bytes that may wait for one page: the answer to `scope` is the longest message.
const WAITING_BYTES_MAX: usize = 8 << 20;
/// Answers that may wait for one page; a page for which there are more is disconnected.
const ANSWERS_MAX: usize = 64;
/// Updates that a page has not yet said to have seen.
const UNSEEN_MAX: u64 = 2;
/// Messages that are read from one page in one turn.
const MESSAGES_PER_TURN_MAX: usize = 16;
/// Messages a second that are served, a stop and `seen` apart.
const MESSAGES_PER_S_MAX: u32 = 60;
/// Wrong tokens after which a page is disconnected.
const WRONG_TOKENS_MAX: u32 = 3;
/// How long a page may be silent, with a question of ours unanswered.
const SILENCE_MAX: Nanos = Nanos::from_secs(20);
/// Time between two questions whether the page is there.
const PING_INTERVAL: Nanos = Nanos::from_secs(5);
/// The name under which held keys are repeated.
const HOLD_ID: &str = "hold";

/// A page that is connected.
pub(crate) struct Page {
    pub(crate) number: u64,
    socket: WebSocket<TcpStream>,
    /// Its own connection to the machine, once it has said something.
    line: Option<OperatorSocket>,
    may_command: bool,
    wrong_tokens: u32,
    hold: Hold,
    /// The last thing that the machine said about held keys.
    hold_text: String,
    answers: VecDeque<String>,
    /// Versions of the documents that it was sent.
    sent: Vec<u64>,
    values_sent: u64,
    /// Updates that it was sent, has seen, and that were replaced before it took them.
    updates: u64,
    seen: u64,
    dropped: u64,
    pub(crate) wanted: Vec<String>,
    second: Nanos,
    messages: u32,
    heard: Nanos,
    next_ping: Nanos,
    is_flushed: bool,
    is_over: bool,
}

impl Page {
    pub(crate) fn new(number: u64, stream: TcpStream, early: Vec<u8>, now: Nanos) -> Page {
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_BYTES_MAX))
            .max_frame_size(Some(MESSAGE_BYTES_MAX))
            .max_write_buffer_size(WAITING_BYTES_MAX);
        let socket = WebSocket::from_partially_read(stream, early, Role::Server, Some(config));
        Page {
            number,
            socket,
            line: None,
            may_command: false,
            wrong_tokens: 0,
            hold: Hold::default(),
            hold_text: String::new(),
            answers: VecDeque::new(),
            sent: Vec::new(),
            values_sent: 0,
            updates: 0,
            seen: 0,
            dropped: 0,
            wanted: Vec::new(),
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

    pub(crate) fn line(&self) -> Option<&OperatorSocket> {
        self.line.as_ref()
    }

    pub(crate) fn has_line(&self) -> bool {
        self.line.is_some()
    }

    pub(crate) fn wants_output(&self) -> bool {
        !self.is_flushed
    }

    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    /// When its held keys are due.
    pub(crate) fn due(&self) -> Option<Nanos> {
        self.hold.due()
    }

    /// Hears the page. `has_free_line` says whether it may open a connection to the machine.
    pub(crate) fn hear(&mut self, services: &mut Services<'_>, now: Nanos) {
        for _ in 0..MESSAGES_PER_TURN_MAX {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.heard = now;
                    self.take_message(text.as_str(), services, now);
                }
                Ok(Message::Close(_)) => return self.end(),
                Ok(Message::Binary(_)) => {
                    self.answers.push_back(complaint(None, "messages are text"));
                }
                Ok(_) => self.heard = now,
                Err(tungstenite::Error::Io(error)) if is_later(&error) => return,
                Err(_) => return self.end(),
            }
            if self.is_over {
                return;
            }
        }
    }

    /// The page has gone: its keys are let go of with its connection.
    fn end(&mut self) {
        self.is_over = true;
        self.line = None;
    }

    fn is_too_fast(&mut self, now: Nanos) -> bool {
        if now - self.second >= Nanos::from_secs(1) {
            (self.second, self.messages) = (now, 0);
        }
        self.messages += 1;
        self.messages > MESSAGES_PER_S_MAX
    }

    fn take_message(&mut self, text: &str, services: &mut Services<'_>, now: Nanos) {
        let message = match read_message(text) {
            Ok(message) => message,
            Err(why) => {
                if self.is_too_fast(now) {
                    return self.end();
                }
                return self.answers.push_back(complaint(None, why));
            }
        };
        match message {
            PageMessage::Seen(number) => self.seen = self.seen.max(number.min(self.updates)),
            PageMessage::Say { id, words } if is_stop(&words) => {
                self.hold.release();
                if !services.feed.stop(self.number, id, now) {
                    let text = "the machine does not hear; use the emergency stop";
                    self.answers.push_back(answer(id, "error", text));
                }
            }
            PageMessage::Token { id, .. }
            | PageMessage::Trace { id, .. }
            | PageMessage::Say { id, .. }
                if self.is_too_fast(now) =>
            {
                let text = "more than 60 messages a second; say less";
                self.answers.push_back(answer(id, "refused", text));
            }
            PageMessage::Token { id, token } => self.check_token(id, &token, services.token),
            PageMessage::Trace { id, paths } => self.trace(id, paths, services.feed),
            PageMessage::Say { id, words } => self.say(id, words, services, now),
        }
    }

    fn check_token(&mut self, id: u64, offered: &str, token: &ControlToken) {
        if token.is_matched_by(offered) {
            self.may_command = true;
            return self.answers.push_back(answer(id, "ok", "this page may command"));
        }
        self.wrong_tokens += 1;
        if self.wrong_tokens >= WRONG_TOKENS_MAX {
            return self.end();
        }
        self.answers.push_back(answer(id, "refused", "this is not the token"));
    }

    fn trace(&mut self, id: u64, paths: Vec<String>, feed: &Feed) {
        match paths.iter().find(|path| !feed.has_signal(path)) {
            None => {
                self.wanted = paths;
                self.answers.push_back(answer(id, "ok", ""));
            }
            Some(path) => {
                let text = format!("{path}: there is no such signal");
                self.answers.push_back(answer(id, "refused", &text));
            }
        }
    }

    fn say(&mut self, id: u64, words: String, services: &mut Services<'_>, now: Nanos) {
        if !self.may_command && !is_for_viewers(&words) {
            let text = "this page may watch and stop; give it the control token to command";
            return self.answers.push_back(answer(id, "refused", text));
        }
        if self.line.is_none() {
            if !services.has_free_line {
                let text = "too many pages speak to the machine; close one";
                return self.answers.push_back(answer(id, "refused", text));
            }
            match OperatorSocket::connect(services.path) {
                Ok(line) => self.line = Some(line),
                Err(_) => {
                    let text = "nobody listens: the run has ended, or the service";
                    return self.answers.push_back(answer(id, "error", text));
                }
            }
        }
        if words.starts_with("jog ") {
            if !self.hold.press(words, id, now) {
                let text = "the page was silent with keys held; let go and press again";
                self.answers.push_back(answer(id, "refused", text));
            }
            return;
        }
        if words == "release" {
            self.hold.release();
        }
        self.send_line(&json!({ "id": id, "say": words }).to_string());
    }

    fn send_line(&mut self, text: &str) {
        let sent = self.line.as_mut().is_some_and(|line| line.send(text).is_ok());
        if !sent {
            self.lose_line();
        }
    }

    fn lose_line(&mut self) {
        self.hold.release();
        let waiting = self.hold.answered(false);
        if self.line.take().is_some() {
            let text = "the machine has hung up; what was asked last may not be done";
            self.answers.extend(waiting.into_iter().map(|id| answer(id, "error", text)));
            let event = json!({ "event": "lost", "text": text });
            self.answers.push_back(event.to_string());
        }
    }

    /// Repeats held keys, and passes on what the machine answered. Returns whether a parameter may
    /// have been set.
    pub(crate) fn serve(&mut self, now: Nanos) -> bool {
        match self.hold.action(now) {
            HoldAction::Nothing => {}
            HoldAction::Repeat(words) => {
                self.send_line(&json!({ "id": HOLD_ID, "say": words }).to_string());
            }
            HoldAction::Release => {
                self.send_line(&json!({ "id": HOLD_ID, "say": "release" }).to_string());
                self.answers.push_back(
                    json!({ "event": "jog", "text": "the page fell silent with keys held" })
                        .to_string(),
                );
            }
        }
        let mut has_set = false;
        for _ in 0..ANSWERS_MAX {
            let Some(line) = &mut self.line else { break };
            match line.flush().and_then(|()| line.receive()) {
                Ok(None) => break,
                Ok(Some(text)) => has_set |= self.take_answer(text),
                Err(_) => self.lose_line(),
            }
        }
        has_set
    }

    fn take_answer(&mut self, text: String) -> bool {
        if !text.starts_with('{') {
            // A sentence without a number is the machine's last one before it hangs up.
            let event = json!({ "event": "lost", "text": text });
            self.answers.push_back(event.to_string());
            return false;
        }
        let has_set = text.contains("\"at_ns\"");
        if !text.contains("\"id\":\"hold\"") {
            self.answers.push_back(text);
            return has_set;
        }
        let Ok(told) = serde_json::from_str::<Value>(&text) else { return false };
        let outcome = told["outcome"].as_str().unwrap_or("error");
        let said = told["text"].as_str().unwrap_or_default();
        for id in self.hold.answered(outcome == "ok") {
            self.answers.push_back(answer(id, outcome, said));
        }
        if self.hold_text != said {
            said.clone_into(&mut self.hold_text);
            let event = json!({ "event": "jog", "text": said });
            self.answers.push_back(event.to_string());
        }
        false
    }

    /// Gives the page an answer that came another way.
    pub(crate) fn push_answer(&mut self, text: String) {
        self.answers.push_back(text);
    }

    /// Sends what waits, and the newest values when the page has taken those before.
    pub(crate) fn send(&mut self, feed: &Feed, now: Nanos) {
        if now - self.heard > SILENCE_MAX || self.answers.len() > ANSWERS_MAX {
            return self.end();
        }
        self.flush();
        if !self.is_flushed || self.is_over {
            return;
        }
        while let Some(text) = self.answers.pop_front() {
            self.write(Message::text(text));
        }
        let documents = std::iter::once(&feed.link).chain(&feed.documents);
        self.sent.resize(1 + feed.documents.len(), 0);
        for (at, document) in documents.enumerate() {
            if document.version > self.sent[at] {
                self.sent[at] = document.version;
                self.write(Message::text(document.text.clone()));
            }
        }
        self.send_values(&feed.values);
        if now >= self.next_ping {
            self.next_ping = now + PING_INTERVAL;
            self.write(Message::Ping(Vec::new().into()));
        }
        self.flush();
    }

    fn send_values(&mut self, values: &Document) {
        let is_new = values.version > self.values_sent;
        if !is_new || self.updates - self.seen >= UNSEEN_MAX {
            return;
        }
        if self.values_sent > 0 {
            self.dropped += values.version - self.values_sent - 1;
        }
        self.values_sent = values.version;
        self.updates += 1;
        let (number, dropped) = (self.updates, self.dropped);
        // The values are the machine's own text; to read and write them again would cost more.
        let text = format!(
            "{{\"event\":\"update\",\"number\":{number},\"dropped\":{dropped},\"watch\":{}}}",
            values.text
        );
        self.write(Message::text(text));
    }

    fn write(&mut self, message: Message) {
        if self.is_over {
            return;
        }
        match self.socket.write(message) {
            Ok(()) => self.is_flushed = false,
            Err(tungstenite::Error::Io(error)) if is_later(&error) => self.is_flushed = false,
            Err(_) => self.end(),
        }
    }

    fn flush(&mut self) {
        if self.is_over {
            return;
        }
        match self.socket.flush() {
            Ok(()) => self.is_flushed = true,
            Err(tungstenite::Error::Io(error)) if is_later(&error) => self.is_flushed = false,
            Err(_) => self.end(),
        }
    }
}

/// What a page needs of its server while it is heard.
pub(crate) struct Services<'a> {
    pub(crate) feed: &'a mut Feed,
    pub(crate) token: &'a ControlToken,
    pub(crate) path: &'a Path,
    /// Whether one more connection to the machine may be opened.
    pub(crate) has_free_line: bool,
}

/// Whether an error only says that nothing can be read or written yet.
pub(crate) fn is_later(error: &std::io::Error) -> bool {
    [ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&error.kind())
}

fn answer(id: u64, outcome: &str, text: &str) -> String {
    json!({ "id": id, "outcome": outcome, "text": text }).to_string()
}

fn complaint(id: Option<u64>, why: &str) -> String {
    json!({ "id": id, "outcome": "refused", "text": why }).to_string()
}
