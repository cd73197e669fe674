//! `taktil move` and `taktil tell`: the operator's words to a running machine, and its answers.
//! Refuses to go on after a refusal: what follows was meant for a machine that had obeyed.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use taktil_machine_console::out;

use taktil_machine_console::option::BadOption;

/// Longest that an answer may take: moves are waited for.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3600);

/// A connection to a running machine.
pub struct Line {
    stream: BufReader<UnixStream>,
}

impl Line {
    /// Connects to the socket of a run or of the service.
    ///
    /// # Errors
    /// [`BadOption`] when nobody listens there.
    pub fn open(path: &Path) -> anyhow::Result<Line> {
        let shown = path.display();
        let stream = UnixStream::connect(path).map_err(|error| {
            BadOption(format!(
                "nobody listens at `{shown}` ({error}); start `taktil run SCENE --operator \
                 {shown}`, or give the service an [operator] section"
            ))
        })?;
        stream.set_read_timeout(Some(ANSWER_TIMEOUT))?;
        Ok(Line { stream: BufReader::new(stream) })
    }

    /// Says one line; nothing is waited for.
    ///
    /// # Errors
    /// The machine is gone.
    pub fn say(&mut self, words: &str) -> anyhow::Result<()> {
        let text = format!("{}\n", words.trim());
        self.stream.get_mut().write_all(text.as_bytes()).context("the machine has gone")
    }

    /// The next answer.
    ///
    /// # Errors
    /// The machine is gone.
    pub fn answer(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        match self.stream.read_line(&mut line) {
            Ok(0) => bail!("the machine has gone"),
            Ok(_) => Ok(line.trim_end().to_owned()),
            Err(error) => Err(error).context("the machine does not answer"),
        }
    }
}

/// Whether a line is answered: what says nothing is not.
fn is_answered(words: &str) -> bool {
    words.split('#').next().is_some_and(|words| !words.trim().is_empty())
}

/// Says lines one after the other and prints the answers.
///
/// # Errors
/// [`BadOption`] when nobody listens; the machine is gone.
pub fn say(path: &Path, lines: impl IntoIterator<Item = String>) -> anyhow::Result<ExitCode> {
    let mut line = Line::open(path)?;
    for words in lines {
        if !exchange(&mut line, &words)? {
            return Ok(ExitCode::from(1));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Says every line of standard input.
///
/// # Errors
/// As [`say`].
pub fn script(path: &Path) -> anyhow::Result<ExitCode> {
    let mut line = Line::open(path)?;
    for words in std::io::stdin().lock().lines() {
        if !exchange(&mut line, &words?)? {
            return Ok(ExitCode::from(1));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// One line and its answer; false when it was refused.
fn exchange(line: &mut Line, words: &str) -> anyhow::Result<bool> {
    if words.contains('\n') {
        bail!(BadOption("one thing a line".into()));
    }
    line.say(words)?;
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
