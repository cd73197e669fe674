//! A pin between two fingertips: the arm rolls it by the touch of one, both feel it. Refuses to
//! look at the controller's opinion where the simulator's truth is to be had.

use taktil::run::world::{OpposedTruth, WorldTruth};
use taktil_signal::{Features, TactileImage};
use taktil_tests::bench::{Draft, run};

#[test]
fn a_pin_is_rolled_between_two_fingertips_and_both_feel_it() {
    let scene = Draft::of("opposed-pads.toml").scene();
    let kept = run(&scene, 1);
    let features = kept.of::<Features>("tactile_servo.features");
    let turns = |row: Option<&(_, Features)>| row.map_or(0, |row| row.1.reversals);
    assert!(turns(features.last()) >= 2, "{} reversals", turns(features.last()));

    let settled = |t_ns: i64| t_ns > 6_000_000_000;
    let tips = kept.of::<OpposedTruth>("world.opposed");
    let tips: Vec<_> = tips.iter().map(|(_, tip)| tip).filter(|tip| settled(tip.t_ns)).collect();
    let truth = kept.of::<WorldTruth>("world.truth");
    let truth: Vec<_> = truth.iter().map(|(_, truth)| truth).filter(|t| settled(t.t_ns)).collect();
    assert!(truth.iter().all(|truth| truth.in_contact == 1), "lost by the finger");
    assert!(tips.iter().all(|tip| tip.normal_n > 0.0), "lost by the other");
    let columns = |of: &dyn Fn(&f64) -> bool| tips.iter().map(|t| t.contact_x).filter(of).count();
    assert!(columns(&|x| *x < 7.0) > 100 && columns(&|x| *x > 10.0) > 100, "it rolls to and fro");

    // What its sensor says is the force there is, without the pin's weight, which its rest level
    // holds, and without what 3 mm of rubber carry off beside the array: a twentieth.
    let images = kept.of::<TactileImage>("opposed_scan.image");
    let sums = images.iter().filter(|(_, image)| settled(image.acquired_ns));
    let sums: Vec<f64> =
        sums.map(|(_, image)| image.counts.iter().map(|count| f64::from(*count)).sum()).collect();
    #[expect(clippy::cast_precision_loss, reason = "counts of samples")]
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(sums.len() > 700, "{} images", sums.len());
    let weight_n = kept.of::<OpposedTruth>("world.opposed")[0].1.normal_n;
    let due_n = mean(&tips.iter().map(|tip| tip.normal_n).collect::<Vec<_>>()) - weight_n;
    let share = mean(&sums) * 4.0 / 4095.0 / due_n;
    assert!((0.9..1.0).contains(&share), "{share} of {due_n} N");
}
