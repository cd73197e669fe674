//! Supports the derivatives of a scene in which the edge of the array cuts the indenter. A motion
//! then has two effects: it moves the indenter with its ends, and it moves the ends along the
//! indenter. The second effect is differentiated only once, by one end or by the length, instead of
//! solving another pin for every motion. An indenter can be cut along its axis only, so one that
//! hangs over the side of the array is an error.

use super::super::pin::ContactedEnds;
use super::super::pin::PlanarPose;
use super::{Invalid, Pose, Prescribed, Scene, Shape, Solver};

/// Step of the differences of the place at which the array's edge cuts the axis, mm or rad.
const DIFFERENCE_STEP: f64 = 1e-6;

impl Scene {
    /// Fixes the ends of a pressed pin that the array cuts. Returns which of them the contact may
    /// reach, and `None` for indenters that are not cut.
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

    /// Moves the last contact to another place over the array without solving it again. This is
    /// only right if [`Scene::keeps_contact`] holds.
    pub(crate) fn set_pose(&mut self, pose: Pose) {
        self.pose = pose;
    }

    /// Checks that the whole width of the contact is over the pad.
    ///
    /// # Errors
    /// A bar, or a cylinder's contact of half-width `half_width_mm`, that hangs over the side of
    /// the array.
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
            // Both sides at the middle of the axis have to be over the array.
            let v = 0.5 * (from + to);
            let inside = |u: f64| {
                let place = [x_mm - v * s + u * c, y_mm + v * c + u * s];
                place.iter().zip(half).all(|(place, half)| place.abs() <= half * (1.0 + 1e-9))
            };
            !(inside(half_width_mm) && inside(-half_width_mm))
        } else {
            // The axis does not cross the array: its distance from the corners decides.
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
            "{half_width_mm} mm to each side of the axis extend beyond the side of the array, but \
             an indenter can only be cut along its axis"
        );
        let remedy =
            "move it over the array, or replace a bar by the narrower part that is over the array";
        Err(Invalid::new(if c.abs() >= s.abs() { "x_mm" } else { "y_mm" }, what, remedy))
    }

    /// Half the width over which the indenter at a depth overlaps the undeformed layer; for a bar
    /// half its full width.
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

    /// Whether a motion along the array leaves the contact as it is, so that [`Scene::set_pose`]
    /// may replace another solution.
    pub(crate) fn keeps_contact(&self) -> bool {
        self.held_ends.is_some() || !(self.is_cut || self.is_cut_in_tilt())
    }

    /// For each end the derivative of its place along the axis by a motion, where `moved` gives the
    /// pose after an amount of the motion, and half the difference between the one-sided
    /// derivatives.
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

    /// Calls `of` with the scene in which the pin is longer by `by_mm` at both ends and pressed.
    ///
    /// # Errors
    /// The errors of the pin's solver.
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
