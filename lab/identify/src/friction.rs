//! `taktil identify friction`: Coulomb and viscous friction of each joint from the log of a run in
//! which it moved. Friction is the torque of the drives minus the model's torque for links, motors
//! and gravity. A straight line through it over the speed, the same for both directions, yields
//! both parts. Joints that hardly moved, and speeds at which a joint may stick, are left out.
//!
//! Torques, speeds and the model are averaged over windows of 50 ms, so that the steps of the
//! counts average out and no speed is differentiated twice. Uncertainties come from leaving out one
//! block of the run at a time (jackknife over blocks), because neighbouring windows are not
//! independent.

use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_machine_console::out;
use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::dynamics::Dynamics;

use taktil_machine_console::option::BadOption;
use taktil_record::Log;
use taktil_record::series::Series;

/// Number of samples in a window.
const WINDOW_SAMPLES: usize = 20;
/// Smallest speed that is used (rad/s); a slower joint may stick.
const SPEED_MIN_RAD_S: f64 = 0.03;
/// Number of blocks of the run that are left out one at a time.
const JACKKNIFE_BLOCKS: usize = 20;
/// Smallest number of windows that determine a line.
const WINDOWS_MIN: usize = 40;

/// Friction of one joint; the uncertainties are two standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Torque of sliding at any speed (N m).
    pub coulomb_nm: f64,
    /// Its uncertainty (N m).
    pub coulomb_error_nm: f64,
    /// Torque per speed (N m s/rad).
    pub viscous_nms_rad: f64,
    /// Its uncertainty (N m s/rad).
    pub viscous_error_nms_rad: f64,
    /// Root mean square of the residuals (N m).
    pub residual_nm: f64,
    /// Number of windows used.
    pub windows: usize,
}

/// Sums of a least-squares line `y = c sign(v) + f v`.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    n: f64,
    sv: f64,
    vv: f64,
    sy: f64,
    vy: f64,
    yy: f64,
}

impl Sums {
    fn add(&mut self, speed: f64, torque: f64) {
        let sign = 1f64.copysign(speed);
        self.n += 1.0;
        self.sv += sign * speed;
        self.vv += speed * speed;
        self.sy += sign * torque;
        self.vy += speed * torque;
        self.yy += torque * torque;
    }

    fn minus(&self, b: &Sums) -> Sums {
        Sums {
            n: self.n - b.n,
            sv: self.sv - b.sv,
            vv: self.vv - b.vv,
            sy: self.sy - b.sy,
            vy: self.vy - b.vy,
            yy: self.yy - b.yy,
        }
    }

    /// Coulomb and viscous parts; `None` when all speeds were the same.
    fn solve(&self) -> Option<(f64, f64)> {
        let det = self.n * self.vv - self.sv * self.sv;
        let known = det > 1e-6 * self.n * self.vv;
        known.then(|| {
            let coulomb = (self.sy * self.vv - self.vy * self.sv) / det;
            (coulomb, (self.n * self.vy - self.sv * self.sy) / det)
        })
    }
}

/// Fits a line through (speed, torque) of consecutive windows; `None` when they do not determine
/// one.
#[must_use]
pub fn fit(windows: &[(f64, f64)]) -> Option<Fit> {
    if windows.len() < WINDOWS_MIN {
        return None;
    }
    let sum = |part: &[(f64, f64)]| {
        part.iter().fold(Sums::default(), |mut sums, (speed, torque)| {
            sums.add(*speed, *torque);
            sums
        })
    };
    let all = sum(windows);
    let (coulomb_nm, viscous_nms_rad) = all.solve()?;
    let parts: Vec<(f64, f64)> = windows
        .chunks(windows.len().div_ceil(JACKKNIFE_BLOCKS))
        .map(|block| all.minus(&sum(block)).solve())
        .collect::<Option<_>>()?;
    #[expect(clippy::cast_precision_loss, reason = "twenty")]
    let count = parts.len() as f64;
    let spread = |of: fn(&(f64, f64)) -> f64| {
        let mean = parts.iter().map(of).sum::<f64>() / count;
        let square = parts.iter().map(|part| (of(part) - mean) * (of(part) - mean)).sum::<f64>();
        2.0 * (square * (count - 1.0) / count).sqrt()
    };
    let left = all.yy - coulomb_nm * all.sy - viscous_nms_rad * all.vy;
    Some(Fit {
        coulomb_nm,
        coulomb_error_nm: spread(|part| part.0),
        viscous_nms_rad,
        viscous_error_nms_rad: spread(|part| part.1),
        residual_nm: (left.max(0.0) / all.n).sqrt(),
        windows: windows.len(),
    })
}

/// The signals of a log that the identification needs, at the same jobs.
struct Rows {
    q: Vec<Joints>,
    desired: Vec<Joints>,
    applied: Vec<Joints>,
    /// True where the joints are calibrated and the torque was not limited.
    is_usable: Vec<bool>,
    tick_s: f64,
}

fn joints(series: &Series, name: &str) -> anyhow::Result<Vec<Joints>> {
    let column = series.column(name).filter(|column| column.width == 6);
    let column = column.ok_or_else(|| BadOption(format!("the log has no {name} of six joints")))?;
    Ok((0..series.len()).map(|row| Joints::from_row_slice(column.row(row))).collect())
}

impl Rows {
    fn from_log(log: &Log) -> anyhow::Result<Rows> {
        let series = |name: &str| {
            let series = log.series(name).filter(|series| !series.is_empty());
            series.ok_or_else(|| {
                BadOption(format!("the log has no `{name}`; name the log of another run"))
            })
        };
        let (state, desired, applied) =
            (series("sense.joints")?, series("setpoint.desired")?, series("actuate.applied")?);
        if state.tick != desired.tick || state.tick != applied.tick || state.len() < 2 {
            let what =
                "the log's jobs are not whole: some wrote only a part; name the log of another run";
            return Err(BadOption(what.into()).into());
        }
        let calibrated = state.values("calibrated", 0);
        let (open, limited) = (applied.values("gate_open", 0), applied.values("limited", 0));
        let is_usable = (0..state.len())
            .map(|row| calibrated[row] == 1.0 && open[row] == 1.0 && limited[row] == 0.0)
            .collect();
        Ok(Rows {
            q: joints(&state, "q_rad")?,
            desired: joints(&desired, "qd_rad_s")?,
            applied: joints(&applied, "tau_nm")?,
            is_usable,
            tick_s: state.t_s[1] - state.t_s[0],
        })
    }

    /// Speeds and friction torques of the windows of each joint.
    fn windows(&self) -> [Vec<(f64, f64)>; 6] {
        let dynamics = Dynamics::reference();
        let mut found: [Vec<(f64, f64)>; 6] = Default::default();
        #[expect(clippy::cast_precision_loss, reason = "twenty")]
        let (count, span_s) = (WINDOW_SAMPLES as f64, WINDOW_SAMPLES as f64 * self.tick_s);
        for begin in (1..self.q.len().saturating_sub(WINDOW_SAMPLES)).step_by(WINDOW_SAMPLES) {
            let rows = begin..begin + WINDOW_SAMPLES;
            if !self.is_usable[begin - 1..begin + WINDOW_SAMPLES].iter().all(|is_usable| *is_usable)
            {
                continue;
            }
            let speed = (self.q[begin + WINDOW_SAMPLES - 1] - self.q[begin - 1]) / span_s;
            let acceleration =
                (self.desired[begin + WINDOW_SAMPLES - 1] - self.desired[begin - 1]) / span_s;
            let mut model_torque =
                dynamics.mass_matrix(&self.q[begin + WINDOW_SAMPLES / 2]) * acceleration;
            let mut applied_torque = Joints::zeros();
            for row in rows.clone() {
                model_torque += dynamics.bias_torque(&self.q[row], &self.desired[row]) / count;
                applied_torque += self.applied[row] / count;
            }
            for (joint, found) in found.iter_mut().enumerate() {
                let sign = self.desired[begin][joint].signum();
                let slides =
                    rows.clone().all(|row| sign * self.desired[row][joint] > SPEED_MIN_RAD_S);
                if slides && sign * speed[joint] > SPEED_MIN_RAD_S {
                    found.push((speed[joint], applied_torque[joint] - model_torque[joint]));
                }
            }
        }
        found
    }
}

/// Fits the friction and prints it.
///
/// # Errors
/// [`BadOption`] for a log that cannot be used.
pub fn run(log: &Log, json: bool) -> anyhow::Result<ExitCode> {
    let windows = Rows::from_log(log)?.windows();
    let fits: Vec<Option<Fit>> = windows.iter().map(|windows| fit(windows)).collect();
    let model = Friction::reference();
    if json {
        out::line(as_json(&fits, &model))?;
    } else {
        out::text(table(&fits, &model))?;
    }
    Ok(if fits.iter().all(Option::is_some) { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn as_json(fits: &[Option<Fit>], model: &Friction) -> Value {
    let one = |(joint, fit): (usize, &Option<Fit>)| {
        json!({
            "joint": joint + 1,
            "coulomb_nm": fit.map(|fit| fit.coulomb_nm),
            "coulomb_error_nm": fit.map(|fit| fit.coulomb_error_nm),
            "viscous_nms_rad": fit.map(|fit| fit.viscous_nms_rad),
            "viscous_error_nms_rad": fit.map(|fit| fit.viscous_error_nms_rad),
            "residual_nm": fit.map(|fit| fit.residual_nm),
            "windows": fit.map(|fit| fit.windows),
            "model_coulomb_nm": model.coulomb_nm[joint],
            "model_viscous_nms_rad": model.viscous_nms_rad[joint],
        })
    };
    Value::Array(fits.iter().enumerate().map(one).collect())
}

fn table(fits: &[Option<Fit>], model: &Friction) -> String {
    let mut text = String::from(
        "joint  Coulomb, N m (2 sigma)   model    viscous, N m s/rad (2 sigma)  model    left, \
         N m  windows\n",
    );
    for (joint, fit) in fits.iter().enumerate() {
        let (coulomb, viscous) = (model.coulomb_nm[joint], model.viscous_nms_rad[joint]);
        text += &match fit {
            Some(fit) => format!(
                "{}      {:8.4} +- {:.4}        {coulomb:.4}   {:8.4} +- {:.4}            \
                 {viscous:.4}   {:.4}     {}\n",
                joint + 1,
                fit.coulomb_nm,
                fit.coulomb_error_nm,
                fit.viscous_nms_rad,
                fit.viscous_error_nms_rad,
                fit.residual_nm,
                fit.windows
            ),
            None => format!("{}      moved too little, or at one speed only\n", joint + 1),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows with friction of 0.5 and 0.2 in both directions, and an error that does not average
    /// out within a block.
    fn windows(error: f64) -> Vec<(f64, f64)> {
        (0..400)
            .map(|k| {
                let speed = 0.1 + 0.002 * f64::from(k % 100);
                let speed = if k % 200 < 100 { speed } else { -speed };
                let wave = if k / 10 % 2 == 0 { error } else { -error };
                (speed, 0.5f64.copysign(speed) + 0.2 * speed + wave)
            })
            .collect()
    }

    #[test]
    fn exact_windows_give_exact_friction_and_no_uncertainty() {
        let fit = fit(&windows(0.0)).unwrap();
        assert!((fit.coulomb_nm - 0.5).abs() < 1e-12 && (fit.viscous_nms_rad - 0.2).abs() < 1e-12);
        assert!(fit.coulomb_error_nm < 1e-9 && fit.viscous_error_nms_rad < 1e-9);
        assert!(fit.residual_nm < 1e-6, "{fit:?}");
    }

    #[test]
    fn the_uncertainty_covers_errors_that_hang_together() {
        let fit = fit(&windows(0.05)).unwrap();
        assert!((fit.coulomb_nm - 0.5).abs() < fit.coulomb_error_nm, "{fit:?}");
        assert!((fit.viscous_nms_rad - 0.2).abs() < fit.viscous_error_nms_rad, "{fit:?}");
        assert!(fit.coulomb_error_nm > 0.002 && (fit.residual_nm - 0.05).abs() < 0.005, "{fit:?}");
    }

    #[test]
    fn few_windows_and_one_speed_fix_no_line() {
        assert_eq!(fit(&[]), None);
        assert_eq!(fit(&windows(0.0)[..WINDOWS_MIN - 1]), None);
        assert_eq!(fit(&vec![(0.3, 0.5); 100]), None);
    }
}
