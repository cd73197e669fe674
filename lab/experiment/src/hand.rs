//! `taktil experiment hand`: objects of drawn size, mass and friction in a hand of three fingers,
//! under drawn pushes. Each seed is run twice: with pushes within what the friction cones bear at
//! the strongest grip, where the object must be held, and with a push far beyond it, of which the
//! margin by touch must tell. A hand on a palm that stands holds the object when its support goes;
//! an arm lifts it from its support as its scene says, and the pushes come after the lift.

mod figures;

use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use taktil_hal::fault::SplitMix;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::run_virtual;
use taktil_lab_scene::scene::Scene;
use taktil_machine::with_robot;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_mechanics::Pose;
use taktil_mechanics::hand::{CARRIER_JOINTS, FINGER_JOINTS, Hand};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_sim::scene::{HeldShape, PushConfig};

use self::figures::{HandEvaluation, HandFigures};
use super::{SEEDS_MAX, run_parallel};

/// When the support is taken away and the hand bears the object alone (s).
const ALONE_S: f64 = 4.0;
/// When an arm has lifted it (s): the slowest grasp begins at 3.5 s and is held for 2 s, and the
/// lift takes 2.8 s.
const LIFTED_S: f64 = 8.0;
/// Share of its way by which the object has to be lifted: pushes move it in the hand.
const LIFTED_SHARE_MIN: f64 = 0.99;
/// From when on the object is judged (s): half a second after the support is gone, before a lift.
const JUDGED_NS: i64 = 4_500_000_000;
/// Pushes of a run within the cones, and the time of each with the rest after it (s).
const PUSHES_COUNT: usize = 3;
const PUSH_S: f64 = 0.7;
const PUSH_EVERY_S: f64 = 1.0;
/// Share of what the cones bear at the strongest grip that pushes and weight take at most, in runs
/// within the cones; and the multiple of it in runs beyond.
const WITHIN_SHARE: f64 = 0.35;
const BEYOND_MULTIPLE: f64 = 1.8;
/// How far (mm) an object that is held is moved and how far (deg) it is turned at most.
const MOVED_MAX_MM: f64 = 5.0;
const TURNED_MAX_DEG: f64 = 15.0;
/// Fingers of the hand.
const FINGER_COUNT: usize = 3;

/// Options of `taktil experiment hand`.
#[derive(Args, Debug)]
pub struct HandOptions {
    /// Seeds 1 to N, each with an object and pushes of its own
    #[arg(long, default_value_t = 20, value_name = "N")]
    seeds: u64,
    /// Only this seed
    #[arg(long, value_name = "K")]
    seed: Option<u64>,
    /// Scene whose object and pushes are replaced
    #[arg(long, default_value = "sim/scenes/hand/hold.toml", value_name = "FILE")]
    scene: PathBuf,
    /// Folder for hand.md and hand.csv
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// A run that is to be made.
struct Planned {
    seed: u64,
    beyond: bool,
    scene: Scene,
    about: String,
    /// Largest force of pushes and weight together (N).
    force_n: f64,
    /// How far the arm lifts the palm (mm); none where the palm stands.
    lift_mm: Option<f64>,
}

/// A drawn unit vector, even over the sphere.
fn drawn_direction(draw: &mut SplitMix) -> [f64; 3] {
    let z = draw.uniform(-1.0, 1.0);
    let (s, c) = libm::sincos(draw.uniform(0.0, core::f64::consts::TAU));
    let across = (1.0 - z * z).max(0.0).sqrt();
    [across * c, across * s, z]
}

/// Height of the faces' middles of `three-fingers.urdf` when they stand upright at this distance
/// from the middle (mm).
fn face_height_mm(distance_mm: f64) -> f64 {
    let (inner_mm, outer_mm, face_mm, base_mm) = (65.0, 50.0, 8.0, 5.0);
    let lean = libm::asin((distance_mm + face_mm - base_mm) / inner_mm);
    -inner_mm * libm::cos(lean) - outer_mm
}

/// The palm of the scene's hand where it starts, and whether an arm carries it.
fn palm_at_start(scene: &Scene) -> Option<(Pose, bool)> {
    fn palm<const F: usize, const N: usize>(
        robot: &Robot<N, Hand<F, N>>,
        degrees: &[f64],
    ) -> Option<(Pose, bool)> {
        let q = <[f64; N]>::try_from(degrees).ok()?.map(f64::to_radians);
        let pose = robot.arm.palm(&JointVector::from(q)).pose;
        Some((pose, robot.arm.carrier().is_some()))
    }
    with_robot!(&scene.robot,
        puma260: _robot => None,
        chain: _robot => None,
        hand: robot => palm(robot, &scene.start_deg)
    )
}

/// The scene of a seed.
fn drawn_scene(base: &Scene, seed: u64, beyond: bool) -> Planned {
    let mut draw = SplitMix::new(seed);
    let mut scene = base.clone();
    let palm = palm_at_start(base);
    let round = draw.unit() < 0.5;
    let radius_mm = draw.uniform(17.0, 32.0);
    let length_mm = draw.uniform(35.0, 70.0);
    let mass_kg = 0.02 * libm::exp(draw.unit() * libm::log(15.0));
    let friction = draw.uniform(0.65, 1.0);
    let law = base.machine.grasp.clone().unwrap_or_default();
    let bears_n = FINGER_COUNT as f64 * law.friction * law.grip_max_n;
    let weight_n = mass_kg * 9.81;
    let hand = &mut scene.world.hand;
    hand.shape = if round { HeldShape::Sphere } else { HeldShape::Cylinder };
    (hand.radius_mm, hand.length_mm, hand.mass_kg) = (radius_mm, length_mm, mass_kg);
    let half_mm = if round { radius_mm } else { 0.5 * length_mm };
    hand.support_mm = face_height_mm(radius_mm) - half_mm;
    hand.support_until_s = Some(ALONE_S);
    let mut alone_s = ALONE_S;
    if let Some((palm, true)) = palm {
        let place_mm = palm.translation * 1e3;
        (hand.x_mm, hand.y_mm) = (place_mm.x, place_mm.y);
        hand.support_mm += place_mm.z;
        (hand.support_until_s, alone_s) = (None, LIFTED_S);
    }
    hand.push.clear();
    let mut force_n = weight_n;
    for i in 0..PUSHES_COUNT {
        let direction = drawn_direction(&mut draw);
        let room_n = WITHIN_SHARE * bears_n - weight_n;
        let size = draw.uniform(0.3, 1.0) * room_n;
        let lever = [0.0; 3].map(|_: f64| draw.uniform(-2.0, 2.0));
        if beyond {
            continue;
        }
        let from_s = alone_s + 1.0 + PUSH_EVERY_S * i as f64;
        hand.push.push(PushConfig {
            from_s,
            to_s: from_s + PUSH_S,
            force_n: direction.map(|part| part * size),
            at_mm: lever,
            ramp_s: 0.3,
        });
        force_n = force_n.max(size + weight_n);
    }
    if beyond {
        // What a hand bears depends on the direction: along the axis of the fingers' circle all
        // cones bear alike.
        let size = BEYOND_MULTIPLE * FINGER_COUNT as f64 * friction * law.grip_max_n;
        hand.push.push(PushConfig {
            from_s: alone_s + 1.0,
            to_s: alone_s + 6.0,
            force_n: [0.0, 0.0, if draw.unit() < 0.5 { size } else { -size }],
            at_mm: [0.0; 3],
            ramp_s: 2.5,
        });
        force_n = size + weight_n;
    }
    scene.world.finger.friction = friction;
    let shape = match round {
        true => format!("sphere {:.1} mm", 2.0 * radius_mm),
        false => format!("cylinder {:.1} x {length_mm:.1} mm", 2.0 * radius_mm),
    };
    let about = format!("{shape}, {:.0} g, friction {friction:.2}", 1e3 * mass_kg);
    let lift_mm = palm.and_then(|(_, is_carried)| is_carried.then_some(law.lift_mm[2]));
    Planned { seed, beyond, scene, about, force_n, lift_mm }
}

fn judged(planned: &Planned) -> anyhow::Result<HandFigures> {
    let mut machine = Assembly::new(&planned.scene).with_seed(planned.seed).build()?;
    let law = planned.scene.machine.grasp.clone().unwrap_or_default();
    let mut judge =
        HandEvaluation::new(&planned.scene.robot, &machine.catalog().clone(), law.friction);
    run_virtual(&mut machine, planned.scene.duration, &mut judge)?;
    Ok(judge.verdict)
}

/// The row of a run in the table.
fn row(planned: &Planned, verdict: &HandFigures) -> String {
    let outcome = match (planned.beyond, verdict.told_ns, verdict.is_held(planned.lift_mm)) {
        (false, _, true) => "held".to_owned(),
        (false, _, false) => "**not held**".to_owned(),
        (true, None, _) => "**not told**".to_owned(),
        (true, Some(told), _) => match verdict.slid_ns {
            Some(slid) => format!("told {} ms before it slid", (slid - told) / 1_000_000),
            None => "told, and it did not slide".to_owned(),
        },
    };
    let fault = verdict.first_fault.map_or(String::new(), |(fault, t_ns)| {
        format!(", {fault:?} at {:.3} s", 1e-9 * t_ns as f64)
    });
    // An object that every finger has lost falls for the rest of the run.
    let moved = match verdict.losses as usize >= FINGER_COUNT {
        true => "lost".to_owned(),
        false => format!("{:.2}", verdict.moved_mm),
    };
    let lifted = planned.lift_mm.map_or(String::new(), |_| match moved.as_str() {
        "lost" => " lost |".to_owned(),
        _ => format!(" {:.1} |", verdict.lifted_mm),
    });
    format!(
        "| {} | {} | {:.1} | {}{fault} | {:.2} | {:.2} | {:.1} | {:.2} | {moved} | {:.1} | {} |\
         {lifted}",
        planned.seed,
        planned.about,
        planned.force_n,
        outcome,
        verdict.margin_n,
        verdict.true_margin_n.unwrap_or(0.0),
        verdict.grip_n,
        verdict.effort,
        verdict.turned_deg,
        verdict.losses,
    )
}

const HEAD: &str = "| seed | object | push and weight, N | outcome | least margin by touch, N | by \
                    the contacts, N | grip, N | share of the true cone | moved, mm | turned, deg \
                    | contacts lost |";
/// Columns of the table of a hand whose palm stands; an arm's has one more.
const COLUMN_COUNT: usize = 11;

/// The page: a table for each kind of push, and the worst seed of either.
fn page(options: &HandOptions, runs: &[(&Planned, HandFigures)]) -> String {
    let mut text = format!(
        "# A hand holds drawn objects\n\n`taktil experiment hand --seeds {}`\n",
        options.seeds
    );
    for (beyond, title) in [(false, "Pushes within the cones"), (true, "A push beyond them")] {
        let of = || runs.iter().filter(|(planned, _)| planned.beyond == beyond);
        let is_lifted = runs.iter().any(|(planned, _)| planned.lift_mm.is_some());
        let lifted = if is_lifted { " lifted, mm |" } else { "" };
        let rule = "---|".repeat(COLUMN_COUNT + usize::from(is_lifted));
        let _ = write!(text, "\n## {title}\n\n{HEAD}{lifted}\n|{rule}\n");
        for (planned, verdict) in of() {
            let _ = writeln!(text, "{}", row(planned, verdict));
        }
        let good = of().filter(|(planned, verdict)| is_good(planned, verdict)).count();
        let said = if beyond { "told by a negative margin" } else { "held" };
        let _ = write!(text, "\n{good} of {} {said}.", of().count());
        let worst = of().min_by(|a, b| {
            let by = |run: &(&Planned, HandFigures)| match beyond {
                true => (run.1.slid_ns.unwrap_or(0) - run.1.told_ns.unwrap_or(i64::MAX / 2)) as f64,
                false => run.1.margin_n,
            };
            by(a).total_cmp(&by(b))
        });
        if let Some((planned, _)) = worst {
            let seed = planned.seed;
            let scene = options.scene.display();
            let _ = writeln!(
                text,
                " Worst seed: {seed}: `taktil experiment hand --scene {scene} --seed {seed}`"
            );
        }
    }
    text
}

/// Whether a run is as it should be: held, or told of.
fn is_good(planned: &Planned, verdict: &HandFigures) -> bool {
    match planned.beyond {
        false => verdict.is_held(planned.lift_mm),
        true => verdict.grasped && verdict.told_ns.is_some(),
    }
}

/// Every run as a table with commas.
fn table(runs: &[(&Planned, HandFigures)]) -> String {
    let mut text = String::from(
        "seed,beyond,object,force_n,held,fault,least_margin_n,true_margin_n,grip_n,effort,\
         moved_mm,turned_deg,losses,told_ns,slid_ns,lifted_mm\n",
    );
    for (planned, v) in runs {
        let instant = |ns: Option<i64>| ns.map_or(String::new(), |ns| ns.to_string());
        let _ = writeln!(
            text,
            "{},{},\"{}\",{},{},{},{},{},{},{},{},{},{},{},{},{}",
            planned.seed,
            u32::from(planned.beyond),
            planned.about,
            planned.force_n,
            u32::from(v.is_held(planned.lift_mm)),
            v.first_fault.map_or(0, |(fault, _)| fault as u16),
            v.margin_n,
            v.true_margin_n.unwrap_or(0.0),
            v.grip_n,
            v.effort,
            v.moved_mm,
            v.turned_deg,
            v.losses,
            instant(v.told_ns),
            instant(v.slid_ns),
            v.lifted_mm,
        );
    }
    text
}

/// Runs the seeds and prints the page.
///
/// # Errors
/// Invalid input as [`BadOption`], a scene that is not one of three fingers, a file that cannot be
/// written.
pub fn run(options: &HandOptions) -> anyhow::Result<ExitCode> {
    if options.seeds == 0 || options.seeds > SEEDS_MAX {
        let text = format!("--seeds {}: give 1 to {SEEDS_MAX}", options.seeds);
        return Err(BadOption(text).into());
    }
    let base = Scene::load(&options.scene)?;
    let joints = [FINGER_COUNT * FINGER_JOINTS, CARRIER_JOINTS + FINGER_COUNT * FINGER_JOINTS];
    if !base.robot.is_hand() || !joints.contains(&base.robot.joints()) {
        let text = format!("--scene {}: not a hand of three fingers", options.scene.display());
        return Err(BadOption(text).into());
    }
    let seeds = options.seed.map_or(1..=options.seeds, |seed| seed..=seed);
    let plan: Vec<Planned> = seeds
        .flat_map(|seed| [false, true].map(|beyond| drawn_scene(&base, seed, beyond)))
        .collect();
    let verdicts = run_parallel(options.threads, &plan, judged)?;
    let runs: Vec<(&Planned, HandFigures)> =
        plan.iter().zip(verdicts).filter_map(|(planned, v)| Some((planned, v?))).collect();
    let text = page(options, &runs);
    if let Some(folder) = &options.out {
        taktil_machine_console::option::create_folder("--out", folder)?;
        for (name, text) in [("hand.md", &text), ("hand.csv", &table(&runs))] {
            let path = folder.join(name);
            std::fs::write(&path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    out::line(&text)?;
    let left = plan.len() - runs.len();
    if left > 0 {
        out::warn(format_args!("interrupted: {left} runs were not made"));
    }
    let good = runs.iter().all(|(planned, verdict)| is_good(planned, verdict));
    Ok(if good && left == 0 { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
