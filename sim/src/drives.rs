//! Drives that close a loop themselves, before the motors of the simulated arm: a power section for
//! each motor, and a cascade that makes its current code four times a millisecond. A scene that
//! drives its motors by codes has none, and pays nothing.
//!
//! The cascade is that of common drives: `v = v_f + w_p (x_t - x)` for positions, and
//! `a = w_v (v - v_a) + w_v w_i sum (v - v_a) dt` for velocities, where `x_t` moves on a straight
//! line from one target to the next within a control period and `v_f` is its slope. The code is the
//! acceleration times what the motor alone has to move in the pose at the start. The drive's own
//! sensor resolves finer than the counts that it reports.

mod halves;
mod model;

use taktil_hal::{CHANNELS, Counts, DriveActual, DriveCommand, DriveLoop, DriveRequest, Nanos};

use crate::devices::LONGEST_SILENCE;
use crate::hash::Hash;
use crate::manipulator::{Manipulator, MotorMotion};

pub(crate) use halves::{DriveLinks, connect_drives};
use model::{DriveModel, MotorScale, Surroundings};

/// From one look of a drive at its motor to the next.
const DRIVE_PERIOD: Nanos = Nanos::from_micros(250);

/// What the drives of an arm have in common.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveSpec {
    pub(crate) control_loop: DriveLoop,
    pub(crate) joints: usize,
    /// Lowest and highest code of a current.
    pub(crate) code_min: i32,
    pub(crate) code_max: i32,
}

impl DriveSpec {
    /// Lowest and highest target.
    pub(crate) fn target_range(&self) -> (i32, i32) {
        match self.control_loop {
            DriveLoop::Torque => (self.code_min, self.code_max),
            DriveLoop::Velocity | DriveLoop::Position => (i32::MIN, i32::MAX),
        }
    }
}

/// The drives of an arm in time.
#[derive(Debug)]
pub(crate) struct DriveBank {
    pub(crate) spec: DriveSpec,
    pub(crate) links: DriveLinks,
    drives: Vec<DriveModel>,
    command: DriveCommand,
    commanded: Nanos,
    /// The instant of the next look.
    next: Nanos,
    control_period: Nanos,
    /// What was sent last.
    pub(crate) sent: Option<([DriveActual; CHANNELS], Nanos)>,
}

impl DriveBank {
    /// The drives of a manipulator that has motors.
    pub(crate) fn new(
        spec: DriveSpec,
        links: DriveLinks,
        finger: &dyn Manipulator,
        control_period: Nanos,
    ) -> Option<DriveBank> {
        let codes = finger.codes_per_acceleration()?;
        let turn = finger.home_counts()?.counts_per_turn;
        let scale = |motor: usize| MotorScale {
            codes_per_count_s2: codes[motor],
            counts_per_turn: turn[motor].abs(),
            code_min: f64::from(spec.code_min),
            code_max: f64::from(spec.code_max),
        };
        let motors = 0..codes.len().min(turn.len());
        let drives = motors.map(scale).map(DriveModel::new).collect();
        Some(DriveBank {
            spec,
            links,
            drives,
            command: DriveCommand::SAFE,
            commanded: Nanos::ZERO,
            next: Nanos::ZERO,
            control_period,
            sent: None,
        })
    }

    /// A copy with other links.
    pub(crate) fn with_links(&self, links: DriveLinks) -> DriveBank {
        DriveBank {
            spec: self.spec,
            links,
            drives: self.drives.clone(),
            command: self.command,
            commanded: self.commanded,
            next: self.next,
            control_period: self.control_period,
            sent: self.sent,
        }
    }

    /// Takes the commands that act by `t`, and steps the drives that look at their motors then;
    /// returns the codes of the currents, and whether a drive has torque.
    pub(crate) fn advance(
        &mut self,
        t: Nanos,
        motion: &MotorMotion,
        is_powered: bool,
    ) -> ([i32; CHANNELS], bool) {
        while let Some(word) = self.links.commands.next(t) {
            (self.command, self.commanded) = (word.value, t);
            for (drive, target) in self.drives.iter_mut().zip(self.command.targets) {
                drive.take(target, t, self.command.reset);
            }
        }
        let is_silent = t - self.commanded >= LONGEST_SILENCE;
        let request = if is_silent { DriveRequest::Off } else { self.command.request };
        let around = Surroundings {
            t,
            control_loop: self.spec.control_loop,
            request,
            is_powered,
            is_silent: is_silent && self.command.request != DriveRequest::Off,
            control_period: self.control_period,
        };
        let looks = t >= self.next;
        for (i, drive) in self.drives.iter_mut().enumerate() {
            drive.switch(&around, motion.counts[i], motion.counts_s[i]);
            if looks {
                drive.look(&around, motion.counts[i], motion.counts_s[i], DRIVE_PERIOD);
            }
        }
        if looks {
            self.next = t + DRIVE_PERIOD;
        }
        let mut codes = [0; CHANNELS];
        for (code, drive) in codes.iter_mut().zip(&self.drives) {
            *code = drive.code();
        }
        (codes, self.drives.iter().any(DriveModel::has_torque))
    }

    /// The next instant after `t` at which something happens.
    pub(crate) fn next_event(&self, t: Nanos) -> Nanos {
        let silent = Some(self.commanded + LONGEST_SILENCE);
        let events = [Some(self.next), self.links.commands.next_visible(), silent];
        events.into_iter().flatten().filter(|at| *at > t).min().unwrap_or(Nanos::MAX)
    }

    /// Sends the reports of `t`.
    pub(crate) fn latch(&mut self, t: Nanos, counts: &[Counts; CHANNELS], motion: &MotorMotion) {
        let mut reports = [DriveActual::default(); CHANNELS];
        for (i, drive) in self.drives.iter().enumerate() {
            reports[i] = drive.report(counts[i], motion.counts_s[i]);
        }
        self.sent = Some((reports, t));
        // A full link counts the values that it loses.
        let _ = self.links.reports.send(reports, t, t);
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.word(self.commanded.0.cast_unsigned());
        hash.word(self.next.0.cast_unsigned());
        hash.word(self.command.request as u64);
        hash.word(u64::from(self.command.reset));
        for drive in &self.drives {
            drive.digest(hash);
        }
    }
}
