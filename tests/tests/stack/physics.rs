//! Effects that need real forces: without friction nothing rolls, without contact nothing is felt.
//! The simulator's truth is the measure wherever it exists, not the controller's estimate.

use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_signal::{Features, State, TactileImage, defined};

use taktil_tests::bench::{RecordedRun, SceneDraft, run};

/// The finger presses from this share of its set point on.
const PRESSED_SHARE: f64 = 0.9;

/// Strokes as the program counts them: reversals of a finger that presses.
fn strokes(scene: &Scene) -> (u32, RecordedRun) {
    let servo = scene.machine.tactile_servo.clone().unwrap_or_default();
    let kept = run(scene, 1);
    let pressed = |f: &&(_, Features)| f.1.active != 0 && f.1.m0 >= PRESSED_SHARE * servo.m0_counts;
    let features = kept.of::<Features>("tactile_servo.features");
    assert!(features.iter().any(|(_, f)| f.active != 0), "never tried");
    let since = features.iter().find(pressed).map(|row| row.0);
    let counted = since.map_or(0, |since| {
        let before = features.iter().filter(|row| row.0 < since).map(|row| row.1.reversals).max();
        features.last().unwrap().1.reversals - before.unwrap_or(0)
    });
    (counted, kept)
}

#[test]
fn without_friction_the_pin_slips_and_the_strokes_fail() {
    for surfaces in [&["table", "finger"][..], &["table"], &["finger"]] {
        let mut draft = SceneDraft::roll_pin();
        for surface in surfaces {
            draft = draft.set(&format!("world.{surface}.friction"), 0.0);
        }
        let (strokes, kept) = strokes(&draft.scene());
        assert_eq!(strokes, 0, "{surfaces:?}");
        let truth = kept.of::<WorldTruth>("world.truth");
        let slip = truth.iter().map(|(_, t)| t.finger_slip_m_s.max(t.table_slip_m_s));
        assert!(slip.fold(0.0, f64::max) > 1e-3, "{surfaces:?}: nothing slipped");
    }
}

#[test]
fn with_friction_the_same_count_finds_strokes() {
    assert!(strokes(&SceneDraft::roll_pin().scene()).0 >= 2);
}

#[test]
fn a_lifted_finger_feels_nothing() {
    // Enabled and calibrated, but never lowered.
    let scene = SceneDraft::roll_pin().first_requests(2).set("duration_s", 4.0).scene();
    let kept = run(&scene, 1);
    assert_eq!(kept.last_control().state, State::IdleCalibrated as u32);
    assert!(kept.of::<WorldTruth>("world.truth").iter().all(|(_, t)| t.in_contact == 0));

    let images = kept.of::<TactileImage>("tactile_scan.image");
    let ready: Vec<_> = images.iter().filter(|(_, image)| image.baseline_ready != 0).collect();
    assert!(ready.len() > 400, "{} images after the baseline", ready.len());
    let noise = scene.world.tactile.noise_counts;
    #[expect(clippy::cast_precision_loss, reason = "counts of samples")]
    let frames = ready.len() as f64;
    let mut outside = 0;
    let mut sum = 0.0;
    for tactel in 0..256 {
        let counts = || ready.iter().map(|(_, image)| f64::from(image.counts[tactel]));
        let mean = counts().sum::<f64>() / frames;
        sum += mean;
        // The baseline is itself a mean of 40 noisy frames: a tactel may stand off by its error, of
        // 256 hardly one by more than five deviations.
        assert!(mean.abs() < 5.0 * noise / 40f64.sqrt(), "tactel {tactel}: mean {mean}");
        let rms = (counts().map(|c| (c - mean) * (c - mean)).sum::<f64>() / frames).sqrt();
        assert!(rms > 0.0, "tactel {tactel} is dead: an image without noise proves nothing");
        outside += counts().filter(|c| c.abs() > 6.0 * noise).count();
    }
    assert_eq!(outside, 0, "counts beyond six standard deviations");
    // 256 baseline errors of at most noise / sqrt(frames of the baseline), added up.
    let spread = (sum / 256.0).abs();
    assert!(spread < 0.1 * noise, "mean over all tactels {spread}");
}

#[test]
fn a_lifted_finger_never_reports_contact() {
    let scene = SceneDraft::roll_pin().first_requests(2).scene();
    let features = run(&scene, 1).of::<Features>("tactile_servo.features");
    let wrong = features.iter().filter(|(_, f)| f.defined & defined::CONTACT != 0);
    let most = features.iter().map(|(_, f)| f.m0).fold(0.0, f64::max);
    assert_eq!(wrong.count(), 0, "of {} frames; largest M0 {most} counts", features.len());
}

#[test]
fn a_pressed_finger_feels_what_presses_it() {
    // The neighbour of the test above: the same figures see a contact.
    let kept = run(&SceneDraft::roll_pin().set("duration_s", 4.0).scene(), 1);
    let features = kept.of::<Features>("tactile_servo.features");
    assert!(features.iter().any(|(_, f)| f.defined & defined::CONTACT != 0));
    assert!(kept.of::<WorldTruth>("world.truth").iter().any(|(_, t)| t.in_contact != 0));
}
