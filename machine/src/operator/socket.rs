//! The operator's socket: lines in, one line of answer each, over a Unix-domain socket. It is
//! polled between two looks at the records, so nobody waits for anybody. Refuses to be another's:
//! a path on which somebody listens, or which is no socket, is left alone.
//!
//! Every line that says something is answered: `ok ..`, `refused: ..` or `error: ..`. The next line
//! of a client is read when its last one was answered. Keys count as held only where they are the
//! newest that a client has said and nothing of it had to wait: whoever says more than is listened
//! to, and then hangs, is not believed for as long as it takes to hear it out.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use taktil_hal::Nanos;
use taktil_rtcore::Invalid;
use taktil_rtcore::record::{Catalog, Record};
use taktil_signal::{JogFrame, Request, TypedMove, Verb};

use super::speech::{Meaning, Order, order};
use super::status::{Status, refusal};
use super::{FIRST_SEQUENCE, Mouth, Word};

/// Clients at most; who comes later is turned away.
const CLIENTS: usize = 8;
/// Longest line, bytes.
const LINE: usize = 1024;
/// Lines of a client served in one look.
const LINES_A_LOOK: usize = 16;
/// How long the machine may take to look at a request.
const PATIENCE: Nanos = Nanos::from_secs(2);

/// Where the service listens.
pub const SERVICE_SOCKET: &str = "/run/taktil/operator.sock";

/// What a client still waits for.
#[derive(Clone, Copy, Debug)]
enum Pending {
    /// The supervisor's look at this request; requests refused before it.
    Request { verb: Verb, sequence: u32, refused: u32, since: Nanos },
    /// The verdict about this move.
    Verdict { sequence: u32, since: Nanos },
    /// That a pause, a resumption or a clearing was taken in.
    Taken { sequence: u32, since: Nanos },
    /// The end of the moves typed up to this one.
    Rest { sequence: u32 },
}

struct Client {
    stream: UnixStream,
    text: Vec<u8>,
    pending: Option<Pending>,
    /// Something that was said before this look has not been answered yet.
    late: bool,
    /// Nothing more will come.
    ended: bool,
    gone: bool,
}

/// The socket and everybody who is connected.
pub struct Socket {
    listener: UnixListener,
    path: PathBuf,
    clients: Vec<Client>,
    mouth: Mouth,
    status: Status,
    meaning: Meaning,
    requests: u32,
    moves: u32,
}

impl Drop for Socket {
    fn drop(&mut self) {
        // Nobody can be told any more.
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Socket {
    /// Listens at `path`, for the owner and the group. `meaning` says what moves are, for
    /// what can be refused without asking the arm.
    ///
    /// # Errors
    /// A path in use, in the way, or that cannot be made.
    pub fn listen(path: &Path, mouth: Mouth, meaning: Meaning) -> Result<Socket, Invalid> {
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
            // The socket of a process that was killed.
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
            Ok(listener) => Ok(Socket {
                listener,
                path: path.to_owned(),
                clients: Vec::new(),
                mouth,
                status: Status::default(),
                meaning,
                requests: 0,
                moves: 0,
            }),
        }
    }

    /// Whose records these will be.
    pub fn attach(&mut self, catalog: &Catalog) {
        self.status = Status::new(catalog);
    }

    /// Takes a record in.
    pub fn record(&mut self, record: &Record<'_>) {
        self.status.record(record);
    }

    /// One look at everybody, at logical time `now`.
    pub fn poll(&mut self, now: Nanos) {
        while let Ok((stream, _)) = self.listener.accept() {
            self.welcome(stream);
        }
        let mut clients = std::mem::take(&mut self.clients);
        for client in &mut clients {
            client.late = client.pending.is_some() || client.text.contains(&b'\n');
            client.read();
            self.serve(client, now);
        }
        clients.retain(|client| !client.gone);
        self.clients = clients;
    }

    fn welcome(&mut self, mut stream: UnixStream) {
        if stream.set_nonblocking(true).is_err() {
            return;
        }
        if self.clients.len() >= CLIENTS {
            let _ = stream.write_all(b"error: too many operators are connected\n");
            return;
        }
        let (text, pending) = (Vec::new(), None);
        let (late, ended, gone) = (false, false, false);
        self.clients.push(Client { stream, text, pending, late, ended, gone });
    }

    /// Answers what can be answered, then reads on.
    fn serve(&mut self, client: &mut Client, now: Nanos) {
        for _ in 0..LINES_A_LOOK {
            if let Some(pending) = client.pending {
                match self.outcome(&pending, now) {
                    None => return,
                    Some(answer) => client.answer(&answer),
                }
            }
            let Some(line) = client.line() else { return };
            match order(&line, &self.meaning) {
                Ok(None) => {}
                Ok(Some(order)) => self.act(client, order, now),
                Err(bad) => {
                    let place =
                        if bad.place.is_empty() { bad.place } else { format!("{}: ", bad.place) };
                    client.answer(&format!("refused: {place}{}; {}", bad.what, bad.remedy));
                }
            }
        }
    }

    fn act(&mut self, client: &mut Client, order: Order, now: Nanos) {
        match order {
            Order::State => client.answer(&format!("ok {}", self.line())),
            Order::Wait => {
                let sequence = FIRST_SEQUENCE | self.moves;
                client.pending = Some(Pending::Rest { sequence });
            }
            Order::Jog(axes, frame) => self.keys(client, axes, frame),
            Order::Ask(verb) => self.ask(client, verb, now),
            Order::Move(typed) => self.type_in(client, typed, now),
        }
    }

    fn send(&mut self, client: &mut Client, word: Word) -> bool {
        let sent = self.mouth.send(word, Nanos::ZERO, Nanos::ZERO).is_ok();
        if !sent {
            client.answer("error: the machine does not listen; the word is lost");
        }
        sent
    }

    /// How the machine stands, and what is in the way of the keys.
    fn line(&self) -> String {
        let obstacle = self.status.obstacle(|joint| self.meaning.robot.joint(joint));
        let obstacle = obstacle.map_or_else(String::new, |obstacle| format!("; {obstacle}"));
        format!("{}{obstacle}", self.status.line())
    }

    fn keys(&mut self, client: &mut Client, axes: [f64; 6], frame: JogFrame) {
        let held = axes.iter().any(|axis| *axis != 0.0);
        if held && (client.late || client.ended || client.text.contains(&b'\n')) {
            client.answer(
                "refused: these keys were said too long ago; say them while they are held, and \
                 wait for each answer",
            );
            return;
        }
        if !self.send(client, Word::Keys { axes, frame }) {
            return;
        }
        if held && !self.status.takes_keys() {
            let place = self.status.place();
            client.answer(&format!("ok, but keys move the arm in MANUAL; it is in {place}"));
            return;
        }
        match self.status.obstacle(|joint| self.meaning.robot.joint(joint)).filter(|_| held) {
            Some(obstacle) => client.answer(&format!("ok {obstacle}")),
            None => client.answer("ok"),
        }
    }

    fn ask(&mut self, client: &mut Client, verb: Verb, now: Nanos) {
        self.requests = (self.requests + 1) % FIRST_SEQUENCE;
        let sequence = FIRST_SEQUENCE | self.requests;
        let refused = self.status.control.refused;
        if self.send(client, Word::Ask(Request { verb: verb as u32, sequence })) {
            client.pending = Some(Pending::Request { verb, sequence, refused, since: now });
        }
    }

    fn type_in(&mut self, client: &mut Client, typed: TypedMove, now: Nanos) {
        if !self.status.takes(&typed) {
            let place = self.status.place();
            client.answer(&format!(
                "refused: moves are taken in TRAJECTORY/USER, the machine is in {place}; ask for \
                 trajectory_user first"
            ));
            return;
        }
        self.moves = (self.moves + 1) % FIRST_SEQUENCE;
        let sequence = FIRST_SEQUENCE | self.moves;
        if self.send(client, Word::Move(TypedMove { sequence, ..typed })) {
            let since = now;
            client.pending = Some(if taktil_tasks_trajectory::typed::is_move(&typed) {
                Pending::Verdict { sequence, since }
            } else {
                Pending::Taken { sequence, since }
            });
        }
    }

    /// The answer, once there is one.
    fn outcome(&self, pending: &Pending, now: Nanos) -> Option<String> {
        let Status { control, typed, check, .. } = &self.status;
        let left = || format!("refused: TRAJECTORY/USER was left: {}", self.status.place());
        let since = match *pending {
            Pending::Request { verb, sequence, refused, since } => {
                if control.request == sequence {
                    let place = self.status.place();
                    return Some(if control.refused == refused {
                        format!("ok {place}")
                    } else {
                        format!("refused: {} is not possible in {place}", verb.name())
                    });
                }
                since
            }
            Pending::Verdict { sequence, since } => {
                if typed.refused == sequence {
                    return Some(format!(
                        "refused: {}",
                        refusal(check, |joint| self.meaning.robot.joint(joint))
                    ));
                }
                if typed.judged == sequence {
                    return Some(format!(
                        "ok {:.2} s, at most {:.0} % of a joint's speed, {:.0} % of its torque",
                        check.duration_s,
                        100.0 * check.speed_share,
                        100.0 * check.torque_share
                    ));
                }
                if !self.status.takes_moves() {
                    return Some(left());
                }
                // A long move in front of it is looked at, and run, for as long as it takes.
                if typed.taken == sequence {
                    return None;
                }
                since
            }
            Pending::Taken { sequence, since } => {
                if typed.taken == sequence {
                    return Some("ok".to_owned());
                }
                since
            }
            Pending::Rest { sequence } => {
                if !self.status.takes_moves() {
                    return Some(left());
                }
                let over = typed.queued == 0 && typed.moving == 0;
                let nothing = sequence == FIRST_SEQUENCE;
                return (over && (nothing || typed.taken == sequence))
                    .then(|| format!("ok {}", self.line()));
            }
        };
        (now - since > PATIENCE).then(|| "error: the machine does not answer".to_owned())
    }
}

impl Client {
    /// Reads what has come, as far as there is room.
    fn read(&mut self) {
        let mut bytes = [0; LINE];
        while self.text.len() < 4 * LINE {
            match self.stream.read(&mut bytes) {
                Ok(0) => {
                    self.ended = true;
                    // Whoever hangs up may have said something before.
                    self.gone = !self.text.contains(&b'\n') && self.pending.is_none();
                    return;
                }
                Ok(count) => self.text.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    self.gone |= error.kind() != ErrorKind::WouldBlock;
                    return;
                }
            }
        }
    }

    /// The next whole line.
    fn line(&mut self) -> Option<String> {
        let Some(end) = self.text.iter().position(|byte| *byte == b'\n') else {
            if self.text.len() > LINE {
                self.answer("refused: a line of more than 1024 bytes; say one thing a line");
                self.gone = true;
            }
            return None;
        };
        let line: Vec<u8> = self.text.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).into_owned())
    }

    fn answer(&mut self, words: &str) {
        self.pending = None;
        // A client that does not read loses its answer, and a broken one is gone.
        if let Err(error) = self.stream.write_all(format!("{words}\n").as_bytes()) {
            self.gone |= error.kind() != ErrorKind::WouldBlock;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Hand, Said, pair};
    use super::*;

    /// A socket of this process, whoever is connected to it, and the lane's end.
    fn connected(name: &str) -> (Socket, UnixStream, Hand) {
        let name = format!("taktil-socket-{}-{name}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let (mouth, hand) = pair();
        let mut socket = Socket::listen(&path, mouth, Meaning::default()).unwrap();
        let caller = UnixStream::connect(&path).unwrap();
        caller.set_nonblocking(true).unwrap();
        socket.poll(Nanos::ZERO);
        (socket, caller, hand)
    }

    /// Confirmations of keys in so many looks, each followed by a job of the lane.
    fn confirmed(socket: &mut Socket, hand: &mut Hand, looks: u32) -> u32 {
        let mut said = Said::default();
        for _ in 0..looks {
            socket.poll(Nanos::ZERO);
            hand.hear(&mut said);
            hand.hear(&mut said);
        }
        said.keys.sequence
    }

    fn answers(caller: &mut UnixStream) -> Vec<String> {
        let mut text = String::new();
        let _ = caller.read_to_string(&mut text);
        text.lines().map(str::to_owned).collect()
    }

    const HELD: &[u8] = b"jog joints 0 0 0 0 1 0\n";

    #[test]
    fn keys_that_had_to_wait_do_not_move_the_arm() {
        let (mut socket, mut caller, mut hand) = connected("flood");
        // A writer that says hundreds of words and hangs: they take many looks to be heard.
        caller.write_all(&HELD.repeat(200)).unwrap();
        assert_eq!(confirmed(&mut socket, &mut hand, 100), 0);
        let said = answers(&mut caller);
        assert_eq!(said.len(), 200);
        assert!(said.iter().all(|answer| answer.starts_with("refused: ")), "{said:?}");
        // One at a time they do.
        for n in 1..=5 {
            caller.write_all(HELD).unwrap();
            assert_eq!(confirmed(&mut socket, &mut hand, 1), n.min(1));
        }
        assert!(answers(&mut caller).iter().all(|answer| answer.starts_with("ok")));
        // Of two that come at once the newer one counts; a release always does.
        caller.write_all(&HELD.repeat(2)).unwrap();
        assert_eq!(confirmed(&mut socket, &mut hand, 3), 1);
        caller.write_all(&[HELD, b"release\n", HELD, b"release\n"].concat()).unwrap();
        assert_eq!(confirmed(&mut socket, &mut hand, 3), 2);
    }

    #[test]
    fn whoever_hangs_up_holds_nothing() {
        let (mut socket, mut caller, mut hand) = connected("hung-up");
        caller.write_all(HELD).unwrap();
        drop(caller);
        assert_eq!(confirmed(&mut socket, &mut hand, 3), 0);
        assert!(socket.clients.is_empty());
    }
}
