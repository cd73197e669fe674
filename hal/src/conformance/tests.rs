//! Tests of the suite itself: correct halves pass, and each deliberately broken half is rejected by
//! the rule that it breaks.

mod drives;
mod inputs;
mod outputs;

use super::Violation;

/// The rules that were broken, in the order found.
fn rules(found: &[Violation]) -> Vec<&'static str> {
    found.iter().map(|violation| violation.rule).collect()
}

#[test]
fn a_violation_reads_as_rule_and_text() {
    let violation = Violation { rule: "delivers", text: "not one reading".to_owned() };
    assert_eq!(violation.to_string(), "delivers: not one reading");
}

#[test]
#[should_panic(expected = "positive period")]
fn a_bench_without_a_period_is_refused() {
    let _ = super::CycleDriver::new(crate::Nanos::ZERO, crate::Nanos::ZERO, |_| {});
}
