//! Solves the frictionless contact of a rigid body with the bricks of a layer, by an active set
//! over the surface's nodes. Each round solves for the forces on the nodes that are assumed to be
//! in contact; then nodes in tension leave the contact and nodes that overlap enter it. The method
//! ends when no node changes, so that complementarity holds to rounding. The displacements under a
//! unit force on a node are one solution of the mesh, computed when the node first touches and
//! kept.
//!
//! Heights that are no profile, forces without a profile over the mesh, and contacts that do not
//! converge in `ROUNDS_MAX` rounds are errors. Pressing allocates.

use super::layer::{Elements, Response};
use crate::numeric::band::Band;
use crate::space::Prescribed;
use crate::{Invalid, finite};

/// Most rounds of the active set, and the number of first rounds that may change many nodes at
/// once.
const ROUNDS_MAX: usize = 200;
const SIMULTANEOUS_ROUNDS: usize = 60;
/// Violation above which a node changes, in parts of the largest force and of the penetration.
const VIOLATION_TOLERANCE: f64 = 1e-11;

/// A rigid profile over a mesh.
#[derive(Clone, Debug)]
pub struct MeshContact {
    body: Elements<3>,
    heights_mm: Vec<f64>,
    /// Descent of every node of the surface under a unit force on one, where it was computed.
    influence: Vec<Option<Vec<f64>>>,
    touching: Vec<bool>,
    forces_n: Vec<f64>,
    penetration_mm: f64,
    residual: f64,
    response: Response<3>,
}

impl MeshContact {
    /// A profile over a body: heights over its lowest point at each column of the mesh, infinite
    /// where there is none.
    ///
    /// # Errors
    /// Heights of another number, NaN or below 0.
    pub fn new(body: Elements<3>, heights_mm: Vec<f64>) -> Result<Self, Invalid> {
        let count = body.mesh().columns();
        let bad = |h: &f64| h.is_nan() || *h < 0.0;
        if heights_mm.len() != count || heights_mm.iter().any(bad) {
            let what = format!("{} heights for {count} columns, or one below 0", heights_mm.len());
            return Err(Invalid::new("heights_mm", what, "give one height, 0 or more, a column"));
        }
        Ok(Self {
            influence: vec![None; count],
            touching: vec![false; count],
            forces_n: vec![0.0; count],
            penetration_mm: 0.0,
            residual: 0.0,
            response: body.response(),
            heights_mm,
            body,
        })
    }

    /// The same body under another profile, with the influences that are computed kept.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_profile(mut self, heights_mm: Vec<f64>) -> Result<Self, Invalid> {
        let influence = core::mem::take(&mut self.influence);
        let mut next = Self::new(self.body, heights_mm)?;
        next.influence = influence;
        Ok(next)
    }

    /// The mesh's elements.
    #[must_use]
    pub fn body(&self) -> &Elements<3> {
        &self.body
    }

    /// Forces on the layer in N, column by column.
    #[must_use]
    pub fn forces_n(&self) -> &[f64] {
        &self.forces_n
    }

    /// Descent of the lowest point in mm.
    #[must_use]
    pub fn penetration_mm(&self) -> f64 {
        self.penetration_mm
    }

    /// Largest violation in the last step of no tension and no overlap, in parts of the largest
    /// force and of the penetration.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.residual
    }

    /// Presses by force or by penetration, starting from the last contact. The force is that on
    /// this mesh: if the mesh is a part of a symmetric whole, it carries its part of the force.
    ///
    /// # Errors
    /// A drive that is not finite, a force below 0 or without a profile over the mesh, a contact
    /// that does not converge.
    pub fn press(&mut self, drive: Prescribed) -> Result<f64, Invalid> {
        let (Prescribed::ForceN(value) | Prescribed::PenetrationMm(value)) = drive;
        let by_force = matches!(drive, Prescribed::ForceN(_));
        let place = if by_force { "force_n" } else { "penetration_mm" };
        finite(place, value)?;
        if by_force && value < 0.0 {
            return Err(Invalid::new(place, format!("{value} pulls"), "give 0 or more"));
        }
        if value <= 0.0 {
            self.touching.fill(false);
            self.forces_n.fill(0.0);
            self.penetration_mm = if by_force { 0.0 } else { value };
            self.residual = 0.0;
            return Ok(0.0);
        }
        let Some(lowest) = self.lowest_column() else {
            let what = format!("{value} with no body over the layer");
            return Err(Invalid::new(place, what, "move the indenter over the layer"));
        };
        if !self.touching.iter().any(|t| *t) {
            self.touching[lowest] = true;
        }
        for round in 0..ROUNDS_MAX {
            if !self.solve(by_force, value)? {
                self.touching.fill(false);
                self.touching[lowest] = true;
                continue;
            }
            if self.update_contact(round) == 0 {
                return Ok(self.forces_n.iter().sum());
            }
            if !self.touching.iter().any(|t| *t) {
                // A body whose prescribed penetration is smaller than its height touches nothing.
                if !by_force && self.heights_mm[lowest] >= value {
                    self.forces_n.fill(0.0);
                    return Ok(0.0);
                }
                self.touching[lowest] = true;
            }
        }
        let what = format!("{value}: the touching nodes did not settle");
        Err(Invalid::new(place, what, "press in smaller steps"))
    }

    fn lowest_column(&self) -> Option<usize> {
        let with = self.heights_mm.iter().enumerate().filter(|(_, h)| h.is_finite());
        with.min_by(|a, b| a.1.total_cmp(b.1)).map(|(column, _)| column)
    }

    /// Forces and penetration of the present guess; false where it has no solution.
    fn solve(&mut self, by_force: bool, value: f64) -> Result<bool, Invalid> {
        let set: Vec<usize> = (0..self.touching.len()).filter(|i| self.touching[*i]).collect();
        set.iter().for_each(|column| self.compute_influence(*column));
        let mut matrix = Band::new(set.len(), set.len());
        let mut one = vec![1.0; set.len()];
        let mut high: Vec<f64> = set.iter().map(|i| self.heights_mm[*i]).collect();
        for (c, j) in set.iter().enumerate() {
            let Some(column) = &self.influence[*j] else { continue };
            for (r, i) in set.iter().enumerate().skip(c) {
                matrix.add(r, c, column[*i]);
            }
        }
        if !matrix.factor() {
            let what = "compliances that are not positive definite".to_owned();
            return Err(Invalid::new("mesh", what, "give elements of a better shape"));
        }
        matrix.solve(&mut one);
        matrix.solve(&mut high);
        let (stiffness, before): (f64, f64) = (one.iter().sum(), high.iter().sum());
        self.penetration_mm = if by_force { (value + before) / stiffness } else { value };
        self.forces_n.fill(0.0);
        for ((i, a), b) in set.iter().zip(&one).zip(&high) {
            self.forces_n[*i] = self.penetration_mm * a - b;
        }
        Ok(self.penetration_mm > 0.0)
    }

    /// Computes the descent of the surface under a unit force on a column, once.
    fn compute_influence(&mut self, column: usize) {
        if self.influence[column].is_some() {
            return;
        }
        let mut forces = vec![[0.0; 3]; self.heights_mm.len()];
        forces[column] = [0.0, 0.0, -1.0];
        self.body.solve(&forces, &mut self.response);
        let mesh = self.body.mesh();
        let down = |i: usize| -self.response.nodes_mm[mesh.surface_node(i)][2];
        self.influence[column] = Some((0..forces.len()).map(down).collect());
    }

    /// Removes nodes in tension from the contact and adds overlapping ones; returns how many
    /// changed.
    fn update_contact(&mut self, round: usize) -> usize {
        let most = self.forces_n.iter().fold(0.0_f64, |most, f| most.max(f.abs()));
        let mut surface = vec![0.0; self.touching.len()];
        for (force, column) in self.forces_n.iter().zip(&self.influence) {
            if let (true, Some(column)) = (*force != 0.0, column) {
                surface.iter_mut().zip(column).for_each(|(s, c)| *s += force * c);
            }
        }
        let deep = self.penetration_mm;
        let mut wrong: Vec<(f64, usize)> = Vec::new();
        for (i, moved) in surface.iter().enumerate() {
            let by = if self.touching[i] {
                -self.forces_n[i] / most
            } else {
                (deep - self.heights_mm[i] - moved) / deep
            };
            if by > VIOLATION_TOLERANCE {
                wrong.push((by, i));
            }
        }
        self.residual = wrong.iter().fold(0.0, |worst, (by, _)| by.max(worst));
        if round >= SIMULTANEOUS_ROUNDS {
            // Late rounds change only the first violating node, which cannot cycle (Murty's rule).
            wrong.truncate(1);
        }
        wrong.iter().for_each(|(_, i)| self.touching[*i] = !self.touching[*i]);
        wrong.len()
    }

    /// The response of the mesh to the last contact.
    #[must_use]
    pub fn response(&self) -> Response<3> {
        let forces: Vec<[f64; 3]> = self.forces_n.iter().map(|f| [0.0, 0.0, -*f]).collect();
        let mut response = self.body.response();
        self.body.solve(&forces, &mut response);
        response
    }
}
