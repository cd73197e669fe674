//! A drive by CiA 402 as its firmware behaves: the power state machine, the cyclic modes, the
//! reaction to a quick stop and to a fault. Its shaft belongs to the plant.

use taktil_hal::Nanos;

use crate::description::TORQUE_MAX_PERMILLE;
use crate::plant::Shaft;

/// The drive has lost its host while it was enabled.
pub const COMMUNICATION_ERROR_CODE: u16 = 0x7500;
/// The error code of a fault by plan: a following error.
pub const PLANNED_ERROR_CODE: u16 = 0x8611;
/// Speed below which a stop is over (counts/s).
const STANDSTILL_COUNTS_S: f64 = 20.0;
/// Longest time of a stop; then the torque goes off, whatever still turns.
const STOP_TIME_MAX: Nanos = Nanos::from_millis(500);
/// Torque of a brake for each count a second of speed (0.1 % of the rated one).
const BRAKE_GAIN_PERMILLE: f64 = 0.2;
/// Torque for each count of position error (0.1 % of the rated one).
const POSITION_GAIN_PERMILLE: f64 = 2.0;
/// Torque for each count a second of speed error (0.1 % of the rated one).
const SPEED_GAIN_PERMILLE: f64 = 0.1;
/// Cyclic synchronous position.
const POSITION_MODE: i8 = 8;
/// Cyclic synchronous velocity.
const VELOCITY_MODE: i8 = 9;
/// Cyclic synchronous torque.
const TORQUE_MODE: i8 = 10;
/// Voltage is applied.
const VOLTAGE_BIT: u16 = 0x0010;
/// The drive listens to its bus.
const REMOTE_BIT: u16 = 0x0200;
/// The drive follows its target.
const FOLLOWS_BIT: u16 = 0x1000;

/// States of the power section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Power {
    #[default]
    Disabled,
    Ready,
    SwitchedOn,
    Enabled,
    Stopping,
    Reacting,
    Fault,
}

/// A drive.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drive {
    power: Power,
    control: u16,
    mode: i8,
    target_position: i32,
    target_velocity: i32,
    target_torque: i16,
    torque_max: u16,
    error: u16,
    shaft: Shaft,
    has_supply: bool,
    /// Since when it stops or reacts.
    stopping: Nanos,
    now: Nanos,
}

impl Drive {
    pub(crate) fn new() -> Drive {
        Drive { torque_max: TORQUE_MAX_PERMILLE, ..Drive::default() }
    }

    /// Everything but the shaft is as after power-up.
    pub(crate) fn reset(&mut self) {
        *self =
            Drive { shaft: self.shaft, has_supply: self.has_supply, now: self.now, ..Drive::new() };
    }

    /// What the plant shows at `now`.
    pub(crate) fn follow(&mut self, now: Nanos, shaft: Shaft, has_supply: bool) {
        (self.now, self.shaft, self.has_supply) = (now, shaft, has_supply);
        let stands = shaft.speed_counts_s.abs() < STANDSTILL_COUNTS_S;
        let is_over = stands || now - self.stopping > STOP_TIME_MAX;
        match self.power {
            Power::Stopping if is_over => self.power = Power::Disabled,
            Power::Reacting if is_over => self.power = Power::Fault,
            Power::Enabled | Power::SwitchedOn if !has_supply => self.fail(0x3220),
            _ => {}
        }
    }

    /// A fault with its code.
    pub(crate) fn fail(&mut self, code: u16) {
        if matches!(self.power, Power::Reacting | Power::Fault) {
            return;
        }
        let turns = matches!(self.power, Power::Enabled | Power::Stopping);
        self.power = if turns { Power::Reacting } else { Power::Fault };
        (self.error, self.stopping) = (code, self.now);
    }

    /// The host has fallen silent.
    pub(crate) fn lose_host(&mut self) {
        self.target_torque = 0;
        if matches!(self.power, Power::Enabled | Power::Stopping) {
            self.fail(COMMUNICATION_ERROR_CODE);
        }
    }

    /// Executes the newest controlword.
    pub(crate) fn obey(&mut self, word: u16) {
        let is_reset = word & 0x80 != 0 && self.control & 0x80 == 0;
        self.control = word;
        let has_voltage = word & 2 != 0;
        let is_quick_stop = word & 6 == 2;
        let shuts_down = word & 7 == 6;
        self.power = match self.power {
            Power::Reacting => Power::Reacting,
            Power::Fault if is_reset => {
                self.error = 0;
                Power::Disabled
            }
            Power::Fault => Power::Fault,
            _ if !has_voltage => Power::Disabled,
            Power::Enabled if is_quick_stop => {
                self.stopping = self.now;
                Power::Stopping
            }
            Power::Stopping => Power::Stopping,
            _ if is_quick_stop => Power::Disabled,
            Power::Disabled if shuts_down => Power::Ready,
            Power::Disabled => Power::Disabled,
            _ if shuts_down => Power::Ready,
            Power::Ready => Power::SwitchedOn,
            Power::SwitchedOn | Power::Enabled if word & 8 == 0 => Power::SwitchedOn,
            Power::SwitchedOn | Power::Enabled => Power::Enabled,
        };
    }

    fn status(&self) -> u16 {
        let state = match self.power {
            Power::Disabled => 0x0040,
            Power::Ready => 0x0021,
            Power::SwitchedOn => 0x0023,
            Power::Enabled => 0x0027,
            Power::Stopping => 0x0007,
            Power::Reacting => 0x000f,
            Power::Fault => 0x0008,
        };
        let follows = if self.power == Power::Enabled { FOLLOWS_BIT } else { 0 };
        let voltage = if self.has_supply { VOLTAGE_BIT } else { 0 };
        state | follows | voltage | REMOTE_BIT
    }

    /// The torque on the shaft (0.1 % of the rated one).
    pub(crate) fn torque_permille(&self) -> i16 {
        let speed = self.shaft.speed_counts_s;
        let wanted = match (self.power, self.mode) {
            (Power::Stopping | Power::Reacting, _) => -BRAKE_GAIN_PERMILLE * speed,
            (Power::Enabled, POSITION_MODE) => {
                let error = f64::from(self.target_position) - self.shaft.position_counts;
                POSITION_GAIN_PERMILLE * error - SPEED_GAIN_PERMILLE * speed
            }
            (Power::Enabled, VELOCITY_MODE) => {
                SPEED_GAIN_PERMILLE * (f64::from(self.target_velocity) - speed)
            }
            (Power::Enabled, TORQUE_MODE) => f64::from(self.target_torque),
            _ => 0.0,
        };
        let most = f64::from(self.torque_max);
        wanted.clamp(-most, most).round() as i16
    }

    /// Whether the power section is on.
    pub(crate) fn is_enabled(&self) -> bool {
        self.power == Power::Enabled
    }

    /// The controlword that came last.
    pub(crate) fn control(&self) -> u16 {
        self.control
    }

    /// The target torque that came last (0.1 % of the rated one), whether it acts or not.
    pub(crate) fn target_torque(&self) -> i16 {
        self.target_torque
    }

    pub(crate) fn write(&mut self, index: u16, value: i64) {
        match index {
            0x6040 => self.obey(value as u16),
            0x6060 => self.mode = value as i8,
            0x6071 => self.target_torque = value as i16,
            0x6072 => self.torque_max = value as u16,
            0x607a => self.target_position = value as i32,
            0x60ff => self.target_velocity = value as i32,
            _ => {}
        }
    }

    pub(crate) fn read(&self, index: u16) -> Option<i64> {
        Some(match index {
            0x603f => i64::from(self.error),
            0x6040 => i64::from(self.control),
            0x6041 => i64::from(self.status()),
            0x6060 | 0x6061 => i64::from(self.mode),
            0x6064 => self.shaft.position_counts.floor() as i64,
            0x606c => self.shaft.speed_counts_s as i64,
            0x6071 => i64::from(self.target_torque),
            0x6072 => i64::from(self.torque_max),
            0x6077 => i64::from(self.torque_permille()),
            0x607a => i64::from(self.target_position),
            0x60ff => i64::from(self.target_velocity),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive() -> Drive {
        let mut drive = Drive::new();
        drive.follow(Nanos(1), Shaft::default(), true);
        drive.write(0x6060, i64::from(TORQUE_MODE));
        drive
    }

    fn enable(drive: &mut Drive) {
        for word in [6, 7, 15] {
            drive.obey(word);
        }
    }

    #[test]
    fn three_words_enable_and_each_state_shows_its_pattern() {
        let mut drive = drive();
        assert_eq!(drive.status() & 0x6f, 0x40);
        let patterns = [6, 7, 15].map(|word| {
            drive.obey(word);
            drive.status() & 0x6f
        });
        assert_eq!(patterns, [0x21, 0x23, 0x27]);
        drive.obey(0x000f);
        assert!(drive.is_enabled() && drive.status() & FOLLOWS_BIT != 0);
        drive.obey(0);
        assert_eq!(drive.status() & 0x4f, 0x40);
        drive.obey(0x000f);
        assert!(!drive.is_enabled(), "no state is skipped");
    }

    #[test]
    fn a_quick_stop_brakes_and_ends_without_torque() {
        let mut drive = drive();
        enable(&mut drive);
        let turning = Shaft { position_counts: 0.0, speed_counts_s: 1_000.0 };
        drive.follow(Nanos(2), turning, true);
        drive.obey(2);
        assert_eq!(drive.status() & 0x6f, 0x07);
        assert!(drive.torque_permille() < 0);
        drive.follow(Nanos(3), Shaft::default(), true);
        assert_eq!((drive.status() & 0x4f, drive.torque_permille()), (0x40, 0));
    }

    #[test]
    fn a_fault_ends_by_a_rising_edge_only() {
        let mut drive = drive();
        enable(&mut drive);
        drive.fail(PLANNED_ERROR_CODE);
        drive.follow(Nanos(2), Shaft::default(), true);
        assert_eq!((drive.status() & 0x4f, drive.read(0x603f)), (8, Some(0x8611)));
        enable(&mut drive);
        assert!(!drive.is_enabled());
        drive.control = 0x80;
        drive.obey(0x80);
        assert_eq!(drive.status() & 0x4f, 8, "a bit that stands is no edge");
        drive.obey(0);
        drive.obey(0x80);
        assert_eq!((drive.status() & 0x4f, drive.read(0x603f)), (0x40, Some(0)));
    }

    #[test]
    fn silence_of_the_host_brakes_and_is_a_fault() {
        let mut drive = drive();
        enable(&mut drive);
        drive.write(0x6071, 500);
        assert_eq!(drive.torque_permille(), 500);
        drive.lose_host();
        drive.follow(Nanos(2), Shaft::default(), true);
        assert_eq!((drive.status() & 0x4f, drive.torque_permille()), (8, 0));
        assert_eq!(drive.read(0x603f), Some(i64::from(COMMUNICATION_ERROR_CODE)));
    }
}
