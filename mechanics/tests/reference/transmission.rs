//! Tests counts, gears, torques and converter codes.

use crate::lcg::Lcg;
use crate::table::rows;
use core::f64::consts::TAU;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::transmission::{Drive, Transmission};

#[test]
fn counts_match_the_reference_and_come_back() {
    let gears = Transmission::reference();
    let file = rows("kinematics/encoder.csv");
    assert_eq!(file.len(), 50);
    for row in file {
        let q = row.joints("q");
        let (got, want, exact) = (gears.counts(&q), row.joints("n"), gears.exact_counts(&q));
        for i in 0..6 {
            let half = ((exact[i] - exact[i].floor()) - 0.5).abs() < 1e-6;
            assert!(
                (f64::from(got[i]) - want[i]).abs() <= f64::from(half),
                "row {}",
                row.word("id")
            );
        }
        #[expect(clippy::cast_possible_truncation, reason = "whole numbers of the file")]
        let counts = core::array::from_fn(|i| want[i] as i32);
        assert!((gears.joints(&counts) - row.joints("qback")).amax() < 1e-12);
    }
}

#[test]
fn every_count_survives_the_way_there_and_back() {
    let gears = Transmission::reference();
    let arm = Puma260::reference();
    let mut lcg = Lcg::new(5);
    for _ in 0..20_000 {
        let q = lcg.joints(&arm);
        let counts = gears.counts(&q);
        assert_eq!(gears.counts(&gears.joints(&counts)), counts);
        let back = gears.exact_counts(&gears.joints(&counts)) - gears.exact_counts(&q);
        assert!(back.amax() <= 0.5 + 1e-9);
    }
    assert_eq!(gears.counts(&Joints::repeat(f64::NAN)), [0; 6]);
    assert_eq!(gears.counts(&Joints::repeat(1e12))[0], i32::MAX);
    assert_eq!(gears.counts(&Joints::repeat(-1e300))[1], i32::MIN);
}

#[test]
fn joint_four_drags_its_neighbours() {
    let gears = Transmission::reference();
    let counts = gears.exact_counts(&Joints::new(0.0, 0.0, 0.0, TAU, 0.0, 0.0));
    let want = Joints::new(0.0, 0.0, 0.0, 43.5111 * 800.0, -9.8462 * 800.0, 800.0);
    assert!((counts - want).amax() < 1e-9);
}

#[test]
fn the_torque_map_keeps_power() {
    let gears = Transmission::reference();
    let mut lcg = Lcg::new(6);
    for _ in 0..1000 {
        let (tau, qd) = (lcg.six(10.0), lcg.six(3.0));
        let motor = gears.motor_torque(&tau);
        assert!((motor.dot(&gears.motor_speed(&qd)) - tau.dot(&qd)).abs() < 1e-12);
        assert!((gears.joint_torque(&motor) - tau).amax() < 1e-13);
    }
    // A torque at joint 4 alone asks nothing of motors 5 and 6; one at joint 6 pulls at 4 and 5.
    let only = gears.motor_torque(&Joints::new(0.0, 0.0, 0.0, 1.0, 0.0, 0.0));
    assert!(only[4] == 0.0 && only[5] == 0.0 && (only[3] - 1.0 / 43.5111).abs() < 1e-15);
    let last = gears.motor_torque(&Joints::new(0.0, 0.0, 0.0, 0.0, 0.0, 1.0));
    assert!(last[4] > 0.0 && last[3] != 0.0);
}

#[test]
fn codes_are_two_s_complement_of_the_current() {
    let drive = Drive::reference();
    assert_eq!(drive.code_range(), (-2048, 2047));
    assert_eq!(drive.dac_code(0.0, 0), 0);
    assert_eq!(drive.dac_code(0.275, 0), 2047);
    assert_eq!(drive.dac_code(-0.275, 0), -2048);
    assert_eq!(drive.dac_code(1e300, 1), 2047);
    assert_eq!(drive.dac_code(f64::NEG_INFINITY, 1), -2048);
    assert_eq!(drive.dac_code(f64::NAN, 2), 0);
    assert_eq!(drive.dac_code(0.1, 6), 0);
    assert_eq!(drive.dac_code(0.03, 3), 1024);
    assert!((drive.motor_torque_nm(1024, 3) - 0.03).abs() < 1e-15);
    assert!((drive.motor_torque_nm(i32::MAX, 3) - 0.06 * 2047.0 / 2048.0).abs() < 1e-15);
    for joint in 0..6 {
        for code in -2048..=2047 {
            assert_eq!(drive.dac_code(drive.motor_torque_nm(code, joint), joint), code);
        }
    }
    let peak = drive.peak_joint_torque(&Transmission::reference());
    let want = Joints::new(12.8, 19.2, 11.8, 2.6, 2.4, 1.9);
    assert!((peak - want).amax() < 0.06, "{peak}");
    let broken = Drive { current_max_a: Joints::zeros(), ..drive };
    assert_eq!(broken.dac_code(1.0, 0), 0);
}
