//! What a score makes of records, in any order.

use super::*;

#[test]
fn a_span_without_a_sample_is_absent() {
    let mut span = Span::default();
    assert_eq!(span.width(), None);
    span.add(3.0);
    span.add(-1.0);
    assert_eq!((span.0, span.width()), (Some((-1.0, 3.0)), Some(4.0)));
    assert_eq!(Spread::default().mean(), None);
}

#[test]
fn a_spread_gives_mean_rms_peak_and_the_steady_value() {
    let mut spread = Spread::default();
    for value in [3.0, -4.0] {
        spread.add(value);
    }
    assert_eq!(spread.mean(), Some(-0.5));
    assert_eq!(spread.rms(), Some(12.5f64.sqrt()));
    assert_eq!(spread.peak(), Some(4.0));
    for _ in 0..4000 {
        spread.add(7.0);
    }
    assert!((spread.steady().unwrap() - 7.0).abs() < 1e-3);
}

#[test]
fn what_a_pin_does_is_judged_only_where_there_is_one() {
    for pin in [true, false] {
        let targets = Targets {
            m0: 1e3,
            counts_per_n: 1e3,
            pitch_x_mm: 1.5875,
            pitch_y_mm: 1.5875,
            pin,
            plain_kp_nm_rad: None,
            phase_names: Vec::new(),
        };
        let catalog = Catalog { signals: Vec::new(), lanes: Vec::new() };
        let mut score = Score::new(&catalog, targets, AnyRobot::puma260());
        score.truth = Some(WorldTruth { in_contact: 1, ..WorldTruth::ZERO });
        let seen = defined::CONTACT | defined::CENTROID;
        score.features(&Features { active: 1, defined: seen, m0: 1e3, ..Features::ZERO });
        score.truth(WorldTruth { finger_normal_n: 1.0, in_contact: 1, ..WorldTruth::ZERO });
        let f = &score.figures;
        assert_eq!((f.force_n.mean(), f.x_c.width()), (Some(1.0), Some(0.0)));
        let about_pin = [f.x_c_error, f.yaw_error_deg, f.tilt_error_deg, f.gap_mm];
        assert!(about_pin.iter().all(|spread| spread.mean().is_some() == pin));
        assert_eq!((f.height_error_mm().is_some(), f.slip_mm_s.is_some()), (pin, pin));
    }
}
