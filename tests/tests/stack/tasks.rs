//! Tasks of touch on objects: holding contact, following a surface, following an edge, levelling on
//! a bar. The simulator's truth over several seeds is the measure. Beside each task runs a control
//! that can only press, and must fail.

use taktil_lab_world::{ObjectTruth, WorldTruth};
use taktil_rtcore::Nanos;
use taktil_signal::{Contact, State};
use taktil_tests::bench::{SceneDraft, run};
use toml::{Table, Value};

/// The judgement begins this long after the force has first reached PRESSED_SHARE.
const SETTLING_TIME: Nanos = Nanos::from_millis(1_500);
/// The share of the set point that counts as pressed.
const PRESSED_SHARE: f64 = 0.8;

/// What came of a task.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Root mean square of the force's error over the set point.
    force: f64,
    /// How often contact was lost, from first touch on.
    lost: usize,
    /// Root mean square and peak of the load's distance from the middle of the pad (mm).
    place_mm: (f64, f64),
    /// Root mean square and peak of an edge's distance from the middle of the pad (mm).
    off_mm: (f64, f64),
    /// Root mean square and peak of the angle between edge and sensor (deg).
    yaw_deg: (f64, f64),
    /// Way along the edge (mm), or of the finger.
    along_mm: f64,
    /// Tilt against a bar at the end, the larger one (deg).
    tilt_deg: f64,
    /// Turn of the finger's normal from start to end (deg).
    turned_deg: f64,
}

/// Root mean square and peak.
#[expect(clippy::cast_precision_loss, reason = "counts of samples")]
fn spread(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut n, mut squares, mut peak) = (0_usize, 0.0, 0.0_f64);
    for value in values {
        (n, squares, peak) = (n + 1, squares + value * value, peak.max(value.abs()));
    }
    ((squares / n.max(1) as f64).sqrt(), peak)
}

/// The outcome of a run; nothing when the finger never pressed or the machine stopped.
fn outcome(draft: &SceneDraft, seed: u64) -> Option<Outcome> {
    let scene = draft.scene();
    let kept = run(&scene, seed);
    let control = kept.last_control();
    if control.faults != 0 || control.state != State::TactileServo as u32 {
        println!("   faults {:#x}, state {}", control.faults, control.state);
        return None;
    }
    let config = scene.machine.tactile_servo.clone().unwrap_or_default();
    let due_n = config.m0_counts * 4.0 / 4095.0;
    let all: Vec<(Nanos, ObjectTruth)> = kept.of("world.object");
    let since =
        all.iter().find(|(_, felt)| felt.normal_n > PRESSED_SHARE * due_n)?.0 + SETTLING_TIME;
    let felt: Vec<ObjectTruth> =
        all.iter().filter(|(t, _)| *t >= since).map(|(_, felt)| *felt).collect();
    let world: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let world: Vec<WorldTruth> =
        world.into_iter().filter(|(t, _)| *t >= since).map(|(_, truth)| truth).collect();
    let (first, last) = (felt.first()?, felt.last()?);
    let touches = |felt: &ObjectTruth| felt.normal_n > 0.0;
    let mm = |value: f64| 1e3 * value;
    let arm = taktil_mechanics::puma260::Puma260::reference();
    let normal = |truth: &WorldTruth| {
        arm.tool_pose(&taktil_mechanics::Joints::from(truth.q_rad)).rotation.z_axis
    };
    let turned = normal(world.first()?).dot(normal(world.last()?)).clamp(-1.0, 1.0);
    let [a, b] = last.tilt_rad;
    Some(Outcome {
        force: spread(felt.iter().map(|felt| felt.normal_n / due_n - 1.0)).0,
        lost: all.windows(2).filter(|pair| touches(&pair[0].1) && !touches(&pair[1].1)).count()
            + usize::from(!touches(first)),
        place_mm: spread(
            felt.iter().map(|f| mm(libm::hypot(f.centre_of_load_m[0], f.centre_of_load_m[1]))),
        ),
        off_mm: spread(felt.iter().map(|felt| mm(felt.offset_m))),
        yaw_deg: spread(felt.iter().map(|felt| felt.yaw_rad.to_degrees())),
        along_mm: mm(last.arc_length_m - first.arc_length_m),
        tilt_deg: a.abs().max(b.abs()).to_degrees(),
        turned_deg: libm::acos(turned).to_degrees(),
    })
}

/// The same scene with a law that presses, and feeds, and nothing else.
fn pressing_only(draft: SceneDraft) -> SceneDraft {
    let mut press = Table::new();
    press.insert("name".into(), "m0".into());
    press.insert("jacobian".into(), Value::Array(vec![14_000.0.into()]));
    press.insert("kp_per_s".into(), 12.0.into());
    press.insert("ki_per_s2".into(), 30.0.into());
    draft
        .set("robot.tactile_servo.task_frame.state", Value::Array(vec!["z".into()]))
        .set("robot.tactile_servo.task_frame.feature", Value::Array(vec![Value::Table(press)]))
}

/// What a variant is called, and what it changes.
type Variant = (&'static str, fn(SceneDraft) -> SceneDraft);

/// Every variant with every seed; says what came of each.
fn judge(what: &str, variants: &[Variant], file: &str, sound: impl Fn(&Outcome) -> bool) {
    for (variant, change) in variants {
        for seed in 1..=3 {
            let outcome = outcome(&change(SceneDraft::of(file)), seed);
            println!("{what}, {variant}, seed {seed}: {outcome:.2?}");
            let outcome = outcome.unwrap_or_else(|| panic!("{what}, {variant}: stopped"));
            assert!(sound(&outcome), "{what}, {variant}, seed {seed}: {outcome:?}");
        }
    }
    let control = outcome(&pressing_only(SceneDraft::of(file)), 1);
    println!("{what}, pressing only: {control:.2?}");
    let control = control.unwrap_or_else(|| panic!("{what}: the control did not run to its end"));
    assert!(!sound(&control), "{what}: the control should fail");
}

fn as_it_is(draft: SceneDraft) -> SceneDraft {
    draft
}

#[test]
fn contact_is_held_while_the_table_moves() {
    let variants: [Variant; 2] = [
        ("a ball of 20 mm", as_it_is),
        ("a ball of 35 mm", |d| d.set("world.object.radius_mm", 35.0)),
    ];
    judge("hold", &variants, "hold-contact.toml", |o| {
        o.lost == 0 && o.force < 0.25 && o.place_mm.0 < 1.5 && o.place_mm.1 < 3.0
    });
}

#[test]
fn a_surface_of_unknown_tilt_and_curvature_is_followed() {
    let variants: [Variant; 5] = [
        ("a dome of 80 mm", as_it_is),
        ("a dome of 40 mm", |d| d.set("world.object.radius_mm", 40.0)),
        ("a dome of 200 mm", |d| d.set("world.object.radius_mm", 200.0)),
        ("a dome of 55 mm", |d| d.set("world.object.radius_mm", 55.0)),
        ("a dome of 130 mm, elsewhere", |d| {
            d.set("world.object.radius_mm", 130.0).set("world.object.y_mm", -8.0)
        }),
    ];
    judge("surface", &variants, "follow-surface.toml", |o| {
        o.lost == 0 && o.force < 0.1 && o.place_mm.0 < 2.0 && o.turned_deg > 5.0
    });
}

/// Where a dome is small or far aside, the finger meets it with the edge of its pad, which sees a
/// third of the load. A contact that noise feigns, or turns that step to their full speed, made it
/// bounce there for seconds.
#[test]
fn a_first_touch_at_the_edge_of_the_pad_does_not_bounce() {
    let variants: [Variant; 3] = [
        ("40 mm", |d| d.set("world.object.radius_mm", 40.0)),
        ("55 mm", |d| d.set("world.object.radius_mm", 55.0)),
        ("55 mm, far aside", |d| {
            d.set("world.object.radius_mm", 55.0)
                .set("world.object.x_mm", -12.0)
                .set("world.object.y_mm", -14.0)
        }),
    ];
    for (variant, change) in variants {
        for seed in [1, 4, 7, 8, 9, 11, 12] {
            let draft = change(SceneDraft::of("follow-surface.toml")).set("duration_s", 2.5);
            let kept = run(&draft.scene(), seed);
            let felt: Vec<(Nanos, ObjectTruth)> = kept.of("world.object");
            let first = felt.iter().position(|(_, felt)| felt.normal_n > 0.0).unwrap();
            let parted = felt[first..].iter().filter(|(_, felt)| felt.normal_n <= 0.0).count();
            let touched: Vec<(Nanos, Contact)> = kept.of("tactile_servo.contact");
            let (at, gained) = (touched[0].0, touched.iter().map(|t| t.1.gained).max().unwrap());
            let late = at - felt[first].0;
            println!("{variant}, seed {seed}: parted {parted}, gained {gained}, late {late:?}");
            assert!(Nanos::ZERO < late && late < Nanos::from_millis(150), "{variant}, {seed}");
            assert!(parted == 0 && gained <= 2, "{variant}, seed {seed}: {parted}, {gained}");
        }
    }
}

#[test]
fn a_straight_edge_is_followed() {
    let variants: [Variant; 2] = [
        ("5 deg", as_it_is),
        ("-12 deg", |d| d.set("world.object.yaw_deg", -12.0).set("world.object.x_mm", -2.0)),
    ];
    judge("edge", &variants, "follow-edge.toml", |o| {
        o.lost == 0 && o.force < 0.2 && o.off_mm.0 < 0.5 && o.yaw_deg.0 < 2.0 && o.along_mm > 20.0
    });
}

#[test]
fn an_edge_is_followed_along_an_arc() {
    let variants: [Variant; 2] = [
        ("60 mm", as_it_is),
        ("90 mm, the other way", |d| d.set("world.object.arc_radius_mm", -90.0)),
    ];
    judge("arc", &variants, "follow-arc.toml", |o| {
        o.lost == 0 && o.force < 0.25 && o.off_mm.0 < 1.5 && o.along_mm > 20.0
    });
}

#[test]
fn an_edge_is_followed_round_a_corner() {
    let variants: [Variant; 1] = [("30 deg", as_it_is)];
    judge("corner", &variants, "follow-corner.toml", |o| {
        o.lost == 0 && o.force < 0.25 && o.off_mm.0 < 2.5 && o.along_mm > 20.0
    });
}

#[test]
fn a_bar_is_pressed_and_levelled() {
    let variants: [Variant; 2] = [
        ("2 and -1.5 deg", as_it_is),
        ("-1 and 3 deg", |d| {
            d.set("world.object.tilt_x_deg", -1.0).set("world.object.tilt_y_deg", 3.0)
        }),
    ];
    judge("bar", &variants, "level-bar.toml", |o| o.lost == 0 && o.force < 0.2 && o.tilt_deg < 0.4);
}
