//! Contact in three dimensions: kernels, solvers, images, features, against exact reference data,
//! closed forms, conservation and each other.

mod draws;
mod features;
mod field;
mod grip;
mod hard;
mod images;
mod kernels;
mod poses;
mod rates;
mod reach;
mod shallow;
mod shear;
mod solvers;
mod stack;
mod tables;

use taktil_contact::layer::Layer;

/// Young's modulus of the reference data, MPa.
const E_MPA: f64 = 27.58;

fn layer(t: f64, nu: f64) -> Layer {
    Layer::new(t, E_MPA, nu).expect("a sound layer")
}

/// Largest size of a number in a list.
fn peak(values: &[f64]) -> f64 {
    values.iter().fold(0.0_f64, |most, value| most.max(value.abs()))
}

/// Largest difference of two lists.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()))
}
