//! `taktil identify jacobian`: how the features of an image change with small motions of the
//! sensor, from a log of such motions in contact. Uncertainties, singular values and the condition
//! number are printed beside the numbers.
//!
//! Motions are those of the arm as its encoders measure them, except along z: there the contact
//! holds the arm, and the force is made by the deflection of the servo's spring. On request all
//! motions are the commanded ones; the result then includes what the friction of the joints
//! absorbs.

pub mod fit;
pub mod rests;
#[cfg(test)]
mod tests;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_machine_console::out;
use taktil_tasks_tactile_servo::config::array::Array;
use taktil_tasks_tactile_servo::config::task_frame::{Feature, Motion, ServoedFeature, TaskFrame};

use fit::{Identification, Task, fit};
use rests::{Reading, rests};
use taktil_machine_console::option::BadOption;
use taktil_record::Log;

/// Names of the motions, with their units.
const MOTION_TABLE: [(&str, Motion, &str); 6] = [
    ("x", Motion::X, "mm"),
    ("y", Motion::Y, "mm"),
    ("z", Motion::Z, "mm"),
    ("theta_x", Motion::ThetaX, "mrad"),
    ("theta_y", Motion::ThetaY, "mrad"),
    ("theta_z", Motion::ThetaZ, "mrad"),
];
/// Names of the features, with their units.
const FEATURE_TABLE: [(&str, Feature, &str); 5] = [
    ("m0", Feature::M0, "counts"),
    ("x_c", Feature::XC, "columns"),
    ("y_c", Feature::YC, "rows"),
    ("m_x", Feature::MX, "counts x rows"),
    ("theta_z", Feature::ThetaZ, "mrad"),
];
/// Proportional gain of the printed task: a low one, for a loop at 200 Hz.
const GAIN_KP_PER_S: f64 = 4.0;
/// Integral gain of the same task.
const GAIN_KI_PER_S2: f64 = 4.0;

/// Options of `taktil identify jacobian`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Log file (MCAP) of a run with small test motions in contact
    pub(super) log: PathBuf,
    /// Only these motions, such as z,theta_x,theta_y
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    state: Vec<String>,
    /// Only these features, such as m0,x_c,y_c
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    features: Vec<String>,
    /// Tactels below this count 0; three standard deviations of the noise when absent
    #[arg(long, value_name = "COUNTS")]
    threshold: Option<f64>,
    /// Contact is a sum above this
    #[arg(long, value_name = "COUNTS", default_value_t = 1000.0)]
    contact: f64,
    /// Left out at the beginning of each rest
    #[arg(long, value_name = "S", default_value_t = 0.15)]
    settle: f64,
    /// Take the commanded motions instead of the measured ones, not only along z
    #[arg(long)]
    commanded: bool,
    /// One JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// Indices of the named entries.
fn indices_of(option: &str, names: &[String], known: &[&str]) -> Result<Vec<usize>, BadOption> {
    let one = |name: &String| {
        known
            .iter()
            .position(|k| k == name)
            .ok_or_else(|| BadOption(format!("{option} {name}: there are {}", known.join(", "))))
    };
    names.iter().map(one).collect()
}

impl Options {
    fn reading(&self) -> Result<Reading, BadOption> {
        let threshold = self.threshold.unwrap_or(0.0);
        for (option, value, most) in [
            ("--threshold", threshold, 65_535.0),
            ("--contact", self.contact, 4.2e6),
            ("--settle", self.settle, 60.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(BadOption(format!("{option} {value}: give 0 to {most}")));
            }
        }
        Ok(Reading {
            threshold_counts: self.threshold,
            contact_counts: self.contact,
            settle_s: self.settle,
            commanded: self.commanded,
        })
    }
}

/// Reads the log, fits the Jacobian and prints it.
///
/// # Errors
/// [`BadOption`] for options and logs that cannot be used.
pub fn run(log: &Log, options: &Options) -> anyhow::Result<ExitCode> {
    let motions = indices_of("--state", &options.state, &MOTION_TABLE.map(|m| m.0))?;
    let features = indices_of("--features", &options.features, &FEATURE_TABLE.map(|f| f.0))?;
    let rests = rests(log, &options.reading()?)?;
    let found = fit(&rests).map_err(BadOption)?;
    let task = found.task(&motions, &features);
    let frame = task_frame(&found, &task);
    if options.json {
        out::line(as_json(&found, &task, frame.as_ref()))?;
    } else {
        let images: usize = rests.iter().map(|rest| rest.images).sum();
        out::line(format_args!("{} rests in contact, {images} images", rests.len()))?;
        out::text(table(&found) + &task_text(&found, &task, frame.as_ref()))?;
    }
    Ok(if frame.is_some() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The task in the form of a law's configuration, and the condition number of its Jacobian.
fn task_frame(found: &Identification, task: &Task) -> Option<(TaskFrame, f64)> {
    let servoed = |row: &usize| {
        let row = &found.rows[*row];
        ServoedFeature {
            name: FEATURE_TABLE[row.feature].1,
            desired: None,
            jacobian: task.motions.iter().map(|j| row.entries[*j].value).collect(),
            kp_per_s: GAIN_KP_PER_S,
            ki_per_s2: GAIN_KI_PER_S2,
        }
    };
    let frame = TaskFrame {
        state: task.motions.iter().map(|j| MOTION_TABLE[found.motions[*j].0].1).collect(),
        feature: task.features.iter().map(servoed).collect(),
        ..TaskFrame::default()
    };
    let condition = frame.check(&Array::default()).and_then(|()| frame.inverse()).ok()?.1;
    (!task.motions.is_empty()).then_some((frame, condition))
}

/// A number with four digits, and with an exponent only where one is needed.
fn four_digits(value: f64) -> String {
    let size = value.abs();
    if size >= 1000.0 || size == 0.0 {
        format!("{value:.0}")
    } else if size >= 1e-3 {
        let places = (3.0 - libm::floor(libm::log10(size))).clamp(0.0, 6.0) as usize;
        format!("{value:.places$}")
    } else {
        format!("{value:.1e}")
    }
}

/// The Jacobian and its uncertainties as a table.
fn table(found: &Identification) -> String {
    let mut text = String::from("test motions, rms:");
    for (motion, size) in &found.motions {
        let (name, _, unit) = MOTION_TABLE[*motion];
        let _ = write!(text, " {name} {} {unit},", four_digits(*size));
    }
    let _ = writeln!(text, " condition number {}", four_digits(found.test_condition));
    text += "\nchange of a feature with each motion, +- two standard deviations\n";
    let _ = write!(text, "{:<24}", "");
    for (motion, _) in &found.motions {
        let (name, _, unit) = MOTION_TABLE[*motion];
        let _ = write!(text, "{:>22}", format!("{name}, per {unit}"));
    }
    text += "   noise of an image   line leaves\n";
    for row in &found.rows {
        let (name, _, unit) = FEATURE_TABLE[row.feature];
        let _ = write!(text, "{:<24}", format!("{name} ({unit})"));
        for entry in &row.entries {
            let cell = format!("{} +- {}", four_digits(entry.value), four_digits(entry.error));
            let _ = write!(text, "{cell:>22}");
        }
        let _ = writeln!(text, "{:>20}{:>14}", four_digits(row.noise), four_digits(row.residual));
    }
    for (index, (name, ..)) in FEATURE_TABLE.iter().enumerate() {
        if !found.rows.iter().any(|row| row.feature == index) {
            let _ = writeln!(text, "{name}: not defined at every rest");
        }
    }
    let singular_values: Vec<String> =
        found.singular_values.iter().map(|signal| four_digits(*signal)).collect();
    let _ = writeln!(
        text,
        "\nobservability: singular values {} (standard deviations of this fit; seen from 3 on)",
        singular_values.join(", ")
    );
    text
}

/// Text about what the features distinguish, and the task that follows.
fn task_text(found: &Identification, task: &Task, frame: Option<&(TaskFrame, f64)>) -> String {
    let mut text = String::new();
    let blind: Vec<&str> = (0..found.motions.len())
        .filter(|j| !task.motions.contains(j))
        .map(|j| MOTION_TABLE[found.motions[j].0].0)
        .collect();
    if !blind.is_empty() {
        let _ = writeln!(
            text,
            "not in the task: {}: not asked for, or not told from the others",
            blind.join(", ")
        );
    }
    let Some((_, condition)) = frame else {
        text += "no task: no motion that was asked for is seen\n";
        return text;
    };
    let _ =
        writeln!(text, "condition number {} (rows and columns scaled)", four_digits(*condition));
    if let Some(steps) = found.resolution(task) {
        let told = task.motions.iter().zip(steps).map(|(j, step)| {
            let (name, _, unit) = MOTION_TABLE[found.motions[*j].0];
            format!("{name} to {} {unit}", four_digits(step))
        });
        let told: Vec<String> = told.collect();
        let _ = writeln!(text, "one image tells {} (one standard deviation)", told.join(", "));
    }
    let names: Vec<String> = task
        .motions
        .iter()
        .map(|j| format!("\"{}\"", MOTION_TABLE[found.motions[*j].0].0))
        .collect();
    let _ = writeln!(text, "\n[robot.tactile_servo.task_frame]\nstate = [{}]", names.join(", "));
    for i in &task.features {
        let row = &found.rows[*i];
        let entries: Vec<String> =
            task.motions.iter().map(|j| toml_number(row.entries[*j].value)).collect();
        let _ = writeln!(
            text,
            "\n[[robot.tactile_servo.task_frame.feature]]\nname = \"{}\"\njacobian = [{}]\n\
             kp_per_s = {:.1}\nki_per_s2 = {:.1}",
            FEATURE_TABLE[row.feature].0,
            entries.join(", "),
            GAIN_KP_PER_S,
            GAIN_KI_PER_S2
        );
    }
    text
}

/// A number in TOML.
fn toml_number(value: f64) -> String {
    let text = four_digits(value);
    if text.contains(['.', 'e']) { text } else { text + ".0" }
}

fn as_json(found: &Identification, task: &Task, frame: Option<&(TaskFrame, f64)>) -> Value {
    let motion = |j: &usize| MOTION_TABLE[found.motions[*j].0].0;
    let rows = found.rows.iter().map(|row| {
        let entries = row.entries.iter().enumerate().map(|(j, entry)| {
            json!({ "motion": motion(&j), "value": entry.value, "error": entry.error })
        });
        json!({
            "feature": FEATURE_TABLE[row.feature].0,
            "unit": FEATURE_TABLE[row.feature].2,
            "jacobian": entries.collect::<Vec<_>>(),
            "drift_per_s": row.drift.value,
            "drift_error_per_s": row.drift.error,
            "mean": row.mean,
            "noise": row.noise,
            "residual": row.residual,
        })
    });
    json!({
        "test_motions": found.motions.iter().map(|(j, rms)| {
            json!({ "motion": MOTION_TABLE[*j].0, "unit": MOTION_TABLE[*j].2, "rms": rms })
        }).collect::<Vec<_>>(),
        "test_condition": found.test_condition,
        "features": rows.collect::<Vec<_>>(),
        "singular_values": found.singular_values,
        "state": task.motions.iter().map(motion).collect::<Vec<_>>(),
        "task_features": task.features.iter().map(|i| FEATURE_TABLE[found.rows[*i].feature].0)
            .collect::<Vec<_>>(),
        "condition": frame.map(|(_, condition)| condition),
        "resolution": found.resolution(task),
    })
}
