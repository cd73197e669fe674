//! The simulated bench in time: integrates all bodies in sub-steps between events, applies each
//! command from its own instant, and latches the devices at theirs. Only `advance(to)` moves it,
//! whoever calls that and whenever.
//!
//! Events are the multiples of the control and scan periods, the instants from which commands act,
//! the supply coming on, and the watchdogs. The interval between two events (or the end of an
//! `advance`) is divided evenly into steps of at most `substep_us`. The state therefore depends on
//! the division of time among the calls, in the last bits only, and repeats exactly when the calls
//! repeat.

use glam::DVec3;
use taktil_hal::{
    AdcCode, CHANNELS, Counts, Devices, DriveLoop, FORCE_TORQUE_CHANNELS, LinesIn, LinesOut, Nanos,
};
use taktil_mechanics::Joints;
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::{linear_and_angular, spatial_vector};

use crate::any_plant::AnyPlant;
use crate::contact::{Patch, Reaction};
use crate::devices::{ARRAYS_MAX, BoardSpec, LONGEST_SILENCE, WorldLinks};
use crate::drives::{DriveBank, DriveSpec, connect_drives};
use crate::electronics::{TactileSensor, Wrist, currents};
use crate::faults::Faults;
use crate::hand::grasp::HandTruth;
use crate::hash::Hash;
use crate::index_pulses::{IndexPulseModel, IndexPulsePlaces};
use crate::last_sent::LastSent;
use crate::manipulator::DriveLines;
use crate::manipulator::JOINTS_MAX;
use crate::pin::Pin;
use crate::scene::{FaultKind, Invalid, Timing, invalid};
use crate::step::StepStatistics;
use crate::truth::{
    ObjectContact, OpposedFingertip, Truth, contact_x_tactels, creepage, yaw_and_tilt,
};

/// The whole simulated bench, built by [`build`](crate::build).
#[derive(Debug)]
pub struct World {
    pub(crate) t: Nanos,
    pub(crate) timing: Timing,
    pub(crate) power_on: Nanos,
    pub(crate) plant: AnyPlant,
    /// The tactile arrays of the finger and of the fingertip opposed to it, or of a hand's fingers.
    pub(crate) arrays: [Option<Box<TactileSensor>>; ARRAYS_MAX],
    pub(crate) wrist: Option<Wrist>,
    pub(crate) faults: Faults,
    /// Whether the manipulator is a hand, which makes the images of all arrays.
    pub(crate) is_hand: bool,
    pub(crate) links: WorldLinks,
    pub(crate) next_control: Nanos,
    /// Sequence numbers of their next scans.
    pub(crate) sequences: [u32; ARRAYS_MAX],
    /// Latest readings of the encoders, and of the gauges below.
    pub(crate) counts: [Counts; CHANNELS],
    pub(crate) index: Option<IndexPulseModel>,
    pub(crate) gauges: [AdcCode; FORCE_TORQUE_CHANNELS],
    pub(crate) codes: [i32; CHANNELS],
    pub(crate) lines_out: LinesOut,
    pub(crate) last_code_time: Nanos,
    pub(crate) last_feed_time: Nanos,
    pub(crate) last_sent: LastSent,
    /// Drives that close a loop, in place of converters and amplifiers.
    pub(crate) drives: Option<Box<DriveBank>>,
}

impl World {
    /// The instant up to which the bench was integrated.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.t
    }

    /// Puts drives that close a loop themselves between the boards and the motors: `devices` then
    /// has their halves in place of the converters. Before the first [`World::advance`].
    ///
    /// # Errors
    /// A manipulator without motors; the place is empty.
    pub fn add_drives(
        &mut self,
        devices: &mut Devices,
        control_loop: DriveLoop,
    ) -> Result<(), Invalid> {
        let BoardSpec { joints, code_min, code_max } = self.last_sent.board;
        let spec = DriveSpec { control_loop, joints, code_min, code_max };
        let links = connect_drives(self.timing.actuation_delay, spec, devices);
        let period = self.timing.control_period;
        let Some(bank) = DriveBank::new(spec, links, self.plant.finger(), period) else {
            let what = "has no motors that drives could turn".to_owned();
            return Err(invalid("", what, "leave `drive_loop` out"));
        };
        self.drives = Some(Box::new(bank));
        self.latch_drives();
        Ok(())
    }

    /// Periods and delays of the simulated boards.
    #[must_use]
    pub fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Integrates up to `to`; an instant that has passed changes nothing. Does not allocate and
    /// does not block.
    pub fn advance(&mut self, to: Nanos) {
        while self.t < to {
            self.apply_commands();
            let next = self.next_event().min(to);
            self.plant.integrate(self.t, next);
            self.t = next;
            self.latch();
        }
    }

    /// The codes on the D/A outputs.
    #[must_use]
    pub fn analog_out(&self) -> [i32; CHANNELS] {
        self.codes
    }

    /// The lines on the digital outputs.
    #[must_use]
    pub fn digital_out(&self) -> LinesOut {
        self.lines_out
    }

    /// The readings of the encoders now, between the instants at which the devices latch them too;
    /// those of dead encoders as they were latched last.
    #[must_use]
    pub fn encoder_counts(&self) -> [Counts; CHANNELS] {
        let mut counts = self.counts;
        for (joint, count) in self.plant.finger().counts().into_iter().enumerate() {
            if !self.faults.has_dead_encoder(joint, self.t) {
                counts[joint] = Counts(count);
            }
        }
        counts
    }

    /// Where the index pulses of the encoders' discs come, one element a joint; absent where the
    /// scene describes none.
    #[must_use]
    pub fn index_pulse_places(&self) -> Option<Vec<IndexPulsePlaces>> {
        self.index.as_ref().map(IndexPulseModel::places)
    }

    /// The lines from the cell now.
    #[must_use]
    pub fn lines_in(&self) -> LinesIn {
        let closed = !self.is_emergency_stopped();
        LinesIn { drive_power: self.is_powered(), estop_a_closed: closed, estop_b_closed: closed }
    }

    /// Whether the scene asks for contacts in three dimensions and an array exists that shows them.
    /// Then [`StepStatistics::spatial_solutions`] and [`StepStatistics::spatial_failures`] count
    /// the results.
    #[must_use]
    pub fn solves_in_three_dimensions(&self) -> bool {
        let pin = self.plant.rolling().is_some_and(|r| r.spatial.is_some());
        let edge = self.plant.objects().is_some_and(|objects| objects.is_spatial());
        self.arrays.iter().any(Option::is_some) && (pin || edge)
    }

    /// Counts of what the simulation computed since the start.
    #[must_use]
    pub fn statistics(&self) -> StepStatistics {
        *self.plant.statistics()
    }

    /// Largest difference of place between a step and its embedded method of lower order (m); 0
    /// for integrators without one.
    #[must_use]
    pub fn step_error_m(&self) -> f64 {
        self.plant.error_m()
    }

    /// Number of values that were lost because the devices' links were full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        let links = &self.links;
        links.counts.dropped()
            + links.marks.as_ref().map_or(0, |marks| marks.dropped())
            + links.currents.dropped()
            + links.gauges.dropped()
            + links.lines.dropped()
            + self.drives.as_ref().map_or(0, |drives| drives.links.reports.dropped())
            + links.scans.iter().map(|scans| scans.dropped()).sum::<u64>()
    }

    /// Applies every command that acts by now, then the watchdogs, then the drives' lines.
    fn apply_commands(&mut self) {
        while let Some(word) = self.links.codes.next(self.t) {
            self.codes = word.value;
            self.last_code_time = self.t;
        }
        while let Some(word) = self.links.lines_out.next(self.t) {
            if word.value.watchdog_feed != self.lines_out.watchdog_feed {
                self.last_feed_time = self.t;
            }
            self.lines_out = word.value;
        }
        if self.t - self.last_code_time >= LONGEST_SILENCE {
            self.codes = [0; CHANNELS];
        }
        if self.t - self.last_feed_time >= LONGEST_SILENCE {
            let watchdog_feed = self.lines_out.watchdog_feed;
            self.lines_out = LinesOut { watchdog_feed, ..LinesOut::SAFE };
        }
        let powered = self.is_powered();
        let mut lines = DriveLines {
            enabled: self.lines_out.enable && powered,
            braked: !(self.lines_out.brake_release && powered),
        };
        if let Some(drives) = &mut self.drives {
            let motion = self.plant.finger().motor_motion();
            (self.codes, lines.enabled) = drives.advance(self.t, &motion, powered);
        }
        self.plant.finger_mut().drive(&self.codes, lines);
    }

    fn is_powered(&self) -> bool {
        let failed =
            self.faults.is_active(FaultKind::PowerLoss, self.t) || self.is_emergency_stopped();
        self.t >= self.power_on && !failed
    }

    /// Whether somebody presses the emergency stop, which also cuts the supply.
    fn is_emergency_stopped(&self) -> bool {
        self.faults.is_active(FaultKind::EmergencyStop, self.t)
    }

    /// The next instant after now at which something other than motion happens.
    fn next_event(&self) -> Nanos {
        let events = [
            self.drives.as_ref().map(|drives| drives.next_event(self.t)),
            Some(self.next_control),
            self.arrays[0].as_ref().map(|array| array.next()),
            self.arrays[1].as_ref().map(|array| array.next()),
            self.arrays[2].as_ref().map(|array| array.next()),
            self.faults.next_change(self.t),
            Some(self.power_on),
            Some(self.last_code_time + LONGEST_SILENCE),
            Some(self.last_feed_time + LONGEST_SILENCE),
            self.links.codes.next_visible(),
            self.links.lines_out.next_visible(),
        ];
        let later = events.into_iter().flatten().filter(|instant| *instant > self.t);
        later.min().unwrap_or(Nanos::MAX)
    }

    /// Samples every device that is due now.
    pub(crate) fn latch(&mut self) {
        let control = self.t >= self.next_control;
        let due =
            |array: &Option<Box<TactileSensor>>| array.as_ref().is_some_and(|a| self.t >= a.next());
        let scans = self.arrays.each_ref().map(due);
        if !control && scans == [false; ARRAYS_MAX] {
            return;
        }
        self.plant.evaluate_contacts(self.t.as_secs_f64());
        if control {
            self.latch_control();
            self.next_control += self.timing.control_period;
        }
        for (tip, due) in scans.into_iter().enumerate() {
            if due {
                self.latch_scan(tip);
            }
        }
    }

    fn latch_control(&mut self) {
        let t = self.t;
        self.counts = self.encoder_counts();
        let lines = self.lines_in();
        let wrench = if self.wrist.is_some() { self.tool_wrench() } else { Joints::zeros() };
        let currents = currents(&self.plant.finger().current_codes());
        self.last_sent.control = Some((currents, lines, t));
        // A full link counts the values that it loses; see `dropped`.
        if let (Some(marks), Some(index)) = (&mut self.links.marks, &mut self.index) {
            let _ = marks.send(index.update(&self.counts), t, t);
        }
        let _ = self.links.counts.send(self.counts, t, t);
        let _ = self.links.currents.send(currents, t, t);
        let _ = self.links.lines.send(lines, t, t);
        self.latch_drives();
        if let Some(wrist) = &mut self.wrist {
            let read = wrist.read(&wrench);
            if !self.faults.is_active(FaultKind::FrozenWrist, t) {
                self.gauges = read;
            }
            let _ = self.links.gauges.send(self.gauges, t, t);
        }
    }

    fn latch_drives(&mut self) {
        if let Some(drives) = &mut self.drives {
            drives.latch(self.t, &self.counts, &self.plant.finger().motor_motion());
        }
    }

    /// Reads the rows of tactels that are due. A complete scan is sent, unless a fault drops it.
    fn latch_scan(&mut self, tip: usize) {
        let Some(array) = &mut self.arrays[tip] else { return };
        let t_s = self.t.as_secs_f64();
        let (opposed, forces) = (tip > 0, &mut array.forces_n);
        match (opposed, self.is_hand) {
            (_, true) => self.plant.hand_image(tip, forces),
            (true, false) => self.plant.opposed_image(t_s, forces),
            (false, false) => self.plant.image(t_s, forces),
        }
        let Some(values) = array.read(self.t) else { return };
        self.plant.statistics_mut().tactile_scans += 1;
        let sequence = self.sequences[tip];
        self.sequences[tip] = sequence.wrapping_add(1);
        let Some(feed) = &mut self.last_sent.feeds[tip] else { return };
        if !self.faults.drops_frame(self.t, opposed) {
            let (stamp, visible) = feed.delivery.instants(self.t, self.timing.scan_period);
            let scan = feed.record(sequence, values, stamp, visible);
            self.links.scans[tip].send(scan);
        }
    }

    /// Wrench on the tool about the tool point in tool axes (N, N m).
    fn tool_wrench(&self) -> Joints {
        let pose = self.plant.finger().pose();
        let rolling = self.plant.rolling().map(|r| r.wrench(pose.translation));
        let objects = self.plant.objects().map(|objects| objects.wrench(pose));
        let sum = rolling.unwrap_or_default() + objects.unwrap_or_default();
        let (force, moment) = linear_and_angular(&sum);
        let back = pose.rotation.transpose();
        spatial_vector(back * force, back * moment)
    }

    /// The true state of the bench now.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let (pose, twist) =
            (self.plant.finger().pose(), linear_and_angular(&self.plant.finger().twist()));
        let arm = self.plant.finger().puma_state().copied().unwrap_or_default();
        let DriveLines { enabled, braked } = self.plant.finger().drive_lines();
        let rolling = self.plant.rolling();
        let pin = rolling.map(|r| &r.pin);
        let finger = rolling.map_or(Reaction::default(), |r| r.finger_reaction);
        let support = rolling.map_or(Reaction::default(), |r| r.support_reaction);
        let (pin_yaw_rad, tilt_rad) = pin.map_or((0.0, 0.0), |pin| yaw_and_tilt(pin, pose));
        let deep = |patch: &Patch| {
            let deepest = patch.rubber.deepest_m();
            patch.slices.iter().any(|slice| slice.delta_m > deepest)
        };
        let objects = self.plant.objects();
        let on_objects_n = objects.map_or(0.0, |objects| objects.normal_n());
        let surroundings = || self.plant.surroundings(self.t.as_secs_f64());
        Truth {
            t: self.t,
            q: arm.q,
            qd: arm.qd,
            tool: pose.translation,
            tool_x: pose.rotation.x_axis,
            tool_z: pose.rotation.z_axis,
            tool_velocity: twist.0,
            pin: pin.map_or(DVec3::ZERO, |pin| pin.position),
            pin_axis: pin.map_or(DVec3::Y, Pin::axis),
            pin_roll_rad: pin.map_or(0.0, |pin| pin.roll_rad),
            pin_velocity: pin.map_or(DVec3::ZERO, |pin| pin.velocity),
            finger_normal_n: finger.normal_n + on_objects_n,
            table_normal_n: support.normal_n,
            finger_tangential_n: finger.tangential_n,
            table_tangential_n: support.tangential_n,
            tool_wrench: self.tool_wrench(),
            contact_x_tactels: rolling.and_then(|r| contact_x_tactels(&r.pad, &r.array)),
            pin_yaw_rad,
            tilt_rad,
            finger_slip_m_s: finger.slip_m_s,
            table_slip_m_s: support.slip_m_s,
            finger_creep_m_s: finger.creep_m_s,
            table_creep_m_s: support.creep_m_s,
            creepage: creepage(&finger, &support),
            in_contact: finger.normal_n + on_objects_n > 0.0,
            opposed: rolling.and_then(|r| OpposedFingertip::of(r, &surroundings())),
            object: objects.and_then(|objects| ObjectContact::of(objects, &surroundings())),
            beyond_small_strain: rolling.is_some_and(|r| deep(&r.pad) || deep(&r.support))
                || objects.is_some_and(|objects| objects.beyond_small_strain()),
            table: self.plant.table().at(self.t.as_secs_f64()).0,
            fixture_active: rolling.is_some_and(|r| r.fixture.holding),
            released: rolling.and_then(|r| r.released),
            enabled,
            braked,
        }
    }

    /// The true state of a hand's object and contacts; none where the arm is no hand.
    #[must_use]
    pub fn hand(&self) -> Option<HandTruth> {
        self.plant.finger().grasp().map(|hand| hand.truth())
    }

    /// Angles (rad) and speeds (rad/s) of the joints; none with a carriage.
    #[must_use]
    pub fn joints(&self) -> (&[f64], &[f64]) {
        self.plant.finger().joints()
    }

    /// Kinetic and gravitational energy of arm and pin, without the energy of the rubbers (J).
    #[must_use]
    pub fn energy_j(&self) -> f64 {
        let arm_j = self.plant.finger().energy_j();
        let fall = |pin: &Pin| pin.mass_kg * GRAVITY_M_S2 * pin.position.z;
        let pin = self.plant.rolling().map(|r| &r.pin);
        arm_j + pin.map_or(0.0, |pin| pin.kinetic_j() + fall(pin))
    }

    /// Energy in the rubbers and in the bristles on them (J), as of the latest evaluation of the
    /// contacts.
    #[must_use]
    pub fn rubber_energy_j(&self) -> f64 {
        let rolling = self.plant.rolling();
        rolling.map_or(0.0, |r| r.pad.stored_energy_j() + r.support.stored_energy_j())
    }

    /// A digest of everything that decides the future, except scans that are complete and on their
    /// way.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        let mut hash = Hash::default();
        hash.word(self.t.0.cast_unsigned());
        self.plant.digest(&mut hash);
        for code in self.codes.iter().take(JOINTS_MAX) {
            hash.word(u64::from(code.cast_unsigned()));
        }
        let lines = self.lines_out;
        let bits = [lines.enable, lines.brake_release, lines.watchdog_feed];
        for bit in bits {
            hash.word(u64::from(bit));
        }
        hash.word(self.last_code_time.0.cast_unsigned());
        hash.word(self.last_feed_time.0.cast_unsigned());
        hash.word(u64::from(self.sequences[0]));
        if let Some(array) = &self.arrays[0] {
            array.digest(&mut hash);
        }
        if let Some(wrist) = &self.wrist {
            wrist.digest(&mut hash);
        }
        self.faults.digest(&mut hash);
        if let Some(index) = &self.index {
            index.digest(&mut hash);
        }
        if let Some(array) = &self.arrays[1] {
            hash.word(u64::from(self.sequences[1]));
            array.digest(&mut hash);
        }
        if let Some(array) = &self.arrays[2] {
            hash.word(u64::from(self.sequences[2]));
            array.digest(&mut hash);
        }
        if let Some(drives) = &self.drives {
            drives.digest(&mut hash);
        }
        hash.value()
    }
}
