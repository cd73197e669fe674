//! `taktil bench readers`: the instructions of a lane's job while nobody reads its records, while
//! eight do, and, to show that the count could differ, while nobody even takes them out of the
//! ring. Refuses to count anything but jobs.

use std::process::ExitCode;

use serde_json::json;
use taktil_machine_console::out;
use taktil_rtcore::Recording;
use taktil_rtcore::record::{Observer, Record};

use super::HOPS;
use super::chain::{BATCH, Chain, Flow, Shape};
use super::measure::count;

/// How to print, and what the counter calls.
#[derive(Clone, Debug, clap::Args)]
pub struct Plan {
    /// One JSON object instead of the table
    #[arg(long)]
    pub json: bool,
    /// Run so many cycles with so many readers and say nothing: what the counter calls
    #[arg(long, num_args = 2, value_names = ["READERS", "CYCLES"], hide = true)]
    pub only: Option<Vec<u64>>,
}

/// Readers of the comparison.
const MANY: u64 = 8;
/// Stands for nobody, not even a carrying thread: the ring fills up.
const ABANDONED: u64 = u64::MAX;
/// Jobs that are counted.
const CYCLES: u64 = 20_000;
/// Largest relative difference between no reader and many.
const LIMIT: f64 = 0.01;
/// Only jobs are counted; both spellings of the name.
const JOBS: &str = "--toggle-collect=*bare*jobs*";

/// Each keeps what it read last, as a client that shows values does.
struct Readers(Vec<(u64, Vec<u8>)>);

impl Observer for Readers {
    fn record(&mut self, record: &Record<'_>) {
        for (seen, body) in &mut self.0 {
            *seen += 1;
            body.clear();
            body.extend_from_slice(record.body);
        }
    }
}

fn child(readers: u64, cycles: u64) -> anyhow::Result<()> {
    let shape =
        Shape { hops: HOPS, flow: Flow::F64x6, recording: Recording::Full, time_tasks: false };
    let mut chain = Chain::new(shape)?;
    if readers == ABANDONED {
        chain.run_undrained(cycles);
        return Ok(());
    }
    let mut readers = Readers((0..readers).map(|_| (0, Vec::new())).collect());
    for _ in 0..cycles / BATCH {
        chain.run_undrained(BATCH);
        chain.drain(&mut readers);
    }
    Ok(())
}

/// Counts and judges: exit code 1 when readers change a job's work.
///
/// # Errors
/// No callgrind.
pub fn run(plan: &Plan) -> anyhow::Result<ExitCode> {
    if let Some([readers, cycles]) = plan.only.as_deref() {
        child(*readers, *cycles)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut found = [0.0; 3];
    for (readers, found) in [0, MANY, ABANDONED].into_iter().zip(&mut found) {
        let words = ["bench", "readers", "--only"].map(String::from);
        let numbers = [readers.to_string(), CYCLES.to_string()];
        let counted = count(&[JOBS], &[words.as_slice(), numbers.as_slice()].concat())?;
        #[expect(clippy::cast_precision_loss, reason = "figures for people")]
        let each = counted as f64 / CYCLES as f64;
        *found = each;
    }
    let [none, many, abandoned] = found;
    let difference = (many - none).abs() / none;
    let holds = none > 0.0 && difference <= LIMIT;
    if plan.json {
        let row = json!({ "none": none, "eight": many, "abandoned": abandoned });
        out::line(json!({ "instructions_a_job": row, "difference": difference, "holds": holds }))?;
    } else {
        out::text(format_args!(
            "instructions a job, a chain of {HOPS} hops, every value recorded\n  \
             no reader                {none:>10.1}\n  \
             {MANY} readers                {many:>10.1}\n  \
             nobody empties the ring  {abandoned:>10.1}\n  \
             difference of the first two: {:.3} %, limit 1 %\n",
            100.0 * difference
        ))?;
    }
    Ok(if holds { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
