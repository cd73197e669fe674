//! `taktil doctor`: checks whether this host is fit for real time, and prints a table of
//! expectation, finding and remedy. Nothing is changed: remedies are printed, never run, and grants
//! that are tried are undone.
//!
//! All files of the kernel are read below a root, so that a recorded tree yields the same result as
//! the host. A file that is missing, empty or senseless yields `unknown`, never a failure.

mod cpulist;
mod cpus;
mod disturbances;
mod environment;
mod facts;
mod finding;
mod gunzip;
mod host;
mod kernel;
mod permissions;
mod print;

pub use cpulist::CpuList;
pub use finding::{Fix, Row, Severity, Verdict};
pub use host::{Host, ReadError, ReadErrorKind};
pub use print::{script, table, to_json};

use std::path::PathBuf;
use std::process::ExitCode;

use facts::Facts;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;

/// The arguments of the command line.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// JSON instead of the table.
    pub json: bool,
    /// A script of remedies instead of the table.
    pub fix_script: bool,
    /// A recorded tree instead of the running host.
    pub root: Option<PathBuf>,
    /// CPUs that the lanes are to use.
    pub cpus: Option<String>,
}

/// The results of all checks of a host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// True for the running host, false for a recorded tree.
    pub live: bool,
    /// One row for each check, always in the same order.
    pub rows: Vec<Row>,
}

impl Report {
    /// The exit code: 0 fine, 1 warnings, 2 not fit for motion. A check of high severity that could
    /// not be made counts as a warning.
    #[must_use]
    pub fn exit(&self) -> u8 {
        if self.count(Verdict::Bad) > 0 {
            return 2;
        }
        let open = |row: &Row| row.verdict == Verdict::Unknown && row.severity == Severity::High;
        u8::from(self.rows.iter().any(|row| row.verdict == Verdict::Warn || open(row)))
    }

    /// Number of rows with a verdict.
    #[must_use]
    pub fn count(&self, verdict: Verdict) -> usize {
        self.rows.iter().filter(|row| row.verdict == verdict).count()
    }

    /// A row by its name.
    #[must_use]
    pub fn row(&self, name: &str) -> Option<&Row> {
        self.rows.iter().find(|row| row.name == name)
    }

    /// The last line of the table: the result in one sentence.
    #[must_use]
    pub fn verdict(&self) -> String {
        let names = |wanted: &dyn Fn(&Row) -> bool| {
            let rows = self.rows.iter().filter(|row| wanted(row));
            rows.map(|row| row.name).collect::<Vec<_>>().join(", ")
        };
        let open = names(&|row| row.verdict == Verdict::Unknown);
        let open = if open.is_empty() { open } else { format!("; could not tell: {open}") };
        match self.exit() {
            2 => format!("not fit for motion: {}", names(&|row| row.verdict == Verdict::Bad)),
            1 if self.count(Verdict::Warn) == 0 => format!("nothing found against motion{open}"),
            1 => {
                let list = names(&|row| row.verdict == Verdict::Warn);
                format!("fit for motion with warnings: {list}{open}")
            }
            _ => format!(
                "fit for motion: {} of {} checks as expected{open}",
                self.count(Verdict::Ok),
                self.rows.len()
            ),
        }
    }
}

/// Makes every check. `cpus` are the CPUs of the lanes; without them the isolated ones are taken.
#[must_use]
pub fn examine(host: &Host, cpus: Option<&CpuList>) -> Report {
    let facts = Facts::read(host, cpus);
    let rows = vec![
        kernel::real_time(host, &facts),
        kernel::virtual_machine(host),
        permissions::fifo(host, &facts),
        permissions::deadline(host, &facts),
        permissions::group_budget(host, &facts),
        permissions::priority_limit(&facts),
        permissions::memory_limit(&facts),
        permissions::memory_lock(host, &facts),
        kernel::clocksource(host),
        kernel::debug_options(&facts),
        permissions::throttling(host, &facts),
        permissions::time_limit(&facts),
        cpus::isolated(&facts),
        disturbances::interrupts(host, &facts),
        cpus::siblings(host, &facts),
        cpus::governor(host, &facts),
        cpus::idle_states(host, &facts),
        kernel::huge_pages(host),
        kernel::numa_balancing(host),
        cpus::tickless(host, &facts),
        cpus::latency_device(host),
        kernel::swap(host),
        disturbances::irq_balancers(host),
        disturbances::disk(host),
        environment::turbo(host),
        environment::firmware(host),
        environment::wake_up_latency(&facts),
        environment::serial_adapters(host),
        environment::time_of_day(host),
    ];
    Report { live: host.is_live(), rows }
}

/// The requested CPUs, which have to be online. Where the host does not report which are, the rows
/// on those CPUs say so.
fn requested_cpus(host: &Host, text: &str) -> Result<CpuList, BadOption> {
    let bad = |what: String| BadOption(format!("--cpus {text}: {what}"));
    let asked = CpuList::parse(text).filter(|list| !list.is_empty());
    let asked = asked.ok_or_else(|| bad("is no list of CPUs such as 2,3 or 4-7".to_owned()))?;
    let Ok(online) = facts::online(host) else { return Ok(asked) };
    let lacking = asked.without(&online);
    if lacking.is_empty() {
        return Ok(asked);
    }
    Err(bad(format!("CPU {lacking} does not run here; choose of {online}, or switch it on")))
}

/// Examines a host and prints the result; the exit code is 0 for fine, 1 for warnings, 2 for not
/// fit for motion.
///
/// # Errors
/// A root that is not a recorded tree, or a list of CPUs that is invalid or names one that is
/// offline, as [`BadOption`].
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let host = match &options.root {
        None => Host::live(),
        Some(root) => Host::recorded(root)?,
    };
    let cpus = options.cpus.as_deref().map(|text| requested_cpus(&host, text)).transpose()?;
    let report = examine(&host, cpus.as_ref());
    if options.json {
        out::line(to_json(&report))?;
    } else if options.fix_script {
        out::text(script(&report))?;
    } else {
        out::text(table(&report))?;
    }
    Ok(ExitCode::from(report.exit()))
}
