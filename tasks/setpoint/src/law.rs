//! Selects the source of the joint setpoints and checks its goals. No path is planned here: a goal
//! is accepted as it is or refused.
//!
//! ```text
//!   mode without torque ──> desired := measured
//!   STOPPING ────────────> slow down to rest
//!   any other mode:
//!     START, IDLE ───────────────────> slow down to rest, hold
//!     MANUAL ────────────────────────> goal of the jog ────────┐
//!     TRAJECTORY, TRAJECTORY/USER ───> goal of the trajectory ─┤  none, stale, refused:
//!     TACTILE-SERVO ─────────────────> goal of the tactile servo ┴> slow down to rest, hold
//! ```

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{FaultCode, Fold, Mode, StateHash};
use taktil_signal::{Desired, Goal, JointState, State};

/// A goal may step by this multiple of the largest speed times the time that passed.
pub const STEP_MARGIN: f64 = 1.5;

/// A source of desired joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// No source: the arm stands still.
    Hold,
    /// The goal of `jog`.
    Jog,
    /// The goal of `trajectory`.
    Trajectory,
    /// The goal of `tactile_servo`.
    Tactile,
}

/// The source of each state.
#[must_use]
pub const fn source(state: State) -> Source {
    match state {
        State::Start | State::IdleUncalibrated | State::IdleCalibrated => Source::Hold,
        State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian => Source::Jog,
        State::Trajectory | State::TrajectoryUser => Source::Trajectory,
        State::TactileServo => Source::Tactile,
    }
}

/// Bounds that a goal has to keep, rad, rad/s, s.
#[derive(Clone, Debug)]
pub struct Bounds<const N: usize = 6> {
    /// Lower joint limits.
    pub q_min_rad: JointVector<N>,
    /// Upper joint limits.
    pub q_max_rad: JointVector<N>,
    /// Largest speeds.
    pub v_max_rad_s: JointVector<N>,
    /// How far the first goal of a source may be from the desired joints.
    pub bumpless_rad: f64,
    /// How far desired joints may be from the measured ones.
    pub lead_max_rad: f64,
    /// Time in which motion without a source comes to rest.
    pub stop_time_s: f64,
}

/// The inputs of one job.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<const N: usize = 6> {
    /// Newest measured joints.
    pub measured: JointState<N>,
    /// What the supervisor decided.
    pub state: State,
    /// Whether torque may flow.
    pub mode: Mode,
    /// Goal of the jog, unless absent or stale.
    pub jog: Option<Goal<N>>,
    /// Goal of the trajectory, unless absent or stale.
    pub trajectory: Option<Goal<N>>,
    /// Goal of the tactile servo, unless absent or stale.
    pub tactile: Option<Goal<N>>,
    /// Time since the last job, s.
    pub dt_s: f64,
}

/// The source that was accepted, with the goal last taken from it.
#[derive(Clone, Copy, Debug)]
struct Accepted<const N: usize> {
    source: Source,
    goal_rad: JointVector<N>,
}

/// The desired joints and what is needed to move them on.
#[derive(Clone, Debug)]
pub struct Law<const N: usize = 6> {
    bounds: Bounds<N>,
    q_rad: JointVector<N>,
    qd_rad_s: JointVector<N>,
    /// Deceleration under way, rad/s^2, not negative.
    brake_rad_s2: JointVector<N>,
    measured_rad: JointVector<N>,
    datum: Option<u32>,
    accepted: Option<Accepted<N>>,
}

impl<const N: usize> Fold for Law<N> {
    fn fold(&self, hash: &mut StateHash) {
        for joints in [&self.q_rad, &self.qd_rad_s, &self.brake_rad_s2, &self.measured_rad] {
            hash.add(joints.as_slice());
        }
        hash.add(&self.datum).add(&self.accepted.is_some());
        if let Some(Accepted { source, goal_rad }) = &self.accepted {
            hash.add(&(*source as u32)).add(goal_rad.as_slice());
        }
    }
}

impl<const N: usize> Law<N> {
    /// Nothing is desired before the first [`Law::step`].
    #[must_use]
    pub fn new(bounds: Bounds<N>) -> Law<N> {
        let zero = JointVector::zeros();
        Law {
            bounds,
            q_rad: zero,
            qd_rad_s: zero,
            brake_rad_s2: zero,
            measured_rad: zero,
            datum: None,
            accepted: None,
        }
    }

    /// One job: the desired joints, and the fault for which a goal was refused. A refused goal
    /// counts as no goal.
    ///
    /// Faults: [`FaultCode::NotBumpless`], [`FaultCode::SetpointJump`], [`FaultCode::SoftLimit`].
    pub fn step(&mut self, inputs: &Inputs<N>) -> (Desired<N>, Result<(), FaultCode>) {
        self.rebase(&inputs.measured);
        let mut fault = Ok(());
        if !inputs.mode.torque_allowed() {
            self.q_rad = self.measured_rad;
            self.reset();
        } else {
            let source =
                if inputs.mode == Mode::Stopping { Source::Hold } else { source(inputs.state) };
            let goal = match source {
                Source::Hold => None,
                Source::Jog => inputs.jog,
                Source::Trajectory => inputs.trajectory,
                Source::Tactile => inputs.tactile,
            };
            let taken = match goal.filter(|goal| goal.valid == 1) {
                Some(goal) => self.accept(source, &goal, inputs),
                None => {
                    self.accepted = None;
                    Ok(false)
                }
            };
            if taken != Ok(true) {
                self.slow_down(inputs);
            }
            fault = taken.map(|_| ());
        }
        let desired = Desired {
            q_rad: self.q_rad.into(),
            qd_rad_s: self.qd_rad_s.into(),
            source: inputs.state as u32,
            valid: 1,
        };
        (desired, fault)
    }

    /// Takes the measurement; when the zero of the angles has moved, the desired angles move with
    /// it.
    fn rebase(&mut self, measured: &JointState<N>) {
        let now_rad = JointVector::from(measured.q_rad);
        match self.datum {
            None => self.q_rad = now_rad,
            Some(datum) if datum != measured.datum => {
                let shift_rad = now_rad - self.measured_rad;
                self.q_rad += shift_rad;
                // A goal in angles from the former zero is no longer valid.
                self.accepted = None;
            }
            Some(_) => {}
        }
        self.datum = Some(measured.datum);
        self.measured_rad = now_rad;
    }

    fn reset(&mut self) {
        self.qd_rad_s = JointVector::zeros();
        self.brake_rad_s2 = JointVector::zeros();
        self.accepted = None;
    }

    /// Accepts a goal if it keeps every bound. After `Err` no source is accepted, and everything
    /// else is unchanged.
    fn accept(
        &mut self,
        source: Source,
        goal: &Goal<N>,
        inputs: &Inputs<N>,
    ) -> Result<bool, FaultCode> {
        let goal_rad = JointVector::from(goal.q_rad);
        let goal_rad_s = JointVector::from(goal.qd_rad_s);
        let accepted = self.accepted.filter(|accepted| accepted.source == source);
        self.accepted = None;
        let bounds = &self.bounds;
        match accepted {
            None => is_within(&(goal_rad - self.q_rad), |_| bounds.bumpless_rad)
                .then_some(())
                .ok_or(FaultCode::NotBumpless)?,
            Some(last) => {
                let step = |i: usize| STEP_MARGIN * bounds.v_max_rad_s[i] * inputs.dt_s;
                is_within(&(goal_rad - last.goal_rad), step)
                    .then_some(())
                    .ok_or(FaultCode::SetpointJump)?;
            }
        }
        is_within(&goal_rad_s, |i| STEP_MARGIN * bounds.v_max_rad_s[i])
            .then_some(())
            .ok_or(FaultCode::SetpointJump)?;
        if inputs.measured.calibrated == 1 && self.leaves_limits(&goal_rad) {
            return Err(FaultCode::SoftLimit);
        }
        let lead_rad = self.bounds.lead_max_rad;
        self.q_rad = limited_lead(&goal_rad, &self.measured_rad, lead_rad);
        self.qd_rad_s = goal_rad_s;
        self.brake_rad_s2 = goal_rad_s.abs() / self.bounds.stop_time_s;
        self.accepted = Some(Accepted { source, goal_rad });
        Ok(true)
    }

    /// True when a goal is beyond a limit, unless it leads back from further outside.
    fn leaves_limits(&self, goal_rad: &JointVector<N>) -> bool {
        (0..N).any(|i| {
            let low = self.bounds.q_min_rad[i].min(self.q_rad[i]);
            let high = self.bounds.q_max_rad[i].max(self.q_rad[i]);
            !(low..=high).contains(&goal_rad[i])
        })
    }

    /// Without a source: every joint's speed falls evenly to zero, within the time to stop of the
    /// speed last taken over.
    fn slow_down(&mut self, inputs: &Inputs<N>) {
        if self.qd_rad_s == JointVector::<N>::zeros() {
            return;
        }
        for i in 0..N {
            let old = self.qd_rad_s[i];
            let new = (old.abs() - self.brake_rad_s2[i] * inputs.dt_s).max(0.0).copysign(old);
            let mut way = 0.5 * (old + new) * inputs.dt_s;
            if inputs.measured.calibrated == 1 {
                let back = (self.bounds.q_min_rad[i] - self.q_rad[i]).min(0.0);
                let forth = (self.bounds.q_max_rad[i] - self.q_rad[i]).max(0.0);
                way = way.clamp(back, forth);
            }
            self.q_rad[i] += way;
            self.qd_rad_s[i] = if new == 0.0 { 0.0 } else { new };
        }
        self.q_rad = limited_lead(&self.q_rad, &self.measured_rad, self.bounds.lead_max_rad);
    }
}

/// Whether every joint is within its bound. The bound itself is within, NaN is not.
fn is_within<const N: usize>(x: &JointVector<N>, bound: impl Fn(usize) -> f64) -> bool {
    (0..N).all(|i| x[i].abs() <= bound(i))
}

/// `q_rad` moved to at most `lead_rad` from the measured joints.
fn limited_lead<const N: usize>(
    q_rad: &JointVector<N>,
    measured_rad: &JointVector<N>,
    lead_rad: f64,
) -> JointVector<N> {
    // `max` and `min` instead of `clamp`: a measured NaN bounds nothing and panics nowhere.
    JointVector::from_fn(|i, _| {
        q_rad[i].max(measured_rad[i] - lead_rad).min(measured_rad[i] + lead_rad)
    })
}

#[cfg(test)]
mod tests;
