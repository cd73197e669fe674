//! Measures how long a stop takes from its line to the job that obeys it, beside whatever else
//! speaks to the machine. A test program, in the guest or by hand:
//!
//! ```text
//! stop_trials --at SOCKET [--tries N] [--moves N] [--idle N] [--flood N]
//! stop_trials --deaf PATH
//! ```
//!
//! A try is a new connection that says `stop`. With `--moves`, so many tries are made while a joint
//! is jogged by a client that has control; each begins with `enable`. `--idle` connections say
//! nothing, `--flood` ones talk as fast as they can. With `--deaf` it binds a datagram socket, as
//! systemd does for its services, reads nothing from it and never ends.
//!
//! One line is printed for the tries and one for the moves: how many were answered, and the median
//! and the longest time from the line to the release of the job that took it, on the kernel's
//! monotonic clock.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use taktil_rtcore::{Nanos, linux};

/// Longest wait for an answer, or for a state.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(20);

#[derive(Clone, Debug, Default)]
struct Arguments {
    at: PathBuf,
    tries: usize,
    moves: usize,
    idle: usize,
    flood: usize,
    deaf: Option<PathBuf>,
}

fn arguments() -> Result<Arguments, String> {
    let mut found = Arguments { tries: 100, ..Arguments::default() };
    let mut words = std::env::args().skip(1);
    while let Some(option) = words.next() {
        let value = words.next().ok_or(format!("{option} lacks its value"))?;
        let number = || value.parse::<usize>().map_err(|error| format!("{option}: {error}"));
        match option.as_str() {
            "--at" => found.at = value.into(),
            "--tries" => found.tries = number()?,
            "--moves" => found.moves = number()?,
            "--idle" => found.idle = number()?,
            "--flood" => found.flood = number()?,
            "--deaf" => found.deaf = Some(value.into()),
            _ => return Err(format!("unknown option {option}")),
        }
    }
    Ok(found)
}

/// A connection that waits for each answer.
struct Caller(BufReader<UnixStream>);

impl Caller {
    fn connect(path: &PathBuf) -> std::io::Result<Caller> {
        let stream = UnixStream::connect(path)?;
        stream.set_read_timeout(Some(ANSWER_TIMEOUT))?;
        Ok(Caller(BufReader::new(stream)))
    }

    fn ask(&mut self, words: &str) -> std::io::Result<String> {
        let line = format!("{{\"id\":1,\"say\":\"{words}\"}}\n");
        self.0.get_mut().write_all(line.as_bytes())?;
        let mut answer = String::new();
        self.0.read_line(&mut answer)?;
        Ok(answer)
    }

    /// Asks for something that has to be granted.
    fn demand(&mut self, words: &str) -> std::io::Result<()> {
        let answer = self.ask(words)?;
        if answer.contains("\"outcome\":\"ok\"") {
            return Ok(());
        }
        Err(std::io::Error::other(format!("`{words}` was refused: {answer}")))
    }

    /// Asks for the state until it contains `text`.
    fn wait_for(&mut self, text: &str) -> std::io::Result<()> {
        let begin = linux::monotonic();
        loop {
            let answer = self.ask("state")?;
            if answer.contains(text) {
                return Ok(());
            }
            if linux::monotonic() - begin > Nanos::from_secs(20) {
                return Err(std::io::Error::other(format!("no `{text}`: {answer}")));
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }
}

/// The number behind a key of an answer.
fn number(answer: &str, key: &str) -> Option<i64> {
    let rest = answer.split_once(&format!("\"{key}\":"))?.1;
    let digits: String = rest.chars().take_while(|c| c.is_ascii_digit() || *c == '-').collect();
    digits.parse().ok()
}

/// One stop on a new connection: how long until the job that took it, and the answer.
fn stop(path: &PathBuf) -> std::io::Result<(Nanos, String)> {
    let mut caller = Caller::connect(path)?;
    let sent = linux::monotonic();
    let answer = caller.ask("stop")?;
    let taken = number(&answer, "taken_ns").filter(|_| answer.contains("\"outcome\":\"ok\""));
    let taken = taken.ok_or_else(|| std::io::Error::other(format!("not taken: {answer}")))?;
    Ok((Nanos(taken) - sent, answer))
}

/// A stop while a joint is jogged.
fn stop_in_motion(path: &PathBuf, holder: &mut Caller) -> std::io::Result<Nanos> {
    holder.wait_for("START (mode READY)")?;
    holder.demand("enable")?;
    holder.wait_for("IDLE/UNCALIBRATED (mode HOLD)")?;
    holder.demand("manual_uncalibrated")?;
    for _ in 0..20 {
        holder.ask("jog joints 0 0 0 0 0 0.5")?;
        std::thread::sleep(Duration::from_millis(8));
    }
    let (took, answer) = stop(path)?;
    if !answer.contains("(mode STOPPING)") && !answer.contains("START") {
        return Err(std::io::Error::other(format!("it goes on: {answer}")));
    }
    Ok(took)
}

/// Talks as fast as it is heard; whoever sends it away is called again.
fn flood(path: &PathBuf, end: &AtomicBool) {
    let lines = "jog joints 1 0 0 0 0 0\nstate\n".repeat(100);
    while !end.load(Ordering::Relaxed) {
        let Ok(mut stream) = UnixStream::connect(path) else { continue };
        let _ = stream.set_write_timeout(Some(Duration::from_millis(200)));
        while !end.load(Ordering::Relaxed) && stream.write(lines.as_bytes()).is_ok() {}
    }
}

fn report(name: &str, wanted: usize, times: &mut [Nanos]) -> bool {
    times.sort_unstable();
    let at = |index: usize| times.get(index).map_or(-1.0, |time| time.0 as f64 * 1e-6);
    let (median, longest) = (at(times.len() / 2), at(times.len().wrapping_sub(1)));
    println!(
        "@stops {name} answered {} of {wanted}, median {median:.3} ms, longest {longest:.3} ms",
        times.len()
    );
    times.len() == wanted
}

fn run(arguments: &Arguments) -> std::io::Result<bool> {
    let Arguments { at, tries, moves, idle, flood: floods, .. } = arguments;
    let mut holder = Caller::connect(at)?;
    holder.demand("control take")?;
    let idle: Vec<UnixStream> =
        (0..*idle).map(|_| UnixStream::connect(at)).collect::<Result<_, _>>()?;
    let end = Arc::new(AtomicBool::new(false));
    let floods: Vec<_> = (0..*floods)
        .map(|_| {
            let (path, end) = (at.clone(), Arc::clone(&end));
            std::thread::spawn(move || flood(&path, &end))
        })
        .collect();
    std::thread::sleep(Duration::from_millis(300));
    let tried = (0..*tries).map_while(|_| {
        std::thread::sleep(Duration::from_millis(7));
        // Whoever has control and says nothing for two seconds may lose it to one that talks.
        let outcome = holder.ask("state").and_then(|_| stop(at));
        outcome.inspect_err(|error| println!("@stops failed: {error}")).ok()
    });
    let mut times: Vec<Nanos> = tried.map(|(took, _)| took).collect();
    let moved = (0..*moves).map_while(|_| {
        let outcome = stop_in_motion(at, &mut holder);
        outcome.inspect_err(|error| println!("@stops failed: {error}")).ok()
    });
    let mut moved: Vec<Nanos> = moved.collect();
    end.store(true, Ordering::Relaxed);
    for thread in floods {
        let _ = thread.join();
    }
    drop(idle);
    let rest = report("at rest", *tries, &mut times);
    Ok(report("in motion", *moves, &mut moved) && rest)
}

fn main() {
    let arguments = arguments().unwrap_or_else(|why| {
        println!("@stops {why}");
        std::process::exit(2);
    });
    if let Some(path) = &arguments.deaf {
        let _socket = UnixDatagram::bind(path).unwrap_or_else(|error| {
            println!("@stops {}: {error}", path.display());
            std::process::exit(2);
        });
        loop {
            std::thread::sleep(Duration::from_secs(3600));
        }
    }
    let ended = run(&arguments).inspect_err(|error| println!("@stops failed: {error}"));
    std::process::exit(i32::from(!ended.unwrap_or(false)));
}
