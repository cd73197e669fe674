//! Sliding contact of a rigid body on cells: a tangential traction in proportion to the pressure.

use super::super::{Invalid, finite};
use super::Prescribed;
use super::fourier::Convolution;
use super::shear::Shear;
use super::surface::{Surface, SurfaceState};

/// Most solutions of the pressure under friction, and the change of the displacement, over the
/// penetration, at which they end.
const ITERATIONS_MAX: usize = 60;
const CHANGE_TOLERANCE: f64 = 1e-7;

impl Shear {
    /// Presses a body that rubs along x with `ratio` times its pressure: the surface also
    /// displacement by what the tangential traction moves, in rounds. `heights_mm` as in
    /// [`Surface::press`]. Allocates.
    ///
    /// # Errors
    /// What [`Surface::press`] refuses; a ratio that is not finite; rounds that do not settle.
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
        // Odd along x, even along y.
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
        let what = format!("{ratio} times the pressure does not settle");
        Err(Invalid::new("ratio", what, "give less friction"))
    }
}
