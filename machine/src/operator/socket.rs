//! The operator's socket: a Unix-domain socket that receives lines and sends one answer line for
//! each. It is polled between two readings of the records, so that neither side waits for the
//! other. A path on which another process listens, or which is not a socket, is an error and stays
//! untouched.
//!
//! Every line that is not empty is answered: `ok ..`, `refused: ..` or `error: ..`. The next line
//! of a client is read after its last one was answered. Keys count as held only when their line is
//! the newest of a client and nothing of that client had to wait. A client that sends faster than
//! it is served, and then hangs, therefore cannot keep the arm moving.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use taktil_hal::Nanos;
use taktil_rtcore::Invalid;
use taktil_rtcore::record::{Catalog, Record};
use taktil_signal::{JogFrame, OperatorMove, Request, Verb};

use super::command::{CommandContext, OperatorCommand, parse};
use super::status::{Status, refusal_text};
use super::{FIRST_SEQUENCE, OperatorMessage, OperatorSender};

/// Largest number of clients; a further client gets an error line.
const CLIENTS_MAX: usize = 8;
/// Longest line (bytes).
const LINE_BYTES_MAX: usize = 1024;
/// Lines of one client that are served in one poll.
const LINES_PER_POLL_MAX: usize = 16;
/// Time that the machine may take to answer a request.
const ANSWER_TIMEOUT: Nanos = Nanos::from_secs(2);

/// Default path of the service's socket.
pub const SERVICE_SOCKET: &str = "/run/taktil/operator.sock";

/// The event for whose answer a client waits.
#[derive(Clone, Copy, Debug)]
enum Pending {
    /// The supervisor's decision about this request; `refused` counts requests refused before it.
    Request { verb: Verb, sequence: u32, refused: u32, since: Nanos },
    /// The check of this move.
    MoveCheck { sequence: u32, since: Nanos },
    /// The acceptance of a pause, a resumption or a clearing.
    Acceptance { sequence: u32, since: Nanos },
    /// The end of all moves up to this one.
    Standstill { sequence: u32 },
}

struct Client {
    stream: UnixStream,
    text: Vec<u8>,
    pending: Option<Pending>,
    /// A line from before this poll has not been answered yet.
    has_backlog: bool,
    /// The client has closed its sending side.
    is_closed: bool,
    is_lost: bool,
}

/// The socket and its clients.
pub struct OperatorSocket {
    listener: UnixListener,
    path: PathBuf,
    clients: Vec<Client>,
    sender: OperatorSender,
    status: Status,
    context: CommandContext,
    requests: u32,
    moves: u32,
}

impl Drop for OperatorSocket {
    fn drop(&mut self) {
        // An error at the end of the process has no receiver.
        let _ = std::fs::remove_file(&self.path);
    }
}

impl OperatorSocket {
    /// Listens at `path`, for the owner and the group. `context` serves to check moves that can be
    /// refused without asking the machine.
    ///
    /// # Errors
    /// A path that is in use, is not a socket, or cannot be created.
    pub fn listen(
        path: &Path,
        sender: OperatorSender,
        context: CommandContext,
    ) -> Result<OperatorSocket, Invalid> {
        let shown = path.display();
        let bad = |what: String, remedy: &str| Err(Invalid::new("operator", what, remedy));
        if let Ok(about) = std::fs::symlink_metadata(path) {
            if !about.file_type().is_socket() {
                return bad(format!("`{shown}` is there and no socket"), "name another path");
            }
            if UnixStream::connect(path).is_ok() {
                let what = format!("somebody listens at `{shown}` already");
                return bad(what, "end the other run, or name another path");
            }
            // The socket is left over from a process that was killed.
            let _ = std::fs::remove_file(path);
        }
        let listener = UnixListener::bind(path).and_then(|listener| {
            listener.set_nonblocking(true)?;
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660))?;
            Ok(listener)
        });
        match listener {
            Err(error) => bad(
                format!("cannot listen at `{shown}`: {error}"),
                "name a path of at most 100 characters in a folder that can be written",
            ),
            Ok(listener) => Ok(OperatorSocket {
                listener,
                path: path.to_owned(),
                clients: Vec::new(),
                sender,
                status: Status::default(),
                context,
                requests: 0,
                moves: 0,
            }),
        }
    }

    /// Sets the catalog of the records that follow.
    pub fn attach(&mut self, catalog: &Catalog) {
        self.status = Status::new(catalog);
    }

    /// Takes over the value of a record.
    pub fn record(&mut self, record: &Record<'_>) {
        self.status.record(record);
    }

    /// Accepts clients and serves all of them once, at logical time `now`.
    pub fn poll(&mut self, now: Nanos) {
        while let Ok((stream, _)) = self.listener.accept() {
            self.add_client(stream);
        }
        let mut clients = std::mem::take(&mut self.clients);
        for client in &mut clients {
            client.has_backlog = client.pending.is_some() || client.text.contains(&b'\n');
            client.read();
            self.serve(client, now);
        }
        clients.retain(|client| !client.is_lost);
        self.clients = clients;
    }

    fn add_client(&mut self, mut stream: UnixStream) {
        if stream.set_nonblocking(true).is_err() {
            return;
        }
        if self.clients.len() >= CLIENTS_MAX {
            let _ = stream.write_all(b"error: too many operators are connected\n");
            return;
        }
        let (text, pending) = (Vec::new(), None);
        let (has_backlog, is_closed, is_lost) = (false, false, false);
        self.clients.push(Client { stream, text, pending, has_backlog, is_closed, is_lost });
    }

    /// Answers what can be answered, then executes further lines.
    fn serve(&mut self, client: &mut Client, now: Nanos) {
        for _ in 0..LINES_PER_POLL_MAX {
            if let Some(pending) = client.pending {
                match self.answer_to(&pending, now) {
                    None => return,
                    Some(answer) => client.answer(&answer),
                }
            }
            let Some(line) = client.line() else { return };
            match parse(&line, &self.context) {
                Ok(None) => {}
                Ok(Some(order)) => self.execute(client, order, now),
                Err(bad) => {
                    let place =
                        if bad.place.is_empty() { bad.place } else { format!("{}: ", bad.place) };
                    client.answer(&format!("refused: {place}{}; {}", bad.what, bad.remedy));
                }
            }
        }
    }

    fn execute(&mut self, client: &mut Client, order: OperatorCommand, now: Nanos) {
        match order {
            OperatorCommand::State => client.answer(&format!("ok {}", self.state_line())),
            OperatorCommand::Wait => {
                let sequence = FIRST_SEQUENCE | self.moves;
                client.pending = Some(Pending::Standstill { sequence });
            }
            OperatorCommand::Jog(axes, frame) => self.jog(client, axes, frame),
            OperatorCommand::Request(verb) => self.request(client, verb, now),
            OperatorCommand::Move(typed) => self.send_move(client, typed, now),
        }
    }

    fn send(&mut self, client: &mut Client, word: OperatorMessage) -> bool {
        let sent = self.sender.send(word, Nanos::ZERO, Nanos::ZERO).is_ok();
        if !sent {
            client.answer("error: the machine does not listen; the word is lost");
        }
        sent
    }

    /// The state of the machine, and what prevents jog motion.
    fn state_line(&self) -> String {
        let obstacle = self.status.jog_obstacle(|joint| self.context.robot.joint_label(joint));
        let obstacle = obstacle.map_or_else(String::new, |obstacle| format!("; {obstacle}"));
        format!("{}{obstacle}", self.status.summary())
    }

    fn jog(&mut self, client: &mut Client, axes: [f64; 6], frame: JogFrame) {
        let held = axes.iter().any(|axis| *axis != 0.0);
        if held && (client.has_backlog || client.is_closed || client.text.contains(&b'\n')) {
            client.answer(
                "refused: these keys were said too long ago; say them while they are held, and \
                 wait for each answer",
            );
            return;
        }
        if !self.send(client, OperatorMessage::Jog { axes, frame }) {
            return;
        }
        if held && !self.status.accepts_jog() {
            let place = self.status.state_text();
            client.answer(&format!("ok, but keys move the arm in MANUAL; it is in {place}"));
            return;
        }
        match self
            .status
            .jog_obstacle(|joint| self.context.robot.joint_label(joint))
            .filter(|_| held)
        {
            Some(obstacle) => client.answer(&format!("ok {obstacle}")),
            None => client.answer("ok"),
        }
    }

    fn request(&mut self, client: &mut Client, verb: Verb, now: Nanos) {
        self.requests = (self.requests + 1) % FIRST_SEQUENCE;
        let sequence = FIRST_SEQUENCE | self.requests;
        let refused = self.status.control.refused;
        if self.send(client, OperatorMessage::Request(Request { verb: verb as u32, sequence })) {
            client.pending = Some(Pending::Request { verb, sequence, refused, since: now });
        }
    }

    fn send_move(&mut self, client: &mut Client, typed: OperatorMove, now: Nanos) {
        if !self.status.accepts(&typed) {
            let place = self.status.state_text();
            client.answer(&format!(
                "refused: moves are taken in TRAJECTORY/USER, the machine is in {place}; ask for \
                 trajectory_user first"
            ));
            return;
        }
        self.moves = (self.moves + 1) % FIRST_SEQUENCE;
        let sequence = FIRST_SEQUENCE | self.moves;
        if self.send(client, OperatorMessage::Move(OperatorMove { sequence, ..typed })) {
            let since = now;
            client.pending = Some(if taktil_tasks_trajectory::typed::is_move(&typed) {
                Pending::MoveCheck { sequence, since }
            } else {
                Pending::Acceptance { sequence, since }
            });
        }
    }

    /// The answer, once the records contain it.
    fn answer_to(&self, pending: &Pending, now: Nanos) -> Option<String> {
        let Status { control, typed, check, .. } = &self.status;
        let left = || format!("refused: TRAJECTORY/USER was left: {}", self.status.state_text());
        let since = match *pending {
            Pending::Request { verb, sequence, refused, since } => {
                if control.request == sequence {
                    let place = self.status.state_text();
                    return Some(if control.refused == refused {
                        format!("ok {place}")
                    } else {
                        format!("refused: {} is not possible in {place}", verb.name())
                    });
                }
                since
            }
            Pending::MoveCheck { sequence, since } => {
                if typed.refused == sequence {
                    return Some(format!(
                        "refused: {}",
                        refusal_text(check, |joint| self.context.robot.joint_label(joint))
                    ));
                }
                if typed.checked == sequence {
                    return Some(format!(
                        "ok {:.2} s, at most {:.0} % of a joint's speed, {:.0} % of its torque",
                        check.duration_s,
                        100.0 * check.speed_share,
                        100.0 * check.torque_share
                    ));
                }
                if !self.status.accepts_moves() {
                    return Some(left());
                }
                // The moves before it are still checked or executed, which may take any time.
                if typed.received == sequence {
                    return None;
                }
                since
            }
            Pending::Acceptance { sequence, since } => {
                if typed.received == sequence {
                    return Some("ok".to_owned());
                }
                since
            }
            Pending::Standstill { sequence } => {
                if !self.status.accepts_moves() {
                    return Some(left());
                }
                let over = typed.queued == 0 && typed.moving == 0;
                let nothing = sequence == FIRST_SEQUENCE;
                return (over && (nothing || typed.received == sequence))
                    .then(|| format!("ok {}", self.state_line()));
            }
        };
        (now - since > ANSWER_TIMEOUT).then(|| "error: the machine does not answer".to_owned())
    }
}

impl Client {
    /// Reads the bytes that have arrived, as far as the buffer has room.
    fn read(&mut self) {
        let mut bytes = [0; LINE_BYTES_MAX];
        while self.text.len() < 4 * LINE_BYTES_MAX {
            match self.stream.read(&mut bytes) {
                Ok(0) => {
                    self.is_closed = true;
                    // Lines that arrived before the client closed are still served.
                    self.is_lost = !self.text.contains(&b'\n') && self.pending.is_none();
                    return;
                }
                Ok(count) => self.text.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    self.is_lost |= error.kind() != ErrorKind::WouldBlock;
                    return;
                }
            }
        }
    }

    /// The next complete line.
    fn line(&mut self) -> Option<String> {
        let Some(end) = self.text.iter().position(|byte| *byte == b'\n') else {
            if self.text.len() > LINE_BYTES_MAX {
                self.answer("refused: a line of more than 1024 bytes; say one thing a line");
                self.is_lost = true;
            }
            return None;
        };
        let line: Vec<u8> = self.text.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).into_owned())
    }

    fn answer(&mut self, words: &str) {
        self.pending = None;
        // A client that does not read loses its answer; a broken connection is closed.
        if let Err(error) = self.stream.write_all(format!("{words}\n").as_bytes()) {
            self.is_lost |= error.kind() != ErrorKind::WouldBlock;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{OperatorInput, OperatorReceiver, channel};
    use super::*;

    /// A listening socket, a connected client, and the lane's end of the channel.
    fn connected(name: &str) -> (OperatorSocket, UnixStream, OperatorReceiver) {
        let name = format!("taktil-socket-{}-{name}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let (sender, receiver) = channel();
        let mut socket = OperatorSocket::listen(&path, sender, CommandContext::default()).unwrap();
        let caller = UnixStream::connect(&path).unwrap();
        caller.set_nonblocking(true).unwrap();
        socket.poll(Nanos::ZERO);
        (socket, caller, receiver)
    }

    /// Counts the confirmations of keys over several polls, each followed by a job of the lane.
    fn confirmations(
        socket: &mut OperatorSocket,
        receiver: &mut OperatorReceiver,
        looks: u32,
    ) -> u32 {
        let mut input = OperatorInput::default();
        for _ in 0..looks {
            socket.poll(Nanos::ZERO);
            receiver.receive_into(&mut input);
            receiver.receive_into(&mut input);
        }
        input.jog.sequence
    }

    fn answers(caller: &mut UnixStream) -> Vec<String> {
        let mut text = String::new();
        let _ = caller.read_to_string(&mut text);
        text.lines().map(str::to_owned).collect()
    }

    const JOG_LINE: &[u8] = b"jog joints 0 0 0 0 1 0\n";

    #[test]
    fn keys_that_had_to_wait_do_not_move_the_arm() {
        let (mut socket, mut caller, mut receiver) = connected("flood");
        // A client sends hundreds of lines and then hangs: it takes many polls to serve them.
        caller.write_all(&JOG_LINE.repeat(200)).unwrap();
        assert_eq!(confirmations(&mut socket, &mut receiver, 100), 0);
        let input = answers(&mut caller);
        assert_eq!(input.len(), 200);
        assert!(input.iter().all(|answer| answer.starts_with("refused: ")), "{input:?}");
        // Lines that come one at a time move the arm.
        for n in 1..=5 {
            caller.write_all(JOG_LINE).unwrap();
            assert_eq!(confirmations(&mut socket, &mut receiver, 1), n.min(1));
        }
        assert!(answers(&mut caller).iter().all(|answer| answer.starts_with("ok")));
        // When two lines come at once, only the newer one counts; a release always counts.
        caller.write_all(&JOG_LINE.repeat(2)).unwrap();
        assert_eq!(confirmations(&mut socket, &mut receiver, 3), 1);
        caller.write_all(&[JOG_LINE, b"release\n", JOG_LINE, b"release\n"].concat()).unwrap();
        assert_eq!(confirmations(&mut socket, &mut receiver, 3), 2);
    }

    #[test]
    fn a_closed_client_holds_no_keys() {
        let (mut socket, mut caller, mut receiver) = connected("hung-up");
        caller.write_all(JOG_LINE).unwrap();
        drop(caller);
        assert_eq!(confirmations(&mut socket, &mut receiver, 3), 0);
        assert!(socket.clients.is_empty());
    }
}
