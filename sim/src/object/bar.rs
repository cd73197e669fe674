//! A bar with a flat face and sharp edges, cut into short lengths along itself. Each length presses
//! as in plane strain across the bar, level or with one edge lifted; the image is that of all loads
//! in three dimensions. Refuses what the plane problem refuses; ends press as if the bar went on.
//!
//! A flat face has no length of its own: load and place of its middle depend on the deepest
//! penetration by proportion and on the ratio of slope and penetration alone, so that one table
//! over that ratio is the whole contact.

use glam::{DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};
use taktil_contact::space::tactels::Shares;
use taktil_hal::MAX_TACTELS;

use super::{Lie, Meeting, Sums, layer_of, on_pad};
use crate::rubber;
use crate::scene::{Invalid, ObjectConfig, RubberConfig, invalid};

/// Longest length (m).
const STEP_M: f64 = 0.5e-3;
/// Knots of the table, from a level face to a load this far out in half-widths.
const KNOTS: usize = 120;
const FARTHEST: f64 = 0.96;
/// Points that stand for the pressure across a length.
const POINTS: usize = 10;

/// A face at one ratio of slope and penetration; lengths in half-widths.
#[derive(Clone, Copy, Debug, Default)]
struct Knot {
    /// Rise of the penetration from the middle to the deepest edge over that at the edge.
    ratio: f64,
    /// Line load over the penetration of the deepest edge (N/m^2).
    stiffness_n_m2: f64,
    /// Place of the load's middle, towards the deepest edge.
    place: f64,
    /// Middle and half of the contact.
    middle: f64,
    half: f64,
    /// Shares of the points at the cosines of equal angles.
    weights: [f64; POINTS],
}

impl Knot {
    fn mix(a: &Knot, b: &Knot, f: f64) -> Knot {
        let mix = |x: f64, y: f64| x + f * (y - x);
        Knot {
            ratio: mix(a.ratio, b.ratio),
            stiffness_n_m2: mix(a.stiffness_n_m2, b.stiffness_n_m2),
            place: mix(a.place, b.place),
            middle: mix(a.middle, b.middle),
            half: mix(a.half, b.half),
            weights: core::array::from_fn(|i| mix(a.weights[i], b.weights[i])),
        }
    }
}

/// One length in contact, as the pad sees it.
#[derive(Clone, Copy, Debug, Default)]
struct Pressed {
    middle: DVec2,
    across: DVec2,
    side: f64,
    load_n: f64,
    knot: Knot,
}

/// The bar with the table of its face.
#[derive(Clone, Debug)]
pub(super) struct Face {
    half_width_m: f64,
    half_length_m: f64,
    step_m: f64,
    count: usize,
    knots: Vec<Knot>,
    /// Stiffness against a tangential shift over that against a normal one.
    shear: f64,
    /// Lengths that pressed at the latest evaluation: the first `used`. Room for all, which a clone
    /// keeps.
    met: Vec<Pressed>,
    used: usize,
    /// Cosines of the points.
    cosines: [f64; POINTS],
}

impl Face {
    pub(super) fn new(
        config: &ObjectConfig,
        pad: &RubberConfig,
        place: &str,
    ) -> Result<Face, Invalid> {
        let layer = layer_of(pad)?;
        let width_mm = config.width_mm.unwrap_or(4.0);
        let shape = Shape::Flat { width_mm, height_mm: 1.0 };
        let mut indenter = Indenter::new(&layer, shape, Friction::None, Accuracy::Default)
            .map_err(rubber::located(place))?;
        let angle = |i: usize| core::f64::consts::PI * (i as f64 + 0.5) / POINTS as f64;
        let cosines = core::array::from_fn(|i| libm::cos(angle(i)));
        let half_mm = 0.5 * width_mm;
        let mut knots = Vec::with_capacity(KNOTS + 1);
        for k in 0..=KNOTS {
            let out = FARTHEST * k as f64 / KNOTS as f64;
            // A moment that moves the load's middle out.
            let load = Load { p_n_mm: 1.0, q_n_mm: out * half_mm };
            let contact = indenter.press(&load).map_err(|refusal| {
                let what = format!("gives no contact: {refusal}");
                invalid(&format!("{place}.width_mm"), what, "give another width")
            })?;
            let deepest_mm = contact.delta_mm + contact.slope.abs() * half_mm;
            let middle_mm = 0.5 * (contact.x_right_mm + contact.x_left_mm);
            let reach_mm = 0.5 * (contact.x_right_mm - contact.x_left_mm);
            let mut weights: [f64; POINTS] = core::array::from_fn(|i| {
                let sine = libm::sin(angle(i));
                sine * indenter.pressure_mpa(middle_mm + reach_mm * libm::cos(angle(i)))
            });
            let sum: f64 = weights.iter().sum();
            weights.iter_mut().for_each(|weight| *weight /= sum);
            knots.push(Knot {
                ratio: contact.slope.abs() * half_mm / deepest_mm,
                stiffness_n_m2: 1e6 / deepest_mm,
                place: out,
                middle: middle_mm / half_mm,
                half: reach_mm / half_mm,
                weights,
            });
        }
        let half_length_m = 0.5e-3 * config.length();
        let count = libm::ceil(2.0 * half_length_m / STEP_M).max(1.0);
        // A thin layer in shear, G w / t, over its plane stiffness.
        let thin = 1e6 * layer.shear_mpa() * width_mm / layer.thickness_mm;
        Ok(Face {
            half_width_m: 1e-3 * half_mm,
            half_length_m,
            step_m: 2.0 * half_length_m / count,
            count: count as usize,
            shear: thin / knots[0].stiffness_n_m2,
            knots,
            met: vec![Pressed::default(); count as usize],
            used: 0,
            cosines,
        })
    }

    /// The face at a ratio of slope and penetration; beyond the table its last knot.
    fn at(&self, ratio: f64) -> Knot {
        let after = self.knots.partition_point(|knot| knot.ratio < ratio);
        if after == 0 {
            return self.knots[0];
        }
        if after >= self.knots.len() {
            return self.knots[self.knots.len() - 1];
        }
        let (a, b) = (&self.knots[after - 1], &self.knots[after]);
        Knot::mix(a, b, (ratio - a.ratio) / (b.ratio - a.ratio))
    }

    /// Evaluates the contact.
    pub(super) fn press(&mut self, meeting: &Meeting, relaxation_s: f64) -> Sums {
        let mut sums = Sums { half_width_m: self.half_width_m, ..Sums::default() };
        self.used = 0;
        let across = meeting.turn.x_axis;
        let flat = across.truncate();
        let level = flat.length();
        // Seen from the side there is no face, and from behind there is none either.
        if level < 0.5 || meeting.turn.z_axis.z > -0.5 {
            return sums;
        }
        let (unit, slope) = (flat / level, -across.z / level);
        let side = if slope < 0.0 { -1.0 } else { 1.0 };
        let rise_m = slope.abs() * self.half_width_m;
        for i in 0..self.count {
            let s = (i as f64 + 0.5) * self.step_m - self.half_length_m;
            let middle: DVec3 = meeting.place + s * meeting.turn.y_axis;
            let deepest_m = rise_m - middle.z;
            if deepest_m <= 0.0 {
                continue;
            }
            let knot = self.at(rise_m / deepest_m);
            let at = middle.truncate() + side * knot.place * self.half_width_m * unit;
            let length_m = self.step_m * meeting.turn.y_axis.truncate().length();
            let stiffness_n_m = knot.stiffness_n_m2 * length_m;
            let rate = meeting.closing(at.x, at.y);
            let load_n = stiffness_n_m * (deepest_m + relaxation_s * rate);
            if load_n <= 0.0 {
                continue;
            }
            let middle = middle.truncate();
            self.met[self.used] = Pressed { middle, across: unit, side, load_n, knot };
            self.used += 1;
            let cover = on_pad(at);
            sums.add(at, cover * load_n, 0.0);
            // Two springs stand for the contact's stiffness against tilt.
            let weight = 0.5 * cover * stiffness_n_m * (meeting.h + relaxation_s);
            let lever = 0.5 * knot.half * self.half_width_m * unit;
            sums.add(at + lever, 0.0, weight);
            sums.add(at - lever, 0.0, weight);
            sums.shear_n_m += cover * self.shear * stiffness_n_m;
            sums.deepest_m = sums.deepest_m.max(deepest_m);
        }
        sums
    }

    /// Adds the stresses of the latest evaluation (MPa).
    pub(super) fn image(&self, shares: &Shares, image: &mut [f64; MAX_TACTELS]) {
        for pressed in &self.met[..self.used] {
            let knot = &pressed.knot;
            for (cosine, weight) in self.cosines.iter().zip(knot.weights) {
                let out = pressed.side * self.half_width_m * (knot.middle + knot.half * cosine);
                let at = 1e3 * (pressed.middle + out * pressed.across);
                shares.add(image, at.to_array(), weight * pressed.load_n);
            }
        }
    }

    /// How the face lies under the pad.
    pub(super) fn lie(&self, meeting: &Meeting) -> Lie {
        let up = meeting.turn.z_axis;
        let along = meeting.turn.y_axis;
        let sign = if along.y < 0.0 { -1.0 } else { 1.0 };
        Lie {
            off_m: meeting.place.x,
            yaw_rad: libm::atan2(-sign * along.x, sign * along.y),
            along_m: meeting.place.y,
            tilt_rad: DVec2::new(libm::atan(up.y / up.z), -libm::atan(up.x / up.z)),
        }
    }

    /// Load (N/m) and place of its middle (m) of one length; for tests.
    #[cfg(test)]
    pub(super) fn plane(&self, deepest_m: f64, slope: f64) -> (f64, f64) {
        let knot = self.at(slope * self.half_width_m / deepest_m);
        (knot.stiffness_n_m2 * deepest_m, knot.place * self.half_width_m)
    }
}
