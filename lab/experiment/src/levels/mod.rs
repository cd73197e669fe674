//! `taktil bench sim`, part scenes: runs each scene at every fidelity level of the physics and
//! tabulates the wall time beside the difference from the finest level. In the first comparison the
//! arm follows its trajectory of the finest level, so that only contact and step differ. In the
//! second one the whole stack runs in virtual time, and each control loop oscillates with its own
//! phase. All levels use the same noise or none, and a scene in which no finger presses is an
//! error.

pub mod compare;
mod picture;
pub mod prescribed_motion;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use taktil_sim::fidelity::{ContactModel, Integrator};

use compare::{Differences, recorded_run, run_time_s};
pub use picture::picture;
use taktil_lab_progress::Progress;
use taktil_lab_scene::scene::{Scene, duration};
use taktil_lab_world::WorldStatistics;
use taktil_machine_console::option::BadOption;

/// The scenes, and how much of them is run.
#[derive(Clone, Debug, clap::Args)]
pub struct SceneOptions {
    /// Scenes to run at every level: files, or folders of which E1 to E9 are taken
    #[arg(long, value_name = "PATH", num_args = 1.., default_value = "sim/scenes")]
    pub scenes: Vec<PathBuf>,
    /// How much of each scene is run (s)
    #[arg(long = "for", value_name = "S", default_value_t = 5.0)]
    pub span_s: f64,
    /// Noise of a tactel in the scenes instead of their own (counts)
    #[arg(long, value_name = "COUNTS", default_value_t = 0.0)]
    pub noise: f64,
    /// File for time against error of the scenes (SVG); none without it
    #[arg(long, value_name = "FILE")]
    pub scenes_out: Option<PathBuf>,
}

/// A fidelity level of the physics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FidelityLevel {
    contact: ContactModel,
    integrator: Integrator,
    step_us: f64,
}

const fn implicit(contact: ContactModel, step_us: f64) -> FidelityLevel {
    FidelityLevel { contact, integrator: Integrator::Implicit, step_us }
}

/// The level with which the others are compared.
const FINEST_LEVEL: FidelityLevel = implicit(ContactModel::Layer3dFine, 312.5);

/// The default level first, then increasingly fine contact models.
const LEVELS: [FidelityLevel; 7] = [
    implicit(ContactModel::Line, 1250.0),
    implicit(ContactModel::Line, 312.5),
    FidelityLevel { contact: ContactModel::Line, integrator: Integrator::Euler, step_us: 80.0 },
    implicit(ContactModel::Layer2d, 1250.0),
    implicit(ContactModel::Layer3d, 1250.0),
    implicit(ContactModel::Layer3d, 312.5),
    implicit(ContactModel::Layer3dFine, 1250.0),
];

impl FidelityLevel {
    /// Name of the level for people.
    fn name(&self) -> String {
        let FidelityLevel { contact, integrator, step_us } = self;
        let contact = match contact {
            ContactModel::Line => "line",
            ContactModel::Layer2d => "layer-2d",
            ContactModel::Layer3d => "layer-3d",
            ContactModel::Layer3dFine => "layer-3d-fine",
        };
        let euler = if *integrator == Integrator::Euler { " euler" } else { "" };
        format!("{contact}{euler} {step_us} us")
    }

    fn applied_to(&self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        let world = &mut scene.world;
        (world.fidelity.contact, world.fidelity.integrator) = (self.contact, self.integrator);
        world.substep_us = self.step_us;
        scene
    }
}

/// One scene at one level; the differences are 0 at the finest level.
pub struct Row {
    scene: String,
    level: FidelityLevel,
    /// Differences with the prescribed motion of the arm.
    prescribed_motion: Differences<{ prescribed_motion::MEASURES.len() }>,
    /// Differences with the whole stack, and wall time of a simulated second (ms).
    whole_stack: (Differences<{ compare::MEASURES.len() }>, f64),
    /// Root mean square of M0 and of the force about their set points, with the whole stack (%).
    swing: [f64; 2],
    work: WorldStatistics,
}

/// The requested scenes, by short names.
///
/// # Errors
/// A scene that cannot be read, or in which there is nothing to compare.
pub fn load_scenes(options: &SceneOptions) -> anyhow::Result<Vec<(String, Scene)>> {
    let mut found = Vec::new();
    for path in &options.scenes {
        if path.is_dir() {
            let (experiments, _) = crate::experiment_scenes(path, &[])?;
            found.extend(experiments.into_iter().map(|(e, _, scene)| (e.id.to_owned(), scene)));
        } else {
            found.push((file_stem(path), Scene::load(path)?));
        }
    }
    for (name, scene) in &mut found {
        if !scene.robot.is_puma260() {
            return Err(BadOption(format!("--scenes: {name}: this arm touches nothing")).into());
        }
        scene.world.tactile.noise_counts = options.noise;
        scene.world.opposed.tactile.noise_counts = options.noise;
        scene.world.check().map_err(|bad| BadOption(format!("--noise: {name}: {bad}")))?;
        let span = duration(options.span_s, "--for").map_err(|bad| BadOption(bad.to_string()))?;
        scene.duration = scene.duration.min(span);
    }
    Ok(found)
}

fn file_stem(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Runs every scene at every level. Wall times are the shortest of `rounds` runs; those of the two
/// finest levels are from one run.
///
/// # Errors
/// A level that a scene does not support, or a scene in which the finger never presses.
pub fn compare_scenes(scenes: &[(String, Scene)], rounds: u32) -> anyhow::Result<Vec<Row>> {
    let mut rows = Vec::new();
    let mut progress = Progress::new("levels of scenes", scenes.len() * LEVELS.len());
    for (name, scene) in scenes {
        let (until, seed) = (scene.duration, scene.seed);
        let (finest, finest_s) = recorded_run(&FINEST_LEVEL.applied_to(scene), until, seed)?;
        let from = finest.comparison_start().filter(|from| *from < until).ok_or_else(|| {
            let what =
                "the finger never presses for a second; name a scene of touch, or more of it";
            BadOption(format!("--scenes: {name}: {what}"))
        })?;
        let follows = prescribed_motion::with_prescribed_motion(scene, &finest);
        let exact =
            prescribed_motion::image_values(&FINEST_LEVEL.applied_to(&follows), until, seed)?;
        let ms = |spent_s: f64| 1e3 * spent_s / until.as_secs_f64();
        for level in LEVELS {
            let (chosen, follows) = (level.applied_to(scene), level.applied_to(&follows));
            let (course, mut whole_s) = recorded_run(&chosen, until, seed)?;
            let felt = prescribed_motion::image_values(&follows, until, seed)?;
            if level.contact != ContactModel::Layer3dFine {
                whole_s = f64::INFINITY;
                for _ in 0..rounds {
                    whole_s = whole_s.min(run_time_s(&chosen, until, seed)?);
                }
            }
            rows.push(Row {
                scene: name.clone(),
                level,
                prescribed_motion: prescribed_motion::differences_to_finest(&felt, &exact, from),
                whole_stack: (course.differences_to(&finest, from), ms(whole_s)),
                swing: course.rms_about_set_points(from),
                work: course.work,
            });
            progress.advance();
        }
        rows.push(Row {
            scene: name.clone(),
            level: FINEST_LEVEL,
            prescribed_motion: prescribed_motion::differences_to_finest(&exact, &exact, from),
            whole_stack: (finest.differences_to(&finest, from), ms(finest_s)),
            swing: finest.rms_about_set_points(from),
            work: finest.work,
        });
    }
    Ok(rows)
}

/// The tables in Markdown: differences for the same motions, differences for the whole stack with
/// wall times, each also as root mean square, and the counts.
#[must_use]
pub fn comparison_tables(rows: &[Row]) -> String {
    let time = |ms: f64| vec![format_figure(ms), format_figure(1e3 / ms)];
    let of_whole = ["M0 rms, %", "force rms, %", "ms a simulated second", "times real time"];
    let (prescribed_motion, whole) = (&prescribed_motion::MEASURES, &compare::MEASURES);
    let values = |values: &[f64]| values.iter().map(|v| format_figure(*v)).collect::<Vec<String>>();
    let mut out = markdown_table(
        "the same motions, largest differences to the finest level",
        prescribed_motion,
        rows,
        |row| values(&row.prescribed_motion.most),
    );
    out += &markdown_table(
        "the same motions, rms differences to the finest level",
        prescribed_motion,
        rows,
        |row| values(&row.prescribed_motion.rms),
    );
    out += &markdown_table(
        "the whole stack, largest differences to the finest level; M0 and force about their set \
         points",
        &[&whole[..], &of_whole].concat(),
        rows,
        |row| {
            [values(&row.whole_stack.0.most), values(&row.swing), time(row.whole_stack.1)].concat()
        },
    );
    out += &markdown_table(
        "the whole stack, rms differences to the finest level",
        whole,
        rows,
        |row| values(&row.whole_stack.0.rms),
    );
    out += &markdown_table("the whole stack, what was counted", &COUNT_NAMES, rows, |row| {
        let WorldStatistics {
            steps,
            halved_steps,
            unconverged_steps,
            newton_iterations,
            contact_evaluations,
            tactile_images,
            spatial_solutions,
            spatial_failures,
            ..
        } = row.work;
        let counts = [
            steps,
            halved_steps,
            unconverged_steps,
            newton_iterations,
            contact_evaluations,
            tactile_images,
            spatial_solutions,
            spatial_failures,
        ];
        counts.map(|count| count.to_string()).to_vec()
    });
    out
}

/// Names of the counts.
const COUNT_NAMES: [&str; 8] =
    ["steps", "halved", "not converged", "iterations", "contacts", "images", "solved", "failed"];

fn markdown_table(
    title: &str,
    heads: &[&str],
    rows: &[Row],
    cells: impl Fn(&Row) -> Vec<String>,
) -> String {
    let mut out = format!("## Scenes, {title}\n\n| scene | level | {} |\n", heads.join(" | "));
    out += &format!("|{}\n", "---|".repeat(2 + heads.len()));
    for row in rows {
        let (scene, level) = (&row.scene, row.level.name());
        let _ = writeln!(out, "| {scene} | {level} | {} |", cells(row).join(" | "));
    }
    out + "\n"
}

/// Two significant digits; a dash for an undefined value.
fn format_figure(value: f64) -> String {
    if value.is_nan() {
        return "–".to_owned();
    }
    if value == 0.0 || value >= 10.0 {
        return format!("{value:.0}");
    }
    if value < 0.01 {
        return format!("{value:.1e}");
    }
    format!(
        "{value:.*}",
        if value < 0.1 {
            3
        } else if value < 1.0 {
            2
        } else {
            1
        }
    )
}
