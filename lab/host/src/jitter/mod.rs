//! `taktil jitter`: measures how late this machine releases jobs, on the real executor with empty
//! lanes, and beside cyclictest on request. Figures of a virtual machine, of a kernel without
//! PREEMPT_RT or of an ordinary thread carry a warning that they do not represent a robot's
//! computer.

pub mod compare;
pub mod cyclictest;
mod load;
pub mod measure;
mod picture;
mod report;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use serde_json::Value;
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, SecondSignal};
use taktil_rtcore::Nanos;

use compare::Comparison;
use cyclictest::Cyclictest;
use load::Load;
use measure::{Lanes, Measurement};
use taktil_machine_console::option::{BadOption, check_writable};

/// The arguments of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct JitterArgs {
    /// Rates of the lanes; several are separated by commas, the first has the highest priority
    #[arg(long, value_name = "HZ", value_delimiter = ',', default_value = "400")]
    pub rate_hz: Vec<f64>,
    /// SCHED_FIFO priority of the first lane
    #[arg(long, value_name = "N", default_value_t = 80,
          value_parser = clap::value_parser!(u8).range(1..=99))]
    pub priority: u8,
    /// CPU to run on; any when absent
    #[arg(long, value_name = "N")]
    pub cpu: Option<usize>,
    /// Phase of the first lane, and cyclictest's: how releases stand to the kernel's tick, which
    /// is 150 us before the epoch (350 or 850 puts 400 Hz and 1 kHz on a tick)
    #[arg(long, value_name = "US")]
    pub phase_us: Option<u32>,
    /// Seconds in all
    #[arg(long = "for", value_name = "S", default_value_t = 10.0)]
    pub for_s: f64,
    /// Wake early and spin to the release; the value is the largest share of a CPU to burn
    #[arg(long, value_name = "SHARE", num_args = 0..=1, default_missing_value = "0.2")]
    pub guard: Option<f64>,
    /// Load the machine meanwhile: CPU, memory and disk, at ordinary priority
    #[arg(long)]
    pub load: bool,
    /// Alternate with cyclictest (package rt-tests) on the same CPU at the same priority
    #[arg(long)]
    pub cyclictest: bool,
    /// Seconds of one slice with --cyclictest; --for holds as many pairs as fit
    #[arg(long = "slice", value_name = "S", default_value_t = 5.0)]
    pub slice_s: f64,
    /// Draw the histogram to this file
    #[arg(long, value_name = "F.svg")]
    pub svg: Option<PathBuf>,
    /// One JSON object on standard output instead of the table
    #[arg(long)]
    pub json: bool,
}

/// Longest measurement (s): a day.
const DURATION_MAX_S: f64 = 86_400.0;
/// Shortest slice (s); shorter ones have too few jobs for percentiles.
const DURATION_MIN_S: f64 = 0.1;

/// All results of a measurement.
pub(crate) struct Findings<'a> {
    pub(crate) arguments: &'a JitterArgs,
    pub(crate) ours: Measurement,
    pub(crate) comparison: Option<Comparison>,
    pub(crate) interrupted: bool,
}

/// Measures and prints the result; the exit code is 0 however late the machine is.
///
/// # Errors
/// [`BadOption`] for what cannot be used, also for a cyclictest that is not there.
pub fn run(arguments: &JitterArgs) -> anyhow::Result<ExitCode> {
    let lanes = lanes(arguments)?;
    let pairs = pairs(arguments)?;
    if let Some(path) = &arguments.svg {
        check_writable("--svg", path)?;
    }
    let theirs = if arguments.cyclictest { Some(Cyclictest::find(&lanes)?) } else { None };
    let stop = signals::watch(SecondSignal::Exits)?;
    let load = if arguments.load { Some(Load::start()?) } else { None };
    let mut ours = Measurement::new(&lanes);
    let comparison = match &theirs {
        None => {
            ours.run_slice(&lanes, seconds(arguments.for_s), &stop)?;
            None
        }
        Some(theirs) => Some(alternate(arguments, pairs, &lanes, theirs, &mut ours, &stop)?),
    };
    drop(load);
    let interrupted = stop.load(Ordering::SeqCst);
    let findings = Findings { arguments, ours, comparison, interrupted };
    let found: Value = report::json(&findings);
    if arguments.json {
        out::line(&found)?;
    } else {
        // As it is: a warning has a colour.
        out::deliver(&mut std::io::stdout().lock(), &report::table(&findings))?;
    }
    if let Some(path) = &arguments.svg {
        std::fs::write(path, picture::draw(&findings))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs slices in the order ours, theirs, theirs, ours, ours ... The slices of each pair are
/// neighbours, drift affects both alike, and every second pair of neighbours is cyclictest against
/// itself.
fn alternate(
    arguments: &JitterArgs,
    pairs: usize,
    lanes: &Lanes,
    theirs: &Cyclictest,
    ours: &mut Measurement,
    stop: &AtomicBool,
) -> anyhow::Result<Comparison> {
    let slice = seconds(arguments.slice_s);
    let period = lanes.specs.first().map_or(slice, |spec| spec.period);
    let mut comparison = Comparison::new((slice.0 / period.0).unsigned_abs());
    for pair in 0..pairs {
        let ours_first = pair % 2 == 0;
        let first = ours_first.then(|| ours.run_slice(lanes, slice, stop)).transpose()?;
        if stop.load(Ordering::SeqCst) {
            break;
        }
        let cyclictest = theirs.run_slice(slice, stop)?;
        if stop.load(Ordering::SeqCst) {
            break;
        }
        let lateness = match first {
            Some(lateness) => lateness,
            None => ours.run_slice(lanes, slice, stop)?,
        };
        if stop.load(Ordering::SeqCst) {
            break;
        }
        comparison.add_pair(&lateness, &cyclictest);
        out::hint(format_args!("\rpair {} of {pairs}", pair + 1));
    }
    out::warn("");
    Ok(comparison)
}

fn seconds(s: f64) -> Nanos {
    #[expect(clippy::cast_possible_truncation, reason = "checked: at most a day")]
    let ns = (s * 1e9).round() as i64;
    Nanos(ns)
}

fn lanes(arguments: &JitterArgs) -> anyhow::Result<Lanes> {
    if arguments.cyclictest && arguments.rate_hz.len() != 1 {
        let what = "--cyclictest compares one lane; give one --rate-hz";
        return Err(BadOption(what.to_owned()).into());
    }
    if let Some(cpu) = arguments.cpu {
        let present = PathBuf::from(format!("/sys/devices/system/cpu/cpu{cpu}")).exists();
        if !present {
            return Err(BadOption(format!("--cpu {cpu}: this machine has no such CPU")).into());
        }
    }
    let phase = Nanos::from_micros(i64::from(arguments.phase_us.unwrap_or(0)));
    let (rates, priority) = (&arguments.rate_hz, arguments.priority);
    Ok(Lanes::new(rates, priority, phase, arguments.cpu, arguments.guard)?)
}

/// Number of pairs of slices that fit into the time.
fn pairs(arguments: &JitterArgs) -> anyhow::Result<usize> {
    for (name, s) in [("--for", arguments.for_s), ("--slice", arguments.slice_s)] {
        if !(DURATION_MIN_S..=DURATION_MAX_S).contains(&s) {
            let what = format!("{name} {s}: give {DURATION_MIN_S} to {DURATION_MAX_S} seconds");
            return Err(BadOption(what).into());
        }
    }
    let pair = 2 * seconds(arguments.slice_s).0;
    let pairs = usize::try_from(seconds(arguments.for_s).0 / pair).unwrap_or(0);
    if arguments.cyclictest && pairs == 0 {
        let (all, slice) = (arguments.for_s, arguments.slice_s);
        let what = format!(
            "--for {all} holds no pair of {slice} s slices; give --for {} or a shorter --slice",
            2.0 * slice
        );
        return Err(BadOption(what).into());
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments() -> JitterArgs {
        JitterArgs {
            rate_hz: vec![400.0],
            priority: 80,
            cpu: None,
            phase_us: None,
            for_s: 60.0,
            guard: None,
            load: false,
            cyclictest: true,
            slice_s: 5.0,
            svg: None,
            json: false,
        }
    }

    #[test]
    fn pairs_fit_into_the_time() {
        assert_eq!(pairs(&arguments()).unwrap(), 6);
        let tenths = JitterArgs { for_s: 1.2, slice_s: 0.2, ..arguments() };
        assert_eq!(pairs(&tenths).unwrap(), 3, "decimal fractions are not cut");
        assert_eq!(pairs(&JitterArgs { for_s: 19.9, ..arguments() }).unwrap(), 1);
        for (for_s, slice_s) in
            [(9.0, 5.0), (f64::NAN, 5.0), (60.0, f64::NAN), (-1.0, 5.0), (60.0, 0.0), (1e9, 5.0)]
        {
            assert!(pairs(&JitterArgs { for_s, slice_s, ..arguments() }).is_err(), "{for_s}");
        }
        let alone = JitterArgs { cyclictest: false, for_s: 1.0, ..arguments() };
        assert_eq!(pairs(&alone).unwrap(), 0, "one slice of its own needs no pair");
    }

    #[test]
    fn impossible_measurements_are_rejected() {
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            assert!(lanes(&JitterArgs { rate_hz: vec![rate], ..arguments() }).is_err(), "{rate}");
        }
        assert!(lanes(&JitterArgs { rate_hz: vec![400.0, 200.0], ..arguments() }).is_err());
        assert!(lanes(&JitterArgs { rate_hz: vec![], ..arguments() }).is_err());
        assert!(lanes(&JitterArgs { cpu: Some(100_000), ..arguments() }).is_err());
        assert!(lanes(&JitterArgs { guard: Some(0.9), ..arguments() }).is_err());
        assert!(lanes(&arguments()).is_ok());
    }
}
