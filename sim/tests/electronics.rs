//! Tests the electronics and the faults of the bench through its devices: parts that a scene does
//! not name cost nothing, parts that it names have their effect, and no subsystem shifts the random
//! numbers of another one.

mod common;

use common::{bench, load_of, meeting_height, nominal, over, seconds};
use glam::DVec3;
use taktil_hal::{Arrival, CHANNELS, DacCode, Devices, LinesOut, Nanos, TactileFrame};
use taktil_sim::scene::{Electronics, Fault, FaultKind};
use taktil_sim::{Carriage, Timing, World, WorldConfig, build};

fn fault(kind: FaultKind, at_s: f64, for_s: f64) -> Fault {
    Fault { for_s: Some(for_s), ..Fault::at(kind, at_s) }
}

fn pressing(config: &WorldConfig, speed_m_s: f64) -> (World, Devices) {
    let z = meeting_height(config) + 1e-4;
    let knots = vec![(0.3, over(z)), (0.8, over(z) + DVec3::X * (0.5 * speed_m_s))];
    bench(config, Carriage { axes: nominal(), knots, float: load_of(15.0) })
}

/// Frames that arrived until an instant, sampled every millisecond.
fn frames(world: &mut World, devices: &mut Devices, until_s: f64) -> Vec<TactileFrame> {
    let mut found = Vec::new();
    while world.now() < seconds(until_s) {
        world.advance(world.now() + Nanos::from_millis(1));
        let mut frame = TactileFrame::new(16, 16);
        if devices.tactile.get_mut("tactile").unwrap().sample(world.now(), &mut frame)
            == Ok(Arrival::New)
        {
            found.push(frame);
        }
    }
    found
}

#[test]
fn parts_that_a_scene_does_not_name_cost_nothing() {
    let mut config = WorldConfig::default();
    let work = |config: &WorldConfig| {
        let (mut world, mut devices) = build(config, &Timing::default(), 1).unwrap();
        let seen = frames(&mut world, &mut devices, 0.2).len();
        let gauges = devices.force_torque.as_mut().unwrap().sample(world.now()).is_ok();
        (world.statistics(), seen, gauges)
    };
    let (whole, seen, gauges) = work(&config);
    assert!(
        whole.contact_evaluations > 0
            && whole.tactile_images == 41
            && whole.tactile_scans == 41
            && seen >= 40
            && gauges
    );
    config.wrist.present = false;
    assert!(!work(&config).2, "gauges without a sensor");
    config.tactile.present = false;
    let (absent, seen, _) = work(&config);
    assert_eq!((absent.tactile_images, absent.tactile_scans, seen), (0, 0, 0));
    config.pin.present = false;
    assert_eq!(work(&config).0.contact_evaluations, 0);
    // An array over an empty table makes scans, but no contact is evaluated.
    config.tactile.present = true;
    let (empty, seen, _) = work(&config);
    assert!(empty.contact_evaluations == 0 && empty.tactile_scans == 41 && seen >= 40);
}

#[test]
fn gauges_that_clip_say_so_and_others_do_not() {
    let over_range = |bias: f64| {
        let mut config = WorldConfig::default();
        config.wrist.bias_codes = [0.0, 0.0, 0.0, 0.0, bias, 0.0];
        let (mut world, mut devices) = build(&config, &Timing::default(), 1).unwrap();
        world.advance(seconds(0.05));
        devices.force_torque.as_mut().unwrap().sample(world.now()).unwrap().value.over_range
    };
    assert_eq!(over_range(2_040.0), [false; 6]);
    assert_eq!(over_range(2_047.0), [false, false, false, false, true, false]);
    assert_eq!(over_range(-2_048.0), [false, false, false, false, true, false]);
}

#[test]
fn rows_are_read_one_after_the_other_and_a_moving_line_is_sheared() {
    let place = |row_us: f64| {
        let mut config = WorldConfig::default();
        (config.tactile.noise_counts, config.tactile.row_us) = (0.0, row_us);
        let (mut world, mut devices) = pressing(&config, 0.02);
        let frame = frames(&mut world, &mut devices, 0.55).pop().unwrap();
        let centre = |row: usize| {
            let counts = &frame.values[row * 16..][..16];
            let sum = |f: &dyn Fn(usize) -> f64| (0..16).map(f).sum::<f64>();
            let load = |j: usize| f64::from(counts[j]) - 300.0;
            sum(&|j| load(j) * j as f64) / sum(&load)
        };
        (centre(2) - centre(13), frame)
    };
    let (straight, at_once) = place(0.0);
    let (sheared, skewed) = place(300.0);
    assert!(straight.abs() < 1e-3, "{straight}");
    // Eleven rows at 300 us; the line runs at half the finger's 40 mm/s peak of mid-stroke.
    let due = 11.0 * 300e-6 * 0.015 / 1.5875e-3;
    println!("sheared by {sheared:.4} tactels, about {due:.4} expected");
    assert!((sheared.abs() / due - 1.0).abs() < 0.4, "{sheared} {due}");
    assert!(at_once.row_acquired.iter().all(|t| *t == at_once.acquired));
    assert_eq!(skewed.row_acquired[15], skewed.acquired);
    assert_eq!(skewed.row_acquired[0], skewed.acquired - Nanos::from_micros(4500));
}

#[test]
fn each_level_of_electronics_adds_its_effect() {
    let image = |electronics| {
        let mut config = WorldConfig::default();
        config.tactile.noise_counts = 0.0;
        config.tactile.electronics = electronics;
        let (mut world, mut devices) = pressing(&config, 0.0);
        frames(&mut world, &mut devices, 0.3).pop().unwrap().values
    };
    let levels =
        [Electronics::Ideal, Electronics::Response, Electronics::Memory, Electronics::Network];
    let images = levels.map(image);
    let off = |a: &[u16], b: &[u16]| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    for pair in images.windows(2) {
        assert!(off(&pair[0], &pair[1]) > 2, "a level without an effect");
    }
    let total = |image: &[u16]| image.iter().map(|v| f64::from(*v) - 300.0).sum::<f64>();
    for image in &images[1..] {
        let ratio = total(image) / total(&images[0]);
        assert!((0.8..1.3).contains(&ratio), "{ratio}");
    }
}

#[test]
fn lost_frames_leave_gaps_that_only_their_seed_decides() {
    let sequences = |fraction, seed| {
        let span = fault(FaultKind::DropFrames, 0.1, 0.4);
        let config =
            WorldConfig { fault: vec![Fault { fraction, ..span }], ..WorldConfig::default() };
        let (mut world, mut devices) = build(&config, &Timing::default(), seed).unwrap();
        frames(&mut world, &mut devices, 0.6).iter().map(|f| f.sequence).collect::<Vec<_>>()
    };
    let all = sequences(None, 1);
    assert!(all.contains(&19) && !all.iter().any(|s| (20..100).contains(s)) && all.contains(&100));
    let some = sequences(Some(0.3), 1);
    let lost = 80 - some.iter().filter(|s| (20..100).contains(*s)).count();
    assert!((12..=36).contains(&lost), "{lost} of 80");
    assert_eq!(some, sequences(Some(0.3), 1));
    assert_ne!(some, sequences(Some(0.3), 2));
}

/// Drives joint 1 and feeds the watchdogs; returns counts, lines and truth at the end of each
/// period.
fn driven(config: &WorldConfig, periods: i64) -> Vec<(i32, bool, bool, bool)> {
    let (mut world, mut devices) = build(config, &Timing::default(), 1).unwrap();
    let period = Timing::default().control_period;
    let mut seen = Vec::new();
    for k in 0..periods {
        let t = period * k;
        let order = LinesOut { enable: true, brake_release: true, watchdog_feed: k % 2 == 0 };
        devices.digital_out.as_mut().unwrap().commit(t, &order).unwrap();
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(600);
        devices.analog_out.as_mut().unwrap().commit(t, &codes).unwrap();
        world.advance(t + period);
        let counts = devices.encoders.as_mut().unwrap().sample(t + period).unwrap().value;
        let lines = devices.digital_in.as_mut().unwrap().sample(t + period).unwrap().value;
        let (moving, power) = (world.truth().qd[0].abs() > 1e-3, lines.drive_power);
        seen.push((counts[0].0, moving, power, lines.estop_a_closed && lines.estop_b_closed));
    }
    seen
}

#[test]
fn a_dead_encoder_stays_where_it_was_and_comes_back() {
    let dead = Fault { joint: Some(1), ..fault(FaultKind::DeadEncoder, 0.1, 0.1) };
    let config = WorldConfig { fault: vec![dead], ..WorldConfig::default() };
    let seen = driven(&config, 120);
    // The count latched at 100 ms is the last one before the fault, which begins there.
    let held = seen[38].0;
    assert!(seen[39..78].iter().all(|s| s.0 == held && s.1), "it moves and does not count");
    assert!(seen[81].0 != held && seen[30].0 != held);
}

#[test]
fn without_power_the_brakes_are_on_and_the_lines_say_so() {
    let mut config = WorldConfig {
        fault: vec![fault(FaultKind::PowerLoss, 0.1, 0.1)],
        ..WorldConfig::default()
    };
    let seen = driven(&config, 120);
    assert!(seen[30].1 && seen[30].2);
    assert!(seen[45..75].iter().all(|s| !s.1 && !s.2 && s.3), "{:?}", &seen[45]);
    assert!(seen[110].1 && seen[110].2, "it comes back");
    config.fault = vec![fault(FaultKind::EmergencyStop, 0.1, 0.1)];
    let seen = driven(&config, 60);
    assert!(seen[45..].iter().all(|s| !s.1 && !s.2 && !s.3));
}

#[test]
fn joints_off_their_zeros_count_from_zero_all_the_same() {
    let mut config = WorldConfig::default();
    config.arm.zero_error_deg = [0.0, 0.0, 0.0, 10.0, 0.0, -10.0];
    let (world, mut devices) = build(&config, &Timing::default(), 1).unwrap();
    let off = (world.truth().q[3].to_degrees() - config.arm.home_deg[3]).abs();
    assert!((off - 10.0).abs() < 1e-9, "{off}");
    let counts = devices.encoders.as_mut().unwrap().sample(Nanos::ZERO).unwrap().value;
    assert!(counts.iter().all(|count| count.0 == 0));
}

#[test]
fn random_numbers_of_one_subsystem_do_not_shift_anothers() {
    let images = |edit: fn(&mut WorldConfig)| {
        let mut config = WorldConfig::default();
        edit(&mut config);
        let (mut world, mut devices) = pressing(&config, 0.01);
        frames(&mut world, &mut devices, 0.4).iter().map(|f| f.values.clone()).collect::<Vec<_>>()
    };
    let plain = images(|_| ());
    assert_eq!(plain, images(|c| c.wrist.noise_codes = 4.0));
    assert_eq!(
        plain,
        images(|c| {
            let span = fault(FaultKind::DropFrames, 9.0, 0.1);
            c.fault = vec![Fault { fraction: Some(0.5), ..span }];
        })
    );
}

#[test]
fn impossible_faults_and_sensors_are_refused() {
    let refused = |edit: fn(&mut WorldConfig)| {
        let mut config = WorldConfig::default();
        edit(&mut config);
        build(&config, &Timing::default(), 0).expect_err("this cannot be simulated").place
    };
    assert_eq!(refused(|c| c.fault = vec![fault(FaultKind::DeadEncoder, 0.0, 1.0)]), "fault[0]");
    assert_eq!(
        refused(|c| {
            let power = fault(FaultKind::PowerLoss, 0.0, 1.0);
            c.fault = vec![Fault { joint: Some(2), ..power }];
        }),
        "fault[0].joint"
    );
    assert_eq!(
        refused(|c| c.fault = vec![fault(FaultKind::PowerLoss, f64::NAN, 1.0)]),
        "fault[0].at_s"
    );
    assert_eq!(refused(|c| c.fault = vec![fault(FaultKind::PowerLoss, 0.0, 1.0); 33]), "fault");
    assert_eq!(refused(|c| c.wrist.codes_per_n_nm = Some([[1.0; 6]; 6])), "wrist.codes_per_n_nm");
    assert_eq!(refused(|c| c.wrist.noise_codes = f64::NAN), "wrist.noise_codes");
    assert_eq!(refused(|c| c.tactile.row_us = 400.0), "tactile.row_us");
    assert_eq!(refused(|c| c.tactile.exponent = 0.0), "tactile.exponent");
    assert_eq!(refused(|c| c.arm.zero_error_deg[2] = 45.0), "arm.zero_error_deg[2]");
}
