//! Several loads on a factored mesh at once, a lane each: the factor, the places of the equations
//! and the modes of the dilatation are read once for all of them. For the compliances of a surface,
//! which are hundreds of loads. Refuses nothing. It allocates.

use super::element::MODES;
use super::layer::{Elements, HELD, SETTLED, STEPS};
use crate::numeric::band::LANES;

/// One number a lane.
type Lane = [f64; LANES];

/// Room for the loads, and the displacements that they make, equation by equation.
pub(super) struct Lanes {
    load: Vec<Lane>,
    moved: Vec<Lane>,
    pressure: Vec<[Lane; MODES]>,
}

impl Lanes {
    pub(super) fn new<const D: usize>(body: &Elements<D>) -> Self {
        let side = vec![[0.0; LANES]; body.unknowns];
        let pressure = vec![[[0.0; LANES]; MODES]; body.modes.len()];
        Self { load: side.clone(), moved: side, pressure }
    }

    /// Solves for one force on a column of the surface in each lane.
    pub(super) fn solve<const D: usize>(
        &mut self,
        body: &Elements<D>,
        forces: &[(usize, [f64; D])],
    ) {
        self.load.fill([0.0; LANES]);
        self.pressure.fill([[0.0; LANES]; MODES]);
        for (lane, (column, force)) in forces.iter().enumerate().take(LANES) {
            for (place, value) in places(body, body.mesh().surface(*column)).zip(force) {
                if let Some(place) = place {
                    self.load[place][lane] = *value;
                }
            }
        }
        self.moved.copy_from_slice(&self.load);
        body.factor.solve_lanes(&mut self.moved);
        let mut last = f64::INFINITY;
        for _ in 0..if body.compliance_left == 0.0 { 0 } else { STEPS } {
            let change = self.raise(body);
            body.factor.solve_lanes(&mut self.moved);
            if change < SETTLED || change > 0.5 * last {
                break;
            }
            last = change;
        }
    }

    /// Displacement of a column of the surface in a lane.
    pub(super) fn at<const D: usize>(
        &self,
        body: &Elements<D>,
        column: usize,
        lane: usize,
    ) -> [f64; D] {
        let mut out = [0.0; D];
        for (slot, place) in out.iter_mut().zip(places(body, body.mesh().surface(column))) {
            *slot = place.map_or(0.0, |place| self.moved[place][lane]);
        }
        out
    }

    /// As a single load's pressures are raised, with the next right side in `moved`; the largest
    /// change of all lanes.
    fn raise<const D: usize>(&mut self, body: &Elements<D>) -> f64 {
        let (bulk, left) = (body.moduli.bulk, body.compliance_left);
        let (mut change, mut largest) = ([0.0_f64; LANES], [f64::MIN_POSITIVE; LANES]);
        for (e, (modes, pressure)) in body.modes.iter().zip(&mut self.pressure).enumerate() {
            let nodes = body.nodes_of(e);
            let rows = modes.rows.chunks_exact(nodes.len() * D);
            for (row, added) in rows.zip(pressure) {
                let mut theta = [0.0; LANES];
                for (part, place) in
                    row.iter().zip(nodes.iter().flat_map(|n| places(body, *n as usize)))
                {
                    if let Some(place) = place {
                        let moved = &self.moved[place];
                        theta
                            .iter_mut()
                            .zip(moved)
                            .for_each(|(theta, moved)| *theta += part * moved);
                    }
                }
                for lane in 0..LANES {
                    let stress = bulk * theta[lane] + added[lane];
                    let more = bulk * (theta[lane] - stress * (left + 1.0 / bulk));
                    added[lane] += more;
                    change[lane] = change[lane].max(more.abs());
                    largest[lane] = largest[lane].max(stress.abs());
                }
            }
        }
        self.moved.copy_from_slice(&self.load);
        for (e, (modes, pressure)) in body.modes.iter().zip(&self.pressure).enumerate() {
            let nodes = body.nodes_of(e);
            for (row, added) in modes.rows.chunks_exact(nodes.len() * D).zip(pressure) {
                for (part, place) in
                    row.iter().zip(nodes.iter().flat_map(|n| places(body, *n as usize)))
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

/// Equations of a node along the axes; none where it is held.
fn places<const D: usize>(
    body: &Elements<D>,
    node: usize,
) -> impl Iterator<Item = Option<usize>> + '_ {
    let all = &body.equations[node * D..][..D];
    all.iter().map(|place| (*place != HELD).then_some(*place as usize))
}
