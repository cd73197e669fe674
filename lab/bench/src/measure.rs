//! Contestants in alternating slices of one process, then each alone under callgrind. Refuses to
//! print a mean: a slice on a shared machine is noise, the median of many is not.

use std::fmt::Write as _;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde_json::{Value, json};
use taktil_rtcore::{Nanos, linux};

/// How long to measure.
#[derive(Clone, Debug, clap::Args)]
pub struct Plan {
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

impl Plan {
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

/// One chain on one executor.
pub struct Contestant {
    /// Whose executor.
    pub who: &'static str,
    /// What flows.
    pub flow: &'static str,
    /// How it is run.
    pub way: &'static str,
    /// Hops between source and sink.
    pub hops: usize,
    /// Runs so many cycles; the time they took.
    pub run: Box<dyn FnMut(u64) -> Nanos>,
}

/// Adds up laps on the monotonic clock.
#[derive(Default)]
pub struct Watch {
    begun: Nanos,
    sum: Nanos,
}

impl Watch {
    /// A lap begins or ends.
    pub fn lap(&mut self, begin: bool) {
        let now = linux::monotonic();
        if begin {
            self.begun = now;
        } else {
            self.sum += now - self.begun;
        }
    }

    /// All laps together.
    #[must_use]
    pub fn total(&self) -> Nanos {
        self.sum
    }
}

/// All contestants and what was found.
pub struct Contest {
    contestants: Vec<Contestant>,
    /// Nanoseconds a cycle, slice by slice.
    slices: Vec<Vec<f64>>,
    instructions: Vec<Option<f64>>,
}

/// Cycles under the counter: the difference of the two runs is counted, so that neither start nor
/// end is.
const COUNTED: [u64; 2] = [1_000, 3_000];

impl Contest {
    pub(super) fn new(contestants: Vec<Contestant>) -> Contest {
        let slices = contestants.iter().map(|_| Vec::new()).collect();
        let instructions = contestants.iter().map(|_| None).collect();
        Contest { contestants, slices, instructions }
    }

    pub(super) fn time(&mut self, plan: &Plan) {
        for contestant in &mut self.contestants {
            (contestant.run)(plan.cycles.min(1000));
        }
        for _ in 0..plan.slices {
            for (contestant, slices) in self.contestants.iter_mut().zip(&mut self.slices) {
                let took = (contestant.run)(plan.cycles);
                #[expect(clippy::cast_precision_loss, reason = "figures for people")]
                slices.push(took.0 as f64 / plan.cycles as f64);
            }
        }
    }

    /// Each contestant in a process of its own under callgrind, twice.
    pub(super) fn count(&mut self) -> anyhow::Result<()> {
        for place in 0..self.contestants.len() {
            let [few, many] = COUNTED.map(|cycles| count_one(place, cycles));
            #[expect(clippy::cast_precision_loss, reason = "figures for people")]
            let a_cycle = (many? - few?) as f64 / (COUNTED[1] - COUNTED[0]) as f64;
            self.instructions[place] = Some(a_cycle);
        }
        Ok(())
    }

    /// Median and quartiles of the time of a cycle, ns.
    fn cycle_ns(&self, place: usize) -> [f64; 3] {
        let mut sorted = self.slices[place].clone();
        sorted.sort_by(f64::total_cmp);
        [1, 2, 3].map(|quarter| sorted[(sorted.len() - 1) * quarter / 4])
    }

    /// The same chain without hops.
    fn without_hops(&self, place: usize) -> Option<usize> {
        let this = &self.contestants[place];
        (this.hops > 0).then_some(())?;
        self.contestants.iter().position(|other| {
            (other.who, other.flow, other.way, other.hops) == (this.who, this.flow, this.way, 0)
        })
    }

    /// Median of what one hop adds, slice by slice, ns; and instructions.
    fn hop(&self, place: usize) -> Option<(f64, Option<f64>)> {
        let base = self.without_hops(place)?;
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let hops = self.contestants[place].hops as f64;
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
        let rows = self.contestants.iter().enumerate().map(|(place, contestant)| {
            let [low, median, high] = self.cycle_ns(place);
            let hop = self.hop(place);
            json!({
                "who": contestant.who, "flow": contestant.flow, "way": contestant.way,
                "hops": contestant.hops, "slices": self.slices[place].len(),
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
        for (place, contestant) in self.contestants.iter().enumerate() {
            let [low, median, high] = self.cycle_ns(place);
            let hop = self.hop(place);
            let number = |n: Option<f64>, digits: usize| {
                n.map_or_else(|| "-".to_owned(), |n| format!("{n:.digits$}"))
            };
            let _ = writeln!(
                out,
                "{:<8} {:<9} {:<22} {:>4} {:>22} {:>8} {:>8} {:>8}",
                contestant.who,
                contestant.flow,
                contestant.way,
                contestant.hops,
                format!("{median:.1} ({low:.1}..{high:.1})"),
                number(hop.map(|(ns, _)| ns), 1),
                number(self.instructions[place], 0),
                number(hop.and_then(|(_, counted)| counted), 0),
            );
        }
        out
    }
}

/// Instructions of a run of so many cycles, start and end included.
fn count_one(place: usize, cycles: u64) -> anyhow::Result<u64> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    arguments.retain(|argument| argument != "--instructions");
    arguments.extend(["--only".into(), place.to_string(), cycles.to_string()]);
    count(&[], &arguments)
}

/// Instructions of this program with other arguments, under callgrind.
pub(super) fn count(options: &[&str], arguments: &[String]) -> anyhow::Result<u64> {
    let program = std::env::current_exe().context("this program's own path")?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .args(options)
        .arg(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .context("instructions are counted by callgrind: install the package valgrind")?;
    let said = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        bail!("callgrind failed ({}): {}", output.status, said.trim());
    }
    said.lines()
        .find_map(|line| line.split("Collected : ").nth(1)?.trim().parse().ok())
        .context("callgrind counted nothing")
}
