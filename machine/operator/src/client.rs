//! One connection: bytes in, bytes out, what it waits for, and how fast it may talk. Nothing here
//! waits for the other side.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;

use serde_json::Value;
use taktil_rtcore::{Nanos, linux};

use crate::access::{Peer, Role};
use crate::answer::{Answer, event_line};
use crate::motion::Pending;
use crate::request::{LINE_BYTES_MAX, is_stop};
use crate::scope::Scope;
use crate::watch::Watch;

/// Bytes of lines that may wait to be served; a client that sends more is disconnected.
const INPUT_BYTES_MAX: usize = 2 * LINE_BYTES_MAX;
/// Bytes of one client that are read in one turn: bounds the work of a turn.
const TURN_BYTES_MAX: usize = 4096;
/// Bytes that may wait to be read by the client; one for which more accumulates is disconnected.
const OUTPUT_BYTES_MAX: usize = 1 << 20;
/// Bytes that may wait before events are left out.
const OUTPUT_BYTES_BEHIND: usize = 1 << 16;
/// A client that reads nothing of what waits for it for this long is disconnected.
const WRITE_STALL_MAX: Nanos = Nanos::from_secs(10);
/// Lines a second that are served, and how many at once after a pause.
const LINES_PER_S: f64 = 50.0;
/// Lines a second of held keys, which are repeated.
const KEY_LINES_PER_S: f64 = 250.0;

/// A bucket of tokens that fills at a rate.
#[derive(Debug)]
struct TokenBucket {
    rate_per_s: f64,
    tokens: f64,
    filled: Nanos,
}

impl TokenBucket {
    fn new(rate_per_s: f64, now: Nanos) -> TokenBucket {
        TokenBucket { rate_per_s, tokens: rate_per_s, filled: now }
    }

    /// Takes a token, if there is one.
    fn take(&mut self, now: Nanos) -> bool {
        let passed = (now - self.filled).as_secs_f64();
        self.tokens = (self.tokens + passed * self.rate_per_s).min(self.rate_per_s);
        self.filled = now;
        let has_one = self.tokens >= 1.0;
        self.tokens -= f64::from(has_one);
        has_one
    }
}

/// A connection.
#[derive(Debug)]
pub(crate) struct Client {
    pub(crate) number: u64,
    pub(crate) role: Role,
    pub(crate) peer: Peer,
    stream: UnixStream,
    input: Vec<u8>,
    /// Bytes of the input that were looked through for stops.
    looked_through: usize,
    output: VecDeque<u8>,
    /// The answer that it waits for, and the number under which to give it.
    pub(crate) pending: Option<(Option<Value>, Pending)>,
    /// Stops that were carried out before their line's turn came: sequence number, and when the
    /// line had come in.
    pub(crate) early_stops: VecDeque<(u32, Nanos)>,
    pub(crate) watch: Option<Watch>,
    pub(crate) scope: Option<Scope>,
    /// It last spoke in JSON.
    speaks_json: bool,
    /// A line from before this turn has not been answered yet.
    pub(crate) has_backlog: bool,
    /// It has closed its sending side.
    pub(crate) is_closed: bool,
    is_lost: bool,
    /// Why it is to be disconnected once its output has gone out.
    is_dismissed: bool,
    lines: TokenBucket,
    key_lines: TokenBucket,
    pub(crate) heard: Nanos,
    wrote: Nanos,
}

impl Client {
    /// A connection that has just been accepted, whose stream does not block.
    pub(crate) fn new(
        number: u64,
        (stream, peer, role): (UnixStream, Peer, Role),
        now: Nanos,
    ) -> Client {
        Client {
            number,
            role,
            peer,
            stream,
            input: Vec::new(),
            looked_through: 0,
            output: VecDeque::new(),
            pending: None,
            early_stops: VecDeque::new(),
            watch: None,
            scope: None,
            speaks_json: false,
            has_backlog: false,
            is_closed: false,
            is_lost: false,
            is_dismissed: false,
            lines: TokenBucket::new(LINES_PER_S, now),
            key_lines: TokenBucket::new(KEY_LINES_PER_S, now),
            heard: now,
            wrote: now,
        }
    }

    /// The stream, to wait for it.
    pub(crate) fn stream(&self) -> &UnixStream {
        &self.stream
    }

    /// Whether more may be read from it.
    pub(crate) fn wants_input(&self) -> bool {
        !self.is_closed && !self.is_dismissed && self.input.len() < INPUT_BYTES_MAX
    }

    /// Whether something waits to be written.
    pub(crate) fn wants_output(&self) -> bool {
        !self.output.is_empty()
    }

    /// Whether the connection is over.
    pub(crate) fn is_over(&self) -> bool {
        self.is_lost || (self.is_dismissed && self.output.is_empty())
    }

    /// Reads what has arrived, and returns how many lines among it say `stop`: they are carried out
    /// before their turn comes.
    pub(crate) fn read(&mut self, now: Nanos) -> usize {
        self.has_backlog = self.pending.is_some() || self.input.contains(&b'\n');
        let mut bytes = [0; TURN_BYTES_MAX];
        if self.wants_input() {
            match self.stream.read(&mut bytes) {
                Ok(0) => {
                    self.is_closed = true;
                    // Lines that arrived before the client closed are still served.
                    self.is_lost |= !self.input.contains(&b'\n') && self.pending.is_none();
                }
                Ok(count) => {
                    self.input.extend_from_slice(&bytes[..count]);
                    self.heard = now;
                }
                Err(error) => {
                    let passes = [ErrorKind::WouldBlock, ErrorKind::Interrupted];
                    self.is_lost |= !passes.contains(&error.kind());
                }
            }
        }
        if self.input.len() >= INPUT_BYTES_MAX {
            self.dismiss("too much was sent at once; wait for each answer");
        }
        self.new_stops()
    }

    /// Counts the stops among the lines that were not looked through yet.
    fn new_stops(&mut self) -> usize {
        let new = &self.input[self.looked_through..];
        let Some(end) = new.iter().rposition(|byte| *byte == b'\n') else { return 0 };
        let lines = new[..end].split(|byte| *byte == b'\n');
        // Most lines say something else, which their bytes show.
        let word = b"stop";
        let may_stop = lines.filter(|line| line.windows(word.len()).any(|four| four == word));
        let stops = may_stop.filter(|line| is_stop(&String::from_utf8_lossy(line))).count();
        self.looked_through += end + 1;
        stops
    }

    /// The next complete line, unless the client talks too fast; a stop always comes.
    pub(crate) fn line(&mut self, now: Nanos) -> Option<String> {
        let Some(end) = self.input.iter().position(|byte| *byte == b'\n') else {
            if self.input.len() > LINE_BYTES_MAX {
                self.dismiss("a line of more than 65536 bytes; say one thing a line");
            } else if self.is_closed {
                self.is_lost |= self.pending.is_none() && self.output.is_empty();
            }
            return None;
        };
        let line = String::from_utf8_lossy(&self.input[..end]).into_owned();
        let bucket = if line.trim_start().starts_with("jog ") || line.contains("\"jog ") {
            &mut self.key_lines
        } else {
            &mut self.lines
        };
        if !is_stop(&line) && !bucket.take(now) {
            return None;
        }
        self.input.drain(..=end);
        self.looked_through = self.looked_through.saturating_sub(end + 1);
        self.speaks_json = line.trim_start().starts_with('{');
        Some(line)
    }

    /// Whether a complete line waits.
    pub(crate) fn has_line(&self) -> bool {
        self.input.contains(&b'\n')
    }

    /// Gives an answer; the client then waits for nothing.
    pub(crate) fn answer(&mut self, id: Option<&Value>, answer: &Answer) {
        self.pending = None;
        self.say(&answer.line(id));
    }

    /// Sends an event.
    pub(crate) fn event(&mut self, event: &Value) {
        let line = event_line(event, self.speaks_json);
        self.say(&line);
    }

    /// Whether the client has not read what it was sent before.
    pub(crate) fn is_behind(&self) -> bool {
        self.output.len() > OUTPUT_BYTES_BEHIND
    }

    fn say(&mut self, line: &str) {
        if self.is_dismissed {
            return;
        }
        if self.output.len() + line.len() > OUTPUT_BYTES_MAX {
            self.is_lost = true;
            return;
        }
        if self.output.is_empty() {
            self.wrote = linux::monotonic();
        }
        self.output.extend(line.as_bytes());
    }

    /// Says why, and disconnects.
    pub(crate) fn dismiss(&mut self, why: &str) {
        self.say(&Answer::error(format!("disconnected: {why}")).line(None));
        self.is_dismissed = true;
        self.input.clear();
        self.looked_through = 0;
        self.pending = None;
    }

    /// Writes what the client takes.
    pub(crate) fn flush(&mut self, now: Nanos) {
        while !self.output.is_empty() {
            let (first, _) = self.output.as_slices();
            match self.stream.write(first) {
                Ok(0) => break,
                Ok(count) => {
                    self.output.drain(..count);
                    self.wrote = now;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    self.is_lost |= error.kind() != ErrorKind::WouldBlock;
                    break;
                }
            }
        }
        let stalled = (now - self.wrote) > WRITE_STALL_MAX;
        self.is_lost |= stalled && !self.output.is_empty();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn connected(now: Nanos) -> (Client, UnixStream) {
        let (here, there) = UnixStream::pair().unwrap();
        here.set_nonblocking(true).unwrap();
        let peer = Peer::of(&here).unwrap();
        (Client::new(1, (here, peer, Role::Control), now), there)
    }

    #[test]
    fn a_fast_talker_is_served_at_the_rate_and_its_stop_is_found_at_once() {
        let now = Nanos::from_secs(5);
        let (mut client, mut there) = connected(now);
        let mut text = "state\n".repeat(200);
        text += "stop\nstate\n";
        there.write_all(text.as_bytes()).unwrap();
        assert_eq!(client.read(now), 1, "before two hundred lines were served");
        assert_eq!(client.read(now), 0, "once only");
        let served =
            |client: &mut Client, at: Nanos| std::iter::from_fn(|| client.line(at)).count();
        assert_eq!(served(&mut client, now), 50);
        assert_eq!(served(&mut client, now + Nanos::from_millis(500)), 25);
        assert_eq!(served(&mut client, now + Nanos::from_secs(100)), 50);
    }

    #[test]
    fn too_much_at_once_is_told_and_disconnected() {
        let now = Nanos::from_secs(5);
        let (mut client, mut there) = connected(now);
        there.set_nonblocking(true).unwrap();
        for _ in 0..1000 {
            let _ = there.write(&[b'x'; 4096]);
            client.read(now);
        }
        client.flush(now);
        assert!(client.is_over());
        let mut text = String::new();
        drop(client);
        let _ = there.read_to_string(&mut text);
        assert!(text.starts_with("error: disconnected: too much"), "{text}");
    }

    #[test]
    fn a_client_that_never_reads_is_dropped() {
        let now = Nanos::from_secs(5);
        let (mut client, _there) = connected(now);
        let long = Answer::ok("x".repeat(10_000));
        for _ in 0..200 {
            client.answer(None, &long);
            client.flush(now);
        }
        assert!(client.is_over(), "more than it may owe");
        let (mut client, _there) = connected(now);
        for _ in 0..50 {
            client.answer(None, &long);
        }
        client.flush(now);
        assert!(client.is_behind() && !client.is_over());
        client.flush(now + Nanos::from_secs(20));
        assert!(client.is_over(), "nothing was read for too long");
    }
}
