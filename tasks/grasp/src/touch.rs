//! What a finger feels: load and middle of a tactile image, and the force of its contact out of the
//! load and the torques of its motors.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix3, Vector3};
use taktil_mechanics::hand::Fingertip;
use taktil_mechanics::spatial::{to_glam_vector, to_nalgebra_vector};
use taktil_rtcore::{Fold, StateHash};
use taktil_signal::TactileImage;

/// How an image is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchScale {
    /// Counts that one newton makes.
    pub counts_per_n: f64,
    /// Distance of neighbouring columns (m).
    pub pitch_x_m: f64,
    /// Distance of neighbouring rows (m).
    pub pitch_y_m: f64,
    /// Counts below which a tactel counts as unloaded, in standard deviations of its noise.
    pub threshold_sigmas: f64,
}

/// The load in one image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Touch {
    /// Normal force (N): the sum over the loaded tactels and their neighbours, those below the
    /// threshold included, so that noise has no bias; 0 while nothing is felt.
    pub load_n: f64,
    /// Middle of the load from the middle of the pad, along the sensor's x and y (m); zero while
    /// nothing is above the threshold.
    pub middle_m: DVec2,
    /// Whether at least two tactels are above the threshold.
    pub felt: bool,
}

impl Fold for Touch {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.load_n).add(&self.middle_m.x).add(&self.middle_m.y).add(&self.felt);
    }
}

/// Tactels above the threshold without which nothing is felt: one alone may be noise.
const LOADED_TACTELS_MIN: usize = 2;
/// Rows and columns around the loaded tactels whose counts belong to the load: those below the
/// threshold carry some of it, and those farther away only noise.
const MARGIN_TACTELS: usize = 2;

/// Reads an image: two passes over the tactels, no allocation. Before the baseline is known nothing
/// is felt.
#[must_use]
pub fn touch(image: &TactileImage, scale: &TouchScale) -> Touch {
    let (rows, cols) = (usize::from(image.rows), usize::from(image.cols));
    if image.baseline_ready == 0 || cols == 0 {
        return Touch::default();
    }
    let threshold = scale.threshold_sigmas * f64::from(image.noise_counts);
    let lines = || image.counts.chunks_exact(cols).zip(image.valid.chunks_exact(cols)).take(rows);
    let (mut loaded, mut above, mut x, mut y) = (0, 0.0, 0.0, 0.0);
    let (mut first, mut last) = ([rows, cols], [0, 0]);
    for (row, (counts, valid)) in lines().enumerate() {
        let v = row as f64 - 0.5 * (rows as f64 - 1.0);
        for (col, (count, valid)) in counts.iter().zip(valid).enumerate() {
            let count = f64::from(*count);
            if *valid == 0 || !(count.is_finite() && count > threshold) {
                continue;
            }
            let u = col as f64 - 0.5 * (cols as f64 - 1.0);
            loaded += 1;
            above += count;
            x += u * count;
            y += v * count;
            first = [first[0].min(row), first[1].min(col)];
            last = [last[0].max(row), last[1].max(col)];
        }
    }
    if loaded < LOADED_TACTELS_MIN || above <= 0.0 {
        return Touch::default();
    }
    let near = |i: usize, first: usize, last: usize| {
        i + MARGIN_TACTELS >= first && i <= last + MARGIN_TACTELS
    };
    let mut sum = 0.0;
    for (row, (counts, valid)) in lines().enumerate() {
        if !near(row, first[0], last[0]) {
            continue;
        }
        for (col, (count, valid)) in counts.iter().zip(valid).enumerate() {
            if *valid != 0 && count.is_finite() && near(col, first[1], last[1]) {
                sum += f64::from(*count);
            }
        }
    }
    Touch {
        load_n: sum / scale.counts_per_n,
        middle_m: DVec2::new(scale.pitch_x_m * x, scale.pitch_y_m * y) / above,
        felt: true,
    }
}

/// The force of a finger on the object, from its palm's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactForce {
    /// Normal force by touch (N).
    pub normal_n: f64,
    /// Tangential force by the motors (N), palm frame.
    pub tangential: DVec3,
}

impl ContactForce {
    /// The distance from the edge of the friction cone (N): what the contact bears at this load
    /// less what it carries. Negative beyond the cone.
    #[must_use]
    pub fn margin_n(&self, friction: f64) -> f64 {
        friction * self.normal_n - self.tangential.length()
    }
}

/// The force at the contact whose motors give `torque_nm` beside gravity: `tau = J^T f` with the
/// Jacobian of the point of contact, of which the part along the face's normal is replaced by what
/// the array feels. `None` where the finger is stretched, so that its motors do not tell the force.
#[must_use]
pub fn contact_force(
    tip: &Fingertip,
    touch: &Touch,
    torque_nm: &Vector3<f64>,
) -> Option<ContactForce> {
    let lever = tip.pose.rotation * touch.middle_m.extend(0.0);
    let jacobian = tip.linear_at(lever);
    let normal = tip.pose.rotation.z_axis;
    let force = force_of(&jacobian, torque_nm)?;
    let tangential = force - normal * force.dot(normal);
    tangential.is_finite().then_some(ContactForce { normal_n: touch.load_n, tangential })
}

/// Solves `J^T f = tau`.
fn force_of(jacobian: &Matrix3<f64>, torque_nm: &Vector3<f64>) -> Option<DVec3> {
    let inverse = jacobian.transpose().try_inverse()?;
    Some(to_glam_vector(&(inverse * torque_nm)))
}

/// Joint motion that moves a finger's tip by `step` (m, palm frame), damped where the finger is
/// nearly stretched: `J^T (J J^T + lambda^2)^-1 step`.
#[must_use]
pub fn joint_step(tip: &Fingertip, step: DVec3) -> Vector3<f64> {
    /// Damping relative to the size of the Jacobian: a direction in which the tip moves a fiftieth
    /// of the others is left alone.
    const DAMPING_SHARE: f64 = 0.02;
    let jacobian = tip.linear;
    let lambda = DAMPING_SHARE * jacobian.norm();
    let gram = jacobian * jacobian.transpose() + Matrix3::identity() * (lambda * lambda);
    match gram.try_inverse() {
        Some(inverse) => jacobian.transpose() * (inverse * to_nalgebra_vector(step)),
        None => Vector3::zeros(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use taktil_mechanics::Pose;

    const SCALE: TouchScale = TouchScale {
        counts_per_n: 1000.0,
        pitch_x_m: 2e-3,
        pitch_y_m: 1e-3,
        threshold_sigmas: 3.0,
    };

    fn image() -> TactileImage {
        let mut image = TactileImage::new(4, 6);
        image.valid.fill(1);
        (image.baseline_ready, image.noise_counts) = (1, 2.0);
        image
    }

    #[test]
    fn load_and_middle_are_those_of_the_tactels() {
        let mut image = image();
        image.counts[2 * 6 + 5] = 600.0;
        image.counts[2 * 6 + 3] = 200.0;
        let felt = touch(&image, &SCALE);
        assert!((felt.load_n - 0.8).abs() < 1e-12);
        assert!(
            (felt.middle_m - DVec2::new(2e-3 * (2.5 * 0.75 + 0.5 * 0.25), 0.5e-3)).length() < 1e-12
        );
        image.counts[2 * 6 + 2] = 100.0;
        image.valid[2 * 6 + 5] = 0;
        assert!((touch(&image, &SCALE).load_n - 0.3).abs() < 1e-12);
    }

    #[test]
    fn noise_numbers_that_are_none_and_an_unknown_baseline_are_not_felt() {
        let mut image = image();
        image.counts.fill(4.0);
        assert!(!touch(&image, &SCALE).felt);
        image.counts[0] = f32::NAN;
        assert!(touch(&image, &SCALE).load_n.is_finite());
        image.counts[1] = 1e6;
        assert!(!touch(&image, &SCALE).felt);
        image.counts[2] = 1e6;
        assert!(touch(&image, &SCALE).felt);
        image.baseline_ready = 0;
        assert_eq!(touch(&image, &SCALE), Touch::default());
        assert_eq!(touch(&TactileImage::new(0, 0), &SCALE), Touch::default());
    }

    fn tip() -> Fingertip {
        Fingertip {
            pose: Pose::new(DMat3::from_rotation_x(0.3), DVec3::new(0.01, 0.02, -0.1)),
            linear: Matrix3::new(0.1, 0.01, 0.0, -0.02, 0.08, 0.03, 0.0, 0.02, 0.05),
            angular: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0),
        }
    }

    #[test]
    fn torques_that_balance_a_force_give_its_tangential_part() {
        let tip = tip();
        let felt = Touch { load_n: 2.0, middle_m: DVec2::new(3e-3, -2e-3), felt: true };
        let lever = tip.pose.rotation * felt.middle_m.extend(0.0);
        let (normal, across) = (tip.pose.rotation.z_axis, tip.pose.rotation.x_axis);
        let force = 2.3 * normal + 0.7 * across;
        let torque = tip.linear_at(lever).transpose() * to_nalgebra_vector(force);
        let found = contact_force(&tip, &felt, &torque).unwrap();
        assert!((found.tangential - 0.7 * across).length() < 1e-12);
        assert!((found.margin_n(0.5) - (0.5 * 2.0 - 0.7)).abs() < 1e-12);
        assert!(found.margin_n(0.3) < 0.0);
    }

    #[test]
    fn a_stretched_finger_tells_no_force_and_does_not_run_away() {
        let flat = Fingertip { linear: Matrix3::zeros(), angular: Matrix3::zeros(), ..tip() };
        assert_eq!(contact_force(&flat, &Touch::default(), &Vector3::zeros()), None);
        assert_eq!(joint_step(&flat, DVec3::X), Vector3::zeros());
    }

    #[test]
    fn a_joint_step_moves_the_tip_as_it_is_asked_to() {
        let step = DVec3::new(1e-3, -2e-3, 5e-4);
        let moved = to_glam_vector(&(tip().linear * joint_step(&tip(), step)));
        assert!((moved - step).length() < 0.05 * step.length(), "{moved}");
    }
}
