//! The assembled layer: factored once, solved for any forces on its surface. Solving does not
//! allocate.

use super::dissect;
use super::element::{DILATATION_MODES, Element, Modes, Moduli, element, point};
use super::factor::{ENTRIES_MAX, Factor, Method, System};
use super::mesh::{Kind, Mesh};
use crate::layer::Layer;
use crate::numeric::product::dot_in_order;
use crate::{Invalid, finite};

/// Largest ratio of bulk to shear modulus that goes into the matrix; beyond it the pressure is
/// found by augmented Lagrange steps.
const BULK_TO_SHEAR_MAX: f64 = 2e3;
/// Most augmented Lagrange steps, and the relative change of pressure at which they end.
pub(super) const AUGMENTED_STEPS_MAX: usize = 60;
pub(super) const PRESSURE_TOLERANCE: f64 = 1e-13;
/// Equation number of a displacement that is held at 0.
pub(super) const FIXED_EQUATION: u32 = u32::MAX;

/// A mesh of a layer, factored.
#[derive(Clone, Debug)]
pub struct Elements<const D: usize = 2> {
    mesh: Mesh<D>,
    kind: Kind,
    /// The moduli in the matrix, and the missing compliance: 1/K - 1/K_matrix.
    pub(super) moduli: Moduli,
    pub(super) compliance_left: f64,
    /// Equation of each displacement, node by node.
    pub(super) equations: Vec<u32>,
    pub(super) unknowns: usize,
    /// Nodes of each element.
    connect: Vec<u32>,
    pub(super) modes: Vec<Modes<D>>,
    /// Rows of the base's nodes in the stiffness of the elements there.
    base_rows: Vec<f64>,
    pub(super) factor: Factor,
}

/// The mesh's response to a load.
#[derive(Clone, Debug)]
pub struct Response<const D: usize = 2> {
    /// Displacement of each node along the axes in mm.
    pub nodes_mm: Vec<[f64; D]>,
    /// Force of the base on each of its nodes, column by column, in N/mm (plane) or N.
    pub reactions: Vec<[f64; D]>,
    /// Mean stress that the steps added, by its modes in each element.
    pressure: Vec<[f64; DILATATION_MODES]>,
    side: Vec<f64>,
    load: Vec<f64>,
    /// Augmented steps taken.
    pub steps: usize,
}

impl<const D: usize> Elements<D> {
    /// Assembles and factors, in the plane as a band, in space as a sparse matrix; the thickness of
    /// `layer` is that of the mesh.
    ///
    /// # Errors
    /// A layer or a mesh that its check refuses; a factor of more than [`ENTRIES_MAX`] numbers;
    /// elements that fold; the plain element at nu = 0.5.
    pub fn new(layer: &Layer, mesh: Mesh<D>, kind: Kind) -> Result<Self, Invalid> {
        let method = if D == 2 { Method::Band } else { Method::Sparse };
        Self::with_method(layer, mesh, kind, method)
    }

    /// [`Self::new`] with the method named.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_method(
        layer: &Layer,
        mesh: Mesh<D>,
        kind: Kind,
        method: Method,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        mesh.check()?;
        let g = layer.shear_mpa();
        // K = 2 G (1 + nu)/(3 (1 - 2 nu)).
        let inverse = 3.0 * (1.0 - 2.0 * layer.poisson) / (2.0 * g * (1.0 + layer.poisson));
        if kind == Kind::Plain && inverse == 0.0 {
            let what = "0.5 makes the plain element infinitely stiff".to_owned();
            return Err(Invalid::new("poisson", what, "take the mean dilatation"));
        }
        let softest = 1.0 / (BULK_TO_SHEAR_MAX * g);
        let in_matrix = if kind == Kind::Plain { inverse } else { inverse.max(softest) };
        let moduli = Moduli { shear: g, bulk: 1.0 / in_matrix };
        let (equations, unknowns) = number_equations(&mesh, method);
        let count = mesh.elements.iter().product();
        let connect: Vec<u32> =
            (0..count).flat_map(|e| mesh.nodes_of(e)).map(|node| node as u32).collect();
        let per = (mesh.order + 1).pow(D as u32);
        let half =
            connect.chunks_exact(per).map(|nodes| equation_distance::<D>(nodes, &equations)).max();
        let half = half.unwrap_or(0);
        check_factor_size(&mesh, method, unknowns, half)?;
        let mut system = System::new(method, unknowns, half);
        let mut modes = Vec::with_capacity(count);
        let mut base_rows = Vec::new();
        for (e, nodes) in connect.chunks_exact(per).enumerate() {
            let one = element_matrices(&mesh, e, nodes, kind, moduli)?;
            add(&mut system, &one, nodes, &equations);
            if mesh.element_at(e)[D - 1] == 0 {
                let dofs = per * D;
                for local in (0..per).step_by(mesh.order + 1) {
                    base_rows.extend_from_slice(&one.stiffness[local * D * dofs..][..D * dofs]);
                }
            }
            modes.push(one.modes);
        }
        let Some(factor) = system.factor() else {
            let what = "a stiffness matrix that is not positive definite".to_owned();
            return Err(Invalid::new("mesh", what, "give elements of a better shape"));
        };
        let compliance_left = inverse - in_matrix;
        Ok(Self {
            mesh,
            kind,
            moduli,
            compliance_left,
            equations,
            unknowns,
            connect,
            modes,
            base_rows,
            factor,
        })
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &Mesh<D> {
        &self.mesh
    }

    /// Unknowns of the system.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Numbers that the factor keeps.
    #[must_use]
    pub fn factor_entries(&self) -> usize {
        self.factor.entries()
    }

    /// An empty response to fill again and again.
    #[must_use]
    pub fn response(&self) -> Response<D> {
        Response {
            nodes_mm: vec![[0.0; D]; self.mesh.nodes.len()],
            reactions: vec![[0.0; D]; self.mesh.columns()],
            pressure: vec![[0.0; DILATATION_MODES]; self.modes.len()],
            side: vec![0.0; self.unknowns],
            load: vec![0.0; self.unknowns],
            steps: 0,
        }
    }

    /// Solves for forces on the nodes of the surface, column by column, along the axes (z up), in
    /// N/mm (plane) or N. Missing forces count as 0. Does not allocate.
    pub fn solve(&self, surface: &[[f64; D]], out: &mut Response<D>) {
        out.load.fill(0.0);
        for (column, force) in surface.iter().take(self.mesh.columns()).enumerate() {
            let node = self.mesh.surface_node(column);
            for (axis, value) in force.iter().enumerate() {
                let place = self.equations[node * D + axis];
                if place != FIXED_EQUATION {
                    out.load[place as usize] = *value;
                }
            }
        }
        out.pressure.fill([0.0; DILATATION_MODES]);
        out.side.copy_from_slice(&out.load);
        self.factor.solve(&mut out.side);
        self.spread_displacements(out);
        out.steps = 0;
        let mut last = f64::INFINITY;
        while self.compliance_left != 0.0 && out.steps < AUGMENTED_STEPS_MAX {
            out.steps += 1;
            let change = self.raise_pressures(out);
            self.factor.solve(&mut out.side);
            self.spread_displacements(out);
            // Each step reduces the error about a thousandfold until rounding is reached; a change
            // that no longer halves is rounding.
            if change < PRESSURE_TOLERANCE || change > 0.5 * last {
                break;
            }
            last = change;
        }
        self.compute_reactions(out);
    }

    pub(super) fn nodes_of(&self, e: usize) -> &[u32] {
        let per = self.connect.len() / self.modes.len();
        &self.connect[e * per..][..per]
    }

    /// Raises the pressures in proportion to the excess of dilatation and makes the next right
    /// side; returns the largest change of a pressure relative to the largest pressure.
    fn raise_pressures(&self, out: &mut Response<D>) -> f64 {
        let (mut change, mut largest) = (0.0_f64, f64::MIN_POSITIVE);
        let bulk = self.moduli.bulk;
        for e in 0..self.modes.len() {
            let theta = self.dilatation(e, out);
            for (mode, theta) in theta.into_iter().enumerate().take(self.modes[e].count) {
                // Mean stress in all: K_m theta + added; wanted is theta = stress/K.
                let stress = bulk * theta + out.pressure[e][mode];
                let excess = theta - stress * (self.compliance_left + 1.0 / bulk);
                out.pressure[e][mode] += bulk * excess;
                change = change.max((bulk * excess).abs());
                largest = largest.max(stress.abs());
            }
        }
        out.side.copy_from_slice(&out.load);
        for (e, modes) in self.modes.iter().enumerate() {
            let nodes = self.nodes_of(e);
            for (row, added) in modes.rows.chunks_exact(nodes.len() * D).zip(out.pressure[e]) {
                for (dof, part) in row.iter().enumerate() {
                    let place = self.equations[nodes[dof / D] as usize * D + dof % D];
                    if place != FIXED_EQUATION {
                        out.side[place as usize] -= added * part;
                    }
                }
            }
        }
        change / largest
    }

    /// Coefficients of the dilatation's modes.
    fn dilatation(&self, e: usize, out: &Response<D>) -> [f64; DILATATION_MODES] {
        let nodes = self.nodes_of(e);
        let mut theta = [0.0; DILATATION_MODES];
        for (slot, row) in theta.iter_mut().zip(self.modes[e].rows.chunks_exact(nodes.len() * D)) {
            for (part, node) in row.chunks_exact(D).zip(nodes) {
                let moved = &out.nodes_mm[*node as usize];
                *slot += part.iter().zip(moved).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        theta
    }

    fn spread_displacements(&self, out: &mut Response<D>) {
        for (node, places) in out.nodes_mm.iter_mut().zip(self.equations.chunks_exact(D)) {
            for (slot, place) in node.iter_mut().zip(places) {
                *slot = if *place == FIXED_EQUATION { 0.0 } else { out.side[*place as usize] };
            }
        }
    }

    /// Reactions of the base.
    fn compute_reactions(&self, out: &mut Response<D>) {
        out.reactions.fill([0.0; D]);
        let (across, wide) = (self.mesh.elements[D - 1], self.mesh.order + 1);
        let tall = self.mesh.counts()[D - 1];
        let dofs = D * self.nodes_of(0).len();
        let mut rows = self.base_rows.chunks_exact(dofs);
        for e in (0..self.modes.len()).step_by(across) {
            let nodes = self.nodes_of(e);
            for local in (0..nodes.len()).step_by(wide) {
                let column = nodes[local] as usize / tall;
                for axis in 0..D {
                    let Some(row) = rows.next() else { return };
                    let elastic: f64 = row
                        .chunks_exact(D)
                        .zip(nodes)
                        .map(|(part, node)| dot_in_order(part, &out.nodes_mm[*node as usize]))
                        .sum();
                    let modes = self.modes[e].rows.chunks_exact(dofs).zip(out.pressure[e]);
                    let added: f64 = modes.map(|(row, p)| p * row[local * D + axis]).sum();
                    out.reactions[column][axis] += elastic + added;
                }
            }
        }
    }

    /// Forces that hold all nodes at given displacements, for the patch test. Allocates.
    ///
    /// # Errors
    /// Elements that fold, which none of a factored mesh does.
    pub fn holding_forces(&self, nodes_mm: &[[f64; D]]) -> Result<Vec<[f64; D]>, Invalid> {
        let mut out = vec![[0.0; D]; self.mesh.nodes.len()];
        for e in 0..self.modes.len() {
            let nodes = self.nodes_of(e);
            let one = element_matrices(&self.mesh, e, nodes, self.kind, self.moduli)?;
            for (dof, row) in one.stiffness.chunks_exact(nodes.len() * D).enumerate() {
                let parts = row.chunks_exact(D).zip(nodes);
                let force: f64 =
                    parts.map(|(part, node)| dot_in_order(part, &nodes_mm[*node as usize])).sum();
                out[nodes[dof / D] as usize][dof % D] += force;
            }
        }
        Ok(out)
    }

    /// Normal stresses along the axes at a place inside, in MPa; `None` outside. Meshes of
    /// straight edges only. Allocates.
    #[must_use]
    pub fn stress_mpa(&self, response: &Response<D>, place: &[f64; D]) -> Option<[f64; D]> {
        let (mut at, mut natural) = ([0; D], [0.0; D]);
        for axis in 0..D {
            let edges: Vec<f64> =
                self.mesh.line_mm(axis).into_iter().step_by(self.mesh.order).collect();
            let last = edges.len() - 1;
            if !(place[axis] >= edges[0] && place[axis] <= edges[last]) {
                return None;
            }
            let cell = edges.partition_point(|x| *x <= place[axis]).clamp(1, last) - 1;
            let (low, high) = (edges[cell], edges[cell + 1]);
            (at[axis], natural[axis]) = (cell, (2.0 * place[axis] - low - high) / (high - low));
        }
        let e = at.iter().zip(self.mesh.elements).fold(0, |e, (i, count)| e * count + i);
        let nodes = self.nodes_of(e);
        let corners: Vec<[f64; D]> = nodes.iter().map(|k| self.mesh.nodes[*k as usize]).collect();
        let here = point(&corners, self.mesh.order, &natural)?;
        let mut strain = [0.0; D];
        for (slope, node) in here.slopes.iter().zip(nodes) {
            let moved = &response.nodes_mm[*node as usize];
            (0..D).for_each(|axis| strain[axis] += slope[axis] * moved[axis]);
        }
        let raw: f64 = strain.iter().sum();
        let shape = self.modes[e].at(place);
        let theta = self.dilatation(e, response);
        let mean: f64 = match self.kind {
            Kind::Plain => self.moduli.bulk * raw,
            Kind::MeanDilatation => {
                let stress =
                    |mode: usize| self.moduli.bulk * theta[mode] + response.pressure[e][mode];
                (0..DILATATION_MODES).map(|mode| shape[mode] * stress(mode)).sum()
            }
        };
        Some(strain.map(|part| mean + 2.0 * self.moduli.shear * (part - raw / 3.0)))
    }
}

impl Elements<2> {
    /// Reactions and base stress under the forces of a contact on this mesh's own compliances.
    /// Allocates.
    ///
    /// # Errors
    /// Forces that are not finite.
    pub fn response_to_contact(
        &self,
        normal: &[f64],
        tangential: &[f64],
    ) -> Result<Response, Invalid> {
        let forces: Vec<[f64; 2]> = normal.iter().zip(tangential).map(|(p, q)| [*q, -*p]).collect();
        forces.iter().flatten().try_for_each(|f| finite("forces", *f))?;
        let mut response = self.response();
        self.solve(&forces, &mut response);
        Ok(response)
    }
}

/// The matrices of one element; an error that names the element if it folds.
fn element_matrices<const D: usize>(
    mesh: &Mesh<D>,
    e: usize,
    nodes: &[u32],
    kind: Kind,
    moduli: Moduli,
) -> Result<Element<D>, Invalid> {
    let corners: Vec<[f64; D]> = nodes.iter().map(|k| mesh.nodes[*k as usize]).collect();
    element(&corners, mesh.order, kind, moduli).ok_or_else(|| {
        let what = format!("element {:?} folds", mesh.element_at(e));
        Invalid::new("mesh", what, "give convex elements")
    })
}

/// Numbers the equations in the order of elimination; displacements at the base and across rollers
/// have none.
fn number_equations<const D: usize>(mesh: &Mesh<D>, method: Method) -> (Vec<u32>, usize) {
    let counts = mesh.counts();
    let mut equations = vec![FIXED_EQUATION; mesh.nodes.len() * D];
    let mut next = 0;
    let mut visit = |at: [usize; D]| {
        if at[D - 1] == 0 {
            return;
        }
        for axis in 0..D {
            let end = [at[axis] == 0, at[axis] + 1 == counts[axis]];
            let held = axis + 1 < D
                && mesh.rollers[axis].iter().zip(end).any(|(roller, end)| *roller && end);
            if !held {
                equations[mesh.node(at) * D + axis] = next;
                next += 1;
            }
        }
    };
    match method {
        Method::Band => {
            // Along the axis of most nodes last: that keeps the band narrow.
            let mut axes: [usize; D] = core::array::from_fn(|axis| axis);
            axes.sort_by_key(|axis| core::cmp::Reverse(counts[*axis]));
            for node in 0..mesh.nodes.len() {
                let (mut at, mut rest) = ([0; D], node);
                for axis in axes.into_iter().rev() {
                    (at[axis], rest) = (rest % counts[axis], rest / counts[axis]);
                }
                visit(at);
            }
        }
        Method::Sparse => {
            dissect::elimination_order(counts, mesh.order).into_iter().for_each(visit)
        }
    }
    (equations, next as usize)
}

/// Refuses a factor of more than [`ENTRIES_MAX`] entries before it is allocated.
fn check_factor_size<const D: usize>(
    mesh: &Mesh<D>,
    method: Method,
    unknowns: usize,
    half: usize,
) -> Result<(), Invalid> {
    let entries = match method {
        Method::Band => unknowns as f64 * (half as f64 + 1.0),
        Method::Sparse => dissect::factor_entries_max(mesh.counts(), mesh.order),
    };
    if entries <= ENTRIES_MAX as f64 {
        return Ok(());
    }
    let what = format!(
        "{:?} elements of order {} keep {entries:.1e} numbers in their factor",
        mesh.elements, mesh.order
    );
    let remedy = format!("give fewer elements: at most {ENTRIES_MAX} numbers are kept");
    Err(Invalid::new("mesh", what, &remedy))
}

/// Largest distance of two equations of an element.
fn equation_distance<const D: usize>(nodes: &[u32], equations: &[u32]) -> usize {
    let all = nodes.iter().flat_map(|node| &equations[*node as usize * D..][..D]);
    let (low, high) = all
        .filter(|place| **place != FIXED_EQUATION)
        .fold((FIXED_EQUATION, 0), |(low, high), place| (low.min(*place), high.max(*place)));
    high.saturating_sub(low) as usize
}

fn add<const D: usize>(system: &mut System, one: &Element<D>, nodes: &[u32], equations: &[u32]) {
    let dofs = nodes.len() * D;
    let place = |dof: usize| equations[nodes[dof / D] as usize * D + dof % D];
    for (a, row) in one.stiffness.chunks_exact(dofs).enumerate() {
        for (b, value) in row.iter().enumerate() {
            let (row, column) = (place(a), place(b));
            if row != FIXED_EQUATION && column != FIXED_EQUATION {
                system.add(row as usize, column as usize, *value);
            }
        }
    }
}
