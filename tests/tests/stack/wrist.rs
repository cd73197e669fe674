//! The wrist in a lane of its own at 1 kHz, and A/D channels as a signal beside it.

use taktil_lab_world::WorldTruth;
use taktil_rtcore::Nanos;
use taktil_signal::{AnalogInputs, Applied, Wrench};
use taktil_tests::bench::{SceneDraft, run};

#[test]
fn the_wrist_at_1_khz_feels_the_force_on_the_pin() {
    let scene = SceneDraft::of("wrist-1khz.toml").set("duration_s", 3.0).scene();
    let kept = run(&scene, 1);
    let wrenches = kept.of::<Wrench>("wrist_scan.wrench");
    let settled = |at: &Nanos| *at > Nanos::from_millis(2_000);
    let settled: Vec<_> = wrenches.iter().filter(|(at, _)| settled(at)).collect();
    // The simulated gauges are converted with the servo's boards, at 400 Hz: between two of their
    // readings nothing new is written.
    assert!((390..=410).contains(&settled.len()), "{} wrenches a second", settled.len());
    let truth = kept.of::<WorldTruth>("world.truth");
    for (at, wrench) in settled.iter().step_by(40) {
        let (_, truth) = truth.iter().rev().find(|(then, _)| then < at).unwrap();
        let off = wrench.force_n[2] + truth.finger_normal_n;
        assert!(off.abs() < 1.5, "{off} N off at {at}");
    }
}

#[test]
fn codes_of_a_board_are_a_signal_that_logs_see() {
    let scene = SceneDraft::of("roll-pin.toml")
        .set("duration_s", 1.0)
        .set("robot.lane.currents.period_us", 2_500)
        .set("robot.lane.currents.priority", 60)
        .set("robot.lane.currents.tasks", vec!["analog_scan"])
        .set("robot.analog_scan.scale_per_code", vec![0.5; 6])
        .scene();
    let kept = run(&scene, 1);
    let inputs = kept.of::<AnalogInputs>("analog_scan.values");
    let (_, last) = inputs.last().unwrap();
    assert_eq!((last.codes.len(), last.values.len()), (6, 6));
    assert!((last.values[1] - 0.5 * f64::from(last.codes[1])).abs() < 1e-12);
    // The simulated amplifiers report the current that they were told to give.
    let told = kept.of::<Applied>("actuate.applied");
    assert!(told.iter().any(|(_, word)| word.dac[..6] == last.codes[..]), "{:?}", last.codes);
}
