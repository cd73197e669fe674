//! What is known of the machine: its newest status and image, and how fast its lanes go.

use std::path::PathBuf;

use taktil_machine_client::{MachineClient, Value};
use taktil_rtcore::{Nanos, linux};

/// How long an answer may take before the machine counts as gone.
const ANSWER_TIMEOUT: Nanos = Nanos::from_secs(1);
/// Time over which the rate of a lane is counted.
const RATE_INTERVAL: Nanos = Nanos::from_secs(1);
/// The signal with the tactile image.
const IMAGE: &str = "tactile_scan.image";

/// Jobs of each lane at an instant.
#[derive(Clone, Debug)]
struct JobCounts {
    at: Nanos,
    jobs: Vec<f64>,
}

/// The newest of everything that is shown.
#[derive(Debug)]
pub struct MachineView {
    path: PathBuf,
    client: Option<MachineClient>,
    has_watch: bool,
    counted: Option<JobCounts>,
    /// The machine's status; null before the first.
    pub(crate) status: Value,
    /// Counts, rows and columns of the image, by the machine's names.
    pub(crate) values: Value,
    /// Jobs of each lane in a second, in the order of the status.
    pub(crate) rates_per_s: Vec<f64>,
    /// What was said last: an answer to a stop, or why there is no machine.
    pub(crate) message: String,
}

impl MachineView {
    /// A view of the machine behind a socket; it is connected to when it is there.
    #[must_use]
    pub fn new(path: PathBuf) -> MachineView {
        MachineView {
            path,
            client: None,
            has_watch: false,
            counted: None,
            status: Value::Null,
            values: Value::Null,
            rates_per_s: Vec::new(),
            message: String::new(),
        }
    }

    /// Whether a status has come since the machine was last connected to.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.client.is_some()
    }

    /// Asks for what is new. A machine that has gone is connected to again.
    pub fn refresh(&mut self) {
        if let Err(error) = self.try_refresh() {
            self.client = None;
            self.has_watch = false;
            self.message = format!("no machine at {}: {error}", self.path.display());
        }
    }

    fn try_refresh(&mut self) -> std::io::Result<()> {
        if self.client.is_none() {
            self.client = Some(MachineClient::connect(&self.path)?);
            self.message.clear();
        }
        let Some(client) = &mut self.client else { return Ok(()) };
        let answer = client.ask("status", ANSWER_TIMEOUT)?;
        if !self.has_watch {
            // A machine that feels nothing refuses it, which is no fault.
            let words = format!("watch 10 {IMAGE}.counts {IMAGE}.rows {IMAGE}.cols");
            client.ask(&words, ANSWER_TIMEOUT)?;
            self.has_watch = true;
        }
        while let Some(mut event) = client.event(Nanos::ZERO)? {
            if event["event"] == "watch" {
                self.values = event["values"].take();
            }
        }
        if answer.is_ok {
            self.status = answer.data;
            self.count_jobs(linux::monotonic());
        }
        Ok(())
    }

    fn count_jobs(&mut self, now: Nanos) {
        let lanes = self.status["timing"].as_array().map(Vec::as_slice).unwrap_or_default();
        let jobs: Vec<f64> =
            lanes.iter().map(|lane| lane["jobs"].as_f64().unwrap_or(0.0)).collect();
        match &self.counted {
            Some(before) if now - before.at < RATE_INTERVAL => {}
            Some(before) if before.jobs.len() == jobs.len() => {
                let seconds = (now - before.at).as_secs_f64();
                let pairs = jobs.iter().zip(&before.jobs);
                self.rates_per_s = pairs.map(|(new, old)| (new - old) / seconds).collect();
                self.counted = Some(JobCounts { at: now, jobs });
            }
            _ => self.counted = Some(JobCounts { at: now, jobs }),
        }
    }

    /// Asks for a stop.
    pub fn stop(&mut self) {
        let Some(client) = &mut self.client else {
            self.message = "no machine hears the stop; use the emergency stop".into();
            return;
        };
        self.message = match client.ask("stop", ANSWER_TIMEOUT) {
            Ok(answer) => format!("stop: {}", answer.text),
            Err(error) => format!("stop: {error}; use the emergency stop"),
        };
    }

    /// The image in at most this many rows and columns, as shares of its largest count; empty
    /// without one. Larger images show the largest count of each block.
    pub(crate) fn image(&self, most: usize) -> Vec<Vec<f64>> {
        let number = |name: &str| self.values[format!("{IMAGE}.{name}")].as_u64().unwrap_or(0);
        let to_size = |value: u64| usize::try_from(value).unwrap_or(0);
        let (rows, cols) = (to_size(number("rows")), to_size(number("cols")));
        let counts = self.values[format!("{IMAGE}.counts")].as_array();
        let Some(counts) =
            counts.filter(|counts| rows > 0 && cols > 0 && counts.len() >= rows * cols)
        else {
            return Vec::new();
        };
        let count = |at: usize| counts[at].as_f64().unwrap_or(0.0);
        let largest = (0..rows * cols).map(count).fold(IMAGE_COUNTS_MIN, f64::max);
        let step = rows.max(cols).div_ceil(most);
        let block = |row: usize, col: usize| {
            let inside = (row..(row + step).min(rows))
                .flat_map(|r| (col..(col + step).min(cols)).map(move |c| r * cols + c));
            inside.map(count).fold(0.0, f64::max) / largest
        };
        (0..rows)
            .step_by(step)
            .map(|row| (0..cols).step_by(step).map(|col| block(row, col)).collect())
            .collect()
    }
}

/// Counts that are shown as full at least, so that noise stays dark.
const IMAGE_COUNTS_MIN: f64 = 300.0;
