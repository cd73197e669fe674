//! Runs cyclictest of rt-tests as a reference: with the same period, priority and CPU, for one
//! slice, and reads its histogram.

use std::io::{ErrorKind, Read};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use hdrhistogram::Histogram;
use taktil_rtcore::{Nanos, linux};

use super::measure::{Lanes, histogram};
use taktil_machine_console::option::BadOption;

/// The binary, found on the PATH.
const BINARY_NAME: &str = "cyclictest";
/// Largest latency that is counted in a bin of its own, us; longer ones share one count.
const LATENCY_MAX_US: u32 = 20_000;
/// Time between two polls of the child process.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Time beyond the duration of a slice after which the child process is killed.
const TIMEOUT_MARGIN: Nanos = Nanos::from_secs(20);

/// The arguments of cyclictest.
#[derive(Clone, Debug)]
pub struct Cyclictest {
    arguments: Vec<String>,
    period: Nanos,
}

impl Cyclictest {
    /// Finds the binary.
    ///
    /// # Errors
    /// [`BadOption`] with the package to install.
    pub fn find(lanes: &Lanes) -> anyhow::Result<Cyclictest> {
        let spec = lanes.specs.first().context("no lane")?;
        match Command::new(BINARY_NAME).arg("--help").output() {
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let what = "--cyclictest: no `cyclictest` on the PATH; \
                            install the package rt-tests, or leave --cyclictest out";
                return Err(BadOption(what.to_owned()).into());
            }
            Err(error) => return Err(anyhow!("cyclictest cannot be run: {error}")),
        }
        let interval_us = spec.period.0 / 1000;
        let mut arguments: Vec<String> = ["-q", "-m", "-t", "1"].map(String::from).to_vec();
        arguments.extend(["-p".into(), spec.priority.to_string()]);
        arguments.extend(["-i".into(), interval_us.to_string()]);
        arguments.extend(["-h".into(), LATENCY_MAX_US.to_string()]);
        // The phase relative to the kernel's tick is the same as ours: after a whole second.
        let phase = linux::EPOCH_AFTER_TICK + spec.phase;
        arguments.push(format!("--secaligned={}", phase.0 / 1000));
        if let Some(cpu) = spec.cpu {
            arguments.extend(["-a".into(), cpu.to_string()]);
        }
        Ok(Cyclictest { arguments, period: spec.period })
    }

    /// Runs cyclictest for one slice and returns its latencies, ns.
    ///
    /// # Errors
    /// Cyclictest failed, hung or printed no histogram.
    pub fn run_slice(&self, long: Nanos, stop: &AtomicBool) -> anyhow::Result<Histogram<u64>> {
        let loops = (long.0 / self.period.0).max(1);
        let mut child = Command::new(BINARY_NAME)
            .args(&self.arguments)
            .args(["-l", &loops.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .context("cyclictest does not start")?;
        let mut stdout = child.stdout.take().context("cyclictest has no output")?;
        let reader = std::thread::spawn(move || {
            let mut text = String::new();
            stdout.read_to_string(&mut text).map(|_| text)
        });
        let latest = linux::monotonic() + long * 2 + TIMEOUT_MARGIN;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            let late = linux::monotonic() > latest;
            if late || stop.load(Ordering::SeqCst) {
                child.kill()?;
                child.wait()?;
                if late {
                    bail!("cyclictest did not end in time and was ended");
                }
                return Ok(histogram());
            }
            std::thread::sleep(POLL_INTERVAL);
        };
        let text = reader.join().map_err(|_| anyhow!("reading cyclictest failed"))??;
        if !status.success() {
            let mut why = String::new();
            if let Some(stderr) = &mut child.stderr {
                stderr.read_to_string(&mut why)?;
            }
            bail!("cyclictest failed ({status}): {}", why.trim());
        }
        parse(&text)
    }
}

/// Parses the histogram that `-h` prints. cyclictest truncates latencies to whole microseconds, so
/// a count is put in the middle of its microsecond; overflows are counted at the largest latency.
fn parse(text: &str) -> anyhow::Result<Histogram<u64>> {
    let mut found = histogram();
    let (mut overflows, mut largest_us) = (0, 0);
    for line in text.lines() {
        let last = || line.split_whitespace().last().and_then(|word| word.parse::<u64>().ok());
        if line.starts_with("# Histogram Overflows:") {
            overflows = last().unwrap_or(0);
        } else if line.starts_with("# Max Latencies:") {
            largest_us = last().unwrap_or(0);
        } else if !line.starts_with(['#', 'T']) {
            let mut report = line.split_whitespace().map(str::parse::<u64>);
            if let (Some(Ok(us)), Some(Ok(count)), None) =
                (report.next(), report.next(), report.next())
            {
                record(&mut found, us, count);
            }
        }
    }
    record(&mut found, largest_us, overflows);
    if found.is_empty() {
        bail!("cyclictest printed no histogram");
    }
    Ok(found)
}

fn record(found: &mut Histogram<u64>, us: u64, count: u64) {
    // A count of zero would still change the smallest and the largest value.
    if count > 0 {
        found.saturating_record_n(us.saturating_mul(1000).saturating_add(500), count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINTED_HISTOGRAM: &str = "# /dev/cpu_dma_latency set to 0us\n\
        T: 0 ( 912) P:80 I:2500 C:  7\n\
        # Histogram\n000000 000000\n000018 000004\n000019 000002\n# Total: 000000006\n\
        # Min Latencies: 00018\n# Avg Latencies: 00043\n# Max Latencies: 05727\n\
        # Histogram Overflows: 00001\n# Histogram Overflow at cycle number:\n# Thread 0: 3\n";

    #[test]
    fn its_histogram_is_read() {
        let found = parse(PRINTED_HISTOGRAM).unwrap();
        assert_eq!(found.len(), 7);
        assert!(found.equivalent(found.min(), 18_500), "{}", found.min());
        assert!(found.equivalent(found.value_at_quantile(0.5), 18_500));
        assert!(found.equivalent(found.max(), 5_727_500), "{}", found.max());
    }

    #[test]
    fn no_histogram_is_a_failure() {
        assert!(parse("").is_err());
        assert!(parse("000018 000000\nnonsense 3\n1 2 3\n").is_err());
    }
}
