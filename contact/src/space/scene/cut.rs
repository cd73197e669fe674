//! What derivatives of a scene need where the array's edge cuts the indenter. A motion then moves
//! the indenter with its ends, and the ends along it: what the second does is found once, for one
//! end or for a length, and not from another pin for every motion. An indenter is cut along its
//! axis only, so one that hangs over the array's side is refused.

use super::super::pin::ContactedEnds;
use super::super::pin::PlanarPose;
use super::{Invalid, Pose, Prescribed, Scene, Shape, Solver};

/// Steps of differences of where the array's edge cuts an axis, mm and rad.
const DIFFERENCE_STEP: f64 = 1e-6;

impl Scene {
    /// Holds the ends of a pressed pin that the array cuts; which of them the contact may touch,
    /// nothing of other indenters.
    pub(crate) fn hold_ends(&mut self) -> Option<ContactedEnds> {
        let Solver::Pin(pin) = &self.solver else { return None };
        let reach = pin.contacted_ends();
        let moves = self.is_cut || self.is_cut_in_tilt();
        if !moves || self.state.force_n <= 0.0 {
            return None;
        }
        self.held_ends = Some(self.ends());
        Some(reach)
    }

    /// Lets the array cut the indenter again.
    pub(crate) fn release_ends(&mut self) {
        self.held_ends = None;
    }

    /// Puts the indenter, as it was pressed last, elsewhere over the array: nothing of the contact
    /// changes but its place. Not for what is cut and not held.
    pub(crate) fn set_pose(&mut self, pose: Pose) {
        self.pose = pose;
    }

    /// Refuses what would press beside the pad with a part of its width: a bar that hangs over the
    /// array's side, a cylinder whose contact, so wide to each side, does.
    ///
    /// # Errors
    /// What its docs say.
    pub(super) fn check_overhang(
        &self,
        [from, to]: [f64; 2],
        half_width_mm: f64,
    ) -> Result<(), Invalid> {
        let PlanarPose { x_mm, y_mm, rot_rad } = self.pose.planar;
        if !self.is_cut {
            return Ok(());
        }
        let (s, c) = (libm::sin(rot_rad), libm::cos(rot_rad));
        let half = self.array.half_sides_mm();
        let over = if from < to {
            // Both sides of its middle.
            let v = 0.5 * (from + to);
            let inside = |u: f64| {
                let place = [x_mm - v * s + u * c, y_mm + v * c + u * s];
                place.iter().zip(half).all(|(place, half)| place.abs() <= half * (1.0 + 1e-9))
            };
            !(inside(half_width_mm) && inside(-half_width_mm))
        } else {
            // The axis passes by, or ends short of the array: how far it is beside the corners.
            let beside = |sx: f64, sy: f64| (sx * half[0] - x_mm) * c + (sy * half[1] - y_mm) * s;
            let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
            let away = corners.map(|(sx, sy)| beside(sx, sy));
            let least = away.iter().fold(f64::INFINITY, |least, u| least.min(u.abs()));
            let aside = away.iter().all(|u| *u > 0.0) || away.iter().all(|u| *u < 0.0);
            aside && least < half_width_mm
        };
        if !over {
            return Ok(());
        }
        let what = format!(
            "{half_width_mm} mm to each side of the axis reach over the array's side, and only \
             along it is it cut"
        );
        let remedy =
            "move it over the array, or give the part of a bar that is over it as a narrower bar";
        Err(Invalid::new(if c.abs() >= s.abs() { "x_mm" } else { "y_mm" }, what, remedy))
    }

    /// Half the width by which the indenter, so deep, stands into the layer's face: a bar's whole
    /// one.
    pub(super) fn half_overlap_mm(&self, depth_mm: f64) -> f64 {
        match self.shape {
            Shape::Bar { width_mm, .. } => 0.5 * width_mm,
            Shape::Cylinder { radius_mm, .. } => {
                let depth = depth_mm.clamp(0.0, radius_mm);
                (depth * (2.0 * radius_mm - depth)).sqrt()
            }
            Shape::Sphere { .. } | Shape::Edge { .. } => 0.0,
        }
    }

    /// Whether [`Scene::set_pose`] will do for motions along the array.
    pub(crate) fn keeps_contact(&self) -> bool {
        self.held_ends.is_some() || !(self.is_cut || self.is_cut_in_tilt())
    }

    /// How the ends move along the axis with a motion from a pose, of which `moved` tells the poses
    /// of an amount; and how much less or more on one side of it.
    pub(crate) fn ends_rate(&mut self, pose: Pose, moved: impl Fn(f64) -> Pose) -> [(f64, f64); 2] {
        let (before, held_ends) = (self.pose, self.held_ends.take());
        let mut at = |pose: Pose| {
            self.pose = pose;
            self.ends()
        };
        let (less, here, more) =
            (at(moved(-DIFFERENCE_STEP)), at(pose), at(moved(DIFFERENCE_STEP)));
        (self.pose, self.held_ends) = (before, held_ends);
        [0, 1].map(|end| {
            let sides = [more[end] - here[end], here[end] - less[end]];
            (
                0.5 * (sides[0] + sides[1]) / DIFFERENCE_STEP,
                0.5 * (sides[0] - sides[1]).abs() / DIFFERENCE_STEP,
            )
        })
    }

    /// Calls with the scene under a pin with both ends so much (mm) further out, pressed.
    ///
    /// # Errors
    /// What pressing it refuses.
    pub(crate) fn lengthened<T>(
        &mut self,
        prescribed: Prescribed,
        pose: Pose,
        by_mm: f64,
        of: impl FnOnce(&Self) -> Result<T, Invalid>,
    ) -> Result<Option<T>, Invalid> {
        let Solver::Pin(pin) = &self.solver else { return Ok(None) };
        let mut pin = pin.lengthened(by_mm)?;
        let state = pin.press(prescribed, pose.tilt_rad)?;
        let before = (self.state, self.pose);
        self.state.force_n = state.force_n;
        self.pose = pose;
        let solver = core::mem::replace(&mut self.solver, Solver::Pin(Box::new(pin)));
        let found = of(self);
        (self.state, self.pose) = before;
        self.solver = solver;
        found.map(Some)
    }
}
