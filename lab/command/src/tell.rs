//! `taktil move` and `taktil tell`: send the operator's commands to a running machine and print its
//! answers. A script ends at the first command that is refused, because the following ones assume
//! that it was executed.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use taktil_hal::{Clock, Nanos};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_rtcore::linux::MonotonicClock;

/// Time between two words of keys that are held: the machine lets go after four times as long.
const JOG_REPETITION: Duration = Duration::from_millis(10);
/// Longest time for which keys are held (s).
const HELD_MAX_S: f64 = 60.0;

/// Longest time until an answer: the answer to `wait` comes at the end of all moves.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3600);

/// A connection to a running machine.
pub struct OperatorConnection {
    stream: BufReader<UnixStream>,
}

impl OperatorConnection {
    /// Connects to the socket of a run or of the service.
    ///
    /// # Errors
    /// [`BadOption`] when no process accepts connections there.
    pub fn connect(path: &Path) -> anyhow::Result<OperatorConnection> {
        let shown = path.display();
        let stream = UnixStream::connect(path).map_err(|error| {
            BadOption(format!(
                "nobody listens at `{shown}` ({error}); start `taktil run SCENE --operator \
                 {shown}`, or give the service an [operator] section"
            ))
        })?;
        stream.set_read_timeout(Some(ANSWER_TIMEOUT))?;
        Ok(OperatorConnection { stream: BufReader::new(stream) })
    }

    /// Sends one line without waiting for an answer.
    ///
    /// # Errors
    /// The connection is closed.
    pub fn send(&mut self, words: &str) -> anyhow::Result<()> {
        let text = format!("{}\n", words.trim());
        self.stream.get_mut().write_all(text.as_bytes()).context("the machine has gone")
    }

    /// Receives the next answer.
    ///
    /// # Errors
    /// The connection is closed.
    pub fn answer(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        match self.stream.read_line(&mut line) {
            Ok(0) => bail!("the machine has gone"),
            Ok(_) => Ok(line.trim_end().to_owned()),
            Err(error) => Err(error).context("the machine does not answer"),
        }
    }
}

/// Whether a line has an answer: empty lines and comments have none.
fn is_answered(words: &str) -> bool {
    words.split('#').next().is_some_and(|words| !words.trim().is_empty())
}

/// Sends lines one after the other and prints the answers.
///
/// # Errors
/// [`BadOption`] when no process accepts connections; a connection that was closed.
pub fn send_lines(
    path: &Path,
    lines: impl IntoIterator<Item = String>,
) -> anyhow::Result<ExitCode> {
    let mut line = OperatorConnection::connect(path)?;
    for words in lines {
        if !exchange(&mut line, &words)? {
            return Ok(ExitCode::from(1));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Sends what the command line of `taktil tell` asks for.
///
/// # Errors
/// As [`send_lines`]; [`BadOption`] for keys without a time, and for a time without keys.
pub fn run(path: &Path, held_s: Option<f64>, words: &str) -> anyhow::Result<ExitCode> {
    if words.contains('\n') {
        bail!(BadOption("one thing a line".into()));
    }
    let is_jog = words.split_whitespace().next() == Some("jog");
    match held_s {
        Some(held_s) if !is_jog => bail!(BadOption(format!(
            "--for {held_s}: only `jog` is held; leave the option out, or give the keys behind it"
        ))),
        Some(held_s) if !(held_s > 0.0 && held_s <= HELD_MAX_S) => {
            bail!(BadOption(format!("--for {held_s}: give seconds above 0, at most {HELD_MAX_S}")))
        }
        Some(held_s) => hold(path, words, held_s),
        None if is_jog => bail!(BadOption(format!(
            "`{words}` moves nothing: keys are held only as long as they are said again; give a \
             time, as in `--for 0.5`, or use `taktil keys`"
        ))),
        None if words.is_empty() => send_standard_input(path),
        None => send_lines(path, [words.to_owned()]),
    }
}

/// Says the keys again until their time is over, and lets go. Every answer that is not the one
/// before is printed.
fn hold(path: &Path, words: &str, held_s: f64) -> anyhow::Result<ExitCode> {
    let mut line = OperatorConnection::connect(path)?;
    let mut last_answer = String::new();
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    while clock.now().as_secs_f64() < held_s {
        line.send(words)?;
        let answer = line.answer()?;
        if !answer.starts_with("ok") {
            out::warn(&answer);
            return Ok(ExitCode::from(1));
        }
        if answer != last_answer {
            out::line(&answer)?;
            last_answer = answer;
        }
        std::thread::sleep(JOG_REPETITION);
    }
    Ok(ExitCode::from(u8::from(!exchange(&mut line, "release")?)))
}

/// Sends every line of standard input.
///
/// # Errors
/// As [`send_lines`].
pub fn send_standard_input(path: &Path) -> anyhow::Result<ExitCode> {
    let mut line = OperatorConnection::connect(path)?;
    for words in std::io::stdin().lock().lines() {
        if !exchange(&mut line, &words?)? {
            return Ok(ExitCode::from(1));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Sends one line and prints the answer; returns false when the line was refused.
fn exchange(line: &mut OperatorConnection, words: &str) -> anyhow::Result<bool> {
    if words.contains('\n') {
        bail!(BadOption("one thing a line".into()));
    }
    line.send(words)?;
    if !is_answered(words) {
        return Ok(true);
    }
    let answer = line.answer()?;
    if answer.starts_with("ok") {
        out::line(&answer)?;
        return Ok(true);
    }
    out::warn(&answer);
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_are_not_answered() {
        for words in ["", "  ", "# nothing", "   # enable"] {
            assert!(!is_answered(words), "{words}");
        }
        assert!(is_answered("state") && is_answered(" move by 0 0 5 # slowly"));
    }
}
