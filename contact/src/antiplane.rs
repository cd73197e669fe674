//! Layers sheared across a wave: displacement v and shear stress of a traction that points across
//! its own wave vector, in [`super::stack`]. In every layer v'' = k^2 v. If
//! the face below has the compliance c, the top of a layer of thickness h and shear modulus G
//! above it has the compliance (c + tanh(k h)/(G k))/(1 + c G k tanh(k h)).

use super::layer::Layer;
use super::stack::Stack;

/// Displacement per traction at the top of a layer whose lower face has the compliance `below`.
fn top_compliance(layer: &Layer, k: f64, below: f64) -> f64 {
    let (h, g) = (layer.thickness_mm, layer.shear_mpa());
    let tanh = libm::tanh(k * h);
    let own = if k > 0.0 { tanh / k } else { h };
    (below + own / g) / (1.0 + below * g * k * tanh)
}

/// Displacement and shear stress at a height over a layer's lower face, per traction on its upper
/// one.
fn fields_at(layer: &Layer, k: f64, below: f64, height: f64) -> [f64; 2] {
    let (h, g) = (layer.thickness_mm, layer.shear_mpa());
    let soft = below * g * k;
    // Numerators and denominator are divided by e^(k h)/2, so that nothing overflows.
    let (grown, died) = (libm::exp(k * (height - h)), libm::exp(-k * (height + h)));
    let whole = 1.0 + libm::exp(-2.0 * k * h) + soft * -libm::expm1(-2.0 * k * h);
    let [cosh, sinh] = [grown + died, grown * -libm::expm1(-2.0 * k * height)];
    let own = if k > 0.0 { sinh / k } else { 2.0 * height };
    [(below * cosh + own / g) / whole, (soft * sinh + cosh) / whole]
}

impl Stack {
    /// At the wave number a over the surface layer's thickness, in that layer's units: displacement
    /// per tangential traction across the wave vector.
    pub(crate) fn across_compliance(&self, a: f64) -> f64 {
        let surface = self.surface_layer();
        let k = a / surface.thickness_mm;
        let all =
            self.layers().iter().rev().fold(0.0, |below, layer| top_compliance(layer, k, below));
        all * surface.shear_mpa() / surface.thickness_mm
    }

    /// Displacement (mm) and shear stress (MPa) at a depth per MPa of such a traction, for a wave
    /// number `k` (1/mm).
    pub(crate) fn across(&self, k: f64, depth_mm: f64) -> [f64; 2] {
        let mut belows = vec![0.0];
        for layer in self.layers().iter().rev() {
            belows.push(top_compliance(layer, k, belows[belows.len() - 1]));
        }
        let (mut traction, mut top) = (1.0, 0.0);
        let mut found = [0.0; 2];
        for (i, layer) in self.layers().iter().enumerate() {
            let below = belows[self.layers().len() - 1 - i];
            let bottom = top + layer.thickness_mm;
            let last = depth_mm <= bottom || i + 1 == self.layers().len();
            let height = if last { (bottom - depth_mm).max(0.0) } else { 0.0 };
            found = fields_at(layer, k, below, height).map(|value| traction * value);
            if last {
                break;
            }
            (traction, top) = (found[1], bottom);
        }
        found
    }
}
