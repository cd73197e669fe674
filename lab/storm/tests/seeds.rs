//! Storms of a few seeds: the production code breaks no rule, a seed is a run bit for bit, and a
//! plan that is given takes the place of the drawn one.

use std::collections::BTreeMap;

use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;
use taktil_lab_storm::campaign::StormPlan;
use taktil_lab_storm::case::{Campaign, Scenes};
use taktil_lab_storm::check::PathPoint;
use taktil_lab_storm::run::run;
use taktil_rtcore::{FaultCode, Mode};
use taktil_signal::State;

fn storm(campaign: Campaign, jobs: usize) -> StormPlan {
    let scenes = Scenes::built_in().unwrap();
    StormPlan { scenes, campaign, plan: None, length: None, jobs }
}

#[test]
fn a_few_seeds_of_each_campaign_break_no_rule_and_repeat_bit_for_bit() {
    for campaign in [Campaign::Recoverable, Campaign::Anything] {
        let seeds: Vec<u64> = (0..4).collect();
        let batch = storm(campaign, 2).run_batch(&seeds);
        assert!(batch.failures.is_empty(), "{:?}", batch.failures);
        let alone = storm(campaign, 1).run_batch(&seeds);
        assert_eq!((batch.digest(), batch.digests), (alone.digest(), alone.digests));
    }
}

#[test]
fn a_law_of_touch_may_begin_with_the_first_frame_after_a_silence() {
    // An operator asks for it in the job of the servo lane behind the one that brought the frame.
    let outcome = run(&storm(Campaign::Anything, 1).case(501_287)).unwrap();
    assert_eq!(outcome.violations, []);
    let stale = FaultCode::TactileStale as u32;
    let begins = |point: &&PathPoint| point.state == State::TactileServo;
    let begin = outcome.path.iter().find(begins).unwrap();
    assert_eq!(begin.first_fault, stale, "{begin:?}");
}

#[test]
fn storms_spend_their_time_in_every_state_and_roll_the_pin() {
    let mut spent: BTreeMap<String, Nanos> = BTreeMap::new();
    let storm = storm(Campaign::Recoverable, 1);
    for seed in 0..24 {
        let outcome = run(&storm.case(seed)).unwrap();
        let ends = outcome.path.iter().skip(1).map(|point| point.at).chain([outcome.length]);
        for (point, end) in outcome.path.iter().zip(ends) {
            *spent.entry(format!("{:?}", point.state)).or_default() += end - point.at;
        }
    }
    let all: Nanos = spent.values().fold(Nanos::ZERO, |sum, part| sum + *part);
    let share = |state: &str| {
        let part = spent.get(state).copied().unwrap_or(Nanos::ZERO);
        part.0 as f64 / all.0 as f64
    };
    for state in ["ManualJoint", "ManualCartesian", "Trajectory", "TrajectoryUser", "TactileServo"]
    {
        assert!(share(state) > 0.01, "{state}: {spent:?}");
    }
    assert!(share("TactileServo") > 0.03, "{spent:?}");
}

/// What comes of a case with these faults instead of drawn ones: modes and first faults after the
/// first fault has begun.
fn with_fault(text: &str) -> Vec<(Mode, u32)> {
    let mut storm = storm(Campaign::Recoverable, 1);
    storm.plan = Some(FaultPlan::new(vec![text.parse().unwrap()]));
    storm.length = Some(Nanos::from_secs(2));
    let case = storm.case(3);
    let outcome = run(&case).unwrap();
    assert_eq!(outcome.violations, [], "{text}");
    let at = case.plan.faults()[0].at;
    let after = outcome.path.iter().filter(|point| point.at >= at);
    after.map(|point| (point.mode, point.first_fault)).collect()
}

#[test]
fn faults_of_every_room_are_acted_on_and_the_machine_comes_back() {
    for (text, fault) in [
        ("kind=jump target=encoders.2 at=1 for=0.1 value=5000", FaultCode::EncoderJump),
        ("kind=unplugged target=encoders at=1 for=0.1", FaultCode::EncoderLost),
        ("kind=failing target=analog_out at=1 for=0.1 value=1", FaultCode::AnalogOutLost),
        ("kind=unplugged target=digital_out at=1 for=0.1", FaultCode::DigitalLost),
        ("kind=dead target=digital_in.3 at=1 for=0.1", FaultCode::EmergencyStop),
        ("kind=dead target=digital_in.1 at=1 for=0.1", FaultCode::DrivePowerLost),
        ("kind=overrun target=lane.servo at=1 for=0.1 value=0.004", FaultCode::OverrunStorm),
        ("kind=silence target=lane.touch at=1 for=0.3", FaultCode::LaneSilent),
        ("kind=clock_gap target=clock at=1 value=0.07", FaultCode::LaneSilent),
        ("kind=not_finite target=task.joint_servo at=1 for=0.02", FaultCode::NotFinite),
    ] {
        let path = with_fault(text);
        assert!(path.iter().any(|point| point.1 == fault as u32), "{text}: {path:?}");
        assert_eq!(path.last(), Some(&(Mode::Moving, 0)), "{text}");
    }
}
