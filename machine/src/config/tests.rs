//! What a machine file may say about lanes, and the tasks that are inserted into them.

use taktil_rtcore::GuardCondition;

use super::*;

fn spec(more: &str) -> Result<LaneSpec, Invalid> {
    let text = format!("period_us = 2500\npriority = 80\ntasks = []\n{more}");
    let lane: LaneConfig = toml::from_str(&text).unwrap();
    lane.spec("servo").and_then(|spec| spec.check().map(|()| spec))
}

#[test]
fn a_lane_says_what_it_does_about_lateness() {
    let plain = spec("").unwrap();
    assert_eq!(
        (plain.late, plain.misses),
        (LatePolicy::Skip, LeakyBucket { capacity: 5, leak_jobs: 100 })
    );
    assert_eq!(plain.silent_after, Nanos::from_millis(50));
    let own = spec(
        "late_policy = \"catch_up\"\ncatch_up_max = 9\nmisses = { bucket = 2, leak_jobs = 7 }\n\
         stall_limit_us = 5000",
    )
    .unwrap();
    assert_eq!(own.late, LatePolicy::CatchUp { at_most: 9 });
    assert_eq!((own.misses.capacity, own.misses.leak_jobs), (2, 7));
    assert_eq!(own.silent_after, Nanos::from_millis(5));
    assert_eq!(
        spec("late_policy = \"catch_up\"").unwrap().late,
        LatePolicy::CatchUp { at_most: 4 }
    );
    assert_eq!(spec("late_policy = \"fault\"").unwrap().late, LatePolicy::Fault);
}

#[test]
fn lateness_that_cannot_be_meant_is_refused_with_its_place() {
    for (line, place) in [
        ("late_policy = \"catch_up\"\ncatch_up_max = 0", "catch_up_max"),
        ("late_policy = \"catch_up\"\ncatch_up_max = 1001", "catch_up_max"),
        ("catch_up_max = 3", "catch_up_max"),
        ("late_policy = \"fault\"\ncatch_up_max = 3", "catch_up_max"),
        ("misses = { bucket = 0 }", "misses.bucket"),
        ("misses = { leak_jobs = 4000000000 }", "misses.leak_jobs"),
        ("stall_limit_us = 4999", "stall_limit_us"),
        ("stall_limit_us = -1", "stall_limit_us"),
        ("stall_limit_us = 9223372036854775807", "stall_limit_us"),
    ] {
        assert_eq!(spec(line).unwrap_err().place, place, "{line}");
    }
    for line in ["late_policy = \"never\"", "catch_up_max = -1", "misses = { buckets = 5 }"] {
        let text = format!("period_us = 2500\npriority = 80\ntasks = []\n{line}");
        assert!(toml::from_str::<LaneConfig>(&text).is_err(), "{line}");
    }
}

#[test]
fn a_guard_is_asked_for_refused_or_left_to_the_schedule() {
    let guard = |lines| spec(lines).unwrap().guard.map(|guard| (guard.spin_max, guard.given));
    assert_eq!(guard(""), None);
    assert_eq!(guard("cpu = 1"), Some((Nanos::from_micros(500), GuardCondition::WhenSchedulable)));
    assert_eq!(guard("cpu = 1\nguard = { cpu_share_max = 0 }"), None);
    let asked = Some((Nanos::from_micros(500), GuardCondition::Always));
    assert_eq!(guard("guard = { cpu_share_max = 0.2 }"), asked);
    for bad in ["0.51", "-0.1", "nan", "inf"] {
        let refused = spec(&format!("guard = {{ cpu_share_max = {bad} }}")).unwrap_err();
        assert_eq!(refused.place, "guard.cpu_share_max", "{bad}");
    }
}

#[test]
fn a_lane_has_a_priority_or_is_scheduled_by_deadline() {
    let spec = |lines: &str| {
        let text = format!("period_us = 2500\ntasks = []\n{lines}");
        toml::from_str::<LaneConfig>(&text).unwrap().spec("servo")
    };
    assert_eq!(spec("priority = 80").unwrap().policy, Policy::Fifo);
    assert_eq!(spec("priority = 80\npolicy = \"fifo\"").unwrap().priority, 80);
    assert_eq!(spec("policy = \"deadline\"").unwrap().policy, Policy::Deadline);
    for lines in ["", "priority = 256", "priority = 9\npolicy = \"deadline\""] {
        assert_eq!(spec(lines).unwrap_err().place, "priority", "{lines}");
    }
    let other = "period_us = 2500\ntasks = []\npolicy = \"rr\"";
    assert!(toml::from_str::<LaneConfig>(other).is_err());
}

const LANES: &str = "
    [lane.servo]
    period_us = 2500
    priority = 80
    tasks = [\"sense\", \"setpoint\"]
    budget_us = { sense = 10, setpoint = 20 }
    [lane.touch]
    period_us = 5000
    priority = 79
    tasks = [\"tactile_scan\"]
";

fn inserted(section: &str) -> Result<MachineConfig, Invalid> {
    let text = format!("{LANES}\n[insert]\n{section}");
    toml::from_str::<MachineConfig>(&text).unwrap().with_insertions()
}

#[test]
fn a_task_that_is_inserted_runs_next_to_the_one_that_is_named() {
    let machine = inserted(
        "sway = { lane = \"servo\", before = \"setpoint\", budget_us = 5 }
         watch = { lane = \"touch\", after = \"tactile_scan\" }",
    )
    .unwrap();
    assert_eq!(machine.lane["servo"].tasks, ["sense", "sway", "setpoint"]);
    assert_eq!(machine.lane["servo"].budget_us["sway"], 5);
    assert_eq!(machine.lane["touch"].tasks, ["tactile_scan", "watch"]);
    assert!(machine.lane["touch"].budget_us.is_empty() && machine.insert.is_empty());
}

#[test]
fn an_insertion_without_a_place_is_refused_with_the_key_that_says_so() {
    for (section, place, says) in [
        ("sway = { lane = \"sero\", before = \"sense\" }", "insert.sway.lane", "`sero`"),
        ("sway = { lane = \"servo\", after = \"sens\" }", "insert.sway.after", "`sens`"),
        ("sway = { lane = \"servo\" }", "insert.sway", "one of `before` and `after`"),
        (
            "sway = { lane = \"servo\", before = \"sense\", after = \"sense\" }",
            "insert.sway",
            "one of `before` and `after`",
        ),
        ("sway = { lane = \"servo\", before = \"sense\" }", "insert.sway", "no budget"),
        ("sense = { lane = \"touch\", before = \"sense\" }", "insert.sense", "already"),
    ] {
        let bad = inserted(section).unwrap_err();
        assert_eq!(bad.place, place, "{section}");
        assert!(bad.what.contains(says), "{section}: {bad}");
    }
}
