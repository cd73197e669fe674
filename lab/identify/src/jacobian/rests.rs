//! The rests of the finger in contact: the displacement, measured or commanded, and the features of
//! the images. A rest that is too short to average is left out; a contact that was lost between two
//! rests is an error.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::{Pose, rotation_vector};
use taktil_rtcore::ArrayPayload;
use taktil_signal::TactileImage;
use taktil_tasks_tactile_servo::config::array::Array;
use taktil_tasks_tactile_servo::perception::{TouchFeatures, touch_features};

use taktil_machine_console::option::BadOption;
use taktil_record::Log;

/// Number of motions of the sensor: along x, y, z (mm) and about them (mrad).
pub const MOTION_COUNT: usize = 6;
/// Number of features: M0, x_c, y_c, M_x, theta_z.
pub const FEATURE_COUNT: usize = 5;
/// Smallest number of images in a rest.
const IMAGES_MIN: usize = 10;
/// Largest change of a joint from job to job while it stands still (rad).
const STANDSTILL_STEP_MAX_RAD: f64 = 1e-9;

/// How images are read.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Tactels below this count as 0; three standard deviations of the noise when absent.
    pub threshold_counts: Option<f64>,
    /// The sum of counts above which there is contact.
    pub contact_counts: f64,
    /// Time that is left out at the beginning of a rest (s).
    pub settle_s: f64,
    /// Whether all motions are the commanded ones, not only the one along z.
    pub commanded: bool,
}

/// One rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// Instant of its middle (s).
    pub at_s: f64,
    /// Displacement from the first rest, in the sensor's frame at the first rest.
    pub motion: [f64; MOTION_COUNT],
    /// Mean of each feature that is defined in every image of the rest.
    pub mean: [Option<f64>; FEATURE_COUNT],
    /// Variance of each feature from image to image.
    pub variance: [f64; FEATURE_COUNT],
    /// Number of images.
    pub images: usize,
    /// Index of its run: consecutive rests to which the same motion led.
    pub run: usize,
}

fn bad(what: String) -> BadOption {
    BadOption(what)
}

/// The features in the order of [`FEATURE_COUNT`].
fn feature_values(touch: &TouchFeatures) -> [Option<f64>; FEATURE_COUNT] {
    [
        touch.contact.then_some(touch.m0),
        touch.x_c,
        touch.y_c,
        touch.contact.then_some(touch.m_x),
        touch.theta_z_rad.map(|theta| 1e3 * theta),
    ]
}

/// Joint angles over time.
struct Angles {
    t_s: Vec<f64>,
    q_rad: Vec<Joints>,
}

impl Angles {
    fn from_log(log: &Log, signal: &str) -> Result<Angles, BadOption> {
        let series = log.series(signal).filter(|series| !series.is_empty());
        let series = series.ok_or_else(|| {
            bad(format!("the log has no `{signal}`; name the log of another run"))
        })?;
        let q = series.column("q_rad").filter(|column| column.width == 6);
        let q = q.ok_or_else(|| bad("only the PUMA 260 moves by touch".into()))?;
        let q_rad = (0..series.len()).map(|row| Joints::from_row_slice(q.row(row))).collect();
        Ok(Angles { t_s: series.t_s, q_rad })
    }

    /// Begin and end of each standstill (s).
    fn standstills(&self) -> Vec<(f64, f64)> {
        let (mut found, mut first) = (Vec::new(), 0);
        for row in 1..=self.q_rad.len() {
            let stands =
                |now: &Joints| (now - self.q_rad[row - 1]).amax() <= STANDSTILL_STEP_MAX_RAD;
            if !self.q_rad.get(row).is_some_and(stands) {
                found.push((self.t_s[first], self.t_s[row - 1]));
                first = row;
            }
        }
        found
    }

    /// Mean between two instants; `None` without samples there.
    fn mean(&self, from_s: f64, to_s: f64) -> Option<Joints> {
        let begin = self.t_s.partition_point(|t| *t < from_s);
        let end = self.t_s.partition_point(|t| *t <= to_s);
        let part = self.q_rad.get(begin..end).filter(|part| !part.is_empty())?;
        Some(part.iter().sum::<Joints>() / part.len() as f64)
    }
}

/// The instant (s) and the features of every image.
fn image_features(log: &Log, reading: &Reading) -> Result<Vec<(f64, TouchFeatures)>, BadOption> {
    let channel = log.find("tactile_scan.image");
    let channel = channel.ok_or_else(|| {
        bad("the log has no `tactile_scan.image`; name the log of another run".into())
    })?;
    let unreadable = || bad("an image of the log cannot be read".into());
    let length = |name: &str| log.channels()[channel].field_length(name);
    let mut image = TactileImage::with_lengths(&length).ok_or_else(unreadable)?;
    let mut found = Vec::new();
    for message in log.messages().filter(|message| message.channel == channel) {
        let body = message.body.get(..image.size()).unwrap_or_default();
        if !image.decode_into(body) {
            return Err(unreadable());
        }
        let noise = f64::from(image.noise_counts);
        let threshold = reading.threshold_counts.unwrap_or(3.0 * noise);
        // A log does not say how far apart the tactels are: as far along both axes.
        let (rows, cols) = (u32::from(image.rows), u32::from(image.cols));
        let array = Array { rows, cols, ..Array::default() };
        let seen = touch_features(&image, &array, threshold, reading.contact_counts);
        found.push((image.acquired_ns as f64 * 1e-9, seen));
    }
    Ok(found)
}

/// The displacement from one pose to another, in the axes of the first.
fn displacement(from: &Pose, to: &Pose) -> [f64; MOTION_COUNT] {
    let way = from.rotation.transpose() * (to.translation - from.translation) * 1e3;
    let turn = rotation_vector(&from.rotation, &to.rotation) * 1e3;
    [way.x, way.y, way.z, turn.x, turn.y, turn.z]
}

/// The motion that changed most between two displacements; a lever of about a hand's width converts
/// rotations to millimetres.
fn largest_motion(from: &[f64; MOTION_COUNT], to: &[f64; MOTION_COUNT]) -> usize {
    let size = |j: usize| (to[j] - from[j]).abs() * if j < 3 { 1.0 } else { 0.1 };
    (0..MOTION_COUNT).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0)
}

/// Mean and variance of the features of several images.
fn feature_statistics(
    images: &[(f64, TouchFeatures)],
) -> ([Option<f64>; FEATURE_COUNT], [f64; FEATURE_COUNT]) {
    let (mut mean, mut variance) = ([None; FEATURE_COUNT], [0.0; FEATURE_COUNT]);
    let n = images.len() as f64;
    for feature in 0..FEATURE_COUNT {
        let values: Option<Vec<f64>> =
            images.iter().map(|(_, touch)| feature_values(touch)[feature]).collect();
        let Some(values) = values else { continue };
        let middle = values.iter().sum::<f64>() / n;
        mean[feature] = Some(middle);
        let square = values.iter().map(|v| (v - middle) * (v - middle)).sum::<f64>();
        variance[feature] = square / (n - 1.0).max(1.0);
    }
    (mean, variance)
}

/// The rests of a log in contact.
///
/// # Errors
/// [`BadOption`]: signals that are missing, or contact that was lost between rests.
pub fn rests(log: &Log, reading: &Reading) -> Result<Vec<Rest>, BadOption> {
    let (commanded, images) =
        (Angles::from_log(log, "setpoint.desired")?, image_features(log, reading)?);
    let measured = Angles::from_log(log, "sense.joints")?;
    let arm = Puma260::reference();
    let (mut found, mut origin): (Vec<Rest>, Option<[Pose; 2]>) = (Vec::new(), None);
    let (mut run, mut before) = (0, (None, [0.0; MOTION_COUNT]));
    let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
    for (from_s, to_s) in commanded.standstills() {
        let begin = images.partition_point(|(t_s, _)| *t_s < from_s + reading.settle_s);
        let end = images.partition_point(|(t_s, _)| *t_s <= to_s);
        if end < begin + IMAGES_MIN || images[begin..end].iter().any(|(_, touch)| !touch.contact) {
            continue;
        }
        let inside = &images[begin..end];
        let mean = |angles: &Angles| angles.mean(from_s + reading.settle_s, to_s);
        let Some((wanted, real)) = mean(&commanded).zip(mean(&measured)) else { continue };
        (first_s, last_s) = (first_s.min(inside[0].0), to_s);
        let poses = [wanted, real].map(|q| arm.tool_pose(&q));
        let origins = origin.get_or_insert(poses);
        let [wanted, real] = [0, 1].map(|i| displacement(&origins[i], &poses[i]));
        let made = largest_motion(&before.1, &wanted);
        run += usize::from(before.0.is_some_and(|before| before != made));
        before = ((!found.is_empty()).then_some(made), wanted);
        let mut motion = if reading.commanded { wanted } else { real };
        // Along the contact normal the arm hardly moves: there the deflection of the servo's spring
        // counts.
        motion[2] = wanted[2];
        let (mean, variance) = feature_statistics(inside);
        found.push(Rest {
            at_s: 0.5 * (inside[0].0 + to_s),
            motion,
            mean,
            variance,
            images: inside.len(),
            run,
        });
    }
    let between = |t_s: f64| t_s >= first_s && t_s <= last_s;
    if let Some((t_s, _)) = images.iter().find(|(t, touch)| between(*t) && !touch.contact) {
        let remedy = "make smaller motions, or press more";
        return Err(bad(format!("contact was lost at {t_s:.2} s, between two rests; {remedy}")));
    }
    Ok(found)
}
