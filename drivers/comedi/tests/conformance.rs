//! Every half passes hal's conformance suite on the double, seen from the driver and from the
//! board's terminals.

mod rig;

use rig::{SharedDouble, bench, codes_out, lines_out, robot_config};
use taktil_drivers_comedi::{AnalogChannel, Config};
use taktil_drivers_comedi_double::Double;
use taktil_hal::conformance::{
    check_analog_in, check_analog_out_drop, check_analog_out_observed, check_digital_in,
    check_digital_out_drop, check_digital_out_observed, check_encoders, check_force_torque,
};

#[test]
fn inputs_conform() {
    for bits in [16, 24, 32] {
        let double = SharedDouble::new(Double::robot_board(bits));
        let mut halves = double.open(&robot_config()).unwrap();
        let cycle = &mut bench(&double);
        assert_eq!(check_encoders(halves.encoders.as_deref_mut().unwrap(), cycle), []);
        assert_eq!(check_analog_in(halves.analog_in.as_deref_mut().unwrap(), cycle), []);
        assert_eq!(check_force_torque(halves.force_torque.as_deref_mut().unwrap(), cycle), []);
        assert_eq!(check_digital_in(halves.digital_in.as_deref_mut().unwrap(), cycle), []);
    }
}

#[test]
fn outputs_conform_as_the_cell_sees_them() {
    let double = SharedDouble::new(Double::robot_board(32));
    let mut halves = double.open(&robot_config()).unwrap();
    let (mut codes, mut lines) = (|| codes_out(&double), || lines_out(&double));
    let cycle = &mut bench(&double);
    let (mut analog, mut digital) = (halves.analog_out.take(), halves.digital_out.take());
    let half = analog.as_deref_mut().unwrap();
    assert_eq!(check_analog_out_observed(half, cycle, &mut codes), []);
    let half = digital.as_deref_mut().unwrap();
    assert_eq!(check_digital_out_observed(half, cycle, &mut lines), []);
    assert_eq!(check_analog_out_drop(analog.unwrap(), cycle, &mut codes), []);
    assert_eq!(check_digital_out_drop(digital.unwrap(), cycle, &mut lines), []);
}

#[test]
fn the_model_of_comedi_test_conforms_and_loops_back() {
    let mut config = Config::new("/dev/comedi0", 10);
    config.analog_out = (0..8).map(AnalogChannel::new).collect();
    config.analog_in = (0..8).map(AnalogChannel::new).collect();
    let double = SharedDouble::new(Double::comedi_test());
    let mut halves = double.open(&config).unwrap();
    let cycle = &mut bench(&double);
    assert_eq!(check_analog_in(halves.analog_in.as_deref_mut().unwrap(), cycle), []);
    let out = halves.analog_out.as_deref_mut().unwrap();
    let mut codes = || codes_out(&double);
    assert_eq!(check_analog_out_observed(out, cycle, &mut codes), []);
}
