//! Tests contact in three dimensions: kernels, solvers, images and features are compared with exact
//! reference data, closed forms, conservation laws and each other.

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

/// Largest absolute value in a list.
fn peak(values: &[f64]) -> f64 {
    values.iter().fold(0.0_f64, |most, value| most.max(value.abs()))
}

/// Largest absolute difference between two lists.
fn max_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()))
}
