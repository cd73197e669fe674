//! Solves several loads on a factored mesh together, side by side: the factor, the numbers of the
//! equations and the modes of the dilatation are read once for all of them. It serves the
//! compliances of a surface, which are hundreds of loads. Only the construction allocates.

use super::element::DILATATION_MODES;
use super::layer::{AUGMENTED_STEPS_MAX, Elements, FIXED_EQUATION, PRESSURE_TOLERANCE};
use crate::numeric::band::SIDES_AT_ONCE;

/// One number for each right side.
type SideValues = [f64; SIDES_AT_ONCE];

/// Room for the loads, and the displacements that they make, equation by equation.
pub(super) struct RightSides {
    load: Vec<SideValues>,
    moved: Vec<SideValues>,
    pressure: Vec<[SideValues; DILATATION_MODES]>,
}

impl RightSides {
    pub(super) fn new<const D: usize>(body: &Elements<D>) -> Self {
        let side = vec![[0.0; SIDES_AT_ONCE]; body.unknowns];
        let pressure = vec![[[0.0; SIDES_AT_ONCE]; DILATATION_MODES]; body.modes.len()];
        Self { load: side.clone(), moved: side, pressure }
    }

    /// Solves for one force on a column of the surface in each right side.
    pub(super) fn solve<const D: usize>(
        &mut self,
        body: &Elements<D>,
        forces: &[(usize, [f64; D])],
    ) {
        self.load.fill([0.0; SIDES_AT_ONCE]);
        self.pressure.fill([[0.0; SIDES_AT_ONCE]; DILATATION_MODES]);
        for (side_index, (column, force)) in forces.iter().enumerate().take(SIDES_AT_ONCE) {
            for (place, value) in equations_of(body, body.mesh().surface_node(*column)).zip(force) {
                if let Some(place) = place {
                    self.load[place][side_index] = *value;
                }
            }
        }
        self.moved.copy_from_slice(&self.load);
        body.factor.solve_many(&mut self.moved);
        let mut last = f64::INFINITY;
        for _ in 0..if body.compliance_left == 0.0 { 0 } else { AUGMENTED_STEPS_MAX } {
            let change = self.raise_pressures(body);
            body.factor.solve_many(&mut self.moved);
            if change < PRESSURE_TOLERANCE || change > 0.5 * last {
                break;
            }
            last = change;
        }
    }

    /// Displacement of a column of the surface under one right side.
    pub(super) fn at<const D: usize>(
        &self,
        body: &Elements<D>,
        column: usize,
        side_index: usize,
    ) -> [f64; D] {
        let mut out = [0.0; D];
        for (slot, place) in
            out.iter_mut().zip(equations_of(body, body.mesh().surface_node(column)))
        {
            *slot = place.map_or(0.0, |place| self.moved[place][side_index]);
        }
        out
    }

    /// Raises the pressures as for a single load and writes the next right sides to `moved`;
    /// returns the largest change over all right sides.
    fn raise_pressures<const D: usize>(&mut self, body: &Elements<D>) -> f64 {
        let (bulk, left) = (body.moduli.bulk, body.compliance_left);
        let (mut change, mut largest) =
            ([0.0_f64; SIDES_AT_ONCE], [f64::MIN_POSITIVE; SIDES_AT_ONCE]);
        for (e, (modes, pressure)) in body.modes.iter().zip(&mut self.pressure).enumerate() {
            let nodes = body.nodes_of(e);
            let rows = modes.rows.chunks_exact(nodes.len() * D);
            for (row, added) in rows.zip(pressure) {
                let mut theta = [0.0; SIDES_AT_ONCE];
                for (part, place) in
                    row.iter().zip(nodes.iter().flat_map(|n| equations_of(body, *n as usize)))
                {
                    if let Some(place) = place {
                        let moved = &self.moved[place];
                        theta
                            .iter_mut()
                            .zip(moved)
                            .for_each(|(theta, moved)| *theta += part * moved);
                    }
                }
                for side_index in 0..SIDES_AT_ONCE {
                    let stress = bulk * theta[side_index] + added[side_index];
                    let more = bulk * (theta[side_index] - stress * (left + 1.0 / bulk));
                    added[side_index] += more;
                    change[side_index] = change[side_index].max(more.abs());
                    largest[side_index] = largest[side_index].max(stress.abs());
                }
            }
        }
        self.moved.copy_from_slice(&self.load);
        for (e, (modes, pressure)) in body.modes.iter().zip(&self.pressure).enumerate() {
            let nodes = body.nodes_of(e);
            for (row, added) in modes.rows.chunks_exact(nodes.len() * D).zip(pressure) {
                for (part, place) in
                    row.iter().zip(nodes.iter().flat_map(|n| equations_of(body, *n as usize)))
                {
                    if let Some(place) = place {
                        let side = &mut self.moved[place];
                        side.iter_mut().zip(added).for_each(|(side, added)| *side -= added * part);
                    }
                }
            }
        }
        change.iter().zip(largest).map(|(change, most)| change / most).fold(0.0, f64::max)
    }
}

/// Equations of a node along the axes; none along an axis on which it is fixed.
fn equations_of<const D: usize>(
    body: &Elements<D>,
    node: usize,
) -> impl Iterator<Item = Option<usize>> + '_ {
    let all = &body.equations[node * D..][..D];
    all.iter().map(|place| (*place != FIXED_EQUATION).then_some(*place as usize))
}
