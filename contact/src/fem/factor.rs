//! The factored stiffness: a banded Cholesky factor ([`crate::numeric::band`]) where a thin section
//! has few nodes across, and in space the sparse Cholesky factor of nalgebra-sparse in the order of
//! nested dissection. Neither is used inside control periods.

use crate::numeric::band::{Band, SIDES_AT_ONCE};
use nalgebra::DMatrixViewMut;
use nalgebra_sparse::factorization::CscCholesky;
use nalgebra_sparse::{CooMatrix, CscMatrix};

/// Most numbers that a factor may hold, a quarter of a gigabyte. For a sparse factor an upper bound
/// is compared with it before anything is allocated.
pub const ENTRIES_MAX: usize = 1 << 25;

/// How to factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Nodes numbered across the axes of fewest nodes first, a banded factor.
    Band,
    /// Nested dissection, a sparse factor.
    Sparse,
}

/// A symmetric positive definite system while it is put together.
pub(super) enum System {
    Band(Band),
    Sparse(CooMatrix<f64>),
}

impl System {
    pub(super) fn new(method: Method, size: usize, half: usize) -> Self {
        match method {
            Method::Band => Self::Band(Band::new(size, half)),
            Method::Sparse => Self::Sparse(CooMatrix::new(size, size)),
        }
    }

    /// Adds an entry; both triangles are given.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        match self {
            Self::Band(band) => band.add(row, column, value),
            Self::Sparse(entries) => entries.push(row, column, value),
        }
    }

    /// The factor; `None` where the matrix is not positive definite.
    pub(super) fn factor(self) -> Option<Factor> {
        match self {
            Self::Band(mut band) => band.factor().then_some(Factor::Band(band)),
            Self::Sparse(entries) => {
                let matrix = CscMatrix::from(&entries);
                drop(entries);
                CscCholesky::factor(&matrix).ok().map(|factor| Factor::Sparse(Box::new(factor)))
            }
        }
    }
}

/// The factor.
#[derive(Clone, Debug)]
pub(super) enum Factor {
    Band(Band),
    Sparse(Box<CscCholesky<f64>>),
}

impl Factor {
    /// Number of stored entries.
    pub(super) fn entries(&self) -> usize {
        match self {
            Self::Band(band) => band.entries(),
            Self::Sparse(factor) => factor.l().nnz(),
        }
    }

    /// Solves in place.
    pub(super) fn solve(&self, side: &mut [f64]) {
        match self {
            Self::Band(band) => band.solve(side),
            Self::Sparse(factor) => {
                let count = side.len();
                factor.solve_mut(DMatrixViewMut::from_slice(side, count, 1));
            }
        }
    }

    /// Solves several right sides in place; the sparse factor one by one, and with an allocation.
    pub(super) fn solve_many(&self, side: &mut [[f64; SIDES_AT_ONCE]]) {
        if let Self::Band(band) = self {
            return band.solve_many(side);
        }
        for index in 0..SIDES_AT_ONCE {
            let mut one: Vec<f64> = side.iter().map(|s| s[index]).collect();
            self.solve(&mut one);
            side.iter_mut().zip(one).for_each(|(s, one)| s[index] = one);
        }
    }
}
