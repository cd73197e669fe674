//! Checks of the environment of the lanes: clocks that depend on temperature, firmware that
//! interrupts the CPU unseen, adapters that delay bytes, and the time of day. Where only a
//! measurement helps, the row names the command.

use super::disturbances::running_programs;
use super::facts::Facts;
use super::finding::{Fix, Row, Severity};
use super::host::{Host, ReadError};

/// Largest number of adapters that are read, so that an invalid tree cannot block the program.
const ADAPTERS_MAX: usize = 1_000;
/// Longest time for which an adapter may hold bytes back without a warning (ms).
const LATENCY_TIMER_MAX_MS: u32 = 1;

/// Checks for clock frequencies above the rated one, which depend on temperature and on other
/// cores.
#[must_use]
pub(super) fn turbo(host: &Host) -> Row {
    let row =
        Row::new("turbo", Severity::Low, "off: the clock does not follow heat and neighbours");
    let intel = "sys/devices/system/cpu/intel_pstate/no_turbo";
    let other = "sys/devices/system/cpu/cpufreq/boost";
    // One switch states what is off, the other what is on.
    for (path, off, on) in [(intel, "1", "0"), (other, "0", "1")] {
        match host.text(path) {
            Ok(text) if text == off => return row.ok("off"),
            Ok(text) if text == on => {
                return row
                    .warn("on", "one job's time depends on what other cores do: switch it off")
                    .fix(Fix::run([format!("echo {off} > /{path}")]));
            }
            Ok(text) => return row.unknown(format!("/{path} makes no sense: {text}")),
            Err(_) => {}
        }
    }
    row.unknown("the kernel has no switch for it")
}

/// Checks whether the time that the firmware takes can be measured.
#[must_use]
pub(super) fn firmware(host: &Host) -> Row {
    let row =
        Row::new("firmware noise", Severity::Low, "the tracer `hwlat` is there to look for it");
    let places = ["sys/kernel/tracing", "sys/kernel/debug/tracing"];
    let read = |place: &str| host.text(&format!("{place}/available_tracers"));
    let text = match read(places[0]).or_else(|error| read(places[1]).map_err(|_| error)) {
        Ok(text) => text,
        Err(error) => return row.unknown(error),
    };
    let has = |name: &str| text.split_whitespace().any(|tracer| tracer == name);
    if !has("nop") {
        return row.unknown("the list of tracers makes no sense");
    }
    if has("hwlat") {
        return row.ok("there, not run: `hwlatdetect --duration=60` as root, nothing above 10 us");
    }
    row.warn(
        "no such tracer in this kernel",
        "system management interrupts cannot be told from other lateness here: a kernel with \
         CONFIG_HWLAT_TRACER, and the vendor's list of BIOS settings",
    )
}

/// The row on wake-up latency, which no file states.
#[must_use]
pub(super) fn wake_up_latency(facts: &Facts) -> Row {
    let row = Row::new("wake-up latency", Severity::Low, "a tenth of the period at most");
    let cpu = facts
        .proposed_lane_cpus()
        .0
        .first()
        .map_or_else(String::new, |cpu| format!(" --cpu {cpu}"));
    row.unknown(format!("not measured here: `taktil jitter{cpu} --for 60 --load`"))
}

/// Checks for serial adapters on USB that collect bytes before they pass them on.
#[must_use]
pub(super) fn serial_adapters(host: &Host) -> Row {
    let row = Row::new("serial adapters", Severity::Low, "no adapter keeps bytes back over 1 ms");
    let folder = "sys/bus/usb-serial/devices";
    if !host.has(folder) {
        // A kernel without the driver has no adapters.
        return if host.has("sys/bus") {
            row.ok("none")
        } else {
            row.unknown("/sys/bus is not there")
        };
    }
    let mut slow: Vec<String> = Vec::new();
    let (mut seen, mut error) = (0, None);
    for name in host.names(folder).into_iter().filter(|name| is_port(name)).take(ADAPTERS_MAX) {
        seen += 1;
        let path = format!("{folder}/{name}/latency_timer");
        match host.text(&path).map(|text| text.parse::<u32>()) {
            Ok(Ok(ms)) if ms <= LATENCY_TIMER_MAX_MS => {}
            Ok(Ok(_)) => slow.push(path),
            Ok(Err(_)) => error = Some(ReadError::unintelligible(&path)),
            // Adapters with other chips than FTDI's have no adjustable timer.
            Err(error) if error.kind == super::host::ReadErrorKind::Absent => {}
            Err(why) => error = Some(why),
        }
    }
    if !slow.is_empty() {
        let commands = slow.iter().map(|path| format!("echo {LATENCY_TIMER_MAX_MS} > /{path}"));
        return row
            .warn(
                format!("{} of {seen} keep bytes back, 16 ms is usual", slow.len()),
                "a device behind it answers so much later: a udev rule that sets \
                 ATTR{latency_timer}=\"1\"",
            )
            .fix(Fix::run(commands));
    }
    match error {
        Some(error) => row.unknown(error),
        None => row.ok(format!("{seen}, none keeps bytes back")),
    }
}

fn is_port(name: &str) -> bool {
    name.strip_prefix("ttyUSB").is_some_and(|number| number.parse::<u16>().is_ok())
}

/// Programs that set the time of day, by the first 15 characters of their names.
const TIME_DAEMONS: [&str; 6] =
    ["chronyd", "ntpd", "ntpsec", "openntpd", "ptp4l", "systemd-timesyn"];

/// Checks that one program sets the time of day.
#[must_use]
pub(super) fn time_of_day(host: &Host) -> Row {
    let row = Row::new("time of day", Severity::Low, "one program sets it");
    let Some(running) = running_programs(host) else {
        return row.unknown("others' processes are not listed");
    };
    let found: Vec<&str> =
        TIME_DAEMONS.into_iter().filter(|name| running.contains(*name)).collect();
    match &found[..] {
        [] => row.warn(
            "nobody",
            "lanes run by the monotonic clock and do not care, but logs of two machines cannot be \
             laid side by side: chrony, or ptp4l",
        ),
        [one] => row.ok(*one),
        several => row.warn(several.join(", "), "two set one clock against each other: keep one"),
    }
}
