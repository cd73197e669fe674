//! The point loads that stand for a contact in the image of the fast level: lines across the pin, a
//! distance apart along it. Neighbouring lines hold every other point of a rule, one the ones that
//! the other leaves out, so that half of the points keep out as much of what the base would see of
//! their spacing. A slice's force stands in them as the slices feel it ([`super::spread`]): a
//! triangle of two lengths, put on the lines by weights that keep its moments. It refuses nothing.

use super::row::{Row, points_for};
use super::strip::COSINES_MAX;
use core::f64::consts::PI;

/// Most points across half a line.
pub(super) const POINTS_MAX: usize = 96;
/// Distance of two lines, times the wave number up to which they stand for the pressure.
const APART: f64 = 3.6;
/// Largest tactel (thicknesses) that sees as much as a point of the base does.
const POINT: f64 = 0.26;
/// Least wave number (times thickness) of an image's points.
const COARSEST: f64 = 3.0;
/// So far (thicknesses) from the ends of what touches lines hold all points.
const EDGE: f64 = 0.8;
/// Lines of two slices may be so many times as far apart.
const LONGER: f64 = 1.15;
/// Fewest lines of two slices each.
const FEWEST: usize = 24;

/// How lines lie among slices: their places in slices from the middle of one, how many slices on
/// there are as many again, and what a slice so many further leaves on the line.
struct Lay {
    step: usize,
    lines: &'static [(f64, &'static [(isize, f64)])],
    /// Slices beyond the ends of what touches that have lines.
    beyond: isize,
}

impl Lay {
    /// Distance of neighbouring lines among slices of a length.
    fn apart(&self, h: f64) -> f64 {
        h * self.step as f64 / self.lines.len() as f64
    }
}

/// A line for each slice.
const EACH: Lay = Lay {
    step: 1,
    lines: &[(0.0, &[(-1, 1.0 / 12.0), (0, 10.0 / 12.0), (1, 1.0 / 12.0)])],
    beyond: 1,
};
/// Two lines in each slice.
const HALVES: Lay = Lay {
    step: 1,
    lines: &[
        (-0.25, &[(0, 19.0 / 48.0), (-1, 5.0 / 48.0)]),
        (0.25, &[(0, 19.0 / 48.0), (1, 5.0 / 48.0)]),
    ],
    beyond: 1,
};
/// A line for two slices, by cubics.
const PAIRS: Lay = Lay {
    step: 2,
    lines: &[(
        0.0,
        &[
            (-3, -5.0 / 96.0),
            (-2, 1.0 / 48.0),
            (-1, 53.0 / 96.0),
            (0, 23.0 / 24.0),
            (1, 53.0 / 96.0),
            (2, 1.0 / 48.0),
            (3, -5.0 / 96.0),
        ],
    )],
    beyond: 3,
};

/// Points across half a strip, and cos(2 k theta) at them.
#[derive(Clone, Debug)]
pub(super) struct Rule {
    /// cos(theta), from the edge inwards.
    places: Vec<f64>,
    /// Of the outer half of them, k after k; the inner ones mirror these, every other k turned.
    cosines: Vec<f64>,
}

impl Rule {
    pub(super) fn new(points: usize, cosines: usize) -> Self {
        let angle = |i: usize| PI * (2 * i + 1) as f64 / (4 * points) as f64;
        let outer = points.div_ceil(2);
        let of = |k: usize| (0..outer).map(move |i| libm::cos(2.0 * k as f64 * angle(i)));
        Self {
            places: (0..points).map(|i| libm::cos(angle(i))).collect(),
            cosines: (0..cosines).flat_map(of).collect(),
        }
    }

    /// Places of the points, over the half-width, and sums of some cosines at them, from the edge
    /// inwards.
    pub(super) fn at<'a>(
        &'a self,
        a: &[f64],
        out: &'a mut [f64; POINTS_MAX],
    ) -> impl Iterator<Item = (f64, f64)> + 'a {
        let (points, outer) = (self.places.len(), self.places.len().div_ceil(2));
        let mut odd = [0.0; POINTS_MAX / 2];
        let (even, odd) = (&mut out[..outer], &mut odd[..outer]);
        even.fill(0.0);
        for (two, a) in self.cosines.chunks(2 * outer).zip(a.chunks(2)) {
            let (first, second) = two.split_at(outer);
            even.iter_mut().zip(first).for_each(|(sum, cosine)| *sum += a[0] * cosine);
            if let [_, a] = a {
                odd.iter_mut().zip(second).for_each(|(sum, cosine)| *sum += a * cosine);
            }
        }
        for i in 0..outer {
            let (even, odd) = (out[i], odd[i]);
            out[points - 1 - i] = even - odd;
            out[i] = even + odd;
        }
        self.places.iter().copied().zip(out.iter().copied())
    }
}

impl Row {
    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact up to a wave number (times thickness), line after line. Left out is what is not
    /// `seen`: its middle along the axis and its reach about that, mm.
    pub(super) fn lined_loads(
        &self,
        cutoff: f64,
        seen: impl Fn([f64; 2]) -> bool,
        mut of: impl FnMut([f64; 2], f64),
    ) {
        let (t, n) = (self.layer.thickness_mm, self.work.places.cosines);
        let Some([first, last]) = self.touching() else { return };
        let lay = self.lay(cutoff, last - first + 1);
        let (from, to) = (first as isize - lay.beyond, last as isize + lay.beyond);
        let count = ((to - from) as usize / lay.step + 1) * lay.lines.len();
        // One rule for all: where it changed, the points of neighbouring lines would coincide.
        let widest = (first..=last).map(|j| self.work.slice(j).0).fold(0.0, f64::max);
        let rule = &self.rules[points_for(cutoff, widest).min(self.rules.len()) - 1];
        let points = rule.places.len();
        let each = 0.5 * PI * self.modulus_mpa() * t * t * self.h / points as f64;
        let apart = lay.apart(self.h);
        let whole = libm::ceil(EDGE / apart) as usize;
        let mut sum = [0.0; COSINES_MAX];
        let mut psi = [0.0; POINTS_MAX];
        for line in 0..count {
            let (place, weights) = lay.lines[line % lay.lines.len()];
            let slice = from + (line / lay.lines.len() * lay.step) as isize;
            let v = self.along[0] + self.h * (slice as f64 + place);
            let own = slice.clamp(first as isize, last as isize) as usize;
            let b = self.work.slice(own).0;
            if !seen([v * t, b * t]) || !self.gather(slice, weights, &mut sum[..n]) {
                continue;
            }
            // At an end the points of one line have no others beside them.
            let more = match line.min(count - 1 - line).saturating_sub(whole) {
                0 => 0.0,
                1 => 0.25,
                2 => 0.75,
                _ => 1.0,
            };
            let mut sides = if line % 2 == 0 { [b * t, -b * t] } else { [-b * t, b * t] };
            for (place, psi) in rule.at(&sum[..n], &mut psi) {
                of([sides[0] * place, v * t], (1.0 + more) * each * psi);
                if more < 1.0 {
                    of([sides[1] * place, v * t], (1.0 - more) * each * psi);
                }
                sides.swap(0, 1);
            }
        }
    }

    /// The first and the last slice that touches.
    fn touching(&self) -> Option<[usize; 2]> {
        let mut touching = (0..self.along.len()).filter(|j| self.work.touches(*j));
        let first = touching.next()?;
        Some([first, touching.next_back().unwrap_or(first)])
    }

    /// Distance of neighbouring lines (thicknesses) that stand for wave numbers up to `cutoff`; 0
    /// where nothing touches.
    pub(super) fn lines_apart(&self, cutoff: f64) -> f64 {
        self.touching()
            .map_or(0.0, |[first, last]| self.lay(cutoff, last - first + 1).apart(self.h))
    }

    /// The lay for lines that stand for wave numbers up to `cutoff`.
    fn lay(&self, cutoff: f64, touching: usize) -> &'static Lay {
        let wanted = APART / cutoff;
        if self.h > wanted {
            &HALVES
        } else if 2.0 * self.h <= LONGER * wanted && touching >= 2 * FEWEST {
            &PAIRS
        } else {
            &EACH
        }
    }

    /// Sums the cosines of slices about one; whether any of them touches.
    fn gather(&self, slice: isize, weights: &[(isize, f64)], sum: &mut [f64]) -> bool {
        sum.fill(0.0);
        let mut any = false;
        for (further, weight) in weights {
            let at = usize::try_from(slice + further);
            let at = at.ok().filter(|j| *j < self.along.len() && self.work.touches(*j));
            if let Some(j) = at {
                let (_, a) = self.work.slice(j);
                sum.iter_mut().zip(a).for_each(|(sum, a)| *sum += weight * a);
                any = true;
            }
        }
        any
    }

    /// Wave number (times thickness) up to which the points of an image stand for the pressure, for
    /// tactels of `pitch_mm`; `finest` is that for a point of the base. The base sees the less of a
    /// wave the shorter it is, and the mean over a tactel leaves a part of that.
    pub(super) fn cutoff(&self, finest: f64, pitch_mm: Option<f64>) -> f64 {
        let tactel = pitch_mm.map_or(POINT, |pitch| pitch / self.layer.thickness_mm);
        (finest - libm::log(tactel.max(POINT) / POINT)).max(COARSEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What each slice leaves on all lines is its force, about its middle, spread as a triangle of
    /// two lengths is.
    #[test]
    fn lays_keep_the_moments_of_a_slice() {
        for lay in [&EACH, &HALVES, &PAIRS] {
            for slice in 0..lay.step as isize {
                let mut moments = [0.0; 4];
                for base in (-12..=12).step_by(lay.step) {
                    for (place, weights) in lay.lines {
                        let at = base as f64 + place - slice as f64;
                        for (_, weight) in weights.iter().filter(|(k, _)| base + k == slice) {
                            for (power, moment) in moments.iter_mut().enumerate() {
                                *moment += weight * libm::pow(at, power as f64);
                            }
                        }
                    }
                }
                let exact = [1.0, 0.0, 1.0 / 6.0, 0.0];
                let off = moments.iter().zip(exact).map(|(a, b)| (a - b).abs());
                assert!(off.fold(0.0, f64::max) < 1e-12, "{}: {moments:?}", lay.step);
                let further = lay.lines.iter().flat_map(|(_, weights)| weights.iter());
                assert_eq!(further.map(|(k, _)| k.abs()).max(), Some(lay.beyond));
            }
        }
    }

    /// A rule's sums by halves against the sums themselves.
    #[test]
    fn rules_sum_cosines() {
        for points in 1..12 {
            for cosines in 1..7 {
                let rule = Rule::new(points, cosines);
                let a: Vec<f64> = (0..cosines).map(|k| 0.3 + libm::sin(k as f64)).collect();
                let mut sums = [0.0; POINTS_MAX];
                for (i, (place, sum)) in rule.at(&a, &mut sums).enumerate() {
                    let angle = libm::acos(place);
                    let of = |(k, a): (usize, &f64)| a * libm::cos(2.0 * k as f64 * angle);
                    let exact: f64 = a.iter().enumerate().map(of).sum();
                    assert!((sum - exact).abs() < 1e-12, "{points} {cosines} {i}");
                }
            }
        }
    }
}
