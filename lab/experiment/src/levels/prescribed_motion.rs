//! Runs one scene at one fidelity level while the arm follows its trajectory of the finest level.
//! The motions are the same to the last bit, so that only contact and step differ. No controller
//! runs, because control loops get out of phase with each other long before their physics differ.

use anyhow::Context;
use taktil_hal::{Nanos, TACTILE, TactileFrame};
use taktil_mechanics::tactile::{Image, features, moments};
use taktil_sim::fidelity::ArmModel;

use super::compare::{DifferenceSums, Differences, Trajectory, distance};
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::score::Targets;
use taktil_lab_scene::targets;

/// The compared quantities: features of the image, and the simulator's force and pin. M0 and the
/// force are in percent of their set points.
pub const MEASURES: [&str; 8] = [
    "M0, %",
    "x_c, mm",
    "y_c, mm",
    "theta_z, deg",
    "force, %",
    "pin x, um",
    "pin z, um",
    "yaw, deg",
];
/// Time between two images.
const SCAN_PERIOD: Nanos = Nanos::from_millis(5);

/// The values of [`MEASURES`] at one image.
pub type Values = [f64; MEASURES.len()];

/// The scene with its arm on a prescribed trajectory.
#[must_use]
pub fn with_prescribed_motion(scene: &Scene, course: &Trajectory) -> Scene {
    let mut scene = scene.clone();
    let degrees = |row: &super::compare::TrajectoryRow| {
        let [a, b, c, d, e, f] = row.q_rad.map(f64::to_degrees);
        [row.at.as_secs_f64(), a, b, c, d, e, f]
    };
    let arm = &mut scene.world.arm;
    arm.trajectory_deg = course.rows.iter().map(degrees).collect();
    arm.zero_error_deg = [0.0; 6];
    scene.world.fidelity.arm = ArmModel::Kinematic;
    scene
}

/// Runs the world of such a scene and returns the values at each image.
///
/// # Errors
/// A level that the scene does not support.
pub fn image_values(scene: &Scene, until: Nanos, seed: u64) -> anyhow::Result<Vec<Values>> {
    let (mut world, mut devices) = Assembly::new(scene).with_seed(seed).build_world()?;
    let rest = scene.world.tactile.rest_counts;
    let Targets { m0, counts_per_n, pitch_x_mm, pitch_y_mm, .. } = targets(scene);
    let (mut all, mut at) = (Vec::new(), Nanos::ZERO);
    let mut frame = TactileFrame::of(devices.require_tactile(TACTILE)?);
    while at + SCAN_PERIOD <= until {
        at += SCAN_PERIOD;
        world.advance(at);
        devices.require_tactile(TACTILE)?.sample(at, &mut frame)?;
        let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - rest) as f32).collect();
        let (rows, cols) = (usize::from(frame.rows()), usize::from(frame.cols()));
        let image = Image::new(rows, cols, &values, None).context("an image of the array")?;
        let moments = moments(&image, 0.0);
        let found = features(&moments);
        // Below a hundredth of the set point the features are not meaningful.
        let there = moments.m0 > 0.01 * m0;
        let known = |value: Option<f64>| value.filter(|_| there).unwrap_or(f64::NAN);
        let truth = world.truth();
        all.push([
            100.0 * moments.m0 / m0,
            pitch_x_mm * known(found.x_c),
            pitch_y_mm * known(found.y_c),
            known(found.theta_z_rad).to_degrees(),
            100.0 * truth.finger_normal_n * counts_per_n / m0,
            1e6 * truth.pin.x,
            1e6 * truth.pin.z,
            truth.pin_yaw_rad.to_degrees(),
        ]);
    }
    Ok(all)
}

/// Differences of one run from the finest one, from an instant on.
#[must_use]
pub fn differences_to_finest(
    ours: &[Values],
    finest: &[Values],
    from: Nanos,
) -> Differences<{ MEASURES.len() }> {
    let skipped = usize::try_from(from.0 / SCAN_PERIOD.0).unwrap_or(0);
    let mut sums = DifferenceSums::default();
    for (a, b) in ours.iter().zip(finest).skip(skipped) {
        sums.add(core::array::from_fn(|i| distance(a[i], b[i])));
    }
    sums.differences()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_before_the_comparison_do_not_count() {
        let exact = [[0.0; 8]; 3];
        let mut ours = exact;
        ours[0] = [1e9; 8];
        (ours[1][0], ours[2][0], ours[2][5]) = (4.0, 3.0, f64::NAN);
        let apart = differences_to_finest(&ours, &exact, SCAN_PERIOD);
        assert_eq!((apart.most[0], apart.rms[0]), (4.0, 12.5_f64.sqrt()));
        assert_eq!((apart.most[5], apart.most[6]), (f64::INFINITY, 0.0));
    }
}
