//! `taktil calibrate tactile`: the rubber's stiffness and the response of each tactel, from the
//! images of a log whose loads are known. A log without the body, the force or the place of the
//! contact is an error.
//!
//! The state at the instant of each image is reconstructed by moving the log's world there. Between
//! two records of the truth the force may change by a newton, and an error of the force would
//! become an error of the exponent.

pub mod equations;
pub mod fit;
pub mod identifiability;
pub mod press;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::json;
use taktil_machine_console::out;
use taktil_sim::scene::Electronics;

use equations::{MODULUS_INDEX, SHARED_COUNT};
use fit::{Estimate, ExtraUnknowns, Fit};
use identifiability::{Identifiability, NAMES};
use press::{Images, LoadedImages, Pad, UNLOADED_IMAGES_MIN};
use taktil_lab_progress::Progress;
use taktil_lab_scene::origin::Origin;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::seek::{recorded_until, seek_telling};
use taktil_machine_console::option::BadOption;
use taktil_record::{Damage, Log};

/// What is calibrated.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Calibrate {
    /// The tactile array: Young's modulus of its rubber, threshold, exponent, gain of each tactel.
    ///
    /// From the log of a scene in which a pin was rolled over the pad: the images as the robot saw
    /// them, force and place of the contact as the simulator knows them. On a board these would
    /// have to come from a load cell and a stage; no task records them. Printed is also which of
    /// these numbers, of thickness and of Poisson's ratio the images tell apart. Exit code 0:
    /// found; 1: the model leaves more than the noise without a load, or too few images without a
    /// load say what that is; 2: a log that cannot be used, or that does not tell.
    Tactile {
        /// Log file (MCAP) of a scene
        log: PathBuf,
        /// Seek these as well instead of taking them from the scene
        #[arg(long, value_delimiter = ',')]
        also: Vec<SoughtParameter>,
        /// One JSON object with every gain instead of the table
        #[arg(long)]
        json: bool,
    },
}

/// What may be sought beside modulus, threshold, exponent and gains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SoughtParameter {
    /// The layer's thickness
    Thickness,
    /// Poisson's ratio
    Poisson,
}

/// Fits and prints the result.
///
/// # Errors
/// [`BadOption`] for logs that cannot be used.
pub fn run(what: &Calibrate) -> anyhow::Result<ExitCode> {
    let Calibrate::Tactile { log, also, json } = what;
    let bad = |why: String| BadOption(format!("{}: {why}", log.display()));
    let recording = read(log).map_err(bad)?;
    let Recording { pad, pressed, .. } = &recording;
    let also = ExtraUnknowns {
        thickness: also.contains(&SoughtParameter::Thickness),
        poisson: also.contains(&SoughtParameter::Poisson),
    };
    let mut progress = Progress::without_total("steps of the search");
    let fit = fit::fit(&pressed.presses, pad, also, &mut || progress.advance()).map_err(bad)?;
    drop(progress);
    if *json {
        out::line(as_json(&fit, &recording))?;
    } else {
        out::line(table(&fit, &recording).trim_end())?;
    }
    let found = is_explained(&fit, pressed) == Some(true);
    Ok(if found { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// What is read from a log.
#[derive(Debug)]
pub struct Recording {
    /// The scene that ran.
    pub scene: Scene,
    /// What is known of the pad of the scene.
    pub pad: Pad,
    /// Every image with its load.
    pub pressed: LoadedImages,
    /// Number of images without a known load, because they are later than the last truth.
    pub beyond: usize,
    /// Where the log ends or is damaged; `None` for a complete one.
    pub damage: Option<Damage>,
}

/// The scene of a log, what is known of its pad, and every image with its load. Of a log that was
/// cut or damaged, the part before the damage is used.
///
/// # Errors
/// What is missing from the log.
pub fn read(path: &Path) -> Result<Recording, String> {
    let log = Log::open(path).map_err(|error| format!("{error:#}"))?;
    let damage = log.damage().cloned();
    read_recording(&log).map_err(|why| match &damage {
        // The missing data may be in the part that cannot be read.
        Some(damage) => format!("{why}; the log is {damage}"),
        None => why,
    })
}

fn read_recording(log: &Log) -> Result<Recording, String> {
    let damage = log.damage().cloned();
    let (scene, _) = Origin::of(log)?.into_scene()?;
    let scan = scene.machine.tactile_scan.clone().unwrap_or_default();
    let pad = Pad::of(&scene.world, scan.baseline_frames)?;
    if scan.response.is_some() {
        return Err("its readings were made linear by a calibration before \
                    (robot.tactile_scan.response); record without it"
            .to_owned());
    }
    let images = log.series("tactile_scan.image").ok_or(
        "it has no `tactile_scan.image`; record with the array (tactile.present) and its scan",
    )?;
    let mut images = Images::of(&images, &pad.array)?;
    // A record may end between an image and the truth of its instant.
    let beyond = images.end_at(recorded_until(log)?);
    let mut progress = None;
    let outcome = seek_telling(log, &images.at_s, &mut |_reached, total| {
        progress.get_or_insert_with(|| Progress::new("states", total)).advance();
    })?;
    drop(progress);
    if let Some(at) = outcome.first_difference {
        return Err(format!(
            "its world cannot be met again from {} s on: another build wrote it, or it is damaged",
            at.as_secs_f64()
        ));
    }
    let truths: Vec<_> = outcome.found.iter().map(|found| found.truth).collect();
    Ok(Recording { scene, pad, pressed: images.with_truths(&truths)?, beyond, damage })
}

/// Ratio of the residual to the noise above which the model does not explain the images.
const RESIDUAL_RATIO_MAX: f64 = 1.02;

/// Whether the residual is no larger than the noise; `None` where too few images without a load
/// determine the noise.
#[must_use]
pub fn is_explained(fit: &Fit, pressed: &LoadedImages) -> Option<bool> {
    pressed.rest_noise_counts.map(|rest| fit.noise_counts <= RESIDUAL_RATIO_MAX * rest.max(0.5))
}

/// What of the log was not used, and why.
fn omissions_text(recording: &Recording) -> String {
    let mut text = String::new();
    if let Some(damage) = &recording.damage {
        text += &format!("  the log is {damage}\n");
    }
    if recording.beyond > 0 {
        text += &format!(
            "  {} images after the last `world.truth` left out: their loads are not known\n",
            recording.beyond
        );
    }
    text
}

fn estimate_line(name: &str, unit: &str, estimate: Option<&Estimate>, says: f64) -> String {
    match estimate {
        Some(Estimate { value, deviation }) => format!(
            "  {name:<26} {value:>9.4} +- {deviation:.4} {unit:<6} the scene says {says:.4}\n"
        ),
        None => format!("  {name:<26} {says:>9.4}           {unit:<6} as the scene says\n"),
    }
}

/// The fit as text for people.
#[must_use]
pub fn table(fit: &Fit, recording: &Recording) -> String {
    let Recording { scene, pressed, .. } = recording;
    let tactile = &scene.world.tactile;
    let mut text = format!("{} images, {} readings", fit.images, fit.readings);
    text += &match fit.clipped {
        0 => "\n".to_owned(),
        n => format!("; {n} near the converter's end left out\n"),
    };
    text += &omissions_text(recording);
    let rubber = &scene.world.finger.rubber;
    text += &estimate_line("Young's modulus", "MPa", Some(&fit.youngs_mpa), rubber.youngs_mpa);
    // An ideal array has neither threshold nor exponent.
    let responds = tactile.electronics >= Electronics::Response;
    let (threshold_n, exponent) =
        if responds { (tactile.threshold_n, tactile.exponent) } else { (0.0, 1.0) };
    text += &estimate_line("threshold", "N", Some(&fit.threshold_n), threshold_n);
    text += &estimate_line("exponent", "", Some(&fit.exponent), exponent);
    text += &estimate_line("thickness", "mm", fit.thickness_mm.as_ref(), rubber.thickness_mm);
    text += &estimate_line("Poisson's ratio", "", fit.poisson.as_ref(), rubber.poisson);
    let known: Vec<&Estimate> = fit.gains.iter().flatten().collect();
    text += &estimate_line("scale of all gains", "", Some(&fit.scale), 1.0);
    let doubt = known.iter().map(|gain| gain.deviation).fold(0.0, f64::max);
    text += &format!("  {:<26} {:>9.4}", "spread of the gains", fit.gain_spread);
    text += &match fit.gains.len() - known.len() {
        _ if known.is_empty() => "           no tactel's own is told\n".to_owned(),
        0 => format!("           each known to {doubt:.4} or better\n"),
        n => format!("           each known to {doubt:.4} or better, {n} pressed too little\n"),
    };
    text += &format!("  {:<26} {:>9.2} counts", "what is left of a reading", fit.noise_counts);
    text += &match pressed.rest_noise_counts {
        Some(rest) => format!(", {rest:.2} without a load\n"),
        None => "\n".to_owned(),
    };
    if is_explained(fit, pressed).is_none() {
        text += &format!(
            "  whether the model explains the images is not told: {} of them without a load, \
             {UNLOADED_IMAGES_MIN} are\n  needed to know the noise; the uncertainties may not \
             cover what is left\n",
            pressed.rest_images
        );
    }
    if is_explained(fit, pressed) == Some(false) {
        text += "  more than the noise is left: hysteresis, creep, crosstalk, broken tactels or \
                 another\n  contact; the uncertainties do not cover them\n";
    }
    text + &identifiability_text(&fit.identifiability)
}

/// Text about which parameters the images determine.
fn identifiability_text(identifiability: &Identifiability) -> String {
    let mut text = String::from("what these images tell apart, one standard deviation\n");
    let row = |name: &str, deviations: Option<&[f64; SHARED_COUNT]>| {
        let mut row = format!("  {name:<24}");
        for c in 0..SHARED_COUNT {
            let word = match deviations.map(|deviations| deviations[c]) {
                None => "-".to_owned(),
                Some(0.0) => "given".to_owned(),
                Some(deviation) => Identifiability::deviation_text(c, deviation),
            };
            row += &format!(" {word:>15}");
        }
        row + "\n"
    };
    text += &format!("  {:<24}", "");
    for (name, _) in NAMES {
        text += &format!(" {name:>15}");
    }
    text += "\n";
    text += &row("as sought here", Some(&identifiability.given));
    text += &row("thickness sought too", identifiability.with_thickness.as_ref());
    text += &row("all of them sought", identifiability.all.as_ref());
    if let Some(correlation) = &identifiability.correlation {
        let pairs: Vec<String> = (1..SHARED_COUNT)
            .map(|c| format!("{} {:.3}", NAMES[c].0, correlation[MODULUS_INDEX][c]))
            .collect();
        text += &format!("  then the modulus goes with {}\n", pairs.join(", "));
    }
    for (c, d, r) in identifiability.correlated_pairs() {
        text += &format!("  told only together: {} and {} ({r:.3})\n", NAMES[c].0, NAMES[d].0);
    }
    let unidentifiable = identifiability.unidentifiable();
    if !unidentifiable.is_empty() {
        text += &format!("  not told without the scene: {}\n", unidentifiable.join(", "));
    }
    let [thicker, denser] = identifiability.shift_percent;
    if let Some(percent) = thicker {
        text += &format!(
            "  a thickness given 1 % too large moves the modulus by {percent:+.2} %: seen is \
             E / t^{percent:.2}\n"
        );
    }
    if let Some(percent) = denser {
        text += &format!("  a Poisson's ratio given 0.01 too large moves it by {percent:+.2} %\n");
    }
    text
}

/// The fit as one JSON object.
#[must_use]
pub fn as_json(fit: &Fit, recording: &Recording) -> serde_json::Value {
    let pressed = &recording.pressed;
    let one = |estimate: &Estimate| json!([estimate.value, estimate.deviation]);
    json!({
        "images": fit.images,
        "readings": fit.readings,
        "clipped": fit.clipped,
        "youngs_mpa": one(&fit.youngs_mpa),
        "threshold_n": one(&fit.threshold_n),
        "exponent": one(&fit.exponent),
        "thickness_mm": fit.thickness_mm.as_ref().map(one),
        "poisson": fit.poisson.as_ref().map(one),
        "scale": one(&fit.scale),
        "gain_spread": fit.gain_spread,
        "noise_counts": fit.noise_counts,
        "rest_noise_counts": pressed.rest_noise_counts,
        "rest_images": pressed.rest_images,
        "images_beyond_truth": recording.beyond,
        "damage": recording.damage.as_ref().map(ToString::to_string),
        "explained": is_explained(fit, pressed),
        "identifiability": {
            "order": NAMES.map(|(name, _)| name),
            "as_sought": fit.identifiability.given,
            "with_thickness": fit.identifiability.with_thickness,
            "all": fit.identifiability.all,
            "correlation": fit.identifiability.correlation,
            "modulus_shift_percent": fit.identifiability.shift_percent,
        },
        "gains": fit.gains.iter().map(|gain| gain.as_ref().map(one)).collect::<Vec<_>>(),
    })
}
