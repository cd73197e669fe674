//! The slices of a line contact, side by side in arrays, so that the processor takes two at a time:
//! where they lie, what their bristles remember, and their forces. The laws are those of the module
//! above. Refuses to know what is pressed: a slice sees a penetration and motions that vary
//! linearly along the pin's axis.

use taktil_mechanics::Pose;

use super::{EDGE_M, HALF_WIDTH_MIN_M, Lean, Line, PAD_HALF_M, PITCH_M, SINE_MIN, SLICES, linear};
use crate::hash::Hash;
use crate::rubber::Rubber;

/// Slices that are worked through together.
const LANES: usize = 8;
const BLOCKS: usize = SLICES / LANES;
type Lanes = [f64; LANES];
/// One number a slice.
pub(crate) type Rows = [Lanes; BLOCKS];

/// Where the slices lie along the pin and how much of each there is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Strips {
    /// Middles, along the pin's axis (m).
    pub(crate) s_m: Rows,
    /// Length of contact line in each (m): 0 off the pad or off the pin.
    pub(crate) length_m: Rows,
    /// On the pad: where the contact line crosses the row, along the sensor's x (m).
    pub(crate) x_m: Rows,
    /// Blocks that have any slices.
    blocks: usize,
}

impl Strips {
    /// Slices over the whole length of a pin: places and widths of Gauss's rule of eight points,
    /// which has all moments of a smooth load up to the fifteenth; there are no more than these.
    pub(crate) fn of_pin(length_m: f64) -> Strips {
        const HALF_RULE: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
            (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
        ];
        let mut strips = Strips { blocks: 1, ..Strips::default() };
        let half_m = 0.5 * length_m;
        for (i, (place, weight)) in HALF_RULE.into_iter().enumerate() {
            for (at, sign) in [(4 + i, 1.0), (3 - i, -1.0)] {
                strips.s_m[0][at] = sign * place * half_m;
                strips.length_m[0][at] = weight * half_m;
            }
        }
        strips
    }

    /// Slices at the pad's rows. A pin across the rows has none, and neither has one whose middle
    /// is behind the face: the plane of the face goes on for ever, the finger does not.
    pub(crate) fn lie_on_pad(&mut self, line: &Line, pad: &Pose, pin_length_m: f64) {
        let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
        let per_row = line.axis.dot(y_axis);
        if per_row.abs() < SINE_MIN {
            *self = Strips::default();
            return;
        }
        self.blocks = BLOCKS;
        let lever = line.foot - pad.translation;
        let (x0, y0) = (lever.dot(x_axis), lever.dot(y_axis));
        let (per_y, dx) = (1.0 / per_row, line.axis.dot(x_axis));
        let width_m = PITCH_M * per_y.abs();
        let (per_width, half) = (1.0 / width_m, 0.5 * pin_length_m);
        let behind_m = -line.radius.length();
        for block in 0..BLOCKS {
            let first_m = tactel_middle_m(block * LANES);
            let (s, length) = (&mut self.s_m[block], &mut self.length_m[block]);
            let x = &mut self.x_m[block];
            for i in 0..LANES {
                let s_m = (first_m + PITCH_M * i as f64 - y0) * per_y;
                let x_m = x0 + s_m * dx;
                let on_pin = part((half - s_m.abs()) * per_width + 0.5);
                let on_pad = part((PAD_HALF_M - x_m.abs()) * (1.0 / EDGE_M));
                let there = if linear(line.height, s_m) > behind_m { width_m } else { 0.0 };
                (s[i], x[i], length[i]) = (s_m, x_m, there * on_pin * on_pad);
            }
        }
    }
}

/// Kept between 0 and 1, by comparisons that the processor does in pairs.
#[inline(always)]
fn part(x: f64) -> f64 {
    let above = if x > 0.0 { x } else { 0.0 };
    if above < 1.0 { above } else { 1.0 }
}

/// Middle of a tactel row or column (m) from the pad's centre.
pub(crate) fn tactel_middle_m(index: usize) -> f64 {
    (index as f64 - 0.5 * (SLICES - 1) as f64) * PITCH_M
}

/// What the bristles of the slices remember; everything that the next instant depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Bristles {
    /// Mean deflection across the axis (m).
    pub(crate) across_m: Rows,
    /// Mean deflection along it (m).
    pub(crate) along_m: Rows,
    /// Stiffness (N/m).
    pub(crate) shear_n_m: Rows,
}

impl Bristles {
    /// These carried on by `reach` times the way to others.
    pub(crate) fn carried_on(&self, to: &Bristles, reach: f64) -> Bristles {
        let mut next = *self;
        for b in 0..BLOCKS {
            for i in 0..LANES {
                next.across_m[b][i] += reach * (to.across_m[b][i] - self.across_m[b][i]);
                next.along_m[b][i] += reach * (to.along_m[b][i] - self.along_m[b][i]);
                let from = self.shear_n_m[b][i];
                let shear = from + reach * (to.shear_n_m[b][i] - from);
                next.shear_n_m[b][i] = if shear > 0.0 { shear } else { 0.0 };
            }
        }
        next
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        for rows in [&self.across_m, &self.along_m, &self.shear_n_m] {
            hash.numbers(rows.as_flattened());
        }
    }
}

/// What the slices of a contact feel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Slices {
    pub(crate) strips: Strips,
    pub(crate) bristles: Bristles,
    /// Normal forces (N).
    pub(crate) load_n: Rows,
    /// Penetrations (m).
    pub(crate) delta_m: Rows,
}

/// One slice, for those that look from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slice {
    pub(crate) s_m: f64,
    pub(crate) x_m: f64,
    pub(crate) length_m: f64,
    pub(crate) load_n: f64,
    pub(crate) delta_m: f64,
    pub(crate) shear_n_m: f64,
    /// Mean deflection of the bristles, across and along (m).
    pub(crate) brush_m: (f64, f64),
}

/// What the slices share.
#[derive(Clone, Copy)]
pub(super) struct Law<'a> {
    pub(super) rubber: &'a Rubber,
    pub(super) lean: Lean,
    pub(super) friction: f64,
    /// Length of the step whose end this is (s).
    pub(super) h: f64,
}

/// Sums over the slices of forces and of how they depend on the motion: each of (normal, across,
/// along), by the powers of the place along the axis.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) force: [[f64; 2]; 3],
    pub(super) weights: [[f64; 3]; 3],
    pub(super) slip_m_s: f64,
}

/// Forces of one block and what they change by per speed.
#[derive(Default)]
struct Block {
    force: [Lanes; 3],
    weight: [Lanes; 3],
    /// Some slices slide: weights across and along differ.
    slides: bool,
}

/// What the rubber answers in one block.
#[derive(Default)]
struct Answer {
    load_n_m: Lanes,
    stiffness_n_m2: Lanes,
    shear_n_m2: Lanes,
    half_width_m: Lanes,
}

impl Slices {
    /// Nothing touches: bristles spring back.
    pub(super) fn release(&mut self) {
        self.bristles = Bristles::default();
        (self.load_n, self.delta_m) = (Rows::default(), Rows::default());
    }

    /// Every slice of the pad, row by row.
    pub(crate) fn each(&self) -> impl Iterator<Item = Slice> + '_ {
        (0..SLICES).map(|row| {
            let at = |rows: &Rows| rows.as_flattened()[row];
            Slice {
                s_m: at(&self.strips.s_m),
                x_m: at(&self.strips.x_m),
                length_m: at(&self.strips.length_m),
                load_n: at(&self.load_n),
                delta_m: at(&self.delta_m),
                shear_n_m: at(&self.bristles.shear_n_m),
                brush_m: (at(&self.bristles.across_m), at(&self.bristles.along_m)),
            }
        })
    }

    /// Moves the bristles on from `from`.
    pub(super) fn act(&mut self, from: &Bristles, line: &Line, law: &Law<'_>) -> Sums {
        let mut sums = Sums::default();
        for b in 0..self.strips.blocks.min(BLOCKS) {
            let answer = self.press(b, line, law.rubber);
            let block = self.drag(b, from, line, law, &answer, &mut sums.slip_m_s);
            sums.add(&self.strips.s_m[b], &block);
        }
        for b in self.strips.blocks.min(BLOCKS)..BLOCKS {
            // A slice that there is not keeps nothing.
            (self.load_n[b], self.delta_m[b]) = (Lanes::default(), Lanes::default());
            let bristles = &mut self.bristles;
            (bristles.across_m[b], bristles.along_m[b]) = (Lanes::default(), Lanes::default());
            bristles.shear_n_m[b] = Lanes::default();
        }
        sums
    }

    /// Penetrations of a block, and what the rubber answers to them.
    #[inline(always)]
    fn press(&mut self, b: usize, line: &Line, rubber: &Rubber) -> Answer {
        let mut answer = Answer::default();
        let (s, length) = (&self.strips.s_m[b], &self.strips.length_m[b]);
        let delta = &mut self.delta_m[b];
        for i in 0..LANES {
            let deep_m = -linear(line.height, s[i]);
            delta[i] = 0.0;
            if deep_m > 0.0 && length[i] > 0.0 {
                let response = rubber.at(deep_m);
                delta[i] = deep_m;
                answer.load_n_m[i] = response.load_n_m;
                answer.stiffness_n_m2[i] = response.stiffness_n_m2;
                answer.shear_n_m2[i] = response.shear_n_m2;
                answer.half_width_m[i] = response.half_width_m;
            }
        }
        answer
    }

    /// Normal loads with their damping, and the bristles: without a branch, as if all stuck; those
    /// that do not are returned to Coulomb's cone afterwards.
    #[inline(always)]
    fn drag(
        &mut self,
        b: usize,
        from: &Bristles,
        line: &Line,
        law: &Law<'_>,
        answer: &Answer,
        slip_m_s: &mut f64,
    ) -> Block {
        let (h, relaxation_s) = (law.h, law.rubber.relaxation_s);
        let (s, length) = (&self.strips.s_m[b], &self.strips.length_m[b]);
        let (delta, load) = (&self.delta_m[b], &mut self.load_n[b]);
        let old = (&from.across_m[b], &from.along_m[b], &from.shear_n_m[b]);
        let Bristles { across_m, along_m, shear_n_m } = &mut self.bristles;
        let new = (&mut across_m[b], &mut along_m[b], &mut shear_n_m[b]);
        let mut block = Block::default();
        let mut slides = 0_u32;
        for i in 0..LANES {
            let lean = law.lean.0 + law.lean.1 * s[i];
            let length_m = length[i] * if lean > 0.0 { lean } else { 0.0 };
            let rate = linear(line.closing, s[i]);
            let stiffness = answer.stiffness_n_m2[i];
            let load_n = (answer.load_n_m[i] + stiffness * relaxation_s * rate) * length_m;
            let pressed = load_n > 0.0;
            load[i] = if pressed { load_n } else { 0.0 };
            let weight_n = stiffness * length_m * (h + relaxation_s);
            let shear = answer.shear_n_m2[i] * length_m;
            // Growing contact adds bristles without stress.
            let diluted = old.2[i] / shear;
            let kept = if shear > old.2[i] { diluted } else { 1.0 };
            let creep = (linear(line.creep_across, s[i]), linear(line.creep_along, s[i]));
            let wide = answer.half_width_m[i];
            let half_m = if wide > HALF_WIDTH_MIN_M { wide } else { HALF_WIDTH_MIN_M };
            let keep = half_m / (half_m + h * linear(line.travel, s[i]).abs());
            let there = if delta[i] > 0.0 { keep } else { 0.0 };
            let brush =
                ((old.0[i] * kept + h * creep.0) * there, (old.1[i] * kept + h * creep.1) * there);
            let force = (
                -shear * (brush.0 + relaxation_s * creep.0),
                -shear * (brush.1 + relaxation_s * creep.1),
            );
            let weight = shear * (h * keep + relaxation_s);
            let limit = law.friction * load[i];
            let size2 = force.0 * force.0 + force.1 * force.1;
            slides += u32::from(size2 > limit * limit);
            (new.0[i], new.1[i], new.2[i]) = (brush.0, brush.1, shear);
            block.force[0][i] = load[i];
            (block.force[1][i], block.force[2][i]) = force;
            block.weight[0][i] = if pressed { weight_n } else { 0.0 };
            (block.weight[1][i], block.weight[2][i]) = (weight, weight);
        }
        block.slides = slides > 0;
        if block.slides {
            let bristles = (new.0, new.1, &*new.2);
            *slip_m_s = slip_m_s.max(block.slide((law.friction, relaxation_s), s, line, bristles));
        }
        block
    }
}

/// How far bristles give way (m) per newton that sliding takes off the force on them: of the
/// `weight_n_s_m` of a step's final speed only the part that stretches them, not their damper's.
/// Else a damped contact that begins to slide would be found stretched by work that nobody did.
pub(crate) fn yields_m_n(shear_n_m: f64, weight_n_s_m: f64, relaxation_s: f64) -> f64 {
    if shear_n_m > 0.0 && weight_n_s_m > 0.0 {
        1.0 / shear_n_m - relaxation_s / weight_n_s_m
    } else if shear_n_m > 0.0 {
        1.0 / shear_n_m
    } else {
        0.0
    }
}

impl Block {
    /// Returns forces that left Coulomb's cone to it, and their bristles with them; the fastest
    /// motion of a slice that slides (m/s).
    fn slide(
        &mut self,
        (friction, relaxation_s): (f64, f64),
        s: &Lanes,
        line: &Line,
        (across_m, along_m, shear_n_m): (&mut Lanes, &mut Lanes, &Lanes),
    ) -> f64 {
        let mut fastest = 0.0_f64;
        for i in 0..LANES {
            let force = (self.force[1][i], self.force[2][i]);
            let limit = friction * self.force[0][i];
            let size2 = force.0 * force.0 + force.1 * force.1;
            if size2 <= limit * limit {
                continue;
            }
            let scale = limit / size2.sqrt();
            let slid = (force.0 * scale, force.1 * scale);
            let back_m_n =
                (1.0 - scale) * yields_m_n(shear_n_m[i], self.weight[1][i], relaxation_s);
            across_m[i] += force.0 * back_m_n;
            along_m[i] += force.1 * back_m_n;
            (self.force[1][i], self.force[2][i]) = slid;
            let creep = (linear(line.creep_across, s[i]), linear(line.creep_along, s[i]));
            fastest = fastest.max((creep.0 * creep.0 + creep.1 * creep.1).sqrt());
            // Only the direction of a sliding force depends on the motion.
            let part = self.weight[1][i] * scale;
            let turns = |f: f64| part * (1.0 - f * f / size2);
            (self.weight[1][i], self.weight[2][i]) = (turns(force.0), turns(force.1));
        }
        fastest
    }
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, s: &Lanes, block: &Block) {
        for (sums, forces) in self.force.iter_mut().zip(&block.force) {
            sums[0] += sum(forces);
            sums[1] += sum(&times(forces, s));
        }
        let [normal, across, along] = &block.weight;
        let (normal, across) = (powers(normal, s), powers(across, s));
        let along = if block.slides { powers(along, s) } else { across };
        for (sums, powers) in self.weights.iter_mut().zip([normal, across, along]) {
            for (sum, power) in sums.iter_mut().zip(powers) {
                *sum += power;
            }
        }
    }
}

/// Sums of `w`, `w s` and `w s^2`.
#[inline(always)]
fn powers(w: &Lanes, s: &Lanes) -> [f64; 3] {
    let first = times(w, s);
    [sum(w), sum(&first), sum(&times(&first, s))]
}

#[inline(always)]
fn times(a: &Lanes, b: &Lanes) -> Lanes {
    let mut product = [0.0; LANES];
    for i in 0..LANES {
        product[i] = a[i] * b[i];
    }
    product
}

/// By halves, as the processor adds them.
#[inline(always)]
fn sum(w: &Lanes) -> f64 {
    let mut halves = [0.0; LANES / 2];
    for i in 0..LANES / 2 {
        halves[i] = w[i] + w[i + LANES / 2];
    }
    let mut quarters = [0.0; LANES / 4];
    for i in 0..LANES / 4 {
        quarters[i] = halves[i] + halves[i + LANES / 4];
    }
    quarters[0] + quarters[1]
}
