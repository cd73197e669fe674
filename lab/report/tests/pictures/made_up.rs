//! A generated run with the shape of the thesis's first experiment: it suffices to draw every
//! picture without a machine. It does not follow the laws of physics.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use taktil_hal::Nanos;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::{Joints, Pose};
use taktil_record::McapLog;
use taktil_record::summary::{SUMMARY_KEY, Summary};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};
use taktil_rtcore::{ArrayPayload, Payload};
use taktil_signal::{Applied, ControlState, Features, JointState, State, TactileImage, Torque};

taktil_rtcore::payload! {
    /// What a simulator would know.
    pub struct Truth {
        /// N
        pub finger_normal_n: f64,
        /// N
        pub table_normal_n: f64,
        /// column
        pub contact_x: f64,
        /// rad
        pub pin_yaw_rad: f64,
        /// rad
        pub q_rad: [f64; 6],
        /// m
        pub tool_m: [f64; 3],
        /// m
        pub pin_m: [f64; 3],
        /// 1
        pub pin_axis: [f64; 3],
        /// 1 while the finger touches
        pub in_contact: u32,
    }
}

const PERIOD_NS: i64 = 2_500_000;

fn signal<T: Payload>(name: &str) -> Signal {
    Signal {
        name: name.into(),
        lane: 0,
        type_name: T::NAME.into(),
        fields: T::FIELDS.into(),
        size: T::SIZE,
    }
}

fn catalog(signals: Vec<Signal>) -> Catalog {
    let lane = LaneInfo { name: "servo".into(), period: Nanos(PERIOD_NS), ..LaneInfo::default() };
    Catalog { signals, lanes: vec![lane] }
}

fn append_value<T: Payload>(log: &mut McapLog, signal: usize, tick: u64, value: &T) {
    let mut body = vec![0; T::SIZE];
    value.encode(&mut body);
    let release = Nanos(tick as i64 * PERIOD_NS);
    log.record(&Record { signal, tick, release, body: &body });
}

fn append_image(log: &mut McapLog, signal: usize, tick: u64, image: &TactileImage) {
    let mut body = vec![0; image.size()];
    image.encode(&mut body);
    let release = Nanos(tick as i64 * PERIOD_NS);
    log.record(&Record { signal, tick, release, body: &body });
}

/// Noise without a random number generator: the fraction of a fast growing number, -0.5 to 0.5.
fn noise(n: u64) -> f64 {
    let x = libm::sin(n as f64 * 12.9898) * 43_758.545_3;
    x - x.floor() - 0.5
}

struct Moment {
    rolling: bool,
    x_c: f64,
    wish: f64,
    joints: JointState,
}

fn at(tick: u64, arm: &Puma260, q: &mut Joints) -> Moment {
    let t_s = tick as f64 * 0.0025;
    let rolling = t_s > 1.5;
    let phase = (t_s - 1.5).max(0.0) * 0.44;
    // A triangle wave between 2.5 and 14.5.
    let saw = phase.rem_euclid(2.0);
    let share = if saw < 1.0 { saw } else { 2.0 - saw };
    let x_c = if rolling { 2.5 + 12.0 * share } else { 0.0 };
    let p_x = 0.308 + 0.0381 * share;
    let p_z = -0.149 + 0.0005 * share + if rolling { 0.0 } else { 0.01 * (1.5 - t_s) };
    let turn = 0.155 + 0.003 * libm::sin(t_s);
    let (s, c) = libm::sincos(turn);
    let r = [-1.0, 0.0, 0.0, 0.0, c, s, 0.0, s, -c];
    let pose = arm.tool_to_wrist(&Pose::from_rows(&r, &[p_x, 0.02, p_z]));
    let branches = arm.inverse_kinematics(&pose, Some(q));
    if let Some((_, next)) = arm.nearest_branch(&branches, q) {
        *q = next;
    }
    let mut joints = JointState::ZERO;
    joints.q_rad = (*q).into();
    joints.calibrated = u32::from(t_s > 0.2);
    Moment { rolling, x_c, wish: if saw < 1.0 { 15.0 } else { 2.0 }, joints }
}

fn image_signal(name: &str) -> Signal {
    let image = TactileImage::new(16, 16);
    let (type_name, fields, size) = (image.type_name(), image.fields().into(), image.size());
    Signal { name: name.into(), lane: 0, type_name, fields, size }
}

fn image(tick: u64, moment: &Moment) -> TactileImage {
    let mut image = TactileImage::new(16, 16);
    image.baseline_ready = 1;
    image.valid.fill(1);
    image.valid[37] = 0;
    for index in 0..256 {
        let (x, y) = ((index % 16) as f64 + 1.0, (index / 16) as f64 + 1.0);
        let off = x - moment.x_c + 0.08 * (y - 8.5);
        let load = if moment.rolling { 330.0 * libm::exp(-off * off / 3.0) } else { 0.0 };
        image.counts[index] = (load + 16.0 * noise(tick * 256 + index as u64)) as f32;
    }
    image
}

fn features(tick: u64, moment: &Moment) -> Features {
    let mut f = Features::ZERO;
    if moment.rolling {
        f.defined = 7;
        f.active = 1;
        f.x_c = moment.x_c + 0.05 * noise(tick);
        f.y_c = 8.5;
        f.m0 = 15_000.0
            + 1_500.0 * noise(tick + 1)
            + if tick.is_multiple_of(977) { 9_000.0 } else { 0.0 };
        f.m_x = 4_000.0 * noise(tick + 2);
        f.theta_z_rad = 0.08 + 0.12 * noise(tick + 3);
        f.x_c_desired = moment.wish;
    }
    f
}

fn control(tick: u64) -> ControlState {
    let mut control = ControlState::ZERO;
    let state = match tick {
        0..40 => State::Start,
        40..80 => State::IdleUncalibrated,
        80..200 => State::IdleCalibrated,
        200..600 => State::Trajectory,
        _ => State::TactileServo,
    };
    control.state = state as u32;
    control
}

/// Writes the log of a whole run to a directory.
pub(crate) fn log(directory: &Path, seconds: f64) -> PathBuf {
    let path = directory.join("made-up.mcap");
    let catalog = catalog(vec![
        signal::<JointState>("sense.joints"),
        signal::<Features>("tactile_servo.features"),
        image_signal("tactile_scan.image"),
        signal::<Torque>("joint_servo.torque"),
        signal::<Applied>("actuate.applied"),
        signal::<ControlState>("supervisor.control"),
        signal::<Truth>("world.truth"),
    ]);
    let about = BTreeMap::from([
        ("taktil".to_owned(), "0.1.0".to_owned()),
        ("scene".to_owned(), "title = \"<script>\"\n[pin]\nradius_mm = 23.0\n".to_owned()),
    ]);
    let mut log = McapLog::create(&path, &catalog, &about).unwrap();
    let arm = Puma260::reference();
    let mut q = Joints::new(0.3, 1.6, -1.9, 0.1, -0.3, 0.2);
    for tick in 0..(seconds * 400.0) as u64 {
        let moment = at(tick, &arm, &mut q);
        append_value(&mut log, 0, tick, &moment.joints);
        append_value(&mut log, 1, tick, &features(tick, &moment));
        if tick.is_multiple_of(2) {
            append_image(&mut log, 2, tick, &image(tick, &moment));
        }
        let tool = arm.tool_pose(&Joints::from_column_slice(&moment.joints.q_rad)).translation;
        let mut torque = <Torque>::ZERO;
        let mut applied = <Applied>::ZERO;
        for joint in 0..6 {
            let n = tick * 6 + joint as u64;
            torque.error_rad[joint] = 0.004 * noise(n) / (1.0 + joint as f64);
            torque.tau_nm[joint] = 2.0 / (1.0 + joint as f64) + 0.4 * noise(n + 9);
            applied.tau_nm[joint] = (torque.tau_nm[joint] * 50.0).round() / 50.0;
        }
        append_value(&mut log, 3, tick, &torque);
        append_value(&mut log, 4, tick, &applied);
        append_value(&mut log, 5, tick, &control(tick));
        let normal = if moment.rolling { 14.7 + 0.6 * noise(tick + 5) } else { 0.0 };
        append_value(
            &mut log,
            6,
            tick,
            &Truth {
                finger_normal_n: normal,
                table_normal_n: normal + 0.4,
                contact_x: moment.x_c,
                pin_yaw_rad: 0.01,
                q_rad: moment.joints.q_rad,
                tool_m: tool.to_array(),
                pin_m: [tool.x, tool.y, tool.z - 0.023],
                pin_axis: [0.0, 1.0, 0.0],
                in_contact: u32::from(moment.rolling),
            },
        );
    }
    let result = BTreeMap::from([(SUMMARY_KEY.to_owned(), summary().to_json().to_string())]);
    log.finish_with(&result).unwrap();
    path
}

/// A log with one signal that no view needs.
pub(crate) fn bare_log(directory: &Path) -> PathBuf {
    let path = directory.join("bare.mcap");
    // A log is not replaced by one without records.
    let _ = std::fs::remove_file(&path);
    let log = McapLog::create(&path, &catalog(vec![signal::<Truth>("a.b")]), &BTreeMap::new());
    log.unwrap().finish().unwrap();
    path
}

fn lane(name: &str, period_ns: u64, late: &[u64], exec: &[u64]) -> Value {
    let bins = |counts: &[u64], first: f64| -> Vec<Value> {
        let edge = |i: usize| first * libm::exp2(i as f64 / 2.0);
        counts.iter().enumerate().map(|(i, n)| json!([edge(i), n])).collect()
    };
    json!({
        "name": name, "period_ns": period_ns, "deadline_ns": period_ns / 2, "jobs": 4000,
        "release_late_us": {"p50": 6.1, "p90": 9.0, "p99": 31.0, "p99_9": 88.0, "max": 240.5},
        "exec_us": {"p50": 21.0, "p90": 30.0, "p99": 44.0, "p99_9": 70.0, "max": 120.0},
        "release_late_bins": bins(late, 1.0), "exec_bins": bins(exec, 5.0),
        "misses": {"late_wake": 1, "overrun": 0, "preempted": 0, "blocked": 0, "page_fault": 0,
            "throttled": 0},
        "allocations": 0, "page_faults": 2, "records_dropped": 0,
    })
}

/// The closing summary of the generated run.
pub(crate) fn summary() -> Summary {
    let servo = lane(
        "servo",
        2_500_000,
        &[0, 2, 40, 300, 1500, 1400, 500, 180, 50, 20, 5, 0, 2, 1],
        &[0, 10, 800, 2200, 700, 200, 60, 20, 9, 1],
    );
    let touch =
        lane("touch", 5_000_000, &[0, 1, 20, 800, 900, 200, 60, 15, 3, 1], &[1500, 480, 20]);
    let summary = json!({
        "ok": true, "scene": "sim/scenes/roll-pin.toml", "title": "A pin rolled by touch",
        "seed": 7, "mode": "live", "sim_s": 10.0, "wall_s": 10.03, "digest": "a1b2c3d4e5f60718",
        "interrupted": false,
        "attested": {"granted": false, "missing": ["SCHED_FIFO: not permitted", "locked memory"]},
        "representative_timing": false,
        "strokes": 3, "x_c": [2.45, 14.6], "p_x_mm": [308.0, 346.1], "p_z_mm": [-149.1, -148.4],
        "theta_xx_deg": [179.9, 180.1], "theta_zz_deg": [171.0, 171.3], "rolling_ratio": 1.98,
        "features": {
            "x_c": {"rms_error": 0.05, "peak_error": 0.3},
            "m0": {"mean": 15003.2, "rms_error": 512.0, "peak_error": 9100.0},
            "m_x": {"rms_error": 1300.0, "peak_error": 5200.0},
            "theta_z": {"rms_error": 2.1, "peak_error": 5.9},
        },
        "truth": {
            "normal_force_n": {"mean": 14.7, "rms_error": 0.3, "peak_error": 1.4,
                "set_point": 14.65},
            "pin_yaw_error_deg": {"rms": 0.2, "peak": 0.9, "steady": 0.1},
            "pin_tilt_error_deg": {"rms": 0.1, "peak": 0.3, "steady": null},
            "height_error_mm": {"rms": null, "peak": null},
            "contact_lost": 0,
        },
        "tracking_deg": [{"rms_error": 0.05, "peak_error": 0.2},
            {"rms_error": 0.07, "peak_error": 0.3}],
        "lanes": [servo, touch], "faults": [], "log": "run.mcap",
        "repeat": "taktil run sim/scenes/roll-pin.toml --seed 7",
    });
    serde_json::from_value(summary).unwrap()
}
