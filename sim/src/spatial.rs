//! The pin on the pad in three dimensions, solved at every image by `taktil_mechanics`, warm from
//! one image to the next: rows lean on each other through the layer, ends of the pin are ends.
//! Between images the rows keep the ratio to their plane solutions that force and moment of the
//! last solution had, linear along the axis; a test states what that leaves. Refuses nothing: where
//! the tables end, the rows stand on their own, which is counted.
//!
//! The theory's layer has no edges. A pin that is longer than the pad is cut beyond it, and only
//! what presses on the pad counts; the pad's own free edges are left out.

use taktil_contact::space::pin::{Pin as LayerPin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_contact::space::{Level, Prescribed};
use taktil_hal::MAX_TACTELS;
use taktil_mechanics::Pose;

use crate::contact::{Lean, Line, PAD_HALF_M, PITCH_M, Patch, Slice};
use crate::rubber;
use crate::scene::{Invalid, RubberConfig};

/// Largest penetration of the deepest slice, in thicknesses.
const DEEPEST: f64 = 0.4;
/// A cut pin goes on beyond the pad's diagonal by so many thicknesses.
const BEYOND: f64 = 6.0;
/// The force of a solution over that of its plane rows is believed within these bounds.
const LEAN: (f64, f64) = (0.3, 3.0);

/// The solver of a pin on a pad, with its tables.
#[derive(Clone, Debug)]
pub(crate) struct Spatial {
    /// The pin from end to end, its origin in its middle.
    whole: LayerPin,
    /// The pin cut beyond the pad, its origin next to the pad's middle; half its length (mm).
    cut: Option<(LayerPin, f64)>,
    shares: Shares,
    half_length_mm: f64,
    image_mpa: [f64; MAX_TACTELS],
}

/// A solved contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Solved {
    /// Force on the pad (N) and its moment about the pin's middle along the axis (N m).
    pub(crate) force_n: f64,
    pub(crate) moment_nm: f64,
}

/// Images under a load where three dimensions are asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    /// Solved.
    pub(crate) solved: u64,
    /// After which rows stand on their own: nothing was solved, or its force is not believed.
    pub(crate) plain: u64,
}

impl Tally {
    /// Of a solution that gave rows this lean.
    pub(crate) fn of(lean: Lean) -> Tally {
        Tally { solved: 1, plain: u64::from(lean == Lean::NONE) }
    }

    /// Of an image without a solution.
    pub(crate) const PLAIN: Tally = Tally { solved: 0, plain: 1 };

    pub(crate) fn add(&mut self, more: Tally) {
        (self.solved, self.plain) = (self.solved + more.solved, self.plain + more.plain);
    }
}

/// The generatrix over the pad in the solver's terms: mm, pad axes.
#[derive(Clone, Copy, Debug)]
struct Lie {
    /// Foot of the pin's middle.
    foot_mm: [f64; 2],
    /// Direction of the axis in the pad, towards +y, and whether that is the pin's own.
    direction: [f64; 2],
    forward: bool,
    rot_rad: f64,
    /// Penetration at the foot and its rise per mm along the direction.
    depth_mm: f64,
    slope: f64,
}

impl Lie {
    fn of(line: &Line, pad: &Pose) -> Lie {
        let lever = line.foot - pad.translation;
        let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
        let (x, y) = (line.along.dot(x_axis), line.along.dot(y_axis));
        let sign = if y < 0.0 { -1.0 } else { 1.0 };
        let (height_m, rise) = line.height();
        let run = line.axis.dot(line.along);
        Lie {
            foot_mm: [1e3 * lever.dot(x_axis), 1e3 * lever.dot(y_axis)],
            direction: [sign * x, sign * y],
            forward: sign > 0.0,
            rot_rad: libm::atan2(-sign * x, sign * y),
            depth_mm: -1e3 * height_m,
            slope: -sign * rise / run,
        }
    }
}

impl Spatial {
    /// Tabulates layer, pin (radius and length) and array; allocates and takes its time. `place` is
    /// the rubber's in the scene.
    pub(crate) fn new(
        config: &RubberConfig,
        (radius_m, length_m): (f64, f64),
        level: Level,
        place: &str,
    ) -> Result<Spatial, Invalid> {
        let located = rubber::located(place);
        let layer = rubber::layer(config).map_err(&located)?;
        let profile = Profile::Cylinder { radius_mm: 1e3 * radius_m };
        let deepest_mm = (DEEPEST * config.thickness_mm).min(200.0 * radius_m);
        let half_length_mm = 500.0 * length_m;
        let pin = |half: f64| {
            LayerPin::new(&layer, profile, [-half, half], deepest_mm, level).map_err(&located)
        };
        let reach = Array::THESIS.half_diagonal_mm() + BEYOND * config.thickness_mm;
        let cut = if half_length_mm > 1.1 * reach { Some((pin(reach)?, reach)) } else { None };
        let fineness = match level {
            Level::Fast => Fineness::FAST,
            Level::Default => Fineness::DEFAULT,
            Level::Fine => Fineness::FINE,
        };
        let influence = Influence::new(&layer).map_err(&located)?;
        let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness);
        Ok(Spatial {
            whole: pin(half_length_mm)?,
            cut,
            shares: shares.map_err(located)?,
            half_length_mm,
            image_mpa: [0.0; MAX_TACTELS],
        })
    }

    /// Solves the contact of the pin's lowest line with the pad; nothing where the tables end.
    pub(crate) fn solve(&mut self, line: &Line, pad: &Pose) -> Option<Solved> {
        let lie = Lie::of(line, pad);
        let [x, y] = lie.foot_mm;
        let [dx, dy] = lie.direction;
        let nearest = -(x * dx + y * dy);
        let (pin, from) = match &mut self.cut {
            Some((pin, half)) if nearest.abs() + *half <= self.half_length_mm => (pin, nearest),
            _ => (&mut self.whole, 0.0),
        };
        let depth_mm = lie.depth_mm + from * lie.slope;
        self.image_mpa = [0.0; MAX_TACTELS];
        let state = pin.press(Prescribed::PenetrationMm(depth_mm), libm::atan(lie.slope)).ok()?;
        if state.force_n <= 0.0 {
            return Some(Solved::default());
        }
        let origin = [x + from * dx, y + from * dy];
        let stand = PlanarPose { x_mm: origin[0], y_mm: origin[1], rot_rad: lie.rot_rad };
        pin.image(&self.shares, stand, &mut self.image_mpa);
        let (force_n, moment_n_mm) = on_pad(pin, &lie, origin, from);
        let sign = if lie.forward { 1.0 } else { -1.0 };
        Some(Solved { force_n, moment_nm: 1e-3 * sign * moment_n_mm })
    }

    /// Normal force on each tactel (N) of the contact last solved.
    pub(crate) fn forces_n(&self) -> [f64; MAX_TACTELS] {
        let area_mm2 = 1e6 * PITCH_M * PITCH_M;
        self.image_mpa.map(|stress| -area_mm2 * stress)
    }

    /// Forgets the warm start.
    pub(crate) fn release(&mut self) {
        self.whole.release();
        if let Some((pin, _)) = &mut self.cut {
            pin.release();
        }
        self.image_mpa = [0.0; MAX_TACTELS];
    }
}

/// Force on the pad and its moment about the pin's middle (N, N mm): what a load stands for along
/// the axis counts by the part of it that is over the pad, and pulls where that part is. Across the
/// axis a load is a point.
fn on_pad(pin: &LayerPin, lie: &Lie, origin: [f64; 2], from: f64) -> (f64, f64) {
    let half_mm = 1e3 * PAD_HALF_M;
    let [dx, dy] = lie.direction;
    let length_mm = pin.load_length_mm();
    let (mut force, mut moment) = (0.0, 0.0);
    pin.loads(|[u, v], load| {
        let place = [origin[0] + u * dy + v * dx, origin[1] - u * dx + v * dy];
        let (part, off_mm) = part_over(place, lie.direction, length_mm, half_mm);
        force += part * load;
        moment += part * load * (from + v + off_mm);
    });
    (force, moment)
}

/// The part of a piece of some length about a place along a direction that is over a square about
/// the origin, and how far from the place along the direction the middle of that part is. A piece
/// along the square's side is half over it.
fn part_over(place: [f64; 2], direction: [f64; 2], length: f64, half: f64) -> (f64, f64) {
    let (mut from, mut to) = (-0.5 * length, 0.5 * length);
    let mut side = 1.0;
    for (at, along) in place.into_iter().zip(direction) {
        // A piece that leaves no more than its own rounding across a side runs beside it.
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

/// The factors on plane rows that give them the force and the moment of a solution.
pub(crate) fn lean_of(pad: &Patch, solved: &Solved) -> Lean {
    let row = |slice: Slice| {
        let response = pad.rubber.at(slice.delta_m);
        (slice.s_m, response.load_n_m * slice.length_m)
    };
    lean(pad.slices.each().map(row), solved)
}

/// The same for places along the axis (m) with the loads of their plane solutions (N).
pub(crate) fn lean(plain: impl Iterator<Item = (f64, f64)>, solved: &Solved) -> Lean {
    let mut sums = [0.0; 3];
    for (s, load) in plain {
        sums[0] += load;
        sums[1] += s * load;
        sums[2] += s * s * load;
    }
    let [whole, first, second] = sums;
    if whole <= 0.0 {
        return Lean::NONE;
    }
    let spread = second - first * first / whole;
    let ratio = solved.force_n / whole;
    if !(LEAN.0..=LEAN.1).contains(&ratio) {
        return Lean::NONE;
    }
    let rest = solved.moment_nm - ratio * first;
    let per_m = if spread > 1e-9 * whole * PAD_HALF_M * PAD_HALF_M { rest / spread } else { 0.0 };
    let steepest = 0.5 * ratio / PAD_HALF_M;
    let per_m = per_m.clamp(-steepest, steepest);
    Lean(ratio - per_m * first / whole, per_m)
}

#[cfg(test)]
mod tests;
