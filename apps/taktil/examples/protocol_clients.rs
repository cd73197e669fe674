//! Clients of a running machine that do what a display does: each watches signals at 20 Hz and asks
//! for the whole status ten times a second. A test program, in the guest or by hand:
//!
//! ```text
//! protocol_clients --at SOCKET [--clients N] [--for S]
//! ```
//!
//! One line is printed: how many answers and events the clients got. The exit code is 1 when an
//! answer belonged to another request, a client got none, or a connection ended early.

use std::io::{BufRead, BufReader, Error, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use taktil_rtcore::{Nanos, linux};

/// Longest wait for a line.
const LINE_TIMEOUT: Duration = Duration::from_secs(20);
/// Pause between an answer and the next question.
const STATUS_PAUSE: Duration = Duration::from_millis(100);

#[derive(Clone, Debug)]
struct Arguments {
    at: PathBuf,
    clients: usize,
    seconds: f64,
}

fn arguments() -> Result<Arguments, String> {
    let mut found = Arguments { at: PathBuf::new(), clients: 16, seconds: 5.0 };
    let mut words = std::env::args().skip(1);
    while let Some(option) = words.next() {
        let value = words.next().ok_or(format!("{option} lacks its value"))?;
        match option.as_str() {
            "--at" => found.at = value.into(),
            "--clients" => {
                found.clients = value.parse().map_err(|error| format!("{option}: {error}"))?;
            }
            "--for" => {
                found.seconds = value.parse().map_err(|error| format!("{option}: {error}"))?;
            }
            _ => return Err(format!("unknown option {option}")),
        }
    }
    Ok(found)
}

/// What one client got.
#[derive(Clone, Copy, Debug, Default)]
struct Received {
    answers: u64,
    events: u64,
}

/// Sends one request and reads up to its answer; events that come first are counted.
fn ask(
    stream: &mut BufReader<UnixStream>,
    id: u64,
    words: &str,
    received: &mut Received,
) -> std::io::Result<()> {
    let line = format!("{{\"id\":{id},\"say\":\"{words}\"}}\n");
    stream.get_mut().write_all(line.as_bytes())?;
    let mut answer = String::new();
    loop {
        answer.clear();
        if stream.read_line(&mut answer)? == 0 {
            return Err(Error::other("the connection was ended"));
        }
        if answer.contains("\"event\":") {
            received.events += 1;
        } else if answer.contains(&format!("\"id\":{id},")) && answer.contains("\"ok\"") {
            received.answers += 1;
            return Ok(());
        } else {
            return Err(Error::other(format!("`{words}` was answered {answer}")));
        }
    }
}

fn client(at: &Path, seconds: f64) -> std::io::Result<Received> {
    let stream = UnixStream::connect(at)?;
    stream.set_read_timeout(Some(LINE_TIMEOUT))?;
    let (mut stream, mut received) = (BufReader::new(stream), Received::default());
    let end = linux::monotonic() + Nanos((seconds * 1e9) as i64);
    ask(&mut stream, 1, "watch 20 sense.joints.q_rad joint_servo.torque", &mut received)?;
    let mut id = 1;
    while linux::monotonic() < end {
        id += 1;
        ask(&mut stream, id, "status", &mut received)?;
        std::thread::sleep(STATUS_PAUSE);
    }
    Ok(received)
}

fn main() {
    let arguments = arguments().unwrap_or_else(|error| {
        eprintln!("protocol_clients: {error}");
        std::process::exit(2);
    });
    let Arguments { at, clients, seconds } = &arguments;
    let received: Vec<std::io::Result<Received>> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..*clients).map(|_| scope.spawn(|| client(at, *seconds))).collect();
        let ended = clients.into_iter().map(|client| client.join());
        ended.map(|received| received.unwrap_or_else(|_| Err(Error::other("panicked")))).collect()
    });
    let mut total = Received::default();
    let mut failed = 0;
    for received in received {
        match received {
            Ok(Received { answers, events }) if answers > 1 && events > 0 => {
                total.answers += answers;
                total.events += events;
            }
            Ok(received) => {
                failed += 1;
                eprintln!("protocol_clients: a client got only {received:?}");
            }
            Err(error) => {
                failed += 1;
                eprintln!("protocol_clients: {error}");
            }
        }
    }
    let Received { answers, events } = total;
    println!("@clients {clients} answers {answers} events {events} failed {failed}");
    std::process::exit(i32::from(failed > 0));
}
