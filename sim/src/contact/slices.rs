//! The slices of a line contact, side by side in arrays so that the processor computes several at a
//! time: their places, the state of their bristles and their forces. The shape of the indenting
//! body does not enter: a slice gets a penetration and motions that vary linearly along the pin's
//! axis.

use taktil_mechanics::Pose;

use super::{
    AXIS_SINE_MIN, ContactLine, EDGE_FADE_M, HALF_WIDTH_MIN_M, LoadFactor, PAD_HALF_M, PITCH_M,
    SLICE_COUNT,
};
use crate::hash::Hash;
use crate::rubber::Rubber;

/// Number of slices that are computed together in one block.
const LANE_COUNT: usize = 8;
const BLOCK_COUNT: usize = SLICE_COUNT / LANE_COUNT;
type Lanes = [f64; LANE_COUNT];
/// One number for each slice.
pub(crate) type SliceValues = [Lanes; BLOCK_COUNT];

/// Places of the slices along the pin, and the length of each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SliceGeometry {
    /// Middles of the slices along the pin's axis (m).
    pub(crate) s_m: SliceValues,
    /// Length of the contact line in each slice (m): 0 off the pad or off the pin.
    pub(crate) length_m: SliceValues,
    /// On a pad, the place where the contact line crosses each row, along the sensor's x (m).
    pub(crate) x_m: SliceValues,
    /// Number of blocks that have any slices.
    blocks: usize,
}

impl SliceGeometry {
    /// Slices over the whole length of a pin, at the places and with the weights of Gauss's rule of
    /// eight points, which is exact for all moments of a smooth load up to the fifteenth.
    pub(crate) fn along_pin(length_m: f64) -> SliceGeometry {
        const HALF_RULE: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
            (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
        ];
        let mut geometry = SliceGeometry { blocks: 1, ..SliceGeometry::default() };
        let half_m = 0.5 * length_m;
        for (i, (place, weight)) in HALF_RULE.into_iter().enumerate() {
            for (at, sign) in [(4 + i, 1.0), (3 - i, -1.0)] {
                geometry.s_m[0][at] = sign * place * half_m;
                geometry.length_m[0][at] = weight * half_m;
            }
        }
        geometry
    }

    /// Places the slices at the rows of a pad. A pin across the rows has no slices, and a slice
    /// whose middle is behind the face has no length: the plane of the face is infinite, the finger
    /// is not.
    pub(crate) fn place_on_pad(&mut self, line: &ContactLine, pad: &Pose, pin_length_m: f64) {
        let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
        let per_row = line.axis.dot(y_axis);
        if per_row.abs() < AXIS_SINE_MIN {
            *self = SliceGeometry::default();
            return;
        }
        self.blocks = BLOCK_COUNT;
        let lever = line.foot - pad.translation;
        let (x0, y0) = (lever.dot(x_axis), lever.dot(y_axis));
        let (per_y, dx) = (1.0 / per_row, line.axis.dot(x_axis));
        let width_m = PITCH_M * per_y.abs();
        let (per_width, half) = (1.0 / width_m, 0.5 * pin_length_m);
        let behind_m = -line.radius.length();
        for block in 0..BLOCK_COUNT {
            let first_m = tactel_centre_m(block * LANE_COUNT);
            let (s, length) = (&mut self.s_m[block], &mut self.length_m[block]);
            let x = &mut self.x_m[block];
            for i in 0..LANE_COUNT {
                let s_m = (first_m + PITCH_M * i as f64 - y0) * per_y;
                let x_m = x0 + s_m * dx;
                let on_pin = clamp_unit((half - s_m.abs()) * per_width + 0.5);
                let on_pad = clamp_unit((PAD_HALF_M - x_m.abs()) * (1.0 / EDGE_FADE_M));
                let there = if line.height.at(s_m) > behind_m { width_m } else { 0.0 };
                (s[i], x[i], length[i]) = (s_m, x_m, there * on_pin * on_pad);
            }
        }
    }
}

/// Clamps a number to 0..1 by comparisons that the compiler vectorises.
#[inline(always)]
fn clamp_unit(x: f64) -> f64 {
    let above = if x > 0.0 { x } else { 0.0 };
    if above < 1.0 { above } else { 1.0 }
}

/// Centre of a tactel row or column, from the centre of the pad (m).
pub(crate) fn tactel_centre_m(index: usize) -> f64 {
    (index as f64 - 0.5 * (SLICE_COUNT - 1) as f64) * PITCH_M
}

/// State of the bristles of all slices: everything that the next instant depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BristleState {
    /// Mean deflection across the axis (m).
    pub(crate) across_m: SliceValues,
    /// Mean deflection along the axis (m).
    pub(crate) along_m: SliceValues,
    /// Stiffness of the bristles (N/m).
    pub(crate) shear_n_m: SliceValues,
}

impl BristleState {
    /// The state on the straight line from this state to `to`, at `reach` times the distance.
    pub(crate) fn extrapolated(&self, to: &BristleState, reach: f64) -> BristleState {
        let mut next = *self;
        for b in 0..BLOCK_COUNT {
            for i in 0..LANE_COUNT {
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

/// Geometry, bristles and loads of all slices of a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Slices {
    pub(crate) geometry: SliceGeometry,
    pub(crate) bristles: BristleState,
    /// Normal forces (N).
    pub(crate) load_n: SliceValues,
    /// Penetrations (m).
    pub(crate) delta_m: SliceValues,
}

/// One slice, as reports and images read it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slice {
    pub(crate) s_m: f64,
    pub(crate) x_m: f64,
    pub(crate) length_m: f64,
    pub(crate) load_n: f64,
    pub(crate) delta_m: f64,
    pub(crate) shear_n_m: f64,
    /// Mean deflection of the bristles across the axis (m).
    pub(crate) across_m: f64,
    /// Mean deflection of the bristles along the axis (m).
    pub(crate) along_m: f64,
}

/// The laws and the step that all slices share.
#[derive(Clone, Copy)]
pub(super) struct ContactLaw<'a> {
    pub(super) rubber: &'a Rubber,
    pub(super) load_factor: LoadFactor,
    pub(super) friction: f64,
    /// Length of the step that ends now (s).
    pub(super) h: f64,
}

/// Sums over the slices of the forces and of their derivatives, for each direction (normal, across,
/// along) and each power of the place along the axis.
#[derive(Clone, Copy, Default)]
pub(super) struct ForceSums {
    pub(super) force: [[f64; 2]; 3],
    pub(super) weights: [[f64; 3]; 3],
    pub(super) slip_m_s: f64,
}

/// Forces of one block and their derivatives with respect to the speed.
#[derive(Default)]
struct BlockForces {
    force: [Lanes; 3],
    weight: [Lanes; 3],
    /// Whether a slice slides: then the weights across and along differ.
    slides: bool,
}

/// Bristles of one block at the end of a step.
struct BlockBristles<'a> {
    across_m: &'a mut Lanes,
    along_m: &'a mut Lanes,
    shear_n_m: &'a Lanes,
}

/// Response of the rubber in one block.
#[derive(Default)]
struct BlockResponse {
    load_n_m: Lanes,
    stiffness_n_m2: Lanes,
    shear_n_m2: Lanes,
    half_width_m: Lanes,
}

impl Slices {
    /// Ends the contact: the bristles spring back.
    pub(super) fn release(&mut self) {
        self.bristles = BristleState::default();
        (self.load_n, self.delta_m) = (SliceValues::default(), SliceValues::default());
    }

    /// All slices, row by row.
    pub(crate) fn iter(&self) -> impl Iterator<Item = Slice> + '_ {
        (0..SLICE_COUNT).map(|row| {
            let at = |rows: &SliceValues| rows.as_flattened()[row];
            Slice {
                s_m: at(&self.geometry.s_m),
                x_m: at(&self.geometry.x_m),
                length_m: at(&self.geometry.length_m),
                load_n: at(&self.load_n),
                delta_m: at(&self.delta_m),
                shear_n_m: at(&self.bristles.shear_n_m),
                across_m: at(&self.bristles.across_m),
                along_m: at(&self.bristles.along_m),
            }
        })
    }

    /// Moves the bristles by one step from the state `from` and sums the forces.
    pub(super) fn evaluate(
        &mut self,
        from: &BristleState,
        line: &ContactLine,
        law: &ContactLaw<'_>,
    ) -> ForceSums {
        let mut sums = ForceSums::default();
        for b in 0..self.geometry.blocks.min(BLOCK_COUNT) {
            let response = self.rubber_response(b, line, law.rubber);
            let block = self.bristle_forces(b, from, line, law, &response, &mut sums.slip_m_s);
            sums.add(&self.geometry.s_m[b], &block);
        }
        for b in self.geometry.blocks.min(BLOCK_COUNT)..BLOCK_COUNT {
            // A block without slices stores zeros, so that digests do not depend on what it held
            // before.
            (self.load_n[b], self.delta_m[b]) = (Lanes::default(), Lanes::default());
            let bristles = &mut self.bristles;
            (bristles.across_m[b], bristles.along_m[b]) = (Lanes::default(), Lanes::default());
            bristles.shear_n_m[b] = Lanes::default();
        }
        sums
    }

    /// Computes the penetrations of a block and the response of the rubber to them.
    #[inline(always)]
    fn rubber_response(&mut self, b: usize, line: &ContactLine, rubber: &Rubber) -> BlockResponse {
        let mut block = BlockResponse::default();
        let (s, length) = (&self.geometry.s_m[b], &self.geometry.length_m[b]);
        let delta = &mut self.delta_m[b];
        for i in 0..LANE_COUNT {
            let deep_m = -line.height.at(s[i]);
            delta[i] = 0.0;
            if deep_m > 0.0 && length[i] > 0.0 {
                let response = rubber.at(deep_m);
                delta[i] = deep_m;
                block.load_n_m[i] = response.load_n_m;
                block.stiffness_n_m2[i] = response.stiffness_n_m2;
                block.shear_n_m2[i] = response.shear_n_m2;
                block.half_width_m[i] = response.half_width_m;
            }
        }
        block
    }

    /// Computes the damped normal loads and the bristles as if every slice stuck, without a branch.
    /// Slices that slide are returned to Coulomb's cone afterwards.
    #[inline(always)]
    fn bristle_forces(
        &mut self,
        b: usize,
        from: &BristleState,
        line: &ContactLine,
        law: &ContactLaw<'_>,
        response: &BlockResponse,
        slip_m_s: &mut f64,
    ) -> BlockForces {
        let (h, relaxation_s) = (law.h, law.rubber.relaxation_s);
        let (s, length) = (&self.geometry.s_m[b], &self.geometry.length_m[b]);
        let (delta, load) = (&self.delta_m[b], &mut self.load_n[b]);
        let old = (&from.across_m[b], &from.along_m[b], &from.shear_n_m[b]);
        let BristleState { across_m, along_m, shear_n_m } = &mut self.bristles;
        let new = (&mut across_m[b], &mut along_m[b], &mut shear_n_m[b]);
        let mut block = BlockForces::default();
        let mut slides = 0_u32;
        for i in 0..LANE_COUNT {
            let load_factor = law.load_factor.at_centre + law.load_factor.per_m * s[i];
            let length_m = length[i] * if load_factor > 0.0 { load_factor } else { 0.0 };
            let rate = line.closing.at(s[i]);
            let stiffness = response.stiffness_n_m2[i];
            let load_n = (response.load_n_m[i] + stiffness * relaxation_s * rate) * length_m;
            let pressed = load_n > 0.0;
            load[i] = if pressed { load_n } else { 0.0 };
            let weight_n = stiffness * length_m * (h + relaxation_s);
            let shear = response.shear_n_m2[i] * length_m;
            // A growing contact adds bristles without stress, so that the mean deflection shrinks.
            let diluted = old.2[i] / shear;
            let kept = if shear > old.2[i] { diluted } else { 1.0 };
            let creep = (line.creep_across.at(s[i]), line.creep_along.at(s[i]));
            let wide = response.half_width_m[i];
            let half_m = if wide > HALF_WIDTH_MIN_M { wide } else { HALF_WIDTH_MIN_M };
            let keep = half_m / (half_m + h * line.travel.at(s[i]).abs());
            let carried = if delta[i] > 0.0 { keep } else { 0.0 };
            let deflection = (
                (old.0[i] * kept + h * creep.0) * carried,
                (old.1[i] * kept + h * creep.1) * carried,
            );
            let force = (
                -shear * (deflection.0 + relaxation_s * creep.0),
                -shear * (deflection.1 + relaxation_s * creep.1),
            );
            let weight = shear * (h * keep + relaxation_s);
            let limit = law.friction * load[i];
            let size2 = force.0 * force.0 + force.1 * force.1;
            slides += u32::from(size2 > limit * limit);
            (new.0[i], new.1[i], new.2[i]) = (deflection.0, deflection.1, shear);
            block.force[0][i] = load[i];
            (block.force[1][i], block.force[2][i]) = force;
            block.weight[0][i] = if pressed { weight_n } else { 0.0 };
            (block.weight[1][i], block.weight[2][i]) = (weight, weight);
        }
        block.slides = slides > 0;
        if block.slides {
            let bristles = BlockBristles { across_m: new.0, along_m: new.1, shear_n_m: new.2 };
            *slip_m_s = slip_m_s.max(block.return_to_cone(law, s, line, bristles));
        }
        block
    }
}

/// Deflection that bristles lose per newton that sliding takes off their force (m/N). Of the
/// derivative `weight_n_s_m` with respect to the step's final speed only the part that stretches
/// the bristles counts, not the part of their damper. Otherwise a damped contact that begins to
/// slide would store energy that no work put into it.
pub(crate) fn slip_compliance_m_n(shear_n_m: f64, weight_n_s_m: f64, relaxation_s: f64) -> f64 {
    if shear_n_m > 0.0 && weight_n_s_m > 0.0 {
        1.0 / shear_n_m - relaxation_s / weight_n_s_m
    } else if shear_n_m > 0.0 {
        1.0 / shear_n_m
    } else {
        0.0
    }
}

impl BlockForces {
    /// Returns forces that left Coulomb's cone to it, and shortens their bristles accordingly.
    /// Returns the speed of the fastest slice that slides (m/s).
    fn return_to_cone(
        &mut self,
        law: &ContactLaw<'_>,
        s: &Lanes,
        line: &ContactLine,
        bristles: BlockBristles<'_>,
    ) -> f64 {
        let (friction, relaxation_s) = (law.friction, law.rubber.relaxation_s);
        let BlockBristles { across_m, along_m, shear_n_m } = bristles;
        let mut fastest = 0.0_f64;
        for i in 0..LANE_COUNT {
            let force = (self.force[1][i], self.force[2][i]);
            let limit = friction * self.force[0][i];
            let size2 = force.0 * force.0 + force.1 * force.1;
            if size2 <= limit * limit {
                continue;
            }
            let scale = limit / size2.sqrt();
            let slid = (force.0 * scale, force.1 * scale);
            let back_m_n =
                (1.0 - scale) * slip_compliance_m_n(shear_n_m[i], self.weight[1][i], relaxation_s);
            across_m[i] += force.0 * back_m_n;
            along_m[i] += force.1 * back_m_n;
            (self.force[1][i], self.force[2][i]) = slid;
            let creep = (line.creep_across.at(s[i]), line.creep_along.at(s[i]));
            fastest = fastest.max((creep.0 * creep.0 + creep.1 * creep.1).sqrt());
            // A sliding force depends on the motion by its direction only.
            let part = self.weight[1][i] * scale;
            let direction_weight = |f: f64| part * (1.0 - f * f / size2);
            (self.weight[1][i], self.weight[2][i]) =
                (direction_weight(force.0), direction_weight(force.1));
        }
        fastest
    }
}

impl ForceSums {
    #[inline(always)]
    fn add(&mut self, s: &Lanes, block: &BlockForces) {
        for (sums, forces) in self.force.iter_mut().zip(&block.force) {
            sums[0] += sum(forces);
            sums[1] += sum(&products(forces, s));
        }
        let [normal, across, along] = &block.weight;
        let (normal, across) = (moments(normal, s), moments(across, s));
        let along = if block.slides { moments(along, s) } else { across };
        for (sums, moments) in self.weights.iter_mut().zip([normal, across, along]) {
            for (sum, power) in sums.iter_mut().zip(moments) {
                *sum += power;
            }
        }
    }
}

/// The sums of `w`, `w s` and `w s^2`.
#[inline(always)]
fn moments(w: &Lanes, s: &Lanes) -> [f64; 3] {
    let first = products(w, s);
    [sum(w), sum(&first), sum(&products(&first, s))]
}

#[inline(always)]
fn products(a: &Lanes, b: &Lanes) -> Lanes {
    let mut product = [0.0; LANE_COUNT];
    for i in 0..LANE_COUNT {
        product[i] = a[i] * b[i];
    }
    product
}

/// Adds the halves of the block first, which is the order of a vectorised sum.
#[inline(always)]
fn sum(w: &Lanes) -> f64 {
    let mut halves = [0.0; LANE_COUNT / 2];
    for i in 0..LANE_COUNT / 2 {
        halves[i] = w[i] + w[i + LANE_COUNT / 2];
    }
    let mut quarters = [0.0; LANE_COUNT / 4];
    for i in 0..LANE_COUNT / 4 {
        quarters[i] = halves[i] + halves[i + LANE_COUNT / 4];
    }
    quarters[0] + quarters[1]
}
