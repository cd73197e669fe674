//! Meshes of quadrilaterals over a rectangle and of bricks over a block, of order 1 or 2. Nodes are
//! numbered across the thickness first, then along y (bricks), then along x. The last axis is z, 0
//! at the base. Edges that do not ascend and meshes of more than [`ELEMENTS_MAX`] elements are
//! errors here; elements that fold are found when they are assembled.

use crate::{Invalid, finite, positive};

/// Most elements of a mesh.
pub const ELEMENTS_MAX: usize = 400_000;

/// How the element treats the change of volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The dilatation of an element is its mean (B-bar, Hughes 1980), with order 2 its projection
    /// on the linear functions (Q2/P-1): does not lock.
    MeanDilatation,
    /// Full integration of everything: locks as nu nears 0.5; refuses 0.5 itself.
    Plain,
}

/// Nodes of a structured mesh in the plane (`D` = 2) or in space (3).
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh<const D: usize = 2> {
    /// Elements along each axis.
    pub elements: [usize; D],
    /// Order of the shape functions along each axis, 1 or 2.
    pub order: usize,
    /// Places of the nodes in mm.
    pub nodes: Vec<[f64; D]>,
    /// Sides on rollers, for the low and the high end of each axis: the displacement along that
    /// axis is 0 there. A plane of symmetry is such a side, and rollers at both ends of y make
    /// plane strain. Other sides are free; the values of z are ignored.
    pub rollers: [[bool; 2]; D],
}

impl<const D: usize> Mesh<D> {
    /// A mesh over edges along each axis, heights from 0 (base) to the thickness last; the nodes
    /// of order 2 lie midway. All sides are free.
    ///
    /// # Errors
    /// Fewer than 2 elements along or 1 across, edges that are not finite or do not ascend, a first
    /// height that is not 0, an order other than 1 and 2, too many elements.
    pub fn from_edges(edges_mm: [&[f64]; D], order: usize) -> Result<Self, Invalid> {
        let elements = edges_mm.map(|edges| edges.len().saturating_sub(1));
        check_size(&elements, order)?;
        for edges in edges_mm {
            edges.iter().try_for_each(|x| finite("mesh", *x))?;
            if !edges.windows(2).all(|w| w[0] < w[1]) {
                let what = "edges that do not ascend".to_owned();
                return Err(Invalid::new("mesh", what, "sort them, each once"));
            }
        }
        let lowest = edges_mm[D - 1][0];
        if lowest != 0.0 {
            let what = format!("heights from {lowest}");
            return Err(Invalid::new("mesh", what, "let the heights begin at 0, the base"));
        }
        let mut mesh = Self { elements, order, nodes: Vec::new(), rollers: [[false; 2]; D] };
        let place = |axis: usize, i: usize| {
            let edges = edges_mm[axis];
            let from = edges[i / order];
            if i.is_multiple_of(order) { from } else { 0.5 * (from + edges[i / order + 1]) }
        };
        let count = mesh.counts().iter().product();
        let of = |node: usize| {
            let at = mesh.at(node);
            core::array::from_fn(|axis| place(axis, at[axis]))
        };
        mesh.nodes = (0..count).map(of).collect();
        Ok(mesh)
    }

    /// The checks of [`Self::from_edges`], for a mesh whose fields were changed directly.
    ///
    /// # Errors
    /// Fewer than 2 elements along or 1 across, too many, an order other than 1 and 2, nodes of
    /// another number or not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        check_size(&self.elements, self.order)?;
        let wanted: usize = self.counts().iter().product();
        if self.nodes.len() != wanted {
            let what = format!("{} nodes for {:?} elements", self.nodes.len(), self.elements);
            let remedy = format!("give {wanted} of them with order {}", self.order);
            return Err(Invalid::new("mesh", what, &remedy));
        }
        self.nodes.iter().flatten().try_for_each(|x| finite("mesh", *x))
    }

    /// The same mesh with an end of an axis on rollers (0 the low end, 1 the high one). An axis or
    /// an end that a mesh of `D` axes does not have changes nothing.
    #[must_use]
    pub fn with_rollers(mut self, axis: usize, end: usize) -> Self {
        if let Some(roller) = self.rollers.get_mut(axis).and_then(|ends| ends.get_mut(end)) {
            *roller = true;
        }
        self
    }

    /// Nodes along each axis.
    #[must_use]
    pub fn counts(&self) -> [usize; D] {
        self.elements.map(|n| self.order.saturating_mul(n).saturating_add(1))
    }

    /// Number of the node at these places along the axes.
    #[must_use]
    pub fn node(&self, at: [usize; D]) -> usize {
        let next = |node: usize, (i, count): (&usize, usize)| {
            node.saturating_mul(count).saturating_add(*i)
        };
        at.iter().zip(self.counts()).fold(0, next)
    }

    /// Places along the axes of a node.
    #[must_use]
    pub fn at(&self, node: usize) -> [usize; D] {
        let mut rest = node;
        let mut at = [0; D];
        for (slot, count) in at.iter_mut().zip(self.counts()).rev() {
            (*slot, rest) = (rest % count, rest / count);
        }
        at
    }

    /// Places along the axes of an element, numbered as the nodes are.
    pub(super) fn element_at(&self, element: usize) -> [usize; D] {
        let mut rest = element;
        let mut at = [0; D];
        for (slot, count) in at.iter_mut().zip(self.elements).rev() {
            (*slot, rest) = (rest % count, rest / count);
        }
        at
    }

    /// The nodes of an element, across the thickness first. Allocates.
    pub(super) fn nodes_of(&self, element: usize) -> Vec<usize> {
        let first = self.element_at(element).map(|i| i * self.order);
        let wide = self.order + 1;
        let node = |local: usize| {
            let mut rest = local;
            let mut at = first;
            for slot in at.iter_mut().rev() {
                *slot += rest % wide;
                rest /= wide;
            }
            self.node(at)
        };
        (0..wide.pow(D as u32)).map(node).collect()
    }

    /// Nodes of the surface, and of the base.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.nodes.len() / self.counts()[D - 1]
    }

    /// The base's node of a column.
    #[must_use]
    pub fn base_node(&self, column: usize) -> usize {
        column * self.counts()[D - 1]
    }

    /// The surface's node of a column.
    #[must_use]
    pub fn surface_node(&self, column: usize) -> usize {
        (column + 1) * self.counts()[D - 1] - 1
    }

    /// Places along an axis of the nodes in the row of node 0, in mm; none along an axis that a
    /// mesh of `D` axes does not have.
    #[must_use]
    pub fn line_mm(&self, axis: usize) -> Vec<f64> {
        let at = |i: usize| {
            let mut at = [0; D];
            at[axis] = i;
            self.nodes.get(self.node(at)).map(|place| place[axis])
        };
        let count = self.counts().get(axis).copied().unwrap_or(0);
        (0..count).map_while(at).collect()
    }

    /// Length or area that each column's node of the base represents: the integral of its shape
    /// function over the base, in mm (plane) or mm^2.
    #[must_use]
    pub fn base_weights(&self) -> Vec<f64> {
        let lines: Vec<Vec<f64>> =
            (0..D - 1).map(|axis| line_weights(&self.line_mm(axis), self.order)).collect();
        let share = |column: usize| {
            let at = self.at(self.base_node(column));
            (0..D - 1).map(|axis| lines[axis][at[axis]]).product()
        };
        (0..self.columns()).map(share).collect()
    }
}

impl Mesh<2> {
    /// A mesh of order 1 over edges along x and heights from 0 (base) to the thickness.
    ///
    /// # Errors
    /// As [`Self::from_edges`].
    pub fn rectangle(x_mm: &[f64], z_mm: &[f64]) -> Result<Self, Invalid> {
        Self::from_edges([x_mm, z_mm], 1)
    }

    /// Equal elements of order 1 over a width centred on x = 0.
    ///
    /// # Errors
    /// As [`Self::from_edges`]; sizes that are not finite and above 0.
    pub fn uniform(
        width_mm: f64,
        thickness_mm: f64,
        nx: usize,
        nz: usize,
    ) -> Result<Self, Invalid> {
        Self::graded(width_mm, thickness_mm, nx, nz, 0.0)
    }

    /// Elements that are finer around x = 0: their widths grow in proportion to 1 + `grading`
    /// x^2/(width/2)^2.
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
        check_size(&[nx, nz], 1)?;
        let half = graded_edges(0.5 * width_mm, nx, grading)?;
        let place = |i: usize| if 2 * i < nx { -half[nx - 2 * i] } else { half[2 * i - nx] };
        let x: Vec<f64> = (0..=nx).map(place).collect();
        let z = graded_edges(thickness_mm, nz, 0.0)?;
        Self::rectangle(&x, &z)
    }

    /// x of the nodes along a row, j = 0 the base; none along a row that there is not.
    #[must_use]
    pub fn row_mm(&self, j: usize) -> Vec<f64> {
        let [along, across] = self.counts();
        let at = |i: usize| self.nodes.get(self.node([i, j])).map(|place| place[0]);
        (0..if j < across { along } else { 0 }).map_while(at).collect()
    }

    /// Length of a row that each of its nodes represents: the integral of its shape function, with
    /// order 1 half its two neighbours' distance.
    #[must_use]
    pub fn widths_mm(&self, j: usize) -> Vec<f64> {
        line_weights(&self.row_mm(j), self.order)
    }
}

impl Mesh<3> {
    /// Bricks over edges along x, along y and heights from 0 (base) to the thickness.
    ///
    /// # Errors
    /// As [`Self::from_edges`].
    pub fn block(x_mm: &[f64], y_mm: &[f64], z_mm: &[f64], order: usize) -> Result<Self, Invalid> {
        Self::from_edges([x_mm, y_mm, z_mm], order)
    }
}

/// Edges from 0 to a length that are closer at 0: the steps grow in proportion to 1 + `grading`
/// s^2, s being the part of the steps taken so far; a grading of 0 makes equal steps.
///
/// # Errors
/// A length that is not finite and above 0, no step or more than [`ELEMENTS_MAX`] times 2, a
/// grading that is not finite or below 0.
pub fn graded_edges(length_mm: f64, count: usize, grading: f64) -> Result<Vec<f64>, Invalid> {
    positive("length_mm", length_mm)?;
    finite("grading", grading)?;
    if grading < 0.0 {
        let what = format!("{grading} is below 0");
        return Err(Invalid::new("grading", what, "give 0 for equal elements, or more"));
    }
    if !(1..=2 * ELEMENTS_MAX).contains(&count) {
        let what = format!("{count} steps along an axis");
        return Err(Invalid::new("mesh", what, "give at least 1, at most 800000"));
    }
    let place = |i: usize| {
        let s = i as f64 / count as f64;
        length_mm * s * (1.0 + grading * s * s / 3.0) / (1.0 + grading / 3.0)
    };
    Ok((0..=count).map(place).collect())
}

fn check_size(elements: &[usize], order: usize) -> Result<(), Invalid> {
    let all = elements.iter().fold(1_usize, |all, n| all.saturating_mul(*n));
    let (across, along) = (elements[elements.len() - 1], &elements[..elements.len() - 1]);
    let least = if elements.len() == 2 { 2 } else { 1 };
    if across < 1 || along.iter().any(|n| *n < least) || all > ELEMENTS_MAX {
        let what = format!("{elements:?} elements");
        let remedy = "give at least 2 by 1 (in space 1 by 1 by 1), at most 400000";
        return Err(Invalid::new("mesh", what, remedy));
    }
    if !(1..=2).contains(&order) {
        return Err(Invalid::new("order", format!("{order}"), "give 1 or 2"));
    }
    Ok(())
}

/// Integrals of the shape functions along a line of nodes.
fn line_weights(x: &[f64], order: usize) -> Vec<f64> {
    let mut out = vec![0.0; x.len()];
    for start in (0..x.len().saturating_sub(order)).step_by(order) {
        let length = x[start + order] - x[start];
        let parts: &[f64] =
            if order == 1 { &[0.5, 0.5] } else { &[1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0] };
        for (slot, part) in out[start..].iter_mut().zip(parts) {
            *slot += part * length;
        }
    }
    out
}
