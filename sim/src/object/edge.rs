//! A plate on its edge: a rounded ridge along a curve, cut into short lengths. Each length presses
//! as in plane strain, across its own direction; the image is that of all loads in three
//! dimensions. Refuses what its rounding refuses as a cylinder; ends and corners press as if the
//! ridge went on (what that leaves is measured in this module's tests). Where the scene asks for
//! three dimensions, a straight ridge is solved so at every image, as the pin is.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::space::tactels::Shares;
use taktil_hal::MAX_TACTELS;
use taktil_mechanics::{Joints, Pose};

use super::{Lie, Meeting, RUBBER, Sums, layer_of, on_pad};
use crate::contact::{Lean, Line, PAD_HALF_M, PITCH_M, Surface};
use crate::pin::Pin;
use crate::rubber::Rubber;
use crate::scene::{EdgeProfile, Invalid, ObjectConfig, RubberConfig};
use crate::spatial::{Solved, Spatial, Tally};

/// Longest length (m).
const STEP_M: f64 = 0.5e-3;
/// Lengths so far from the one nearest to the pad's middle are looked at (m): the pad's diagonal
/// and somewhat more.
const REACH_M: f64 = 22e-3;
/// Loads beyond the pad by so much still show at its border (m).
const BEYOND_M: f64 = 3e-3;
/// Points that stand for the pressure across a length.
const POINTS: usize = 6;

/// Seen from above, in the object's frame.
#[derive(Clone, Copy, Debug)]
enum Curve {
    Straight,
    /// Curvature (1/m) behind the origin, towards -x.
    Arc(f64),
    /// Direction behind the origin.
    Corner(DVec2),
}

impl Curve {
    fn of(config: &ObjectConfig) -> Curve {
        let turn = config.corner_deg.unwrap_or(0.0).to_radians();
        match config.profile.unwrap_or_default() {
            EdgeProfile::Straight => Curve::Straight,
            EdgeProfile::Arc => Curve::Arc(1e3 / config.bend_mm.unwrap_or(f64::INFINITY)),
            EdgeProfile::Corner => Curve::Corner(DVec2::new(-libm::sin(turn), libm::cos(turn))),
        }
    }

    /// Place and direction at a length along the curve from its origin.
    fn at(&self, s: f64) -> (DVec2, DVec2) {
        match *self {
            Curve::Arc(bend) if s > 0.0 && bend != 0.0 => {
                let (sine, cosine) = (libm::sin(bend * s), libm::cos(bend * s));
                (DVec2::new(cosine - 1.0, sine) / bend, DVec2::new(-sine, cosine))
            }
            Curve::Corner(along) if s > 0.0 => (s * along, along),
            _ => (DVec2::new(0.0, s), DVec2::Y),
        }
    }

    /// Length at which the curve, between `-half` and `half`, is nearest to a place.
    fn nearest(&self, from: DVec2, half: f64) -> f64 {
        let before = from.y.clamp(-half, 0.0);
        let behind = match *self {
            Curve::Straight => from.y,
            Curve::Corner(along) => from.dot(along),
            Curve::Arc(0.0) => from.y,
            Curve::Arc(bend) => {
                // Angle about the arc's middle, from the origin on.
                let side = 1.0 / bend;
                let angle = libm::atan2(from.y * bend.abs(), (from.x + side) * bend);
                let turned = if angle < -0.5 * PI { angle + 2.0 * PI } else { angle };
                turned / bend.abs()
            }
        };
        let behind = behind.clamp(0.0, half);
        let far = |s: f64| (self.at(s).0 - from).length_squared();
        if far(behind) < far(before) { behind } else { before }
    }
}

/// One length in contact, as the pad sees it.
#[derive(Clone, Copy, Debug, Default)]
struct Pressed {
    at: DVec2,
    across: DVec2,
    half_width_m: f64,
    load_n: f64,
    /// Place along the curve (m), and the elastic load on the pad without lean (N).
    s_m: f64,
    plain_n: f64,
}

/// The ridge with the contact of its rounding.
#[derive(Clone, Debug)]
pub(super) struct Ridge {
    curve: Curve,
    radius_m: f64,
    half_m: f64,
    step_m: f64,
    /// Middle and direction of each length in the object's frame.
    lengths: Vec<(DVec2, DVec2)>,
    rubber: Rubber,
    /// Lengths that pressed at the latest evaluation: the first `used`. Room for all that can,
    /// which a clone keeps.
    met: Vec<Pressed>,
    used: usize,
    /// Cosines of the points across a length, and their weights.
    points: [(f64, f64); POINTS],
    /// The contact in three dimensions, for straight ridges of scenes that ask for it.
    spatial: Option<Box<Spatial>>,
    /// The scene asks for three dimensions.
    pub(super) asked: bool,
    /// What lengths carry over their plane solutions.
    pub(super) lean: Lean,
    /// Where it was at the latest evaluation.
    last: Meeting,
}

impl Ridge {
    /// `level` asks for three dimensions; `place` is the object's.
    pub(super) fn new(
        config: &ObjectConfig,
        rubber: &RubberConfig,
        level: Option<Accuracy>,
        place: &str,
    ) -> Result<Ridge, Invalid> {
        let radius_mm = config.radius();
        // Complaints that are the rubber's own belong to it.
        layer_of(rubber)?;
        let (curve, half_m) = (Curve::of(config), 0.5e-3 * config.length());
        // A corner is a border between two lengths.
        let each = libm::ceil(half_m / STEP_M).max(1.0);
        let step_m = half_m / each;
        let count = 2 * each as usize;
        let most = 2 * (REACH_M / step_m) as usize + 4;
        let middle = |i: usize| curve.at((i as f64 + 0.5) * step_m - half_m);
        let mut points = [(0.0, 0.0); POINTS];
        for (i, point) in points.iter_mut().enumerate() {
            // Gauss and Chebyshev's rule of the second kind.
            let angle = PI * (i as f64 + 1.0) / (POINTS as f64 + 1.0);
            let sine = libm::sin(angle);
            *point = (libm::cos(angle), 2.0 / (POINTS as f64 + 1.0) * sine * sine);
        }
        let spatial = match (level, curve) {
            (Some(level), Curve::Straight) => {
                let length_m = 2.0 * half_m;
                let size_m = (1e-3 * radius_mm, length_m);
                Some(Box::new(Spatial::new(rubber, size_m, level, RUBBER)?))
            }
            _ => None,
        };
        Ok(Ridge {
            curve,
            radius_m: 1e-3 * radius_mm,
            half_m,
            step_m,
            lengths: (0..count).map(middle).collect(),
            rubber: Rubber::new(rubber, radius_mm, place)?,
            met: vec![Pressed::default(); most],
            used: 0,
            points,
            spatial,
            asked: level.is_some(),
            lean: Lean::NONE,
            last: Meeting::default(),
        })
    }

    /// Length along the curve nearest to the pad's middle.
    fn nearest(&self, meeting: &Meeting) -> f64 {
        let middle = meeting.turn.transpose() * -meeting.place;
        self.curve.nearest(middle.truncate(), self.half_m)
    }

    /// Evaluates the contact.
    pub(super) fn press(&mut self, meeting: &Meeting, relaxation_s: f64) -> Sums {
        let mut sums = Sums::default();
        self.used = 0;
        self.last = *meeting;
        let near = self.nearest(meeting);
        let index = |s: f64| ((s + self.half_m) / self.step_m).max(0.0) as usize;
        let from = index(near - REACH_M);
        let to = (index(near + REACH_M) + 1).min(self.lengths.len());
        let mut widest = 0.0;
        for (i, (middle, along)) in self.lengths.iter().enumerate().take(to).skip(from) {
            let along = meeting.turn * along.extend(0.0);
            let ridge = meeting.place + meeting.turn * middle.extend(0.0);
            let axis = ridge - self.radius_m * meeting.turn.z_axis;
            // Out of the pad, across the length: there the rounding comes nearest.
            let out = (DVec3::Z - along.z * along).normalize_or_zero();
            let foot = axis - self.radius_m * out;
            let (at, delta_m) = (foot.truncate(), -foot.z);
            let reach = PAD_HALF_M + BEYOND_M;
            if !(delta_m > 0.0 && axis.z > 0.0) || at.abs().max_element() > reach {
                continue;
            }
            let response = self.rubber.at(delta_m);
            let flat = along.truncate();
            let s_m = (i as f64 + 0.5) * self.step_m - self.half_m;
            let plain_m = self.step_m * flat.length();
            let length_m = plain_m * self.lean.at(s_m);
            let rate = meeting.closing(at.x, at.y);
            let damping = response.stiffness_n_m2 * relaxation_s;
            let load_n = (response.load_n_m + damping * rate) * length_m;
            if load_n <= 0.0 {
                continue;
            }
            let across = flat.perp().normalize_or_zero();
            let half_width_m = response.half_width_m;
            let cover = on_pad(at);
            if let Some(pressed) = self.met.get_mut(self.used) {
                let plain_n = cover * response.load_n_m * plain_m;
                *pressed = Pressed { at, across, half_width_m, load_n, s_m, plain_n };
                self.used += 1;
            }
            let (part, h) = (cover * length_m, meeting.h);
            sums.add(at, cover * load_n, part * response.stiffness_n_m2 * (h + relaxation_s));
            sums.shear_n_m += part * response.shear_n_m2;
            if cover > 0.0 && delta_m > widest {
                widest = delta_m;
                sums.half_width_m = half_width_m;
                let carried = meeting.velocity + meeting.spin.cross(axis);
                sums.travel_m_s = carried.truncate().dot(across).abs();
            }
        }
        sums.deepest_m = widest;
        sums
    }

    /// What pressed at the latest evaluation.
    fn pressed(&self) -> &[Pressed] {
        &self.met[..self.used]
    }

    /// Adds the stresses of the latest evaluation (MPa). The theory's layer has no edges: lengths
    /// beyond the pad show at its border.
    pub(super) fn image(&mut self, shares: &Shares, image: &mut [f64; MAX_TACTELS]) -> Tally {
        if self.solved(image) {
            return Tally::of(self.lean);
        }
        self.lean = Lean::NONE;
        for pressed in self.pressed() {
            for (cosine, weight) in self.points {
                let at = 1e3 * (pressed.at + cosine * pressed.half_width_m * pressed.across);
                shares.add(image, at.to_array(), weight * pressed.load_n);
            }
        }
        if self.asked { Tally::PLAIN } else { Tally::default() }
    }

    /// Solves the contact in three dimensions where that is asked for, and adds its stresses.
    fn solved(&mut self, image: &mut [f64; MAX_TACTELS]) -> bool {
        let Some(spatial) = &mut self.spatial else { return false };
        let meeting = &self.last;
        let middle = meeting.place - self.radius_m * meeting.turn.z_axis;
        let size_m = (self.radius_m, 2.0 * self.half_m);
        let pin = Pin::at_rest(middle, &meeting.turn, size_m, 1.0);
        let face = Surface::of_pad(&Pose::IDENTITY, &Joints::zeros());
        let Some(line) = Line::between(&pin, pin.axis(), &face) else { return false };
        let solved = spatial.solve(&line, &Pose::IDENTITY).filter(|solved| solved.force_n > 0.0);
        let Some(solved) = solved else { return false };
        let met = &self.met[..self.used];
        let load_n: f64 = met.iter().map(|pressed| on_pad(pressed.at) * pressed.load_n).sum();
        // Viscous loads are spread as the elastic ones.
        let elastic_n: f64 = met.iter().map(|p| p.plain_n * self.lean.at(p.s_m)).sum();
        let damping = if elastic_n > 0.0 { (load_n / elastic_n).clamp(0.0, 2.0) } else { 1.0 };
        let per_mpa = damping / (1e6 * PITCH_M * PITCH_M);
        for (value, force) in image.iter_mut().zip(spatial.forces_n()) {
            *value -= per_mpa * force;
        }
        self.lean = self.lean_of(&solved);
        true
    }

    /// The factors on plane lengths that give them force and moment of a solution.
    fn lean_of(&self, solved: &Solved) -> Lean {
        let plain = self.pressed().iter().map(|pressed| (pressed.s_m, pressed.plain_n));
        crate::spatial::lean(plain, solved)
    }

    /// Where the ridge runs under the pad.
    pub(super) fn lie(&self, meeting: &Meeting) -> Lie {
        let along_m = self.nearest(meeting);
        let (place, direction) = self.curve.at(along_m);
        let to = meeting.place + meeting.turn * place.extend(0.0);
        let direction = meeting.turn * direction.extend(0.0);
        // Run towards the pad's y, whichever way the curve does.
        let sign = if direction.y < 0.0 { -1.0 } else { 1.0 };
        let flat = (sign * direction.truncate()).normalize_or_zero();
        Lie {
            off_m: to.x * flat.y - to.y * flat.x,
            yaw_rad: libm::atan2(-flat.x, flat.y),
            along_m,
            tilt_rad: DVec2::new(-libm::atan(sign * direction.z), 0.0),
        }
    }
}

#[cfg(test)]
impl Ridge {
    /// Distance from a place to the curve (m).
    pub(super) fn far(&self, from: DVec2) -> f64 {
        (self.curve.at(self.curve.nearest(from, self.half_m)).0 - from).length()
    }

    /// The same by trying every length.
    pub(super) fn far_by_search(&self, from: DVec2) -> f64 {
        let far = |i: i32| {
            let s = self.half_m * (f64::from(i) / 5000.0 - 1.0);
            (self.curve.at(s).0 - from).length()
        };
        (0..=10_000).map(far).fold(f64::INFINITY, f64::min)
    }
}
