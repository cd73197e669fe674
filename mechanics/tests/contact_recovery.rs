//! Recovery of loads and width from moments: there and back, uncertainties, refusals.

use taktil_mechanics::contact::layer::Layer;
use taktil_mechanics::contact::plane::recovery::{Measured, Setting, Unrecovered};
use taktil_mechanics::contact::plane::{Friction, Load};

fn setting(friction: Friction) -> Setting {
    let layer = Layer::new(0.8, 27.58, 0.49).expect("a sound layer");
    Setting { layer, height_mm: 6.35, origin_mm: 12.7, friction }
}

fn measured(m: [f64; 2]) -> [Measured; 2] {
    m.map(|value| Measured { value, sigma: 0.001 * value.abs() })
}

#[test]
fn loads_and_width_come_back_whole_or_lifted() {
    for friction in [Friction::None, Friction::Proportional] {
        for (p_n_mm, q_n_mm) in [(0.7, 0.0), (0.175, 0.0438), (0.35, 0.2), (0.5, -0.1)] {
            let (setting, width) = (setting(friction), 12.7);
            let load = Load { p_n_mm, q_n_mm };
            let m = setting.moments(width, &load).expect("a contact");
            assert!((m[0] + 7.15 * q_n_mm + 12.7 * p_n_mm).abs() < 1e-10);
            let found = setting.loads(width, measured(m)).expect("loads");
            assert!((found.p.value - p_n_mm).abs() < 1e-5 * p_n_mm, "{found:?}");
            assert!((found.q.value - q_n_mm).abs() < 1e-5 * p_n_mm, "{found:?}");
            assert!(found.p.sigma > 0.0 && found.q.sigma > 0.0);
            let found = setting.width(&load, measured(m)).expect("a width");
            assert!((found.width.value - width).abs() < 1e-3, "{found:?}");
            assert!(found.width.sigma > 0.0 && found.misses[0].abs() < 1e-9);
            let all = setting.check_all(width, &load, measured(m)).expect("a check");
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
        let m = [0, 1].map(|k| Measured { value: m[k] + sigma[k] * d[k], sigma: sigma[k] });
        setting.loads(10.0, m).expect("loads")
    };
    let middle = at([0.0, 0.0]);
    // Four draws at one sigma in each moment: their mean square is the variance.
    let signs = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let spread: f64 =
        signs.iter().map(|d| at(*d).p.value - middle.p.value).map(|d| d * d).sum::<f64>() / 2.0;
    assert!((spread.sqrt() / middle.p.sigma - 1.0).abs() < 0.01, "{spread} {middle:?}");
}

#[test]
fn what_cannot_be_recovered_is_refused() {
    let sound = setting(Friction::None);
    let m = measured(sound.moments(12.7, &Load { p_n_mm: 0.5, q_n_mm: 0.0 }).expect("sound"));
    let middle = Setting { origin_mm: 0.0, ..sound };
    assert!(matches!(middle.loads(12.7, m), Err(Unrecovered::Invalid(_))));
    let pulls = measured([6.35, 80.0]);
    assert_eq!(sound.loads(12.7, pulls), Err(Unrecovered::NoContact));
    let wide = Measured { value: 4.0 * m[1].value, sigma: 1.0 };
    let load = Load { p_n_mm: 0.5, q_n_mm: 0.0 };
    assert_eq!(sound.width(&load, [m[0], wide]), Err(Unrecovered::NoContact));
    for bad in [f64::NAN, f64::INFINITY] {
        let bad = Measured { value: bad, sigma: 1.0 };
        assert!(matches!(sound.loads(12.7, [bad, m[1]]), Err(Unrecovered::Invalid(_))));
    }
    let toppling = Load { p_n_mm: 0.1, q_n_mm: 0.3 };
    assert_eq!(sound.check_all(12.7, &toppling, m), Err(Unrecovered::NoContact));
    let flat = Setting { height_mm: -1.0, ..sound };
    assert!(matches!(flat.width(&load, m), Err(Unrecovered::Invalid(_))));
}
