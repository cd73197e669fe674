//! The end loss of a row of strips of constant pressure: the distance, in strip lengths, by which
//! the strips place the end of the pin too far inwards. Slices are laid out so that this distance
//! is compensated. It follows from a plane punch on the layer, whose force is known both exactly
//! and by strips.

use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Transfer;
use super::coupling::strip_row;
use super::strip::punch_force;
use crate::numeric::cholesky::{factor, solve};

/// Number of strips that stand for the punch.
const PUNCH_STRIPS: usize = 16;

/// Loss at each end of a row of strips of length `h` thicknesses, in strips.
pub(super) fn end_loss(transfer: &Transfer, kernel: &SurfaceKernel, h: f64) -> f64 {
    let row = strip_row(transfer, h, PUNCH_STRIPS - 1);
    let mut matrix = vec![0.0; PUNCH_STRIPS * PUNCH_STRIPS];
    for i in 0..PUNCH_STRIPS {
        for j in 0..=i {
            matrix[i * PUNCH_STRIPS + j] = row[i - j];
        }
    }
    let mut pressure = vec![1.0; PUNCH_STRIPS];
    if !factor(&mut matrix, PUNCH_STRIPS) {
        return 0.0;
    }
    solve(&matrix, PUNCH_STRIPS, &mut pressure);
    let force = h * pressure.iter().sum::<f64>();
    let half = |loss: f64| 0.5 * h * (PUNCH_STRIPS as f64 - 2.0 * loss);
    let [none, some] = [0.0, 0.2].map(|loss| punch_force(kernel, half(loss)));
    (0.2 * (force - none) / (some - none)).clamp(0.0, 0.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For short strips the loss tends to that of the logarithmic kernel; the layer changes it for
    /// longer ones.
    #[test]
    fn short_strips_follow_the_logarithmic_end_loss_and_long_ones_lose_less() {
        for nu in [-0.5, 0.0, 0.3, 0.49, 0.5] {
            let transfer = Transfer::new(nu);
            let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
            let found = end_loss(&transfer, &kernel, 0.01);
            assert!((found - 0.1135).abs() < 5e-4, "{nu}: {found}");
            let longer = [0.1, 0.3, 0.6, 0.8, 1.0].map(|h| end_loss(&transfer, &kernel, h));
            assert!(
                longer[..3].is_sorted_by(|a, b| a > b) && longer[0] < found,
                "{nu}: {longer:?}"
            );
            assert!(longer[3..].iter().all(|loss| (0.03..0.1).contains(loss)), "{nu}: {longer:?}");
        }
    }
}
