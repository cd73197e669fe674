//! Numerical methods without any mechanics in them: linear systems, quadrature, orthogonal
//! polynomials, Bessel functions, interpolation, root searches and loops for wide registers.
//!
//! Where two methods of one kind stand side by side, each says why the other does not replace it:
//! the sums of the contact solvers are pinned to the last bit and their instructions are counted,
//! so that two orders of summation remain two functions.

pub(crate) mod band;
pub(crate) mod bessel;
pub(crate) mod cholesky;
pub(crate) mod cubic_hermite;
pub(crate) mod elimination;
pub(crate) mod interpolation;
pub(crate) mod jacobi;
pub(crate) mod product;
pub(crate) mod quadrature;
pub(crate) mod roots;
pub(crate) mod wide;
