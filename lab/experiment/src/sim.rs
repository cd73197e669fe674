//! `taktil bench sim`: wall time of a simulated second against error, by integrator, step and
//! contact model, each compared with the finest of them in the same scene. The time excludes the
//! construction of the scene and the controllers: the finger follows rails, and the free arm has no
//! torque.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use glam::{DMat3, DVec3};
use taktil_hal::{Devices, LinesOut, Nanos, TACTILE, TactileFrame};
use taktil_machine_console::out;
use taktil_mechanics::spatial::rotation_x;
use taktil_mechanics::tactile::{Image, features, moments};
use taktil_rtcore::linux;
use taktil_sim::fidelity::{ArmModel, ContactModel, Integrator};
use taktil_sim::{Carriage, FloatingGuide, Timing, World, WorldConfig, build, build_with_carriage};

use super::levels;
use taktil_lab_plot::axis::{Scale, decade_ticks};
use taktil_lab_plot::svg::{Anchor, Figure, Point};
use taktil_lab_progress::Progress;
use taktil_machine_console::option::{BadOption, check_writable};

/// How often to measure, and where the picture goes.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Runs of each method; the fastest counts
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub rounds: u32,
    /// File for time against error of the centroid (SVG); none without it
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// One JSON object instead of the tables
    #[arg(long)]
    pub json: bool,
    /// Which scenes, at every level.
    #[command(flatten)]
    pub scene_options: levels::SceneOptions,
    /// Only one part: the arm alone, a pin on rails, or scenes by the whole stack
    #[arg(long, value_enum)]
    pub only: Option<Part>,
    /// Answer falls that are asked for on standard input, for a program that does the same
    #[arg(long, hide = true)]
    pub serve: bool,
}

/// The parts of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// The arm alone.
    Arm,
    /// A pin rolled by a finger on rails.
    Rails,
    /// Scenes by the whole stack.
    Scenes,
}

/// Duration of the free fall that is timed and compared (s).
const FALL_TIME_S: f64 = 0.3;
/// End of the pressing at rest in the rolling scene (s); the rolling follows.
const PRESSING_END_S: f64 = 0.3;
/// End of the rolling (s).
const ROLLING_END_S: f64 = 2.3;
/// Force on the finger (N).
const LOAD_N: f64 = 15.0;
/// Scan period of the default timing (s).
const SCAN_S: f64 = 5e-3;

/// Measures, prints the tables and draws the picture.
///
/// # Errors
/// [`BadOption`] for a number of runs that cannot be used; a file that cannot be written.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    if plan.serve {
        super::free_fall::serve(std::io::stdin().lock())?;
        return Ok(ExitCode::SUCCESS);
    }
    if !(1..=1000).contains(&plan.rounds) {
        return Err(BadOption(format!("--rounds {}: give 1 to 1000", plan.rounds)).into());
    }
    for (option, path) in [("--out", &plan.out), ("--scenes-out", &plan.scene_options.scenes_out)] {
        path.as_ref().map_or(Ok(()), |path| check_writable(option, path))?;
    }
    let asked = |part: Part| plan.only.is_none_or(|only| only == part);
    // Input errors are reported before anything is measured.
    let scenes =
        if asked(Part::Scenes) { levels::load_scenes(&plan.scene_options)? } else { Vec::new() };
    let (mut text, mut pictures) = (Vec::new(), Vec::new());
    if asked(Part::Arm) {
        text.push(format!("## Arm alone, {FALL_TIME_S} s of fall\n\n{}", arm_table(plan.rounds)?));
    }
    if asked(Part::Rails) {
        let rows = rolling_rows(plan.rounds)?;
        let title = format!("## Pin rolled by a finger on rails, {LOAD_N} N");
        text.push(format!("{title}\n\n{}", rolling_table(&rows)));
        pictures.extend(plan.out.as_ref().map(|path| (path, picture(&rows))));
    }
    if asked(Part::Scenes) {
        let rows = levels::compare_scenes(&scenes, plan.rounds)?;
        text.push(levels::comparison_tables(&rows));
        let path = plan.scene_options.scenes_out.as_ref();
        pictures.extend(path.map(|path| (path, levels::picture(&rows))));
    }
    let text = text.join("\n");
    if plan.json {
        let tables = taktil_lab_plot::markdown::tables_as_json(&text);
        out::line(serde_json::json!({ "rounds": plan.rounds, "tables": tables }))?;
    } else {
        out::line(&text)?;
    }
    for (path, figure) in pictures {
        std::fs::write(path, figure.svg_document())
            .with_context(|| format!("{}", path.display()))?;
        if !plan.json {
            out::line(path.display())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn seconds(s: f64) -> Nanos {
    Nanos((1e9 * s).round() as i64)
}

/// Advances the world and adds the wall time that it took.
fn advance_timed(world: &mut World, to: Nanos, spent: &mut Nanos) {
    let start = linux::monotonic();
    world.advance(to);
    *spent += linux::monotonic() - start;
}

/// Angles after the fall, and wall time of a simulated second (ms).
fn free_fall(
    arm: ArmModel,
    integrator: Integrator,
    substep_us: f64,
    period_us: i64,
) -> anyhow::Result<([f64; 6], f64)> {
    let mut config = WorldConfig { substep_us, arm_refresh_steps: 1, ..WorldConfig::default() };
    config.pin.present = false;
    (config.fidelity.arm, config.fidelity.integrator) = (arm, integrator);
    if arm == ArmModel::Kinematic {
        let [a, b, c, d, e, f] = config.arm.home_deg;
        config.arm.trajectory_deg =
            vec![[FALL_TIME_S, a + 10.0, b - 5.0, c + 5.0, d, e + 10.0, f - 10.0]];
    }
    let period = Nanos::from_micros(period_us);
    let timing =
        Timing { control_period: period, actuation_delay: Nanos::ZERO, scan_period: period * 2 };
    let (mut world, mut devices) = build(&config, &timing, 1)?;
    let (mut spent, mut t, mut feed) = (Nanos::ZERO, Nanos::ZERO, false);
    while t < seconds(FALL_TIME_S) {
        feed = !feed;
        let order = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        devices.require_digital_out()?.commit(t, &order)?;
        devices.require_encoders()?.sample(t)?;
        t += period;
        advance_timed(&mut world, t, &mut spent);
    }
    let q = world.truth().q;
    Ok((core::array::from_fn(|i| q[i]), spent.as_secs_f64() * 1e3 / FALL_TIME_S))
}

/// Work against precision of the arm alone, in Markdown.
fn arm_table(rounds: u32) -> anyhow::Result<String> {
    let mut out = String::from(
        "| arm | integrator | step, us | error, rad | ms a simulated second | times real time |\n\
         |---|---|---|---|---|---|\n",
    );
    let cases = [
        (ArmModel::Kinematic, Integrator::Auto, 2500.0, 2500),
        (ArmModel::Rigid, Integrator::Rk4, 2500.0, 2500),
        (ArmModel::Rigid, Integrator::Rk4, 1250.0, 2500),
        (ArmModel::Rigid, Integrator::Implicit, 2500.0, 2500),
        (ArmModel::Rigid, Integrator::Implicit, 625.0, 2500),
        (ArmModel::Rigid, Integrator::Euler, 1250.0, 2500),
        (ArmModel::Rigid, Integrator::Euler, 80.0, 2500),
        (ArmModel::RigidMotors, Integrator::Implicit, 2500.0, 2500),
        (ArmModel::RigidMotors, Integrator::Implicit, 625.0, 2500),
        (ArmModel::RigidMotors, Integrator::Euler, 80.0, 2500),
        (ArmModel::Compliant, Integrator::Implicit, 2500.0, 2500),
        (ArmModel::Compliant, Integrator::Implicit, 625.0, 2500),
    ];
    let mut progress = Progress::new("arms", cases.len());
    for (arm, integrator, step_us, period_us) in cases {
        let (method, finest_us) = match arm {
            ArmModel::Kinematic => (Integrator::Auto, 250.0),
            ArmModel::Rigid => (Integrator::Rk4, 250.0),
            ArmModel::RigidMotors | ArmModel::Compliant => (Integrator::Implicit, 20.0),
        };
        let (exact, _) = free_fall(arm, method, finest_us, period_us)?;
        let mut best = f64::INFINITY;
        let mut error = 0.0_f64;
        for _ in 0..rounds {
            let (q, ms) = free_fall(arm, integrator, step_us, period_us)?;
            best = best.min(ms);
            error = q.iter().zip(&exact).fold(0.0, |most, (a, b)| most.max((a - b).abs()));
        }
        writeln!(
            out,
            "| {arm:?} | {integrator:?} | {step_us} | {error:.1e} | {best:.2} | {:.0} |",
            1e3 / best
        )?;
        progress.advance();
    }
    Ok(out)
}

/// The compared quantities.
const FEATURES: [&str; 8] =
    ["M0, %", "x_c, mm", "y_c, mm", "theta_z, deg", "force, %", "p_x, um", "p_z, um", "yaw, deg"];

/// One method of simulating the rolling scene.
struct Row {
    contact: ContactModel,
    integrator: Integrator,
    step_us: f64,
    errors: [f64; 8],
    ms: f64,
}

/// The pin is rotated and the finger leans, so that every feature has a value.
fn rolling_scene(
    contact: ContactModel,
    integrator: Integrator,
    step_us: f64,
) -> (WorldConfig, Carriage) {
    let mut config = WorldConfig { substep_us: step_us, ..WorldConfig::default() };
    (config.fidelity.contact, config.fidelity.integrator) = (contact, integrator);
    config.pin.yaw_deg = 2.0;
    (config.tactile.noise_counts, config.tactile.bits) = (0.0, 16);
    let top = 1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm);
    let at = DVec3::new(0.325, -0.127, top + 1e-4);
    let knots = vec![(PRESSING_END_S, at), (ROLLING_END_S, at + DVec3::new(0.015, 0.0, 0.0))];
    let axes = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z) * rotation_x(2e-4);
    let float = Some(FloatingGuide { mass_kg: 1.0, load_n: LOAD_N, damping_n_s_m: 200.0 });
    (config, Carriage { axes, knots, float })
}

/// Features at each scan after the pressing, and wall time of a simulated second (ms).
fn rolling_run(
    contact: ContactModel,
    integrator: Integrator,
    step_us: f64,
) -> anyhow::Result<(Vec<[f64; 8]>, f64)> {
    let (config, carriage) = rolling_scene(contact, integrator, step_us);
    let (mut world, mut devices) = build_with_carriage(&config, &Timing::default(), 1, carriage)?;
    let (mut spent, mut samples) = (Nanos::ZERO, Vec::new());
    for i in 1..=(ROLLING_END_S / SCAN_S).round() as i64 {
        let t = Nanos::from_millis(5) * i;
        advance_timed(&mut world, t, &mut spent);
        let sample = image_values(&config, &world, &mut devices, t)?;
        if t >= seconds(PRESSING_END_S) {
            samples.push(sample);
        }
    }
    Ok((samples, spent.as_secs_f64() * 1e3 / ROLLING_END_S))
}

fn image_values(
    config: &WorldConfig,
    world: &World,
    devices: &mut Devices,
    t: Nanos,
) -> anyhow::Result<[f64; 8]> {
    let array = devices.require_tactile(TACTILE)?;
    let mut frame = TactileFrame::of(array);
    array.sample(t, &mut frame)?;
    let rest = config.tactile.rest_counts;
    let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - rest) as f32).collect();
    let (rows, cols) = (usize::from(frame.rows()), usize::from(frame.cols()));
    let image = Image::new(rows, cols, &values, None).context("an image of the array")?;
    let moments = moments(&image, 0.0);
    let found = features(&moments);
    let truth = world.truth();
    let array = config.tactile.geometry();
    Ok([
        moments.m0,
        1e3 * array.pitch_x_m * found.x_c.unwrap_or(0.0),
        1e3 * array.pitch_y_m * found.y_c.unwrap_or(0.0),
        found.theta_z_rad.unwrap_or(0.0).to_degrees(),
        truth.finger_normal_n,
        1e6 * truth.pin.x,
        1e6 * truth.tool.z,
        truth.pin_yaw_rad.to_degrees(),
    ])
}

/// Largest differences; M0 and the force in percent.
fn largest_differences(samples: &[[f64; 8]], exact: &[[f64; 8]]) -> [f64; 8] {
    let mut worst = [0.0_f64; 8];
    for (a, b) in samples.iter().zip(exact) {
        for (i, most) in worst.iter_mut().enumerate() {
            let scale = if i == 0 || i == 4 { 100.0 / b[i].abs().max(1e-9) } else { 1.0 };
            *most = most.max(scale * (a[i] - b[i]).abs());
        }
    }
    worst
}

fn rolling_rows(rounds: u32) -> anyhow::Result<Vec<Row>> {
    let finest = (ContactModel::Layer3dFine, Integrator::Implicit, 312.5);
    let (exact, finest_ms) = rolling_run(finest.0, finest.1, finest.2)?;
    let cases = [
        (ContactModel::Line, Integrator::Implicit, 1250.0),
        (ContactModel::Line, Integrator::Implicit, 312.5),
        (ContactModel::Line, Integrator::Euler, 80.0),
        (ContactModel::Line, Integrator::Euler, 20.0),
        (ContactModel::Layer2d, Integrator::Implicit, 1250.0),
        (ContactModel::Layer3d, Integrator::Implicit, 1250.0),
        (ContactModel::Layer3d, Integrator::Implicit, 312.5),
        (ContactModel::Layer3dFine, Integrator::Implicit, 1250.0),
    ];
    let mut rows = Vec::new();
    let mut progress = Progress::new("pins on rails", cases.len());
    for (contact, integrator, step_us) in cases {
        let (mut best, mut errors) = (f64::INFINITY, [0.0; 8]);
        for _ in 0..rounds {
            let (samples, ms) = rolling_run(contact, integrator, step_us)?;
            best = best.min(ms);
            errors = largest_differences(&samples, &exact);
        }
        rows.push(Row { contact, integrator, step_us, errors, ms: best });
        progress.advance();
    }
    let (contact, integrator, step_us) = finest;
    rows.push(Row { contact, integrator, step_us, errors: [0.0; 8], ms: finest_ms });
    Ok(rows)
}

fn rolling_table(rows: &[Row]) -> String {
    let mut out = String::from("| contact | integrator | step, us |");
    for feature in FEATURES {
        let _ = write!(out, " {feature} |");
    }
    let _ = writeln!(out, " ms a simulated second | times real time |");
    let _ = writeln!(out, "|{}", "---|".repeat(5 + FEATURES.len()));
    for row in rows {
        let _ = write!(out, "| {:?} | {:?} | {} |", row.contact, row.integrator, row.step_us);
        for error in row.errors {
            let _ = write!(out, " {error:.1e} |");
        }
        let _ = writeln!(out, " {:.2} | {:.0} |", row.ms, 1e3 / row.ms);
    }
    out
}

/// Wall time against the error of the centroid, both on logarithmic scales.
fn picture(rows: &[Row]) -> Figure {
    let (width, height) = (760.0, 420.0);
    let mut figure = Figure::new(width, height, "time of a simulated second against error");
    figure.text(70.0, 22.0, Anchor::Start, "head", "Simulator: work against precision");
    let log = |v: f64| libm::log10(v.max(1e-12));
    let shown: Vec<&Row> = rows.iter().filter(|row| row.errors[1] > 0.0).collect();
    let ends = |of: &dyn Fn(&Row) -> f64| {
        let values = || shown.iter().map(|row| log(of(row)));
        let (low, high) = (values().fold(9.0, f64::min), values().fold(-12.0, f64::max));
        (libm::floor(low - 0.1), libm::ceil(high + 0.1))
    };
    let (from, to) = ends(&|row| row.errors[1]);
    let x = Scale { low: from, high: to, from_px: 70.0, to_px: width - 30.0 };
    let (low, high) = ends(&|row| row.ms);
    let y = Scale { low, high, from_px: height - 60.0, to_px: 50.0 };
    for tick in decade_ticks(libm::pow(10.0, from), libm::pow(10.0, to), 8.0) {
        let place = x.position_px(log(tick.value));
        figure.line(Point::new(place, y.from_px), Point::new(place, y.to_px), "grid");
        figure.text(place, y.from_px + 18.0, Anchor::Middle, "small", &tick.label);
    }
    for tick in decade_ticks(libm::pow(10.0, low), libm::pow(10.0, high), 6.0) {
        let place = y.position_px(log(tick.value));
        figure.line(Point::new(x.from_px, place), Point::new(x.to_px, place), "grid");
        figure.text(x.from_px - 8.0, place + 4.0, Anchor::End, "small", &tick.label);
    }
    let foot = "largest error of the centroid along x (mm); up: ms a simulated second";
    figure.text(0.5 * width, height - 18.0, Anchor::Middle, "small dim", foot);
    let mut marks: Vec<_> = shown
        .iter()
        .map(|row| (x.position_px(log(row.errors[1])), y.position_px(log(row.ms)), *row))
        .collect();
    marks.sort_by(|a, b| a.1.total_cmp(&b.1));
    // The names stand in a column beside the points, each with a line to its point.
    let column = 0.58 * width;
    let mut next = 0.0_f64;
    for (across, up, row) in marks {
        let name = format!("{:?}, {:?} {} us", row.contact, row.integrator, row.step_us);
        if across > column + 20.0 {
            next = next.max(up - 24.0);
            figure.line(Point::new(column + 5.0, next), Point::new(across, up), "grid");
            figure.text(column, next + 4.0, Anchor::End, "small", &name);
            next += 16.0;
        } else {
            figure.text(across + 8.0, up + 4.0, Anchor::Start, "small", &name);
        }
        figure.circle(across, up, 4.0, &format!("f{}", row.contact as usize % 6));
    }
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_of_force_are_percent_and_of_places_are_not() {
        let exact = vec![[100.0, 1.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0]];
        let got = vec![[101.0, 1.5, 0.0, 0.0, 9.9, 0.0, 0.0, 0.0]];
        let errors = largest_differences(&got, &exact);
        assert!((errors[0] - 1.0).abs() < 1e-9 && (errors[1] - 0.5).abs() < 1e-12);
        assert!((errors[4] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn invalid_numbers_of_runs_are_rejected() {
        let scene_options =
            levels::SceneOptions { scenes: Vec::new(), span_s: 1.0, noise: 0.0, scenes_out: None };
        let plan = Options {
            rounds: 0,
            out: None,
            json: false,
            scene_options,
            only: Some(Part::Arm),
            serve: false,
        };
        assert!(run(&plan).is_err());
    }
}
