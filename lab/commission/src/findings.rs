//! What a commissioning found, with residuals, and as the section `[joints]` of a machine file.

use core::fmt::Write as _;

use taktil_machine::joints::JointsConfig;

use crate::cell::Punctuality;
use crate::fit::TorqueFit;
use crate::model::Model;

/// Where a torque constant comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Gravity changed enough over the swing.
    Gravity,
    /// The axis is vertical or balanced: only the inertia of the model resists.
    Inertia,
}

/// What was found of one joint.
#[derive(Clone, Debug, PartialEq)]
pub struct JointFindings {
    /// Channel of its encoder.
    pub encoder_channel: usize,
    /// 1, or -1 for an encoder that counts down where the angle grows.
    pub encoder_sign: f64,
    /// Channel of the converter before its amplifier.
    pub motor_channel: usize,
    /// 1, or -1 for a motor that turns the other way at a positive code.
    pub motor_sign: f64,
    /// Counts in a motor turn, from index pulses.
    pub counts_per_rev: Option<f64>,
    /// Largest deviation of a spacing of pulses from it (counts), and how many there were.
    pub spacing_residual_counts: i64,
    /// Number of spacings.
    pub spacings: usize,
    /// Motor turns in a joint turn, from the counts between the stops.
    pub gear: Option<f64>,
    /// By how much both halves of the range, from the home pose to either stop, disagree about it,
    /// in parts of it.
    pub gear_disagreement: f64,
    /// Counts by which the home pose is past an index pulse.
    pub home_counts: Option<f64>,
    /// Torque of the motor at the joint for one code (N m); friction; residual.
    pub torque: Option<TorqueFindings>,
    /// Torque constant of the motor (N m/A), with the current that the file states.
    pub torque_constant_nm_a: Option<f64>,
    /// Code at which the motor broke loose from rest.
    pub breakaway_codes: f64,
}

/// Torque and friction of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueFindings {
    /// Torque at the joint for one code (N m).
    pub nm_per_code: f64,
    /// Coulomb friction (N m).
    pub coulomb_nm: f64,
    /// Viscous friction (N m s/rad).
    pub viscous_nms_rad: f64,
    /// Root mean square of what the fit leaves (N m).
    pub residual_nm: f64,
    /// What told the scale.
    pub source: Source,
}

impl TorqueFindings {
    pub(crate) fn of(fit: &TorqueFit, source: Source) -> TorqueFindings {
        TorqueFindings {
            nm_per_code: fit.nm_per_code,
            coulomb_nm: fit.coulomb_nm,
            viscous_nms_rad: fit.viscous_nms_rad,
            residual_nm: fit.residual_nm,
            source,
        }
    }
}

/// What was found of all joints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// By joint.
    pub joints: Vec<JointFindings>,
    /// What cannot be known of this robot in this pose, for people.
    pub unknown: Vec<String>,
    /// How well the cycles kept their time.
    pub punctuality: Punctuality,
}

impl Findings {
    fn all(&self, value: impl Fn(&JointFindings) -> Option<f64>) -> Option<Vec<f64>> {
        self.joints.iter().map(value).collect()
    }

    /// As the section of a machine file; a scale that was not found for every joint keeps the
    /// value of `model` where it is missing.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "channels")]
    pub fn section(&self, model: &Model) -> JointsConfig {
        let or_known = |known: &[f64], value: &dyn Fn(&JointFindings) -> Option<f64>| {
            let found = self.joints.iter().zip(known);
            Some(found.map(|(joint, known)| value(joint).unwrap_or(*known)).collect())
        };
        JointsConfig {
            encoder_channel: self.all(|joint| Some(joint.encoder_channel as f64)),
            encoder_sign: self.all(|joint| Some(joint.encoder_sign)),
            counts_per_rev: or_known(&model.counts_per_rev, &|joint| joint.counts_per_rev),
            gear: or_known(&model.gear, &|joint| joint.gear),
            motor_channel: self.all(|joint| Some(joint.motor_channel as f64)),
            motor_sign: self.all(|joint| Some(joint.motor_sign)),
            torque_constant_nm_a: or_known(&model.torque_constant_nm_a, &|joint| {
                joint.torque_constant_nm_a
            }),
            current_max_a: Some(model.current_max_a.clone()),
            ..JointsConfig::default()
        }
    }

    /// The text of the section, with the date and what the numbers are worth. What a code is worth
    /// stays as `file` says it.
    #[must_use]
    pub fn text(&self, model: &Model, file: &JointsConfig, date: &str) -> String {
        let section = self.section(model);
        let mut text = format!("# Found by `taktil commission` on {date}.\n");
        for (i, joint) in self.joints.iter().enumerate() {
            text += &format!("# {}: {}\n", model.label(i), joint.residuals());
        }
        for unknown in &self.unknown {
            text += &format!("# Not known: {unknown}\n");
        }
        let Punctuality { cycles, left_out, latest, failed, repeated_pulses } = self.punctuality;
        if !self.punctuality.is_perfect() {
            text += &format!(
                "# Of {cycles} cycles {failed} failed; {left_out} releases were left out, the \
                 latest cycle began {latest} late. {repeated_pulses} pulses were given again; \
                 windows with such a cycle are in no fit.\n"
            );
        }
        text += "[joints]\n";
        let lists = [
            ("encoder_channel", &section.encoder_channel),
            ("encoder_sign", &section.encoder_sign),
            ("counts_per_rev", &section.counts_per_rev),
            ("gear", &section.gear),
            ("motor_channel", &section.motor_channel),
            ("motor_sign", &section.motor_sign),
            ("torque_constant_nm_a", &section.torque_constant_nm_a),
            ("current_max_a", &section.current_max_a),
            ("full_scale_codes", &file.full_scale_codes),
            ("full_scale_v", &file.full_scale_v),
            ("current_limit_a", &file.current_limit_a),
        ];
        for (name, list) in lists {
            let Some(list) = list else { continue };
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{name} = {}", numbers(list));
        }
        text
    }

    /// Counts of the home pose past the index pulses, for `[sense.index] home_counts`; only if they
    /// are known for every joint.
    #[must_use]
    pub fn home_counts(&self) -> Option<Vec<f64>> {
        self.all(|joint| joint.home_counts)
    }

    /// What the machine file said otherwise, for people.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "channels")]
    pub fn differences(&self, file: &JointsConfig, model: &Model) -> Vec<String> {
        let found = self.section(model);
        let usual = |value: f64| (0..self.joints.len()).map(|_| value).collect::<Vec<f64>>();
        let order: Vec<f64> = (0..self.joints.len()).map(|i| i as f64).collect();
        let keys = [
            ("encoder_channel", &found.encoder_channel, &file.encoder_channel, order.clone()),
            ("encoder_sign", &found.encoder_sign, &file.encoder_sign, usual(1.0)),
            ("motor_channel", &found.motor_channel, &file.motor_channel, order),
            ("motor_sign", &found.motor_sign, &file.motor_sign, usual(1.0)),
            ("counts_per_rev", &found.counts_per_rev, &None, model.counts_per_rev.clone()),
            ("gear", &found.gear, &None, model.gear.clone()),
        ];
        let mut all = Vec::new();
        for (name, found, file, usual) in keys {
            let (Some(found), file) = (found, file.as_ref().unwrap_or(&usual)) else { continue };
            for (i, (found, file)) in found.iter().zip(file).enumerate() {
                if (found - file).abs() > 1e-3 * file.abs() {
                    let label = model.label(i);
                    all.push(format!("{label}: {name} is {found}, the file says {file}"));
                }
            }
        }
        all
    }
}

fn numbers(list: &[f64]) -> String {
    let rounded = |x: &f64| format!("{}", (x * 1e6).round() / 1e6);
    format!("[{}]", list.iter().map(rounded).collect::<Vec<_>>().join(", "))
}

impl JointFindings {
    fn residuals(&self) -> String {
        let mut text = match self.counts_per_rev {
            Some(_) => format!(
                "{} turns between index pulses, off by at most {} counts; ",
                self.spacings, self.spacing_residual_counts
            ),
            None => "counts of a turn not measured; ".to_owned(),
        };
        text += &match self.gear {
            Some(_) => format!(
                "gear from stop to stop, both ways from home differ by {:.3} %; ",
                100.0 * self.gear_disagreement
            ),
            None => "gear not measured; ".to_owned(),
        };
        text += &match &self.torque {
            None => "torque not measured".to_owned(),
            Some(torque) => format!(
                "torque against {}: {:.5} N m a code, residual {:.4} N m; friction {:.4} N m and \
                 {:.4} N m s/rad",
                match torque.source {
                    Source::Gravity => "gravity",
                    Source::Inertia => "inertia",
                },
                torque.nm_per_code,
                torque.residual_nm,
                torque.coulomb_nm,
                torque.viscous_nms_rad
            ),
        };
        text + &format!("; broke loose at code {:.0}", self.breakaway_codes)
    }
}
