//! What a contact is off by: what the pressure leaves at the edge of a slice whose width is free,
//! as the change of width that cures it, and slices in the air that the layer reaches. It refuses
//! nothing.

use super::row::Row;
use super::strip::Places;
use super::work::Work;

/// Least and largest of a slice's growth over that in the plane.
const BLUNT: [f64; 2] = [0.3, 3.0];
/// Change of the penetration of a slice's width that cures what the pressure leaves at its edge.
pub(super) fn edge(places: Places, row: &[f64], own: &[f64]) -> f64 {
    let strength = own.iter().sum::<f64>() / row[places.edge()];
    strength * bluntness(places, row, own, strength)
}

/// How much faster than on its own the slice's contact grows with what is left at its edge. At the
/// right width the pressure ends as a square root, and moving the edge by db leaves a singularity
/// in proportion to db and to that root's factor; widths do not act on each other. The factor is
/// taken from the pressure without its singularity, beside the plane contact's of the same width.
fn bluntness(places: Places, row: &[f64], own: &[f64], strength: f64) -> f64 {
    let (mut plane, mut found) = (0.0, 0.0);
    for (k, a) in own.iter().enumerate().skip(1) {
        let weight = (k * k) as f64;
        plane += weight * row[places.contact(k)];
        found += weight * (a - strength * row[places.punch(k)]);
    }
    let ratio = plane / found;
    if ratio > 0.0 { ratio.clamp(BLUNT[0], BLUNT[1]) } else { 1.0 }
}

/// Penetration of the width of a slice in the air to which those that touch on both of its sides
/// lead; absent where none touch on one side. The rubber swells between them, so that the slice is
/// reached by more than that: too wide, it would let go again.
fn led(work: &Work, slice: usize) -> Option<f64> {
    let n = work.places.cosines;
    let touches = |j: &usize| work.active[*j] && work.a[j * n] != 0.0;
    let before = (0..slice).rev().find(touches)?;
    let after = (slice + 1..work.active.len()).find(touches)?;
    let part = (slice - before) as f64 / (after - before) as f64;
    Some((1.0 - part) * work.effective[before] + part * work.effective[after])
}

impl Row {
    /// Change of the penetration of its width that a slice on its own would take.
    pub(super) fn change(&self, slice: usize) -> f64 {
        let n = self.work.places.cosines;
        let own = &self.work.a[slice * n..(slice + 1) * n];
        edge(self.work.places, self.work.row(slice), own)
    }

    /// Largest change that a slice on its own would take, over the largest penetration.
    pub(super) fn left_at_edges(&self) -> f64 {
        let touching = (0..self.along.len()).filter(|j| self.work.active[*j]);
        touching.map(|j| self.change(j).abs()).fold(0.0, f64::max) / self.largest()
    }

    /// The layer's shape under lifted slices; those that it reaches come back. The largest reach.
    pub(super) fn wake(&mut self) -> f64 {
        let (slices, n) = (self.along.len(), self.work.places.cosines);
        let mut largest: f64 = 0.0;
        self.coupling.convolve(&self.work.transforms, &self.work.a);
        for j in 0..slices {
            let work = &mut self.work;
            if !work.active[j] && work.a[j * n] == 0.0 && !work.stays_off(j) {
                let gap = work.given[j] - self.coupling.middle(j);
                if gap > 0.0 {
                    let led = if self.strips.is_free() { led(&self.work, j) } else { None };
                    let work = &mut self.work;
                    work.active[j] = true;
                    work.effective[j] = led.map_or(gap, |led| gap.min(led));
                    largest = largest.max(gap);
                }
            }
        }
        largest
    }
}
