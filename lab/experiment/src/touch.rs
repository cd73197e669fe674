//! `taktil bench touch`: the time of a touch law from an image to the change of the set point:
//! features, line, law and joint step. The median and the slowest slice are printed, because a mean
//! over slices of a shared machine is dominated by noise.

use std::process::ExitCode;

use taktil_lab_progress::Progress;
use taktil_machine_console::out;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::linux;
use taktil_signal::TactileImage;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::joint_integrator::joint_step;
use taktil_tasks_tactile_servo::law::model::jacobian::ContactModel;
use taktil_tasks_tactile_servo::law::model::{self, ModelState};
use taktil_tasks_tactile_servo::law::{Observation, projector_pid, thesis, tool_motion};
use taktil_tasks_tactile_servo::perception::line::{LineFinder, LineParameters};
use taktil_tasks_tactile_servo::perception::touch_features;

use taktil_machine_console::option::BadOption;

/// The options of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Images of one slice
    #[arg(long, value_name = "N", default_value_t = 2_000)]
    images: u32,
    /// Slices of each law, in turns
    #[arg(long, value_name = "N", default_value_t = 21)]
    slices: u32,
}

/// Seconds between two jobs.
const DT_S: f64 = 0.0025;
/// Number of images that are used in turn.
const IMAGE_COUNT: usize = 16;

/// Images of a line load of 15000 counts that moves over the columns, with noise of about 50
/// counts.
fn line_images() -> Vec<TactileImage> {
    let mut word = 1_u64;
    let mut noise = || {
        let sum: f64 = (0..12)
            .map(|_| {
                word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (word >> 40) as f64 / f64::from(1 << 24)
            })
            .sum();
        50.0 * (sum - 6.0)
    };
    (0..IMAGE_COUNT)
        .map(|k| {
            let mut image = TactileImage {
                valid: vec![1; 256].into(),
                baseline_ready: 1,
                noise_counts: 50.0,
                ..TactileImage::new(16, 16)
            };
            let middle = 6.0 + 0.3 * k as f64;
            for (index, counts) in image.counts.iter_mut().enumerate() {
                let off = (index % 16) as f64 + 1.0 - middle;
                *counts = ((450.0 * (1.0 - 0.3 * off * off)).max(0.0) + noise()) as f32;
            }
            image
        })
        .collect()
}

/// A law with its state: takes an image and returns the size of the joint step.
type Law = Box<dyn FnMut(&TactileImage) -> f64>;

fn joints() -> Joints {
    Joints::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians))
}

fn joint_step_norm(arm: &Puma260, step: &[f64; 4]) -> f64 {
    joint_step(arm, &joints(), &tool_motion(step), &Joints::zeros(), 0.05)
        .map_or(0.0, |step| step.norm())
}

fn timed_laws() -> anyhow::Result<Vec<(&'static str, Law)>> {
    let config = Config::default();
    let arm = Puma260::reference();
    let (plain, pid, ours) = (config.clone(), config.clone(), config);
    let law = thesis::ThesisLaw::new(&plain);
    let by_thesis: Law = Box::new(move |image| {
        let seen = touch_features(
            image,
            &plain.array,
            plain.threshold(image.noise_counts),
            plain.contact_counts,
        );
        joint_step_norm(&arm, &law.displacement(&seen, 2.0))
    });
    let (arm, mut memory) = (Puma260::reference(), projector_pid::PidState::default());
    let by_pid: Law = Box::new(move |image| {
        let seen = touch_features(
            image,
            &pid.array,
            pid.threshold(image.noise_counts),
            pid.contact_counts,
        );
        let (step, next) = projector_pid::displacement(&pid, &memory, &seen, 2.0, 2.0 * DT_S);
        memory = next;
        joint_step_norm(&arm, &step)
    });
    let contact = ContactModel::new(&ours.model, &ours.array, ours.m0_counts)
        .map_err(|bad| anyhow::anyhow!("{}: {}", bad.place, bad.what))?;
    let (arm, mut memory) = (Puma260::reference(), ModelState::new(&ours.model));
    let mut finder = LineFinder::new(&ours.array);
    let by_model: Law = Box::new(move |image| {
        let seen = touch_features(
            image,
            &ours.array,
            ours.threshold(image.noise_counts),
            ours.contact_counts,
        );
        let known = LineParameters {
            profile: contact.profile(),
            noise_counts: f64::from(image.noise_counts),
            speed_cols_s: memory.line_speed_cols_s(&ours.array),
        };
        let found = finder.line(image, &seen, &known);
        let found = found.map(|line| line.scaled(contact.band_correction()));
        let image = Observation::new(&seen, found.as_ref(), DT_S, DT_S);
        memory = model::observe(&ours, &contact, &memory, &image);
        let step = model::job_displacement(&ours, &memory, 2.0, DT_S);
        memory = model::state_after_job(&ours.model, &memory, &step, DT_S);
        joint_step_norm(&arm, &step)
    });
    Ok(vec![("thesis", by_thesis), ("projector-pid", by_pid), ("model", by_model)])
}

/// Measures and prints the result.
///
/// # Errors
/// [`BadOption`] for numbers outside their ranges.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    if !(1..=10_000_000).contains(&plan.images) || !(1..=10_000).contains(&plan.slices) {
        let text = "--images: give 1 to 10000000; --slices: give 1 to 10000".to_owned();
        return Err(BadOption(text).into());
    }
    let (images, mut laws) = (line_images(), timed_laws()?);
    let mut times_us = vec![Vec::new(); laws.len()];
    let mut moved = 0.0;
    let mut progress = Progress::new("slices", plan.slices as usize);
    for _ in 0..plan.slices {
        for ((_, law), times) in laws.iter_mut().zip(&mut times_us) {
            let from = linux::monotonic();
            for k in 0..plan.images as usize {
                moved += law(&images[k % IMAGE_COUNT]);
            }
            let took = linux::monotonic() - from;
            times.push(took.as_secs_f64() * 1e6 / f64::from(plan.images));
        }
        progress.advance();
    }
    drop(progress);
    anyhow::ensure!(moved.is_finite() && moved > 0.0, "the laws did not move");
    out::line(
        "| law | image to joint step, us: median of slices | slowest slice |\n|---|---|---|",
    )?;
    for ((name, _), times) in laws.iter().zip(&mut times_us) {
        times.sort_by(f64::total_cmp);
        let (median, slowest) = (times[times.len() / 2], times[times.len() - 1]);
        out::line(format_args!("| {name} | {median:.2} | {slowest:.2} |"))?;
    }
    Ok(ExitCode::SUCCESS)
}
