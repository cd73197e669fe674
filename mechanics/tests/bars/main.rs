//! A share of what `cargo run --release -p taktil-mechanics --example inverse_bars` shows for a
//! million poses: every branch, to rounding, at and beside singularities.

mod checks;

use checks::{Tally, near_singular, random, through_the_wrist};

fn whole(tally: &Tally) -> bool {
    (tally.short, tally.doubles, tally.lost, tally.not_finite) == (0, 0, 0, 0)
}

#[test]
fn random_poses_keep_the_bars() {
    let tally = random(20_000, 51);
    assert!(whole(&tally) && tally.off_m <= 1e-14 && tally.off_rad <= 1e-14, "{tally:?}");
}

#[test]
fn poses_beside_singularities_keep_the_bars() {
    let tally = near_singular(10_000, 52);
    assert!(whole(&tally) && tally.off_m <= 1e-12 && tally.off_rad <= 1e-9, "{tally:?}");
    assert!(tally.off_m <= 1e-14 && tally.off_rad <= 2e-11, "as far as it is known: {tally:?}");
}

#[test]
fn no_branch_is_lost_or_doubled_on_the_way_into_the_wrist() {
    let tally = through_the_wrist(50, 200, 53);
    assert!(whole(&tally) && tally.poses == 50 * 201, "{tally:?}");
}
