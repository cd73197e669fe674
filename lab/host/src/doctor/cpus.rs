//! Checks of the CPUs on which lanes run: isolation, periodic tick, sibling threads, clock
//! frequency and idle states. These are the requested CPUs, otherwise the isolated ones, otherwise
//! all.

use super::cpulist::CpuList;
use super::facts::{Facts, cpu_list};
use super::finding::{Fix, Row, Severity};
use super::host::Host;

/// Longest exit latency of an idle state that does not disturb lanes (us).
const IDLE_EXIT_LATENCY_MAX_US: u64 = 10;
/// Value of the latency device when no process requests a latency (us).
const LATENCY_REQUEST_NONE_US: i32 = 2_000_000_000;
const LATENCY_DEVICE: &str = "dev/cpu_dma_latency";

fn isolation_fix(facts: &Facts) -> Fix {
    let (lanes, others) = (facts.proposed_lane_cpus(), facts.other_cpus());
    if lanes.is_empty() || others.is_empty() {
        return Fix::default();
    }
    Fix::boot([
        format!("isolcpus=managed_irq,domain,{lanes}"),
        format!("nohz_full={lanes}"),
        format!("rcu_nocbs={lanes}"),
        format!("irqaffinity={others}"),
    ])
}

/// Checks for CPUs that the scheduler leaves alone.
#[must_use]
pub(super) fn isolated(facts: &Facts) -> Row {
    let row = Row::new("isolated CPUs", Severity::Medium, "the lanes' CPUs are isolated");
    let list = match &facts.isolated {
        Ok(list) => list,
        Err(error) => return row.unknown(error),
    };
    let lacking = facts.lanes.without(list);
    if !lacking.is_empty() {
        return row
            .warn(
                format!("{list} without {lacking}").trim_start(),
                "other programs run on the lanes' CPUs: boot parameters in --fix-script",
            )
            .fix(isolation_fix(facts));
    }
    if !list.is_empty() {
        return row.ok(list.to_string());
    }
    let fix = isolation_fix(facts);
    let remedy = match &fix.boot[..] {
        [] => "one CPU cannot be set aside: a machine with two or more".to_owned(),
        parameters => format!("boot with {}", parameters.join(" ")),
    };
    row.warn("none", remedy).fix(fix)
}

/// Checks for CPUs without a periodic tick.
#[must_use]
pub(super) fn tickless(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("nohz_full", Severity::Low, "the lanes' CPUs have no periodic tick");
    match cpu_list(host, "sys/devices/system/cpu/nohz_full") {
        Err(error) => row.unknown(error),
        Ok(list) => {
            let lacking = facts.lanes.without(&list);
            if list.is_empty() || !lacking.is_empty() {
                let found = if list.is_empty() { "none".to_owned() } else { list.to_string() };
                row.warn(found, "the tick costs a few microseconds now and then: see --fix-script")
                    .fix(isolation_fix(facts))
            } else {
                row.ok(list.to_string())
            }
        }
    }
}

/// Checks for two threads in one core.
#[must_use]
pub(super) fn siblings(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("SMT", Severity::Medium, "off, or no sibling of a lane's CPU runs");
    match host.text("sys/devices/system/cpu/smt/active") {
        Ok(text) if text == "0" => return row.ok("off"),
        Ok(text) if text == "1" => {}
        Ok(text) => return row.unknown(format!("/sys/devices/system/cpu/smt/active is {text}")),
        Err(error) => return row.unknown(error),
    }
    if facts.lanes.is_empty() {
        return row
            .warn(
                "on",
                "two threads share a core and slow each other: boot with nosmt, or isolate CPUs",
            )
            .fix(Fix::boot(["nosmt"]));
    }
    let mut stop = CpuList::default();
    for cpu in &facts.lanes.0 {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list");
        let mut core = match cpu_list(host, &path) {
            Ok(core) => core,
            Err(error) => return row.unknown(error),
        };
        // When several CPUs of lanes share a core, the first one keeps it.
        let stays = core.common(&facts.lanes).0.first().copied().unwrap_or(*cpu);
        core.0.remove(&stays);
        stop.0.extend(core.0);
    }
    if let Ok(online) = &facts.online {
        stop = stop.common(online);
    }
    if stop.is_empty() {
        return row.ok("on; the lanes' CPUs have no running sibling");
    }
    let commands =
        stop.0.iter().map(|cpu| format!("echo 0 > /sys/devices/system/cpu/cpu{cpu}/online"));
    row.warn(format!("on; siblings of lanes' CPUs run: {stop}"), "switch the siblings off")
        .fix(Fix::run(commands))
}

/// Checks the clock frequency of the CPUs.
#[must_use]
pub(super) fn governor(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("CPU governor", Severity::Medium, "performance");
    let mut others: Vec<String> = Vec::new();
    let mut slow = CpuList::default();
    let mut error = None;
    let judged = facts.checked_cpus();
    for cpu in &judged.0 {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
        match host.text(&path) {
            Ok(name) if name == "performance" => {}
            Ok(name) => {
                slow.0.insert(*cpu);
                if !others.contains(&name) {
                    others.push(name);
                }
            }
            Err(why) => error = Some(why),
        }
    }
    if !slow.is_empty() {
        let path = |cpu| format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
        let commands = slow.0.iter().map(|cpu| format!("echo performance > {}", path(cpu)));
        return row
            .warn(
                format!("{} on CPUs {slow}", others.join(", ")),
                "a core that was clocked down takes long to wake: set the governor performance",
            )
            .fix(Fix::run(commands));
    }
    match error {
        Some(error) => row.unknown(format!("{error}; a virtual machine, or the firmware decides")),
        None if judged.is_empty() => row.unknown("which CPUs run is not known"),
        None => row.ok(format!("performance on CPUs {judged}")),
    }
}

/// Checks the depth of the CPUs' idle states.
#[must_use]
pub(super) fn idle_states(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("C-states", Severity::Medium, "no state that takes over 10 us to leave");
    let mut deepest: Option<(u64, String)> = None;
    let mut deep: Vec<String> = Vec::new();
    let judged = facts.checked_cpus();
    for cpu in &judged.0 {
        let folder = format!("sys/devices/system/cpu/cpu{cpu}/cpuidle");
        for state in host.names(&folder) {
            if !is_state(&state) {
                continue;
            }
            let base = format!("{folder}/{state}");
            let number =
                |file: &str| host.text(&format!("{base}/{file}")).ok()?.parse::<u64>().ok();
            let Some(exit_us) = number("latency") else {
                return row.unknown(format!("/{base}/latency does not say"));
            };
            if number("disable").unwrap_or(0) != 0 {
                continue;
            }
            let name = host.text(&format!("{base}/name")).unwrap_or_else(|_| state.clone());
            if exit_us > IDLE_EXIT_LATENCY_MAX_US {
                deep.push(format!("echo 1 > /{base}/disable"));
            }
            if deepest.as_ref().is_none_or(|(most, _)| exit_us > *most) {
                deepest = Some((exit_us, name));
            }
        }
    }
    let Some((exit_us, name)) = deepest else {
        return row.unknown("the kernel lists no idle states");
    };
    let found = format!("deepest is {name}, {exit_us} us to leave");
    match latency_request_us(host) {
        _ if exit_us <= IDLE_EXIT_LATENCY_MAX_US => row.ok(found),
        Some(us) if (0..=10).contains(&us) => {
            row.ok(format!("{found}; a wish of {us} us keeps it away"))
        }
        _ => row
            .warn(
                found,
                "hold 0 in /dev/cpu_dma_latency while lanes run, or disable the deep states",
            )
            .fix(Fix::run(deep)),
    }
}

fn is_state(name: &str) -> bool {
    name.strip_prefix("state").is_some_and(|number| number.parse::<u16>().is_ok())
}

/// The strictest latency that a process requests now, in us.
fn latency_request_us(host: &Host) -> Option<i32> {
    let bytes = host.bytes(LATENCY_DEVICE).ok()?;
    Some(i32::from_le_bytes(bytes.get(..4)?.try_into().ok()?))
}

/// Checks the device by which a program keeps CPUs awake.
#[must_use]
pub(super) fn latency_device(host: &Host) -> Row {
    let row = Row::new("latency device", Severity::Low, "/dev/cpu_dma_latency can be opened");
    match host.bytes(LATENCY_DEVICE) {
        Ok(_) => match latency_request_us(host) {
            Some(LATENCY_REQUEST_NONE_US) => row.ok("there; nobody holds a wish"),
            Some(us) if us >= 0 => row.ok(format!("there; somebody wishes {us} us")),
            _ => row.unknown("/dev/cpu_dma_latency makes no sense"),
        },
        Err(error) => match error.kind {
            super::host::ReadErrorKind::Unreadable(_) => row.warn(
                error.to_string(),
                "a udev rule: KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"",
            ),
            _ => row.unknown(error),
        },
    }
}
