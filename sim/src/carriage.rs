//! A finger on rails instead of an arm: its place along a path is prescribed, so that the contact
//! can be studied and checked without a servo. Optionally it floats along z0 under a constant load.
//! Its orientation is fixed.

use glam::{DMat3, DVec3};
use taktil_mechanics::spatial::{linear_and_angular, spatial_vector};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::friction::ResistingTorque;
use crate::hash::Hash;
use crate::manipulator::{ArmState, Coordinates, Manipulator, StagePredictor};
use crate::scene::{Invalid, invalid};

/// The guide of a finger that floats along z0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloatingGuide {
    /// Moving mass (kg), without weight: its weight is part of the load.
    pub mass_kg: f64,
    /// Force along -z0 (N).
    pub load_n: f64,
    /// Viscous damping of the guide (N s/m).
    pub damping_n_s_m: f64,
}

/// The prescribed motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Carriage {
    /// Axes of the sensor frame as columns.
    pub axes: DMat3,
    /// Instants (s, increasing) and places of the sensor's centre (m); between them the finger
    /// moves with a smooth start and stop, outside them it rests.
    pub knots: Vec<(f64, DVec3)>,
    /// The guide of a floating finger; then z of the knots is only the start.
    pub float: Option<FloatingGuide>,
}

/// A carriage at an instant of its motion.
#[derive(Clone, Debug)]
pub(crate) struct MovingCarriage {
    plan: Carriage,
    t_s: f64,
    pose: Pose,
    velocity: DVec3,
    /// Height and its speed in the first place, if the carriage floats.
    state: ArmState,
}

impl Carriage {
    /// Refuses paths and guides that are not finite, not in order or not positive.
    pub(crate) fn check(&self) -> Result<(), Invalid> {
        let refuse = |place: &str, what: &str, remedy: &str| {
            Err(invalid(&format!("carriage.{place}"), what.to_owned(), remedy))
        };
        let turn = self.axes * self.axes.transpose();
        let right_handed = self.axes.determinant() > 0.0;
        if !(right_handed && turn.abs_diff_eq(DMat3::IDENTITY, 1e-9)) {
            return refuse("axes", "are not those of a turned frame", "give a rotation matrix");
        }
        let finite = self.knots.iter().all(|(t, p)| t.is_finite() && p.is_finite());
        let ordered = self.knots.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if self.knots.is_empty() || !finite || !ordered {
            return refuse("knots", "are empty, not finite or not in order", "order them by time");
        }
        if let Some(float) = self.float {
            let sound = float.mass_kg >= 1e-3
                && float.mass_kg.is_finite()
                && float.load_n.is_finite()
                && (0.0..1e6).contains(&float.damping_n_s_m);
            if !sound {
                return refuse("float", "has a figure that is not physical", "see its fields");
            }
        }
        Ok(())
    }

    /// Place and velocity at an instant (s), without the floating.
    fn at(&self, t_s: f64) -> (DVec3, DVec3) {
        let knots = &self.knots;
        let after = knots.iter().position(|(t, _)| *t > t_s);
        match (after, knots.first(), knots.last()) {
            (Some(i), Some(_), Some(_)) if i > 0 => {
                let ((t0, p0), (t1, p1)) = (knots[i - 1], knots[i]);
                let (span, u) = (t1 - t0, (t_s - t0) / (t1 - t0));
                let place = p0 + u * u * (3.0 - 2.0 * u) * (p1 - p0);
                (place, 6.0 * u * (1.0 - u) / span * (p1 - p0))
            }
            (Some(_), Some((_, first)), _) => (*first, DVec3::ZERO),
            (None, _, Some((_, last))) => (*last, DVec3::ZERO),
            _ => (DVec3::ZERO, DVec3::ZERO),
        }
    }
}

impl MovingCarriage {
    pub(crate) fn new(plan: Carriage) -> MovingCarriage {
        let (place, velocity) = plan.at(0.0);
        let pose = Pose::new(plan.axes, place);
        let mut state = ArmState::default();
        (state.q[0], state.qd[0]) = (place.z, velocity.z);
        MovingCarriage { plan, t_s: 0.0, pose, velocity, state }
    }

    /// Mass that follows the finger along its normal (kg); none when the place is prescribed.
    pub(crate) fn mass_kg(&self) -> Option<f64> {
        self.plan.float.map(|guide| guide.mass_kg)
    }
}

impl Manipulator for MovingCarriage {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn twist(&self) -> Joints {
        spatial_vector(self.velocity, DVec3::ZERO)
    }

    fn is_prescribed(&self) -> bool {
        true
    }

    fn digest(&self, hash: &mut Hash) {
        hash.number(self.t_s);
        hash.vector(self.pose.translation);
        hash.vector(self.velocity);
    }
}

impl Coordinates<6> for MovingCarriage {
    fn state(&self) -> &ArmState {
        &self.state
    }

    fn state_mut(&mut self) -> &mut ArmState {
        &mut self.state
    }

    /// The step is explicit in the force on the finger and implicit in the guide's damping.
    fn step(&mut self, h: f64, wrench: &Joints) {
        let force = linear_and_angular(wrench).0;
        if let Some(guide) = self.plan.float {
            let driven = self.state.qd[0] + h * (force.z - guide.load_n) / guide.mass_kg;
            self.state.qd[0] = driven / (1.0 + h * guide.damping_n_s_m / guide.mass_kg);
            self.state.q[0] += h * self.state.qd[0];
        }
        self.update_kinematics(self.t_s + h);
    }

    /// One degree of freedom when the carriage floats, none when it does not.
    fn predict_stage(&self, base: &ArmState, guess: &Joints, h: f64, end_s: f64) -> StagePredictor {
        let (mut place, mut velocity) = self.plan.at(end_s);
        let Some(guide) = self.plan.float else {
            let pose = Pose::new(self.plan.axes, place);
            return StagePredictor::prescribed(pose, spatial_vector(velocity, DVec3::ZERO));
        };
        (place.z, velocity.z) = (base.q[0] + h * guess[0], 0.0);
        let pose = Pose::new(self.plan.axes, place);
        let mut predictor = StagePredictor::prescribed(pose, spatial_vector(velocity, DVec3::ZERO));
        predictor.degrees_of_freedom = 1;
        predictor.inertia[(0, 0)] = guide.mass_kg;
        predictor.forces[0] = -guide.load_n;
        predictor.jacobian = Matrix6::zeros();
        predictor.jacobian[(2, 0)] = 1.0;
        predictor.guessed_speeds = *guess;
        predictor
    }

    /// The guide's viscous friction.
    fn resisting_torque(&self, _: &ArmState, _: usize, speed: f64, _: f64) -> ResistingTorque {
        let slope = self.plan.float.map_or(0.0, |guide| guide.damping_n_s_m);
        ResistingTorque { torque_nm: slope * speed, slope, ..ResistingTorque::default() }
    }

    fn update_kinematics(&mut self, t_s: f64) {
        self.t_s = t_s;
        let (mut place, mut velocity) = self.plan.at(t_s);
        if self.plan.float.is_some() {
            (place.z, velocity.z) = (self.state.q[0], self.state.qd[0]);
        }
        (self.pose.translation, self.velocity) = (place, velocity);
    }

    fn clone_box(&self) -> Box<dyn Coordinates<6>> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_carriage_rests_outside_its_path_and_moves_smoothly_inside() {
        let knots = vec![(1.0, DVec3::ZERO), (3.0, DVec3::X), (4.0, DVec3::X + DVec3::Y)];
        let carriage = Carriage { axes: DMat3::IDENTITY, knots, float: None };
        assert_eq!(carriage.at(0.0), (DVec3::ZERO, DVec3::ZERO));
        assert_eq!(carriage.at(2.0), (0.5 * DVec3::X, 0.75 * DVec3::X));
        assert_eq!(carriage.at(9.0), (DVec3::X + DVec3::Y, DVec3::ZERO));
        let empty = Carriage { axes: DMat3::IDENTITY, knots: Vec::new(), float: None };
        assert_eq!(empty.at(1.0), (DVec3::ZERO, DVec3::ZERO));
    }
}
