//! A bar with a flat face and sharp edges, cut into short sections along its length. Each section
//! presses as in plane strain across the bar, level or with one edge lifted; the image is that of
//! all loads in three dimensions. Ends press as if the bar continued. A contact that the plane
//! problem cannot solve is an error.
//!
//! A flat face has no length scale of its own: the load is proportional to the deepest penetration,
//! and the place of its middle depends on the ratio of slope and penetration alone, so that one
//! table over that ratio describes the whole contact.

use glam::{DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};
use taktil_contact::space::tactels::Shares;

use super::pad::pad_layer;
use super::{ContactLoad, ObjectPlacement, RelativeMotion, on_pad};
use crate::rubber;
use crate::scene::{Invalid, ObjectConfig, invalid};
use crate::spatial::PadSection;
use crate::square_cells::SquareCells;

/// Longest section (m).
const SECTION_LENGTH_MAX_M: f64 = 0.5e-3;
/// Number of cells of the table, and the largest eccentricity of the load, in half-widths.
const KNOT_COUNT: usize = 120;
const ECCENTRICITY_MAX: f64 = 0.96;
/// Number of point loads that represent the pressure across a section.
const PRESSURE_POINT_COUNT: usize = 10;

/// The contact at one ratio of slope and penetration; lengths are in half-widths.
#[derive(Clone, Copy, Debug, Default)]
struct Knot {
    /// Rise of the penetration from the middle to the deepest edge, relative to the penetration of
    /// that edge.
    ratio: f64,
    /// Line load per penetration of the deepest edge (N/m^2).
    stiffness_n_m2: f64,
    /// Place of the middle of the load, towards the deepest edge.
    place: f64,
    /// Middle and half-width of the contact.
    middle: f64,
    half: f64,
    /// Weights of the point loads at the cosines of equal angles.
    weights: [f64; PRESSURE_POINT_COUNT],
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

/// One loaded section in the pad's frame.
#[derive(Clone, Copy, Debug, Default)]
struct LoadedSection {
    middle: DVec2,
    across: DVec2,
    side: f64,
    load_n: f64,
    knot: Knot,
}

/// The bar with the table of its contact.
#[derive(Clone, Debug)]
pub(super) struct BarContact {
    /// Half the pad's sides (m).
    pad_half_m: DVec2,
    half_width_m: f64,
    half_length_m: f64,
    step_m: f64,
    count: usize,
    knots: Vec<Knot>,
    /// Ratio of the stiffness against a tangential shift to the normal one.
    shear: f64,
    /// Sections that were loaded at the latest evaluation: the first `loaded_count`. The vector has
    /// room for all sections, also in a clone.
    sections: Vec<LoadedSection>,
    loaded_count: usize,
    /// Places of the point loads, as cosines.
    cosines: [f64; PRESSURE_POINT_COUNT],
}

impl BarContact {
    pub(super) fn new(
        config: &ObjectConfig,
        pad: &PadSection<'_>,
        place: &str,
    ) -> Result<BarContact, Invalid> {
        let layer = pad_layer(pad.rubber)?;
        let width_mm = config.width_mm.unwrap_or(4.0);
        let shape = Shape::Flat { width_mm, height_mm: 1.0 };
        let mut indenter = Indenter::new(&layer, shape, Friction::None, Accuracy::Default)
            .map_err(rubber::at_place(place))?;
        let angle =
            |i: usize| core::f64::consts::PI * (i as f64 + 0.5) / PRESSURE_POINT_COUNT as f64;
        let cosines = core::array::from_fn(|i| libm::cos(angle(i)));
        let half_mm = 0.5 * width_mm;
        let mut knots = Vec::with_capacity(KNOT_COUNT + 1);
        for k in 0..=KNOT_COUNT {
            let out = ECCENTRICITY_MAX * k as f64 / KNOT_COUNT as f64;
            // The moment moves the middle of the load outwards.
            let load = Load { p_n_mm: 1.0, q_n_mm: out * half_mm };
            let contact = indenter.press(&load).map_err(|refusal| {
                let what = format!("gives no contact: {refusal}");
                invalid(&format!("{place}.width_mm"), what, "give another width")
            })?;
            let deepest_mm = contact.delta_mm + contact.slope.abs() * half_mm;
            let middle_mm = 0.5 * (contact.x_right_mm + contact.x_left_mm);
            let reach_mm = 0.5 * (contact.x_right_mm - contact.x_left_mm);
            let mut weights: [f64; PRESSURE_POINT_COUNT] = core::array::from_fn(|i| {
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
        let count = libm::ceil(2.0 * half_length_m / SECTION_LENGTH_MAX_M).max(1.0);
        // This is the stiffness of a thin layer in shear, G w / t, over its plane stiffness.
        let thin = 1e6 * layer.shear_mpa() * width_mm / layer.thickness_mm;
        Ok(BarContact {
            pad_half_m: pad.array.half_sides_m(),
            half_width_m: 1e-3 * half_mm,
            half_length_m,
            step_m: 2.0 * half_length_m / count,
            count: count as usize,
            shear: thin / knots[0].stiffness_n_m2,
            knots,
            sections: vec![LoadedSection::default(); count as usize],
            loaded_count: 0,
            cosines,
        })
    }

    /// The contact at a ratio of slope and penetration; beyond the table its last knot.
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

    /// Evaluates the contact at a relative motion.
    pub(super) fn evaluate(&mut self, motion: &RelativeMotion, relaxation_s: f64) -> ContactLoad {
        let mut sums = ContactLoad { half_width_m: self.half_width_m, ..ContactLoad::default() };
        self.loaded_count = 0;
        let across = motion.turn.x_axis;
        let flat = across.truncate();
        let level = flat.length();
        // A bar on its side and a bar from behind have no face towards the pad.
        if level < 0.5 || motion.turn.z_axis.z > -0.5 {
            return sums;
        }
        let (unit, slope) = (flat / level, -across.z / level);
        let side = if slope < 0.0 { -1.0 } else { 1.0 };
        let rise_m = slope.abs() * self.half_width_m;
        for i in 0..self.count {
            let s = (i as f64 + 0.5) * self.step_m - self.half_length_m;
            let middle: DVec3 = motion.place + s * motion.turn.y_axis;
            let deepest_m = rise_m - middle.z;
            if deepest_m <= 0.0 {
                continue;
            }
            let knot = self.at(rise_m / deepest_m);
            let at = middle.truncate() + side * knot.place * self.half_width_m * unit;
            let length_m = self.step_m * motion.turn.y_axis.truncate().length();
            let stiffness_n_m = knot.stiffness_n_m2 * length_m;
            let rate = motion.closing(at.x, at.y);
            let load_n = stiffness_n_m * (deepest_m + relaxation_s * rate);
            if load_n <= 0.0 {
                continue;
            }
            let middle = middle.truncate();
            self.sections[self.loaded_count] =
                LoadedSection { middle, across: unit, side, load_n, knot };
            self.loaded_count += 1;
            let cover = on_pad(at, self.pad_half_m);
            sums.add(at, cover * load_n, 0.0);
            // Two springs represent the contact's stiffness against tilt.
            let weight = 0.5 * cover * stiffness_n_m * (motion.h + relaxation_s);
            let lever = 0.5 * knot.half * self.half_width_m * unit;
            sums.add(at + lever, 0.0, weight);
            sums.add(at - lever, 0.0, weight);
            sums.shear_n_m += cover * self.shear * stiffness_n_m;
            sums.deepest_m = sums.deepest_m.max(deepest_m);
        }
        sums
    }

    /// Adds the stresses of the latest evaluation (MPa).
    pub(super) fn image(&self, shares: &Shares, cells: &mut SquareCells, image: &mut [f64]) {
        cells.add(image, |_, image| {
            for pressed in &self.sections[..self.loaded_count] {
                let knot = &pressed.knot;
                for (cosine, weight) in self.cosines.iter().zip(knot.weights) {
                    let out = pressed.side * self.half_width_m * (knot.middle + knot.half * cosine);
                    let at = 1e3 * (pressed.middle + out * pressed.across);
                    shares.add(image, at.to_array(), weight * pressed.load_n);
                }
            }
        });
    }

    /// The placement of the face under the pad.
    pub(super) fn placement(&self, motion: &RelativeMotion) -> ObjectPlacement {
        let up = motion.turn.z_axis;
        let along = motion.turn.y_axis;
        let sign = if along.y < 0.0 { -1.0 } else { 1.0 };
        ObjectPlacement {
            off_m: motion.place.x,
            yaw_rad: libm::atan2(-sign * along.x, sign * along.y),
            along_m: motion.place.y,
            tilt_rad: DVec2::new(libm::atan(up.y / up.z), -libm::atan(up.x / up.z)),
        }
    }

    /// Load (N/m) and place of its middle (m) for one section, which tests compare with the
    /// reference.
    #[cfg(test)]
    pub(super) fn plane_load(&self, deepest_m: f64, slope: f64) -> (f64, f64) {
        let knot = self.at(slope * self.half_width_m / deepest_m);
        (knot.stiffness_n_m2 * deepest_m, knot.place * self.half_width_m)
    }
}
