//! Checks of the kernel's grants to this process: SCHED_FIFO, a real-time budget of its control
//! group, limits, locked memory. On the running host each grant is tried, read back and undone: the
//! thread ends and the memory is unlocked.

use taktil_hal::Nanos;
use taktil_rtcore::{Reservation, linux};

use super::facts::{CAP_IPC_LOCK, CAP_SYS_NICE, Facts, Limit};
use super::finding::{Fix, Row, Severity};
use super::host::{Host, ReadError, ReadErrorKind};

/// The priority that is tried: above threaded interrupts (50), below the kernel's own threads (99).
pub(super) const TEST_PRIORITY: u8 = 80;
/// Smallest share of real time per period; below it, threads are throttled sooner or later.
const SHARE_MIN: f64 = 0.9;

const SERVICE_PREFIX: &str = "in a service";
const LIMITS_FILE: &str = "/etc/security/limits.d/60-taktil.conf";

/// Checks whether a thread may have SCHED_FIFO: tried in a thread of its own, deduced for a
/// recorded tree.
#[must_use]
pub(super) fn fifo(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("SCHED_FIFO", Severity::High, "granted at priority 80");
    if host.is_live() {
        let tried = std::thread::Builder::new().spawn(|| linux::set_fifo(TEST_PRIORITY));
        return match tried.map(std::thread::JoinHandle::join) {
            Ok(Ok(Ok(()))) => row.ok("granted and read back"),
            Ok(Ok(Err(why))) => row.bad(
                why,
                "see the rows on the limit and on the control group: one of them says why",
            ),
            _ => row.unknown("no thread could be started to try it"),
        };
    }
    let skipped = "not tried, a recorded tree";
    if facts.has_capability(CAP_SYS_NICE) {
        return row.ok(format!("{skipped}; CAP_SYS_NICE is held"));
    }
    match facts.limit("Max realtime priority") {
        Ok(limit) if allows_tried_priority(limit) => {
            row.ok(format!("{skipped}; the limit allows it"))
        }
        Ok(_) => row.bad(format!("{skipped}; the limit forbids it"), "see the row on the limit"),
        Err(error) => row.unknown(format!("{skipped}; {error}")),
    }
}

/// The reservation that is tried for a lane that is scheduled by deadline: a hundredth of a CPU.
const TEST_RESERVATION: Reservation = Reservation {
    runtime: Nanos::from_micros(100),
    deadline: Nanos::from_millis(10),
    period: Nanos::from_millis(10),
};

/// Checks whether a lane may reserve its processor time: tried in a thread of its own, deduced for
/// a recorded tree. A refusal is reported without a warning, because lanes have fixed priorities
/// unless they request a reservation.
#[must_use]
pub(super) fn deadline(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("SCHED_DEADLINE", Severity::Low, "granted, if a lane is to have it");
    let needless = "only lanes with `policy = \"deadline\"` need it";
    if !host.is_live() {
        let skipped = "not tried, a recorded tree";
        return match &facts.capabilities {
            Err(error) => row.unknown(format!("{skipped}; {error}")),
            Ok(_) if facts.has_capability(CAP_SYS_NICE) => {
                row.ok(format!("{skipped}; CAP_SYS_NICE is held"))
            }
            Ok(_) => row.ok(format!("{skipped}; refused without CAP_SYS_NICE; {needless}")),
        };
    }
    let tried = std::thread::Builder::new().spawn(|| linux::set_deadline(&TEST_RESERVATION));
    match tried.map(std::thread::JoinHandle::join) {
        Ok(Ok(Ok(()))) => row.ok(format!("{TEST_RESERVATION} granted and read back")),
        Ok(Ok(Err(why))) => row.ok(format!("{why}; {needless}")),
        _ => row.unknown("no thread could be started to try it"),
    }
}

fn allows_tried_priority(limit: Limit) -> bool {
    match limit {
        Limit::Unlimited => true,
        Limit::Value(value) => value >= u64::from(TEST_PRIORITY),
    }
}

/// Checks the limit on priorities.
#[must_use]
pub(super) fn priority_limit(facts: &Facts) -> Row {
    let row = Row::new("RLIMIT_RTPRIO", Severity::High, "80 or more, or CAP_SYS_NICE");
    let limit = facts.limit("Max realtime priority");
    match limit {
        _ if facts.has_capability(CAP_SYS_NICE) => row.ok("CAP_SYS_NICE is held"),
        Err(error) => row.unknown(error),
        Ok(limit) if allows_tried_priority(limit) => row.ok(limit_text(limit, "")),
        Ok(limit) => row
            .bad(
                limit_text(limit, ""),
                format!(
                    "`@realtime - rtprio {TEST_PRIORITY}` in {LIMITS_FILE}, join the group, \
                     log in again; \
                     {SERVICE_PREFIX} `LimitRTPRIO={TEST_PRIORITY}`"
                ),
            )
            .fix(limits_entry(&format!("@realtime - rtprio {TEST_PRIORITY}"))),
    }
}

/// The remedy that appends a line to the configuration of the limits, once.
fn limits_entry(line: &str) -> Fix {
    Fix::run([
        "groupadd -f realtime".to_owned(),
        format!("grep -qsxF '{line}' {LIMITS_FILE} || echo '{line}' >> {LIMITS_FILE}"),
    ])
}

fn limit_text(limit: Limit, unit: &str) -> String {
    match limit {
        Limit::Unlimited => "unlimited".to_owned(),
        Limit::Value(value) => format!("{value}{unit}"),
    }
}

/// Checks the limit on locked memory.
#[must_use]
pub(super) fn memory_limit(facts: &Facts) -> Row {
    let row = Row::new("RLIMIT_MEMLOCK", Severity::High, "unlimited, or CAP_IPC_LOCK");
    match facts.limit("Max locked memory") {
        _ if facts.has_capability(CAP_IPC_LOCK) => row.ok("CAP_IPC_LOCK is held"),
        Err(error) => row.unknown(error),
        Ok(Limit::Unlimited) => row.ok("unlimited"),
        Ok(Limit::Value(bytes)) => row
            .bad(
                format!("{} KiB", bytes / 1024),
                format!(
                    "`@realtime - memlock unlimited` in {LIMITS_FILE}, join the group, \
                     log in again; \
                     {SERVICE_PREFIX} `LimitMEMLOCK=infinity`"
                ),
            )
            .fix(limits_entry("@realtime - memlock unlimited")),
    }
}

/// Checks the limit on real-time work without a wait.
#[must_use]
pub(super) fn time_limit(facts: &Facts) -> Row {
    let row = Row::new("RLIMIT_RTTIME", Severity::Medium, "unlimited");
    match facts.limit("Max realtime timeout") {
        Err(error) => row.unknown(error),
        Ok(Limit::Unlimited) => row.ok("unlimited"),
        Ok(limit) => row.warn(
            limit_text(limit, " us without a sleep"),
            format!(
                "a lane that works longer is killed: find who sets the limit (PAM, a session \
                     daemon) and lift it; {SERVICE_PREFIX} `LimitRTTIME=infinity`"
            ),
        ),
    }
}

/// Checks whether all memory can be locked: tried and undone, deduced for a recorded tree.
#[must_use]
pub(super) fn memory_lock(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("memory lock", Severity::High, "all memory of the process stays in RAM");
    let remedy = "see the row on RLIMIT_MEMLOCK";
    if host.is_live() {
        let tried = linux::lock_memory();
        let locked = status_kib(host, "VmLck:");
        linux::unlock_memory();
        return match (tried, locked) {
            (Err(why), _) => row.bad(why, remedy),
            (Ok(()), Some(0)) => row.bad("granted, yet nothing is locked", remedy),
            (Ok(()), Some(kib)) => row.ok(format!("granted and read back: {} MiB", kib / 1024)),
            (Ok(()), None) => row.ok("granted; /proc/self/status does not tell how much"),
        };
    }
    let skipped = "not tried, a recorded tree";
    let limit = facts.limit("Max locked memory");
    if facts.has_capability(CAP_IPC_LOCK) || limit == Ok(Limit::Unlimited) {
        return row.ok(format!("{skipped}; the limit allows it"));
    }
    match limit {
        Ok(_) => row.bad(format!("{skipped}; the limit forbids it"), remedy),
        Err(error) => row.unknown(format!("{skipped}; {error}")),
    }
}

fn status_kib(host: &Host, name: &str) -> Option<u64> {
    let text = host.text("proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

fn number(host: &Host, path: &str) -> Result<i64, ReadError> {
    host.text(path)?.parse().map_err(|_| ReadError::unintelligible(path))
}

/// Checks the throttling of all real-time threads together.
#[must_use]
pub(super) fn throttling(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("RT throttling", Severity::Medium, "at least 90 % of each period, or off");
    let share = (
        number(host, "proc/sys/kernel/sched_rt_runtime_us"),
        number(host, "proc/sys/kernel/sched_rt_period_us"),
    );
    let (runtime_us, period_us) = match share {
        (Ok(runtime), Ok(period)) if runtime >= -1 && period > 0 => (runtime, period),
        (Err(error), _) | (_, Err(error)) => return row.unknown(error),
        (Ok(runtime), Ok(period)) => {
            return row.unknown(format!("{runtime} us of {period} us makes no sense"));
        }
    };
    let found = format!("{runtime_us} us of {period_us} us");
    let fix = || Fix::run(["sysctl -w kernel.sched_rt_runtime_us=950000"]);
    match runtime_us {
        -1 if facts.lanes.is_empty() => row.warn(
            "off, and no CPU is isolated",
            "a lane that never sleeps takes the machine with it: isolate a CPU, or \
             kernel.sched_rt_runtime_us=950000",
        ),
        -1 => row.ok("off; keep a watchdog on the boards"),
        0 => row
            .bad(found, "no real-time thread may run at all: kernel.sched_rt_runtime_us=950000")
            .fix(fix()),
        _ if (runtime_us as f64) < SHARE_MIN * period_us as f64 => row
            .warn(
                found,
                "lanes stop for the rest of each period once they used their share: \
                 kernel.sched_rt_runtime_us=950000",
            )
            .fix(fix()),
        _ => row.ok(format!("{found}; lanes that use more are stopped for the rest")),
    }
}

/// Checks the share of real time of this process's control group.
#[must_use]
pub(super) fn group_budget(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("RT group budget", Severity::High, "none needed, or above 0");
    if let Ok(config) = &facts.config
        && !config.is_enabled("RT_GROUP_SCHED")
    {
        return row.ok("none needed: CONFIG_RT_GROUP_SCHED is off");
    }
    let line = host.text("proc/cmdline").unwrap_or_default();
    let switch =
        line.split_whitespace().rev().find_map(|word| word.strip_prefix("rt_group_sched="));
    let by_default =
        facts.config.as_ref().is_ok_and(|c| c.is_enabled("RT_GROUP_SCHED_DEFAULT_DISABLED"));
    if switch == Some("0") || (switch.is_none() && by_default) {
        return row.ok("none needed: group scheduling is switched off at boot");
    }
    match control_group(host) {
        Err(error) => row.unknown(error),
        Ok(Group::V1(folder)) => v1_budget(row, host, facts, &folder),
        Ok(Group::V2(group)) => v2_budget(row, host, facts, &group),
    }
}

/// A control group in the unified hierarchy.
struct UnifiedGroup {
    /// Path in the hierarchy; empty for the root group.
    path: String,
    /// Folder where the hierarchy is mounted, without the leading slash.
    mount: String,
}

/// The control group of a process.
enum Group {
    /// Folder of the group in the hierarchy of the controller `cpu`.
    V1(String),
    /// Group in the unified hierarchy.
    V2(UnifiedGroup),
}

fn control_group(host: &Host) -> Result<Group, ReadError> {
    let own = "proc/self/cgroup";
    let strange = || ReadError {
        path: own.to_owned(),
        kind: ReadErrorKind::Unreadable("an unknown layout of control groups".to_owned()),
    };
    let text = host.text(own)?;
    let mounts = host.text("proc/self/mounts").or_else(|_| host.text("proc/mounts"))?;
    let mounted = |kind: &str, option: Option<&str>| {
        mounts.lines().find_map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [_, place, found, options, ..] = words[..] else { return None };
            let with = option.is_none_or(|option| options.split(',').any(|o| o == option));
            (found == kind && with).then(|| place.trim_matches('/').to_owned())
        })
    };
    let mut unified = None;
    for line in text.lines() {
        let parts: Vec<&str> = line.splitn(3, ':').collect();
        let [number, controllers, path] = parts[..] else { return Err(strange()) };
        if !path.starts_with('/') || path.split('/').any(|part| part == "..") {
            return Err(strange());
        }
        if controllers.split(',').any(|controller| controller == "cpu") {
            let place = mounted("cgroup", Some("cpu")).ok_or_else(strange)?;
            return Ok(Group::V1(format!("{place}{}", path.trim_end_matches('/'))));
        }
        if number == "0" && controllers.is_empty() {
            unified = Some(path.trim_end_matches('/').to_owned());
        }
    }
    let place = mounted("cgroup2", None).ok_or_else(strange)?;
    unified.map(|path| Group::V2(UnifiedGroup { path, mount: place })).ok_or_else(strange)
}

const BUDGET_ZERO: &str = "0 us: SCHED_FIFO is refused here, even to root";

fn v1_budget(row: Row, host: &Host, facts: &Facts, folder: &str) -> Row {
    let file = format!("{folder}/cpu.rt_runtime_us");
    match number(host, &file) {
        Ok(-1) => row.ok("without bound"),
        Ok(budget_us) if budget_us > 0 => row.ok(format!("{budget_us} us in /{file}")),
        Ok(0) => row
            .bad(
                BUDGET_ZERO,
                format!(
                    "give the group a budget (echo 900000 > /{file}, parents first), or boot with \
                     rt_group_sched=0"
                ),
            )
            .fix(Fix::boot(["rt_group_sched=0"])),
        Ok(strange) => row.unknown(format!("{strange} us makes no sense")),
        // Without the file, and without a configuration that requires it, there is no such budget.
        Err(error)
            if error.kind == ReadErrorKind::Absent && facts.config.is_err() && host.has(folder) =>
        {
            row.ok("none needed: the group has no budget file")
        }
        Err(error) => row.unknown(error),
    }
}

fn v2_budget(row: Row, host: &Host, facts: &Facts, group: &UnifiedGroup) -> Row {
    let UnifiedGroup { path, mount } = group;
    if path.is_empty() {
        return row.ok("the root group has all");
    }
    if let Err(error) = &facts.config {
        return row.unknown(format!("whether groups need one is not known: {error}"));
    }
    let file = format!("{mount}{path}/cgroup.controllers");
    match host.text(&file) {
        Ok(text) if text.split_whitespace().any(|controller| controller == "cpu") => row
            .bad(
                BUDGET_ZERO,
                "cgroup v2 gives no budgets: boot with rt_group_sched=0, or a kernel without \
                 CONFIG_RT_GROUP_SCHED",
            )
            .fix(Fix::boot(["rt_group_sched=0"])),
        Ok(_) => row.ok("the group is not under the controller `cpu`"),
        // The kernel writes a file without a byte when there are no controllers.
        Err(error) if error.kind == ReadErrorKind::Empty => {
            row.ok("the group is not under the controller `cpu`")
        }
        Err(error) => row.unknown(error),
    }
}
