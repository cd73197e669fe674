//! Our law: the errors of the features, taken through the inverse of the coupled feature Jacobian
//! that the contact's model gives for the image at hand ([`jacobian`]), are watched by an observer
//! for each axis ([`observer`]) that knows the delay, the commands under way and the motion of the
//! table; every job of the servo gets a velocity from it, between images too. Refuses to act on an
//! image that is not trusted, to remember anything of a contact that is lost, and to go on for long
//! without an image that says something.
//!
//! ```text
//! image -> e = (J'WJ + P)^-1 J'W (F_d - F_a) -> observer: e, d, b of each axis
//! job   -> v_x = k_x e_x, limited in speed and in change
//!          v_i = k_i e_i + d_i + b_i v_x     (z, theta_x, theta_z), limited
//! ```
//! Sum and moment of the load are those by the shape that the contact's model gives a row's load
//! ([`crate::perception::line::Shape`]), which have less noise, times the ratio that the plain ones
//! have to them in the mean of a second: what the shape is wrong by drops out.
//!
//! The disturbance d is the integral action: a table that turns or rises at an even rate is
//! followed without lag. The slope b makes the answer to a tilted table change sign with the
//! direction of rolling at once.

pub mod jacobian;
pub mod observer;
pub mod opposed;

use nalgebra::Matrix4;
use serde::Deserialize;
use taktil_rtcore::{Fold, Invalid, StateHash};

use crate::config::Config;
use crate::perception::Touch;
use crate::perception::line::Line;
use jacobian::{Contact, Felt, PITCH_MM, displacement};
use observer::{Axis, Noise};

/// Jobs whose commands are remembered: at an image not more of them may be under way.
pub const WAY: usize = 32;
const _: () = assert!(WAY == 32, "what `Model::delay_ms` says");
/// Middle of the columns.
const MIDDLE: f64 = 8.5;
/// The pin is rolled only while the load's centre lies within so many rows of the middle.
const LEVEL_ROWS: f64 = 3.5;
/// Without an image that says something the law stands still after this time (s).
const BLIND_S: f64 = 0.05;

taktil_rtcore::explained! {
    /// `[tactile_servo.model]`
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Model {
        /// Gains of (x, z, theta_x, theta_z) on the way left (1/s). Default (20, 25, 12, 8).
        pub gain_per_s: [f64; 4],
        /// Largest speeds of (x, z, theta_x, theta_z) (mm/s, mm/s, mrad/s, mrad/s). Default (12,
        /// 15, 300, 500).
        pub speed: [f64; 4],
        /// Largest change of the speed of rolling (mm/s^2). Default 100.
        pub roll_mm_s2: f64,
        /// How fast the finger gives way to what pushes it along the pin, which touch cannot see
        /// (1/s). Default 8; 0 stands still there.
        pub yield_per_s: f64,
        /// From a command to the motion of the finger (ms), with the age of an image at most 32
        /// jobs. Default 7.5.
        pub delay_ms: f64,
        /// Process noise of the rates of the table along and about (x, z, theta_x, theta_z): how
        /// fast they are believed to change (mm/s/sqrt s, mrad/s/sqrt s). Default (20, 4, 60, 60).
        pub table_rate: [f64; 4],
        /// Process noise of the slopes of the table, the way along and about (z, theta_x, theta_z)
        /// that comes with each millimetre of rolling (mm/mm/sqrt s, mrad/mm/sqrt s). Default
        /// (0.05, 0.5, 0.5).
        pub table_slope: [f64; 3],
        /// Standard deviation of a tactel (counts) where none was measured with the baseline.
        /// Default 50.
        pub noise_counts: f64,
        /// Counts that a newton makes. Default 4095/4.
        pub counts_per_n: f64,
        /// Radius of the pin that the contact is solved for (mm). Default 23.
        pub pin_radius_mm: f64,
        /// Thickness of the pad's rubber (mm). Default 0.8.
        pub pad_thickness_mm: f64,
        /// Young's modulus of the pad's rubber (MPa). Default 2.
        pub pad_mpa: f64,
        /// Poisson's ratio of the pad's rubber. Default 0.49.
        pub pad_poisson: f64,
        /// Stiffness of what lies behind pad and pin, arm and table, along z (N/mm). Default 14.
        pub support_n_mm: f64,
        /// Stiffness of what lies behind pad and pin about x (N m/rad). Default 20.
        pub support_nm_rad: f64,
    }
}

impl Default for Model {
    fn default() -> Model {
        Model {
            gain_per_s: [20.0, 25.0, 12.0, 8.0],
            speed: [12.0, 15.0, 300.0, 500.0],
            roll_mm_s2: 100.0,
            yield_per_s: 8.0,
            delay_ms: 7.5,
            table_rate: [20.0, 4.0, 60.0, 60.0],
            table_slope: [0.05, 0.5, 0.5],
            noise_counts: 50.0,
            counts_per_n: 4095.0 / 4.0,
            pin_radius_mm: 23.0,
            pad_thickness_mm: 0.8,
            pad_mpa: 2.0,
            pad_poisson: 0.49,
            support_n_mm: 14.0,
            support_nm_rad: 20.0,
        }
    }
}

impl Model {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let within = |place: String, value: f64, low: f64, high: f64| {
            if low <= value && value <= high {
                return Ok(());
            }
            Err(Invalid::new(place, format!("is {value}"), format!("give {low} to {high}")))
        };
        for i in 0..4 {
            within(format!("gain_per_s[{i}]"), self.gain_per_s[i], 0.0, 200.0)?;
            within(format!("speed[{i}]"), self.speed[i], 1e-3, 3_000.0)?;
            within(format!("table_rate[{i}]"), self.table_rate[i], 0.0, 1e4)?;
        }
        for (i, value) in self.table_slope.iter().enumerate() {
            within(format!("table_slope[{i}]"), *value, 0.0, 1e3)?;
        }
        let rows = [
            ("roll_mm_s2", self.roll_mm_s2, 1.0, 1e5),
            ("yield_per_s", self.yield_per_s, 0.0, 100.0),
            ("delay_ms", self.delay_ms, 0.0, 40.0),
            ("noise_counts", self.noise_counts, 0.1, 1e4),
            ("counts_per_n", self.counts_per_n, 1e-3, 1e6),
            ("pin_radius_mm", self.pin_radius_mm, 1.0, 500.0),
            ("pad_thickness_mm", self.pad_thickness_mm, 0.05, 100.0),
            ("pad_mpa", self.pad_mpa, 0.01, 1e3),
            ("pad_poisson", self.pad_poisson, 0.0, 0.4999),
            ("support_n_mm", self.support_n_mm, 1e-3, 1e6),
            ("support_nm_rad", self.support_nm_rad, 1e-3, 1e6),
        ];
        for (place, value, low, high) in rows {
            within(place.to_owned(), value, low, high)?;
        }
        Ok(())
    }

    /// Whether what is under way at an image that is one image's time old, or one more when it is
    /// late, is remembered, with jobs `dt_s` apart.
    ///
    /// # Errors
    /// A delay of more jobs than [`WAY`]; the place is `delay_ms`.
    pub fn check_period(&self, dt_s: f64, image_s: f64) -> Result<(), Invalid> {
        let most_ms = 1e3 * (WAY as f64 * dt_s - 2.0 * image_s);
        if self.delay_ms <= most_ms + 1e-9 {
            return Ok(());
        }
        let (job_ms, image_ms) = (1e3 * dt_s, 1e3 * image_s);
        Err(Invalid::new(
            "delay_ms",
            format!(
                "{} ms and an image that is two of {image_ms} ms old are more than the {WAY} jobs \
                 of {job_ms} ms whose commands the law remembers",
                self.delay_ms
            ),
            format!("give at most {} ms, or a lane with a longer period", most_ms.max(0.0)),
        ))
    }

    /// What the observer of axis `i` believes.
    fn noise(&self, i: usize) -> Noise {
        let way = [0.5, 0.02, 2.0, 2.0][i];
        let slope = if i == 0 { 0.0 } else { self.table_slope[i - 1] };
        let model = [0.05, 0.02, 0.3, 2.0][i];
        let most = [self.speed[i], [1e-9, 0.5, 20.0, 20.0][i]];
        Noise { way, rate: self.table_rate[i], slope, most, model }
    }
}

/// Images over which sum and shaped sum are compared: 1 s at 200 Hz.
const COMPARED: f64 = 200.0;

/// Means of a line's sum and of the same by the shape (counts), over so many images: their ratio is
/// what the shape is wrong by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Scale {
    sum: f64,
    shaped: f64,
    images: f64,
}

impl Scale {
    /// With another image's.
    fn with(&self, line: &Line) -> Scale {
        let images = (self.images + 1.0).min(COMPARED);
        Scale {
            sum: self.sum + (line.features[1] - self.sum) / images,
            shaped: self.shaped + (line.shaped[0] - self.shaped) / images,
            images,
        }
    }

    /// The line with sum and moment by the shape, as large as they are in the mean.
    fn line(&self, line: &Line) -> Line {
        let by = self.sum / self.shaped;
        let mut out = *line;
        if by > 0.5 && by < 2.0 {
            for i in [0, 1] {
                out.features[i + 1] = by * line.shaped[i];
                out.variance[i + 1] = by * by * line.shaped_variance[i];
            }
        }
        out
    }
}

/// What the law remembers of the contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Memory {
    axes: [Axis; 4],
    scale: Scale,
    /// Commands of the latest jobs, newest at `newest`.
    commands: [[f64; 4]; WAY],
    newest: usize,
    speed_x_mm_s: f64,
    /// Images seen of this contact.
    images: u32,
    rolls: bool,
    /// Time since the last image that said something (s).
    blind_s: f64,
}

impl Fold for Memory {
    fn fold(&self, hash: &mut StateHash) {
        for axis in &self.axes {
            hash.add(axis);
        }
        hash.add(&self.scale.sum).add(&self.scale.shaped).add(&self.scale.images);
        for command in &self.commands {
            hash.add(&command[..]);
        }
        hash.add(&self.newest).add(&self.speed_x_mm_s).add(&self.images).add(&self.rolls);
        hash.add(&self.blind_s);
    }
}

impl Memory {
    /// Of nothing.
    #[must_use]
    pub fn new(model: &Model) -> Memory {
        Memory {
            axes: core::array::from_fn(|i| Axis::new(&model.noise(i))),
            scale: Scale::default(),
            commands: [[0.0; 4]; WAY],
            newest: 0,
            speed_x_mm_s: 0.0,
            images: 0,
            rolls: false,
            blind_s: 0.0,
        }
    }

    /// Speed of the line over the columns (columns/s).
    #[must_use]
    pub fn line_cols_s(&self) -> f64 {
        -0.5 * self.speed_x_mm_s / PITCH_MM
    }

    /// There is an image of this contact.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.images > 0
    }

    /// The column where the contact will be once the commands so far are carried out.
    #[must_use]
    pub fn column(&self) -> Option<f64> {
        self.holds().then(|| MIDDLE + 0.5 / PITCH_MM * self.axes[0].state[0])
    }

    /// Commands of the last `jobs` jobs.
    fn under_way(&self, jobs: usize) -> [f64; 4] {
        let mut sum = [0.0; 4];
        for back in 0..jobs.min(WAY) {
            let command = &self.commands[(self.newest + WAY - back) % WAY];
            for (total, part) in sum.iter_mut().zip(command) {
                *total += part;
            }
        }
        sum
    }
}

/// Takes an image in that is `age_s` old; jobs are `dt_s` apart.
#[must_use]
pub fn observe(
    config: &Config,
    contact: &Contact,
    memory: &Memory,
    seen: (&Touch, Option<&Line>),
    times: (f64, f64),
) -> Memory {
    observe_both(config, contact, memory, (seen, |_, _| None), times)
}

/// The same with another fingertip that touches the pin: `other` says what it felt at this image,
/// for the finger's line and Jacobian.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to WAY")]
pub fn observe_both(
    config: &Config,
    contact: &Contact,
    memory: &Memory,
    ((touch, line), other): (
        (&Touch, Option<&Line>),
        impl FnOnce(&Line, &Matrix4<f64>) -> Option<Felt>,
    ),
    (age_s, dt_s): (f64, f64),
) -> Memory {
    let model = &config.model;
    if !touch.trusted || age_s > BLIND_S {
        return *memory;
    }
    if !touch.contact {
        return Memory::new(model);
    }
    // Load that lies along no line tells nothing of the four motions.
    let Some(line) = line else { return *memory };
    let wanted = [MIDDLE, config.m0_counts, config.m_x_counts, config.theta_z_mrad];
    let scale = memory.scale.with(line);
    let line = &scale.line(line);
    let [x_c, m0, m_x, theta_z] = line.features;
    let found = [x_c, m0, m_x, 1e3 * theta_z];
    let error: [f64; 4] = core::array::from_fn(|i| wanted[i] - found[i]);
    let mut variance = line.variance;
    variance[3] *= 1e6;
    let delay_s = age_s + 1e-3 * model.delay_ms;
    let jobs = (delay_s / dt_s.max(1e-6)).round();
    // Older than what is remembered: nobody knows any more what was under way then.
    if !(0.0..=WAY as f64).contains(&jobs) {
        return *memory;
    }
    let jobs = jobs as usize;
    let jacobian = contact.jacobian(line);
    let own = Felt { jacobian, error, variance };
    let other = other(line, &jacobian);
    let (way, spread) = displacement(core::iter::once(&own).chain(&other));
    let sums = memory.under_way(jobs);
    let mut next = Memory { scale, ..*memory };
    for (i, axis) in next.axes.iter_mut().enumerate() {
        let under_way = (sums[i], if i == 0 { 0.0 } else { sums[0] }, delay_s);
        axis.observe(&model.noise(i), way[i], spread[i], under_way);
    }
    next.images = next.images.saturating_add(1);
    next.rolls = m0 >= config.roll_from_counts && m_x.abs() < LEVEL_ROWS * m0;
    next.blind_s = 0.0;
    next
}

/// The displacement for a job of `dt_s`, towards column `x_c_desired`; nothing before the first
/// image of a contact.
#[must_use]
pub fn displacement_of_job(
    config: &Config,
    memory: &Memory,
    x_c_desired: f64,
    dt_s: f64,
) -> [f64; 4] {
    let model = &config.model;
    if !memory.holds() || memory.blind_s > BLIND_S {
        return [0.0; 4];
    }
    let limited = |i: usize, speed: f64| speed.clamp(-model.speed[i], model.speed[i]);
    let target_mm = (MIDDLE - x_c_desired) * 2.0 * PITCH_MM;
    let left = memory.axes[0].state[0] + target_mm;
    let wanted = if memory.rolls {
        limited(0, model.gain_per_s[0] * left + memory.axes[0].state[1])
    } else {
        0.0
    };
    let change = model.roll_mm_s2 * dt_s;
    let roll = memory.speed_x_mm_s + (wanted - memory.speed_x_mm_s).clamp(-change, change);
    let mut out = [roll * dt_s, 0.0, 0.0, 0.0];
    for (i, part) in out.iter_mut().enumerate().skip(1) {
        let [e, d, b] = memory.axes[i].state;
        *part = limited(i, model.gain_per_s[i] * e + d + b * roll) * dt_s;
    }
    out
}

/// The memory after a job in which `displacement` was carried out.
#[must_use]
pub fn after_job(model: &Model, memory: &Memory, displacement: &[f64; 4], dt_s: f64) -> Memory {
    let mut next = *memory;
    next.newest = (memory.newest + 1) % WAY;
    next.commands[next.newest] = *displacement;
    if !memory.holds() {
        return next;
    }
    next.blind_s += dt_s;
    next.speed_x_mm_s = if dt_s > 0.0 { displacement[0] / dt_s } else { 0.0 };
    for (i, axis) in next.axes.iter_mut().enumerate() {
        let roll_mm = if i == 0 { 0.0 } else { displacement[0] };
        axis.advance(&model.noise(i), displacement[i], roll_mm, dt_s);
    }
    next
}
