//! Checks of disturbances of the lanes: interrupts, programs that move interrupts between CPUs, and
//! a full disk. Nothing is measured; counts are those since boot.

use std::collections::{BTreeMap, BTreeSet};

use super::cpulist::CpuList;
use super::facts::{Facts, cpu_list};
use super::finding::{Fix, Row, Severity};
use super::host::{Host, ReadError, ReadErrorKind};

/// Interrupts that exist on every CPU and cannot be moved (ARM numbers them).
const PER_CPU_INTERRUPTS: [&str; 4] = ["arch_timer", "arm-pmu", "vtimer", "ipi"];
/// Number of interrupts that are named; the others are counted.
const NAMED_INTERRUPTS_MAX: usize = 4;
/// Largest number of processes that are read, so that an invalid tree cannot block the program.
const PROCESSES_MAX: usize = 100_000;
/// Smallest free space without a warning (bytes): a few minutes of a full recording.
const FREE_BYTES_MIN: u64 = 2 << 30;

/// Checks for interrupts that the lanes' CPUs serve.
#[must_use]
pub(super) fn interrupts(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("IRQ affinity", Severity::Medium, "no device interrupts a lane's CPU");
    if facts.lanes.is_empty() {
        return row.unknown("which CPUs the lanes use is not known; say --cpus LIST");
    }
    let active = match active(host) {
        Ok(active) => active,
        Err(error) => return row.unknown(error),
    };
    let mut offenders: Vec<(u32, String)> = Vec::new();
    let mut untold = 0;
    for (number, device) in active {
        match affinity(host, number) {
            Some(list) if list.common(&facts.lanes).is_empty() => {}
            Some(_) => offenders.push((number, device)),
            None => untold += 1,
        }
    }
    let others = facts.other_cpus();
    if !offenders.is_empty() {
        let named: Vec<String> = offenders
            .iter()
            .take(NAMED_INTERRUPTS_MAX)
            .map(|(number, device)| format!("{number} {device}"))
            .collect();
        let more = offenders.len().saturating_sub(NAMED_INTERRUPTS_MAX);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let fix = offenders
            .iter()
            .filter(|_| !others.is_empty())
            .map(|(number, _)| format!("echo {others} > /proc/irq/{number}/smp_affinity_list"));
        return row
            .warn(
                format!("on CPUs {}: {}{more}", facts.lanes, named.join(", ")),
                format!("echo {others} into /proc/irq/N/smp_affinity_list; see --fix-script"),
            )
            .fix(Fix::run(fix));
    }
    if untold > 0 {
        return row.unknown(format!("the affinity of {untold} interrupts is not readable"));
    }
    row.ok(format!("none on CPUs {}", facts.lanes))
}

/// Numbers and devices of the interrupts in use.
fn active(host: &Host) -> Result<BTreeMap<u32, String>, ReadError> {
    let path = "proc/interrupts";
    let text = host.text(path)?;
    let mut lines = text.lines();
    let columns = lines
        .next()
        .map_or(0, |head| head.split_whitespace().filter(|word| word.starts_with("CPU")).count());
    if columns == 0 {
        return Err(ReadError::unintelligible(path));
    }
    let mut out = BTreeMap::new();
    for line in lines {
        let Some((number, rest)) = line.split_once(':') else { continue };
        // Lines with names instead of numbers are the CPUs' own interrupts.
        let Ok(number) = number.trim().parse() else { continue };
        let device = rest.split_whitespace().skip(columns).last().unwrap_or("?");
        if !PER_CPU_INTERRUPTS.contains(&device) {
            out.insert(number, device.to_owned());
        }
    }
    Ok(out)
}

/// CPUs that serve an interrupt: those to which the hardware sends it, otherwise those to which it
/// may.
fn affinity(host: &Host, number: u32) -> Option<CpuList> {
    let list = |file: &str| cpu_list(host, &format!("proc/irq/{number}/{file}")).ok();
    list("effective_affinity_list")
        .filter(|list| !list.is_empty())
        .or_else(|| list("smp_affinity_list").filter(|list| !list.is_empty()))
}

/// The names of all processes, cut by the kernel to 15 characters. `None` when no process is
/// listed, or when only one's own are visible (`hidepid`, `ProtectProc=`): then process 1 is
/// missing.
pub(super) fn running_programs(host: &Host) -> Option<BTreeSet<String>> {
    host.text("proc/1/comm").ok()?;
    let names = host.names("proc").into_iter().take(PROCESSES_MAX);
    let numbers = names.filter(|name| name.bytes().all(|byte| byte.is_ascii_digit()));
    let found: BTreeSet<String> =
        numbers.filter_map(|name| host.text(&format!("proc/{name}/comm")).ok()).collect();
    (!found.is_empty()).then_some(found)
}

/// Checks for programs that move interrupts or memory while lanes run.
#[must_use]
pub(super) fn irq_balancers(host: &Host) -> Row {
    let row = Row::new("irqbalance/numad", Severity::Low, "neither runs");
    let Some(running) = running_programs(host) else {
        return row.unknown("others' processes are not listed");
    };
    let found: Vec<&str> =
        ["irqbalance", "numad"].into_iter().filter(|name| running.contains(*name)).collect();
    if found.is_empty() {
        return row.ok("neither");
    }
    let fix = found.iter().map(|program| format!("systemctl disable --now {program}"));
    let fix = Fix::run(fix);
    let names = found.join(", ");
    row.warn(names, "they move interrupts and memory under running lanes: stop them").fix(fix)
}

/// Checks the free space for recordings in the working directory.
#[must_use]
pub(super) fn disk(host: &Host) -> Row {
    let row = Row::new("disk space", Severity::Low, "2 GiB free in this folder");
    if !host.is_live() {
        return row.unknown("not looked at, a recorded tree");
    }
    let Ok(status) = nix::sys::statvfs::statvfs(".") else {
        let kind = ReadErrorKind::Unreadable("the file system does not answer".to_owned());
        return row.unknown(ReadError { path: "this folder".to_owned(), kind });
    };
    // The widths of these fields differ between platforms.
    let free = u128::from(status.blocks_available()) * u128::from(status.fragment_size());
    let found = format!("{:.1} GiB free", free as f64 / f64::from(1 << 30));
    if free < u128::from(FREE_BYTES_MIN) {
        return row.warn(found, "a recording that runs full ends early: make room");
    }
    row.ok(found)
}
