//! Questions to a running machine, one after the other, for programs that may wait for an answer.

use std::io::{Error, ErrorKind};
use std::path::Path;

use serde_json::{Value, json};
use taktil_rtcore::{Nanos, linux};

use crate::OperatorSocket;

/// An answer of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineAnswer {
    /// Whether it did what it was asked.
    pub is_ok: bool,
    /// A sentence for people; may be empty.
    pub text: String,
    /// Values; null where there are none.
    pub data: Value,
}

/// A connection over which one question is asked at a time.
#[derive(Debug)]
pub struct MachineClient {
    socket: OperatorSocket,
    asked: u64,
    /// Events that came while an answer was waited for.
    events: Vec<Value>,
}

/// Events that are kept while an answer is waited for; older ones are dropped.
const EVENTS_MAX: usize = 256;
/// How long a wait for a line lasts before the time is looked at again (ms).
const WAIT_STEP_MS: u16 = 20;

impl MachineClient {
    /// Connects to the socket of a run or of the service.
    ///
    /// # Errors
    /// As [`OperatorSocket::connect`].
    pub fn connect(path: &Path) -> Result<MachineClient, Error> {
        Ok(MachineClient { socket: OperatorSocket::connect(path)?, asked: 0, events: Vec::new() })
    }

    /// Says something and waits for the answer, at most for a time.
    ///
    /// # Errors
    /// The machine has gone, or has not answered in time.
    pub fn ask(&mut self, words: &str, timeout: Nanos) -> Result<MachineAnswer, Error> {
        self.asked += 1;
        let id = self.asked;
        self.socket.send(&json!({ "id": id, "say": words }).to_string())?;
        let until = linux::monotonic() + timeout;
        while let Some(value) = self.value_until(until)? {
            if value["event"].is_string() {
                if self.events.len() == EVENTS_MAX {
                    self.events.remove(0);
                }
                self.events.push(value);
            } else if value["id"] == json!(id) {
                return Ok(MachineAnswer {
                    is_ok: value["outcome"] == "ok",
                    text: value["text"].as_str().unwrap_or_default().to_owned(),
                    data: value["data"].clone(),
                });
            }
        }
        Err(Error::new(ErrorKind::TimedOut, "the machine does not answer"))
    }

    /// The next event, waiting for it at most for a time; `None` when none came.
    ///
    /// # Errors
    /// The machine has gone.
    pub fn event(&mut self, timeout: Nanos) -> Result<Option<Value>, Error> {
        if !self.events.is_empty() {
            return Ok(Some(self.events.remove(0)));
        }
        let until = linux::monotonic() + timeout;
        while let Some(value) = self.value_until(until)? {
            if value["event"].is_string() {
                return Ok(Some(value));
            }
        }
        Ok(None)
    }

    /// The next line as JSON. What is no JSON is an error that the machine tells before it hangs
    /// up.
    fn value_until(&mut self, until: Nanos) -> Result<Option<Value>, Error> {
        loop {
            self.socket.flush()?;
            if let Some(line) = self.socket.receive()? {
                return match serde_json::from_str(&line) {
                    Ok(value) => Ok(Some(value)),
                    Err(_) => Err(Error::new(ErrorKind::ConnectionAborted, line)),
                };
            }
            if linux::monotonic() >= until {
                return Ok(None);
            }
            self.socket.wait(WAIT_STEP_MS);
        }
    }
}
