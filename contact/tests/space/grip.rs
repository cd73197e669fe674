//! Tests Coulomb's friction in space: discs that stick (Mindlin, Reissner and Sagoci), a sphere
//! that slides from its edge inwards (Cattaneo and Mindlin), the rule of friction along a path, the
//! plane problem under the middle of a long cylinder, and the base's statics.

use crate::layer;
use core::f64::consts::PI;
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::frictional as plane;
use taktil_contact::space::Prescribed;
use taktil_contact::space::grip::{BodyMotion, Grip, GripState, Status};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::shear::Shear;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

fn gripped(layer: &Layer, cells: &Cells, friction: f64) -> Grip {
    let surface = Surface::new(&Influence::new(layer).unwrap(), cells).unwrap();
    Grip::new(surface, &Shear::new(layer).unwrap(), friction).unwrap()
}

fn heights(cells: &Cells, of: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let height = |n: usize| {
        let [x, y] = cells.place_mm(n);
        of(x, y)
    };
    (0..cells.columns * cells.rows).map(height).collect()
}

fn along(x: f64, y: f64) -> BodyMotion {
    BodyMotion { shift_mm: [x, y], ..BodyMotion::default() }
}

/// On thick rubber that keeps its volume, the stiffness of a sticking disc is 8 G a/(2 - nu) along
/// the surface and 16/3 G a^3 in rotation.
#[test]
fn a_disc_that_sticks_is_as_stiff_as_in_closed_form() {
    let thick = layer(300.0, 0.5);
    let shear_mpa = thick.shear_mpa();
    let mut off = [[0.0_f64; 2]; 2];
    for (off, columns) in off.iter_mut().zip([24, 48]) {
        let cells = Cells { columns, rows: columns, spacing_mm: 2.4 / columns as f64 };
        let mut grip = gripped(&thick, &cells, 50.0);
        let face = heights(&cells, |x, y| if x * x + y * y < 1.0 { 0.0 } else { f64::INFINITY });
        let drive = Prescribed::PenetrationMm(0.01);
        let pressed = grip.step(&face, drive, &BodyMotion::default()).unwrap();
        let radius = (pressed.pressed.area_mm2 / PI).sqrt();
        let state = grip.step(&face, drive, &along(1e-3, 0.0)).unwrap();
        off[0] = state.force_n[0] / (8.0 / 1.5 * shear_mpa * radius * 1e-3) - 1.0;
        assert!(state.area_mm2[1] == 0.0 && state.force_n[1].abs() < 1e-6 * state.force_n[0]);
        grip.release();
        let turn = BodyMotion { turn_rad: 1e-3, ..BodyMotion::default() };
        grip.step(&face, drive, &BodyMotion::default()).unwrap();
        let state = grip.step(&face, drive, &turn).unwrap();
        off[1] =
            state.torque_n_mm / (16.0 / 3.0 * shear_mpa * (radius * radius * radius) * 1e-3) - 1.0;
    }
    for k in 0..2 {
        assert!(off[1][k].abs() < 0.02 && off[1][k].abs() < 0.7 * off[0][k].abs(), "{off:?}");
    }
}

/// On thick rubber the stick zone is a disc of radius a (1 - Q/(mu P))^(1/3) (Cattaneo and
/// Mindlin).
#[test]
fn a_sphere_slides_from_its_edge_inwards() {
    let thick = layer(300.0, 0.5);
    let cells = Cells { columns: 48, rows: 48, spacing_mm: 0.05 };
    let friction = 0.4;
    let mut grip = gripped(&thick, &cells, friction);
    let ball = heights(&cells, |x, y| (x * x + y * y) / 20.0);
    let drive = Prescribed::PenetrationMm(0.1);
    let pressed = grip.step(&ball, drive, &BodyMotion::default()).unwrap().pressed;
    let radius = 1.0;
    let whole = 3.0 * friction * pressed.force_n * 1.5 / (16.0 * thick.shear_mpa() * radius);
    for part in [0.3, 0.6, 0.9] {
        let left: f64 = 1.0 - part;
        let shift = whole * (1.0 - libm::pow(left, 2.0 / 3.0)) - moved_at_the_middle(&grip);
        let state = grip.step(&ball, drive, &along(shift, 0.0)).unwrap();
        let carried = state.force_n[0] / (friction * pressed.force_n);
        assert!((carried - part).abs() < 0.02, "{part}: {carried}");
        let stuck = state.area_mm2[0] / (PI * radius * radius * libm::pow(left, 2.0 / 3.0));
        assert!((stuck - 1.0).abs() < 0.12, "{part}: {stuck}");
    }
}

/// Displacement along x of a cell beside the middle, which sticks.
fn moved_at_the_middle(grip: &Grip) -> f64 {
    grip.displacement_mm()[0][24 * 48 + 24]
}

/// Every cell obeys Coulomb's law on any path: a press, moves along, across and back, a rotation,
/// and a deeper press at the same time.
#[test]
fn every_cell_obeys_coulombs_law() {
    for (nu, friction) in [(0.3, 0.3), (0.49, 0.8), (0.5, 0.15)] {
        let rubber = layer(0.8, nu);
        let cells = Cells { columns: 32, rows: 30, spacing_mm: 0.1 };
        let mut grip = gripped(&rubber, &cells, friction);
        let body = heights(&cells, |x, y| (x * x + 0.6 * y * y) / 20.0);
        let path = [
            (0.04, along(0.0, 0.0)),
            (0.04, along(2e-3, 0.0)),
            (0.05, along(3e-3, 2e-3)),
            (0.05, along(-6e-3, 0.0)),
            (0.045, BodyMotion { shift_mm: [0.0, 1e-3], turn_rad: 8e-3 }),
        ];
        let mut seen = [0; 2];
        for (depth, carry) in path {
            let before = grip.displacement_mm().map(<[f64]>::to_vec);
            let state = grip.step(&body, Prescribed::PenetrationMm(depth), &carry).unwrap();
            assert!(state.residual < 1e-5, "{state:?}");
            let largest = 1e-2;
            let statuses: Vec<Status> = grip.status().collect();
            for (n, status) in statuses.iter().enumerate() {
                let [x, y] = cells.place_mm(n);
                let way = [
                    carry.shift_mm[0] - carry.turn_rad * y,
                    carry.shift_mm[1] + carry.turn_rad * x,
                ];
                let slip = [0, 1].map(|k| way[k] - (grip.displacement_mm()[k][n] - before[k][n]));
                let q = [0, 1].map(|k| grip.traction_mpa()[k][n]);
                let size = libm::hypot(q[0], q[1]);
                let limit = friction * grip.pressure_mpa()[n];
                assert!(size <= limit * (1.0 + 1e-12), "{nu} {n}: {size} {limit}");
                match status {
                    Status::Apart => assert!(size == 0.0),
                    Status::Sticks => {
                        seen[0] += 1;
                        assert!(
                            libm::hypot(slip[0], slip[1]) < 1e-6 * largest,
                            "{nu} {n}: {slip:?}"
                        );
                    }
                    Status::Slides => {
                        seen[1] += 1;
                        // Along the slip, and not against it.
                        let cross = (q[0] * slip[1] - q[1] * slip[0]) / size;
                        let with = (q[0] * slip[0] + q[1] * slip[1]) / size;
                        let small = 1e-6 * largest;
                        assert!(cross.abs() < small && with > -small, "{nu} {n}: {q:?} {slip:?}");
                    }
                }
            }
        }
        assert!(seen[0] > 50 && seen[1] > 200, "{seen:?}");
    }
}

/// Moved far enough, the whole contact slides and equals that of [`Shear::press`]. After the body
/// was lifted off, the layer has no memory.
#[test]
fn full_sliding_has_proportional_friction() {
    let rubber = layer(0.8, 0.4);
    let cells = Cells { columns: 31, rows: 31, spacing_mm: 0.1 };
    let ball = heights(&cells, |x, y| (x * x + y * y) / 20.0);
    let drive = Prescribed::ForceN(1.0);
    let mut grip = gripped(&rubber, &cells, 0.3);
    grip.step(&ball, drive, &BodyMotion::default()).unwrap();
    let mut state = GripState::default();
    for _ in 0..4 {
        state = grip.step(&ball, drive, &along(0.02, 0.0)).unwrap();
    }
    assert!(state.area_mm2[0] == 0.0, "{state:?}");
    let mut surface = Surface::new(&Influence::new(&rubber).unwrap(), &cells).unwrap();
    let shear = Shear::new(&rubber).unwrap();
    let rubbed = shear.press(&mut surface, &ball, drive, 0.3).unwrap();
    assert!((state.force_n[0] - 0.3).abs() < 1e-3 && state.force_n[1].abs() < 1e-6, "{state:?}");
    let depth = state.pressed.penetration_mm / rubbed.penetration_mm - 1.0;
    assert!(depth.abs() < 1e-3, "{state:?} {rubbed:?}");
    let first = {
        grip.release();
        grip.step(&ball, drive, &along(1e-3, 0.0)).unwrap()
    };
    grip.release();
    assert_eq!(grip.step(&ball, drive, &along(1e-3, 0.0)).unwrap(), first);
}

/// Without friction there is no tangential force; a body in the air carries no load; invalid
/// arguments are errors and leave the state unchanged.
#[test]
fn limits_of_friction() {
    let rubber = layer(0.8, 0.49);
    let cells = Cells { columns: 24, rows: 24, spacing_mm: 0.1 };
    let ball = heights(&cells, |x, y| (x * x + y * y) / 20.0);
    let mut smooth = gripped(&rubber, &cells, 0.0);
    let state = smooth.step(&ball, Prescribed::ForceN(0.5), &along(0.1, 0.0)).unwrap();
    assert!(state.force_n == [0.0; 2] && state.area_mm2[0] == 0.0, "{state:?}");
    let mut grip = gripped(&rubber, &cells, 3.0);
    let state = grip.step(&ball, Prescribed::ForceN(0.5), &along(1e-3, 0.0)).unwrap();
    assert!(state.force_n[0] > 0.0 && state.area_mm2[0] > 0.0, "{state:?}");
    let kept =
        (grip.state(), grip.pressure_mpa().to_vec(), grip.displacement_mm().map(<[f64]>::to_vec));
    for (face, drive, carry, place) in [
        (&ball[..], Prescribed::ForceN(0.5), along(f64::NAN, 0.0), "shift_mm"),
        (
            &ball,
            Prescribed::ForceN(0.5),
            BodyMotion { turn_rad: f64::INFINITY, ..along(0.0, 0.0) },
            "turn_rad",
        ),
        (&ball[1..], Prescribed::ForceN(0.5), along(0.0, 0.0), "heights_mm"),
        (&ball, Prescribed::ForceN(-1.0), along(0.0, 0.0), "force_n"),
        (&ball, Prescribed::ForceN(1e3), along(0.0, 0.0), "columns"),
    ] {
        assert_eq!(grip.step(face, drive, &carry).unwrap_err().place, place);
        let now = (
            grip.state(),
            grip.pressure_mpa().to_vec(),
            grip.displacement_mm().map(<[f64]>::to_vec),
        );
        assert!(now == kept, "{place}");
    }
    let lifted = grip.step(&ball, Prescribed::ForceN(0.0), &along(0.0, 0.0)).unwrap();
    assert!(lifted.force_n == [0.0; 2] && lifted.pressed.force_n == 0.0);
    assert!(grip.displacement_mm()[0].iter().all(|u| *u == 0.0));
    for friction in [-0.1, f64::NAN] {
        let surface = Surface::new(&Influence::new(&rubber).unwrap(), &cells).unwrap();
        let refused = Grip::new(surface, &Shear::new(&rubber).unwrap(), friction).unwrap_err();
        assert_eq!(refused.place, "friction");
    }
}

/// The image sums to the force, and its moment is that of the pressure plus -t Q. A move along y is
/// the mirror image of one along x, also on an array that is not square and not centred.
#[test]
fn the_image_has_the_moments_of_statics() {
    let rubber = layer(0.8, 0.49);
    let (influence, shear) = (Influence::new(&rubber).unwrap(), Shear::new(&rubber).unwrap());
    let array = Array { rows: 29, cols: 35, pitch_mm: 0.5 };
    let arrays = [array, Array { rows: array.cols, cols: array.rows, ..array }];
    let normal =
        arrays.map(|one| Shares::new(&influence, &one, Sampling::Area, Fineness::FINE).unwrap());
    let [sheared, turned] =
        arrays.map(|one| Shares::sheared(&shear, &one, Sampling::Area, Fineness::FINE).unwrap());
    let cells = Cells { columns: 30, rows: 30, spacing_mm: 0.1 };
    let ball = heights(&cells, |x, y| (x * x + y * y) / 20.0);
    let (grip, state) = carry(&cells, &rubber, &ball, [2e-3, 0.0]);
    let (across, _) = carry(&cells, &rubber, &ball, [0.0, 2e-3]);
    let mut images = [vec![0.0; array.len()], vec![0.0; array.len()]];
    grip.image(&normal[0], [&sheared, &turned], [0.2, -0.1], &mut images[0]).unwrap();
    across.image(&normal[1], [&turned, &sheared], [-0.1, 0.2], &mut images[1]).unwrap();
    let moment = |power: usize| -> f64 {
        let at = |n: usize| if power == 0 { 1.0 } else { array.x_mm(n % array.cols) - 0.2 };
        0.25 * images[0].iter().enumerate().map(|(n, s)| s * at(n)).sum::<f64>()
    };
    let sum = moment(0);
    assert!((sum / -state.pressed.force_n - 1.0).abs() < 2e-3, "{sum} {state:?}");
    let pressed: f64 =
        grip.pressure_mpa().iter().enumerate().map(|(n, p)| 0.01 * p * cells.place_mm(n)[0]).sum();
    let wanted = -pressed - 0.8 * state.force_n[0];
    let found = moment(1);
    assert!((found / wanted - 1.0).abs() < 0.02, "{found} {wanted}");
    let largest = crate::peak(&images[0]);
    for (n, value) in images[0].iter().enumerate() {
        let mirrored = images[1][(n % array.cols) * array.rows + n / array.cols];
        assert!((value - mirrored).abs() < 1e-6 * largest, "{n}");
    }
    // Not the mirror's shares.
    let refused = grip.image(&normal[0], [&sheared; 2], [0.0; 2], &mut images[0]).unwrap_err();
    assert_eq!(refused.place, "sheared");
}

fn carry(cells: &Cells, rubber: &Layer, ball: &[f64], shift_mm: [f64; 2]) -> (Grip, GripState) {
    let mut grip = gripped(rubber, cells, 0.5);
    let drive = Prescribed::ForceN(1.0);
    grip.step(ball, drive, &BodyMotion::default()).unwrap();
    let state = grip.step(ball, drive, &BodyMotion { shift_mm, turn_rad: 0.0 }).unwrap();
    (grip, state)
}

/// Under the middle of a long cylinder that is pressed, moved across its axis and moved back, the
/// solution is that of the plane problem on the same cells, place by place.
#[test]
fn the_middle_of_a_long_cylinder_is_the_plane_problem() {
    let (columns, spacing_mm, friction) = (24, 0.08, 0.4);
    for nu in [0.3, 0.5] {
        let rubber = layer(0.8, nu);
        let cells = Cells { columns, rows: 165, spacing_mm };
        let mut grip = gripped(&rubber, &cells, friction);
        let face = heights(&cells, |x, y| if y.abs() < 6.4 { x * x / 20.0 } else { f64::INFINITY });
        let edges: Vec<f64> =
            (0..=columns).map(|i| (i as f64 - 0.5 * columns as f64) * spacing_mm).collect();
        let bed = SurfaceCompliance::of_layer(&rubber, &edges).unwrap();
        let profile = bed.x_mm.iter().map(|x| x * x / 20.0).collect();
        let mut flat =
            plane::FrictionalContact::new(bed, profile, plane::FrictionLaw::Coulomb(friction))
                .unwrap();
        let mut place = 0.0;
        for shift in [0.0, 1.5e-3, 2e-3, -2.5e-3] {
            place += shift;
            grip.step(&face, Prescribed::PenetrationMm(0.02), &along(shift, 0.0)).unwrap();
            flat.step(&plane::LoadStep::Move { dz_mm: 0.02, dx_mm: place }).unwrap();
            let middle = 82 * columns;
            let peak = crate::peak(flat.normal_n_mm()) / spacing_mm;
            for i in 0..columns {
                let wanted = [flat.normal_n_mm()[i], flat.tangential_n_mm()[i]];
                let found = [grip.pressure_mpa()[middle + i], grip.traction_mpa()[0][middle + i]];
                for (found, wanted) in found.iter().zip(wanted.map(|f| f / spacing_mm)) {
                    let off = (found - wanted).abs() / peak;
                    assert!(off < 1e-3, "{nu} {shift} {i}: {found} {wanted} of {peak}");
                }
            }
        }
    }
}
