//! The column to which the contact is moved, alternately one of two turning points. An image
//! without a centroid never reverses the direction.

use taktil_rtcore::{Fold, StateHash};

use crate::config::Config;

/// The motion of the centroid to and fro between two columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    low: f64,
    high: f64,
    tolerance: f64,
    upwards: bool,
    reversals: u32,
}

impl Fold for Heading {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.upwards).add(&self.reversals);
    }
}

impl Heading {
    /// Heads for the lower column first.
    #[must_use]
    pub fn new(config: &Config) -> Heading {
        Heading {
            low: config.x_c_low,
            high: config.x_c_high,
            tolerance: config.x_c_tolerance,
            upwards: false,
            reversals: 0,
        }
    }

    /// The column headed for.
    #[must_use]
    pub fn x_c(&self) -> f64 {
        if self.upwards { self.high } else { self.low }
    }

    /// Number of reversals so far.
    #[must_use]
    pub fn reversals(&self) -> u32 {
        self.reversals
    }

    /// Reverses the direction when the centroid is within the tolerance of the column that it moves
    /// to.
    pub fn update(&mut self, x_c: Option<f64>) {
        if x_c.is_some_and(|x_c| (x_c - self.x_c()).abs() < self.tolerance) {
            self.upwards = !self.upwards;
            self.reversals = self.reversals.wrapping_add(1);
        }
    }
}
