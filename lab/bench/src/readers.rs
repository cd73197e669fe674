//! Counts for `taktil bench readers` the instructions of a lane's job with no reader of its
//! records and with eight readers. As a check that the count can differ at all, it also counts
//! without an observer that takes the records out of the ring.

use std::process::ExitCode;

use serde_json::json;
use taktil_lab_progress::Progress;
use taktil_machine_console::out;
use taktil_rtcore::Recording;
use taktil_rtcore::record::{Observer, Record};

use super::LONG_CHAIN_HOPS;
use super::chain::{Chain, ChainConfig, JOBS_PER_BATCH, PayloadKind};
use super::measure::callgrind_instructions;

/// The options of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// One JSON object instead of the table
    #[arg(long)]
    pub json: bool,
    /// Run so many cycles with so many readers and say nothing: what the counter calls
    #[arg(long, num_args = 2, value_names = ["READERS", "CYCLES"], hide = true)]
    pub only: Option<Vec<u64>>,
}

/// Number of readers that are compared with none.
const READER_COUNT: u64 = 8;
/// Number of readers that stands for no observer at all, so that the ring fills up.
const NO_OBSERVER: u64 = u64::MAX;
/// Number of jobs under the counter.
const COUNTED_JOBS: u64 = 20_000;
/// Largest relative difference between no reader and [`READER_COUNT`] readers.
const DIFFERENCE_MAX: f64 = 0.01;
/// Option of callgrind by which only jobs are counted; it matches both spellings of the symbol.
const JOBS_ONLY_OPTION: &str = "--toggle-collect=*bare*jobs*";

/// Readers that each keep the last value, as a client that displays values does.
struct RecordReaders(Vec<(u64, Vec<u8>)>);

impl Observer for RecordReaders {
    fn record(&mut self, record: &Record<'_>) {
        for (seen, body) in &mut self.0 {
            *seen += 1;
            body.clear();
            body.extend_from_slice(record.body);
        }
    }
}

fn run_counted(readers: u64, cycles: u64) -> anyhow::Result<()> {
    let shape = ChainConfig {
        hops: LONG_CHAIN_HOPS,
        payload: PayloadKind::F64x6,
        recording: Recording::Full,
        time_tasks: false,
    };
    let mut chain = Chain::new(shape)?;
    if readers == NO_OBSERVER {
        chain.run_undrained(cycles);
        return Ok(());
    }
    let mut readers = RecordReaders((0..readers).map(|_| (0, Vec::new())).collect());
    for _ in 0..cycles / JOBS_PER_BATCH {
        chain.run_undrained(JOBS_PER_BATCH);
        chain.drain(&mut readers);
    }
    Ok(())
}

/// Counts and prints the result; the exit code is 1 when readers change the work of a job.
///
/// # Errors
/// Callgrind is missing or fails.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    if let Some([readers, cycles]) = plan.only.as_deref() {
        run_counted(*readers, *cycles)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut found = [0.0; 3];
    let mut progress = Progress::new("counts", found.len());
    for (readers, found) in [0, READER_COUNT, NO_OBSERVER].into_iter().zip(&mut found) {
        let words = ["bench", "readers", "--only"].map(String::from);
        let numbers = [readers.to_string(), COUNTED_JOBS.to_string()];
        let counted = callgrind_instructions(
            &[JOBS_ONLY_OPTION],
            &[words.as_slice(), numbers.as_slice()].concat(),
        )?;
        #[expect(clippy::cast_precision_loss, reason = "figures for people")]
        let each = counted as f64 / COUNTED_JOBS as f64;
        *found = each;
        progress.advance();
    }
    drop(progress);
    let [none, many, abandoned] = found;
    let difference = (many - none).abs() / none;
    let holds = none > 0.0 && difference <= DIFFERENCE_MAX;
    if plan.json {
        let row = json!({ "none": none, "eight": many, "abandoned": abandoned });
        out::line(json!({ "instructions_a_job": row, "difference": difference, "holds": holds }))?;
    } else {
        out::text(format_args!(
            "instructions a job, a chain of {LONG_CHAIN_HOPS} hops, every value recorded\n  \
             no reader                {none:>10.1}\n  \
             {READER_COUNT} readers                {many:>10.1}\n  \
             nobody empties the ring  {abandoned:>10.1}\n  \
             difference of the first two: {:.3} %, limit 1 %\n",
            100.0 * difference
        ))?;
    }
    Ok(if holds { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
