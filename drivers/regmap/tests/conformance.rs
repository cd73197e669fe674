//! Tests every device half with hal's conformance suite, against the registers and against the
//! model behind them.

use std::cell::RefCell;
use std::sync::Arc;

use taktil_drivers_regmap::{Board, Config, Loopback, RegisterFile};
use taktil_hal::conformance::{
    CycleDriver, check_analog_in, check_analog_out_drop, check_analog_out_observed, check_devices,
    check_digital_in, check_digital_out_drop, check_digital_out_observed, check_encoders,
    check_force_torque, check_tactile,
};
use taktil_hal::{CHANNELS, Devices, Nanos};

const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);

/// A board with odd numbers of channels, its model, and a bench that ticks the model.
struct Rig {
    model: RefCell<Loopback>,
    now: RefCell<Nanos>,
}

impl Rig {
    fn new(config: &Config) -> (Rig, Devices) {
        let registers = Arc::new(RegisterFile::anonymous().unwrap());
        let model = RefCell::new(Loopback::new(registers.clone(), config).unwrap());
        let devices = Board::attach(registers, config).unwrap();
        (Rig { model, now: RefCell::new(Nanos::ZERO) }, devices)
    }

    fn advance(&self, now: Nanos) {
        let step = (now.0 / CYCLE_PERIOD.0) as i32;
        let mut model = self.model.borrow_mut();
        model.set_counts([step * 1_000; CHANNELS]);
        if step % 2 == 0 {
            model.publish_frame(&[step as u16; 256]);
        }
        model.tick(now);
        *self.now.borrow_mut() = now;
    }

    fn bench(&self) -> CycleDriver<'_> {
        CycleDriver::new(Nanos::ZERO, CYCLE_PERIOD, |now| self.advance(now))
    }

    /// Lets the model see the registers as they are now.
    fn look(&self) -> std::cell::Ref<'_, Loopback> {
        self.model.borrow_mut().tick(*self.now.borrow());
        self.model.borrow()
    }
}

fn narrow() -> Config {
    Config { joints: 3, dac_channels: 5, adc_channels: 1, counter_bits: 16, ..Config::default() }
}

#[test]
fn inputs_conform() {
    for config in [Config::default(), narrow()] {
        let (rig, mut devices) = Rig::new(&config);
        let bench = &mut rig.bench();
        assert_eq!(check_encoders(devices.encoders.as_deref_mut().unwrap(), bench), []);
        assert_eq!(check_analog_in(devices.analog_in.as_deref_mut().unwrap(), bench), []);
        assert_eq!(check_force_torque(devices.force_torque.as_deref_mut().unwrap(), bench), []);
        assert_eq!(check_digital_in(devices.digital_in.as_deref_mut().unwrap(), bench), []);
        assert_eq!(check_tactile(devices.tactile.get_mut("tactile").unwrap().as_mut(), bench), []);
    }
}

#[test]
fn outputs_conform_as_the_cell_sees_them() {
    for config in [Config::default(), narrow()] {
        let (rig, mut devices) = Rig::new(&config);
        let (mut volts, mut lines) = (|| rig.look().dac_codes(), || rig.look().lines_out());
        let bench = &mut rig.bench();
        let (analog, digital) = (
            devices.analog_out.as_deref_mut().unwrap(),
            devices.digital_out.as_deref_mut().unwrap(),
        );
        assert_eq!(check_analog_out_observed(analog, bench, &mut volts), []);
        assert_eq!(check_digital_out_observed(digital, bench, &mut lines), []);
        let (analog, digital) = (devices.analog_out, devices.digital_out);
        assert_eq!(check_analog_out_drop(analog.unwrap(), bench, &mut volts), []);
        assert_eq!(check_digital_out_drop(digital.unwrap(), bench, &mut lines), []);
    }
}

#[test]
fn the_whole_board_conforms() {
    let (rig, mut devices) = Rig::new(&Config::default());
    assert_eq!(check_devices(&mut devices, &mut rig.bench()), []);
}

#[test]
fn a_dead_board_does_not_conform() {
    let (_rig, mut devices) = Rig::new(&Config::default());
    let found = check_devices(&mut devices, &mut CycleDriver::stationary());
    assert!(
        found.iter().any(|v| v.rule == "delivers" && v.text.starts_with("tactile")),
        "{found:?}"
    );
    assert!(
        found.iter().any(|v| v.rule == "moves-on" && v.text.starts_with("encoders")),
        "{found:?}"
    );
}
