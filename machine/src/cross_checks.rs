//! Checks that need more than one section of a machine: the times of tasks and boards against the
//! periods of the lanes, and the priorities of the lanes against those of the kernel. Each number
//! may be fine by itself.

use std::ops::RangeInclusive;

use taktil_hal::{Devices, Nanos};
use taktil_rtcore::{Invalid, LaneSpec};

use crate::config::MachineConfig;

/// The longest that a board may keep its outputs after the last sign of life: for so long an arm
/// moves without control.
const BOARD_SILENCE_MAX: Nanos = Nanos::from_secs(1);
/// The shortest silence of a board, in periods of the lane that writes to it: one job may be late.
const BOARD_SILENCE_MIN_PERIODS: i64 = 2;
/// The longest that joints and lines may stay away, in periods of the lane that needs them.
const STALE_MAX_PERIODS: i64 = 200;
/// The highest `SCHED_FIFO` priority of a lane: the kernel's own threads that move other threads
/// between processors have 99.
const LANE_PRIORITY_MAX: i64 = 98;

/// Checks the sections of a machine against each other.
///
/// # Errors
/// The first contradiction, at its dotted path in the description.
pub(crate) fn check(config: &MachineConfig, devices: &Devices) -> Result<(), Invalid> {
    check_priorities(config)?;
    if let Some((name, lane)) = lane_of(config, "actuate")? {
        let analog = devices.analog_out.as_ref().map(|half| half.longest_silence());
        check_silence(config, "analog_out", analog, (&name, lane.period))?;
        let drives = devices.drive_out.as_ref().map(|half| half.longest_silence());
        check_silence(config, "drive_out", drives, (&name, lane.period))?;
        let digital = devices.digital_out.as_ref().map(|half| half.longest_silence());
        check_silence(config, "digital_out", digital, (&name, lane.period))?;
    }
    check_stale_times(config)
}

/// The shortest silence after which one of the outputs lets go by itself. A log that does not know
/// of one says 0.
pub(crate) fn shortest_silence(devices: &Devices) -> Nanos {
    let analog = devices.analog_out.as_ref().map(|half| half.longest_silence());
    let drives = devices.drive_out.as_ref().map(|half| half.longest_silence());
    let digital = devices.digital_out.as_ref().map(|half| half.longest_silence());
    let all = [analog, drives, digital].into_iter().flatten();
    all.filter(|silence| *silence > Nanos::ZERO).min().unwrap_or(Nanos::MAX)
}

/// The lane that runs a task, with its name.
fn lane_of(config: &MachineConfig, task: &str) -> Result<Option<(String, LaneSpec)>, Invalid> {
    let lane = config.lane.iter().find(|(_, lane)| lane.tasks.iter().any(|name| name == task));
    let Some((name, lane)) = lane else { return Ok(None) };
    let spec = lane.spec(name).map_err(|bad| bad.within(&format!("lane.{name}")))?;
    Ok(Some((name.clone(), spec)))
}

fn check_priorities(config: &MachineConfig) -> Result<(), Invalid> {
    for (name, lane) in &config.lane {
        if let Some(priority) = lane.priority.filter(|priority| *priority == LANE_PRIORITY_MAX + 1)
        {
            let what = format!("{priority} is the priority of the kernel's own threads");
            let remedy = format!("give at most {LANE_PRIORITY_MAX}; 80 is usual");
            return Err(Invalid::new(format!("lane.{name}.priority"), what, remedy));
        }
    }
    Ok(())
}

/// Checks how long a half keeps its outputs without a sign of life from its lane.
fn check_silence(
    config: &MachineConfig,
    half: &str,
    silence: Option<Nanos>,
    (lane, period): (&str, Nanos),
) -> Result<(), Invalid> {
    let Some(silence) = silence else { return Ok(()) };
    let least = period * BOARD_SILENCE_MIN_PERIODS;
    if (least..=BOARD_SILENCE_MAX).contains(&silence) {
        return Ok(());
    }
    let what = if silence < least {
        format!("`{half}` goes safe after {silence} of silence, lane `{lane}` has {period}")
    } else {
        format!("`{half}` keeps its outputs for {silence} after the last sign of life")
    };
    let remedy = format!("have its watchdog or relay act after {least} to {BOARD_SILENCE_MAX}");
    Err(Invalid::new(watchdog_place(config, half), what, remedy))
}

/// Where the watchdog of the device that serves a half is set.
fn watchdog_place(config: &MachineConfig, half: &str) -> String {
    let serving = config.device.iter().find(|(_, section)| {
        section.split().is_ok_and(|(keys, _)| {
            keys.serves.is_none_or(|halves| halves.iter().any(|name| name == half))
        })
    });
    let Some((name, section)) = serving else { return String::new() };
    let keys = ["relay_ms", "watchdog_ms", "remote_watchdog_ms"];
    match keys.into_iter().find(|key| section.has_key(key)) {
        Some(key) => format!("device.{name}.{key}"),
        None => format!("device.{name}"),
    }
}

/// Checks after what age the inputs of the supervisor count as lost.
fn check_stale_times(config: &MachineConfig) -> Result<(), Invalid> {
    let supervisor = config.supervisor.clone().unwrap_or_default();
    if let Some((name, lane)) = lane_of(config, "supervisor")? {
        let place = "supervisor.input_stale_s";
        let range = lane.period..=lane.period * STALE_MAX_PERIODS;
        check_age(place, supervisor.input_stale_s, range, &name)?;
    }
    if let Some((name, lane)) = lane_of(config, "tactile_scan")? {
        let place = "supervisor.tactile_timeout_s";
        let most = lane.period * (10 * STALE_MAX_PERIODS);
        let range = lane.period + lane.delivery..=most;
        check_age(place, supervisor.tactile_timeout_s, range, &name)?;
    }
    Ok(())
}

fn check_age(
    place: &str,
    age_s: f64,
    range: RangeInclusive<Nanos>,
    lane: &str,
) -> Result<(), Invalid> {
    let (least_s, most_s) = (range.start().as_secs_f64(), range.end().as_secs_f64());
    if (least_s..=most_s).contains(&age_s) {
        return Ok(());
    }
    let what = format!("{age_s} s do not go with the period of lane `{lane}`");
    Err(Invalid::new(place, what, format!("give seconds from {least_s} to {most_s}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> Option<(String, String)> {
        let config: MachineConfig = toml::from_str(text).unwrap();
        check(&config, &Devices::default()).err().map(|bad| (bad.place, bad.remedy))
    }

    fn machine(more: &str) -> String {
        format!(
            "[lane.servo]\nperiod_us = 2500\npriority = 80\ntasks = [\"supervisor\", \"actuate\"]\n\
             [lane.touch]\nperiod_us = 5000\npriority = 75\ntasks = [\"tactile_scan\"]\n{more}"
        )
    }

    #[test]
    fn times_that_do_not_go_with_the_periods_are_refused_with_the_range() {
        assert_eq!(refused(&machine("")), None);
        for (key, bad) in
            [("input_stale_s", "0.001"), ("input_stale_s", "1.0"), ("tactile_timeout_s", "0.006")]
        {
            let (place, remedy) =
                refused(&machine(&format!("[supervisor]\n{key} = {bad}"))).unwrap();
            assert_eq!(place, format!("supervisor.{key}"), "{bad}");
            assert!(remedy.starts_with("give seconds from "), "{remedy}");
        }
    }

    #[test]
    fn a_lane_does_not_have_the_priority_of_the_kernel_s_threads() {
        let text = machine("").replace("priority = 75", "priority = 99");
        assert_eq!(refused(&text).unwrap().0, "lane.touch.priority");
        assert_eq!(refused(&text.replace("= 99", "= 98")), None);
    }

    #[test]
    fn the_watchdog_of_a_board_is_sought_in_the_section_that_serves_the_half() {
        let device = "[device.card]\ndriver = \"regmap\"\nserves = [\"analog_out\"]\n\
                      watchdog_ms = 9\n\
                      [device.rest]\ndriver = \"regmap\"\nserves = [\"digital_out\"]\n";
        let config: MachineConfig = toml::from_str(&machine(device)).unwrap();
        let silence = |half, ms: i64| {
            let silence = Some(Nanos::from_millis(ms));
            check_silence(&config, half, silence, ("servo", Nanos::from_micros(2500))).err()
        };
        assert_eq!(silence("analog_out", 5), None);
        assert_eq!(silence("analog_out", 1000), None);
        assert_eq!(silence("analog_out", 10_000).unwrap().place, "device.card.watchdog_ms");
        assert_eq!(silence("analog_out", 4).unwrap().place, "device.card.watchdog_ms");
        assert_eq!(silence("digital_out", 10_000).unwrap().place, "device.rest");
    }
}
