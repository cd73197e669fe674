//! Detects encoders that do not count by the motion that they must be hiding: a motor whose torque
//! exceeds what gravity and friction can take accelerates, and within a time it has turned by so
//! much at least, unless something holds it. An encoder that has not counted by then is dead, or
//! its joint is held fast.
//!
//! Only what the fingertip touches may hold a joint, and touch tells whether it does. Without
//! contact nothing holds it. In contact the place of the load on the pad tells: where the finger
//! moves by `b + h` along the sensor's x axis, `b` by its encoders and `h` hidden, the load moves
//! by `-k (b + h)` over the pad, with `k` from one half, on a pin that rolls, to one, on what
//! stands. A joint that is held leaves `h` at zero for some `k` of these. A joint that moves the
//! finger along other directions than x is seen only after the contact is lost.
//!
//! The other motors throw a motor when they accelerate: what they may put on it is taken off its
//! torque.
//!
//! What the finger touches may be moved itself, by a hand or by a table, or slip over the pad. In
//! contact an encoder is therefore taken for dead only within a time after it has counted last: a
//! joint that has stood for longer is one that is held.

use core::fmt;

use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Transmission;

use crate::runaway::Load;

/// Change of a reading that is no motion (counts): a disc between two lines flickers.
pub(crate) const FLICKER_COUNTS: i32 = 2;
/// Motion that must have been counted, over the departure that counts, in contact and without: 0.6
/// and 0.3 degrees at the joint.
const HIDDEN_FACTOR: f64 = 3.0;
const FREE_HIDDEN_FACTOR: f64 = 1.5;
/// For how long a motor has to stand at least (s): a brake takes some time to open.
const STANDING_MIN_S: f64 = 0.03;
/// Within which time pulls add up (s): what is touched may move later.
const PULLS_WITHIN_S: f64 = 0.5;
/// Inertia may be so many times that of the model.
const INERTIA_FACTOR: f64 = 1.3;
/// Smallest hidden motion of the fingertip that the load's place on the pad shows (m): noise and
/// the shape of the load move its centroid by a fifth of that.
const FELT_MOTION_MIN_M: f64 = 0.8e-3;
/// Smallest motion of the load over the pad that is one (m): three times what noise makes of it.
const PAD_MOTION_MIN_M: f64 = 0.6e-3;
/// Time constant by which the load's place before the motion is smoothed (s): four images.
const PLACE_FILTER_S: f64 = 0.02;
/// Number of images in a row that have to tell of a motion.
const CONFIRMING_IMAGES: u32 = 3;
/// A motion of the load over the pad must be so many times what the place changes by from one image
/// to the next, on the mean of some images.
const IMAGE_NOISE_FACTOR: f64 = 6.0;
/// Share that an image has in that mean.
const IMAGE_NOISE_SHARE: f64 = 0.05;
/// For how long a contact has to last (s): until then the load finds its place on the pad.
const CONTACT_SETTLED_S: f64 = 0.1;
/// For how long an encoder may not have counted in contact (s): beyond, what is touched holds it.
const STANDING_MAX_S: f64 = 0.25;
/// An encoder that takes longer than this for a few counts creeps (s).
const CREEP_MIN_S: f64 = 0.1;
/// Share of the finger's motion along the sensor's x axis by which it may press on what it has
/// touched for less than this time (s).
const PRESSED_SHARE_MAX: f64 = 0.3;
const PRESSED_SETTLED_S: f64 = 0.5;
/// Share of the motion that the torque must have made by which touch has to confirm it.
const FELT_SHARE_MIN: f64 = 0.3;
/// Smallest and largest part of the finger's motion by which the load moves over the pad.
const PAD_MOTION_SHARES: [f64; 2] = [0.5, 1.0];
/// For how long the contact has to be gone (s): the load of a finger that rolls over an edge goes
/// and comes.
const CONTACT_GONE_S: f64 = 0.02;
/// Turn of a joint by which the motion of the tool is found (rad).
const TURN_RAD: f64 = 1e-3;

/// What is known of the fingertip's contact in a job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Touch {
    /// The machine has nothing that presses: nothing holds its joints.
    Absent,
    /// Nobody can say whether something is touched.
    #[default]
    Unknown,
    /// The fingertip touches nothing.
    Free,
    /// It touches something.
    Contact {
        /// Middle of the load along the sensor's x axis (m).
        x_m: f64,
        /// Middle of the load along the sensor's y axis (m).
        y_m: f64,
        /// Direction of a long load: its angle from the sensor's y axis (rad), modulo half a turn.
        yaw_rad: Option<f64>,
    },
}

impl Touch {
    /// Middle of the load along the sensor's x and y axes (m), where something is touched.
    #[must_use]
    pub const fn place_m(self) -> Option<[f64; 2]> {
        match self {
            Touch::Contact { x_m, y_m, .. } => Some([x_m, y_m]),
            Touch::Absent | Touch::Unknown | Touch::Free => None,
        }
    }
}

/// One reading of all motors.
#[derive(Clone, Copy, Debug)]
pub struct Reading<'a, const N: usize> {
    /// Counts of the encoders.
    pub counts: &'a [i32; N],
    /// Measured joint angles (rad).
    pub q_rad: &'a [f64; N],
    /// Whether they are calibrated.
    pub calibrated: bool,
    /// Torques of the motors since the last reading (N m).
    pub torque_nm: &'a JointVector<N>,
    /// Accelerations of the motors (counts a squared period).
    pub acceleration: &'a JointVector<N>,
    /// What is touched.
    pub touch: Touch,
    /// Whether its load has jumped to another place of the pad.
    pub has_jumped: bool,
    /// Time since the last reading (s).
    pub after_s: f64,
}

/// A motor since its encoder counted last.
#[derive(Clone, Copy, Debug)]
struct Standing<const N: usize> {
    place: i32,
    /// Joint angles at that time (rad).
    q_rad: [f64; N],
    /// Place of the load at that time, or since it is known (m).
    felt_m: Option<f64>,
    stood_s: f64,
    /// Images in a row that have told of its motion.
    images: u32,
    /// For how long the encoder has not left this place, and has not moved (s).
    place_s: f64,
    silent_s: f64,
    /// What its torque must have made of it at least, and what it makes of a motor at rest.
    least: Pulled,
    from_rest: Pulled,
}

/// Speed and way of a motor to either side (counts a reading, counts). One that turned the other
/// way has a negative speed, which its torque has to brake first.
#[derive(Clone, Copy, Debug, Default)]
struct Pulled {
    speed: [f64; 2],
    way: [f64; 2],
}

impl Pulled {
    /// A reading later, at which the torque makes the motor faster by so much (counts a reading) to
    /// side `k`.
    fn add(&mut self, k: usize, gain: f64) {
        // Friction stops what was pushed, and brakes by an unknown amount what turned the other
        // way.
        self.speed[k] = (self.speed[k] + gain).max(self.speed[k].min(0.0));
        self.way[k] += self.speed[k].max(0.0);
    }

    /// The longer way to either side (counts, with its sign).
    fn way(&self) -> f64 {
        let [forward, back] = self.way;
        if back > forward { -back } else { forward }
    }
}

/// The pose of the tool at joint angles (rad), in the base frame.
pub(crate) struct ToolPose<const N: usize>(pub(crate) Box<dyn Fn(&JointVector<N>) -> Pose + Send>);

impl<const N: usize> ToolPose<N> {
    pub(crate) fn new<A: Arm<N>>(arm: &A) -> ToolPose<N> {
        let arm = *arm;
        ToolPose(Box::new(move |q| arm.tool_pose(q)))
    }
}

impl<const N: usize> fmt::Debug for ToolPose<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the tool of an arm of {N} joints")
    }
}

/// The detector with its memory, which is no part of the digest of a run: it follows from values
/// that are.
#[derive(Debug)]
pub struct HiddenMotionDetector<const N: usize = 6> {
    tool_pose: ToolPose<N>,
    gears: Transmission<N>,
    motors: [Option<Standing<N>>; N],
    /// For how long nothing and something has been touched (s).
    free_s: f64,
    contact_s: f64,
    /// Smoothed place of the load (m).
    place_m: f64,
    /// Place of the load in the last image (m), and by how much the last ones differed (m).
    image_m: f64,
    image_noise_m: f64,
}

/// The two sides to which a motor may be pulled.
const PULL_SIDES: [f64; 2] = [1.0, -1.0];

impl<const N: usize> Standing<N> {
    fn new(reading: &Reading<'_, N>, motor: usize, felt_m: Option<f64>) -> Standing<N> {
        Standing {
            place: reading.counts[motor],
            q_rad: *reading.q_rad,
            felt_m,
            stood_s: 0.0,
            images: 0,
            place_s: 0.0,
            silent_s: 0.0,
            least: Pulled::default(),
            from_rest: Pulled::default(),
        }
    }

    /// A motor that has just counted `moved` counts in so many readings, at the latest.
    fn after_motion(self, moved: i32, readings: f64) -> Standing<N> {
        // One count more, for the rounding of the reading before.
        let speed = (f64::from(moved.saturating_abs()) + 1.0) / readings.max(1.0);
        let toward = f64::from(moved.signum());
        let speed = PULL_SIDES.map(|side| (side * toward * speed).min(0.0));
        Standing { least: Pulled { speed, ..self.least }, ..self }
    }

    /// Adds up what the torque makes of motor `i`.
    fn pull(&mut self, i: usize, reading: &Reading<'_, N>, load: &Load<N>) {
        let reaction_nm = load.reaction_nm(i, reading.acceleration);
        for (k, toward) in PULL_SIDES.into_iter().enumerate() {
            let excess_nm = load.excess_nm(i, reading.torque_nm[i], toward) - reaction_nm;
            let gain = excess_nm / (INERTIA_FACTOR * load.own_inertia(i));
            self.least.add(k, gain);
            self.from_rest.add(k, gain);
        }
    }
}

/// The nearest whole count.
#[expect(clippy::cast_possible_truncation, reason = "clamped first")]
fn whole(counts: f64) -> i32 {
    counts.round().clamp(-1e9, 1e9) as i32
}

impl<const N: usize> HiddenMotionDetector<N> {
    /// A detector that has seen nothing, of an arm with these gears.
    #[must_use]
    pub fn new<A: Arm<N>>(arm: &A, gears: &Transmission<N>) -> HiddenMotionDetector<N> {
        HiddenMotionDetector {
            tool_pose: ToolPose::new(arm),
            gears: *gears,
            motors: [None; N],
            free_s: 0.0,
            contact_s: 0.0,
            place_m: 0.0,
            image_m: 0.0,
            image_noise_m: 0.0,
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.motors = [None; N];
    }

    /// Takes a reading under a load of the motors. The first motor that must have moved and has not
    /// counted is returned, 0 the first.
    pub fn update(&mut self, reading: &Reading<'_, N>, load: &Load<N>) -> Option<usize> {
        let (felt_m, is_new_image) = self.follow_touch(reading);
        let mut found = None;
        for i in 0..N {
            let Some(motor) = &mut self.motors[i] else {
                self.motors[i] = Some(Standing::new(reading, i, felt_m));
                continue;
            };
            let moved = reading.counts[i].wrapping_sub(motor.place);
            motor.place_s += reading.after_s;
            if !(-FLICKER_COUNTS..=FLICKER_COUNTS).contains(&moved) {
                // What creeps is held, as what stands.
                let creeps = motor.place_s > CREEP_MIN_S;
                let silent_s = if creeps { motor.silent_s + reading.after_s } else { 0.0 };
                let anew = Standing::new(reading, i, felt_m);
                let anew = anew.after_motion(moved, motor.place_s / reading.after_s);
                *motor = Standing { silent_s, ..anew };
                continue;
            }
            motor.stood_s += reading.after_s;
            motor.felt_m = motor.felt_m.or(felt_m);
            motor.silent_s += reading.after_s;
            motor.pull(i, reading, load);
            if motor.least.speed.iter().all(|speed| *speed <= 0.0) && motor.stood_s > PULLS_WITHIN_S
            {
                // Friction may have stopped it long ago: from here on it is pulled anew.
                let Standing { place, place_s, silent_s, .. } = *motor;
                let anew = Standing::new(reading, i, felt_m);
                *motor = Standing { place, place_s, silent_s, ..anew };
                continue;
            }
            let factor =
                if self.free_s >= CONTACT_GONE_S { FREE_HIDDEN_FACTOR } else { HIDDEN_FACTOR };
            let is_due = motor.stood_s > STANDING_MIN_S
                && motor.least.way().abs() >= factor * load.departure_min()[i];
            if !is_due {
                continue;
            }
            // Touch has to show the motion of a motor that nothing has braked.
            let way = motor.from_rest.way();
            let is_hidden = self.is_hidden(i, way, reading);
            let Some(motor) = &mut self.motors[i] else { continue };
            motor.images = if is_hidden { motor.images + u32::from(is_new_image) } else { 0 };
            if is_hidden && (motor.images >= CONFIRMING_IMAGES || self.free_s >= CONTACT_GONE_S) {
                found = found.or(Some(i));
            }
        }
        found
    }

    /// Follows what is touched: the smoothed place of the load (m) once it has settled, and whether
    /// the image is a new one.
    fn follow_touch(&mut self, reading: &Reading<'_, N>) -> (Option<f64>, bool) {
        let is_free = matches!(reading.touch, Touch::Free | Touch::Absent);
        if is_free && self.free_s == 0.0 {
            // What was touched may have held a motor that friction holds from here on.
            self.reset();
        }
        self.free_s = if is_free { self.free_s + reading.after_s } else { 0.0 };
        let felt_m = reading.touch.place_m().map(|[x_m, _]| x_m);
        if reading.has_jumped {
            self.begin_contact(reading);
        }
        self.contact_s = if felt_m.is_some() { self.contact_s + reading.after_s } else { 0.0 };
        let now_m = felt_m.unwrap_or(0.0);
        let part =
            if self.contact_s > reading.after_s { reading.after_s / PLACE_FILTER_S } else { 1.0 };
        self.place_m += part.min(1.0) * (now_m - self.place_m);
        let is_new_image = felt_m.is_some() && now_m != self.image_m;
        if is_new_image && self.contact_s > reading.after_s {
            let change_m = (now_m - self.image_m).abs();
            self.image_noise_m += IMAGE_NOISE_SHARE * (change_m - self.image_noise_m);
        }
        self.image_m = now_m;
        let felt_m = (self.contact_s > CONTACT_SETTLED_S).then_some(self.place_m);
        (felt_m, is_new_image)
    }

    /// The load is at another place of the pad: each motor is pulled anew from here on, and has
    /// stood for as long as it had.
    fn begin_contact(&mut self, reading: &Reading<'_, N>) {
        self.contact_s = 0.0;
        for (i, motor) in self.motors.iter_mut().enumerate() {
            let Some(Standing { place, place_s, silent_s, .. }) = *motor else { continue };
            let anew = Standing::new(reading, i, None);
            *motor = Some(Standing { place, place_s, silent_s, ..anew });
        }
    }

    /// Whether nothing but a dead encoder explains that motor `i`, which turned by `way` (counts)
    /// if nothing held it, has not counted.
    fn is_hidden(&self, i: usize, way: f64, reading: &Reading<'_, N>) -> bool {
        if self.free_s >= CONTACT_GONE_S {
            return true;
        }
        let Some(motor) = self.motors[i].as_ref().filter(|motor| motor.silent_s <= STANDING_MAX_S)
        else {
            return false;
        };
        let Standing { q_rad: before, felt_m: Some(felt_m), .. } = motor else { return false };
        let Touch::Contact { x_m: now_m, .. } = reading.touch else { return false };
        if !reading.calibrated {
            return false;
        }
        let (before, now) = (JointVector::from(*before), JointVector::from(*reading.q_rad));
        let tool = (self.tool_pose.0)(&now);
        let moved_m =
            (tool.translation - (self.tool_pose.0)(&before).translation).dot(tool.rotation.x_axis);
        // The joints that motor `i` alone turns.
        let mut motors = [0; N];
        motors[i] = whole(way);
        let hidden = self.gears.joints(&motors);
        let turn = hidden * (TURN_RAD / hidden.amax().max(f64::MIN_POSITIVE));
        let turned = (self.tool_pose.0)(&(now + turn)).translation - tool.translation;
        let scale = hidden.amax() / TURN_RAD;
        let due_m = turned.dot(tool.rotation.x_axis) * scale;
        let sideways_m = turned.dot(tool.rotation.y_axis) * scale;
        if due_m.abs() < sideways_m.abs().max(FELT_MOTION_MIN_M) {
            // Along its other axis the finger shifts the middle of the load in no known way.
            return false;
        }
        let pressed_m = turned.dot(tool.rotation.z_axis) * scale;
        if self.contact_s < PRESSED_SETTLED_S && pressed_m > PRESSED_SHARE_MAX * due_m.abs() {
            // What is pressed on anew holds the finger, and may roll away by itself.
            return false;
        }
        let least_m = PAD_MOTION_SHARES
            .map(|share| due_m.signum() * ((felt_m - now_m) / share - moved_m))
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        let noise_m = IMAGE_NOISE_FACTOR * self.image_noise_m;
        (now_m - felt_m).abs() >= PAD_MOTION_MIN_M.max(noise_m)
            && least_m >= FELT_MOTION_MIN_M.max(noise_m).max(FELT_SHARE_MIN * due_m.abs())
    }
}

#[cfg(test)]
mod tests;
