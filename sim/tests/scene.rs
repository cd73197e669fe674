//! Checks that scenes that cannot be simulated are refused with their place.

use taktil_hal::explain::Explain;
use taktil_sim::fidelity::{ArmModel, Integrator};
use taktil_sim::scene::{Axis, Motion, MotionKind, ObjectConfig, ObjectKind};
use taktil_sim::{
    Carriage, FloatingGuide, Invalid, Timing, WorldConfig, build, build_with_carriage,
};

fn refused(edit: impl FnOnce(&mut WorldConfig)) -> Invalid {
    let mut config = WorldConfig::default();
    edit(&mut config);
    let built = build(&config, &Timing::default(), 0).map(|_| ());
    built.expect_err("this cannot be simulated")
}

#[test]
fn the_defaults_and_the_empty_text_are_the_same_sound_scene() {
    let parsed: WorldConfig = toml::from_str("").unwrap();
    assert_eq!(parsed, WorldConfig::default());
    parsed.check().unwrap();
    build(&parsed, &Timing::default(), 0).unwrap();
}

#[test]
fn every_key_can_be_written() {
    let text = r#"
        substep_us = 100.0
        arm_refresh_steps = 2
        [arm]
        home_deg = [0.0, 46.0, -160.0, -180.0, 66.0, 180.0]
        coulomb_scale = 0.5
        viscous_scale = 2.0
        power_on_s = 0.1
        [finger]
        friction = 0.7
        rubber = { thickness_mm = 1.0, youngs_mpa = 1.5, poisson = 0.45, relaxation_ms = 0.2 }
        [pin]
        present = true
        radius_mm = 15.0
        length_mm = 60.0
        mass_kg = 0.3
        x_mm = 1.0
        y_mm = -2.0
        yaw_deg = 3.0
        fixture = false
        fixture_release_n = 4.0
        rolling_resistance_mm = 0.05
        [table]
        height_mm = -190.0
        tilt_x_deg = 1.0
        tilt_y_deg = 2.0
        pan_deg = 3.0
        slide_mm = 4.0
        pivot_x_mm = 300.0
        pivot_y_mm = -100.0
        friction = 0.6
        rubber = { thickness_mm = 4.0, youngs_mpa = 0.8, poisson = 0.48 }
        [[table.motion]]
        axis = "tilt_y"
        rate_deg_s = 2.0
        from_s = 1.0
        to_s = 6.0
        [[table.motion]]
        axis = "slide"
        rate_mm_s = -9.0
        from_s = 1.0
        to_s = 6.0
        [tactile]
        noise_counts = 10.0
        rest_counts = 100.0
        bits = 10
        full_scale_n = 5.0
    "#;
    let config: WorldConfig = toml::from_str(text).unwrap();
    assert_eq!(config.table.motion[1].axis, Axis::Slide);
    assert!((config.table.rubber.relaxation_ms - 0.3).abs() < 1e-15);
    build(&config, &Timing::default(), 0).unwrap();
}

#[test]
fn unknown_keys_and_wrong_types_are_refused() {
    for text in [
        "colour = 3",
        "[pin]\nradius = 23.0",
        "[pin]\nradius_mm = \"23\"",
        "[arm]\nhome_deg = [0.0]",
        "[table.rubber]\nthickness_mm = 3.0",
        "[[table.motion]]\naxis = \"roll\"\nrate_deg_s = 1.0\nfrom_s = 0.0\nto_s = 1.0",
        "[tactile]\nbits = -1",
    ] {
        assert!(toml::from_str::<WorldConfig>(text).is_err(), "{text}");
    }
}

#[test]
fn every_number_is_refused_when_it_is_nan_or_out_of_range() {
    type Field = (&'static str, fn(&mut WorldConfig) -> &mut f64, bool);
    let fields: [Field; 30] = [
        ("substep_us", |c| &mut c.substep_us, true),
        ("arm.home_deg[3]", |c| &mut c.arm.home_deg[3], false),
        ("arm.coulomb_scale", |c| &mut c.arm.coulomb_scale, true),
        ("arm.encoder_scale", |c| &mut c.arm.encoder_scale, true),
        ("arm.viscous_scale", |c| &mut c.arm.viscous_scale, true),
        ("arm.link_mass_scale[2]", |c| &mut c.arm.link_mass_scale[2], true),
        ("arm.tool_mass_scale", |c| &mut c.arm.tool_mass_scale, true),
        ("arm.power_on_s", |c| &mut c.arm.power_on_s, true),
        ("finger.rubber.thickness_mm", |c| &mut c.finger.rubber.thickness_mm, true),
        ("finger.rubber.youngs_mpa", |c| &mut c.finger.rubber.youngs_mpa, true),
        ("finger.rubber.poisson", |c| &mut c.finger.rubber.poisson, true),
        ("finger.rubber.relaxation_ms", |c| &mut c.finger.rubber.relaxation_ms, true),
        ("finger.friction", |c| &mut c.finger.friction, true),
        ("pin.radius_mm", |c| &mut c.pin.radius_mm, true),
        ("pin.length_mm", |c| &mut c.pin.length_mm, true),
        ("pin.mass_kg", |c| &mut c.pin.mass_kg, true),
        ("pin.x_mm", |c| &mut c.pin.x_mm, false),
        ("pin.y_mm", |c| &mut c.pin.y_mm, false),
        ("pin.yaw_deg", |c| &mut c.pin.yaw_deg, false),
        ("pin.fixture_release_n", |c| &mut c.pin.fixture_release_n, true),
        ("pin.rolling_resistance_mm", |c| &mut c.pin.rolling_resistance_mm, true),
        ("table.height_mm", |c| c.table.height_mm.get_or_insert(-195.0), false),
        ("table.tilt_x_deg", |c| &mut c.table.tilt_x_deg, false),
        ("table.tilt_y_deg", |c| &mut c.table.tilt_y_deg, false),
        ("table.pan_deg", |c| &mut c.table.pan_deg, false),
        ("table.rubber.youngs_mpa", |c| &mut c.table.rubber.youngs_mpa, true),
        ("table.friction", |c| &mut c.table.friction, true),
        ("tactile.noise_counts", |c| &mut c.tactile.noise_counts, true),
        ("tactile.rest_counts", |c| &mut c.tactile.rest_counts, true),
        ("tactile.full_scale_n", |c| &mut c.tactile.full_scale_n, true),
    ];
    for (place, field, size) in fields {
        let negative = if size { -1.0 } else { -1e9 };
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30, negative] {
            let found = refused(|c| *field(c) = bad);
            assert_eq!(found.place, place, "{bad}: {found}");
            assert!(!found.remedy.is_empty() && found.what.contains("is "), "{found}");
        }
    }
    for (place, field, _) in fields.iter().filter(|f| {
        ["radius_mm", "length_mm", "mass_kg", "thickness_mm", "youngs_mpa", "substep_us"]
            .iter()
            .any(|key| f.0.ends_with(key))
    }) {
        assert_eq!(refused(|c| *field(c) = 0.0).place, *place);
    }
}

#[test]
fn contradictions_are_refused() {
    let found = refused(|c| c.tactile.rest_counts = 249.0);
    assert_eq!(found.place, "tactile.rest_counts");
    assert!(found.what.contains("250"), "{found}");
    assert_eq!(refused(|c| c.tactile.delay_scans = 31).place, "tactile.delay_scans");
    assert_eq!(refused(|c| c.arm.tool_mass_scale = 0.0).place, "arm.tool_mass_scale");
    assert_eq!(refused(|c| c.tactile.bits = 7).place, "tactile.bits");
    assert_eq!(refused(|c| c.tactile.bits = 40).place, "tactile.bits");
    assert_eq!(refused(|c| c.arm_refresh_steps = 0).place, "arm_refresh_steps");
    assert_eq!(refused(|c| c.finger.rubber.poisson = 0.5).place, "finger.rubber.poisson");
    let found = refused(|c| c.arm.home_deg[4] = 130.0);
    assert_eq!(found.place, "arm.home_deg[4]");
    assert!(found.remedy.contains("122"), "{found}");
}

#[test]
fn motions_must_fit_their_axis_and_their_kind_and_run_forwards() {
    let good = Motion::ramp(Axis::Pan, 5.0, 1.0, 2.0);
    let with = |edit: fn(&mut Motion)| {
        let mut motion = good.clone();
        edit(&mut motion);
        let found = refused(|c| c.table.motion = vec![good.clone(), motion]);
        assert!(!found.remedy.is_empty());
        found.place.strip_prefix("table.motion[1]").unwrap().to_owned()
    };
    assert_eq!(with(|m| m.rate_deg_s = None), "");
    assert_eq!(with(|m| m.rate_mm_s = Some(1.0)), ".rate_mm_s");
    assert_eq!(with(|m| m.axis = Axis::Slide), ".rate_deg_s");
    assert_eq!(with(|m| m.rate_deg_s = Some(f64::NAN)), ".rate_deg_s");
    assert_eq!(with(|m| m.rate_deg_s = Some(1e9)), ".rate_deg_s");
    assert_eq!(with(|m| m.to_s = Some(1.0)), ".to_s");
    assert_eq!(with(|m| m.to_s = None), "");
    assert_eq!(with(|m| m.from_s = -1.0), ".from_s");
    assert_eq!(with(|m| m.blend_s = Some(0.6)), ".blend_s");
    assert_eq!(with(|m| m.by_deg = Some(1.0)), ".by_deg");
    assert_eq!(with(|m| m.kind = MotionKind::Step), ".rate_deg_s");
    assert_eq!(with(|m| *m = Motion::of(Axis::Pan, MotionKind::Step)), "");
    assert_eq!(with(|m| *m = Motion::of(Axis::Pan, MotionKind::Sine)), "");
    assert_eq!(refused(|c| c.table.motion = vec![good.clone(); 17]).place, "table.motion");
    let points = |points: &[[f64; 2]]| {
        let mut motion = Motion::of(Axis::Slide, MotionKind::Points);
        motion.points_mm = Some(points.to_vec());
        let place = refused(|c| c.table.motion = vec![motion]).place;
        place.strip_prefix("table.motion[0].points_mm").unwrap().to_owned()
    };
    assert_eq!(points(&[]), "");
    assert_eq!(points(&[[0.0, 1.0]]), "");
    assert_eq!(points(&[[0.0, 1.0], [1.0, f64::NAN]]), "[1][1]");
    assert_eq!(points(&[[0.0, 1.0], [1.0, 2.0], [0.5, 0.0]]), "[2][0]");
    assert_eq!(points(&[[-0.5, 1.0], [1.0, 2.0]]), "[0][0]");
    let mut unread = Motion::of(Axis::Slide, MotionKind::Points);
    assert_eq!(refused(|c| c.table.motion = vec![unread.clone()]).place, "table.motion[0]");
    unread.file = Some("hand.csv".to_owned());
    assert_eq!(refused(|c| c.table.motion = vec![unread.clone()]).place, "table.motion[0].file");
}

#[test]
fn every_key_is_listed_with_its_meaning_and_every_number_with_its_range() {
    let keys = WorldConfig::keys();
    let at = |path: &str| keys.iter().find(|key| key.path == path).unwrap();
    assert_eq!(at("pin.radius_mm").range, Some((1.0, 500.0)));
    assert_eq!(at("arm.home_deg[]").range, Some((-720.0, 720.0)));
    assert_eq!(at("table.motion[].from_s").range, Some((0.0, 1e6)));
    assert_eq!(at("table.rubber.poisson").about, "Poisson's ratio, below 0.5.");
    let silent: Vec<_> =
        keys.iter().filter(|key| key.about.is_empty() && !key.path.ends_with("[]")).collect();
    assert!(silent.is_empty(), "{silent:?}");
    assert!(keys.iter().all(|key| key.range.is_none_or(|(low, high)| low < high)));
}

#[test]
fn an_integrator_that_cannot_follow_the_gears_is_refused() {
    let springy = |integrator| {
        refused(|c| {
            c.fidelity.arm = ArmModel::Compliant;
            c.fidelity.integrator = integrator;
            c.substep_us = 20.0;
        })
    };
    for integrator in [Integrator::Euler, Integrator::Rk4] {
        assert_eq!(springy(integrator).place, "fidelity.integrator");
    }
    let found = springy(Integrator::Euler);
    assert!(found.what.contains("gears that give way"), "{found}");
    assert_eq!(found.remedy, "say auto or implicit");
}

#[test]
fn a_step_too_long_for_the_rubber_is_refused_with_figures() {
    let explicit = |c: &mut WorldConfig| {
        c.fidelity.integrator = Integrator::Euler;
        c.substep_us = 80.0;
    };
    let found = refused(|c| {
        explicit(c);
        c.finger.rubber.youngs_mpa = 27.58;
    });
    assert_eq!(found.place, "substep_us");
    assert!(found.what.contains("rad/s") && found.remedy.contains("use "), "{found}");
    let found = refused(|c| {
        explicit(c);
        c.pin.mass_kg = 0.02;
    });
    assert_eq!(found.place, "substep_us");
    // The figure in the remedy is accepted.
    let digits: String = found.remedy.chars().skip(4).take_while(char::is_ascii_digit).collect();
    let mut config = WorldConfig::default();
    explicit(&mut config);
    config.pin.mass_kg = 0.02;
    config.substep_us = digits.parse().unwrap();
    build(&config, &Timing::default(), 0).unwrap();
    // The rubber of the thesis works with a steel pin and a short step.
    let mut config = WorldConfig::default();
    explicit(&mut config);
    config.finger.rubber.youngs_mpa = 27.58;
    (config.pin.mass_kg, config.substep_us) = (1.04, 50.0);
    build(&config, &Timing::default(), 0).unwrap();
    // The implicit integrator accepts all of these scenes.
    config.fidelity.integrator = Integrator::Auto;
    config.substep_us = 1250.0;
    build(&config, &Timing::default(), 0).unwrap();
}

#[test]
fn a_finger_that_starts_inside_something_is_refused() {
    // The pin is 15 mm under the finger by default, pressed into the table by its weight.
    let found = refused(|c| c.table.height_mm = Some(-149.0 - 46.0 + 20.0));
    assert_eq!(found.place, "pin");
    assert!(found.what.contains("4.958 mm inside"), "{found}");
    assert!(found.remedy.contains("table.height_mm"), "{found}");
    for kind in [ObjectKind::Sphere, ObjectKind::Edge, ObjectKind::Bar] {
        let found = refused(|c| {
            c.pin.present = false;
            let far = ObjectConfig { x_mm: 200.0, ..ObjectConfig::of(kind) };
            c.object = vec![far, ObjectConfig { top_mm: 62.0, ..ObjectConfig::of(kind) }];
        });
        assert_eq!(found.place, "object[1]", "{kind:?}");
        assert!(found.what.contains("mm inside"), "{found}");
    }
}

#[test]
fn timings_and_carriages_are_checked_too() {
    let bad = Timing { control_period: taktil_hal::Nanos::ZERO, ..Timing::default() };
    let found = build(&WorldConfig::default(), &bad, 0).unwrap_err();
    assert_eq!(found.place, "control_period");
    let carriage = |edit: fn(&mut Carriage)| {
        let mut carriage = Carriage {
            axes: common::nominal(),
            knots: vec![(0.0, common::over(0.0))],
            float: None,
        };
        edit(&mut carriage);
        build_with_carriage(&WorldConfig::default(), &Timing::default(), 0, carriage)
            .unwrap_err()
            .place
    };
    assert_eq!(carriage(|c| c.knots.clear()), "carriage.knots");
    assert_eq!(carriage(|c| c.knots.push((0.0, common::over(0.0)))), "carriage.knots");
    assert_eq!(carriage(|c| c.knots[0].1.x = f64::NAN), "carriage.knots");
    assert_eq!(carriage(|c| c.axes.x_axis *= 2.0), "carriage.axes");
    assert_eq!(carriage(|c| c.axes.x_axis *= -1.0), "carriage.axes", "left-handed");
    let float = FloatingGuide { mass_kg: 0.0, load_n: 1.0, damping_n_s_m: 0.0 };
    assert_eq!(carriage_with(float), "carriage.float");
}

fn carriage_with(float: FloatingGuide) -> String {
    let knots = vec![(0.0, common::over(0.0))];
    let carriage = Carriage { axes: common::nominal(), knots, float: Some(float) };
    build_with_carriage(&WorldConfig::default(), &Timing::default(), 0, carriage).unwrap_err().place
}

mod common;
