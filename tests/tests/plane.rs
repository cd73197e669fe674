//! Plane contact inside a lane: bars and cylinders that are pressed, steps with stick and slip, and
//! finite element loads make no heap call once they are built, from a cold or a warm start.

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::contact_table::ContactTable;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Friction, Indenter, Load, Refusal, Shape};
use taktil_rtcore::guard::{self, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// P and Q of contacts that come, tilt, go, are refused and come again, N/mm.
const LOADS_N_MM: [[f64; 2]; 9] = [
    [0.5, 0.0],
    [0.5, 0.1],
    [0.5, 0.45],
    [3.0, -2.5],
    [0.0, 0.0],
    [0.01, 0.009],
    [0.5, 0.9],
    [-1.0, 0.0],
    [1.0, 0.2],
];

#[test]
fn plane_contact_makes_no_heap_call() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let bar = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let mut bodies = Vec::new();
    for shape in [bar, Shape::Cylinder { radius_mm: 23.0 }, Shape::Parabola { radius_mm: 5.0 }] {
        for friction in [Friction::None, Friction::Proportional] {
            for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
                bodies.push(Indenter::new(&layer, shape, friction, level).unwrap());
            }
        }
    }
    let mut chart = ContactTable::new(&layer, 12.7, 6.35, Friction::None, &[0.0, 3.0]).unwrap();
    let edges: Vec<f64> = (0..=48).map(|i| f64::from(i) * 0.25 - 6.0).collect();
    let bed = SurfaceCompliance::of_layer(&layer, &edges).unwrap();
    let mut grip = FrictionalContact::new(bed, vec![0.0; 48], FrictionLaw::Coulomb(0.4)).unwrap();
    let mesh = Mesh::uniform(25.4, 0.8, 64, 4).unwrap();
    let soft = Layer { poisson: 0.5, ..layer };
    let elements = Elements::new(&soft, mesh, Kind::MeanDilatation).unwrap();
    let mut response = elements.response();
    let forces = [[0.1, -1.0]; 65];
    let (mut solved, mut refused) = (0, 0);
    for [p_n_mm, q_n_mm] in LOADS_N_MM {
        let load = Load { p_n_mm, q_n_mm };
        let ((), calls) = guard::count_heap_calls(|| {
            for body in &mut bodies {
                match body.press(&load) {
                    Ok(_) => solved += 1,
                    Err(Refusal::Toppling | Refusal::Tension) => refused += 1,
                    Err(other) => panic!("{other}"),
                }
                std::hint::black_box(body.pressure_mpa(0.1));
                body.forget();
                let _ = std::hint::black_box(body.descend(0.01 * p_n_mm));
            }
            let _ = std::hint::black_box(chart.press(&load));
            chart.base_szz_mpa(std::hint::black_box(&mut [0.0; 2]));
            let held = LoadStep::Loads { load, height_mm: 0.5 };
            let _ = std::hint::black_box(grip.step(&held));
            elements.solve(&forces, &mut response);
        });
        assert_eq!(calls, 0, "P {p_n_mm}, Q {q_n_mm}");
    }
    assert!(solved > 100 && refused > 10, "{solved} {refused}");
    assert!(guard::installed());
    let ((), calls) = guard::count_heap_calls(|| drop(std::hint::black_box(vec![1.0; 9])));
    assert!(calls > 0, "the guard counts");
}
