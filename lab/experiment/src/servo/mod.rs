//! `taktil bench servo`: compares the modes of the joint servo on the simulated robot with its
//! counts, converters and friction: rest error, tracking error, torque noise, and the stability
//! margins of each sampled loop. A robot without friction would show results that are too good.

pub mod margin;

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_machine_console::out;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{Invalid, Machine, Payload};
use taktil_signal::{Desired, Torque};
use taktil_tasks_joint_servo::Config;

use margin::{JointLoop, StabilityMargins};
use taktil_lab_progress::Progress;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_machine_console::option::BadOption;

/// Time without desired motion after which the arm counts as at rest.
const REST_TIME_MIN_S: f64 = 0.5;

/// The options of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Scene whose moves are made
    #[arg(long, value_name = "FILE", default_value = "sim/scenes/lines.toml")]
    scene: PathBuf,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// One JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// A mode of the servo.
struct ServoMode {
    name: &'static str,
    config: Config,
}

/// The modes: with bandwidth, damping and filter of the scenes, and with the default ones.
fn modes() -> Vec<ServoMode> {
    let soft =
        Config { damping: Some(vec![0.5; 6]), derivative_filter_hz: 30.0, ..Config::default() };
    let plain = Config { gravity: false, ..soft.clone() };
    let helped = Config { friction: 0.8, acceleration: 1.0, ..soft.clone() };
    let observed = |hz| Config { observer_hz: Some(hz), ..helped.clone() };
    let stiff = Config { bandwidth_rad_s: Some(vec![110.0; 6]), ..helped.clone() };
    let damped =
        Config { damping: Some(vec![1.0; 6]), derivative_filter_hz: 60.0, ..helped.clone() };
    let one = |name, config| ServoMode { name, config };
    vec![
        one("PD (the thesis)", plain),
        one("PD + gravity", soft.clone()),
        one("+ friction", Config { friction: 0.8, ..soft }),
        one("+ computed torque", helped.clone()),
        one("damping 1, filter 60 Hz", damped),
        one("observer 60 Hz", observed(60.0)),
        one("observer 60 Hz, damping 1", Config { damping: Some(vec![1.0; 6]), ..observed(60.0) }),
        one("110 rad/s", stiff.clone()),
        one("110 rad/s, observer 60 Hz", Config { observer_hz: Some(60.0), ..stiff }),
    ]
}

/// The tracking figures of a run.
#[derive(Clone, Copy, Debug, Default)]
struct TrackingFigures {
    rest_mm: f64,
    rms_deg: f64,
    peak_deg: f64,
    noise: f64,
}

/// Observes one run.
struct TrackingRecorder {
    desired_id: Option<usize>,
    torque_id: Option<usize>,
    truth_id: Option<usize>,
    desired: Desired,
    moved: bool,
    still: usize,
    errors: (f64, u64, f64),
    /// Torques of the last three jobs.
    torques: [Joints; 3],
    noise: (Joints, u64),
    truth: WorldTruth,
    peak_nm: Joints,
}

impl TrackingRecorder {
    fn new(catalog: &Catalog) -> TrackingRecorder {
        TrackingRecorder {
            desired_id: catalog.find("setpoint.desired"),
            torque_id: catalog.find("joint_servo.torque"),
            truth_id: catalog.find("world.truth"),
            desired: Desired::ZERO,
            moved: false,
            still: 0,
            errors: (0.0, 0, 0.0),
            torques: [Joints::zeros(); 3],
            noise: (Joints::zeros(), 0),
            truth: WorldTruth::ZERO,
            peak_nm: Drive::reference().peak_joint_torque(&Transmission::reference()),
        }
    }

    fn torque(&mut self, torque: &Torque) {
        let moving = self.desired.qd_rad_s != [0.0; 6];
        self.moved |= moving;
        self.still = if moving { 0 } else { self.still + 1 };
        self.torques = [Joints::from(torque.tau_nm), self.torques[0], self.torques[1]];
        if !moving {
            return;
        }
        for error in torque.error_rad {
            self.errors.0 += error * error;
            self.errors.1 += 1;
            self.errors.2 = self.errors.2.max(error.abs());
        }
        // The difference pattern of three jobs removes a straight line; white noise passes it with
        // a gain of sqrt(3/2).
        let [a, b, c] = &self.torques;
        let rough = (b - (a + c) * 0.5) / 1.5f64.sqrt();
        self.noise.0 += rough.component_mul(&rough);
        self.noise.1 += 1;
    }

    #[expect(clippy::cast_precision_loss, reason = "a few thousand samples")]
    fn figures(&self, resting: usize) -> Option<TrackingFigures> {
        if !self.moved || self.still < resting {
            return None;
        }
        let arm = Puma260::reference();
        let at = |q: [f64; 6]| arm.tool_pose(&Joints::from(q)).translation;
        let rest = at(self.truth.q_rad) - at(self.desired.q_rad);
        let noise = (self.noise.0 / self.noise.1 as f64).map(f64::sqrt);
        Some(TrackingFigures {
            rest_mm: rest.length() * 1e3,
            rms_deg: (self.errors.0 / self.errors.1 as f64).sqrt().to_degrees(),
            peak_deg: self.errors.2.to_degrees(),
            noise: noise.component_div(&self.peak_nm).max(),
        })
    }
}

impl Observer for TrackingRecorder {
    fn record(&mut self, record: &Record<'_>) {
        let signal = Some(record.signal);
        if signal == self.desired_id
            && let Some(desired) = Desired::decode(record.body)
        {
            self.desired = desired;
        } else if signal == self.torque_id
            && let Some(torque) = Torque::decode(record.body)
        {
            self.torque(&torque);
        } else if signal == self.truth_id
            && let Some(truth) = WorldTruth::decode(record.body)
        {
            self.truth = truth;
        }
    }
}

/// Runs every mode and prints the table.
///
/// # Errors
/// A scene that cannot be used, or whose moves do not end at rest.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    let mut rows = Vec::new();
    let modes = modes();
    let mut progress = Progress::new("modes", modes.len());
    for mode in modes {
        let mut scene = Scene::load(&plan.scene)?;
        let assumed_pose_deg =
            scene.machine.joint_servo.as_ref().and_then(|servo| servo.assumed_pose_deg.clone());
        let config = Config { assumed_pose_deg, ..mode.config };
        scene.machine.joint_servo = Some(config.clone());
        let mut machine = Assembly::new(&scene).with_seed(plan.seed).build()?;
        let tick_s = period_s(&machine)?;
        let mut watch = TrackingRecorder::new(machine.catalog());
        taktil_lab_scene::run_virtual(&mut machine, scene.duration, &mut watch)?;
        let figures = watch.figures((REST_TIME_MIN_S / tick_s).round() as usize);
        let figures = figures.ok_or_else(|| {
            let name = mode.name;
            let scene = plan.scene.display();
            BadOption(format!(
                "--scene {scene}: with `{name}` the arm did not move, or not come to rest half a \
                 second before the end; name a scene with moves that takes longer"
            ))
        })?;
        let delay = scene.actuation_delay.as_secs_f64() / tick_s;
        let margin = worst_margin(&config, tick_s, delay);
        let margin = margin.map_err(|bad| anyhow::anyhow!("{}: {}", bad.place, bad.what))?;
        rows.push((mode.name, figures, margin));
        progress.advance();
    }
    drop(progress);
    if plan.json {
        out::line(Value::Array(rows.iter().map(json_row).collect()))?;
    } else {
        out::text(table(&rows))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Period of the lane in which the servo runs (s).
fn period_s(machine: &Machine) -> anyhow::Result<f64> {
    let mut lanes = machine.figures().zip(machine.task_names());
    let lane = lanes.find(|(_, seats)| seats.contains(&"joint_servo"));
    let ((spec, _), _) = lane.ok_or_else(|| BadOption("no lane runs `joint_servo`".into()))?;
    Ok(spec.period.as_secs_f64())
}

/// The margins of the loop. They are the same for every joint except for its damping, which the
/// modes share.
fn worst_margin(config: &Config, tick_s: f64, delay: f64) -> Result<StabilityMargins, Invalid> {
    let tuning = config.tuning(&Robot::puma260())?;
    let inertia_kg_m2 = tuning.inertia_kg_m2[0];
    Ok(JointLoop { law: tuning.law(), inertia_kg_m2, joint: 0, tick_s, delay }.stability_margins())
}

type Row = (&'static str, TrackingFigures, StabilityMargins);

fn json_row((name, figures, margin): &Row) -> Value {
    json!({
        "mode": name,
        "rest_mm": figures.rest_mm,
        "tracking_rms_deg": figures.rms_deg,
        "tracking_peak_deg": figures.peak_deg,
        "torque_noise_share": figures.noise,
        "crossing_rad_s": margin.crossing_rad_s,
        "phase_margin_deg": margin.phase_deg,
        "delay_margin_ms": margin.delay_ms,
        "gain_margin": margin.gain,
        "gain_margin_simulated": margin.gain_simulated,
        "gain_margin_low": margin.gain_low,
        "sensitivity": margin.sensitivity,
    })
}

fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "| mode | at rest, mm | tracking rms, deg | peak, deg | noise, % of peak torque | \
         crossing, rad/s | phase margin, deg | delay margin, ms | gain margin | simulated | \
         largest sensitivity |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, f, m) in rows {
        text += &format!(
            "| {name} | {:.3} | {:.3} | {:.3} | {:.2} | {:.0} | {:.0} | {:.1} | {:.2} | {:.2} | \
             {:.2} |\n",
            f.rest_mm,
            f.rms_deg,
            f.peak_deg,
            100.0 * f.noise,
            m.crossing_rad_s,
            m.phase_deg,
            m.delay_ms,
            m.gain,
            m.gain_simulated,
            m.sensitivity
        );
    }
    text
}
