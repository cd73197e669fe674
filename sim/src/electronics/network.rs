//! The array as an electric network: resistors between 16 rows and 16 columns, one row driven at a
//! time, the others grounded, each column's current read. Drivers and inputs have resistance, so
//! that rows and columns have other potentials than intended, and a tactel's reading depends on its
//! neighbours. The crosstalk is not approximated: the potentials are the solution of a linear
//! system.
//!
//! Kirchhoff's law, with row i at `r_i`, column j at `c_j`, tactel conductances `g_ij`, drivers and
//! inputs `G`: `G (v_i - r_i) = sum_j g_ij (r_i - c_j)` and `sum_i g_ij (r_i - c_j) = G c_j`. The
//! rows are eliminated; the remaining system of the columns is symmetric, positive definite and the
//! same whichever row is driven.

use crate::contact::SLICE_COUNT;

/// Conductances of all tactels, row by row, relative to the conductance at full scale.
pub(crate) type Conductances = [f64; SLICE_COUNT * SLICE_COUNT];

/// The network of rows and columns with its drivers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Network {
    /// Conductance of a driver and of an input, relative to a tactel's at full scale.
    driver: f64,
}

/// The factorised system of the columns.
#[derive(Clone, Debug)]
pub(crate) struct FactoredNetwork {
    driver: f64,
    lower: [[f64; SLICE_COUNT]; SLICE_COUNT],
    /// Sum of all conductances at each row.
    rows: [f64; SLICE_COUNT],
}

impl Network {
    /// The network; none without resistance, because then no tactel influences another.
    pub(crate) fn new(full_scale_ohm: f64, driver_ohm: f64) -> Option<Network> {
        (driver_ohm > 0.0).then(|| Network { driver: full_scale_ohm / driver_ohm })
    }

    /// Makes and factorises the system of the columns by Cholesky.
    pub(crate) fn factorise(&self, g: &Conductances) -> FactoredNetwork {
        let mut rows = [self.driver; SLICE_COUNT];
        let mut a = [[0.0; SLICE_COUNT]; SLICE_COUNT];
        for (row, sum) in rows.iter_mut().enumerate() {
            let of_row = &g[row * SLICE_COUNT..][..SLICE_COUNT];
            *sum += of_row.iter().sum::<f64>();
            for (j, gj) in of_row.iter().enumerate() {
                if *gj == 0.0 {
                    continue;
                }
                let share = gj / *sum;
                for (k, gk) in of_row[..=j].iter().enumerate() {
                    a[j][k] -= share * gk;
                }
                a[j][j] += gj;
            }
        }
        for j in 0..SLICE_COUNT {
            a[j][j] += self.driver;
            for k in 0..=j {
                let (before, here) = (&a[k][..k], &a[j][..k]);
                let dot: f64 = here.iter().zip(before).map(|(x, y)| x * y).sum();
                let rest = a[j][k] - dot;
                a[j][k] = if j == k { rest.sqrt() } else { rest / a[k][k] };
            }
        }
        FactoredNetwork { driver: self.driver, lower: a, rows }
    }
}

impl FactoredNetwork {
    /// Readings of one row, tactel by tactel, relative to full scale.
    pub(crate) fn read(&self, g: &Conductances, row: usize) -> [f64; SLICE_COUNT] {
        let share = self.driver / self.rows[row];
        let mut c: [f64; SLICE_COUNT] = core::array::from_fn(|j| share * g[row * SLICE_COUNT + j]);
        for j in 0..SLICE_COUNT {
            let dot: f64 = self.lower[j][..j].iter().zip(&c[..j]).map(|(l, x)| l * x).sum();
            c[j] = (c[j] - dot) / self.lower[j][j];
        }
        for j in (0..SLICE_COUNT).rev() {
            let dot: f64 = (j + 1..SLICE_COUNT).map(|k| self.lower[k][j] * c[k]).sum();
            c[j] = (c[j] - dot) / self.lower[j][j];
        }
        c.map(|potential| self.driver * potential)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressed(places: &[(usize, usize)]) -> Conductances {
        let mut g = [0.0; SLICE_COUNT * SLICE_COUNT];
        for (row, column) in places {
            g[row * SLICE_COUNT + column] = 1.0;
        }
        g
    }

    #[test]
    fn one_tactel_alone_is_in_series_with_driver_and_input() {
        let network = Network::new(5000.0, 50.0).unwrap();
        let g = pressed(&[(3, 7)]);
        let factored = network.factorise(&g);
        let read = factored.read(&g, 3);
        assert!((read[7] - 5000.0 / 5100.0).abs() < 1e-12, "{}", read[7]);
        assert!(read.iter().enumerate().all(|(j, x)| j == 7 || x.abs() < 1e-15));
        assert!(factored.read(&g, 4).iter().all(|x| x.abs() < 1e-15));
    }

    #[test]
    fn the_fourth_corner_of_three_pressed_ones_lights_up() {
        let g = pressed(&[(2, 2), (2, 9), (11, 2)]);
        let ghost = |ohm: f64| Network::new(5000.0, ohm).unwrap().factorise(&g).read(&g, 11)[9];
        assert!(ghost(50.0) > 1e-5 && ghost(50.0) < 1e-3, "{}", ghost(50.0));
        assert!(ghost(2000.0) > 0.01, "{}", ghost(2000.0));
        assert!(ghost(1e-3) < 1e-12, "{}", ghost(1e-3));
    }

    #[test]
    fn currents_obey_kirchhoff() {
        // Potentials found by relaxation, another way.
        let mut g = [0.0; SLICE_COUNT * SLICE_COUNT];
        for (i, g) in g.iter_mut().enumerate() {
            *g = 0.3 + 0.3 * libm::sin(0.7 * i as f64);
        }
        let network = Network { driver: 4.0 };
        let (driven, mut r, mut c) = (5, [0.0; SLICE_COUNT], [0.0; SLICE_COUNT]);
        for _ in 0..2000 {
            for i in 0..SLICE_COUNT {
                let (mut flow, mut sum) = (if i == driven { 4.0 } else { 0.0 }, 4.0);
                for j in 0..SLICE_COUNT {
                    flow += g[i * SLICE_COUNT + j] * c[j];
                    sum += g[i * SLICE_COUNT + j];
                }
                r[i] = flow / sum;
            }
            for j in 0..SLICE_COUNT {
                let (mut flow, mut sum) = (0.0, 4.0);
                for i in 0..SLICE_COUNT {
                    flow += g[i * SLICE_COUNT + j] * r[i];
                    sum += g[i * SLICE_COUNT + j];
                }
                c[j] = flow / sum;
            }
        }
        let read = network.factorise(&g).read(&g, driven);
        for j in 0..SLICE_COUNT {
            assert!((read[j] - 4.0 * c[j]).abs() < 1e-9, "{j}: {} {}", read[j], 4.0 * c[j]);
        }
    }
}
