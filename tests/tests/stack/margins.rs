//! How much gain the law `thesis` bears, and how much delay that nobody told it the law `model`, in
//! the whole simulated stack, in each of their four loops: predicted from the loop of the law over
//! a linear plant, which is identified from a run of the stack, and confirmed by the stack itself,
//! which comes to rest before the limit and swings behind it. The plant is not assumed but
//! measured: the response of arm, servo and contact to a command.
//!
//! ```text
//! dy(k) = sum_i a_i dy(k-i) + sum_i b_i u(k+1-i)    u: steps commanded along or about an axis of
//!                                                   the sensor, job by job
//!                                                   y: column, force, tilt or yaw of the contact
//! ```
//! Joints here have no Coulomb friction, encoders 64 times the counts, images no noise: a margin is
//! a number of the linear loop. What the arm's own encoders add to it is a test of its own.

use nalgebra::{DMatrix, DVector};
use taktil_lab_experiment::{LawName, with_law};
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::rotation_vector;
use taktil_rtcore::Nanos;
use taktil_signal::{Desired, Features, TactileImage};
use taktil_sim::scene::ScanStamp;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::law::Observation;
use taktil_tasks_tactile_servo::law::model::jacobian::ContactModel;
use taktil_tasks_tactile_servo::law::model::{
    ModelState, job_displacement, observe, state_after_job,
};
use taktil_tasks_tactile_servo::law::thesis;
use taktil_tasks_tactile_servo::perception::line::{Line, LineParameters, line};
use taktil_tasks_tactile_servo::perception::{TouchFeatures, touch_features};
use taktil_tests::bench::{RecordedRun, SceneDraft, run};

/// The period of the servo lane.
const SERVO_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Number of earlier steps and commands that decide the next step: enough for the servo and a
/// spring that swings.
const MODEL_ORDER: usize = 16;
/// The finger presses from this instant on.
const PRESSING_START: Nanos = Nanos::from_secs(3);
/// Noise of a tactel that stirs a loop to be identified (counts).
const STIR_COUNTS: f64 = 200.0;
/// Most scans that an image may be late in the simulator.
const LATE_MAX: u32 = 30;
/// How long the runs are that judge a loop (s).
const RUN_S: f64 = 10.0;
/// The column that the law is to reach (tactels): no image's by chance, so that it stays.
const TARGET_COLUMN: f64 = 8.371_828_182_845;
/// A loop whose error has grown by this factor in the last second is unstable. A lost contact keeps
/// the error from growing for ever, and a swing that neither grows nor dies away would otherwise be
/// called stable by chance.
const ERROR_GROWTH_MAX: f64 = 100.0;
/// How many times finer the encoders are than the arm's own, where their steps must not matter.
const FINE_ENCODER_FACTOR: f64 = 64.0;

/// A loop of one law.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Axis {
    /// Column by motion along the sensor's x.
    Roll,
    /// Force by motion along its z.
    Press,
    /// Moment by turns about its x.
    Tilt,
    /// Yaw by turns about its z.
    Turn,
}

impl Axis {
    /// Its place among the motions and features of the laws.
    fn index(self) -> usize {
        self as usize
    }

    /// A gain of the law `thesis`, over its own, that stirs the loop well within its margin.
    fn stirring_gain(self) -> f64 {
        [5.0, 0.1, 0.3, 30.0][self.index()]
    }

    /// A small error (columns, counts, mrad, mrad).
    fn small_error(self) -> f64 {
        [1e-3, 15.0, 1e-2, 2.0][self.index()]
    }

    /// What is controlled, in that unit.
    fn controlled_value(self, truth: &WorldTruth) -> f64 {
        match self {
            Axis::Roll => truth.contact_x,
            Axis::Press => truth.finger_normal_n * Config::default().model.counts_per_n,
            Axis::Tilt => 1e3 * truth.pin_tilt_rad,
            Axis::Turn => 1e3 * truth.pin_yaw_rad,
        }
    }

    /// The feature by which the laws see it.
    fn feature(self, features: &Features) -> f64 {
        [features.x_c, features.m0, features.m_x, 1e3 * features.theta_z_rad][self.index()]
    }
}

/// How a loop is strained: its gain times so much, images so many scans late.
#[derive(Clone, Copy, Debug)]
struct LoopChange {
    law: LawName,
    axis: Axis,
    gain: f64,
    late: u32,
    /// Counts of the encoders over the arm's own.
    fine: f64,
}

impl LoopChange {
    /// Without the limits of speed, which hold what grows.
    fn config(&self) -> Config {
        let mut config = Config { law: self.law, ..Config::default() };
        self.apply(&mut config);
        (config.model.speed, config.model.roll_mm_s2) = ([1e9; 4], 1e12);
        (config.roll_mm_s, config.press_mm_s) = (1e9, 1e9);
        (config.tilt_mrad_s, config.turn_mrad_s) = (1e9, 1e9);
        config
    }

    fn apply(&self, config: &mut Config) {
        let at = self.axis.index();
        if self.law == LawName::Model {
            config.model.gain_per_s[at] *= self.gain;
        } else {
            config.feature_jacobian[at] /= self.gain;
        }
        // Headed for the middle for good.
        (config.x_c_low, config.x_c_tolerance) = (TARGET_COLUMN, 1e-12);
    }

    /// The rolling scene so strained, with the pin turned by a degree and a plain servo of the
    /// joints.
    fn scene(&self, noise_counts: f64, duration_s: f64) -> Scene {
        let draft = SceneDraft::roll_pin()
            .set("duration_s", duration_s)
            .set("world.pin.yaw_deg", 1.0)
            .set("robot.joint_servo.damping", vec![0.5; 6])
            .set("robot.joint_servo.derivative_filter_hz", 30.0)
            .set("world.arm.coulomb_scale", 0.0)
            .set("world.tactile.rest_counts", 1500.0)
            .set("world.tactile.noise_counts", noise_counts);
        let mut scene = with_law(&draft.scene(), self.law);
        scene.world.arm.encoder_scale = self.fine;
        scene.machine.sense.get_or_insert_default().encoder_scale = self.fine;
        scene.world.tactile.delay_scans = self.late;
        scene.world.tactile.stamp = ScanStamp::Delivered;
        // What swings by its loop's gain must go on doing so.
        scene.machine.actuate.get_or_insert_default().runaway_detection = false;
        let scan = scene.machine.tactile_scan.get_or_insert_default();
        (scan.stale_ms, scan.baseline_frames_max) = (300.0, 40);
        let servo = scene.machine.tactile_servo.get_or_insert_default();
        self.apply(servo);
        let roll_mm_s = if self.axis == Axis::Roll { 100.0 } else { 1e-3 };
        (servo.model.speed, servo.model.roll_mm_s2) = ([roll_mm_s, 15.0, 300.0, 500.0], 1e5);
        (servo.roll_mm_s, servo.press_mm_s) = (roll_mm_s, 3.0);
        (servo.tilt_mrad_s, servo.turn_mrad_s) = (300.0, 500.0);
        // Noise is there to stir the loop, not to be cut away.
        servo.threshold_counts = Some(0.0);
        // The other loops are slow, and learn nothing of a table that rests.
        for i in (0..4).filter(|i| *i != self.axis.index()) {
            servo.feature_jacobian[i] *= 10.0;
            servo.model.gain_per_s[i] *= 0.1;
            servo.model.table_rate[i] = 0.0;
        }
        servo.model.table_slope = [0.0; 3];
        scene
    }
}

/// What is controlled, in the middle between two times at which the world tells it, by the four
/// times around an instant.
fn controlled_value_at(truth: &[(Nanos, WorldTruth)], axis: Axis, at: Nanos) -> Option<f64> {
    let next = truth.partition_point(|(_, truth)| truth.t_ns < at.0);
    let around = truth.get(next.checked_sub(2)?..next + 2)?;
    let y: Vec<f64> = around.iter().map(|(_, truth)| axis.controlled_value(truth)).collect();
    Some((9.0 * (y[1] + y[2]) - y[0] - y[3]) / 16.0)
}

/// Steps commanded along or about an axis (mm, mrad), and what came of them, job by job.
fn commands_and_responses(kept: &RecordedRun, axis: Axis) -> (Vec<f64>, Vec<f64>) {
    let arm = Puma260::reference();
    let desired: Vec<(Nanos, Desired)> = kept.of("setpoint.desired");
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let pose = |q: &[f64; 6]| arm.tool_pose(&Joints::from(*q));
    let (mut u, mut y) = (Vec::new(), Vec::new());
    for pair in desired.windows(2).filter(|pair| pair[1].0 >= PRESSING_START) {
        let (last, now) = (pose(&pair[0].1.q_rad), pose(&pair[1].1.q_rad));
        let Some(done) = controlled_value_at(&truth, axis, pair[1].0) else { continue };
        let moved = last.rotation.transpose() * (now.translation - last.translation);
        let turned = rotation_vector(&last.rotation, &now.rotation);
        u.push(1e3 * [moved.x, moved.z, turned.x, turned.z][axis.index()]);
        y.push(done);
    }
    (u, y)
}

/// The feature for each unit of what is controlled, by least squares over a run.
fn feature_per_unit(kept: &RecordedRun, axis: Axis) -> f64 {
    let features: Vec<(Nanos, Features)> = kept.of("tactile_servo.features");
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let settled = features.iter().filter(|(at, _)| *at >= PRESSING_START);
    let pairs: Vec<[f64; 2]> = settled
        .filter_map(|(_, f)| {
            Some([controlled_value_at(&truth, axis, Nanos(f.acquired_ns))?, axis.feature(f)])
        })
        .collect();
    let count = pairs.len() as f64;
    let mean = [0, 1].map(|i| pairs.iter().map(|pair| pair[i]).sum::<f64>() / count);
    let product = |i: usize, j: usize| {
        pairs.iter().map(|pair| (pair[i] - mean[i]) * (pair[j] - mean[j])).sum::<f64>()
    };
    product(0, 1) / product(0, 0)
}

/// Steps of y by earlier ones and by commands, `[a, b]`, by least squares.
fn plant(u: &[f64], y: &[f64]) -> [Vec<f64>; 2] {
    let steps: Vec<f64> = y.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let rows = steps.len() - MODEL_ORDER;
    let past = DMatrix::from_fn(rows, 2 * MODEL_ORDER, |r, i| {
        if i < MODEL_ORDER { steps[r + MODEL_ORDER - 1 - i] } else { u[r + 2 * MODEL_ORDER - i] }
    });
    let next = DVector::from_fn(rows, |r, _| steps[r + MODEL_ORDER]);
    let size: Vec<f64> = past.column_iter().map(|column| column.norm().max(1e-300)).collect();
    let even = DMatrix::from_fn(rows, 2 * MODEL_ORDER, |r, i| past[(r, i)] / size[i]);
    let mut normal = even.transpose() * &even;
    for i in 0..2 * MODEL_ORDER {
        normal[(i, i)] += 1e-9;
    }
    let found = normal.cholesky().expect("positive").solve(&(even.transpose() * &next));
    [0, MODEL_ORDER].map(|from| (from..from + MODEL_ORDER).map(|i| found[i] / size[i]).collect())
}

/// The line of an image in the middle of the run, as the law sees it.
fn line_of_image(kept: &RecordedRun, config: &Config, contact: &ContactModel) -> Line {
    let images: Vec<(Nanos, TactileImage)> = kept.of("tactile_scan.image");
    let image = &images.iter().find(|(t, _)| *t >= PRESSING_START).expect("an image").1;
    let threshold = config.threshold(image.noise_counts);
    let touch = touch_features(image, &config.array, threshold, config.contact_counts);
    let known = LineParameters {
        profile: contact.profile(),
        // As the law takes it where none was measured.
        noise_counts: config.model.noise_counts,
        speed_cols_s: 0.0,
    };
    line(image, &config.array, &touch, &known).expect("a line").scaled(contact.band_correction())
}

/// A loop's plant: steps by earlier ones and by commands, the feature that shows it, and an image
/// of it.
struct Plant {
    axis: Axis,
    past: Vec<f64>,
    taps: Vec<f64>,
    scale: f64,
    like: Line,
}

impl Plant {
    /// What a run of the stack says that noise stirs by way of the law `thesis`, every image.
    fn identify(axis: Axis) -> Plant {
        let strain = LoopChange {
            law: LawName::Thesis,
            axis,
            gain: axis.stirring_gain(),
            late: 0,
            fine: FINE_ENCODER_FACTOR,
        };
        let kept = run(&strain.scene(STIR_COUNTS, 4.0 * RUN_S), 1);
        let (u, y) = commands_and_responses(&kept, axis);
        let [past, taps] = plant(&u, &y);
        let scale = feature_per_unit(&kept, axis);
        let config = strain.config();
        let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
        let like = line_of_image(&run(&strain.scene(0.0, RUN_S), 1), &config, &contact);
        Plant { axis, past, taps, scale, like }
    }

    /// The image in which what is controlled is off by so much.
    fn image(&self, config: &Config, off: f64) -> Line {
        let mut features = [TARGET_COLUMN, config.m0_counts, 0.0, 0.0];
        let unit = if self.axis == Axis::Turn { 1e-3 } else { 1.0 };
        features[self.axis.index()] += unit * self.scale * off;
        features[1] = features[1].max(config.contact_counts);
        let weighted = [features[1], features[2]];
        Line { features, weighted, rows: [config.m0_counts / 16.0; 64], ..self.like }
    }

    /// Growth of a small error in the loop of the law over the plant: last second over the second
    /// after two, of ten.
    fn growth(&self, strain: &LoopChange) -> f64 {
        let (axis, config) = (strain.axis, strain.config());
        let old = thesis::ThesisLaw::new(&config);
        let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
        let mut memory = ModelState::new(&config.model);
        let dt_s = SERVO_PERIOD.as_secs_f64();
        let (mut off, mut pending) = (axis.small_error(), 0.0);
        let (mut commands, mut steps) = ([0.0; MODEL_ORDER], [0.0; MODEL_ORDER]);
        let mut scans = vec![off; strain.late as usize + 1];
        let mut most = [1e-300_f64; 2];
        for job in 0..4_000 {
            let arrives = job % 2 == 1;
            if job % 2 == 0 {
                scans.rotate_right(1);
                scans[0] = off;
            }
            let image = self.image(&config, scans[strain.late as usize]);
            let touch = image.refined_features(&TouchFeatures {
                trusted: true,
                contact: true,
                ..TouchFeatures::default()
            });
            let step = if strain.law == LawName::Model {
                if arrives {
                    let shown = Observation::new(&touch, Some(&image), dt_s, dt_s);
                    memory = observe(&config, &contact, &memory, &shown);
                }
                let step = job_displacement(&config, &memory, TARGET_COLUMN, dt_s);
                memory = state_after_job(&config.model, &memory, &step, dt_s);
                step[axis.index()]
            } else {
                if arrives {
                    pending = 0.5 * old.displacement(&touch, TARGET_COLUMN)[axis.index()];
                }
                pending
            };
            commands.rotate_right(1);
            commands[0] = step;
            let by = |all: &[f64], of: &[f64]| all.iter().zip(of).map(|(a, x)| a * x).sum::<f64>();
            let went = by(&self.past, &steps) + by(&self.taps, &commands);
            steps.rotate_right(1);
            steps[0] = went;
            off += went;
            match job {
                800..1_200 => most[0] = most[0].max(off.abs()),
                3_600.. => most[1] = most[1].max(off.abs()),
                _ => {}
            }
            if off.is_nan() || off.abs() > 1e4 * axis.small_error() {
                return f64::INFINITY;
            }
        }
        if most[1] > ERROR_GROWTH_MAX * axis.small_error() {
            f64::INFINITY
        } else {
            most[1] / most[0]
        }
    }

    /// The gain, in terms of the default one, at which a small error neither grows nor dies away.
    fn gain_limit(&self, law: LawName) -> f64 {
        let axis = self.axis;
        let bears = |gain| {
            self.growth(&LoopChange { law, axis, gain, late: 0, fine: FINE_ENCODER_FACTOR }) < 1.0
        };
        let (mut low, mut high) = (0.01, 5_000.0);
        assert!(bears(low) && !bears(high), "the limit is not within {low} and {high}");
        while high / low > 1.01 {
            let middle = (low * high).sqrt();
            if bears(middle) { low = middle } else { high = middle }
        }
        low
    }

    /// The first lateness (scans) that the loop does not bear.
    fn late_limit(&self, law: LawName, gain: f64) -> u32 {
        let axis = self.axis;
        let bears = |late| {
            self.growth(&LoopChange { law, axis, gain, late, fine: FINE_ENCODER_FACTOR }) < 1.0
        };
        (0..100).find(|late| !bears(*late)).expect("some lateness is too much")
    }
}

/// Rms of what is controlled, about its mean, over the last second and a half of a run.
fn swing_rms(strain: &LoopChange) -> f64 {
    let kept = run(&strain.scene(0.0, RUN_S), 1);
    let (_, y) = commands_and_responses(&kept, strain.axis);
    let last = &y[y.len().saturating_sub(600)..];
    let mean = last.iter().sum::<f64>() / last.len() as f64;
    (last.iter().map(|y| (y - mean) * (y - mean)).sum::<f64>() / last.len() as f64).sqrt()
}

/// A loop that is strained ever more, and where it gives way.
struct StabilityLimit {
    /// What the linear loop says.
    limit: f64,
    /// Before and behind it, as parts of it, and how the stack swings there.
    tried: [(f64, f64); 2],
}

impl StabilityLimit {
    /// Says so; behind the limit the stack swings ten times as much as it may before.
    fn report(&self, what: &str, most_calm: f64) {
        let [(before, calm), (after, swings)] = self.tried;
        println!(
            "| {what} | {:.3} | {calm:.4} at {before:.2} | {swings:.3} at {after:.2} |",
            self.limit
        );
        let parts = format!("{what}: limit {}: {:?}", self.limit, self.tried);
        assert!((0.79..1.0).contains(&before) && after > 1.0 && after <= 1.21, "{parts}");
        assert!(calm < most_calm && swings > 10.0 * most_calm, "{parts}");
    }
}

/// By the gain, images on time.
fn by_gain(plant: &Plant, law: LawName) -> StabilityLimit {
    let (limit, axis) = (plant.gain_limit(law), plant.axis);
    let at = |part: f64| {
        (
            part,
            swing_rms(&LoopChange {
                law,
                axis,
                gain: part * limit,
                late: 0,
                fine: FINE_ENCODER_FACTOR,
            }),
        )
    };
    StabilityLimit { limit, tried: [at(0.8), at(1.2)] }
}

/// By images that are late.
fn by_delay(plant: &Plant, law: LawName, gain: f64) -> StabilityLimit {
    let (limit, axis) = (plant.late_limit(law, gain), plant.axis);
    let part = |late: u32| f64::from(late) / f64::from(limit);
    let at = |late: u32| {
        (part(late), swing_rms(&LoopChange { law, axis, gain, late, fine: FINE_ENCODER_FACTOR }))
    };
    // Whole scans within a fifth of the limit.
    let (before, after) = ((limit * 4).div_ceil(5), (limit * 6 / 5).min(LATE_MAX));
    StabilityLimit { limit: f64::from(limit), tried: [at(before), at(after)] }
}

/// Largest root mean square of a loop at rest (columns, counts, mrad, mrad): what the converters
/// leave of it.
const CALM_SWING_MAX: [f64; 4] = [0.02, 100.0, 0.02, 0.15];

#[test]
fn both_laws_swing_along_x_where_the_linear_loops_say() {
    let plant = Plant::identify(Axis::Roll);
    by_gain(&plant, LawName::Thesis).report("roll, thesis, gain x", CALM_SWING_MAX[0]);
    by_gain(&plant, LawName::Model).report("roll, model, gain x", CALM_SWING_MAX[0]);
}

#[test]
fn both_laws_swing_along_z_where_the_linear_loops_say() {
    let plant = Plant::identify(Axis::Press);
    by_gain(&plant, LawName::Thesis).report("press, thesis, gain x", CALM_SWING_MAX[1]);
    by_delay(&plant, LawName::Model, 1.0).report("press, model, scans late", CALM_SWING_MAX[1]);
    by_delay(&plant, LawName::Model, 0.6)
        .report("press, model, gain x 0.6, scans late", CALM_SWING_MAX[1]);
}

#[test]
fn both_laws_swing_about_x_where_the_linear_loops_say() {
    let plant = Plant::identify(Axis::Tilt);
    by_gain(&plant, LawName::Thesis).report("theta_x, thesis, gain x", CALM_SWING_MAX[2]);
    by_delay(&plant, LawName::Model, 0.4)
        .report("theta_x, model, gain x 0.4, scans late", CALM_SWING_MAX[2]);
}

#[test]
fn both_laws_swing_about_z_where_the_linear_loops_say() {
    let plant = Plant::identify(Axis::Turn);
    by_gain(&plant, LawName::Thesis).report("theta_z, thesis, gain x", CALM_SWING_MAX[3]);
    by_delay(&plant, LawName::Model, 1.0).report("theta_z, model, scans late", CALM_SWING_MAX[3]);
    by_delay(&plant, LawName::Model, 5.0)
        .report("theta_z, model, gain x 5, scans late", CALM_SWING_MAX[3]);
}

#[test]
fn the_arm_s_own_encoders_make_the_press_loop_of_the_thesis_swing_before_its_limit() {
    let (law, axis) = (LawName::Thesis, Axis::Press);
    let limit = Plant::identify(axis).gain_limit(law);
    let at = |part: f64, fine: f64| {
        swing_rms(&LoopChange { law, axis, gain: part * limit, late: 0, fine })
    };
    let own = [0.2, 0.4, 0.6, 0.8, 1.2].map(|part| at(part, 1.0));
    println!("own encoders, 0.2, 0.4, 0.6, 0.8, 1.2 of the limit: {own:.0?} counts");
    assert!(own[3] > 10.0 * at(0.8, FINE_ENCODER_FACTOR), "{own:?}");
    assert!(own[0] < 0.5 * own[4] && own[3] > 0.5 * own[4], "{own:?}");
}
