//! The array as an electric network: resistors between rows and columns, one row driven at a
//! time, the others grounded, each column's current read. Drivers and inputs have resistance, so
//! that rows and columns have other potentials than intended, and a tactel's reading depends on its
//! neighbours. The crosstalk is not approximated: the potentials are the solution of a linear
//! system.
//!
//! Kirchhoff's law, with row i at `r_i`, column j at `c_j`, tactel conductances `g_ij`, drivers and
//! inputs `G`: `G (v_i - r_i) = sum_j g_ij (r_i - c_j)` and `sum_i g_ij (r_i - c_j) = G c_j`. The
//! rows are eliminated; the remaining system of the columns is symmetric, positive definite and the
//! same whichever row is driven.

use crate::geometry::ArrayGeometry;

/// The network of rows and columns with its drivers. Conductances are of all tactels, row by row,
/// relative to the conductance at full scale.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    /// Conductance of a driver and of an input, relative to a tactel's at full scale.
    driver: f64,
    cols: usize,
    /// The factor of the system of the columns that was factorised last, row by row.
    lower: Box<[f64]>,
    /// Sum of all conductances at each row.
    rows: Box<[f64]>,
}

impl Network {
    /// The network; none without resistance, because then no tactel influences another. Allocates.
    pub(crate) fn new(
        geometry: &ArrayGeometry,
        full_scale_ohm: f64,
        driver_ohm: f64,
    ) -> Option<Network> {
        let &ArrayGeometry { rows, cols, .. } = geometry;
        (driver_ohm > 0.0).then(|| Network {
            driver: full_scale_ohm / driver_ohm,
            cols,
            lower: vec![0.0; cols * cols].into(),
            rows: vec![0.0; rows].into(),
        })
    }

    /// Makes and factorises the system of the columns by Cholesky.
    pub(crate) fn factorise(&mut self, g: &[f64]) {
        let Network { driver, cols, lower: a, rows } = self;
        let (driver, cols) = (*driver, *cols);
        rows.fill(driver);
        a.fill(0.0);
        for (sum, of_row) in rows.iter_mut().zip(g.chunks_exact(cols)) {
            *sum += of_row.iter().sum::<f64>();
            for (j, gj) in of_row.iter().enumerate() {
                if *gj == 0.0 {
                    continue;
                }
                let share = gj / *sum;
                let line = &mut a[j * cols..][..=j];
                for (entry, gk) in line.iter_mut().zip(of_row) {
                    *entry -= share * gk;
                }
                line[j] += gj;
            }
        }
        for j in 0..cols {
            let (above, line) = a.split_at_mut(j * cols);
            let line = &mut line[..=j];
            line[j] += driver;
            for k in 0..j {
                let before = &above[k * cols..][..=k];
                let dot: f64 = line[..k].iter().zip(before).map(|(x, y)| x * y).sum();
                line[k] = (line[k] - dot) / before[k];
            }
            let dot: f64 = line[..j].iter().map(|x| x * x).sum();
            line[j] = (line[j] - dot).sqrt();
        }
    }

    /// Writes the readings of one row, tactel by tactel, relative to full scale, for the
    /// conductances that were factorised last.
    pub(crate) fn read(&self, g: &[f64], row: usize, readings: &mut [f64]) {
        let Network { driver, cols, lower, rows } = self;
        let (driver, cols) = (*driver, *cols);
        let (share, c) = (driver / rows[row], readings);
        for (reading, conductance) in c.iter_mut().zip(&g[row * cols..]) {
            *reading = share * conductance;
        }
        for j in 0..cols {
            let line = &lower[j * cols..][..=j];
            let dot: f64 = line[..j].iter().zip(&*c).map(|(l, x)| l * x).sum();
            c[j] = (c[j] - dot) / line[j];
        }
        for j in (0..cols).rev() {
            let dot: f64 = (j + 1..cols).map(|k| lower[k * cols + j] * c[k]).sum();
            c[j] = (c[j] - dot) / lower[j * cols + j];
        }
        c.iter_mut().for_each(|potential| *potential *= driver);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARRAY_SIDE: usize = 16;

    fn network(driver_ohm: f64) -> Network {
        Network::new(&ArrayGeometry::THESIS, 5000.0, driver_ohm).unwrap()
    }

    /// The readings of one row.
    fn readings(network: &mut Network, g: &[f64], row: usize) -> Vec<f64> {
        let mut readings = vec![0.0; ARRAY_SIDE];
        network.factorise(g);
        network.read(g, row, &mut readings);
        readings
    }

    fn pressed(places: &[(usize, usize)]) -> Vec<f64> {
        let mut g = vec![0.0; ARRAY_SIDE * ARRAY_SIDE];
        for (row, column) in places {
            g[row * ARRAY_SIDE + column] = 1.0;
        }
        g
    }

    #[test]
    fn one_tactel_alone_is_in_series_with_driver_and_input() {
        let mut network = network(50.0);
        let g = pressed(&[(3, 7)]);
        let read = readings(&mut network, &g, 3);
        assert!((read[7] - 5000.0 / 5100.0).abs() < 1e-12, "{}", read[7]);
        assert!(read.iter().enumerate().all(|(j, x)| j == 7 || x.abs() < 1e-15));
        assert!(readings(&mut network, &g, 4).iter().all(|x| x.abs() < 1e-15));
    }

    #[test]
    fn the_fourth_corner_of_three_pressed_ones_lights_up() {
        let g = pressed(&[(2, 2), (2, 9), (11, 2)]);
        let ghost = |ohm: f64| readings(&mut network(ohm), &g, 11)[9];
        assert!(ghost(50.0) > 1e-5 && ghost(50.0) < 1e-3, "{}", ghost(50.0));
        assert!(ghost(2000.0) > 0.01, "{}", ghost(2000.0));
        assert!(ghost(1e-3) < 1e-12, "{}", ghost(1e-3));
    }

    #[test]
    fn currents_obey_kirchhoff() {
        // Potentials found by relaxation, another way.
        let mut g = vec![0.0; ARRAY_SIDE * ARRAY_SIDE];
        for (i, g) in g.iter_mut().enumerate() {
            *g = 0.3 + 0.3 * libm::sin(0.7 * i as f64);
        }
        let mut network = network(1250.0);
        let (driven, mut r, mut c) = (5, [0.0; ARRAY_SIDE], [0.0; ARRAY_SIDE]);
        for _ in 0..2000 {
            for i in 0..ARRAY_SIDE {
                let (mut flow, mut sum) = (if i == driven { 4.0 } else { 0.0 }, 4.0);
                for j in 0..ARRAY_SIDE {
                    flow += g[i * ARRAY_SIDE + j] * c[j];
                    sum += g[i * ARRAY_SIDE + j];
                }
                r[i] = flow / sum;
            }
            for j in 0..ARRAY_SIDE {
                let (mut flow, mut sum) = (0.0, 4.0);
                for i in 0..ARRAY_SIDE {
                    flow += g[i * ARRAY_SIDE + j] * r[i];
                    sum += g[i * ARRAY_SIDE + j];
                }
                c[j] = flow / sum;
            }
        }
        let read = readings(&mut network, &g, driven);
        for j in 0..ARRAY_SIDE {
            assert!((read[j] - 4.0 * c[j]).abs() < 1e-9, "{j}: {} {}", read[j], 4.0 * c[j]);
        }
    }
}
