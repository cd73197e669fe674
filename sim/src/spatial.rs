//! The contact of pin and pad in three dimensions, solved at every image by `taktil_contact`, warm
//! from one image to the next. Rows influence each other through the layer, and the ends of the pin
//! are ends. Between images each row keeps the ratio to its plane solution that reproduces force
//! and moment of the last solution, linear along the axis; a test states the error of that. Where
//! the solver's tables end, the image is made from independent rows, and that is counted.
//!
//! The theory's layer has no edges. A pin that is longer than the pad is cut beyond the pad, and
//! only the pressure on the pad counts.

use taktil_contact::Accuracy;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin as LayerPin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::tactels::{Fineness, Sampling, Shares};
use taktil_mechanics::Pose;

use crate::contact::{ContactLine, Linear, LoadFactor, Patch, Slice};
use crate::geometry::ArrayGeometry;
use crate::pin::CylinderSize;
use crate::rubber;
use crate::scene::{Invalid, RubberConfig};
use crate::square_cells::SquareCells;

/// Largest penetration of the deepest slice, in thicknesses of the layer.
const PENETRATION_MAX_THICKNESSES: f64 = 0.4;
/// Distance by which a cut pin extends beyond the pad's diagonal, in thicknesses of the layer.
const CUT_MARGIN_THICKNESSES: f64 = 6.0;
/// Bounds of the ratio of a solution's force to the force of its plane rows; outside them the
/// solution is discarded.
const LOAD_RATIO_MIN: f64 = 0.3;
const LOAD_RATIO_MAX: f64 = 3.0;

/// The solver of a pin on a pad, with its tables.
#[derive(Clone, Debug)]
pub(crate) struct SpatialSolver {
    /// The whole pin, with its origin in its middle.
    whole: LayerPin,
    /// The pin cut beyond the pad, with its origin next to the pad's middle, and half its length
    /// (mm).
    cut: Option<(LayerPin, f64)>,
    shares: Shares,
    half_length_mm: f64,
    geometry: ArrayGeometry,
    cells: SquareCells,
    image_mpa: Box<[f64]>,
}

/// A pad as a solver has to know it: its array and its rubber, each with its place in the scene.
#[derive(Clone, Copy)]
pub(crate) struct PadSection<'a> {
    pub(crate) array: &'a ArrayGeometry,
    pub(crate) array_place: &'a str,
    pub(crate) rubber: &'a RubberConfig,
    pub(crate) rubber_place: &'a str,
}

impl PadSection<'_> {
    /// The shares that the squares of the pad's tactels have in point loads. Allocates and takes
    /// long.
    pub(crate) fn shares(
        &self,
        cells: &SquareCells,
        fineness: Fineness,
    ) -> Result<Shares, Invalid> {
        let at_place = rubber::at_place(self.rubber_place);
        let layer = rubber::layer(self.rubber).map_err(&at_place)?;
        let influence = Influence::new(&layer).map_err(&at_place)?;
        let of_array = |refusal: taktil_contact::Invalid| {
            let key = match refusal.place.as_str() {
                "pitch_mm" => "pitch_x_mm",
                "rows" => "rows",
                _ => return at_place(refusal),
            };
            Invalid::new(key, refusal.what, refusal.remedy).within(self.array_place)
        };
        Shares::new(&influence, cells.array(), Sampling::Area, fineness).map_err(of_array)
    }
}

/// The load of a solved contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SpatialLoad {
    /// Force on the pad (N) and its moment about the pin's middle along the axis (N m).
    pub(crate) force_n: f64,
    pub(crate) moment_nm: f64,
}

/// Counts of loaded images in scenes that ask for three dimensions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SolveCounts {
    /// Images that were solved.
    pub(crate) solutions: u64,
    /// Images that were made from independent rows: nothing was solved, or the solution was
    /// discarded.
    pub(crate) failures: u64,
}

impl SolveCounts {
    /// The counts of one solution that gave this load factor.
    pub(crate) fn of(load_factor: LoadFactor) -> SolveCounts {
        SolveCounts { solutions: 1, failures: u64::from(load_factor == LoadFactor::ONE) }
    }

    /// The counts of one image without a solution.
    pub(crate) const UNSOLVED: SolveCounts = SolveCounts { solutions: 0, failures: 1 };

    pub(crate) fn add(&mut self, more: SolveCounts) {
        self.solutions += more.solutions;
        self.failures += more.failures;
    }
}

/// The generatrix over the pad in the solver's units (mm) and the pad's axes.
#[derive(Clone, Copy, Debug)]
struct PinPlacement {
    /// Point under the pin's middle.
    foot_mm: [f64; 2],
    /// Direction of the axis in the pad, chosen towards +y, and whether the pin's own axis points
    /// that way.
    direction: [f64; 2],
    forward: bool,
    rot_rad: f64,
    /// Penetration under the pin's middle, and its change per mm along the direction.
    depth_mm: f64,
    slope: f64,
}

impl PinPlacement {
    fn of(line: &ContactLine, pad: &Pose) -> PinPlacement {
        let lever = line.foot - pad.translation;
        let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
        let (x, y) = (line.along.dot(x_axis), line.along.dot(y_axis));
        let sign = if y < 0.0 { -1.0 } else { 1.0 };
        let Linear { at_centre: height_m, per_m: rise } = line.height;
        let run = line.axis.dot(line.along);
        PinPlacement {
            foot_mm: [1e3 * lever.dot(x_axis), 1e3 * lever.dot(y_axis)],
            direction: [sign * x, sign * y],
            forward: sign > 0.0,
            rot_rad: libm::atan2(-sign * x, sign * y),
            depth_mm: -1e3 * height_m,
            slope: -sign * rise / run,
        }
    }
}

impl SpatialSolver {
    /// Computes the tables of layer, pin and array, which allocates and takes long.
    pub(crate) fn new(
        pad: &PadSection<'_>,
        size: CylinderSize,
        level: Accuracy,
    ) -> Result<SpatialSolver, Invalid> {
        let at_place = rubber::at_place(pad.rubber_place);
        let layer = rubber::layer(pad.rubber).map_err(&at_place)?;
        let profile = Profile::Cylinder { radius_mm: 1e3 * size.radius_m };
        let thickness_mm = pad.rubber.thickness_mm;
        let deepest_mm = (PENETRATION_MAX_THICKNESSES * thickness_mm).min(200.0 * size.radius_m);
        let half_length_mm = 500.0 * size.length_m;
        let pin = |half: f64| {
            LayerPin::new(&layer, profile, [-half, half], deepest_mm, level).map_err(&at_place)
        };
        let cells = SquareCells::new(pad.array, pad.array_place)?;
        let reach = cells.array().half_diagonal_mm() + CUT_MARGIN_THICKNESSES * thickness_mm;
        let cut = if half_length_mm > 1.1 * reach { Some((pin(reach)?, reach)) } else { None };
        let fineness = match level {
            Accuracy::Fast => Fineness::FAST,
            Accuracy::Default => Fineness::DEFAULT,
            Accuracy::Fine => Fineness::FINE,
        };
        Ok(SpatialSolver {
            whole: pin(half_length_mm)?,
            cut,
            shares: pad.shares(&cells, fineness)?,
            half_length_mm,
            geometry: *pad.array,
            cells,
            image_mpa: vec![0.0; pad.array.tactels()].into(),
        })
    }

    /// Solves the contact of the pin's lowest line with the pad; none where the tables end.
    pub(crate) fn solve(&mut self, line: &ContactLine, pad: &Pose) -> Option<SpatialLoad> {
        let placement = PinPlacement::of(line, pad);
        let [x, y] = placement.foot_mm;
        let [dx, dy] = placement.direction;
        let nearest = -(x * dx + y * dy);
        let (pin, from) = match &mut self.cut {
            Some((pin, half)) if nearest.abs() + *half <= self.half_length_mm => (pin, nearest),
            _ => (&mut self.whole, 0.0),
        };
        let depth_mm = placement.depth_mm + from * placement.slope;
        self.image_mpa.fill(0.0);
        let state =
            pin.press(Prescribed::PenetrationMm(depth_mm), libm::atan(placement.slope)).ok()?;
        if state.force_n <= 0.0 {
            return Some(SpatialLoad::default());
        }
        let origin = [x + from * dx, y + from * dy];
        let stand = PlanarPose { x_mm: origin[0], y_mm: origin[1], rot_rad: placement.rot_rad };
        let shares = &self.shares;
        self.cells.add(&mut self.image_mpa, |_, image| pin.image(shares, stand, image));
        let (force_n, moment_n_mm) = load_on_pad(pin, &self.geometry, &placement, origin, from);
        let sign = if placement.forward { 1.0 } else { -1.0 };
        Some(SpatialLoad { force_n, moment_nm: 1e-3 * sign * moment_n_mm })
    }

    /// Normal force on each tactel (N) of the contact last solved.
    pub(crate) fn tactel_forces_n(&self) -> impl Iterator<Item = f64> + '_ {
        let area_mm2 = self.geometry.tactel_mm2();
        self.image_mpa.iter().map(move |stress| -area_mm2 * stress)
    }

    /// Discards the warm start.
    pub(crate) fn release(&mut self) {
        self.whole.release();
        if let Some((pin, _)) = &mut self.cut {
            pin.release();
        }
        self.image_mpa.fill(0.0);
    }
}

/// Force on the pad and its moment about the pin's middle (N, N mm). Each load of the solution
/// stands for a length along the axis. It counts with the part of that length that is over the pad,
/// and acts in the middle of that part; across the axis it acts at a point.
fn load_on_pad(
    pin: &LayerPin,
    array: &ArrayGeometry,
    placement: &PinPlacement,
    origin: [f64; 2],
    from: f64,
) -> (f64, f64) {
    let half_mm = [1e3 * array.half_x_m(), 1e3 * array.half_y_m()];
    let [dx, dy] = placement.direction;
    let length_mm = pin.load_length_mm();
    let (mut force, mut moment) = (0.0, 0.0);
    pin.loads(|[u, v], load| {
        let place = [origin[0] + u * dy + v * dx, origin[1] - u * dx + v * dy];
        let (part, off_mm) = overlap(place, placement.direction, length_mm, half_mm);
        force += part * load;
        moment += part * load * (from + v + off_mm);
    });
    (force, moment)
}

/// The part of a segment of some length that is over a rectangle about the origin with half the
/// sides `half`, and the distance from the segment's middle to the middle of that part. The segment
/// has its middle at `place` and the given direction; a segment on a side of the rectangle is half
/// over it.
fn overlap(place: [f64; 2], direction: [f64; 2], length: f64, half: [f64; 2]) -> (f64, f64) {
    let (mut from, mut to) = (-0.5 * length, 0.5 * length);
    let mut side = 1.0;
    for ((at, along), half) in place.into_iter().zip(direction).zip(half) {
        // A segment that crosses a side by no more than rounding is parallel to that side.
        if along.abs() * length <= 1e-12 * half {
            side *= match at.abs() - half {
                beyond if beyond > 1e-12 * half => 0.0,
                beyond if beyond < -1e-12 * half => 1.0,
                _ => 0.5,
            };
            continue;
        }
        let ends = [(-half - at) / along, (half - at) / along];
        from = from.max(ends[0].min(ends[1]));
        to = to.min(ends[0].max(ends[1]));
    }
    if length <= 0.0 {
        return (side, 0.0);
    }
    if from >= to {
        return (0.0, 0.0);
    }
    (side * (to - from) / length, 0.5 * (from + to))
}

/// The load factor that gives the plane rows force and moment of a solution.
pub(crate) fn load_factor_of(
    pad: &Patch,
    array: &ArrayGeometry,
    solved: &SpatialLoad,
) -> LoadFactor {
    let row = |slice: Slice| {
        let response = pad.rubber.at(slice.delta_m);
        (slice.s_m, response.load_n_m * slice.length_m)
    };
    load_factor(pad.slices.iter().map(row), array.half_y_m(), solved)
}

/// The load factor for places along the axis (m) with the loads of their plane solutions (N), on a
/// pad of `half_m` to both sides of its middle.
pub(crate) fn load_factor(
    plain: impl Iterator<Item = (f64, f64)>,
    half_m: f64,
    solved: &SpatialLoad,
) -> LoadFactor {
    let mut sums = [0.0; 3];
    for (s, load) in plain {
        sums[0] += load;
        sums[1] += s * load;
        sums[2] += s * s * load;
    }
    let [whole, first, second] = sums;
    if whole <= 0.0 {
        return LoadFactor::ONE;
    }
    let spread = second - first * first / whole;
    let ratio = solved.force_n / whole;
    if !(LOAD_RATIO_MIN..=LOAD_RATIO_MAX).contains(&ratio) {
        return LoadFactor::ONE;
    }
    let rest = solved.moment_nm - ratio * first;
    let per_m = if spread > 1e-9 * whole * half_m * half_m { rest / spread } else { 0.0 };
    let steepest = 0.5 * ratio / half_m;
    let per_m = per_m.clamp(-steepest, steepest);
    LoadFactor { at_centre: ratio - per_m * first / whole, per_m }
}

#[cfg(test)]
mod tests;
