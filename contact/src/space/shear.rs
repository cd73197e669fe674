//! Tangential loads on the bonded layer, or several on each other, in three dimensions:
//! displacement of the surface, normal stress at the base, and contacts that rub with a traction in
//! proportion to their pressure.
//!
//! Along its wave vector a tangential traction is the plane problem's, with T and N of
//! [`super::super::layer`]; across it the layer shears alone, u_hat = tanh(k t)/(G k) q_hat. The
//! inverse transforms are Hankel's of order 0, 1 and 2; that of order 2 follows from the others by
//! J2 = 2 J1(y)/y - J0. What a half space does (Cerruti; Johnson, Contact Mechanics, 1985, section
//! 3.6) is kept in closed form, the rest is tabulated, and nu = 0.5 is an ordinary value.
//!
//! Frame as in [`super`]; a load Q > 0 pushes the layer along +x, displacements w are downwards. It
//! refuses what is not finite; contacts under friction also what `Surface::press` refuses and
//! friction that does not settle. Stick and slip are [`super::grip`]'s.

use super::super::Invalid;
use super::super::layer::Layer;
use super::super::stack::Stack;
use super::ground::{Ground, Sizes, tanh_over};
use super::radial::{Grid, images, images_mean, line_of_sight, love, means, over_cell, slopes};
use super::table::Even;
use core::f64::consts::PI;

/// Table points per thickness.
const POINTS_PER_THICKNESS: f64 = 64.0;

/// f(r) = integral of a g(a) J0(a r), and its mean (1/r^2) integral of s f(s) from 0, which is that
/// of g(a) J1(a r) over r.
#[derive(Clone, Debug)]
struct Orders {
    level: Even,
    mean: Even,
}

impl Orders {
    fn of(g: impl Fn(f64) -> f64, cutoff: f64, grid: Grid) -> Self {
        Self::more(g, cutoff, grid, |_| [0.0; 2])
    }

    /// The same with more of both at each distance.
    fn more(
        g: impl Fn(f64) -> f64,
        cutoff: f64,
        grid: Grid,
        more: impl Fn(f64) -> [f64; 2],
    ) -> Self {
        let mut level = line_of_sight(&slopes(&g, cutoff, grid), grid);
        let mut mean = means(g, cutoff, grid);
        for (i, (level, mean)) in level.iter_mut().zip(&mut mean).enumerate() {
            let [more_level, more_mean] = more(i as f64 / POINTS_PER_THICKNESS);
            (*level, *mean) = (2.0 * *level + more_level, *mean + more_mean);
        }
        Self {
            level: Even::new(&level, POINTS_PER_THICKNESS),
            mean: Even::new(&mean, POINTS_PER_THICKNESS),
        }
    }

    /// Integral of a g(a) J2(a r).
    fn second(&self, r: f64) -> f64 {
        2.0 * self.mean.at(r) - self.level.at(r)
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
    /// Transforms of T/a less its value across, of that value less 1/a, and of N less n.
    along: Orders,
    across: Orders,
    coupling: Orders,
    /// (1/r) integral of a B(a) J1(a r), B being the base stress per traction.
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

    /// Tabulates the kernels of several layers: as long for so many thicknesses of the surface
    /// layer as a layer's fields reach, squared; allocates.
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
        // What is under the waves that a single layer feels is in the images.
        let across = |a: f64| ground.across(a) - tanh_over(a);
        Self {
            sizes: ground.sizes,
            along: Orders::of(|a| ground.tangential(a) - ground.across(a), surface, grid),
            across: Orders::more(across, surface, grid, |r| [images(r), images_mean(r)]),
            coupling: Orders::of(|a| ground.coupling(a) - far_out, surface, grid),
            base: Even::new(
                &means(|a| a * ground.base_from_tangential(a), base, grid),
                POINTS_PER_THICKNESS,
            ),
        }
    }

    /// The layer, of a stack the one at the surface.
    #[must_use]
    pub fn layer(&self) -> &Layer {
        &self.sizes.surface
    }

    /// Sizes of what it stands on.
    pub(super) fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// Displacements along x, along y and downwards at (x, y) per unit point load along +x at the
    /// origin, mm/N; infinite or NaN at the origin itself.
    #[must_use]
    pub fn surface_point(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let t = self.layer().thickness_mm;
        let [x, y] = [x / t, y / t];
        if (x * x + y * y).sqrt() >= self.along.level.end() {
            return [0.0; 3];
        }
        let unit = 1.0 / (2.0 * PI * t * self.layer().shear_mpa());
        let (near, rest) = (self.half_space([x, y]), self.rest([x, y]));
        [0, 1, 2].map(|k| unit * (near[k] + rest[k]))
    }

    /// What a half space of the layer at the surface moves by, times 2 pi G t per unit load; places
    /// in thicknesses.
    fn half_space(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let nu = self.layer().poisson;
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        [((1.0 - nu) + nu * x * x / r2) / r, nu * x * y / (r2 * r), 0.5 * (1.0 - 2.0 * nu) * x / r2]
    }

    /// What the layer adds to that.
    fn rest(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let nu = self.layer().poisson;
        let r2 = x * x + y * y;
        let r = r2.sqrt();
        // Far off the whole has died.
        if r >= self.along.level.end() {
            return self.half_space([x, y]).map(|u| -u);
        }
        let even = (1.0 - nu) * self.along.level.at(r) + (2.0 - nu) * self.across.level.at(r);
        let turned = (1.0 - nu) * self.along.second(r) - nu * self.across.second(r);
        // cos and sin of twice the angle; the second order vanishes at the origin.
        let [c, s] = if r2 > 0.0 { [(x * x - y * y) / r2, 2.0 * x * y / r2] } else { [0.0; 2] };
        [0.5 * (even - c * turned), -0.5 * s * turned, 0.5 * x * self.coupling.mean.at(r)]
    }

    /// Normal stress at the base at (x, y) per unit point load along +x, 1/mm^2: pressed ahead of
    /// the load, lifted behind it.
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
        let corners = |of: &dyn Fn(f64, f64) -> f64| corners(place, half_mm, of);
        // Antiderivatives of x^2/r^3, x y/r^3 and x/r^2.
        let squared = corners(&|u, v| if v == 0.0 { 0.0 } else { v * libm::asinh(u / v.abs()) });
        let mixed = corners(&|u, v| -(u * u + v * v).sqrt());
        let first = corners(&|u, v| {
            let r2 = u * u + v * v;
            let angle = if u == 0.0 { 0.0 } else { u * libm::atan(v / u) };
            angle + if r2 > 0.0 { 0.5 * v * libm::log(r2) } else { 0.0 }
        });
        let rest =
            |k: usize| over_cell(place, half_mm, 8.0, t, |at| self.rest(at.map(|x| x / t))[k]) / t;
        [
            unit * ((1.0 - nu) * love(place, half_mm) + nu * squared + rest(0)),
            unit * (nu * mixed + rest(1)),
            unit * (0.5 * (1.0 - 2.0 * nu) * first + rest(2)),
        ]
    }

    /// Normal stress at the base under (x, y) per unit traction along +x on such a rectangle.
    #[must_use]
    pub fn base_cell(&self, place: [f64; 2], half_mm: [f64; 2]) -> f64 {
        over_cell(place, half_mm, 8.0, self.layer().thickness_mm, |at| self.base_point(at))
    }

    /// Normal stress at the base at (x, y) (mm) under loads along the surface, MPa.
    #[must_use]
    pub fn base_szz_mpa(&self, [x, y]: [f64; 2], loads: &[TangentialLoad]) -> f64 {
        let one = |load: &TangentialLoad| {
            let ([u, v], [qx, qy]) = (load.place_mm, load.force_n);
            let (dx, dy) = (x - u, y - v);
            qx * self.base_point([dx, dy]) + qy * self.base_point([dy, -dx])
        };
        loads.iter().map(one).sum()
    }
}

/// A product of differences of an antiderivative over a rectangle, seen from (x, y).
fn corners([x, y]: [f64; 2], [a, b]: [f64; 2], of: &dyn Fn(f64, f64) -> f64) -> f64 {
    of(x + a, y + b) - of(x - a, y + b) - of(x + a, y - b) + of(x - a, y - b)
}
