//! A library of another language in a process of its own: it gets the arm and the samples once,
//! then an order a slice, and times itself. The benchmark ends with an error when it stops
//! answering.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;

use crate::{Sample, rows};

/// One running peer.
pub struct Peer {
    /// What it is called.
    pub name: String,
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts `NAME=PROGRAM` and tells it the arm and the samples.
    ///
    /// # Errors
    /// No such program, or it closes its ends.
    pub fn start(named: &str, samples: &[Sample]) -> Result<Peer> {
        let (name, program) = named.split_once('=').context("give --peer NAME=PROGRAM")?;
        let mut child = Command::new(program)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("{program} does not start"))?;
        let orders = child.stdin.take().context("no standard input")?;
        let answers = BufReader::new(child.stdout.take().context("no standard output")?);
        let mut peer = Peer { name: name.to_owned(), child, orders, answers };
        writeln!(peer.orders, "{}", arm())?;
        writeln!(peer.orders, "{}", samples.len())?;
        for sample in samples {
            for x in sample.q.iter().chain(&sample.qd).chain(&sample.qdd) {
                write!(peer.orders, "{x:e} ")?;
            }
            writeln!(peer.orders)?;
        }
        Ok(peer)
    }

    fn line(&mut self) -> Result<Vec<f64>> {
        let mut line = String::new();
        if self.answers.read_line(&mut line)? == 0 {
            bail!("{} stopped answering", self.name);
        }
        line.split_whitespace().map(|word| Ok(word.parse()?)).collect()
    }

    /// What it answers for each sample: pose (rotation row by row, place), tool Jacobian row by
    /// row, torques.
    ///
    /// # Errors
    /// It stops, or says what is no number.
    pub fn answers(&mut self, count: usize) -> Result<Vec<Vec<f64>>> {
        writeln!(self.orders, "answers")?;
        (0..count).map(|_| self.line()).collect()
    }

    /// One slice: nanoseconds a call.
    ///
    /// # Errors
    /// As [`Peer::answers`].
    pub fn time(&mut self, order: &str, rounds: u32) -> Result<f64> {
        writeln!(self.orders, "{order} {rounds}")?;
        self.line()?.first().copied().context("an empty answer")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It ends with its input; what cannot be ended has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The arm as the peers read it: tool length, then a row a joint.
fn arm() -> String {
    let (arm, dynamics) = (Puma260::reference(), Dynamics::reference());
    let mut text = format!("{:e}", arm.tool_z_m);
    for ((a, d, alpha), body) in rows(&arm).iter().zip(dynamics.bodies()) {
        let (c, i) = (body.com_m, body.inertia_kg_m2);
        let numbers =
            [*a, *d, *alpha, body.mass_kg, c.x, c.y, c.z, i.x_axis.x, i.y_axis.y, i.z_axis.z];
        for number in numbers {
            text.push_str(&format!(" {number:e}"));
        }
    }
    text
}
