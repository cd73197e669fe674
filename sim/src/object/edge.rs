//! A plate on its edge: a rounded ridge along a curve, cut into short sections. Each section
//! presses as in plane strain across its own direction; the image is that of all loads in three
//! dimensions. Ends and corners press as if the ridge continued; this module's tests measure the
//! error of that. Where the scene asks for three dimensions, a straight ridge is solved at every
//! image, as the pin is. A radius of the ridge that the contact of a cylinder does not allow is an
//! error.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::space::tactels::Shares;
use taktil_mechanics::{Joints, Pose};

use super::pad::pad_layer;
use super::{ContactLoad, ObjectPlacement, RelativeMotion, on_pad};
use crate::contact::{ContactLine, LoadFactor, Surface};
use crate::pin::{CylinderSize, Pin};
use crate::rubber::Rubber;
use crate::scene::{EdgeProfile, Invalid, ObjectConfig};
use crate::spatial::{PadSection, SolveCounts, SpatialLoad, SpatialSolver};
use crate::square_cells::SquareCells;

/// Longest section (m).
const SECTION_LENGTH_MAX_M: f64 = 0.5e-3;
/// Shortest distance along the curve from the place nearest to the pad's middle up to which
/// sections are evaluated (m), and what this distance exceeds half the pad's diagonal by at least.
const SEARCH_REACH_MIN_M: f64 = 22e-3;
const SEARCH_MARGIN_M: f64 = 4e-3;
/// Distance beyond the pad up to which loads show at its border (m).
const IMAGE_MARGIN_M: f64 = 3e-3;
/// Number of point loads that represent the pressure across a section.
const PRESSURE_POINT_COUNT: usize = 6;

/// The curve seen from above, in the object's frame.
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
            EdgeProfile::Arc => Curve::Arc(1e3 / config.arc_radius_mm.unwrap_or(f64::INFINITY)),
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

/// One loaded section in the pad's frame.
#[derive(Clone, Copy, Debug, Default)]
struct LoadedSection {
    at: DVec2,
    across: DVec2,
    half_width_m: f64,
    load_n: f64,
    /// Place along the curve (m), and the elastic load on the pad of the plane solution (N).
    s_m: f64,
    plane_load_n: f64,
}

/// The edge with the contact of its rounding.
#[derive(Clone, Debug)]
pub(super) struct EdgeContact {
    /// Half the pad's sides, the area of a tactel in mm^2, and the distance along the curve up to
    /// which sections are evaluated (m).
    pad_half_m: DVec2,
    tactel_mm2: f64,
    reach_m: f64,
    curve: Curve,
    radius_m: f64,
    half_m: f64,
    step_m: f64,
    /// Middle and direction of each section in the object's frame.
    lengths: Vec<(DVec2, DVec2)>,
    rubber: Rubber,
    /// Sections that were loaded at the latest evaluation: the first `loaded_count`. The vector has
    /// room for all that can be loaded, also in a clone.
    sections: Vec<LoadedSection>,
    loaded_count: usize,
    /// Places of the point loads across a section, as cosines, and their weights.
    points: [(f64, f64); PRESSURE_POINT_COUNT],
    /// The solver in three dimensions, for straight edges of scenes that ask for it.
    spatial: Option<Box<SpatialSolver>>,
    /// Whether the scene asks for three dimensions.
    pub(super) is_spatial: bool,
    /// Ratio of the sections' loads to their plane solutions.
    pub(super) load_factor: LoadFactor,
    /// The relative motion at the latest evaluation.
    latest_motion: RelativeMotion,
}

impl EdgeContact {
    /// Builds the contact of an edge; `level` asks for three dimensions, `place` is the object's
    /// place in the scene.
    pub(super) fn new(
        config: &ObjectConfig,
        pad: &PadSection<'_>,
        level: Option<Accuracy>,
        place: &str,
    ) -> Result<EdgeContact, Invalid> {
        let radius_mm = config.radius();
        // Errors of the rubber itself are reported at the rubber's place.
        pad_layer(pad.rubber)?;
        let reach_m = SEARCH_REACH_MIN_M.max(pad.array.half_diagonal_m() + SEARCH_MARGIN_M);
        let (curve, half_m) = (Curve::of(config), 0.5e-3 * config.length());
        // A corner is a border between two sections.
        let each = libm::ceil(half_m / SECTION_LENGTH_MAX_M).max(1.0);
        let step_m = half_m / each;
        let count = 2 * each as usize;
        let most = 2 * (reach_m / step_m) as usize + 4;
        let middle = |i: usize| curve.at((i as f64 + 0.5) * step_m - half_m);
        let mut points = [(0.0, 0.0); PRESSURE_POINT_COUNT];
        for (i, point) in points.iter_mut().enumerate() {
            // These are places and weights of the Gauss-Chebyshev rule of the second kind.
            let angle = PI * (i as f64 + 1.0) / (PRESSURE_POINT_COUNT as f64 + 1.0);
            let sine = libm::sin(angle);
            *point = (libm::cos(angle), 2.0 / (PRESSURE_POINT_COUNT as f64 + 1.0) * sine * sine);
        }
        let spatial = match (level, curve) {
            (Some(level), Curve::Straight) => {
                let length_m = 2.0 * half_m;
                let size = CylinderSize { radius_m: 1e-3 * radius_mm, length_m };
                Some(Box::new(SpatialSolver::new(pad, size, level)?))
            }
            _ => None,
        };
        Ok(EdgeContact {
            pad_half_m: pad.array.half_sides_m(),
            tactel_mm2: pad.array.tactel_mm2(),
            reach_m,
            curve,
            radius_m: 1e-3 * radius_mm,
            half_m,
            step_m,
            lengths: (0..count).map(middle).collect(),
            rubber: Rubber::new(pad.rubber, radius_mm, place)?,
            sections: vec![LoadedSection::default(); most],
            loaded_count: 0,
            points,
            spatial,
            is_spatial: level.is_some(),
            load_factor: LoadFactor::ONE,
            latest_motion: RelativeMotion::default(),
        })
    }

    /// Length along the curve nearest to the pad's middle.
    fn nearest(&self, motion: &RelativeMotion) -> f64 {
        let middle = motion.turn.transpose() * -motion.place;
        self.curve.nearest(middle.truncate(), self.half_m)
    }

    /// Evaluates the contact at a relative motion.
    pub(super) fn evaluate(&mut self, motion: &RelativeMotion, relaxation_s: f64) -> ContactLoad {
        let mut sums = ContactLoad::default();
        self.loaded_count = 0;
        self.latest_motion = *motion;
        let near = self.nearest(motion);
        let index = |s: f64| ((s + self.half_m) / self.step_m).max(0.0) as usize;
        let from = index(near - self.reach_m);
        let to = (index(near + self.reach_m) + 1).min(self.lengths.len());
        let mut widest = 0.0;
        for (i, (middle, along)) in self.lengths.iter().enumerate().take(to).skip(from) {
            let along = motion.turn * along.extend(0.0);
            let crest = motion.place + motion.turn * middle.extend(0.0);
            let axis = crest - self.radius_m * motion.turn.z_axis;
            // Across the section, out of the pad, the rounding comes nearest to the pad.
            let out = (DVec3::Z - along.z * along).normalize_or_zero();
            let foot = axis - self.radius_m * out;
            let (at, delta_m) = (foot.truncate(), -foot.z);
            let beyond = (at.abs() - self.pad_half_m).max_element();
            if !(delta_m > 0.0 && axis.z > 0.0) || beyond > IMAGE_MARGIN_M {
                continue;
            }
            let response = self.rubber.at(delta_m);
            let flat = along.truncate();
            let s_m = (i as f64 + 0.5) * self.step_m - self.half_m;
            let plane_length_m = self.step_m * flat.length();
            let length_m = plane_length_m * self.load_factor.at(s_m);
            let rate = motion.closing(at.x, at.y);
            let damping = response.stiffness_n_m2 * relaxation_s;
            let load_n = (response.load_n_m + damping * rate) * length_m;
            if load_n <= 0.0 {
                continue;
            }
            let across = flat.perp().normalize_or_zero();
            let half_width_m = response.half_width_m;
            let cover = on_pad(at, self.pad_half_m);
            if let Some(section) = self.sections.get_mut(self.loaded_count) {
                let plane_load_n = cover * response.load_n_m * plane_length_m;
                *section = LoadedSection { at, across, half_width_m, load_n, s_m, plane_load_n };
                self.loaded_count += 1;
            }
            let (part, h) = (cover * length_m, motion.h);
            sums.add(at, cover * load_n, part * response.stiffness_n_m2 * (h + relaxation_s));
            sums.shear_n_m += part * response.shear_n_m2;
            if cover > 0.0 && delta_m > widest {
                widest = delta_m;
                sums.half_width_m = half_width_m;
                let carried = motion.velocity + motion.spin.cross(axis);
                sums.travel_m_s = carried.truncate().dot(across).abs();
            }
        }
        sums.deepest_m = widest;
        sums
    }

    /// The sections that were loaded at the latest evaluation.
    fn section(&self) -> &[LoadedSection] {
        &self.sections[..self.loaded_count]
    }

    /// Adds the stresses of the latest evaluation (MPa). The theory's layer has no edges: sections
    /// beyond the pad show at its border.
    pub(super) fn image(
        &mut self,
        shares: &Shares,
        cells: &mut SquareCells,
        image: &mut [f64],
    ) -> SolveCounts {
        if self.solve_in_three_dimensions(image) {
            return SolveCounts::of(self.load_factor);
        }
        self.load_factor = LoadFactor::ONE;
        cells.add(image, |_, image| {
            for section in self.section() {
                for (cosine, weight) in self.points {
                    let at = 1e3 * (section.at + cosine * section.half_width_m * section.across);
                    shares.add(image, at.to_array(), weight * section.load_n);
                }
            }
        });
        if self.is_spatial { SolveCounts::UNSOLVED } else { SolveCounts::default() }
    }

    /// Solves the contact in three dimensions where the scene asks for it, and adds its stresses.
    /// Returns whether it did.
    fn solve_in_three_dimensions(&mut self, image: &mut [f64]) -> bool {
        let Some(spatial) = &mut self.spatial else { return false };
        let motion = &self.latest_motion;
        let middle = motion.place - self.radius_m * motion.turn.z_axis;
        let size = CylinderSize { radius_m: self.radius_m, length_m: 2.0 * self.half_m };
        let pin = Pin::at_rest(middle, &motion.turn, size, 1.0);
        let face = Surface::of_pad(&Pose::IDENTITY, &Joints::zeros());
        let Some(line) = ContactLine::on_pad(&pin, pin.axis(), &face) else { return false };
        let solved = spatial.solve(&line, &Pose::IDENTITY).filter(|solved| solved.force_n > 0.0);
        let Some(solved) = solved else { return false };
        let sections = &self.sections[..self.loaded_count];
        let half = self.pad_half_m;
        let load_n: f64 =
            sections.iter().map(|section| on_pad(section.at, half) * section.load_n).sum();
        // Viscous loads have the same distribution as elastic loads.
        let elastic_n: f64 =
            sections.iter().map(|p| p.plane_load_n * self.load_factor.at(p.s_m)).sum();
        let damping = if elastic_n > 0.0 { (load_n / elastic_n).clamp(0.0, 2.0) } else { 1.0 };
        let per_mpa = damping / self.tactel_mm2;
        for (value, force) in image.iter_mut().zip(spatial.tactel_forces_n()) {
            *value -= per_mpa * force;
        }
        self.load_factor = self.load_factor_of(&solved);
        true
    }

    /// The load factor that gives the plane sections force and moment of a solution.
    fn load_factor_of(&self, solved: &SpatialLoad) -> LoadFactor {
        let plain = self.section().iter().map(|section| (section.s_m, section.plane_load_n));
        crate::spatial::load_factor(plain, self.pad_half_m.y, solved)
    }

    /// The placement of the edge under the pad.
    pub(super) fn placement(&self, motion: &RelativeMotion) -> ObjectPlacement {
        let along_m = self.nearest(motion);
        let (place, direction) = self.curve.at(along_m);
        let to = motion.place + motion.turn * place.extend(0.0);
        let direction = motion.turn * direction.extend(0.0);
        // The direction is chosen towards the pad's y, whichever way the curve runs.
        let sign = if direction.y < 0.0 { -1.0 } else { 1.0 };
        let flat = (sign * direction.truncate()).normalize_or_zero();
        ObjectPlacement {
            off_m: to.x * flat.y - to.y * flat.x,
            yaw_rad: libm::atan2(-flat.x, flat.y),
            along_m,
            tilt_rad: DVec2::new(-libm::atan(sign * direction.z), 0.0),
        }
    }
}

#[cfg(test)]
impl EdgeContact {
    /// Distance from a place to the curve (m).
    pub(super) fn distance(&self, from: DVec2) -> f64 {
        (self.curve.at(self.curve.nearest(from, self.half_m)).0 - from).length()
    }

    /// The same distance, found by trying every place.
    pub(super) fn distance_by_search(&self, from: DVec2) -> f64 {
        let far = |i: i32| {
            let s = self.half_m * (f64::from(i) / 5000.0 - 1.0);
            (self.curve.at(s).0 - from).length()
        };
        (0..=10_000).map(far).fold(f64::INFINITY, f64::min)
    }
}
