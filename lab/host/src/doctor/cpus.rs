//! Checks of the CPUs that lanes run on: set aside, ticking, shared with a sibling, clocked down,
//! asleep. Refuses to guess which they are: asked for, else the isolated ones, else all.

use super::cpulist::CpuList;
use super::facts::{Facts, cpus};
use super::finding::{Fix, Row, Severity};
use super::host::Host;

/// Waking up may take this long (us) before it shows.
const EXIT_MAX_US: u64 = 10;
/// What the latency device says when nobody wishes anything (us).
const NO_WISH_US: i32 = 2_000_000_000;
const LATENCY_DEVICE: &str = "dev/cpu_dma_latency";

fn boot(facts: &Facts) -> Fix {
    let (lanes, others) = (facts.proposed(), facts.others());
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

/// CPUs that the scheduler leaves alone.
#[must_use]
pub(super) fn isolated(facts: &Facts) -> Row {
    let row = Row::new("isolated CPUs", Severity::Medium, "the lanes' CPUs are isolated");
    let list = match &facts.isolated {
        Ok(list) => list,
        Err(gap) => return row.unknown(gap),
    };
    let lacking = facts.lanes.without(list);
    if !lacking.is_empty() {
        return row
            .warn(
                format!("{list} without {lacking}").trim_start(),
                "other programs run on the lanes' CPUs: boot parameters in --fix-script",
            )
            .fix(boot(facts));
    }
    if !list.is_empty() {
        return row.ok(list.to_string());
    }
    let fix = boot(facts);
    let remedy = match &fix.boot[..] {
        [] => "one CPU cannot be set aside: a machine with two or more".to_owned(),
        parameters => format!("boot with {}", parameters.join(" ")),
    };
    row.warn("none", remedy).fix(fix)
}

/// CPUs without a periodic tick.
#[must_use]
pub(super) fn tickless(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("nohz_full", Severity::Low, "the lanes' CPUs have no periodic tick");
    match cpus(host, "sys/devices/system/cpu/nohz_full") {
        Err(gap) => row.unknown(gap),
        Ok(list) => {
            let lacking = facts.lanes.without(&list);
            if list.is_empty() || !lacking.is_empty() {
                let found = if list.is_empty() { "none".to_owned() } else { list.to_string() };
                row.warn(found, "the tick costs a few microseconds now and then: see --fix-script")
                    .fix(boot(facts))
            } else {
                row.ok(list.to_string())
            }
        }
    }
}

/// Two threads in one core.
#[must_use]
pub(super) fn siblings(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("SMT", Severity::Medium, "off, or no sibling of a lane's CPU runs");
    match host.text("sys/devices/system/cpu/smt/active") {
        Ok(text) if text == "0" => return row.ok("off"),
        Ok(text) if text == "1" => {}
        Ok(text) => return row.unknown(format!("/sys/devices/system/cpu/smt/active is {text}")),
        Err(gap) => return row.unknown(gap),
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
        let mut core = match cpus(host, &path) {
            Ok(core) => core,
            Err(gap) => return row.unknown(gap),
        };
        // Of the lanes' CPUs in one core the first stays.
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

/// The clock of the CPUs.
#[must_use]
pub(super) fn governor(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("CPU governor", Severity::Medium, "performance");
    let mut others: Vec<String> = Vec::new();
    let mut slow = CpuList::default();
    let mut gap = None;
    let judged = facts.judged();
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
            Err(why) => gap = Some(why),
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
    match gap {
        Some(gap) => row.unknown(format!("{gap}; a virtual machine, or the firmware decides")),
        None if judged.is_empty() => row.unknown("which CPUs run is not known"),
        None => row.ok(format!("performance on CPUs {judged}")),
    }
}

/// How deeply the CPUs sleep.
#[must_use]
pub(super) fn idle_states(host: &Host, facts: &Facts) -> Row {
    let row = Row::new("C-states", Severity::Medium, "no state that takes over 10 us to leave");
    let mut deepest: Option<(u64, String)> = None;
    let mut deep: Vec<String> = Vec::new();
    let judged = facts.judged();
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
            if exit_us > EXIT_MAX_US {
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
    match wish_us(host) {
        _ if exit_us <= EXIT_MAX_US => row.ok(found),
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

/// The strictest wish that is held now, in us.
fn wish_us(host: &Host) -> Option<i32> {
    let bytes = host.bytes(LATENCY_DEVICE).ok()?;
    Some(i32::from_le_bytes(bytes.get(..4)?.try_into().ok()?))
}

/// The device by which a program keeps CPUs awake.
#[must_use]
pub(super) fn latency_device(host: &Host) -> Row {
    let row = Row::new("latency device", Severity::Low, "/dev/cpu_dma_latency can be opened");
    match host.bytes(LATENCY_DEVICE) {
        Ok(_) => match wish_us(host) {
            Some(NO_WISH_US) => row.ok("there; nobody holds a wish"),
            Some(us) if us >= 0 => row.ok(format!("there; somebody wishes {us} us")),
            _ => row.unknown("/dev/cpu_dma_latency makes no sense"),
        },
        Err(gap) => match gap.why {
            super::host::Why::Unreadable(_) => row.warn(
                gap.to_string(),
                "a udev rule: KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"",
            ),
            _ => row.unknown(gap),
        },
    }
}
