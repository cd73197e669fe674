//! Simulates falls of the arm alone, which another program requests line by line on standard input,
//! so that it can step its own arm in turns with ours: see `docs/measurements/simulator_mujoco.py`.

use std::io::BufRead;

use serde_json::json;
use taktil_hal::{LinesOut, Nanos};
use taktil_machine_console::out;
use taktil_rtcore::linux;
use taktil_sim::fidelity::{ArmModel, Integrator};
use taktil_sim::{Timing, WorldConfig, build};

use taktil_machine_console::option::BadOption;

/// Period of the commands to the devices.
const CONTROL_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Longest fall (s).
const FALL_TIME_MAX_S: f64 = 100.0;

/// The request of a line: integrator, step (us), duration (s), six angles (rad).
fn parse_request(line: &str) -> Option<(WorldConfig, Nanos)> {
    let mut words = line.split_whitespace();
    let integrator = match words.next()? {
        "rk4" => Integrator::Rk4,
        "implicit" => Integrator::Implicit,
        "euler" => Integrator::Euler,
        _ => return None,
    };
    let numbers: Vec<f64> = words.map(|word| word.parse().ok()).collect::<Option<_>>()?;
    let [substep_us, span_s, start @ ..] = numbers.as_slice() else { return None };
    let start = <[f64; 6]>::try_from(start).ok()?;
    if !(0.0..=FALL_TIME_MAX_S).contains(span_s) {
        return None;
    }
    let mut config =
        WorldConfig { substep_us: *substep_us, arm_refresh_steps: 1, ..WorldConfig::default() };
    (config.fidelity.arm, config.fidelity.integrator) = (ArmModel::Rigid, integrator);
    (config.pin.present, config.tactile.present) = (false, false);
    config.arm.home_deg = start.map(f64::to_degrees);
    Some((config, Nanos((1e9 * span_s).round() as i64)))
}

/// Answers every line with the wall time of the simulation and the final angles of the arm.
///
/// # Errors
/// [`BadOption`] for a line that is not a request; a world that cannot be built.
pub(super) fn serve(lines: impl BufRead) -> anyhow::Result<()> {
    for line in lines.lines() {
        let line = line?;
        let what = || BadOption(format!("`{line}`: give integrator, us, s and six angles in rad"));
        let (config, span) = parse_request(&line).ok_or_else(what)?;
        let timing = Timing {
            control_period: CONTROL_PERIOD,
            actuation_delay: Nanos::ZERO,
            scan_period: CONTROL_PERIOD * 2,
        };
        let (mut world, mut devices) = build(&config, &timing, 1)?;
        let (mut spent, mut t, mut watchdog_feed) = (Nanos::ZERO, Nanos::ZERO, false);
        while t < span {
            watchdog_feed = !watchdog_feed;
            let order = LinesOut { enable: true, brake_release: true, watchdog_feed };
            devices.require_digital_out()?.commit(t, &order)?;
            devices.require_encoders()?.sample(t)?;
            t += CONTROL_PERIOD;
            let start = linux::monotonic();
            world.advance(t.min(span));
            spent += linux::monotonic() - start;
        }
        let (q, _) = world.joints();
        if !out::line(json!({ "ns": spent.0, "steps": world.statistics().steps, "q_rad": q }))? {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_ask_for_nothing_are_refused() {
        let home = "0 0.8 -2.8 -3.1 1.1 3.1";
        assert!(serve(format!("rk4 2500 0.01 {home}\n").as_bytes()).is_ok());
        for line in ["", "rk4", "rk4 2500 0.01 0 0", "heun 2500 0.01", "rk4 x 0.01", "rk4 2500 nan"]
        {
            assert!(serve(format!("{line} {home}\n").as_bytes()).is_err(), "{line}");
        }
    }
}
