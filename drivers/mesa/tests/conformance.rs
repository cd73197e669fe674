//! Every half passes hal's conformance suite, seen from the emulated card's outputs.

mod rig;

use rig::{CYCLE_PERIOD, Rig, codes_of, field_lines, field_word, with_7i77, with_pwm};
use taktil_drivers_mesa_emulator::{Firmware, Outputs};
use taktil_hal::conformance::{
    CycleDriver, check_analog_out_drop, check_analog_out_observed, check_digital_in,
    check_digital_out_drop, check_digital_out_observed, check_encoders,
};
use taktil_hal::{CHANNELS, DacCode, LinesIn, LinesOut, Nanos};

fn bench(rig: &Rig) -> CycleDriver<'_> {
    CycleDriver::new(Nanos::ZERO, CYCLE_PERIOD, |release| {
        let step = release.0 / CYCLE_PERIOD.0;
        rig.set_counts([step * 1_700; 6]);
        let lines = LinesIn { drive_power: step % 2 == 0, ..LinesIn::default() };
        rig.set_field(field_word(lines));
        rig.advance(release);
    })
}

#[test]
fn inputs_conform() {
    for (firmware, config) in
        [(Firmware::with_7i77(), with_7i77()), (Firmware::with_pwm(), with_pwm())]
    {
        let rig = Rig::new(firmware);
        let mut halves = rig.open(&config).unwrap();
        let mut bench = bench(&rig);
        assert_eq!(check_encoders(halves.encoders.as_mut().unwrap(), &mut bench), []);
        assert_eq!(check_digital_in(halves.digital_in.as_mut().unwrap(), &mut bench), []);
    }
}

#[test]
fn outputs_of_a_7i77_conform_as_the_cell_sees_them() {
    let rig = Rig::new(Firmware::with_7i77());
    let mut halves = rig.open(&with_7i77()).unwrap();
    let mut bench = bench(&rig);
    let mut volts = || codes_of(&rig.outputs());
    let mut lines = || field_lines(rig.outputs().field);
    let analog = halves.analog_out.as_mut().unwrap();
    assert_eq!(check_analog_out_observed(analog, &mut bench, &mut volts), []);
    let digital = halves.digital_out.as_mut().unwrap();
    assert_eq!(check_digital_out_observed(digital, &mut bench, &mut lines), []);
    let analog = Box::new(halves.analog_out.take().unwrap());
    assert_eq!(check_analog_out_drop(analog, &mut bench, &mut volts), []);
    let digital = Box::new(halves.digital_out.take().unwrap());
    assert_eq!(check_digital_out_drop(digital, &mut bench, &mut lines), []);
}

fn pwm_codes(outputs: &Outputs) -> [DacCode; CHANNELS] {
    core::array::from_fn(|unit| {
        let duty = outputs.pwm.get(unit).copied().unwrap_or(0.0);
        DacCode((duty * 4_095.0).round() as i32)
    })
}

fn pin_lines(outputs: &Outputs) -> LinesOut {
    let word = outputs.pins[2];
    LinesOut { enable: word & 4 != 0, brake_release: word & 8 == 0, watchdog_feed: word & 16 != 0 }
}

#[test]
fn modulators_and_pins_conform_as_the_cell_sees_them() {
    let rig = Rig::new(Firmware::with_pwm());
    let mut halves = rig.open(&with_pwm()).unwrap();
    let mut bench = bench(&rig);
    let mut duties = || pwm_codes(&rig.outputs());
    let mut lines = || pin_lines(&rig.outputs());
    let analog = halves.analog_out.as_mut().unwrap();
    assert_eq!(check_analog_out_observed(analog, &mut bench, &mut duties), []);
    let digital = halves.digital_out.as_mut().unwrap();
    assert_eq!(check_digital_out_observed(digital, &mut bench, &mut lines), []);
    let analog = Box::new(halves.analog_out.take().unwrap());
    assert_eq!(check_analog_out_drop(analog, &mut bench, &mut duties), []);
    let digital = Box::new(halves.digital_out.take().unwrap());
    assert_eq!(check_digital_out_drop(digital, &mut bench, &mut lines), []);
}
