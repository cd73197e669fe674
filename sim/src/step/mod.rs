//! The plant: the bodies on the bench and their motion over a span of time. This module chooses the
//! integrator and the number of steps, and halves a step in which something happens. Clocks,
//! commands and devices belong to the world.
//!
//! A step of the implicit integrator is repeated in halves, four times at most, when finger or
//! table gain or lose the pin within it, when a joint reaches its stop, when its estimated error is
//! beyond [`STEP_ERROR_MAX_M`], or when its equations did not converge.

mod implicit;
mod matrix;

use taktil_hal::Nanos;

use taktil_mechanics::Joints;

use crate::hash::Hash;
use crate::manipulator::{ArmState, Coordinates};
use crate::object::{ObjectBristles, Objects};
use crate::rolling::{PinState, RollingPin};
use crate::scene::fidelity::Integrator;
use crate::spatial::SolveCounts;
use crate::surroundings::Surroundings;
use crate::table::Table;
use implicit::StageRoom;
pub(crate) use implicit::WarmStart;

/// Estimated error of a place above which a step is halved (m).
pub(crate) const STEP_ERROR_MAX_M: f64 = 2e-6;
/// Change of speed below which the forces of a step's last iteration are those of its end (m/s):
/// contacts of 1e5 N/m that relax within 1 ms change by 1e-5 N.
const CONTACT_SPEED_TOLERANCE_M_S: f64 = 1e-7;
/// How often a step is halved at most.
const HALVINGS_MAX: u32 = 4;

/// Counts of what the simulation computed since the start; nothing here is a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepStatistics {
    /// Steps of any integrator, halved ones included.
    pub steps: u64,
    /// Steps that were repeated in halves.
    pub halved_steps: u64,
    /// Implicit steps that did not converge and were taken nevertheless.
    pub unconverged_steps: u64,
    /// Newton iterations of implicit stages.
    pub newton_iterations: u64,
    /// Evaluations of the contacts of pin and objects.
    pub contact_evaluations: u64,
    /// Tactile images computed from a contact.
    pub tactile_images: u64,
    /// Contacts that were solved in three dimensions for an image.
    pub spatial_solutions: u64,
    /// Loaded contacts of scenes that ask for three dimensions whose image was made from
    /// independent rows: the solver's tables ended, no solver exists for that shape, or the force
    /// of the solution was far from the force of the rows.
    pub spatial_failures: u64,
    /// Scans converted to counts.
    pub tactile_scans: u64,
}

impl StepStatistics {
    fn add(&mut self, counts: SolveCounts) {
        self.spatial_solutions += counts.solutions;
        self.spatial_failures += counts.failures;
    }
}

/// The integrator, chosen when the bench is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Method {
    Euler,
    Rk4,
    Implicit,
}

/// The bodies that move, and how they are integrated: a finger of `J` coordinates and a pin, with
/// `U` unknown speeds together.
#[derive(Clone, Debug)]
pub(crate) struct Plant<const J: usize = 6, const U: usize = 12> {
    pub(crate) finger: Box<dyn Coordinates<J>>,
    pub(crate) rolling: Option<Box<RollingPin>>,
    pub(crate) objects: Option<Box<Objects>>,
    pub(crate) table: Table,
    pub(crate) method: Method,
    pub(crate) substep: Nanos,
    /// Largest estimated error of a step that was taken (m).
    pub(crate) error_m: f64,
    pub(crate) statistics: StepStatistics,
    /// The warm start of the next implicit step.
    pub(crate) warm_start: WarmStart<U>,
    /// Whether the contacts were evaluated at the present state.
    pub(crate) contacts_current: bool,
    /// Room for the states of an implicit step; present with that method.
    pub(crate) room: Option<Box<StepRoom<J>>>,
}

/// The state at the start of a step, for repeating the step.
#[derive(Clone, Debug, Default)]
struct SavedState<const J: usize> {
    arm: ArmState<J>,
    pin: Option<PinState>,
    bristles: ObjectBristles,
}

/// The states that an implicit step compares and combines, made with the bench so that no step
/// allocates.
#[derive(Clone, Debug)]
pub(crate) struct StepRoom<const J: usize> {
    /// The starts of a step and of its halves, one for each depth of halving.
    starts: [SavedState<J>; HALVINGS_MAX as usize + 1],
    stages: StageRoom<J>,
}

impl<const J: usize> StepRoom<J> {
    /// Room for the states of a bench with this pin; none for a method that needs none.
    pub(crate) fn new(method: Method, rolling: Option<&RollingPin>) -> Option<Box<StepRoom<J>>> {
        let state = || SavedState { pin: rolling.map(RollingPin::state), ..SavedState::default() };
        let room = || StepRoom {
            starts: core::array::from_fn(|_| state()),
            stages: StageRoom::new(state),
        };
        (method == Method::Implicit).then(|| Box::new(room()))
    }
}

impl Method {
    /// The method for an integrator that a scene names; `smooth` says whether all forces are
    /// smooth.
    pub(crate) fn of(integrator: Integrator, smooth: bool) -> Method {
        match integrator {
            Integrator::Euler => Method::Euler,
            Integrator::Implicit => Method::Implicit,
            Integrator::Rk4 => Method::Rk4,
            Integrator::Auto if smooth => Method::Rk4,
            Integrator::Auto => Method::Implicit,
        }
    }
}

impl<const J: usize, const U: usize> Plant<J, U> {
    /// Moves all bodies from `from` to `to`.
    pub(crate) fn integrate(&mut self, from: Nanos, to: Nanos) {
        let span = to - from;
        let steps = (span.0 + self.substep.0 - 1) / self.substep.0;
        let h = span.as_secs_f64() / steps as f64;
        let start_s = from.as_secs_f64();
        let mut room = self.room.take();
        for i in 0..steps {
            let t_s = start_s + h * i as f64;
            match (self.method, room.as_deref_mut()) {
                (Method::Rk4, _) => self.step_rk4_halved(h, 0),
                (Method::Implicit, Some(StepRoom { starts, stages })) => {
                    self.step_implicit(from, t_s, h, starts, stages);
                }
                (Method::Euler | Method::Implicit, _) => self.step_euler(from, t_s, h),
            }
        }
        self.room = room;
        // Explicit steps of an arm reuse the Jacobian of an earlier step on purpose. Every other
        // method, and every prescribed motion, needs the kinematics of the present state here.
        if self.method != Method::Euler || self.finger.is_prescribed() {
            self.finger.update_kinematics(to.as_secs_f64());
        }
    }

    fn save(&self, saved: &mut SavedState<J>) {
        if let (Some(rolling), Some(pin)) = (&self.rolling, &mut saved.pin) {
            rolling.save(pin);
        }
        saved.bristles =
            self.objects.as_ref().map_or(ObjectBristles::default(), |objects| objects.bristles());
        saved.arm = *self.finger.state();
    }

    fn restore(&mut self, saved: &SavedState<J>) {
        *self.finger.state_mut() = saved.arm;
        if let (Some(rolling), Some(pin)) = (&mut self.rolling, &saved.pin) {
            rolling.restore(pin);
        }
        if let Some(objects) = &mut self.objects {
            objects.restore(&saved.bristles);
        }
    }

    /// The places and motions of finger, pad and table at an instant.
    pub(crate) fn surroundings(&self, t_s: f64) -> Surroundings {
        let (_, table_axes, table) = self.table.at(t_s);
        Surroundings { pad: *self.finger.pose(), finger: self.finger.surface(), table, table_axes }
    }

    /// Evaluates the contacts of the present state, unless the step that led there did so.
    pub(crate) fn evaluate_contacts(&mut self, t_s: f64) {
        if core::mem::replace(&mut self.contacts_current, true) {
            return;
        }
        let surroundings = self.surroundings(t_s);
        if let Some(rolling) = &mut self.rolling {
            self.statistics.contact_evaluations += 1;
            rolling.evaluate(&surroundings, 0.0);
        }
        if let Some(objects) = &mut self.objects {
            self.statistics.contact_evaluations += 1;
            objects.evaluate(&surroundings, 0.0);
        }
    }

    /// Writes the normal force on each tactel of the finger (N); zero when the scene has nothing to
    /// touch.
    pub(crate) fn image(&mut self, t_s: f64, forces: &mut [f64]) {
        if self.rolling.is_some() || self.objects.is_some() {
            self.statistics.tactile_images += 1;
        }
        let surroundings = self.surroundings(t_s);
        if let Some(rolling) = &mut self.rolling {
            let counts = rolling.image(&surroundings, forces);
            self.statistics.add(counts);
        } else {
            forces.fill(0.0);
        }
        if let Some(objects) = &mut self.objects {
            self.statistics.add(objects.image(forces));
        }
    }

    /// Writes the normal force on each tactel of the opposed fingertip (N).
    pub(crate) fn opposed_image(&mut self, t_s: f64, forces: &mut [f64]) {
        let surroundings = self.surroundings(t_s);
        let Some(rolling) = &mut self.rolling else { return };
        let counts = rolling.opposed_image(&surroundings, forces);
        self.statistics.tactile_images += 1;
        self.statistics.add(counts);
    }

    /// Writes the normal force on each tactel of a finger of a hand (N); nothing where the
    /// manipulator is none.
    pub(crate) fn hand_image(&mut self, finger: usize, forces: &mut [f64]) {
        if let Some(hand) = self.finger.grasp() {
            hand.image(finger, forces);
            self.statistics.tactile_images += 1;
        }
    }

    /// One step of semi-implicit Euler, explicit in every force.
    fn step_euler(&mut self, now: Nanos, t_s: f64, h: f64) {
        self.statistics.steps += 1;
        self.contacts_current = false;
        let mut wrench = Joints::zeros();
        if self.rolling.is_some() {
            let surroundings = self.surroundings(t_s);
            if let Some(rolling) = &mut self.rolling {
                self.statistics.contact_evaluations += 1;
                rolling.evaluate(&surroundings, h);
                rolling.update_fixture(now);
                wrench = rolling.wrench(surroundings.finger.origin);
                rolling.step(&surroundings, h);
            }
        }
        self.finger.step_from(t_s, h, &wrench);
        let work = self.finger.take_work();
        self.statistics.newton_iterations += work.iterations;
        self.statistics.unconverged_steps += work.unconverged;
    }

    /// One Runge-Kutta step of the arm alone; a step that ends beyond a stop is halved to approach
    /// the instant of the impact.
    fn step_rk4_halved(&mut self, h: f64, depth: u32) {
        let before = *self.finger.state();
        self.statistics.steps += 1;
        self.finger.step_rk4(h);
        if !self.finger.is_beyond_limits() {
            return;
        }
        if depth < HALVINGS_MAX {
            *self.finger.state_mut() = before;
            self.statistics.halved_steps += 1;
            self.step_rk4_halved(0.5 * h, depth + 1);
            self.step_rk4_halved(0.5 * h, depth + 1);
            return;
        }
        self.finger.stop_at_limits();
    }

    fn contact_flags(&self) -> (bool, bool, u8) {
        let loaded =
            |r: &RollingPin| (r.finger_reaction.normal_n > 0.0, r.support_reaction.normal_n > 0.0);
        let (finger, table) = self.rolling.as_deref().map_or((false, false), loaded);
        (finger, table, self.objects.as_ref().map_or(0, |objects| objects.contact_bits()))
    }

    /// One implicit step, repeated in halves when something happens within it. `starts` has room
    /// for the start of this step and, behind it, for those of its halves: as many levels as a step
    /// may still be halved.
    fn step_implicit(
        &mut self,
        now: Nanos,
        t_s: f64,
        h: f64,
        starts: &mut [SavedState<J>],
        stages: &mut StageRoom<J>,
    ) {
        let Some((saved, of_halves)) = starts.split_first_mut() else { return };
        self.save(saved);
        let before = self.contact_flags();
        let mut outcome = self.step_sdirk(saved, stages, t_s, h);
        self.statistics.steps += 1;
        self.statistics.newton_iterations += u64::from(outcome.iterations);
        let happened = self.contact_flags() != before || self.finger.is_beyond_limits();
        let coarse = outcome.error_m > STEP_ERROR_MAX_M || !outcome.has_converged;
        if !of_halves.is_empty() && (happened || coarse) {
            self.restore(saved);
            self.warm_start.clear();
            self.statistics.halved_steps += 1;
            self.step_implicit(now, t_s, 0.5 * h, of_halves, stages);
            self.step_implicit(now, t_s + 0.5 * h, 0.5 * h, of_halves, stages);
            return;
        }
        if coarse {
            self.restore(saved);
            outcome = self.step_backward_euler(saved, stages, t_s, h);
            self.statistics.newton_iterations += u64::from(outcome.iterations);
        } else if happened {
            self.warm_start.clear();
        }
        self.contacts_current = outcome.last_change_m_s < CONTACT_SPEED_TOLERANCE_M_S
            && !self.finger.is_beyond_limits();
        self.finger.stop_at_limits();
        self.statistics.unconverged_steps += u64::from(!outcome.has_converged);
        self.error_m = self.error_m.max(outcome.error_m);
        if let Some(rolling) = &mut self.rolling {
            rolling.update_fixture(now);
        }
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.finger.digest(hash);
        if let Some(rolling) = &self.rolling {
            rolling.digest(hash);
        }
        if let Some(objects) = &self.objects {
            objects.digest(hash);
        }
        self.warm_start.digest(hash);
    }
}

#[cfg(test)]
mod tests;
