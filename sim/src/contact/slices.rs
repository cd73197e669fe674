//! The slices of a line contact, side by side in arrays so that the processor computes several at a
//! time: their places, the state of their bristles and their forces. The shape of the indenting
//! body does not enter: a slice gets a penetration and motions that vary linearly along the pin's
//! axis.

mod lanes;

use taktil_mechanics::Pose;

use super::{AXIS_SINE_MIN, ContactLine, EDGE_FADE_M, HALF_WIDTH_MIN_M, LoadFactor};
use crate::geometry::ArrayGeometry;
use crate::hash::Hash;
use crate::rubber::Rubber;
use lanes::{LANE_COUNT, Lanes, moments, products, sum};

/// Fewest blocks that a digest covers. A contact of fewer blocks counts as if it had these, so that
/// a digest does not depend on how few blocks the slices need.
const DIGEST_BLOCK_COUNT_MIN: usize = 2;

/// Places of one block's slices along the pin, and the length of each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PlacesOfBlock {
    /// Middles of the slices along the pin's axis (m).
    s_m: Lanes,
    /// Length of the contact line in each slice (m): 0 off the pad or off the pin.
    length_m: Lanes,
    /// On a pad, the place where the contact line crosses each row, along the sensor's x (m).
    x_m: Lanes,
}

/// Places of the slices along the pin.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SliceGeometry {
    blocks: Box<[PlacesOfBlock]>,
    /// Number of blocks that have any slices.
    active: usize,
}

impl SliceGeometry {
    /// Slices over the whole length of a pin, at the places and with the weights of Gauss's rule of
    /// eight points, which is exact for all moments of a smooth load up to the fifteenth.
    fn along_pin(length_m: f64) -> SliceGeometry {
        const HALF_RULE: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
            (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
        ];
        let mut block = PlacesOfBlock::default();
        let half_m = 0.5 * length_m;
        for (i, (place, weight)) in HALF_RULE.into_iter().enumerate() {
            for (at, sign) in [(4 + i, 1.0), (3 - i, -1.0)] {
                block.s_m[at] = sign * place * half_m;
                block.length_m[at] = weight * half_m;
            }
        }
        SliceGeometry { blocks: [block].into(), active: 1 }
    }

    /// Places the slices at the rows of a pad. A pin across the rows has no slices, and a slice
    /// whose middle is behind the face has no length: the plane of the face is infinite, the finger
    /// is not.
    pub(crate) fn place_on_pad(
        &mut self,
        line: &ContactLine,
        pad: &Pose,
        array: &ArrayGeometry,
        pin_length_m: f64,
    ) {
        let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
        let per_row = line.axis.dot(y_axis);
        if per_row.abs() < AXIS_SINE_MIN {
            self.blocks.fill(PlacesOfBlock::default());
            self.active = 0;
            return;
        }
        self.active = self.blocks.len();
        let lever = line.foot - pad.translation;
        let (x0, y0) = (lever.dot(x_axis), lever.dot(y_axis));
        let (per_y, dx) = (1.0 / per_row, line.axis.dot(x_axis));
        let (pitch_m, half_x_m) = (array.pitch_y_m, array.half_x_m());
        let width_m = pitch_m * per_y.abs();
        let (per_width, half) = (1.0 / width_m, 0.5 * pin_length_m);
        let behind_m = -line.radius.length();
        for (index, block) in self.blocks.iter_mut().enumerate() {
            let first_m = array.row_m(index * LANE_COUNT);
            for i in 0..LANE_COUNT {
                let s_m = (first_m + pitch_m * i as f64 - y0) * per_y;
                let x_m = x0 + s_m * dx;
                let on_pin = clamp_unit((half - s_m.abs()) * per_width + 0.5);
                let on_pad = clamp_unit((half_x_m - x_m.abs()) * (1.0 / EDGE_FADE_M));
                let there = if line.height.at(s_m) > behind_m { width_m } else { 0.0 };
                (block.s_m[i], block.x_m[i]) = (s_m, x_m);
                block.length_m[i] = there * on_pin * on_pad;
            }
        }
        // The last block may have lanes beyond the last row.
        let rest = array.rows % LANE_COUNT;
        if let Some(block) = self.blocks.last_mut().filter(|_| rest > 0) {
            block.length_m[rest..].fill(0.0);
        }
    }
}

/// Clamps a number to 0..1 by comparisons that the compiler vectorises.
#[inline(always)]
fn clamp_unit(x: f64) -> f64 {
    let above = if x > 0.0 { x } else { 0.0 };
    if above < 1.0 { above } else { 1.0 }
}

/// State of the bristles of one block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct BristlesOfBlock {
    /// Mean deflection across the axis (m).
    across_m: Lanes,
    /// Mean deflection along the axis (m).
    along_m: Lanes,
    /// Stiffness of the bristles (N/m).
    shear_n_m: Lanes,
}

/// State of the bristles of all slices: everything that the next instant depends on.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct BristleState {
    blocks: Box<[BristlesOfBlock]>,
}

impl BristleState {
    /// Takes the state of a contact with as many slices, in place.
    pub(crate) fn copy_from(&mut self, other: &BristleState) {
        for (to, from) in self.blocks.iter_mut().zip(&other.blocks) {
            *to = *from;
        }
    }

    /// Makes this state the one on the straight line from the state `from` to `to`, at `reach`
    /// times the distance.
    pub(crate) fn extrapolate(&mut self, from: &BristleState, to: &BristleState, reach: f64) {
        for ((next, from), to) in self.blocks.iter_mut().zip(&from.blocks).zip(&to.blocks) {
            for i in 0..LANE_COUNT {
                next.across_m[i] = from.across_m[i] + reach * (to.across_m[i] - from.across_m[i]);
                next.along_m[i] = from.along_m[i] + reach * (to.along_m[i] - from.along_m[i]);
                let shear = from.shear_n_m[i] + reach * (to.shear_n_m[i] - from.shear_n_m[i]);
                next.shear_n_m[i] = if shear > 0.0 { shear } else { 0.0 };
            }
        }
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        let lanes: [fn(&BristlesOfBlock) -> &Lanes; 3] =
            [|block| &block.across_m, |block| &block.along_m, |block| &block.shear_n_m];
        for of in lanes {
            self.blocks.iter().for_each(|block| hash.numbers(of(block)));
            for _ in self.blocks.len()..DIGEST_BLOCK_COUNT_MIN {
                hash.numbers(&Lanes::default());
            }
        }
    }
}

/// Loads of one block's slices.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct LoadsOfBlock {
    /// Normal forces (N).
    load_n: Lanes,
    /// Penetrations (m).
    delta_m: Lanes,
}

/// Geometry, bristles and loads of all slices of a contact.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Slices {
    /// Number of slices: the rows of a pad.
    count: usize,
    pub(crate) geometry: SliceGeometry,
    pub(crate) bristles: BristleState,
    loads: Box<[LoadsOfBlock]>,
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

/// Response of the rubber in one block.
#[derive(Default)]
struct BlockResponse {
    /// Penetrations (m).
    delta_m: Lanes,
    load_n_m: Lanes,
    stiffness_n_m2: Lanes,
    shear_n_m2: Lanes,
    half_width_m: Lanes,
}

impl Slices {
    /// Unloaded slices at the rows of a pad. Allocates.
    pub(super) fn on_pad(array: &ArrayGeometry) -> Slices {
        let blocks = array.rows.div_ceil(LANE_COUNT);
        let places = vec![PlacesOfBlock::default(); blocks].into();
        Slices::at(SliceGeometry { blocks: places, active: 0 }, array.rows)
    }

    /// Unloaded slices over the whole length of a pin. Allocates.
    pub(super) fn along_pin(length_m: f64) -> Slices {
        Slices::at(SliceGeometry::along_pin(length_m), LANE_COUNT)
    }

    fn at(geometry: SliceGeometry, count: usize) -> Slices {
        let blocks = geometry.blocks.len();
        Slices {
            count,
            geometry,
            bristles: BristleState { blocks: vec![BristlesOfBlock::default(); blocks].into() },
            loads: vec![LoadsOfBlock::default(); blocks].into(),
        }
    }

    /// Ends the contact: the bristles spring back.
    pub(super) fn release(&mut self) {
        self.bristles.blocks.fill(BristlesOfBlock::default());
        self.loads.fill(LoadsOfBlock::default());
    }

    /// All slices, row by row.
    pub(crate) fn iter(&self) -> impl Iterator<Item = Slice> + '_ {
        let blocks = self.geometry.blocks.iter().zip(&self.bristles.blocks).zip(&self.loads);
        let slices = blocks.flat_map(|((places, bristles), loads)| {
            (0..LANE_COUNT).map(move |i| Slice {
                s_m: places.s_m[i],
                x_m: places.x_m[i],
                length_m: places.length_m[i],
                load_n: loads.load_n[i],
                delta_m: loads.delta_m[i],
                shear_n_m: bristles.shear_n_m[i],
                across_m: bristles.across_m[i],
                along_m: bristles.along_m[i],
            })
        });
        slices.take(self.count)
    }

    /// Moves the bristles by one step from the state `from` and sums the forces.
    pub(super) fn evaluate(
        &mut self,
        from: &BristleState,
        line: &ContactLine,
        law: &ContactLaw<'_>,
    ) -> ForceSums {
        let mut sums = ForceSums::default();
        let Slices { geometry, bristles, loads, .. } = self;
        let states = geometry.blocks.iter().zip(&from.blocks);
        let blocks = states.zip(&mut bristles.blocks).zip(loads.iter_mut()).take(geometry.active);
        for (((places, from), bristles), loads) in blocks {
            let response = rubber_response(places, line, law.rubber);
            let (forces, state) =
                bristle_forces(places, from, line, law, &response, &mut sums.slip_m_s);
            *bristles = state;
            *loads = LoadsOfBlock { load_n: forces.force[0], delta_m: response.delta_m };
            sums.add(&places.s_m, &forces);
        }
        // A block without slices stores zeros, so that digests do not depend on what it held
        // before.
        for block in bristles.blocks.iter_mut().skip(geometry.active) {
            *block = BristlesOfBlock::default();
        }
        for block in loads.iter_mut().skip(geometry.active) {
            *block = LoadsOfBlock::default();
        }
        sums
    }
}

/// Computes the penetrations of a block and the response of the rubber to them.
#[inline(always)]
fn rubber_response(places: &PlacesOfBlock, line: &ContactLine, rubber: &Rubber) -> BlockResponse {
    let mut block = BlockResponse::default();
    let (s, length) = (&places.s_m, &places.length_m);
    for i in 0..LANE_COUNT {
        let deep_m = -line.height.at(s[i]);
        if deep_m > 0.0 && length[i] > 0.0 {
            let response = rubber.at(deep_m);
            block.delta_m[i] = deep_m;
            block.load_n_m[i] = response.load_n_m;
            block.stiffness_n_m2[i] = response.stiffness_n_m2;
            block.shear_n_m2[i] = response.shear_n_m2;
            block.half_width_m[i] = response.half_width_m;
        }
    }
    block
}

/// Computes the damped normal loads and the bristles as if every slice stuck, without a branch.
/// Slices that slide are returned to Coulomb's cone afterwards. The bristles are a value of their
/// own, which the compiler can tell from those at the start of the step.
#[inline(always)]
fn bristle_forces(
    places: &PlacesOfBlock,
    old: &BristlesOfBlock,
    line: &ContactLine,
    law: &ContactLaw<'_>,
    response: &BlockResponse,
    slip_m_s: &mut f64,
) -> (BlockForces, BristlesOfBlock) {
    let (h, relaxation_s) = (law.h, law.rubber.relaxation_s);
    let (s, length) = (&places.s_m, &places.length_m);
    let (mut block, mut new) = (BlockForces::default(), BristlesOfBlock::default());
    let mut slides = 0_u32;
    for i in 0..LANE_COUNT {
        let load_factor = law.load_factor.at_centre + law.load_factor.per_m * s[i];
        let length_m = length[i] * if load_factor > 0.0 { load_factor } else { 0.0 };
        let rate = line.closing.at(s[i]);
        let stiffness = response.stiffness_n_m2[i];
        let load_n = (response.load_n_m[i] + stiffness * relaxation_s * rate) * length_m;
        let pressed = load_n > 0.0;
        let load_n = if pressed { load_n } else { 0.0 };
        let weight_n = stiffness * length_m * (h + relaxation_s);
        let shear = response.shear_n_m2[i] * length_m;
        // A growing contact adds bristles without stress, so that the mean deflection shrinks.
        let diluted = old.shear_n_m[i] / shear;
        let kept = if shear > old.shear_n_m[i] { diluted } else { 1.0 };
        let creep = (line.creep_across.at(s[i]), line.creep_along.at(s[i]));
        let wide = response.half_width_m[i];
        let half_m = if wide > HALF_WIDTH_MIN_M { wide } else { HALF_WIDTH_MIN_M };
        let keep = half_m / (half_m + h * line.travel.at(s[i]).abs());
        let carried = if response.delta_m[i] > 0.0 { keep } else { 0.0 };
        let deflection = (
            (old.across_m[i] * kept + h * creep.0) * carried,
            (old.along_m[i] * kept + h * creep.1) * carried,
        );
        let force = (
            -shear * (deflection.0 + relaxation_s * creep.0),
            -shear * (deflection.1 + relaxation_s * creep.1),
        );
        let weight = shear * (h * keep + relaxation_s);
        let limit = law.friction * load_n;
        let size2 = force.0 * force.0 + force.1 * force.1;
        slides += u32::from(size2 > limit * limit);
        (new.across_m[i], new.along_m[i]) = deflection;
        new.shear_n_m[i] = shear;
        block.force[0][i] = load_n;
        (block.force[1][i], block.force[2][i]) = force;
        block.weight[0][i] = if pressed { weight_n } else { 0.0 };
        (block.weight[1][i], block.weight[2][i]) = (weight, weight);
    }
    block.slides = slides > 0;
    if block.slides {
        *slip_m_s = slip_m_s.max(block.return_to_cone(law, s, line, &mut new));
    }
    (block, new)
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
        bristles: &mut BristlesOfBlock,
    ) -> f64 {
        let (friction, relaxation_s) = (law.friction, law.rubber.relaxation_s);
        let BristlesOfBlock { across_m, along_m, shear_n_m } = bristles;
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
