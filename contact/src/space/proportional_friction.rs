//! Solves the sliding contact of a rigid body on cells, whose tangential traction is proportional
//! to the pressure.

use super::super::{Invalid, finite};
use super::Prescribed;
use super::fourier::Convolution;
use super::shear::Shear;
use super::surface::{Surface, SurfaceState};

/// Most iterations between pressure and displacement by friction.
const ITERATIONS_MAX: usize = 60;
/// Change of that displacement, over the penetration, at which the iterations end.
const CHANGE_TOLERANCE: f64 = 1e-7;

impl Shear {
    /// Presses a body whose traction along x is `ratio` times its pressure. The tangential traction
    /// displaces the surface too, which is found by iteration. `heights_mm` is as in
    /// [`Surface::press`]. Allocates.
    ///
    /// # Errors
    /// The errors of [`Surface::press`]; a ratio that is not finite; iterations that do not
    /// converge.
    pub fn press(
        &self,
        surface: &mut Surface,
        heights_mm: &[f64],
        prescribed: Prescribed,
        ratio: f64,
    ) -> Result<SurfaceState, Invalid> {
        finite("ratio", ratio)?;
        let cells = *surface.cells();
        let half = [0.5 * cells.spacing_mm; 2];
        let (columns, rows) = (cells.columns, cells.rows);
        let offset = |i: usize| i as f64 * cells.spacing_mm;
        // The normal displacement is odd along x and even along y.
        let mut convolution = Convolution::with_parity([columns, rows], [true, false], |i, j| {
            self.surface_cell([offset(i), offset(j)], half)[2]
        });
        let mut displaced = vec![0.0; heights_mm.len()];
        for _ in 0..ITERATIONS_MAX {
            let raised: Vec<f64> = heights_mm.iter().zip(&displaced).map(|(h, s)| h + s).collect();
            let state = surface.press(&raised, prescribed)?;
            let mut displacement = surface.pressure_mpa().to_vec();
            convolution.apply(&mut displacement);
            let mut change = 0.0_f64;
            for (before, displacement) in displaced.iter_mut().zip(displacement) {
                change = change.max((ratio * displacement - *before).abs());
                *before = ratio * displacement;
            }
            if change <= CHANGE_TOLERANCE * state.penetration_mm.abs() {
                return Ok(state);
            }
        }
        surface.release();
        let what = format!("the contact does not converge under {ratio} times the pressure");
        Err(Invalid::new("ratio", what, "give a smaller ratio"))
    }
}
