//! Runs benchmark cases in alternating time slices of one process, and each of them alone under
//! callgrind. Results are medians and quartiles, because a single slice on a shared machine is
//! noise and a mean would keep it.

use std::fmt::Write as _;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde_json::{Value, json};
use taktil_lab_progress::Progress;
use taktil_rtcore::{Nanos, linux};

/// The options of a measurement.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Cycles of one slice
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub cycles: u64,
    /// Slices of each chain, in turns
    #[arg(long, value_name = "N", default_value_t = 21)]
    pub slices: u32,
    /// Count instructions too, with callgrind (package valgrind)
    #[arg(long)]
    pub instructions: bool,
    /// One JSON object instead of the table
    #[arg(long)]
    pub json: bool,
    /// Run one chain alone for so many cycles and say nothing: what the counter calls
    #[arg(long, num_args = 2, value_names = ["CHAIN", "CYCLES"], hide = true)]
    pub only: Option<Vec<u64>>,
}

impl Options {
    pub(super) fn check(&self) -> Result<(), String> {
        if !(1..=10_000_000).contains(&self.cycles) {
            return Err(format!("--cycles {}: give 1 to 10000000", self.cycles));
        }
        if !(1..=10_000).contains(&self.slices) {
            return Err(format!("--slices {}: give 1 to 10000", self.slices));
        }
        Ok(())
    }
}

/// One chain on one executor, in one configuration.
pub struct BenchmarkCase {
    /// Name of the executor.
    pub executor: &'static str,
    /// Payload of the chain.
    pub payload: &'static str,
    /// Configuration of the executor.
    pub configuration: &'static str,
    /// Hops between source and sink.
    pub hops: usize,
    /// Runs the given number of cycles and returns the time that they took.
    pub run: Box<dyn FnMut(u64) -> Nanos>,
}

/// A stopwatch that adds up laps on the monotonic clock.
#[derive(Default)]
pub struct Stopwatch {
    started: Nanos,
    sum: Nanos,
}

impl Stopwatch {
    /// Begins a lap, or ends the current one.
    pub fn lap(&mut self, begin: bool) {
        let now = linux::monotonic();
        if begin {
            self.started = now;
        } else {
            self.sum += now - self.started;
        }
    }

    /// Sum of all laps.
    #[must_use]
    pub fn total(&self) -> Nanos {
        self.sum
    }
}

/// All cases with their measured times and instructions.
pub struct Benchmark {
    cases: Vec<BenchmarkCase>,
    /// Time of a cycle (ns) for each case and slice.
    slices: Vec<Vec<f64>>,
    instructions: Vec<Option<f64>>,
}

/// Numbers of cycles of the two runs under the counter. Their difference is evaluated, so that
/// start and end of the program do not count.
const COUNTED_CYCLES: [u64; 2] = [1_000, 3_000];

impl Benchmark {
    pub(super) fn new(cases: Vec<BenchmarkCase>) -> Benchmark {
        let slices = cases.iter().map(|_| Vec::new()).collect();
        let instructions = cases.iter().map(|_| None).collect();
        Benchmark { cases, slices, instructions }
    }

    pub(super) fn measure_times(&mut self, plan: &Options) {
        for case in &mut self.cases {
            (case.run)(plan.cycles.min(1000));
        }
        let mut progress = Progress::new("slices", plan.slices as usize);
        for _ in 0..plan.slices {
            for (case, slices) in self.cases.iter_mut().zip(&mut self.slices) {
                let duration = (case.run)(plan.cycles);
                #[expect(clippy::cast_precision_loss, reason = "figures for people")]
                slices.push(duration.0 as f64 / plan.cycles as f64);
            }
            progress.advance();
        }
    }

    /// Runs each case twice in a process of its own under callgrind.
    pub(super) fn count_instructions(&mut self) -> anyhow::Result<()> {
        let mut progress = Progress::new("chains counted", self.cases.len());
        for place in 0..self.cases.len() {
            let [few, many] = COUNTED_CYCLES.map(|cycles| case_instructions(place, cycles));
            #[expect(clippy::cast_precision_loss, reason = "figures for people")]
            let per_cycle = (many? - few?) as f64 / (COUNTED_CYCLES[1] - COUNTED_CYCLES[0]) as f64;
            self.instructions[place] = Some(per_cycle);
            progress.advance();
        }
        Ok(())
    }

    /// Median and quartiles of the time of a cycle, ns.
    fn cycle_quartiles_ns(&self, place: usize) -> [f64; 3] {
        let mut sorted = self.slices[place].clone();
        sorted.sort_by(f64::total_cmp);
        [1, 2, 3].map(|quarter| sorted[(sorted.len() - 1) * quarter / 4])
    }

    /// The case with the same executor, payload and configuration but without hops.
    fn case_without_hops(&self, place: usize) -> Option<usize> {
        let this = &self.cases[place];
        (this.hops > 0).then_some(())?;
        self.cases.iter().position(|other| {
            (other.executor, other.payload, other.configuration, other.hops)
                == (this.executor, this.payload, this.configuration, 0)
        })
    }

    /// What one hop adds: the median over slices (ns), and instructions.
    fn hop_cost(&self, place: usize) -> Option<(f64, Option<f64>)> {
        let base = self.case_without_hops(place)?;
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let hops = self.cases[place].hops as f64;
        let pairs = self.slices[place].iter().zip(&self.slices[base]);
        let mut each: Vec<f64> = pairs.map(|(long, short)| (long - short) / hops).collect();
        each.sort_by(f64::total_cmp);
        let counted = match (self.instructions[place], self.instructions[base]) {
            (Some(long), Some(short)) => Some((long - short) / hops),
            _ => None,
        };
        Some((each[(each.len() - 1) / 2], counted))
    }

    pub(super) fn json(&self) -> Value {
        let rows = self.cases.iter().enumerate().map(|(place, case)| {
            let [low, median, high] = self.cycle_quartiles_ns(place);
            let hop = self.hop_cost(place);
            json!({
                "who": case.executor, "flow": case.payload, "way": case.configuration,
                "hops": case.hops, "slices": self.slices[place].len(),
                "cycle_ns": { "p25": low, "p50": median, "p75": high },
                "cycle_instructions": self.instructions[place],
                "hop_ns": hop.map(|(ns, _)| ns),
                "hop_instructions": hop.and_then(|(_, counted)| counted),
            })
        });
        json!({ "chains": rows.collect::<Vec<_>>() })
    }

    pub(super) fn table(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(
            out,
            "{:<8} {:<9} {:<22} {:>4} {:>22} {:>8} {:>8} {:>8}",
            "", "payload", "", "hops", "cycle ns (quartiles)", "hop ns", "instr", "hop"
        );
        for (place, case) in self.cases.iter().enumerate() {
            let [low, median, high] = self.cycle_quartiles_ns(place);
            let hop = self.hop_cost(place);
            let number = |n: Option<f64>, digits: usize| {
                n.map_or_else(|| "-".to_owned(), |n| format!("{n:.digits$}"))
            };
            let _ = writeln!(
                out,
                "{:<8} {:<9} {:<22} {:>4} {:>22} {:>8} {:>8} {:>8}",
                case.executor,
                case.payload,
                case.configuration,
                case.hops,
                format!("{median:.1} ({low:.1}..{high:.1})"),
                number(hop.map(|(ns, _)| ns), 1),
                number(self.instructions[place], 0),
                number(hop.and_then(|(_, counted)| counted), 0),
            );
        }
        out
    }
}

/// Instructions of a run of the given number of cycles, including start and end of the program.
fn case_instructions(place: usize, cycles: u64) -> anyhow::Result<u64> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    arguments.retain(|argument| argument != "--instructions");
    arguments.extend(["--only".into(), place.to_string(), cycles.to_string()]);
    callgrind_instructions(&[], &arguments)
}

/// Instructions of this program with other arguments, under callgrind.
pub(super) fn callgrind_instructions(
    options: &[&str],
    arguments: &[String],
) -> anyhow::Result<u64> {
    let program = std::env::current_exe().context("this program's own path")?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .args(options)
        .arg(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .context("instructions are counted by callgrind: install the package valgrind")?;
    let report = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        bail!("callgrind failed ({}): {}", output.status, report.trim());
    }
    report
        .lines()
        .find_map(|line| line.split("Collected : ").nth(1)?.trim().parse().ok())
        .context("callgrind counted nothing")
}
