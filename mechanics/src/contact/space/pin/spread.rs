//! The point loads that stand for slices where an image has to be right to a part in a thousand.
//! Slices act on each other by their means: what presses is felt as if it were spread over a slice,
//! and once more what it is felt by. So the pressure that their forces stand for is each force
//! spread twice over a slice's length, a triangle of two lengths; in the middle of its slice it
//! would put the ends of a pin off by the square of the length. A part of each force on the middles
//! of its neighbours has the triangle's moments. It refuses nothing.

use super::lines::POINTS_MAX;
use super::row::{Row, points_for};
use super::strip::COSINES_MAX;
use core::f64::consts::PI;

/// Part of a slice's force that stands on each of its neighbours' middles.
const SPREAD: f64 = 1.0 / 12.0;
/// Neighbours whose half-widths (thicknesses) are no further apart share their points.
const NEAR: f64 = 0.1;

/// Places along at which a slice at `v` of length `h` stands, and the parts of its force there.
pub(super) fn stood(v: f64, h: f64) -> [(f64, f64); 3] {
    [(v, 1.0 - 2.0 * SPREAD), (v - h, SPREAD), (v + h, SPREAD)]
}

/// Part of the level's wave numbers that an image of what is left over needs.
const COARSER: f64 = 0.7;

impl Row {
    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact, slice after slice.
    pub(super) fn spread_loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let n = self.work.places.cosines;
        let mut sum = [0.0; COSINES_MAX];
        let sum = &mut sum[..n];
        let slices = self.along.len();
        for j in (0..slices).filter(|j| self.work.touches(*j)) {
            let (b, own) = self.work.slice(j);
            sum.iter_mut().zip(own).for_each(|(sum, a)| *sum = (1.0 - 2.0 * SPREAD) * a);
            let sides = [(j.checked_sub(1), -self.h), ((j + 1 < slices).then_some(j + 1), self.h)];
            for (beside, away) in sides {
                let touching = beside.filter(|i| self.work.touches(*i));
                let other = touching.map(|i| self.work.slice(i));
                match other.filter(|(width, _)| (width - b).abs() < NEAR) {
                    Some((_, a)) => sum.iter_mut().zip(a).for_each(|(sum, a)| *sum += SPREAD * a),
                    None => self.points((b, self.along[j] + away), (own, SPREAD), 1.0, &mut of),
                }
            }
            self.points((b, self.along[j]), (sum, 1.0), 1.0, &mut of);
        }
        // It is small, and fewer points do.
        self.left_over(|place, cosines| {
            self.points(place, (cosines, 1.0 / self.h), COARSER, &mut of);
        });
    }

    /// Calls with the points of a part of some cosines at a half-width and a place, for a part of
    /// the level's wave numbers.
    fn points(
        &self,
        (b, v): (f64, f64),
        (a, part): (&[f64], f64),
        coarser: f64,
        of: &mut impl FnMut([f64; 2], f64),
    ) {
        let t = self.layer.thickness_mm;
        let least = self.work.places.cosines / 2 + 1;
        let points = points_for(coarser * self.fineness.points, b).max(least).min(self.rules.len());
        let scale = part * 0.5 * PI * self.modulus_mpa() * t * t * self.h / points as f64;
        let mut psi = [0.0; POINTS_MAX];
        for (place, psi) in self.rules[points - 1].at(a, &mut psi) {
            let (u, force) = (b * place * t, scale * psi);
            of([u, v * t], force);
            of([-u, v * t], force);
        }
    }
}
