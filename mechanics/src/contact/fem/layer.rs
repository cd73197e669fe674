//! The assembled layer: factored once, solved for any forces on its surface. Solving does not
//! allocate.

use super::band::Band;
use super::element::{Element, element};
use super::mesh::{Kind, Mesh};
use crate::contact::layer::Layer;
use crate::contact::plane::bed::Bed;
use crate::contact::{Invalid, finite};

/// Largest ratio of bulk to shear modulus that goes into the matrix; beyond it the pressure is
/// found by augmented Lagrange steps.
const STIFFEST: f64 = 2e3;
/// Those steps, at most, and the change of pressure at which they end.
const STEPS: usize = 60;
const SETTLED: f64 = 1e-13;

/// A mesh of a layer, factored.
#[derive(Clone, Debug)]
pub struct Elements {
    mesh: Mesh,
    shear_mpa: f64,
    /// Bulk modulus in the matrix, and what is still missing: 1/K - 1/K_matrix.
    bulk_mpa: f64,
    compliance_left: f64,
    kind: Kind,
    band: Band,
    elements: Vec<Element>,
}

/// What a load does.
#[derive(Clone, Debug)]
pub struct Response {
    /// Displacement x, z of each node in mm.
    pub nodes_mm: Vec<[f64; 2]>,
    /// Force of the base on each of its nodes, x and z, in N/mm.
    pub reactions: Vec<[f64; 2]>,
    /// Mean stress times -1 of each element that the steps added, in MPa.
    pressure: Vec<f64>,
    side: Vec<f64>,
    load: Vec<f64>,
    /// Augmented steps taken.
    pub steps: usize,
}

impl Elements {
    /// Assembles and factors; the thickness of `layer` is that of the mesh.
    ///
    /// # Errors
    /// A layer that its check refuses; elements that fold; the plain element at nu = 0.5.
    pub fn new(layer: &Layer, mesh: Mesh, kind: Kind) -> Result<Self, Invalid> {
        layer.check()?;
        let g = layer.shear_mpa();
        // K = 2 G (1 + nu)/(3 (1 - 2 nu)).
        let inverse = 3.0 * (1.0 - 2.0 * layer.poisson) / (2.0 * g * (1.0 + layer.poisson));
        if kind == Kind::Plain && inverse == 0.0 {
            let what = "0.5 makes the plain element infinitely stiff".to_owned();
            return Err(Invalid::new("poisson", what, "take the mean dilatation"));
        }
        let softest = 1.0 / (STIFFEST * g);
        let in_matrix = if kind == Kind::Plain { inverse } else { inverse.max(softest) };
        let size = 2 * mesh.nz * (mesh.nx + 1);
        let mut out = Self {
            shear_mpa: g,
            bulk_mpa: 1.0 / in_matrix,
            compliance_left: inverse - in_matrix,
            kind,
            band: Band::new(size, 2 * mesh.nz + 3),
            elements: Vec::with_capacity(mesh.nx * mesh.nz),
            mesh,
        };
        out.assemble()?;
        if out.band.factor() {
            return Ok(out);
        }
        let what = "a stiffness matrix that is not positive definite".to_owned();
        Err(Invalid::new("mesh", what, "give elements of a better shape"))
    }

    fn assemble(&mut self) -> Result<(), Invalid> {
        for i in 0..self.mesh.nx {
            for j in 0..self.mesh.nz {
                let corners = self.mesh.corners(i, j);
                let Some(one) = element(&corners.map(|k| self.mesh.nodes[k])) else {
                    let what = format!("element {i}, {j} folds");
                    return Err(Invalid::new("mesh", what, "give convex quadrilaterals"));
                };
                let places: [Option<usize>; 8] =
                    core::array::from_fn(|k| self.free(corners[k / 2], k % 2));
                for (a, row) in places.iter().enumerate() {
                    for (b, column) in places.iter().enumerate() {
                        if let (Some(row), Some(column)) = (row, column) {
                            self.band.add(*row, *column, self.entry(&one, a, b));
                        }
                    }
                }
                self.elements.push(one);
            }
        }
        Ok(())
    }

    fn entry(&self, one: &Element, a: usize, b: usize) -> f64 {
        let volume = match self.kind {
            Kind::MeanDilatation => one.area * one.mean[a] * one.mean[b],
            Kind::Plain => one.volume[a][b],
        };
        self.shear_mpa * one.shear[a][b] + self.bulk_mpa * volume
    }

    /// Equation of a node's displacement; none at the base.
    fn free(&self, node: usize, axis: usize) -> Option<usize> {
        let (i, j) = (node / (self.mesh.nz + 1), node % (self.mesh.nz + 1));
        (j > 0).then(|| 2 * (i * self.mesh.nz + j - 1) + axis)
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Unknowns of the system.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.band.size()
    }

    /// An empty response to fill again and again.
    #[must_use]
    pub fn response(&self) -> Response {
        Response {
            nodes_mm: vec![[0.0; 2]; self.mesh.nodes.len()],
            reactions: vec![[0.0; 2]; self.mesh.nx + 1],
            pressure: vec![0.0; self.elements.len()],
            side: vec![0.0; self.band.size()],
            load: vec![0.0; self.band.size()],
            steps: 0,
        }
    }

    /// Solves for forces on the nodes of the surface, left to right, x and z up, in N/mm. What is
    /// missing counts as 0. Does not allocate.
    pub fn solve(&self, surface_n_mm: &[[f64; 2]], out: &mut Response) {
        out.load.fill(0.0);
        for (i, force) in surface_n_mm.iter().take(self.mesh.nx + 1).enumerate() {
            let node = self.mesh.node(i, self.mesh.nz);
            for (axis, value) in force.iter().enumerate() {
                if let Some(place) = self.free(node, axis) {
                    out.load[place] = *value;
                }
            }
        }
        out.pressure.fill(0.0);
        out.side.copy_from_slice(&out.load);
        self.band.solve(&mut out.side);
        out.steps = 0;
        while self.compliance_left != 0.0 && out.steps < STEPS {
            out.steps += 1;
            if self.augment(out) < SETTLED {
                break;
            }
        }
        self.spread(out);
    }

    /// Raises the pressures by what the dilatation is too large, and solves again; the largest
    /// change of a pressure relative to the largest pressure.
    fn augment(&self, out: &mut Response) -> f64 {
        let (mut change, mut largest) = (0.0_f64, f64::MIN_POSITIVE);
        self.spread_displacements(out);
        for e in 0..self.elements.len() {
            let theta = self.dilatation(e, out);
            // Mean stress in all: K_m theta + added; wanted is theta = stress/K.
            let stress = self.bulk_mpa * theta + out.pressure[e];
            let excess = theta - stress * (self.compliance_left + 1.0 / self.bulk_mpa);
            let step = self.bulk_mpa * excess;
            out.pressure[e] += step;
            change = change.max(step.abs());
            largest = largest.max(stress.abs());
        }
        out.side.copy_from_slice(&out.load);
        for e in 0..self.elements.len() {
            let one = &self.elements[e];
            let corners = self.corners_of(e);
            for k in 0..8 {
                if let Some(place) = self.free(corners[k / 2], k % 2) {
                    out.side[place] -= out.pressure[e] * one.area * one.mean[k];
                }
            }
        }
        self.band.solve(&mut out.side);
        change / largest
    }

    fn corners_of(&self, e: usize) -> [usize; 4] {
        self.mesh.corners(e / self.mesh.nz, e % self.mesh.nz)
    }

    fn dilatation(&self, e: usize, out: &Response) -> f64 {
        let corners = self.corners_of(e);
        let mean = &self.elements[e].mean;
        (0..8).map(|k| mean[k] * out.nodes_mm[corners[k / 2]][k % 2]).sum()
    }

    fn spread_displacements(&self, out: &mut Response) {
        for node in 0..self.mesh.nodes.len() {
            for axis in 0..2 {
                out.nodes_mm[node][axis] =
                    self.free(node, axis).map_or(0.0, |place| out.side[place]);
            }
        }
    }

    /// Displacements and reactions from the solution.
    fn spread(&self, out: &mut Response) {
        self.spread_displacements(out);
        out.reactions.fill([0.0; 2]);
        for i in 0..self.mesh.nx {
            let e = i * self.mesh.nz;
            let corners = self.corners_of(e);
            let forces = self.forces(e, &corners.map(|k| out.nodes_mm[k]), out.pressure[e]);
            for axis in 0..2 {
                out.reactions[i][axis] += forces[axis];
                out.reactions[i + 1][axis] += forces[2 + axis];
            }
        }
    }

    /// Forces that hold an element at displacements of its corners, under an added mean stress.
    fn forces(&self, e: usize, corners: &[[f64; 2]; 4], added: f64) -> [f64; 8] {
        let one = &self.elements[e];
        core::array::from_fn(|a| {
            let elastic: f64 = (0..8).map(|b| self.entry(one, a, b) * corners[b / 2][b % 2]).sum();
            elastic + added * one.area * one.mean[a]
        })
    }

    /// Forces that hold all nodes at given displacements, for the patch test. Allocates.
    #[must_use]
    pub fn holding_forces(&self, nodes_mm: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; self.mesh.nodes.len()];
        for e in 0..self.elements.len() {
            let corners = self.corners_of(e);
            let forces = self.forces(e, &corners.map(|k| nodes_mm[k]), 0.0);
            for k in 0..8 {
                out[corners[k / 2]][k % 2] += forces[k];
            }
        }
        out
    }

    /// Normal stress at the base's nodes in MPa: reactions over what each node stands for, which
    /// keeps every moment and converges at second order. Allocates.
    #[must_use]
    pub fn base_szz_mpa(&self, response: &Response) -> Vec<f64> {
        let widths = self.mesh.widths_mm(0);
        response.reactions.iter().zip(widths).map(|(r, w)| -r[1] / w).collect()
    }

    /// The compliances of the surface's nodes, for the contact solver. Allocates.
    ///
    /// # Errors
    /// More nodes than a bed may have.
    pub fn bed(&self) -> Result<Bed, Invalid> {
        let n = self.mesh.nx + 1;
        if n > crate::contact::plane::bed::CELLS_MAX {
            let what = format!("{n} nodes on the surface");
            return Err(Invalid::new("mesh", what, "give at most 999 elements along"));
        }
        let zeros = || vec![0.0; n * n];
        let mut bed = Bed {
            x_mm: self.mesh.row_mm(self.mesh.nz),
            width_mm: self.mesh.widths_mm(self.mesh.nz),
            down_per_p: zeros(),
            down_per_q: zeros(),
            along_per_p: zeros(),
            along_per_q: zeros(),
        };
        let mut response = self.response();
        let mut forces = vec![[0.0; 2]; n];
        for j in 0..n {
            forces[j] = [0.0, -1.0];
            self.solve(&forces, &mut response);
            for i in 0..n {
                let [x, z] = response.nodes_mm[self.mesh.node(i, self.mesh.nz)];
                (bed.down_per_p[i * n + j], bed.along_per_p[i * n + j]) = (-z, x);
            }
            forces[j] = [1.0, 0.0];
            self.solve(&forces, &mut response);
            for i in 0..n {
                let [x, z] = response.nodes_mm[self.mesh.node(i, self.mesh.nz)];
                (bed.down_per_q[i * n + j], bed.along_per_q[i * n + j]) = (-z, x);
            }
            forces[j] = [0.0; 2];
        }
        Ok(bed)
    }

    /// Reactions and base stress under the forces of a contact on this mesh's own bed. Allocates.
    ///
    /// # Errors
    /// Forces that are not finite.
    pub fn under(&self, normal: &[f64], tangential: &[f64]) -> Result<Response, Invalid> {
        let forces: Vec<[f64; 2]> = normal.iter().zip(tangential).map(|(p, q)| [*q, -*p]).collect();
        forces.iter().flatten().try_for_each(|f| finite("forces", *f))?;
        let mut response = self.response();
        self.solve(&forces, &mut response);
        Ok(response)
    }
}
