//! What derivatives of a scene need where the array's edge cuts the indenter. A motion then moves
//! the indenter with its ends, and the ends along it: what the second does is found once, for one
//! end or for a length, and not from another pin for every motion. It refuses nothing of its own.

use super::super::pin::Reach;
use super::{Drive, Invalid, Pose, Scene, Solver};

/// Steps of differences of where the array's edge cuts an axis, mm and rad.
const NEAR: f64 = 1e-6;

impl Scene {
    /// Holds the ends of a pressed pin that the array cuts; which of them the contact may touch,
    /// nothing of other indenters.
    pub(crate) fn hold(&mut self) -> Option<Reach> {
        let Solver::Pin(pin) = &self.solver else { return None };
        let reach = pin.reach();
        let moves = self.cut || self.is_cut_in_tilt();
        if !moves || self.touch.force_n <= 0.0 {
            return None;
        }
        self.held = Some(self.ends());
        Some(reach)
    }

    /// Lets the array cut the indenter again.
    pub(crate) fn let_go(&mut self) {
        self.held = None;
    }

    /// Puts the indenter, as it was pressed last, elsewhere over the array: nothing of the contact
    /// changes but its place. Not for what is cut and not held.
    pub(crate) fn put(&mut self, pose: Pose) {
        self.pose = pose;
    }

    /// Whether [`Scene::put`] will do for motions along the array.
    pub(crate) fn is_carried(&self) -> bool {
        self.held.is_some() || !(self.cut || self.is_cut_in_tilt())
    }

    /// How the ends move along the axis with a motion from a pose, of which `moved` tells the poses
    /// of an amount; and how much less or more on one side of it.
    pub(crate) fn ends_rate(&mut self, pose: Pose, moved: impl Fn(f64) -> Pose) -> [(f64, f64); 2] {
        let (before, held) = (self.pose, self.held.take());
        let mut at = |pose: Pose| {
            self.pose = pose;
            self.ends()
        };
        let (less, here, more) = (at(moved(-NEAR)), at(pose), at(moved(NEAR)));
        (self.pose, self.held) = (before, held);
        [0, 1].map(|end| {
            let sides = [more[end] - here[end], here[end] - less[end]];
            (0.5 * (sides[0] + sides[1]) / NEAR, 0.5 * (sides[0] - sides[1]).abs() / NEAR)
        })
    }

    /// Calls with the scene under a pin with both ends so much (mm) further out, pressed.
    ///
    /// # Errors
    /// What pressing it refuses.
    pub(crate) fn lengthened<T>(
        &mut self,
        (drive, pose): (Drive, Pose),
        by_mm: f64,
        of: impl FnOnce(&Self) -> Result<T, Invalid>,
    ) -> Result<Option<T>, Invalid> {
        let Solver::Pin(pin) = &self.solver else { return Ok(None) };
        let mut pin = pin.lengthened(by_mm)?;
        let state = pin.press(drive, pose.tilt_rad)?;
        let before = (self.touch, self.pose);
        self.touch.force_n = state.force_n;
        self.pose = pose;
        let solver = core::mem::replace(&mut self.solver, Solver::Pin(Box::new(pin)));
        let found = of(self);
        (self.touch, self.pose) = before;
        self.solver = solver;
        found.map(Some)
    }
}
