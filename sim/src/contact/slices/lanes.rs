//! Sums over the slices of a block, in the order of a vectorised sum.

/// Number of slices that are computed together in one block.
pub(super) const LANE_COUNT: usize = 8;

pub(super) type Lanes = [f64; LANE_COUNT];

/// The sums of `w`, `w s` and `w s^2`.
#[inline(always)]
pub(super) fn moments(w: &Lanes, s: &Lanes) -> [f64; 3] {
    let first = products(w, s);
    [sum(w), sum(&first), sum(&products(&first, s))]
}

/// The products of `a` and `b`.
#[inline(always)]
pub(super) fn products(a: &Lanes, b: &Lanes) -> Lanes {
    let mut product = [0.0; LANE_COUNT];
    for i in 0..LANE_COUNT {
        product[i] = a[i] * b[i];
    }
    product
}

/// Adds the halves of the block first, which is the order of a vectorised sum.
#[inline(always)]
pub(super) fn sum(w: &Lanes) -> f64 {
    let mut halves = [0.0; LANE_COUNT / 2];
    for i in 0..LANE_COUNT / 2 {
        halves[i] = w[i] + w[i + LANE_COUNT / 2];
    }
    let mut quarters = [0.0; LANE_COUNT / 4];
    for i in 0..LANE_COUNT / 4 {
        quarters[i] = halves[i] + halves[i + LANE_COUNT / 4];
    }
    quarters[0] + quarters[1]
}
