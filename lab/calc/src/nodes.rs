//! Base stress of a finite element contact on the nodes of its mesh, and the features of this
//! stress. Outside the mesh the stress is zero.

use taktil_contact::plane::features::{Compressive, Moments};

/// Base stress on the nodes of a mesh, linear between them.
pub(super) struct NodalStress {
    pub(super) x: Vec<f64>,
    pub(super) width: Vec<f64>,
    pub(super) szz: Vec<f64>,
}

impl NodalStress {
    pub(super) fn szz(&self, x: f64) -> f64 {
        let right = self.x.partition_point(|place| *place < x);
        if right == 0 || right == self.x.len() {
            return if self.x.first() == Some(&x) { self.szz[0] } else { 0.0 };
        }
        let (a, b) = (self.x[right - 1], self.x[right]);
        let s = (x - a) / (b - a);
        self.szz[right - 1] * (1.0 - s) + self.szz[right] * s
    }

    pub(super) fn moments(&self, compressive: bool) -> Moments {
        let mut m = [0.0; 4];
        for ((x, w), s) in self.x.iter().zip(&self.width).zip(&self.szz) {
            let mut power = w * if compressive { s.min(0.0) } else { *s };
            for m in &mut m {
                *m += power;
                power *= x;
            }
        }
        Moments { m }
    }

    pub(super) fn compressive(&self, thresholds: &[f64]) -> Compressive {
        let lowest = |a: &usize, b: &usize| self.szz[*a].total_cmp(&self.szz[*b]);
        let peak = (0..self.x.len()).min_by(lowest).unwrap_or(0);
        let width = |threshold: &f64| {
            if *threshold >= -self.szz[peak] {
                return 0.0;
            }
            let crossing = |step: isize| {
                let mut i = peak;
                while let Some(next) = i.checked_add_signed(step).filter(|k| *k < self.x.len()) {
                    let (a, b) = (-self.szz[i] - threshold, -self.szz[next] - threshold);
                    if b <= 0.0 {
                        return self.x[i] + (self.x[next] - self.x[i]) * a / (a - b);
                    }
                    i = next;
                }
                self.x[i]
            };
            crossing(1) - crossing(-1)
        };
        Compressive {
            moments: self.moments(true),
            x_peak_mm: self.x[peak],
            szz_peak_mpa: self.szz[peak].min(0.0),
            widths_mm: thresholds.iter().map(width).collect(),
        }
    }
}
