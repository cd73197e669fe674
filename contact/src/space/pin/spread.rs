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

/// Slices longer than this (thicknesses) stand between their middles, too, near ends, where their
/// stand counts beside what they leave over; up to the first distance from an end (thicknesses)
/// with all of it, from there to the second less and less.
pub(super) const LONG: f64 = 0.5;
const NEAR_END: [f64; 2] = [4.5, 9.5];
/// Elsewhere those are whose wave number is not so much above the one that an image is made for.
const ABOVE: f64 = 1.6;
/// Neighbours whose half-widths (thicknesses) are no further apart share their points.
const NEAR: f64 = 0.1;

/// Parts of a slice's force on its middle, between it and each neighbour's, and on each of those:
/// the triangle's moments up to the third. With nothing between them (`halved` is 0) loads are a
/// slice apart, and the base feels the wave of that length where slices are long; `halved` (1) they
/// are half as far apart, neither half has more of the force than the other, and that wave is gone.
fn stand(halved: f64) -> [f64; 3] {
    [5.0 / 6.0 - 0.375 * halved, 0.25 * halved, 1.0 / 12.0 - 0.0625 * halved]
}

/// Places along at which a slice at `v` of length `h` stands near an end, and the parts of its
/// force there.
pub(super) fn stood(v: f64, h: f64) -> [(f64, f64); 5] {
    let [own, between, beside] = stand(if h > LONG { 1.0 } else { 0.0 });
    let half = 0.5 * h;
    [(v, own), (v - half, between), (v + half, between), (v - h, beside), (v + h, beside)]
}

/// Part of the wave numbers that an image of what is left over needs.
const COARSER: f64 = 0.7;

impl Row {
    /// Whether the points of a contact up to a wave number (times thickness) stand between slices,
    /// too, away from ends.
    pub(super) fn halved(&self, cutoff: f64) -> bool {
        self.h > LONG && 2.0 * PI / self.h < cutoff + ABOVE
    }

    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact up to a wave number (times thickness), slice after slice. Left out is what is not
    /// `seen`: its middle along the axis and its reach about that, mm.
    pub(super) fn spread_loads(
        &self,
        cutoff: f64,
        seen: impl Fn([f64; 2]) -> bool,
        mut of: impl FnMut([f64; 2], f64),
    ) {
        let (t, n) = (self.layer.thickness_mm, self.work.places.cosines);
        let mut room = [[0.0; COSINES_MAX]; 2];
        let [sum, joint] = room.each_mut().map(|room| &mut room[..n]);
        let slices = self.along.len();
        let everywhere = self.halved(cutoff);
        let stands = |j: usize| {
            let away = j.min(slices - 1 - j) as f64 * self.h;
            let [all, none] = NEAR_END;
            stand(match self.h > LONG {
                true if everywhere || away < all => 1.0,
                true if away < none => 0.5 + 0.5 * libm::cos(PI * (away - all) / (none - all)),
                _ => 0.0,
            })
        };
        for j in (0..slices).filter(|j| self.work.touches(*j)) {
            let (b, own) = self.work.slice(j);
            if !seen([self.along[j] * t, (b + self.h) * t]) {
                continue;
            }
            let [middle, between, beside] = stands(j);
            sum.iter_mut().zip(own).for_each(|(sum, a)| *sum = middle * a);
            let sides = [(j.checked_sub(1), -self.h), ((j + 1 < slices).then_some(j + 1), self.h)];
            for (neighbour, away) in sides {
                let touching = neighbour.filter(|i| self.work.touches(*i));
                let near = |i: &usize| (self.work.slice(*i).0 - b).abs() < NEAR;
                let place = self.along[j] + 0.5 * away;
                let Some(i) = touching.filter(near) else {
                    self.points((b, self.along[j] + away), (own, beside), cutoff, &mut of);
                    if between > 0.0 {
                        self.points((b, place), (own, between), cutoff, &mut of);
                    }
                    continue;
                };
                let ((width, a), [_, half, part]) = (self.work.slice(i), stands(i));
                sum.iter_mut().zip(a).for_each(|(sum, a)| *sum += part * a);
                // What is between two stands there once.
                if i > j && between + half > 0.0 {
                    let both = own.iter().zip(a).map(|(own, a)| between * own + half * a);
                    joint.iter_mut().zip(both).for_each(|(joint, both)| *joint = both);
                    self.points((0.5 * (b + width), place), (joint, 1.0), cutoff, &mut of);
                }
            }
            self.points((b, self.along[j]), (sum, 1.0), cutoff, &mut of);
        }
        // It is small, and fewer points do.
        self.left_over(|place, cosines| {
            self.points(place, (cosines, 1.0 / self.h), COARSER * cutoff, &mut of);
        });
    }

    /// Calls with the points of a part of some cosines at a half-width and a place, which stand for
    /// it up to a wave number.
    fn points(
        &self,
        (b, v): (f64, f64),
        (a, part): (&[f64], f64),
        cutoff: f64,
        of: &mut impl FnMut([f64; 2], f64),
    ) {
        let t = self.layer.thickness_mm;
        let least = self.work.places.cosines / 2 + 1;
        let points = points_for(cutoff, b).max(least).min(self.rules.len());
        let scale = part * 0.5 * PI * self.modulus_mpa() * t * t * self.h / points as f64;
        let mut psi = [0.0; POINTS_MAX];
        for (place, psi) in self.rules[points - 1].at(a, &mut psi) {
            let (u, force) = (b * place * t, scale * psi);
            of([u, v * t], force);
            of([-u, v * t], force);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::Drive;
    use super::super::super::radial::Influence;
    use super::super::super::tactels::{Array, Fineness, Sampling, Shares};
    use super::super::{Pin, Profile, Stand};
    use crate::Accuracy;

    /// The image by fewer points, without what is far off the tactels, against that by all.
    #[test]
    fn large_tactels_need_fewer_points() {
        let mut fewest = 1.0_f64;
        for (t, nu, radius_mm, pitch_mm) in [
            (0.3, 0.5, 45.0, 1.5875),
            (0.8, 0.45, 45.0, 1.5875),
            (2.0, 0.49, 45.0, 1.5875),
            (0.8, 0.3, 10.0, 0.4),
            (2.0, 0.49, 10.0, 0.5),
        ] {
            let layer = Layer::new(t, 27.58, nu).expect("a sound layer");
            let influence = Influence::new(&layer).expect("a layer");
            let array = Array { rows: 16, cols: 16, pitch_mm };
            let shares = Shares::new(&influence, &array, Sampling::Area, Fineness::DEFAULT);
            let shares = shares.expect("tables");
            let profile = Profile::Cylinder { radius_mm };
            let half = 8.0 * pitch_mm + 15.0 * t;
            let made = Pin::new(&layer, profile, [-half, 0.3 * half], 0.25 * t, Accuracy::Default);
            let mut pin = made.expect("a pin");
            pin.press(Drive::PenetrationMm(0.2 * t), 0.0).expect("a contact");
            let stand = Stand { x_mm: 0.1, y_mm: -0.2, rot_rad: 0.3 };
            let (s, c) = (libm::sin(stand.rot_rad), libm::cos(stand.rot_rad));
            let (mut image, mut exact) = (vec![0.0; 256], vec![0.0; 256]);
            let (mut seen, mut all) = (0, 0);
            pin.image(&shares, stand, &mut image);
            pin.seen_loads(&shares, stand, |_, _| seen += 1);
            pin.loads(|[u, v], force| {
                let place = [stand.x_mm + u * c - v * s, stand.y_mm + u * s + v * c];
                shares.add(&mut exact, place, force);
                all += 1;
            });
            let peak = exact.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            for (a, b) in image.iter().zip(&exact) {
                assert!((a - b).abs() < 1.5e-4 * peak, "{t} {pitch_mm}: {a} {b}");
            }
            fewest = fewest.min(f64::from(seen) / f64::from(all));
        }
        assert!(fewest < 0.75, "{fewest}");
    }
}
