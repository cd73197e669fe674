//! What a world asks of a hand beside what it asks of every manipulator, and what it is told.

use glam::{DMat3, DVec3};

/// The most fingers that a simulated hand has: as many as the world has arrays.
pub(crate) const FINGERS_MAX: usize = 3;

/// The contact of one fingertip with the object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FingerContact {
    /// Normal force (N).
    pub normal_n: f64,
    /// Friction along the pad's x and y (N) and about its normal (N m), on the object.
    pub friction: [f64; 3],
    /// Friction relative to what the contact bears, before it yields: above 1 it slides.
    pub effort: f64,
    /// Speed of sliding at the middle of the load (m/s); 0 while it sticks.
    pub slip_m_s: f64,
    /// Middle of the load on the pad (m), along its x and y.
    pub middle_m: [f64; 2],
}

/// The true state of a hand's object and its contacts, base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandTruth {
    /// Centre of the object (m).
    pub object_m: DVec3,
    /// The object's axes in the base frame, as columns.
    pub object_axes: DMat3,
    /// Velocity of its centre (m/s).
    pub object_m_s: DVec3,
    /// Its angular velocity (rad/s).
    pub object_rad_s: DVec3,
    /// Force of the pushes from outside (N).
    pub push_n: DVec3,
    /// The contact of each finger; zero for fingers that the hand lacks.
    pub fingers: [FingerContact; FINGERS_MAX],
    /// Normal force of the support (N).
    pub support_n: f64,
    /// Whether a rubber is pressed deeper than small strain covers.
    pub beyond_small_strain: bool,
}

/// What the last steps took, since it was last asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StepWork {
    pub(crate) iterations: u64,
    pub(crate) unconverged: u64,
}

/// What a world asks of a hand beside what it asks of every manipulator.
pub(crate) trait Grasp {
    /// Number of fingers.
    fn fingers(&self) -> usize;

    /// The true state of object and contacts.
    fn truth(&self) -> HandTruth;

    /// Writes the normal force on each tactel of a finger (N).
    fn image(&self, finger: usize, forces: &mut [f64]);
}
