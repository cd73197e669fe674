//! Checks of the kernel itself: real-time preemption, debugging options, clock source, virtual
//! machine. No check relies on a single file: some real-time kernels lack `/sys/kernel/realtime`.

use taktil_rtcore::detection;

use super::facts::Facts;
use super::finding::{Fix, Row, Severity};
use super::host::Host;

/// Options that make every lock or every access slow.
const SLOW_DEBUG_OPTIONS: [&str; 9] = [
    "PROVE_LOCKING",
    "LOCKDEP",
    "LOCK_STAT",
    "KASAN",
    "KCSAN",
    "DEBUG_KMEMLEAK",
    "DEBUG_OBJECTS",
    "DEBUG_ATOMIC_SLEEP",
    "DEBUG_PAGEALLOC",
];
/// Options that cost time occasionally.
const COSTLY_DEBUG_OPTIONS: [&str; 5] =
    ["DEBUG_PREEMPT", "PREEMPT_TRACER", "IRQSOFF_TRACER", "DEBUG_MUTEXES", "SLUB_DEBUG_ON"];

/// Clock sources that are read from a register and do not stop.
const GOOD_CLOCK_SOURCES: [&str; 4] = ["tsc", "arch_sys_counter", "riscv_clocksource", "timebase"];
/// Clock sources of hypervisors.
const GUEST_CLOCK_SOURCES: [&str; 3] = ["kvm-clock", "hyperv_clocksource", "xen"];

/// Checks whether the kernel is built with PREEMPT_RT.
#[must_use]
pub(super) fn real_time(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("real-time kernel", Severity::High, "built with PREEMPT_RT");
    let remedy = "install the distribution's real-time kernel, reboot and choose it";
    if let Some(sign) = detection::preempt_rt_sign(&|path| host.text(path).ok()) {
        return row.ok(sign);
    }
    let version = host.text("proc/sys/kernel/version").or_else(|_| host.text("proc/version"));
    match (&facts.config, version) {
        (Ok(config), _) if config.is_enabled("PREEMPT_RT") => {
            row.ok(format!("CONFIG_PREEMPT_RT=y in {}", config.from))
        }
        (Ok(config), Err(_)) => row.bad(format!("no CONFIG_PREEMPT_RT in {}", config.from), remedy),
        (_, Ok(text)) if text.contains('#') => row.bad(text, remedy),
        (_, Ok(text)) => row.unknown(format!("a version that makes no sense: {text}")),
        (_, Err(error)) => row.unknown(error),
    }
}

/// Checks for debugging options of the kernel.
#[must_use]
pub(super) fn debug_options(facts: &Facts) -> Row {
    let row = Row::new("debug options", Severity::High, "no lock checking, no memory checking");
    let config = match &facts.config {
        Ok(config) => config,
        Err(error) => return row.unknown(format!("configuration not readable: {error}")),
    };
    let on = |names: &[&str]| -> Vec<String> {
        names
            .iter()
            .filter(|name| config.is_enabled(name))
            .map(|name| format!("CONFIG_{name}"))
            .collect()
    };
    let (slow, costly) = (on(&SLOW_DEBUG_OPTIONS), on(&COSTLY_DEBUG_OPTIONS));
    let remedy = "a kernel for debugging is not for motion: boot the ordinary build";
    if !slow.is_empty() {
        return row.bad(slow.join(", "), remedy);
    }
    if !costly.is_empty() {
        return row.warn(costly.join(", "), remedy);
    }
    row.ok(format!("none in {}", config.from))
}

/// Checks the clock source.
#[must_use]
pub(super) fn clocksource(host: &Host) -> Row {
    let row = Row::new("clocksource", Severity::High, "tsc, or the ARM or RISC-V counter");
    let path = "sys/devices/system/clocksource/clocksource0/current_clocksource";
    let name = match host.text(path) {
        Ok(name) => name,
        Err(error) => return row.unknown(error),
    };
    if GOOD_CLOCK_SOURCES.contains(&name.as_str()) {
        return row.ok(name);
    }
    if GUEST_CLOCK_SOURCES.iter().any(|guest| name.starts_with(guest)) {
        return row.warn(format!("{name}, a hypervisor's"), "run on the machine itself");
    }
    let word = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
    if name.is_empty() || !name.chars().all(word) {
        return row.unknown(format!("a name that makes no sense: {name}"));
    }
    row.bad(
        format!("{name}: slow to read, or coarse"),
        "the kernel gave tsc up: look for the reason with `dmesg | grep -i -e tsc -e clocksource`; \
         after a BIOS update or change try the boot parameter tsc=reliable",
    )
}

/// Checks whether the host is a virtual machine.
#[must_use]
pub(super) fn virtual_machine(host: &Host) -> Row {
    let row = Row::new("virtual machine", Severity::High, "no hypervisor below");
    let remedy = "a host steals time unseen: use this machine for simulation only";
    let processor = host.text("proc/cpuinfo");
    let line = processor.as_ref().ok().and_then(|text| {
        text.lines().find(|line| line.starts_with("flags") || line.starts_with("Features"))
    });
    if let Some(sign) = detection::virtual_machine_sign(&|path| host.text(path).ok()) {
        return row.bad(sign, remedy);
    }
    match (&processor, line) {
        (Err(error), _) => row.unknown(error),
        (Ok(_), None) => row.unknown("/proc/cpuinfo lists no flags"),
        (Ok(_), Some(_)) => row.ok("no sign of one"),
    }
}

/// Checks for huge pages that the kernel makes without a request.
#[must_use]
pub(super) fn huge_pages(host: &Host) -> Row {
    let row = Row::new("transparent huge pages", Severity::Medium, "madvise or never");
    let path = "sys/kernel/mm/transparent_hugepage/enabled";
    let text = match host.text(path) {
        Ok(text) => text,
        Err(error) => return row.unknown(error),
    };
    match text.split(['[', ']']).nth(1) {
        Some(chosen @ ("madvise" | "never")) => row.ok(chosen),
        Some("always") => row
            .warn("always", "pages are moved and merged under running lanes: set madvise")
            .fix(Fix {
                commands: vec![format!("echo madvise > /{path}")],
                boot: vec!["transparent_hugepage=madvise".to_owned()],
            }),
        _ => row.unknown(format!("/{path} makes no sense: {text}")),
    }
}

/// Checks for pages that the kernel moves between memory nodes.
#[must_use]
pub(super) fn numa_balancing(host: &Host) -> Row {
    let row = Row::new("NUMA balancing", Severity::Medium, "off");
    let path = "proc/sys/kernel/numa_balancing";
    match host.text(path) {
        Ok(text) if text == "0" => row.ok("off"),
        Ok(text) if text == "1" || text == "2" => row
            .warn(
                format!("on ({text})"),
                "page faults are made on purpose to see who uses memory: switch it off",
            )
            .fix(Fix::run(["sysctl -w kernel.numa_balancing=0"])),
        Ok(text) => row.unknown(format!("/{path} makes no sense: {text}")),
        // A kernel without the switch does not have the feature.
        Err(error)
            if error.kind == super::host::ReadErrorKind::Absent
                && host.has("proc/sys/kernel/version") =>
        {
            row.ok("not in this kernel")
        }
        Err(error) => row.unknown(error),
    }
}

/// Checks for swap space.
#[must_use]
pub(super) fn swap(host: &Host) -> Row {
    let row = Row::new("swap", Severity::Low, "none");
    let text = match host.text("proc/swaps") {
        Ok(text) => text,
        Err(error) => return row.unknown(error),
    };
    let mut lines = text.lines();
    if !lines.next().is_some_and(|line| line.starts_with("Filename")) {
        return row.unknown("/proc/swaps makes no sense");
    }
    match lines.filter(|line| !line.trim().is_empty()).count() {
        0 => row.ok("none"),
        count => row
            .warn(
                format!("{count} in use"),
                "lanes are locked in memory, what talks to people is not: swapoff -a, and out of \
                 /etc/fstab",
            )
            .fix(Fix::run(["swapoff -a"])),
    }
}
