//! What is known of the arm beforehand: its geometry, its masses, the ranges of its joints, how its
//! gears are coupled. The sizes of gears, encoders and motors are estimates until they are found.

use nalgebra::DMatrix;
use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::arm::ArmDynamics;
use taktil_mechanics::spatial::JointVector;

/// The arm as a caller without a type parameter for its joints needs it.
#[derive(Clone, Debug)]
pub struct Model {
    robot: AnyRobot,
    /// Number of joints.
    pub joints: usize,
    /// Joint angles in which the commissioning begins (rad).
    pub home_rad: Vec<f64>,
    /// Lower limits of the joints (rad).
    pub low_rad: Vec<f64>,
    /// Upper limits of the joints (rad).
    pub high_rad: Vec<f64>,
    /// Estimates: motor turns in a joint turn, counts in a motor turn.
    pub(crate) gear: Vec<f64>,
    pub(crate) counts_per_rev: Vec<f64>,
    /// Torque constants that the file has (N m/A).
    pub(crate) torque_constant_nm_a: Vec<f64>,
    /// Currents of the amplifiers at full scale (A), and the code of it.
    pub(crate) current_max_a: Vec<f64>,
    pub(crate) full_scale_codes: f64,
    /// Direction in which the arm's own gear turns.
    pub(crate) own_sign: Vec<f64>,
    /// Coulomb friction of the joints (N m); 0 where the file states none.
    pub(crate) friction_nm: Vec<f64>,
}

impl Model {
    /// The arm of a machine file in the pose `home_rad`, with the sizes that the file has.
    #[must_use]
    pub fn new(robot: &AnyRobot, home_rad: &[f64]) -> Model {
        with_robot!(robot, known => {
            let diagonal = |i: usize| known.gears.gear_matrix()[(i, i)];
            let joints = known.home_rad.len();
            Model {
                robot: robot.clone(),
                joints,
                home_rad: home_rad.to_vec(),
                low_rad: known.arm.q_min().as_slice().to_vec(),
                high_rad: known.arm.q_max().as_slice().to_vec(),
                gear: (0..joints).map(|i| diagonal(i).abs()).collect(),
                counts_per_rev: known.gears.counts_per_revolution().as_slice().to_vec(),
                torque_constant_nm_a: known.drive.torque_constant_nm_a.as_slice().to_vec(),
                current_max_a: known.drive.current_max_a.as_slice().to_vec(),
                full_scale_codes: f64::from(-known.drive.code_range().0),
                own_sign: (0..joints).map(|i| diagonal(i).signum()).collect(),
                friction_nm: known.friction.coulomb_nm.as_slice().to_vec(),
            }
        })
    }

    /// Turns of motor `motor` for one turn of joint `joint`, over its turns for its own joint.
    pub(crate) fn coupling(&self, motor: usize, joint: usize) -> f64 {
        with_robot!(&self.robot, robot => {
            let gears = robot.gears.gear_matrix();
            gears[(motor, joint)] / gears[(motor, motor)]
        })
    }

    /// Torque of each joint that moves the arm like this, without friction (N m); zeros for lists
    /// of another length.
    pub(crate) fn torque_nm(&self, q: &[f64], qd: &[f64], qdd: &[f64]) -> Vec<f64> {
        with_robot!(&self.robot, robot => {
            let (Some(q), Some(qd), Some(qdd)) = (vector(q), vector(qd), vector(qdd)) else {
                return vec![0.0; self.joints];
            };
            let dynamics = &robot.dynamics;
            let torque = dynamics.mass_matrix(&q) * qdd + dynamics.bias_torque(&q, &qd);
            torque.as_slice().to_vec()
        })
    }

    /// Counts for one degree of a joint, by the sizes of the file.
    pub(crate) fn counts_per_deg(&self, joint: usize) -> f64 {
        self.counts_per_rev[joint] * self.gear[joint] / 360.0
    }

    /// Torque of a joint's motor at the joint for one code, by the sizes of the file (N m).
    pub(crate) fn nm_per_code(&self, joint: usize) -> f64 {
        self.torque_constant_nm_a[joint] * self.gear[joint] * self.current_max_a[joint]
            / self.full_scale_codes
    }

    /// Torques that hold the arm in the pose in which the commissioning begins (N m).
    pub(crate) fn holding_nm(&self) -> Vec<f64> {
        let still = vec![0.0; self.joints];
        self.torque_nm(&self.home_rad, &still, &still)
    }

    /// Least inertia that a torque on one joint alone meets in that pose (kg m^2): that of the
    /// joint with all others free, which is never more than with the others held.
    pub(crate) fn free_inertia_kg_m2(&self) -> Vec<f64> {
        let (still, holding) = (vec![0.0; self.joints], self.holding_nm());
        let column = |joint: usize| {
            let mut unit = still.clone();
            unit[joint] = 1.0;
            self.torque_nm(&self.home_rad, &still, &unit)
        };
        let columns: Vec<Vec<f64>> = (0..self.joints).map(column).collect();
        let mass = DMatrix::from_fn(self.joints, self.joints, |i, j| columns[j][i] - holding[i]);
        let inverse = mass.clone().try_inverse();
        let free = |i: usize| match &inverse {
            Some(inverse) if inverse[(i, i)] > 0.0 => 1.0 / inverse[(i, i)],
            _ => mass[(i, i)],
        };
        (0..self.joints).map(free).collect()
    }

    /// The name of a joint, counted from 0.
    #[must_use]
    pub fn label(&self, joint: usize) -> String {
        self.robot.joint_label(joint)
    }
}

fn vector<const N: usize>(all: &[f64]) -> Option<JointVector<N>> {
    <[f64; N]>::try_from(all).ok().map(JointVector::from)
}
