//! Measures the cost of factoring and solving a mesh, with the band and with the sparse factor:
//! unknowns, numbers kept, milliseconds to assemble and factor, microseconds a load.
//!
//! `cargo run --profile dist -p taktil-contact --example fem_speed`

use std::hint::black_box;
use std::time::Instant;

use taktil_contact::Invalid;
use taktil_contact::fem::{Elements, Kind, Mesh, Method, graded_edges};
use taktil_contact::layer::Layer;

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn report<const D: usize>(name: &str, layer: &Layer, mesh: &Mesh<D>) -> Result<(), Invalid> {
    for method in [Method::Band, Method::Sparse] {
        let start = Instant::now();
        let body = Elements::with_method(layer, mesh.clone(), Kind::MeanDilatation, method)?;
        let made = start.elapsed().as_secs_f64() * 1e3;
        let mut forces = vec![[0.0; D]; mesh.columns()];
        forces.iter_mut().for_each(|force| force[D - 1] = -0.01);
        let mut out = body.response();
        let mut best = f64::INFINITY;
        for _ in 0..if D == 2 { 200 } else { 5 } {
            let start = Instant::now();
            body.solve(black_box(&forces), &mut out);
            best = best.min(start.elapsed().as_secs_f64() * 1e6);
        }
        let (unknowns, kept) = (body.unknowns(), body.factor_entries());
        println!("{name} | {method:?} | {unknowns} | {kept} | {made:.1} | {best:.1}");
    }
    Ok(())
}

fn main() -> Result<(), Invalid> {
    println!("mesh | factor | unknowns | numbers kept | ms to assemble and factor | us a load");
    let layer = Layer::new(0.8, 27.58, 0.49)?;
    for (nx, nz) in [(64, 4), (256, 16)] {
        report(&format!("{nx} x {nz}"), &layer, &Mesh::uniform(25.4, 0.8, nx, nz)?)?;
    }
    for (n, nz) in [(16, 4), (24, 6)] {
        let x = graded_edges(7.2, n, 3.0)?;
        let z = graded_edges(0.8, nz, 0.0)?;
        let mesh = Mesh::block(&x, &x, &z, 1)?.with_rollers(0, 0).with_rollers(1, 0);
        report(&format!("{n} x {n} x {nz}"), &layer, &mesh)?;
    }
    let x = graded_edges(12.7, 13, 3.0)?;
    let z = graded_edges(12.7, 13, 0.0)?;
    report("13 x 13 x 13", &layer, &Mesh::block(&x, &x, &z, 1)?)?;
    Ok(())
}
