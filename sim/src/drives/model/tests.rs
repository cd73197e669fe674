//! One drive before a motor that is a mass without friction.

use super::*;

const LOOK_PERIOD: Nanos = Nanos::from_micros(250);
const CONTROL_PERIOD: Nanos = Nanos::from_millis(2);
const SCALE: MotorScale = MotorScale {
    codes_per_count_s2: 1e-3,
    counts_per_turn: 1000.0,
    code_min: -2048.0,
    code_max: 2047.0,
};

/// A drive with its motor.
struct Rig {
    drive: DriveModel,
    around: Surroundings,
    counts: f64,
    counts_s: f64,
    /// Torque from outside, in codes.
    load: f64,
}

impl Rig {
    fn new(control_loop: DriveLoop) -> Rig {
        let around = Surroundings {
            t: Nanos::ZERO,
            control_loop,
            request: DriveRequest::Off,
            is_powered: true,
            is_silent: false,
            control_period: CONTROL_PERIOD,
        };
        Rig { drive: DriveModel::new(SCALE), around, counts: 120.0, counts_s: 0.0, load: 0.0 }
    }

    /// One control period in which the host asks for `target`.
    fn cycle(&mut self, target: f64, request: DriveRequest) {
        self.drive.take(target.round() as i32, self.around.t, false);
        self.around.request = request;
        for _ in 0..CONTROL_PERIOD.0 / LOOK_PERIOD.0 {
            self.drive.switch(&self.around, self.counts, self.counts_s);
            self.drive.look(&self.around, self.counts, self.counts_s, LOOK_PERIOD);
            let torque = f64::from(self.drive.code()) + self.load;
            let h = LOOK_PERIOD.as_secs_f64();
            let before = self.counts_s;
            self.counts_s += h * torque / SCALE.codes_per_count_s2;
            self.counts += 0.5 * h * (before + self.counts_s);
            self.around.t += LOOK_PERIOD;
        }
    }

    fn state(&self) -> (DriveState, u16) {
        let report = self.drive.report(Counts(0), self.counts_s);
        (report.state, report.fault_code)
    }

    fn enabled(mut self) -> Rig {
        for _ in 0..5 {
            self.cycle(
                if self.around.control_loop == DriveLoop::Position { 120.0 } else { 0.0 },
                DriveRequest::Follow,
            );
        }
        assert_eq!(self.state(), (DriveState::Following, 0));
        self
    }
}

#[test]
fn each_loop_follows_its_target_against_a_load() {
    let mut position = Rig::new(DriveLoop::Position).enabled();
    let mut velocity = Rig::new(DriveLoop::Velocity).enabled();
    (position.load, velocity.load) = (-300.0, -300.0);
    for cycle in 0..500 {
        let t_s = 0.002 * f64::from(cycle);
        position.cycle(120.0 + 400.0 * t_s, DriveRequest::Follow);
        velocity.cycle(400.0, DriveRequest::Follow);
    }
    // A ramp is followed one control period late, within a count of rounding.
    assert!((position.counts - (120.0 + 400.0)).abs() < 3.0, "{}", position.counts);
    assert!((velocity.counts_s - 400.0).abs() < 2.0, "{}", velocity.counts_s);
    let mut torque = Rig::new(DriveLoop::Torque).enabled();
    torque.cycle(50.0, DriveRequest::Follow);
    assert!((torque.counts_s - 100.0).abs() < 1e-9, "50 codes for 2 ms: {}", torque.counts_s);
}

#[test]
fn the_first_target_acts_from_where_the_motor_is() {
    let mut rig = Rig::new(DriveLoop::Position);
    let mut fastest = 0.0_f64;
    for _ in 0..100 {
        rig.cycle(170.0, DriveRequest::Follow);
        fastest = fastest.max(rig.counts_s.abs());
    }
    assert!((rig.counts - 170.0).abs() < 1.0, "{}", rig.counts);
    assert!(fastest < 50.0 * POSITION_CORNER_1_S, "no leap: {fastest}");
}

#[test]
fn a_quick_stop_brakes_and_ends_without_torque() {
    let mut rig = Rig::new(DriveLoop::Velocity).enabled();
    for _ in 0..100 {
        rig.cycle(2000.0, DriveRequest::Follow);
    }
    let mut cycles = 0;
    while rig.state().0 != DriveState::Off {
        rig.cycle(2000.0, DriveRequest::QuickStop);
        cycles += 1;
        assert!(cycles < 100, "{}", rig.counts_s);
    }
    assert!((5..80).contains(&cycles) && rig.counts_s.abs() < 30.0, "{cycles} {}", rig.counts_s);
    rig.cycle(2000.0, DriveRequest::QuickStop);
    assert_eq!((rig.state().0, rig.drive.code()), (DriveState::Off, 0));
    rig.cycle(2000.0, DriveRequest::Off);
    assert_eq!(rig.state().0, DriveState::Off);
}

#[test]
fn a_fault_takes_a_reset_and_then_a_new_request() {
    let mut rig = Rig::new(DriveLoop::Position).enabled();
    for _ in 0..20 {
        rig.cycle(5000.0, DriveRequest::Follow);
    }
    assert_eq!(rig.state(), (DriveState::Fault, FOLLOWING_ERROR_CODE));
    for request in [DriveRequest::Off, DriveRequest::Follow, DriveRequest::Off] {
        rig.cycle(120.0, request);
        assert_eq!(rig.state().0, DriveState::Fault, "{request:?} resets nothing");
    }
    let t = rig.around.t;
    rig.around.request = DriveRequest::Follow;
    rig.drive.take(120, t, true);
    rig.drive.switch(&rig.around, rig.counts, rig.counts_s);
    assert_eq!(rig.state(), (DriveState::Off, 0));
    for _ in 0..10 {
        rig.drive.take(120, rig.around.t, true);
        rig.drive.switch(&rig.around, rig.counts, rig.counts_s);
    }
    assert_eq!(rig.state().0, DriveState::Off, "the request stands from before the reset");
    rig.cycle(120.0, DriveRequest::Off);
    rig.cycle(rig.counts, DriveRequest::Follow);
    assert_eq!(rig.state().0, DriveState::Enabling);
}

#[test]
fn silence_and_a_lost_supply_end_operation() {
    let mut rig = Rig::new(DriveLoop::Velocity).enabled();
    rig.around.is_silent = true;
    rig.cycle(0.0, DriveRequest::Off);
    assert_eq!(rig.state(), (DriveState::Fault, SILENCE_CODE));
    let mut rig = Rig::new(DriveLoop::Velocity).enabled();
    rig.around.is_powered = false;
    rig.cycle(0.0, DriveRequest::Follow);
    rig.around.is_powered = true;
    for _ in 0..10 {
        rig.cycle(0.0, DriveRequest::Follow);
    }
    assert_eq!(rig.state().0, DriveState::Off, "nothing moves because a supply came back");
    rig.cycle(0.0, DriveRequest::Off);
    assert_eq!(rig.enabled().state().0, DriveState::Following);
}
