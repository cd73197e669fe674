//! Contact in three dimensions inside a lane: once the tables are built, neither pressing nor
//! taking images makes a heap call, from a cold or a warm start, nor does a load that is refused.

use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::layer::Layer;
use taktil_contact::space::infinite::InfiniteIndenter;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_contact::space::{Prescribed, Why};
use taktil_rtcore::guard::{self, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Forces of a contact that comes, stays, goes and comes again, N.
const FORCES_N: [f64; 7] = [5.0, 5.1, 20.0, 0.0, 0.3, 40.0, 4.0];

#[test]
fn pressing_and_imaging_make_no_heap_call() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let influence = Influence::new(&layer).unwrap();
    let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::FAST).unwrap();
    let cylinder = Profile::Cylinder { radius_mm: 23.0 };
    let mut pin = Pin::new(&layer, cylinder, [-15.0, 15.0], 0.1, Accuracy::Fast).unwrap();
    let bar = Profile::Bar { width_mm: 4.0 };
    let mut bar = Pin::new(&layer, bar, [-5.0, 5.0], 0.1, Accuracy::Fast).unwrap();
    let mut endless = InfiniteIndenter::new(&layer, cylinder, 0.2).unwrap();
    let mut sphere = Sphere::new(&layer, 10.0, Accuracy::Default).unwrap();
    let cells = Cells { columns: 48, rows: 48, spacing_mm: 0.1 };
    let mut surface = Surface::new(&influence, &cells).unwrap();
    let heights: Vec<f64> = (0..48 * 48)
        .map(|cell| {
            let [x, y] = cells.place_mm(cell);
            10.0 - (100.0 - x * x - y * y).sqrt()
        })
        .collect();
    let mut image = vec![0.0; Array::THESIS.len()];
    for (n, force) in FORCES_N.into_iter().enumerate() {
        let tilt = 1e-3 * (n as f64 - 2.0);
        let stand = PlanarPose { x_mm: 0.3, y_mm: 0.1 * n as f64, rot_rad: 0.2 };
        let ((), calls) = guard::count_heap_calls(|| {
            image.fill(0.0);
            pin.press(Prescribed::ForceN(force), tilt).unwrap();
            pin.image(&shares, stand, &mut image);
            // On an end, on the other one, on a corner.
            for (end, depth) in [(0.004, 0.05), (-0.01, 0.04), (0.1, 0.01 + 1e-3 * force)] {
                let delta = Prescribed::PenetrationMm(depth - 15.0 * libm::tan(end).abs());
                assert!(pin.press(delta, end).unwrap().force_n > 0.0);
            }
            pin.image(&shares, stand, &mut image);
            bar.press(Prescribed::ForceN(force), 0.01 * tilt).unwrap();
            bar.image(&shares, stand, &mut image);
            surface.press(&heights, Prescribed::ForceN(force)).unwrap();
            surface.image(&shares, [0.3, 0.2], &mut image);
            endless.press(Prescribed::ForceN(0.1 * force)).unwrap();
            endless.image(&Array::THESIS, Sampling::Area, stand, &mut image).unwrap();
            sphere.press(Prescribed::ForceN(force)).unwrap();
            sphere.image(&Array::THESIS, Sampling::Area, [1.0, 2.0], &mut image).unwrap();
        });
        assert_eq!(calls, 0, "force {force}");
    }
    assert!(guard::installed());
    let ((), calls) = guard::count_heap_calls(|| drop(std::hint::black_box(vec![1.0; 9])));
    assert!(calls > 0, "the guard counts");
}

/// A scene of each shape at each level, once its tables reach as deep: forces, poses, images and
/// their features.
#[test]
fn scenes_of_every_level_make_no_heap_call() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let shapes = [
        Shape::Sphere { radius_mm: 10.0 },
        Shape::Cylinder { radius_mm: 10.0, length_mm: Some(8.0) },
        Shape::Cylinder { radius_mm: 10.0, length_mm: None },
        Shape::Bar { width_mm: 3.0, length_mm: Some(8.0) },
        Shape::Edge { length_mm: Some(8.0) },
    ];
    for shape in shapes {
        let tilts = matches!(shape, Shape::Cylinder { length_mm: Some(_), .. } | Shape::Bar { .. });
        for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
            let array = Array::THESIS;
            let mut scene = Scene::new(&layer, shape, &array, Sampling::Area, level).unwrap();
            let mut image = vec![0.0; array.len()];
            let mut round = || {
                for (n, force) in FORCES_N.into_iter().enumerate() {
                    let tilt_rad = if tilts { 2e-3 * (n % 3) as f64 } else { 0.0 };
                    let stand = PlanarPose { x_mm: 0.3, y_mm: 0.1 * n as f64, rot_rad: 0.2 };
                    scene
                        .press(Prescribed::ForceN(force), Pose { planar: stand, tilt_rad })
                        .unwrap();
                    scene.image(&mut image).unwrap();
                    for part in [Part::Full, Part::Compressive] {
                        std::hint::black_box(image_features(&array, &image, part)).unwrap();
                    }
                }
            };
            round();
            let ((), calls) = guard::count_heap_calls(round);
            assert_eq!(calls, 0, "{shape:?} {level:?}");
        }
    }
}

/// A lane is refused by numbers; words are made of them where somebody asks.
#[test]
fn a_refused_press_makes_no_heap_call() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let cylinder = Profile::Cylinder { radius_mm: 23.0 };
    let mut pin = Pin::new(&layer, cylinder, [-15.0, 15.0], 0.1, Accuracy::Fast).unwrap();
    let mut endless = InfiniteIndenter::new(&layer, cylinder, 0.2).unwrap();
    let mut sphere = Sphere::new(&layer, 10.0, Accuracy::Fast).unwrap();
    let (depth, force) = (Prescribed::PenetrationMm, Prescribed::ForceN);
    // Prescribed and tilt, the number at fault, what of it is said.
    let cases = [
        (depth(f64::NAN), 0.0, "penetration_mm", "NaN is not a finite number"),
        (depth(1e40), 0.0, "penetration_mm", "beyond sense"),
        (depth(0.8), 0.0, "penetration_mm", "thickness or more"),
        (depth(0.3), 0.0, "penetration_mm", "beyond the table"),
        (depth(0.7), 0.02, "penetration_mm", "beyond the table"),
        (force(f64::INFINITY), 0.0, "force_n", "not a finite number"),
        (force(-1.0), 0.0, "force_n", "pulls"),
        (force(1e9), 0.0, "force_n", "beyond the table"),
        (force(1e9), 0.1, "force_n", "beyond the table"),
        (depth(0.01), f64::NAN, "tilt_rad", "not a finite number"),
        (depth(0.01), -0.3, "tilt_rad", "-0.3 rad"),
    ];
    for (drive, tilt, place, words) in cases {
        pin.press(depth(0.05), 0.0).unwrap();
        let (refused, calls) = guard::count_heap_calls(|| pin.press(drive, tilt).unwrap_err());
        assert_eq!((calls, refused.place), (0, place), "{drive:?} {tilt}");
        assert_eq!(pin.state().force_n, 0.0, "no contact is left");
        let (told, calls) = guard::count_heap_calls(|| refused.to_string());
        assert!(calls > 0 && told.contains(words), "{told}");
    }
    for drive in [depth(f64::NAN), depth(0.9), force(-1.0), force(1e9)] {
        let (refused, calls) = guard::count_heap_calls(|| {
            [endless.press(drive).unwrap_err(), sphere.press(drive).unwrap_err()]
        });
        assert_eq!(calls, 0, "{drive:?}");
        let beyond = drive == force(1e9);
        let table = |why| matches!(why, Why::BeyondTable | Why::Unreachable | Why::Thickness(_));
        assert!(refused.iter().all(|one| !beyond || table(one.why)), "{refused:?}");
    }
}

/// The same of a body on cells.
#[test]
fn a_refused_body_makes_no_heap_call() {
    let layer = Layer::new(0.8, 27.58, 0.49).unwrap();
    let influence = Influence::new(&layer).unwrap();
    let cells = Cells { columns: 16, rows: 16, spacing_mm: 0.1 };
    let mut surface = Surface::new(&influence, &cells).unwrap();
    let bowl: Vec<f64> = (0..16 * 16)
        .map(|cell| {
            let [x, y] = cells.place_mm(cell);
            0.1 * (x * x + y * y)
        })
        .collect();
    let (nowhere, unsound) = ([f64::INFINITY; 256], [f64::NAN; 256]);
    let (depth, force) = (Prescribed::PenetrationMm, Prescribed::ForceN);
    let cases = [
        (&bowl[..9], depth(0.01), "heights_mm", "9 heights for 256 cells"),
        (&unsound[..], depth(0.01), "heights_mm", "one number a cell"),
        (&nowhere[..], depth(0.01), "heights_mm", "not a finite number"),
        (&bowl[..], depth(0.9), "penetration_mm", "thickness or more"),
        (&bowl[..], force(-1.0), "force_n", "pulls"),
        (&bowl[..], depth(0.4), "columns", "border"),
    ];
    for (heights, drive, place, words) in cases {
        let (refused, calls) =
            guard::count_heap_calls(|| surface.press(heights, drive).unwrap_err());
        assert_eq!((calls, refused.place), (0, place), "{drive:?}");
        assert_eq!(surface.state().force_n, 0.0, "no contact is left");
        assert!(format!("{:?}", refused.to_invalid()).contains(words), "{refused:?}");
    }
}
