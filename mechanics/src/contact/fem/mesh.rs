//! Meshes of quadrilaterals over a rectangle, nodes numbered across the thickness first.

use crate::contact::{Invalid, finite, positive};

/// Most elements of a mesh.
pub const ELEMENTS_MAX: usize = 400_000;

/// How the element treats the change of volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One mean dilatation an element (B-bar): does not lock.
    MeanDilatation,
    /// Full integration of everything: locks as nu nears 0.5; refuses 0.5 itself.
    Plain,
}

/// Nodes of a structured mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Elements along x.
    pub nx: usize,
    /// Elements across the thickness.
    pub nz: usize,
    /// x and z of each node in mm; node (i, j) is i (nz + 1) + j, j = 0 at the base.
    pub nodes: Vec<[f64; 2]>,
}

impl Mesh {
    /// A mesh over edges along x and heights from 0 (base) to the thickness.
    ///
    /// # Errors
    /// Fewer than 2 elements along or 1 across, edges that are not finite or do not ascend, a first
    /// height that is not 0, too many elements.
    pub fn of_edges(x_mm: &[f64], z_mm: &[f64]) -> Result<Self, Invalid> {
        let (nx, nz) = (x_mm.len().saturating_sub(1), z_mm.len().saturating_sub(1));
        if nx < 2 || nz < 1 || nx.saturating_mul(nz) > ELEMENTS_MAX {
            let what = format!("{nx} by {nz} elements");
            return Err(Invalid::new("mesh", what, "give at least 2 by 1, at most 400000"));
        }
        for edges in [x_mm, z_mm] {
            edges.iter().try_for_each(|x| finite("mesh", *x))?;
            if !edges.windows(2).all(|w| w[0] < w[1]) {
                let what = "edges that do not ascend".to_owned();
                return Err(Invalid::new("mesh", what, "sort them, each once"));
            }
        }
        if z_mm[0] != 0.0 {
            let what = format!("heights from {}", z_mm[0]);
            return Err(Invalid::new("mesh", what, "let the heights begin at 0, the base"));
        }
        let column = |x: &f64| z_mm.iter().map(|z| [*x, *z]).collect::<Vec<_>>();
        Ok(Self { nx, nz, nodes: x_mm.iter().flat_map(column).collect() })
    }

    /// Equal elements over a width centred on x = 0.
    ///
    /// # Errors
    /// As [`Self::of_edges`]; sizes that are not finite and above 0.
    pub fn uniform(
        width_mm: f64,
        thickness_mm: f64,
        nx: usize,
        nz: usize,
    ) -> Result<Self, Invalid> {
        Self::graded(width_mm, thickness_mm, nx, nz, 0.0)
    }

    /// Elements gathered around x = 0: widths grow in proportion to 1 + `grading` x^2/(width/2)^2.
    ///
    /// # Errors
    /// As [`Self::uniform`]; a grading that is not finite or below 0.
    pub fn graded(
        width_mm: f64,
        thickness_mm: f64,
        nx: usize,
        nz: usize,
        grading: f64,
    ) -> Result<Self, Invalid> {
        positive("width_mm", width_mm)?;
        positive("thickness_mm", thickness_mm)?;
        finite("grading", grading)?;
        if grading < 0.0 {
            let what = format!("{grading} is below 0");
            return Err(Invalid::new("grading", what, "give 0 for equal elements, or more"));
        }
        if nx.saturating_mul(nz) > ELEMENTS_MAX {
            let what = format!("{nx} by {nz} elements");
            return Err(Invalid::new("mesh", what, "give at most 400000"));
        }
        let place = |i: usize| {
            let s = 2.0 * i as f64 / nx as f64 - 1.0;
            0.5 * width_mm * s * (1.0 + grading * s * s / 3.0) / (1.0 + grading / 3.0)
        };
        let x: Vec<f64> = (0..=nx).map(place).collect();
        let z: Vec<f64> = (0..=nz).map(|j| thickness_mm * j as f64 / nz as f64).collect();
        Self::of_edges(&x, &z)
    }

    /// Number of node (i, j).
    #[must_use]
    pub fn node(&self, i: usize, j: usize) -> usize {
        i * (self.nz + 1) + j
    }

    /// The four nodes of element (i, j), anticlockwise.
    #[must_use]
    pub fn corners(&self, i: usize, j: usize) -> [usize; 4] {
        let (a, b) = (self.node(i, j), self.node(i + 1, j));
        [a, b, b + 1, a + 1]
    }

    /// x of the nodes along a row, j = 0 the base, `nz` the surface.
    #[must_use]
    pub fn row_mm(&self, j: usize) -> Vec<f64> {
        (0..=self.nx).map(|i| self.nodes[self.node(i, j)][0]).collect()
    }

    /// What of a row each of its nodes stands for: half its two neighbours' distance.
    #[must_use]
    pub fn widths_mm(&self, j: usize) -> Vec<f64> {
        let x = self.row_mm(j);
        let last = x.len() - 1;
        (0..=last).map(|i| 0.5 * (x[(i + 1).min(last)] - x[i.saturating_sub(1)])).collect()
    }
}
