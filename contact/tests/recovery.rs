//! Tests the recovery of loads and width from moments: round trips, uncertainties, errors.

use taktil_contact::layer::Layer;
use taktil_contact::plane::recovery::{BarOverSensor, Estimate, RecoveryError};
use taktil_contact::plane::{Friction, Load};

fn setting(friction: Friction) -> BarOverSensor {
    let layer = Layer::new(0.8, 27.58, 0.49).expect("a sound layer");
    BarOverSensor { layer, height_mm: 6.35, origin_mm: 12.7, friction }
}

fn measured(m: [f64; 2]) -> [Estimate; 2] {
    m.map(|value| Estimate { value, sigma: 0.001 * value.abs() })
}

#[test]
fn loads_and_width_come_back_whole_or_lifted() {
    for friction in [Friction::None, Friction::Proportional] {
        for (p_n_mm, q_n_mm) in [(0.7, 0.0), (0.175, 0.0438), (0.35, 0.2), (0.5, -0.1)] {
            let (setting, width) = (setting(friction), 12.7);
            let load = Load { p_n_mm, q_n_mm };
            let m = setting.moments(width, &load).expect("a contact");
            // Shear acts over the layer's thickness too.
            let lever = if friction == Friction::None { 6.35 } else { 7.15 };
            assert!((m[0] + lever * q_n_mm + 12.7 * p_n_mm).abs() < 1e-10);
            let found = setting.loads(width, measured(m)).expect("loads");
            assert!((found.p.value - p_n_mm).abs() < 1e-5 * p_n_mm, "{found:?}");
            assert!((found.q.value - q_n_mm).abs() < 1e-5 * p_n_mm, "{found:?}");
            assert!(found.p.sigma > 0.0 && found.q.sigma > 0.0);
            let found = setting.width(&load, measured(m)).expect("a width");
            assert!((found.width.value - width).abs() < 1e-3, "{found:?}");
            assert!(found.width.sigma > 0.0 && found.misses[0].abs() < 1e-9);
            let all = setting.check_consistency(width, &load, measured(m)).expect("a check");
            assert!(all.misses.iter().all(|miss| miss.abs() < 1e-9));
            let [c, lever, value] = setting.constraint(measured(m)).expect("a constraint");
            assert!((c * p_n_mm + lever * q_n_mm - value).abs() < 1e-9);
        }
    }
}

#[test]
fn uncertainties_are_those_of_many_draws() {
    let setting = setting(Friction::None);
    let load = Load { p_n_mm: 0.5, q_n_mm: 0.05 };
    let m = setting.moments(10.0, &load).expect("a contact");
    let sigma = [0.003, 0.04];
    let at = |d: [f64; 2]| {
        let m = [0, 1].map(|k| Estimate { value: m[k] + sigma[k] * d[k], sigma: sigma[k] });
        setting.loads(10.0, m).expect("loads")
    };
    let middle = at([0.0, 0.0]);
    // Four draws at one sigma in each moment: their mean square is the variance.
    let signs = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let spread: f64 =
        signs.iter().map(|d| at(*d).p.value - middle.p.value).map(|d| d * d).sum::<f64>() / 2.0;
    assert!((spread.sqrt() / middle.p.sigma - 1.0).abs() < 0.01, "{spread} {middle:?}");
}

/// Loads at the height of the surface, low bars near the origin and thin incompressible layers are
/// recovered like all others.
#[test]
fn low_bars_and_thin_layers_come_back_too() {
    for (t, nu, height_mm, origin_mm, width, slant) in [
        (0.8, 0.49, 0.0, 12.7, 12.7, 0.3),
        (2.6, 0.49, 3.4, 7.55, 14.4, 0.0),
        (0.8, 0.3, 1.0, -12.7, 15.1, -0.9),
        (1.1, 0.31, 9.6, 5.43, 10.3, 0.1),
        (0.1, 0.5, 6.35, 12.7, 6.35, 0.05),
    ] {
        let layer = Layer::new(t, 27.58, nu).expect("a sound layer");
        let friction = Friction::Proportional;
        let setting = BarOverSensor { layer, height_mm, origin_mm, friction };
        let load = Load { p_n_mm: 0.4, q_n_mm: slant * 0.4 };
        let m = measured(setting.moments(width, &load).expect("a contact"));
        let found = setting.loads(width, m).expect("loads");
        assert!((found.p.value - 0.4).abs() < 1e-4 * 0.4, "{height_mm}: {found:?}");
        assert!((found.q.value - load.q_n_mm).abs() < 1e-4 * 0.4, "{height_mm}: {found:?}");
        let found = setting.width(&load, m).expect("a width");
        assert!((found.width.value / width - 1.0).abs() < 1e-4, "{height_mm}: {found:?}");
    }
}

/// Bars of all widths under noise of 3 % in both moments: none is refused, and the uncertainties
/// have the coverage that they state.
#[test]
fn noise_is_never_refused_and_its_uncertainty_covers() {
    let mut state = 7_u64;
    let mut draw = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
    };
    let (mut within, mut count) = ([[0_usize; 2]; 3], 0_usize);
    for i in 0..24 {
        let setting = setting([Friction::None, Friction::Proportional][i % 2]);
        let width = 1.0 + 14.0 * draw();
        let p_n_mm = 0.1 + draw();
        let load = Load { p_n_mm, q_n_mm: 0.9 * (2.0 * draw() - 1.0) * p_n_mm * width / 12.7 };
        let exact = setting.moments(width, &load).expect("a contact");
        let sigma = exact.map(|m| 0.03 * m.abs());
        for _ in 0..12 {
            let noisy = [0, 1].map(|k| {
                let normal = (0..12).map(|_| draw()).sum::<f64>() - 6.0;
                Estimate { value: exact[k] + sigma[k] * normal, sigma: sigma[k] }
            });
            let loads = setting.loads(width, noisy).expect("loads");
            let wide = setting.width(&load, noisy).expect("a width");
            let misses = [
                (loads.p.value - p_n_mm) / loads.p.sigma,
                (loads.q.value - load.q_n_mm) / loads.q.sigma,
                (wide.width.value - width) / wide.width.sigma,
            ];
            count += 1;
            for (within, miss) in within.iter_mut().zip(misses) {
                within[0] += usize::from(miss.abs() <= 1.0);
                within[1] += usize::from(miss.abs() <= 2.0);
            }
        }
    }
    let part = |n: usize| n as f64 / count as f64;
    for [one, two] in within.map(|w| w.map(part)) {
        assert!(one > 0.62 && two > 0.91, "{one} {two}");
    }
}

#[test]
fn what_cannot_be_recovered_is_refused() {
    let sound = setting(Friction::None);
    let m = measured(sound.moments(12.7, &Load { p_n_mm: 0.5, q_n_mm: 0.0 }).expect("sound"));
    let middle = BarOverSensor { origin_mm: 0.0, ..sound };
    assert!(matches!(middle.loads(12.7, m), Err(RecoveryError::Invalid(_))));
    let pulls = measured([6.35, 80.0]);
    assert_eq!(sound.loads(12.7, pulls), Err(RecoveryError::NoContact));
    let wide = Estimate { value: 4.0 * m[1].value, sigma: 1.0 };
    let load = Load { p_n_mm: 0.5, q_n_mm: 0.0 };
    assert_eq!(sound.width(&load, [m[0], wide]), Err(RecoveryError::NoContact));
    for bad in [f64::NAN, f64::INFINITY] {
        let bad = Estimate { value: bad, sigma: 1.0 };
        assert!(matches!(sound.loads(12.7, [bad, m[1]]), Err(RecoveryError::Invalid(_))));
    }
    let toppling = Load { p_n_mm: 0.1, q_n_mm: 0.3 };
    assert_eq!(sound.check_consistency(12.7, &toppling, m), Err(RecoveryError::NoContact));
    let slack = BarOverSensor { height_mm: 0.0, ..sound };
    assert!(matches!(slack.loads(12.7, m), Err(RecoveryError::Invalid(_))));
    let flat = BarOverSensor { height_mm: -1.0, ..sound };
    assert!(matches!(flat.width(&load, m), Err(RecoveryError::Invalid(_))));
}
