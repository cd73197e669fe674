//! Detects motors that run the wrong way: a motor departs from its desired angle ever faster while
//! its torque pulls it back, by more than gravity, friction and the motion of the other joints can
//! take. That is what a motor or an encoder of wrong polarity does; what the arm touches, slows
//! down, and what pushes back in a contact may carry it on a little.
//!
//! The comparison is made motor by motor, because polarity belongs to a motor and its encoder,
//! while the coupling of a wrist spreads it over several joints. With the motor angles `m = G q`
//! the equations of motion are `M' m'' + g' = u' + d'`, where `M' = G^-T M G^-1`, `g' = G^-T g` and
//! `u' = G^-T u`. Over a window of `2 h` periods the growth of a departure from the first half to
//! the second is `h^2` times its acceleration, in counts a squared period; it needs no differences
//! of single periods, in which one count is large.

use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::{JointMatrix, JointVector};
use taktil_mechanics::transmission::Transmission;
use taktil_rtcore::{Fold, StateHash};

/// Half lengths of the windows that are looked at (periods): a short window is enough where a motor
/// runs away fast, a long one tells slow departures from the rounding of the encoders.
const HALF_WINDOW_PERIODS: [usize; 3] = [2, 3, 4];
/// Samples that the longest window needs, the newest included.
const SAMPLES_KEPT: usize = 9;
/// Largest error of a reading that stands still (counts).
const ROUNDING_COUNTS: f64 = 0.5;
/// Largest error of the instant of a reading (periods), by which a reading in motion is off.
const TIMING_ERROR_PERIODS: f64 = 0.05;
/// Growth of a departure that is taken for one, over the largest that readings of this error can
/// make, which is four times the error.
const GROWTH_FACTOR: f64 = 1.5;
/// Share that the motor's own acceleration must have in that growth; the rest is that of the
/// desired angle.
const OWN_GROWTH_SHARE_MIN: f64 = 0.5;
/// Departure within a window that is taken for one (rad at the joint of the motor): on rubber the
/// fingertip swings by less.
const DEPARTURE_MIN_RAD: f64 = 3.5e-3;
/// Departure within a window, over that, by which a new contact of the fingertip may push a motor.
const PUSHED_FACTOR: f64 = 1.5;
/// Share that the acceleration of a motor must have in the growth of its departure to the side to
/// which a contact pushes it: its torque pulls back even at rest there.
const PUSHED_OWN_GROWTH_SHARE_MIN: f64 = 0.65;
/// Friction may be so many times that of the model: it differs by half with temperature and wear,
/// and a joint breaks away at more than it slides with.
const FRICTION_FACTOR: f64 = 1.5;
/// Share of gravity by which the model may be wrong.
const GRAVITY_ERROR_SHARE: f64 = 0.2;
/// Share of the inertia by which the model may be wrong.
const INERTIA_ERROR_SHARE: f64 = 0.2;
/// Number of angles of each joint at which the largest torque of gravity is looked for.
const GRAVITY_GRID_ANGLES: usize = 4;
/// Joints whose angles are all combined with each other, 262144 points for nine; the joints of a
/// longer arm are tried one after the other, so many times.
const GRID_JOINTS_MAX: usize = 9;
const ASCENT_SWEEPS: usize = 3;

/// What is known of the arm's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<const N: usize = 6> {
    /// Measured joint angles (rad), of meaning only when calibrated.
    pub q_rad: [f64; N],
    /// Measured joint speeds (rad/s).
    pub qd_rad_s: [f64; N],
    /// Whether the angles are those of the arm, or count from where it was switched on.
    pub calibrated: bool,
}

/// What the motors have to move, seen from the motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load<const N: usize = 6> {
    /// Torques per acceleration (N m for one count a squared period): the mass matrix.
    inertia: JointMatrix<N>,
    /// Torques of gravity, Coriolis and centrifugal forces (N m).
    bias_nm: JointVector<N>,
    /// Bounds of friction and of the error of the bias (N m).
    uncertainty_nm: JointVector<N>,
    /// Departure that counts (counts).
    departure_min: JointVector<N>,
    /// Where the pose is not known, the bias is zero and its bound the largest gravity in any pose;
    /// then what each motor has at least to accelerate (N m for one count a squared period), and
    /// zero otherwise.
    least_inertia: JointVector<N>,
}

impl<const N: usize> Load<N> {
    /// Departure of each motor from its desired angle that counts as one (counts).
    #[must_use]
    pub fn departure_min(&self) -> &JointVector<N> {
        &self.departure_min
    }

    /// Torque per acceleration of motor `i` while all others stand (N m for one count a squared
    /// period).
    #[must_use]
    pub fn own_inertia(&self, i: usize) -> f64 {
        self.inertia[(i, i)]
    }

    /// Torque per acceleration that motor `i` needs at least in any pose while all others stand
    /// (N m for one count a squared period); zero where the pose is known.
    #[must_use]
    pub fn least_inertia(&self, i: usize) -> f64 {
        self.least_inertia[i]
    }

    /// The torque of motor `i` beyond gravity, with its side, over what friction and the error of
    /// gravity may take.
    #[must_use]
    pub fn pull_share(&self, i: usize, torque_nm: f64) -> f64 {
        (torque_nm - self.bias_nm[i]) / self.uncertainty_nm[i].max(f64::MIN_POSITIVE)
    }

    /// Largest torque that the acceleration of the other motors puts on motor `i` (N m).
    #[must_use]
    pub fn reaction_nm(&self, i: usize, acceleration: &JointVector<N>) -> f64 {
        let others = (0..N).filter(|j| *j != i);
        others.map(|j| (self.inertia[(i, j)] * acceleration[j]).abs()).sum()
    }

    /// By how much the torque of motor `i` pulls to the side of this sign, beyond what gravity and
    /// friction can take (N m); negative where they may hold it.
    #[must_use]
    pub fn excess_nm(&self, i: usize, torque_nm: f64, side: f64) -> f64 {
        side * (torque_nm - self.bias_nm[i]) - self.uncertainty_nm[i]
    }
}

/// The arm as its motors feel it.
#[derive(Clone, Debug)]
pub struct MotorModel<const N: usize, L> {
    dynamics: L,
    gears: Transmission<N>,
    /// Absolute values of `G^-T`: bounds of joint torques become bounds of motor torques.
    bounds: JointMatrix<N>,
    coulomb_nm: JointVector<N>,
    viscous_nms_rad: JointVector<N>,
    nominal_rad: JointVector<N>,
    /// Largest torques of gravity in any pose (N m at the motors).
    gravity_max_nm: JointVector<N>,
    /// Smallest inertia of each motor in any pose while the others stand (kg m^2 at the motor).
    inertia_min_kg_m2: JointVector<N>,
}

impl<const N: usize, L: ArmDynamics<N>> MotorModel<N, L> {
    /// The model of a robot.
    #[must_use]
    pub fn new<A: Arm<N, Dynamics = L>>(robot: &Robot<N, A>) -> MotorModel<N, L> {
        let unit = JointMatrix::<N>::identity();
        MotorModel {
            dynamics: robot.dynamics.clone(),
            gears: robot.gears,
            bounds: to_motors(&robot.gears, &unit).map(f64::abs),
            coulomb_nm: robot.friction.coulomb_nm,
            viscous_nms_rad: robot.friction.viscous_nms_rad,
            nominal_rad: robot.nominal_rad,
            gravity_max_nm: gravity_max_nm(robot),
            inertia_min_kg_m2: inertia_min_kg_m2(robot),
        }
    }

    /// Counts of the motors in a joint displacement (rad).
    #[must_use]
    pub fn counts(&self, joints_rad: &JointVector<N>) -> JointVector<N> {
        self.gears.exact_counts(joints_rad)
    }

    /// The torques of the motors (N m) for torques at the joints (N m).
    #[must_use]
    pub fn motor_torque(&self, tau_nm: &[f64; N]) -> JointVector<N> {
        self.gears.motor_torque(&JointVector::from(*tau_nm))
    }

    /// The load over periods of `period_s`. In an arm that is not calibrated the pose is not known:
    /// then the masses are those of the nominal pose, and gravity is anything up to its largest
    /// value.
    #[must_use]
    pub fn load(&self, motion: &Motion<N>, period_s: f64) -> Load<N> {
        let qd = JointVector::from(motion.qd_rad_s);
        let (pose, bias_nm, bias_error_nm, least_inertia_kg_m2) = if motion.calibrated {
            let q = JointVector::from(motion.q_rad);
            let bias = self.gears.motor_torque(&self.dynamics.bias_torque(&q, &qd));
            (q, bias, bias.map(f64::abs) * GRAVITY_ERROR_SHARE, JointVector::zeros())
        } else {
            let error = self.gravity_max_nm * (1.0 + GRAVITY_ERROR_SHARE);
            let inertia = self.inertia_min_kg_m2 * (1.0 - INERTIA_ERROR_SHARE);
            (self.nominal_rad, JointVector::zeros(), error, inertia)
        };
        let friction = self.coulomb_nm + self.viscous_nms_rad.component_mul(&qd.map(f64::abs));
        let mut inertia = motor_inertia_kg_m2(&self.gears, &self.dynamics.mass_matrix(&pose));
        let squared_s2 = period_s * period_s;
        let counts_per_rad = self.gears.counts_per_revolution() / core::f64::consts::TAU;
        for (i, mut column) in inertia.column_iter_mut().enumerate() {
            column /= counts_per_rad[i] * squared_s2;
        }
        let least_inertia = least_inertia_kg_m2.component_div(&counts_per_rad) / squared_s2;
        let uncertainty_nm = self.bounds * friction * FRICTION_FACTOR + bias_error_nm;
        let departure_min = JointVector::from_fn(|i, _| {
            let rad = self.gears.gear_matrix()[(i, i)].abs() * DEPARTURE_MIN_RAD;
            rad * self.gears.counts_per_revolution()[i] / core::f64::consts::TAU
        });
        Load { inertia, bias_nm, uncertainty_nm, departure_min, least_inertia }
    }
}

/// Each column of joint torques as motor torques: `G^-T` times the matrix.
fn to_motors<const N: usize>(gears: &Transmission<N>, joints: &JointMatrix<N>) -> JointMatrix<N> {
    let mut motors = *joints;
    for mut column in motors.column_iter_mut() {
        let torque = gears.motor_torque(&column.clone_owned());
        column.copy_from(&torque);
    }
    motors
}

/// The mass matrix of the joints as the motors feel it: `G^-T M G^-1`.
fn motor_inertia_kg_m2<const N: usize>(
    gears: &Transmission<N>,
    joints: &JointMatrix<N>,
) -> JointMatrix<N> {
    to_motors(gears, &to_motors(gears, joints).transpose())
}

/// The smallest inertia that each motor has while the others stand (kg m^2), over poses on the
/// diagonals of the joints' ranges and those in which one joint stands elsewhere.
fn inertia_min_kg_m2<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> JointVector<N> {
    let mut least = JointVector::<N>::repeat(f64::INFINITY);
    let starts = (0..GRAVITY_GRID_ANGLES).flat_map(|along| (0..N).map(move |joint| (along, joint)));
    for (along, joint) in starts {
        for place in 0..GRAVITY_GRID_ANGLES {
            let at = |i: usize| if i == joint { place } else { (along + i) % GRAVITY_GRID_ANGLES };
            let q = JointVector::from_fn(|i, _| grid_angle(robot, i, at(i)));
            let here = motor_inertia_kg_m2(&robot.gears, &robot.dynamics.mass_matrix(&q));
            least = least.zip_map(&here.diagonal(), f64::min);
        }
    }
    least
}

/// The largest torques of gravity over the range of the joints, at the motors (N m).
fn gravity_max_nm<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> JointVector<N> {
    if N > GRID_JOINTS_MAX { ascended_nm(robot) } else { on_grid_nm(robot) }
}

/// The angle of a joint at a place of the grid (rad).
fn grid_angle<const N: usize, A: Arm<N>>(robot: &Robot<N, A>, joint: usize, place: usize) -> f64 {
    let turn = core::f64::consts::PI;
    let share = place as f64 / (GRAVITY_GRID_ANGLES - 1) as f64;
    let (low, high) = (robot.arm.q_min()[joint].max(-turn), robot.arm.q_max()[joint].min(turn));
    low + (high - low) * share
}

/// The largest torques on a grid of all joints.
fn on_grid_nm<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> JointVector<N> {
    let mut most = JointVector::<N>::zeros();
    let points = (0..N).fold(1, |points, _| points * GRAVITY_GRID_ANGLES);
    for point in 0..points {
        let mut rest = point;
        let q = JointVector::from_fn(|i, _| {
            let place = rest % GRAVITY_GRID_ANGLES;
            rest /= GRAVITY_GRID_ANGLES;
            grid_angle(robot, i, place)
        });
        let gravity = robot.gears.motor_torque(&robot.dynamics.gravity_torque(&q));
        most = most.zip_map(&gravity, |most, now| most.max(now.abs()));
    }
    most
}

/// The largest torques that are found by trying one joint after the other, from a few starts for
/// each motor.
fn ascended_nm<const N: usize, A: Arm<N>>(robot: &Robot<N, A>) -> JointVector<N> {
    JointVector::from_fn(|motor, _| {
        let torque_nm = |q: &JointVector<N>| {
            robot.gears.motor_torque(&robot.dynamics.gravity_torque(q))[motor].abs()
        };
        let starts = (0..GRAVITY_GRID_ANGLES).map(|start| {
            let place = |i: usize| (start + i * (1 + start)) % GRAVITY_GRID_ANGLES;
            let q = JointVector::from_fn(|i, _| grid_angle(robot, i, place(i)));
            largest_from(q, |i, place| grid_angle(robot, i, place), torque_nm)
        });
        starts.fold(0.0, f64::max)
    })
}

/// The largest value that is found from joints `q` (rad) by putting one joint after the other where
/// the value is largest.
fn largest_from<const N: usize>(
    mut q: JointVector<N>,
    angle: impl Fn(usize, usize) -> f64,
    value: impl Fn(&JointVector<N>) -> f64,
) -> f64 {
    let mut most = value(&q);
    for _ in 0..ASCENT_SWEEPS {
        for joint in 0..N {
            for place in 0..GRAVITY_GRID_ANGLES {
                let mut other = q;
                other[joint] = angle(joint, place);
                let there = value(&other);
                if there > most {
                    (most, q) = (there, other);
                }
            }
        }
    }
    most
}

/// What the fingertip touches, as the motors feel it.
#[derive(Clone, Copy)]
pub struct MotorContact<'a> {
    /// The sign of the counts to which it pushes a motor; 0 where it does not.
    pub pushed_side: &'a dyn Fn(usize) -> f64,
    /// Whether the finger may still swing on the rubber.
    pub is_new: bool,
}

/// One period of the past.
#[derive(Clone, Copy, Debug)]
struct Sample<const N: usize> {
    counts: [i32; N],
    /// Measured minus desired angles (counts).
    departure: JointVector<N>,
    /// Torques of the motors commanded after these readings (N m).
    torque_nm: JointVector<N>,
}

/// The detector: the last periods of all motors, the newest first.
#[derive(Clone, Debug)]
pub struct RunawayDetector<const N: usize = 6> {
    samples: [Sample<N>; SAMPLES_KEPT],
    known: usize,
}

impl<const N: usize> Default for RunawayDetector<N> {
    fn default() -> RunawayDetector<N> {
        RunawayDetector::new()
    }
}

impl<const N: usize> Fold for RunawayDetector<N> {
    fn fold(&self, hash: &mut StateHash) {
        let newest = &self.samples[0];
        hash.add(&self.known).add(&newest.counts).add(newest.departure.as_slice());
    }
}

impl<const N: usize> RunawayDetector<N> {
    /// A detector that has seen nothing.
    #[must_use]
    pub fn new() -> RunawayDetector<N> {
        let zero = JointVector::zeros();
        let none = Sample { counts: [0; N], departure: zero, torque_nm: zero };
        RunawayDetector { samples: [none; SAMPLES_KEPT], known: 0 }
    }

    /// Forgets the past: the drives were off, the brakes on, or a sample is missing.
    pub fn reset(&mut self) {
        self.known = 0;
    }

    /// Takes the readings of one period, `departure` in counts measured minus desired, under a load
    /// of the motors. The first motor that runs away is returned, 0 the first. What the fingertip
    /// touches may brake a motor that still turns the other way than it departs, which counts from
    /// its reversal on. A motor that departs to the side to which a contact pushes has to make at
    /// least 0.65 of the growth itself, and in a new contact to depart by 1.5 times as much.
    pub fn update(
        &mut self,
        counts: [i32; N],
        departure: JointVector<N>,
        load: &Load<N>,
        contact: Option<MotorContact<'_>>,
    ) -> Option<usize> {
        if !departure.iter().all(|x| x.is_finite()) {
            self.reset();
            return None;
        }
        self.samples.rotate_right(1);
        self.samples[0] = Sample { counts, departure, torque_nm: JointVector::zeros() };
        self.known = (self.known + 1).min(SAMPLES_KEPT);
        HALF_WINDOW_PERIODS.iter().find_map(|half| self.runaway_motor(*half, load, contact))
    }

    /// Notes the torque of the motors (N m) that is commanded after this period's readings.
    pub fn command(&mut self, torque_nm: JointVector<N>) {
        self.samples[0].torque_nm = torque_nm;
    }

    /// Accelerations of the motors over the longest window (counts a squared period); zero until
    /// there are enough readings, and where it is no more than rounding makes.
    #[must_use]
    pub fn acceleration(&self) -> JointVector<N> {
        let half = (SAMPLES_KEPT - 1) / 2;
        if self.known < SAMPLES_KEPT {
            return JointVector::zeros();
        }
        let change = self.turned(half, 0) - self.turned(2 * half, half);
        let squared = (half * half) as f64;
        change.map(|counts| if counts.abs() <= 2.0 { 0.0 } else { counts / squared })
    }

    /// How far the motors turned from sample `from` to sample `to` (counts).
    fn turned(&self, from: usize, to: usize) -> JointVector<N> {
        let (from, to) = (&self.samples[from].counts, &self.samples[to].counts);
        JointVector::from_fn(|i, _| f64::from(to[i].wrapping_sub(from[i])))
    }

    /// The first motor that runs away in a window of `2 half` periods.
    fn runaway_motor(
        &self,
        half: usize,
        load: &Load<N>,
        contact: Option<MotorContact<'_>>,
    ) -> Option<usize> {
        let (middle, first) = (half, 2 * half);
        if self.known <= first {
            return None;
        }
        let (before, newest) = (self.turned(first, middle), self.turned(middle, 0));
        let periods = half as f64;
        let speed = before.zip_map(&newest, |a, b| a.abs().max(b.abs()) / periods);
        // The second difference of readings with this error is off by four times the error.
        let error = speed.map(|speed| 4.0 * (ROUNDING_COUNTS + TIMING_ERROR_PERIODS * speed));
        let squared = periods * periods;
        let acceleration = (newest - before) / squared;
        let departed = |i: usize, from: usize, to: usize| {
            self.samples[to].departure[i] - self.samples[from].departure[i]
        };
        (0..N).find(|&i| {
            let side = departed(i, middle, 0).signum();
            let growth = side * (departed(i, middle, 0) - departed(i, first, middle));
            // A motor that does not turn is stuck; it does not run away. One that keeps its speed
            // while its desired angle turns back departs ever faster, too, but not by itself.
            let own_growth = side * (newest[i] - before[i]);
            if growth < GROWTH_FACTOR * error[i]
                || own_growth < (GROWTH_FACTOR * error[i]).max(OWN_GROWTH_SHARE_MIN * growth)
                || newest[i].abs() < error[i]
                || (contact.is_some() && side * newest[i] < 0.0)
                || side * departed(i, first, 0) < load.departure_min[i]
            {
                return false;
            }
            // Only a motor that departs ever faster is compared with what moves the others.
            let others = (0..N).filter(|j| *j != i).map(|j| (load.inertia[(i, j)], j));
            let others_nm: f64 = others.clone().map(|(inertia, j)| inertia * acceleration[j]).sum();
            let others_error_nm: f64 =
                others.map(|(inertia, j)| inertia.abs() * error[j] / squared).sum();
            // In a pose that is not known the bound is that of all poses, and a torque limit may
            // lie below it. What would have to pull the motor away must then also accelerate it.
            // The growth is that of half a window squared times the acceleration.
            let accelerating_nm = load.least_inertia[i] * (own_growth - error[i]) / squared;
            let bound_nm = load.uncertainty_nm[i] + others_error_nm - accelerating_nm;
            // A torque acts from up to one period after its command, so that those at both ends of
            // the window hardly count.
            let torque = |k: usize| self.samples[k].torque_nm[i] - load.bias_nm[i] - others_nm;
            let pulls_back_nm = (1..first).map(|k| -side * torque(k));
            let least_nm = pulls_back_nm.clone().fold(f64::INFINITY, f64::min);
            let is_far = side * departed(i, first, 0) > PUSHED_FACTOR * load.departure_min[i];
            let is_own = own_growth >= PUSHED_OWN_GROWTH_SHARE_MIN * growth;
            let may_be_pushed = |contact: MotorContact<'_>| {
                !(is_own && (is_far || !contact.is_new)) && side * (contact.pushed_side)(i) > 0.0
            };
            least_nm > 0.0
                && pulls_back_nm.sum::<f64>() > bound_nm * (first - 1) as f64
                && !contact.is_some_and(may_be_pushed)
        })
    }
}

#[cfg(test)]
mod tests;
