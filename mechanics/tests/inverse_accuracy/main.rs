//! Tests the accuracy of the closed-form inverse kinematics at random poses and at and beside
//! singularities, on a part of the poses that `cargo run --profile dist -p taktil-mechanics
//! --example inverse_accuracy` shows a million of.

mod statistics;

use statistics::{Statistics, near_singular, random, through_the_wrist};

fn is_complete(statistics: &Statistics) -> bool {
    (statistics.missing, statistics.duplicates, statistics.not_found, statistics.not_finite)
        == (0, 0, 0, 0)
}

#[test]
fn random_poses_are_within_the_bounds() {
    let statistics = random(20_000, 51);
    assert!(
        is_complete(&statistics)
            && statistics.position_error_m <= 1e-14
            && statistics.orientation_error_rad <= 1e-14,
        "{statistics:?}"
    );
}

#[test]
fn poses_beside_singularities_are_within_the_bounds() {
    let statistics = near_singular(10_000, 52);
    assert!(
        is_complete(&statistics)
            && statistics.position_error_m <= 1e-12
            && statistics.orientation_error_rad <= 1e-9,
        "{statistics:?}"
    );
    assert!(
        statistics.position_error_m <= 1e-14 && statistics.orientation_error_rad <= 2e-11,
        "as far as it is known: {statistics:?}"
    );
}

#[test]
fn no_branch_is_lost_or_doubled_on_the_way_into_the_wrist() {
    let statistics = through_the_wrist(50, 200, 53);
    assert!(is_complete(&statistics) && statistics.poses == 50 * 201, "{statistics:?}");
}
