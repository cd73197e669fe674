//! Calibration against ground truth: a pin rolls over pads with known tactels and rubber, and the
//! estimates and their uncertainties are compared with the true values over many draws.

mod common;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use common::Folder;
use glam::{DMat3, DVec3};
use taktil_hal::{Nanos, TactileFrame};
use taktil_lab_command::run::{Options, run};
use taktil_lab_identify::calibrate::fit::{ExtraUnknowns, Fit, fit};
use taktil_lab_identify::calibrate::press::{LoadedImage, Pad, UNLOADED_IMAGES_MIN};
use taktil_lab_identify::calibrate::{Recording, as_json, is_explained, read, table};
use taktil_sim::scene::Electronics;
use taktil_sim::{Carriage, FloatingGuide, Timing, WorldConfig, build_with_carriage, tactel_gains};

/// Number of frames of the rest level, which is known here.
const BASELINE_FRAMES: u32 = 100;

/// A pad with the given response.
fn pad(youngs_mpa: f64, threshold_n: f64, exponent: f64, noise_counts: f64) -> WorldConfig {
    let mut world = WorldConfig::default();
    world.finger.rubber.youngs_mpa = youngs_mpa;
    let tactile = &mut world.tactile;
    tactile.electronics = Electronics::Response;
    (tactile.threshold_n, tactile.exponent) = (threshold_n, exponent);
    tactile.noise_counts = noise_counts;
    world
}

/// Every fourth image of a finger on rails that rolls the pin over the pad, there and back, once
/// under each load (N). The sensor is slightly rotated, so that the rows differ. Each load begins
/// one image later: a seed draws the same noise for the same image, and readings with the same
/// noise would count only once.
fn rolling_images(world: &WorldConfig, seed: u64, loads: &[f64]) -> Vec<LoadedImage> {
    let nominal = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let axes = nominal * DMat3::from_rotation_x(0.001) * DMat3::from_rotation_z(0.03);
    let above_mm = world.table_height_mm() + 2.0 * world.pin.radius_mm + 0.5;
    let at = |x_mm: f64| 1e-3 * DVec3::new(325.0 + x_mm, -127.0, above_mm);
    let mut presses = Vec::new();
    for (later, load_n) in (0..).zip(loads) {
        let knots = vec![(0.4, at(0.0)), (0.9, at(20.0)), (1.9, at(-20.0)), (2.4, at(0.0))];
        let float = Some(FloatingGuide { mass_kg: 1.0, load_n: *load_n, damping_n_s_m: 200.0 });
        let carriage = Carriage { axes, knots, float };
        let (mut bench, mut devices) =
            build_with_carriage(world, &Timing::default(), seed, carriage).unwrap();
        for i in (70 + later..480).step_by(4) {
            let t = Nanos::from_millis(5 * i);
            bench.advance(t);
            let mut frame = TactileFrame::new(16, 16);
            let _ = devices.tactile.get_mut("tactile").unwrap().sample(t, &mut frame);
            assert_eq!(frame.acquired, t);
            let counts = frame.values.iter();
            let counts = counts.map(|value| f64::from(*value) - world.tactile.rest_counts);
            presses.extend(LoadedImage::of(
                counts.collect(),
                &world.tactile.geometry(),
                &bench.truth(),
            ));
        }
    }
    presses
}

/// Errors of modulus, threshold and exponent in standard deviations.
fn deviations(fit: &Fit, world: &WorldConfig) -> [f64; 3] {
    let tactile = &world.tactile;
    let due = [
        (fit.youngs_mpa, world.finger.rubber.youngs_mpa),
        (fit.threshold_n, tactile.threshold_n),
        (fit.exponent, tactile.exponent),
    ];
    due.map(|(estimate, due)| (estimate.value - due) / estimate.deviation)
}

fn gains_off(fit: &Fit, world: &WorldConfig, seed: u64) -> Vec<(f64, f64)> {
    let drawn = tactel_gains(&world.tactile, seed);
    let known = fit.gains.iter().zip(&drawn).filter_map(|(gain, due)| Some(((*gain)?, *due)));
    known.map(|(gain, due)| (gain.value - due, gain.deviation)).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn share(values: &[f64], bound: f64) -> f64 {
    values.iter().filter(|v| v.abs() < bound).count() as f64 / values.len() as f64
}

/// Draws of four pads, with noise from a fifth of the scene's default up to the default: the errors
/// of modulus, threshold and exponent, and those of the gains, in standard deviations.
fn normalised_errors(draws: u64) -> (Vec<f64>, Vec<f64>) {
    let (mut shared, mut gains) = (Vec::new(), Vec::new());
    for seed in 1..=draws {
        let world = match seed % 4 {
            0 => pad(2.0, 0.01, 0.85, 50.0),
            1 => pad(1.0, 0.002, 0.95, 10.0),
            2 => pad(5.0, 0.005, 1.1, 20.0),
            _ => pad(2.7, 0.02, 0.7, 50.0),
        };
        let presses = rolling_images(&world, seed, &[16.0, 7.0]);
        let fit = fit(
            &presses,
            &Pad::of(&world, BASELINE_FRAMES).unwrap(),
            ExtraUnknowns::default(),
            &mut || (),
        )
        .unwrap();
        let z = deviations(&fit, &world);
        println!(
            "seed {seed}: {} images, E {:?} t {:?} p {:?}, noise {:.2}: {z:.2?}",
            fit.images, fit.youngs_mpa, fit.threshold_n, fit.exponent, fit.noise_counts
        );
        let noise = fit.noise_counts / world.tactile.noise_counts;
        assert!((noise - 1.0).abs() < 0.03, "seed {seed}: {noise}");
        assert!(fit.youngs_mpa.deviation < 0.1 * world.finger.rubber.youngs_mpa);
        assert!(fit.exponent.deviation < 0.01);
        shared.extend(z);
        gains.extend(gains_off(&fit, &world, seed));
    }
    let ratios: Vec<f64> = gains.iter().map(|(off, deviation)| off / deviation).collect();
    let errors: Vec<f64> = gains.iter().map(|(off, _)| *off).collect();
    println!(
        "E, t, p: {:.2} deviations rms, {:.3} within two; {} gains: error {:.4} rms, {:.2} \
         deviations rms, {:.3} within two",
        rms(&shared),
        share(&shared, 2.0),
        gains.len(),
        rms(&errors),
        rms(&ratios),
        share(&ratios, 2.0)
    );
    assert!(gains.len() > 200 * draws as usize, "{} gains", gains.len());
    // Without calibration the error is the spread of the gains itself, 0.06.
    assert!(rms(&errors) < 0.03, "{}", rms(&errors));
    (shared, ratios)
}

#[test]
fn the_true_values_lie_within_the_uncertainty() {
    let (shared, gains) = normalised_errors(4);
    assert!(share(&shared, 3.5) == 1.0, "{shared:.2?}");
    // 95 % of a thousand independent gains lie within two deviations, within 0.7 %; the parameters
    // that they share move the gains of one pad together.
    assert!((0.85..1.15).contains(&rms(&gains)), "{}", rms(&gains));
    assert!(share(&gains, 2.0) > 0.92, "{}", share(&gains, 2.0));
}

#[test]
#[ignore = "minutes: cargo test --release -p taktil --test calibrate -- --ignored --nocapture"]
fn the_true_values_lie_within_the_uncertainty_over_many_draws() {
    let (shared, gains) = normalised_errors(20);
    // 95 % of 60 draws lie within two deviations, within 2.8 %.
    assert!((0.88..=1.0).contains(&share(&shared, 2.0)) && share(&shared, 4.0) == 1.0);
    assert!((0.7..1.2).contains(&rms(&shared)), "{}", rms(&shared));
    assert!((0.9..1.1).contains(&rms(&gains)), "{}", rms(&gains));
    assert!((0.93..0.97).contains(&share(&gains, 2.0)), "{}", share(&gains, 2.0));
}

#[test]
fn thickness_is_identified_only_together_with_the_modulus() {
    let world = pad(2.0, 0.01, 0.85, 10.0);
    let presses = rolling_images(&world, 3, &[16.0, 7.0]);
    let given = Pad::of(&world, BASELINE_FRAMES).unwrap();
    let known = fit(&presses, &given, ExtraUnknowns::default(), &mut || ()).unwrap();
    let modulus = |fit: &Fit| fit.youngs_mpa.deviation / fit.youngs_mpa.value;
    // When the thickness is sought as well, it is found, with a less certain modulus, as was
    // predicted.
    let also = ExtraUnknowns { thickness: true, poisson: false };
    let sought = fit(&presses, &given, also, &mut || ()).unwrap();
    let thickness = sought.thickness_mm.unwrap();
    println!("{known:?}\n{thickness:?} {:?}", sought.youngs_mpa);
    assert!((thickness.value - 0.8).abs() < 3.5 * thickness.deviation, "{thickness:?}");
    assert!(deviations(&sought, &world).iter().all(|z| z.abs() < 3.5));
    assert!(modulus(&sought) > 2.0 * modulus(&known));
    let foretold = known.identifiability.with_thickness.unwrap()[0];
    assert!((modulus(&sought) / foretold - 1.0).abs() < 0.5, "{foretold}");
    assert!(known.identifiability.correlation.unwrap()[0][3] > 0.9);
    // A wrong thickness shifts the modulus by the predicted amount.
    let thicker = Pad { thickness_mm: 0.8 * 1.02, ..given };
    let shifted = fit(&presses, &thicker, ExtraUnknowns::default(), &mut || ()).unwrap();
    let percent = 100.0 * (shifted.youngs_mpa.value / known.youngs_mpa.value - 1.0);
    let said = 2.0 * known.identifiability.shift_percent[0].unwrap();
    assert!((percent / said - 1.0).abs() < 0.15, "{percent} {said}");
}

#[test]
fn readings_at_the_end_of_the_converter_do_not_bias_and_too_many_are_refused() {
    let mut world = pad(2.0, 0.01, 0.85, 20.0);
    world.tactile.full_scale_n = 0.8;
    let some = rolling_images(&world, 4, &[16.0]);
    let fit_some = fit(
        &some,
        &Pad::of(&world, BASELINE_FRAMES).unwrap(),
        ExtraUnknowns::default(),
        &mut || (),
    )
    .unwrap();
    println!("{} clipped: {:?}", fit_some.clipped, deviations(&fit_some, &world));
    assert!(fit_some.clipped > 20 && deviations(&fit_some, &world).iter().all(|z| z.abs() < 3.5));
    world.tactile.full_scale_n = 0.2;
    let most = rolling_images(&world, 4, &[16.0]);
    let refused = fit(
        &most,
        &Pad::of(&world, BASELINE_FRAMES).unwrap(),
        ExtraUnknowns::default(),
        &mut || (),
    )
    .unwrap_err();
    assert!(refused.contains("converter's end") && refused.contains("press less"), "{refused}");
}

#[test]
fn uninformative_images_are_rejected() {
    let pad = Pad::of(&WorldConfig::default(), BASELINE_FRAMES).unwrap();
    let few = fit(&[], &pad, ExtraUnknowns::default(), &mut || ()).unwrap_err();
    assert!(few.contains("0 images"), "{few}");
    // Many images without a contact do not separate stiffness and response.
    let press = LoadedImage {
        counts: vec![0.0; 256],
        force_n: 15.0,
        x_c: 8.5,
        yaw_rad: 0.0,
        tilt_rad: 0.0,
    };
    let same =
        fit(&vec![press.clone(); 60], &pad, ExtraUnknowns::default(), &mut || ()).unwrap_err();
    assert!(same.contains("do not tell"), "{same}");
    // In these images every tactel is invalid.
    let blind = LoadedImage { counts: vec![f64::NAN; 256], ..press };
    let blind = fit(&vec![blind; 60], &pad, ExtraUnknowns::default(), &mut || ()).unwrap_err();
    assert!(blind.contains("do not tell"), "{blind}");
    let mut world = WorldConfig::default();
    world.pin.present = false;
    assert!(Pad::of(&world, BASELINE_FRAMES).unwrap_err().contains("pin.present"));
    let mut world = WorldConfig::default();
    world.tactile.row_us = 100.0;
    assert!(Pad::of(&world, BASELINE_FRAMES).unwrap_err().contains("tactile.row_us"));
}

/// The rolling scene with more settings, recorded in virtual time.
fn recorded(folder: &Path, more: &str, for_s: f64) -> PathBuf {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    let text = std::fs::read_to_string(scenes.join("roll-pin.toml")).unwrap();
    let machine = scenes.join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap()) + more;
    let (scene, log) = (folder.join("scene.toml"), folder.join("log.mcap"));
    std::fs::write(&scene, text).unwrap();
    let options = Options {
        scene,
        fast: true,
        for_s: Some(for_s),
        log: Some(log.clone()),
        json: true,
        ..Options::default()
    };
    run(&options).unwrap();
    log
}

/// Bytes of a log of the rolling scene with a response and little noise, so that a wrong model or a
/// wrong instant would leave a visible residual. It is recorded once for all tests.
fn rolling() -> &'static [u8] {
    static LOG: OnceLock<Vec<u8>> = OnceLock::new();
    LOG.get_or_init(|| {
        let folder = Folder::new("calibrate");
        let more = "\n[world.tactile]\nelectronics = \"response\"\nexponent = 0.85\n\
                    threshold_n = 0.01\nnoise_counts = 5\n";
        std::fs::read(recorded(&folder.0, more, 5.0)).unwrap()
    })
}

/// Writes these bytes to a file and reads the recording from it.
fn read_bytes(name: &str, bytes: &[u8]) -> Result<Recording, String> {
    let folder = Folder::new(name);
    let path = folder.0.join("log.mcap");
    std::fs::write(&path, bytes).unwrap();
    read(&path)
}

#[test]
fn a_log_of_the_rolling_scene_is_calibrated() {
    let recording = read_bytes("calibrate-whole", rolling()).unwrap();
    let Recording { scene, pad, pressed, beyond, damage } = &recording;
    assert_eq!((*beyond, damage), (0, &None));
    let fit = fit(&pressed.presses, pad, ExtraUnknowns::default(), &mut || ()).unwrap();
    let z = deviations(&fit, &scene.world);
    println!("{:?} {:?} {:?}: {z:.2?}", fit.youngs_mpa, fit.threshold_n, fit.exponent);
    assert!(z.iter().all(|z| z.abs() < 3.5), "{z:.2?}");
    assert!(fit.youngs_mpa.deviation < 0.02, "{:?}", fit.youngs_mpa);
    let rest = pressed.rest_noise_counts.unwrap();
    assert!((fit.noise_counts / rest - 1.0).abs() < 0.02, "{} {rest}", fit.noise_counts);
}

/// Positions of the records of an MCAP file, with their opcodes.
fn records(bytes: &[u8]) -> Vec<(usize, u8)> {
    let (mut at, mut all) = (8, Vec::new());
    while at + 9 < bytes.len() - 8 {
        all.push((at, bytes[at]));
        let length = u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap());
        at += 9 + usize::try_from(length).unwrap();
    }
    all
}

/// The same messages in a log without chunks, as older programs wrote it, with an end that says
/// nothing of what is in it.
fn unchunked(bytes: &[u8]) -> Vec<u8> {
    const CHUNK_OPCODE: u8 = 6;
    const MESSAGE_INDEX: u8 = 7;
    const DATA_END: u8 = 15;
    const MAGIC_BYTES: usize = 8;
    let mut plain = bytes[..MAGIC_BYTES].to_vec();
    let all = records(bytes);
    for pair in all.windows(2) {
        let (at, opcode) = pair[0];
        match opcode {
            CHUNK_OPCODE => {
                // Times, size and CRC, then the name of the compression, which is empty.
                let name = at + 9 + 28;
                assert_eq!(bytes[name..name + 4], [0; 4], "not compressed");
                plain.extend_from_slice(&bytes[name + 4 + 8..pair[1].0]);
            }
            MESSAGE_INDEX => {}
            _ => plain.extend_from_slice(&bytes[at..pair[1].0]),
        }
        if opcode == DATA_END {
            break;
        }
    }
    // The footer of a file without a summary, and the magic bytes again.
    plain.push(2);
    plain.extend_from_slice(&20u64.to_le_bytes());
    plain.extend_from_slice(&[0; 20]);
    plain.extend_from_slice(&bytes[..MAGIC_BYTES]);
    plain
}

/// The number of a topic's channel in the file.
fn channel(bytes: &[u8], topic: &str) -> [u8; 2] {
    let named = |at: usize| bytes[at + 17..].starts_with(topic.as_bytes());
    let mut all = records(bytes).into_iter().filter(|(_, opcode)| *opcode == 4);
    let (at, _) = all.find(|(at, _)| named(*at)).unwrap();
    *bytes[at + 9..].first_chunk().unwrap()
}

#[test]
fn the_readable_part_of_a_damaged_log_is_used_and_the_damage_is_reported() {
    let whole = rolling();
    let pressed = |recording: &Recording| recording.pressed.presses.len();
    let all = pressed(&read_bytes("calibrate-all", whole).unwrap());
    // The file is cut in the middle of a record, at nine tenths.
    let plain = unchunked(whole);
    assert_eq!(pressed(&read_bytes("calibrate-plain", &plain).unwrap()), all);
    for (name, log) in [("calibrate-cut", whole), ("calibrate-cut-plain", &plain)] {
        let cut = read_bytes(name, &log[..log.len() * 9 / 10 + 3]).unwrap();
        let damage = cut.damage.as_ref().unwrap().to_string();
        assert!(damage.contains("cut"), "{damage}");
        assert!((all / 2..all).contains(&pressed(&cut)), "{} of {all}", pressed(&cut));
    }
    // A bit of a message is flipped there.
    let whole = plain.as_slice();
    let starts = records(whole);
    let (at, _) = starts[starts.len() * 9 / 10..].iter().find(|(_, code)| *code == 5).unwrap();
    let mut flipped = whole.to_vec();
    flipped[at + 60] ^= 0x10;
    let flipped = read_bytes("calibrate-flipped", &flipped).unwrap();
    let damage = flipped.damage.as_ref().unwrap();
    assert!(damage.what.contains("CRC") && damage.offset == *at, "{damage}");
    assert!((all / 2..all).contains(&pressed(&flipped)), "{} of {all}", pressed(&flipped));
    let used =
        fit(&flipped.pressed.presses, &flipped.pad, ExtraUnknowns::default(), &mut || ()).unwrap();
    assert!(deviations(&used, &flipped.scene.world).iter().all(|z| z.abs() < 3.5));
}

#[test]
fn images_after_the_last_truth_are_left_out_and_counted() {
    let whole = unchunked(rolling());
    let whole = whole.as_slice();
    let truth = channel(whole, "/world/truth");
    let starts = records(whole);
    let from = starts.len() * 9 / 10;
    let mut bytes = whole[..starts[from].0].to_vec();
    let mut images = 0;
    for pair in starts[from..].windows(2) {
        let (at, opcode) = pair[0];
        if opcode != 5 {
            break;
        }
        let of: [u8; 2] = *whole[at + 9..].first_chunk().unwrap();
        images += usize::from(of == channel(whole, "/tactile_scan/image"));
        if of != truth {
            bytes.extend_from_slice(&whole[at..pair[1].0]);
        }
    }
    let recording = read_bytes("calibrate-beyond", &bytes).unwrap();
    assert!(recording.beyond > 50 && recording.beyond <= images, "{}", recording.beyond);
    assert!(recording.damage.is_some(), "it has no end");
    assert!(recording.pressed.presses.len() > 100);
    // Without any truth no image can be used.
    let mut none = whole[..8].to_vec();
    for pair in starts.windows(2) {
        let (at, opcode) = pair[0];
        if !(opcode == 5 && whole[at + 9..].starts_with(&truth)) && opcode != 15 {
            none.extend_from_slice(&whole[at..pair[1].0]);
        }
        if opcode == 15 {
            break;
        }
    }
    let refused = read_bytes("calibrate-no-truth", &none).unwrap_err();
    assert!(refused.contains("does not say what the world did"), "{refused}");
}

#[test]
fn with_too_few_images_at_rest_it_is_not_claimed_that_the_model_explains_the_others() {
    let whole = rolling();
    let mut recording = read_bytes("calibrate-rest", whole).unwrap();
    let fit = fit(&recording.pressed.presses, &recording.pad, ExtraUnknowns::default(), &mut || ())
        .unwrap();
    assert!(recording.pressed.rest_images >= UNLOADED_IMAGES_MIN);
    assert_eq!(is_explained(&fit, &recording.pressed), Some(true));
    (recording.pressed.rest_images, recording.pressed.rest_noise_counts) =
        (UNLOADED_IMAGES_MIN - 1, None);
    assert_eq!(is_explained(&fit, &recording.pressed), None);
    let text = table(&fit, &recording);
    assert!(text.contains("is not told: 19 of them without a load"), "{text}");
    assert!(as_json(&fit, &recording)["explained"].is_null());
}

#[test]
fn logs_that_cannot_be_used_are_refused_with_the_reason() {
    let folder = Folder::new("calibrate-bad");
    let absent = read(&folder.0.join("absent.mcap")).unwrap_err();
    assert!(absent.contains("absent.mcap"), "{absent}");
    let foreign = read_bytes("calibrate-foreign", b"not a log").unwrap_err();
    assert!(foreign.contains("not an MCAP file"), "{foreign}");
    let empty = read_bytes("calibrate-empty", b"").unwrap_err();
    assert!(empty.contains("it is empty"), "{empty}");
    // This log is cut before its first message.
    let bare = read_bytes("calibrate-bare", &rolling()[..500]).unwrap_err();
    assert!(bare.contains("metadata") && bare.contains("readable up to byte"), "{bare}");
    // This log ends before the finger touches the pin.
    let early = read(&recorded(&folder.0, "", 0.8)).unwrap_err();
    assert!(early.contains("none of its images") || early.contains("no image"), "{early}");
    let linear = "\n[robot.tactile_scan.response]\nexponent = 0.85\nfull_counts = 4000.0\n";
    let linear = read(&recorded(&folder.0, linear, 0.2)).unwrap_err();
    assert!(linear.contains("robot.tactile_scan.response"), "{linear}");
}
