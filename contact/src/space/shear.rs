//! Computes what a tangential load does to the bonded layer, or to a stack of layers, in three
//! dimensions: the displacement of the surface and the normal stress at the base.
//!
//! The component of a tangential traction along its wave vector follows the plane problem, with T
//! and N of [`super::super::layer`]. Under the component across the wave vector the layer is in
//! pure shear: u_hat = tanh(k t)/(G k) q_hat. The inverse transforms are Hankel transforms of
//! order 0, 1 and 2; the one of order 2 follows from the others by J2 = 2 J1(y)/y - J0. The
//! solution of the half space (Cerruti; Johnson, Contact Mechanics, 1985, section 3.6) stays in
//! closed form and only the difference from it is tabulated. nu = 0.5 needs no special case.
//!
//! The frame is that of [`super`]. A load Q > 0 pushes the layer along +x; a displacement w > 0 is
//! downwards. Contacts with stick and slip are solved in [`super::grip`].

use super::super::Invalid;
use super::super::layer::Layer;
use super::super::stack::Stack;
use super::ground::{Ground, Sizes, tanh_over};
use super::radial::{Grid, images, images_mean, line_of_sight, love, means, over_cell, slopes};
use super::table::Even;
use core::f64::consts::PI;

/// Table points per thickness.
const POINTS_PER_THICKNESS: f64 = 64.0;

/// The Hankel transforms of one function g, tabulated over the distance r in thicknesses.
#[derive(Clone, Debug)]
struct HankelTables {
    /// Order 0: f(r) = integral of a g(a) J0(a r).
    order_0: Even,
    /// Order 1 over r: integral of g(a) J1(a r), divided by r, which is (1/r^2) times the integral
    /// of s f(s) from 0 to r.
    order_1_over_r: Even,
}

impl HankelTables {
    fn new(g: impl Fn(f64) -> f64, cutoff: f64, grid: Grid) -> Self {
        Self::with_addition(g, cutoff, grid, |_| [0.0; 2])
    }

    /// The tables of g plus another function, whose transforms of order 0 and of order 1 over r
    /// `addition` gives in closed form at a distance.
    fn with_addition(
        g: impl Fn(f64) -> f64,
        cutoff: f64,
        grid: Grid,
        addition: impl Fn(f64) -> [f64; 2],
    ) -> Self {
        let mut order_0 = line_of_sight(&slopes(&g, cutoff, grid), grid);
        let mut order_1_over_r = means(g, cutoff, grid);
        for (i, (zeroth, first)) in order_0.iter_mut().zip(&mut order_1_over_r).enumerate() {
            let [zeroth_added, first_added] = addition(i as f64 / POINTS_PER_THICKNESS);
            // `line_of_sight` gives half the transform of order 0.
            (*zeroth, *first) = (2.0 * *zeroth + zeroth_added, *first + first_added);
        }
        Self {
            order_0: Even::new(&order_0, POINTS_PER_THICKNESS),
            order_1_over_r: Even::new(&order_1_over_r, POINTS_PER_THICKNESS),
        }
    }

    /// Order 2: the integral of a g(a) J2(a r).
    fn order_2(&self, r: f64) -> f64 {
        2.0 * self.order_1_over_r.at(r) - self.order_0.at(r)
    }
}

/// A load along the surface at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TangentialLoad {
    /// Its place (mm), x along the columns.
    pub place_mm: [f64; 2],
    /// Its components along x and y (N).
    pub force_n: [f64; 2],
}

/// Influence of tangential loads along x on a [`Layer`] or a [`Stack`], in mm, N and MPa.
#[derive(Clone, Debug)]
pub struct Shear {
    sizes: Sizes,
    /// Transforms of the compliance along the wave vector minus the compliance across it.
    along: HankelTables,
    /// Transforms of the compliance across the wave vector minus 1/a, that of the half space.
    across: HankelTables,
    /// Transforms of the coupling N minus its limit for short waves.
    coupling: HankelTables,
    /// (1/r) integral of a B(a) J1(a r), where B is the base stress per traction.
    base: Even,
}

impl Shear {
    /// Tabulates the kernels of a layer; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses.
    pub fn new(layer: &Layer) -> Result<Self, Invalid> {
        Ok(Self::of(&Ground::layer(layer)?))
    }

    /// Tabulates the kernels of several layers; allocates. The time grows as the square of the
    /// distance, in thicknesses of the surface layer, that the stack's fields reach.
    ///
    /// # Errors
    /// A surface layer too thin against the distance at which the stack's fields die.
    pub fn of_stack(stack: &Stack) -> Result<Self, Invalid> {
        Ok(Self::of(&Ground::stack(stack)?))
    }

    fn of(ground: &Ground) -> Self {
        let grid = Grid { reach: ground.reach, density: POINTS_PER_THICKNESS };
        let [base, surface] = ground.cutoffs();
        let far_out = ground.coupling_far_out();
        // The transform of tanh(a)/a is known in closed form: it is the sum over the images.
        let across = |a: f64| ground.across(a) - tanh_over(a);
        Self {
            sizes: ground.sizes,
            along: HankelTables::new(|a| ground.tangential(a) - ground.across(a), surface, grid),
            across: HankelTables::with_addition(across, surface, grid, |r| {
                [images(r), images_mean(r)]
            }),
            coupling: HankelTables::new(|a| ground.coupling(a) - far_out, surface, grid),
            base: Even::new(
                &means(|a| a * ground.base_from_tangential(a), base, grid),
                POINTS_PER_THICKNESS,
            ),
        }
    }

    /// The layer at the surface.
    #[must_use]
    pub fn layer(&self) -> &Layer {
        &self.sizes.surface
    }

    /// Thickness and range of the layer or stack.
    pub(super) fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// Displacements along x, along y and downwards at (x, y) per unit point load along +x at the
    /// origin, mm/N; infinite or NaN at the origin itself.
    #[must_use]
    pub fn surface_point(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let t = self.layer().thickness_mm;
        let [x, y] = [x / t, y / t];
        if (x * x + y * y).sqrt() >= self.along.order_0.end() {
            return [0.0; 3];
        }
        let unit = 1.0 / (2.0 * PI * t * self.layer().shear_mpa());
        let (near, rest) = (self.half_space([x, y]), self.layer_part([x, y]));
        [0, 1, 2].map(|k| unit * (near[k] + rest[k]))
    }

    /// Displacements of a half space of the surface layer's rubber, times 2 pi G t per unit load;
    /// the place is in thicknesses.
    fn half_space(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let nu = self.layer().poisson;
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        [((1.0 - nu) + nu * x * x / r2) / r, nu * x * y / (r2 * r), 0.5 * (1.0 - 2.0 * nu) * x / r2]
    }

    /// Displacements of the layer minus those of the half space, in the same units.
    fn layer_part(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let nu = self.layer().poisson;
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        // Beyond the table the layer does not move: its part cancels the half space's.
        if r >= self.along.order_0.end() {
            return self.half_space([x, y]).map(|u| -u);
        }
        let isotropic =
            (1.0 - nu) * self.along.order_0.at(r) + (2.0 - nu) * self.across.order_0.at(r);
        let twofold = (1.0 - nu) * self.along.order_2(r) - nu * self.across.order_2(r);
        // cos and sin of twice the angle; at the origin the part of order 2 is zero anyway.
        let [c, s] = if r2 > 0.0 { [(x * x - y * y) / r2, 2.0 * x * y / r2] } else { [0.0; 2] };
        let downwards = 0.5 * x * self.coupling.order_1_over_r.at(r);
        [0.5 * (isotropic - c * twofold), -0.5 * s * twofold, downwards]
    }

    /// Normal stress at the base at (x, y) per unit point load along +x, 1/mm^2: compression in
    /// front of the load, tension behind it.
    #[must_use]
    pub fn base_point(&self, [x, y]: [f64; 2]) -> f64 {
        let t = self.layer().thickness_mm;
        let r = (x * x + y * y).sqrt() / t;
        -x / t * self.base.at(r) / (2.0 * PI * t * t)
    }

    /// Displacements at (x, y) per unit traction along +x on a rectangle of half-sides `half_mm`
    /// about the origin, mm/MPa.
    #[must_use]
    pub fn surface_cell(&self, place: [f64; 2], half_mm: [f64; 2]) -> [f64; 3] {
        let t = self.layer().thickness_mm;
        let nu = self.layer().poisson;
        let unit = 1.0 / (2.0 * PI * self.layer().shear_mpa());
        let corners = |of: &dyn Fn(f64, f64) -> f64| corner_sum(place, half_mm, of);
        // Antiderivatives of x^2/r^3, x y/r^3 and x/r^2.
        let squared = corners(&|u, v| if v == 0.0 { 0.0 } else { v * libm::asinh(u / v.abs()) });
        let mixed = corners(&|u, v| -(u * u + v * v).sqrt());
        let first = corners(&|u, v| {
            let r2 = u * u + v * v;
            let angle = if u == 0.0 { 0.0 } else { u * libm::atan(v / u) };
            angle + if r2 > 0.0 { 0.5 * v * libm::log(r2) } else { 0.0 }
        });
        let rest = |k: usize| {
            over_cell(place, half_mm, 8.0, t, |at| self.layer_part(at.map(|x| x / t))[k]) / t
        };
        [
            unit * ((1.0 - nu) * love(place, half_mm) + nu * squared + rest(0)),
            unit * (nu * mixed + rest(1)),
            unit * (0.5 * (1.0 - 2.0 * nu) * first + rest(2)),
        ]
    }

    /// Normal stress at the base under (x, y) per unit traction along +x on a rectangle of
    /// half-sides `half_mm` about the origin.
    #[must_use]
    pub fn base_cell(&self, place: [f64; 2], half_mm: [f64; 2]) -> f64 {
        over_cell(place, half_mm, 8.0, self.layer().thickness_mm, |at| self.base_point(at))
    }

    /// Normal stress at the base at (x, y) (mm) under loads along the surface, MPa.
    #[must_use]
    pub fn base_szz_mpa(&self, [x, y]: [f64; 2], loads: &[TangentialLoad]) -> f64 {
        let stress_mpa = |load: &TangentialLoad| {
            let ([u, v], [qx, qy]) = (load.place_mm, load.force_n);
            let (dx, dy) = (x - u, y - v);
            qx * self.base_point([dx, dy]) + qy * self.base_point([dy, -dx])
        };
        loads.iter().map(stress_mpa).sum()
    }
}

/// Integral over a rectangle of half-sides (a, b) about the origin, seen from (x, y), from the
/// double antiderivative `of` at the four corners.
fn corner_sum([x, y]: [f64; 2], [a, b]: [f64; 2], of: &dyn Fn(f64, f64) -> f64) -> f64 {
    of(x + a, y + b) - of(x - a, y + b) - of(x + a, y - b) + of(x - a, y - b)
}
