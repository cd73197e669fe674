//! The contact of one fingertip's face with the object: pressure tactel by tactel from the
//! foundation, and friction as that of one soft fingertip.
//!
//! Friction is carried by three bristle forces at the middle of the load: two tangential ones and a
//! moment about the normal. They grow with the relative motion at the rubber's stiffness and yield
//! on an ellipsoid: `(f / mu N)^2 + (m / mu N r)^2 = 1`, where `r` is the mean distance of the load
//! from its middle (Howe and Cutkosky, International Journal of Robotics Research 15, 1996).
//! Forces, not deflections, are kept, so that a growing contact does not load what comes to touch.
//!
//! Wrenches and twists stand at the pad's middle in the pad's axes, `[linear; angular]`; those on
//! the object are positive.

use glam::DVec2;
use nalgebra::{Matrix3, Matrix3x6, Vector3};
use taktil_mechanics::spatial::spatial_vector;
use taktil_mechanics::{Joints, Matrix6, Pose};

use super::foundation::Foundation;
use super::object::Solid;
use crate::geometry::ArrayGeometry;

/// Load below which a contact has no middle and no friction (N).
const LOAD_MIN_N: f64 = 1e-9;
/// Smallest mean distance of the load from its middle (m): the torsional limit of a contact on one
/// tactel.
const LEVER_MIN_M: f64 = 0.2e-3;

/// Bristle forces of a patch: along the pad's x and y (N) and about its normal (N m).
pub(super) type Bristle = Vector3<f64>;

/// How the object lies before a pad and moves against it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relative {
    /// The object's frame in the pad's.
    pub(super) pose: Pose,
    /// Twist of the object less that of the pad, at the pad's middle, pad axes.
    pub(super) twist: Joints,
    /// Length of the step that ends here (s); 0 for an evaluation between steps.
    pub(super) h: f64,
}

/// The contact at the end of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchLoad {
    /// Wrench on the object.
    pub(super) wrench: Joints,
    /// Its derivative per relative twist at the step's end.
    pub(super) derivative: Matrix6,
    /// Bristle forces at the step's end.
    pub(super) bristle: Bristle,
    pub(super) normal_n: f64,
    /// Middle of the load (m), pad axes.
    pub(super) middle: DVec2,
    /// Bristle forces relative to what friction bears: above 1 the contact slides.
    pub(super) effort: f64,
    /// Speed of the object over the pad at the middle of the load while it slides (m/s).
    pub(super) slip_m_s: f64,
    pub(super) deepest_m: f64,
}

impl Default for PatchLoad {
    fn default() -> PatchLoad {
        PatchLoad {
            wrench: Joints::zeros(),
            derivative: Matrix6::zeros(),
            bristle: Bristle::zeros(),
            normal_n: 0.0,
            middle: DVec2::ZERO,
            effort: 0.0,
            slip_m_s: 0.0,
            deepest_m: 0.0,
        }
    }
}

/// What a pad is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pad {
    pub(super) array: ArrayGeometry,
    pub(super) law: Foundation,
    pub(super) friction: f64,
}

/// Sums over the tactels that are pressed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    load: f64,
    load_x: f64,
    load_y: f64,
    load_rr: f64,
    area: f64,
    /// Stiffness, its first moments and its second moments about the pad's middle.
    k: f64,
    kx: f64,
    ky: f64,
    kxx: f64,
    kxy: f64,
    kyy: f64,
    deepest_m: f64,
}

impl Sums {
    /// The wrench of the pressure, and its derivative per relative twist; `weight` is what a speed
    /// at the step's end makes of penetration and damping (s).
    fn pressure(&self, weight: f64) -> (Joints, Matrix6) {
        let mut wrench = Joints::zeros();
        (wrench[2], wrench[3], wrench[4]) = (self.load, self.load_y, -self.load_x);
        let mut derivative = Matrix6::zeros();
        // Rows and columns are those of the normal force and of the two moments in the face.
        let normal = [
            [self.k, self.ky, -self.kx],
            [self.ky, self.kyy, -self.kxy],
            [-self.kx, -self.kxy, self.kxx],
        ];
        for (i, row) in normal.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                derivative[(2 + i, 2 + j)] = weight * value;
            }
        }
        (wrench, derivative)
    }
}

/// Places on a tactel along each axis at which its penetration is taken.
const LOAD_SAMPLES: usize = 2;
/// The same for images: a contact may be narrower than a tactel.
const IMAGE_SAMPLES: usize = 4;
/// Largest sine of the angle between a cylinder's axis and a face along which it counts as lying.
const LYING_SINE_MAX: f64 = 0.3;
/// Smallest half-width over which a sphere's load fades out as it leaves the pad (m).
const FADE_HALF_WIDTH_MIN_M: f64 = 0.25e-3;

/// Indices of the tactels along one axis whose middles lie within a reach of a place.
fn indices(place: f64, reach: f64, pitch: f64, count: usize) -> core::ops::Range<usize> {
    let middle = 0.5 * (count as f64 - 1.0);
    let low = libm::ceil((place - reach) / pitch + middle).max(0.0);
    let high = libm::floor((place + reach) / pitch + middle).min(count as f64 - 1.0);
    // Whoever is not within the array, or not a number, gives an empty range.
    if low.is_nan() || high.is_nan() || low > high {
        return 0..0;
    }
    low as usize..high as usize + 1
}

impl Pad {
    /// Calls `of` with each place on the face at which the solid presses, `SIDE` by `SIDE` a
    /// tactel: the tactel's index, the place, and the penetration there (m).
    #[inline(always)]
    fn for_each_pressed<const SIDE: usize>(
        &self,
        solid: &Solid,
        pose: &Pose,
        mut of: impl FnMut(usize, DVec2, f64),
    ) {
        let (centre, array) = (pose.translation, &self.array);
        let bound = solid.bound_m();
        let square = bound * bound - centre.z * centre.z;
        if square.is_nan() || square <= 0.0 {
            return;
        }
        let half = DVec2::new(0.5 * array.pitch_x_m, 0.5 * array.pitch_y_m);
        let reach = square.sqrt() + half.max_element();
        let rows = indices(centre.y, reach, array.pitch_y_m, array.rows);
        let cols = indices(centre.x, reach, array.pitch_x_m, array.cols);
        let into = pose.rotation.transpose();
        let (along, reach_m) = (into.z_axis, half.length());
        let offset = |i: usize, half: f64| half * ((2 * i + 1) as f64 / SIDE as f64 - 1.0);
        for row in rows {
            for col in cols.clone() {
                let middle = DVec2::new(array.column_m(col), array.row_m(row));
                let origin = into * (middle.extend(0.0) - centre);
                // The solid presses on a place only if it contains that place.
                if solid.is_outside(origin, reach_m) {
                    continue;
                }
                for i in 0..SIDE * SIDE {
                    let (u, v) = (offset(i % SIDE, half.x), offset(i / SIDE, half.y));
                    let chord = solid.chord(origin + u * into.x_axis + v * into.y_axis, along);
                    if chord.enters_m < 0.0 && chord.leaves_m > 0.0 {
                        let tactel = row * array.cols + col;
                        of(tactel, middle + DVec2::new(u, v), -chord.enters_m);
                    }
                }
            }
        }
    }

    /// The sums of a sphere, which presses as a paraboloid, in closed form: on the lattice of the
    /// tactels its load would ripple by several percent.
    fn sphere_sums(&self, radius_m: f64, at: &Relative) -> Sums {
        let centre = at.pose.translation;
        let depth = radius_m - centre.z;
        if !(depth > 0.0 && centre.z > 0.0) {
            return Sums::default();
        }
        let place = centre.truncate();
        let contact = self.law.paraboloid(radius_m, depth);
        let width = contact.edge_m.max(FADE_HALF_WIDTH_MIN_M);
        let half = self.array.half_sides_m();
        let part = |u: f64, half: f64| (0.5 * (half + width - u.abs()) / width).clamp(0.0, 1.0);
        let cover = part(place.x, half.x) * part(place.y, half.y);
        let closing = -(at.twist[2] + at.twist[3] * place.y - at.twist[4] * place.x);
        let k = cover * contact.stiffness_n_m;
        let load = cover * contact.load_n + self.law.relaxation_s * k * closing;
        if load <= 0.0 {
            return Sums { deepest_m: depth, ..Sums::default() };
        }
        let (x, y) = (place.x, place.y);
        let spread = 0.5 * contact.stiffness_radius_m * contact.stiffness_radius_m;
        let far = contact.load_radius_m * contact.load_radius_m;
        Sums {
            load,
            load_x: load * x,
            load_y: load * y,
            load_rr: load * (x * x + y * y + far),
            area: cover * core::f64::consts::PI * contact.edge_m * contact.edge_m,
            k,
            kx: k * x,
            ky: k * y,
            kxx: k * (x * x + spread),
            kxy: k * x * y,
            kyy: k * (y * y + spread),
            deepest_m: depth,
        }
    }

    /// Evaluates the contact at the end of a step from these bristle forces.
    pub(super) fn evaluate(&self, solid: &Solid, at: &Relative, from: &Bristle) -> PatchLoad {
        let sums = self.sums(solid, at);
        if sums.load < LOAD_MIN_N {
            return PatchLoad { deepest_m: sums.deepest_m, ..PatchLoad::default() };
        }
        self.loaded(&sums, at, from)
    }

    /// The sums over the contact, in closed form where there is one.
    fn sums(&self, solid: &Solid, at: &Relative) -> Sums {
        match *solid {
            Solid::Sphere { radius_m } => self.sphere_sums(radius_m, at),
            Solid::Cylinder { radius_m, half_length_m }
                if at.pose.rotation.z_axis.z.abs() < LYING_SINE_MAX =>
            {
                self.line_sums(radius_m, half_length_m, at)
            }
            _ => self.sampled_sums(solid, at),
        }
    }

    /// The sums of a cylinder that lies along the face, strip by strip: each row of tactels across
    /// its axis, or each column, presses as a parabola in closed form.
    fn line_sums(&self, radius_m: f64, half_length_m: f64, at: &Relative) -> Sums {
        let mut sums = Sums::default();
        let (axis, centre, array) = (at.pose.rotation.z_axis, at.pose.translation, &self.array);
        let along_rows = axis.y.abs() >= axis.x.abs();
        let (count, pitch, half) = match along_rows {
            true => (array.rows, array.pitch_y_m, array.half_x_m()),
            false => (array.cols, array.pitch_x_m, array.half_y_m()),
        };
        let flat = libm::hypot(axis.x, axis.y);
        let (along, from) = match along_rows {
            true => (axis.y, centre.y),
            false => (axis.x, centre.x),
        };
        // The section across the strip is an ellipse, as flat as the axis is turned from it.
        let cosine = along.abs() / flat;
        let curvature_m = radius_m / (cosine * cosine) * flat;
        let law = &self.law;
        for strip in 0..count {
            let place = match along_rows {
                true => array.row_m(strip),
                false => array.column_m(strip),
            };
            let t = (place - from) / along;
            let covered = (half_length_m - t.abs()) * along.abs() / pitch + 0.5;
            let foot = centre + t * axis;
            let depth = radius_m / flat - foot.z;
            if !(covered > 0.0 && depth > 0.0 && foot.z > 0.0) {
                continue;
            }
            let contact = law.parabola(curvature_m, depth);
            let across = if along_rows { foot.x } else { foot.y };
            let width = contact.edge_m.max(FADE_HALF_WIDTH_MIN_M);
            let fade = (0.5 * (half + width - across.abs()) / width).clamp(0.0, 1.0);
            let cover = covered.min(1.0) * fade * pitch;
            let middle =
                if along_rows { DVec2::new(across, place) } else { DVec2::new(place, across) };
            let closing = -(at.twist[2] + at.twist[3] * middle.y - at.twist[4] * middle.x);
            let k = cover * contact.stiffness_n_m;
            let load = cover * contact.load_n + law.relaxation_s * k * closing;
            sums.deepest_m = sums.deepest_m.max(depth);
            if load <= 0.0 {
                continue;
            }
            let square = |r: f64| r * r;
            sums.load += load;
            sums.load_x += load * middle.x;
            sums.load_y += load * middle.y;
            sums.load_rr += load * (middle.length_squared() + square(contact.load_radius_m));
            sums.area += 2.0 * cover * contact.edge_m;
            sums.k += k;
            sums.kx += k * middle.x;
            sums.ky += k * middle.y;
            sums.kxx += k * square(middle.x);
            sums.kyy += k * square(middle.y);
            sums.kxy += k * middle.x * middle.y;
            let spread = k * square(contact.stiffness_radius_m);
            match along_rows {
                true => sums.kxx += spread,
                false => sums.kyy += spread,
            }
        }
        sums
    }

    /// The sums of any solid, place by place.
    fn sampled_sums(&self, solid: &Solid, at: &Relative) -> Sums {
        let tactel = self.array.pitch_x_m * self.array.pitch_y_m;
        let area = tactel / (LOAD_SAMPLES * LOAD_SAMPLES) as f64;
        let law = self.law;
        let (v, w) = (at.twist.fixed_rows::<3>(0), at.twist.fixed_rows::<3>(3));
        let mut sums = Sums::default();
        self.for_each_pressed::<LOAD_SAMPLES>(solid, &at.pose, |_, place, depth| {
            let pressure = law.pressure(depth);
            let closing = -(v[2] + w[0] * place.y - w[1] * place.x);
            let k = area * pressure.slope_pa_m;
            let load = area * pressure.pa + law.relaxation_s * k * closing;
            sums.deepest_m = sums.deepest_m.max(depth);
            if load <= 0.0 {
                return;
            }
            sums.load += load;
            sums.load_x += load * place.x;
            sums.load_y += load * place.y;
            sums.load_rr += load * place.length_squared();
            sums.area += area;
            sums.k += k;
            sums.kx += k * place.x;
            sums.ky += k * place.y;
            sums.kxx += k * place.x * place.x;
            sums.kxy += k * place.x * place.y;
            sums.kyy += k * place.y * place.y;
        });
        sums
    }

    /// The contact of a loaded patch.
    fn loaded(&self, sums: &Sums, at: &Relative, from: &Bristle) -> PatchLoad {
        let n = sums.load;
        let middle = DVec2::new(sums.load_x, sums.load_y) / n;
        let weight = -(at.h + self.law.relaxation_s);
        let (mut wrench, mut derivative) = sums.pressure(weight);
        // Friction acts at the middle of the load.
        let mut pick = Matrix3x6::zeros();
        (pick[(0, 0)], pick[(0, 5)]) = (1.0, -middle.y);
        (pick[(1, 1)], pick[(1, 5)]) = (1.0, middle.x);
        pick[(2, 5)] = 1.0;
        let motion = pick * at.twist;
        let spread = (sums.load_rr / n - middle.length_squared()).max(0.0);
        // The mean distance of a load is about 0.94 of its rms distance: exactly for a uniform
        // disc.
        let lever = (0.9428 * spread.sqrt()).max(LEVER_MIN_M);
        let shear = self.law.tangential_n_m(sums.area);
        let stiffness = Vector3::new(shear, shear, shear * spread.max(LEVER_MIN_M * LEVER_MIN_M));
        let grown = from + stiffness.component_mul(&motion) * -at.h;
        let damped = stiffness.component_mul(&motion) * -self.law.relaxation_s;
        let trial = grown + damped;
        let most = self.friction * n;
        let scale = Vector3::new(1.0, 1.0, 1.0 / lever);
        let relative = trial.component_mul(&scale);
        let effort = if most > 0.0 { relative.norm() / most } else { f64::INFINITY };
        let slides = effort > 1.0;
        let share = if slides { 1.0 / effort } else { 1.0 };
        let forces = trial * share;
        // What yields cannot be kept as a spring: the stored part is cut back as the whole is.
        let bristle = if slides { forces } else { grown };
        let mut slope = Matrix3::from_diagonal(&(stiffness * weight)) * share;
        let pressed = derivative;
        if slides {
            // The return to the ellipsoid takes away growth along the force itself, and follows the
            // load.
            let unit = relative / relative.norm();
            let along = unit.component_div(&scale);
            let taken = along * (unit.component_mul(&scale)).transpose() * slope;
            slope -= taken;
            let row = derivative.fixed_rows::<1>(2).into_owned();
            let push = pick.transpose() * (along * self.friction);
            derivative += push * row;
        }
        wrench += pick.transpose() * forces;
        derivative += pick.transpose() * slope * pick;
        // The middle of the load, at which friction acts, moves with the pressure.
        let towards_x = (-pressed.row(4) - pressed.row(2) * middle.x) / n;
        let towards_y = (pressed.row(3) - pressed.row(2) * middle.y) / n;
        let mut turning = derivative.row_mut(5);
        turning += towards_x * forces[1] - towards_y * forces[0];
        let slip = DVec2::new(motion[0], motion[1]).length();
        PatchLoad {
            wrench,
            derivative,
            bristle,
            normal_n: n,
            middle,
            effort,
            slip_m_s: if slides { slip } else { 0.0 },
            deepest_m: sums.deepest_m,
        }
    }

    /// Writes the normal force on each tactel (N); they sum up to the load of the contact.
    pub(super) fn image(&self, solid: &Solid, at: &Relative, forces: &mut [f64]) {
        forces.fill(0.0);
        let (v, w) = (at.twist.fixed_rows::<3>(0), at.twist.fixed_rows::<3>(3));
        let mut of = |tactel: usize, place: DVec2, depth: f64| {
            let pressure = self.law.pressure(depth);
            let closing = -(v[2] + w[0] * place.y - w[1] * place.x);
            let load = pressure.pa + self.law.relaxation_s * pressure.slope_pa_m * closing;
            forces[tactel] += load.max(0.0);
        };
        self.for_each_pressed::<IMAGE_SAMPLES>(solid, &at.pose, &mut of);
        let load_n = self.sums(solid, at).load;
        let sum: f64 = forces.iter().sum();
        let scale = if sum > 0.0 { load_n / sum } else { 0.0 };
        forces.iter_mut().for_each(|force| *force *= scale);
    }
}

impl Relative {
    /// The relative place and motion of an object and a pad, whose twists at their own origins are
    /// given in base axes.
    pub(super) fn of(
        pad: &Pose,
        pad_twist: &Joints,
        object: &super::object::Motion,
        h: f64,
    ) -> Relative {
        let back = pad.rotation.transpose();
        let lever = pad.translation - object.pose.translation;
        let carried = object.velocity + object.spin.cross(lever);
        let (pad_v, pad_w) = taktil_mechanics::spatial::linear_and_angular(pad_twist);
        Relative {
            pose: Pose::new(
                back * object.pose.rotation,
                back * (object.pose.translation - pad.translation),
            ),
            twist: spatial_vector(back * (carried - pad_v), back * (object.spin - pad_w)),
            h,
        }
    }
}

#[cfg(test)]
mod tests;
