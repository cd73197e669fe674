//! How much gain, and how much delay that nobody told them, the laws `thesis` and `model` bear in
//! the whole simulated stack, about theta_z and along z: predicted from the loop of the law over a
//! linear plant, which is identified from a run of the stack, and confirmed by the stack itself,
//! which comes to rest before the limit and swings behind it. Refuses a plant that is assumed: what
//! arm, servo and contact make of a command is measured.
//!
//! ```text
//! y(k+1) - y(k) = sum_i h_i u(k-i)      u: steps commanded along or about the sensor's z, by job
//!                                       y: yaw of the pin on the sensor (mrad), force (counts)
//! ```
//! Joints here have no Coulomb friction, images no noise and the finger does not roll: a margin is
//! a number of the linear loop, and friction, which stops small swings, is no part of it.

use nalgebra::{DMatrix, DVector};
use taktil::experiment::{Name, with_law};
use taktil::run::scene::Scene;
use taktil::run::world::WorldTruth;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::rotation_vector;
use taktil_rtcore::Nanos;
use taktil_signal::{Desired, TactileImage};
use taktil_sim::scene::Stamp;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::law::model::jacobian::Contact;
use taktil_tasks_tactile_servo::law::model::{Memory, after_job, displacement_of_job, observe};
use taktil_tasks_tactile_servo::law::thesis;
use taktil_tasks_tactile_servo::perception::line::{Known, Line, line};
use taktil_tasks_tactile_servo::perception::{Touch, touch};
use taktil_tests::bench::{Draft, Kept, run};

/// One job.
const JOB: Nanos = Nanos::from_micros(2_500);
/// Jobs after which a command has had its effect: 200 ms.
const TAPS: usize = 80;
/// From here on the finger presses.
const SETTLED: Nanos = Nanos::from_secs(3);
/// Noise of a tactel that stirs a loop to be identified (counts).
const STIR_COUNTS: f64 = 200.0;
/// Most scans that an image may be late in the simulator.
const LATE_MAX: u32 = 16;
/// How long the runs are that judge a loop (s).
const RUN_S: f64 = 7.0;

/// A loop of one law.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Axis {
    /// Force by motion along the sensor's z.
    Press,
    /// Yaw by turns about it.
    Turn,
}

impl Axis {
    /// Its place among the motions and features of the laws.
    fn index(self) -> usize {
        match self {
            Axis::Press => 1,
            Axis::Turn => 3,
        }
    }
}

/// How a loop is strained: its gain times so much, images so many scans late.
#[derive(Clone, Copy, Debug)]
struct Strain {
    law: Name,
    axis: Axis,
    gain: f64,
    late: u32,
}

impl Strain {
    /// Without the limits of speed, which hold what grows.
    fn config(&self) -> Config {
        let mut config = Config { law: self.law, ..Config::default() };
        self.apply(&mut config);
        config.model.speed = [1e9; 4];
        (config.press_mm_s, config.turn_mrad_s) = (1e9, 1e9);
        config
    }

    fn apply(&self, config: &mut Config) {
        let at = self.axis.index();
        if self.law == Name::Model {
            config.model.gain_per_s[at] *= self.gain;
        } else {
            config.feature_jacobian[at] /= self.gain;
        }
    }

    /// The rolling scene so strained, with the pin turned by a degree.
    fn scene(&self, noise_counts: f64, duration_s: f64) -> Scene {
        let draft = Draft::roll_pin()
            .set("duration_s", duration_s)
            .set("world.pin.yaw_deg", 1.0)
            .set("world.arm.coulomb_scale", 0.0)
            .set("world.tactile.rest_counts", 1500.0)
            .set("world.tactile.noise_counts", noise_counts);
        let mut scene = with_law(&draft.scene(), self.law);
        scene.world.tactile.late_scans = self.late;
        scene.world.tactile.stamp = Stamp::Delivered;
        scene.machine.tactile_scan.get_or_insert_default().stale_ms = 200.0;
        let servo = scene.machine.tactile_servo.get_or_insert_default();
        self.apply(servo);
        servo.model.speed = [1e-3, 15.0, 300.0, 500.0];
        (servo.roll_mm_s, servo.press_mm_s, servo.turn_mrad_s) = (1e-3, 3.0, 500.0);
        // Noise is there to stir the loop, not to be cut away.
        servo.threshold_counts = Some(0.0);
        scene
    }
}

/// Steps commanded along or about the sensor's z (mm, mrad), and what came of them (counts, mrad),
/// job by job.
fn commanded_and_done(kept: &Kept, axis: Axis) -> (Vec<f64>, Vec<f64>) {
    let arm = Puma260::reference();
    let desired: Vec<(Nanos, Desired)> = kept.of("setpoint.desired");
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let pose = |q: &[f64; 6]| arm.tool_pose(&Joints::from(*q));
    let counts_per_n = Config::default().model.counts_per_n;
    let done = |truth: &WorldTruth| match axis {
        Axis::Press => truth.finger_normal_n * counts_per_n,
        Axis::Turn => 1e3 * truth.pin_yaw_rad,
    };
    let (mut u, mut y) = (Vec::new(), Vec::new());
    for pair in desired.windows(2).filter(|pair| pair[1].0 >= SETTLED) {
        let (last, now) = (pose(&pair[0].1.q_rad), pose(&pair[1].1.q_rad));
        // The world tells its truth between the servo's releases.
        let next = truth.partition_point(|(_, truth)| truth.t_ns < pair[1].0.0);
        let (Some((_, after)), Some((_, before))) = (truth.get(next), truth.get(next - 1)) else {
            continue;
        };
        let step = match axis {
            Axis::Press => (last.rotation.transpose() * (now.translation - last.translation)).z,
            Axis::Turn => rotation_vector(&last.rotation, &now.rotation).z,
        };
        u.push(1e3 * step);
        y.push(0.5 * (done(before) + done(after)));
    }
    (u, y)
}

/// The effect of a step of one, job after job, by least squares.
fn plant(u: &[f64], y: &[f64]) -> Vec<f64> {
    let rows: Vec<usize> = (TAPS..y.len() - 1).collect();
    let past = DMatrix::from_fn(rows.len(), TAPS, |r, i| u[rows[r] - i]);
    let step = DVector::from_fn(rows.len(), |r, _| y[rows[r] + 1] - y[rows[r]]);
    // Taps that nothing excites stay small.
    let mut normal = past.transpose() * &past;
    let size = normal.diagonal().mean();
    for i in 0..TAPS {
        normal[(i, i)] += 1e-6 * size;
    }
    let taps = normal.cholesky().expect("positive").solve(&(past.transpose() * &step));
    taps.iter().copied().collect()
}

/// The line of an image in the middle of the run, as the law sees it.
fn seen(kept: &Kept, config: &Config, contact: &Contact) -> Line {
    let images: Vec<(Nanos, TactileImage)> = kept.of("tactile_scan.image");
    let image = &images.iter().find(|(t, _)| *t >= SETTLED).expect("an image").1;
    let touch = touch(image, config.threshold(image.noise_counts), config.contact_counts);
    let known = Known {
        // As the law takes it where none was measured.
        noise_counts: config.model.noise_counts,
        speed_cols_s: 0.0,
        saturated_counts: config.model.saturated_counts,
    };
    line(image, &touch, &known).expect("a line").scaled(contact.whole())
}

/// A loop's plant: its taps, and an image of it.
struct Plant {
    taps: Vec<f64>,
    like: Line,
}

impl Plant {
    /// What a run of the stack says that noise stirs by way of the law `thesis`, every image.
    fn identified(axis: Axis) -> Plant {
        let gain = if axis == Axis::Press { 0.3 } else { 30.0 };
        let strain = Strain { law: Name::Thesis, axis, gain, late: 0 };
        let (u, y) = commanded_and_done(&run(&strain.scene(STIR_COUNTS, 4.0 * RUN_S), 1), axis);
        let config = strain.config();
        let contact = Contact::new(&config.model, config.m0_counts).unwrap();
        let like = seen(&run(&strain.scene(0.0, RUN_S), 1), &config, &contact);
        Plant { taps: plant(&u, &y), like }
    }

    /// The image in which the controlled feature is off by so much.
    fn image(&self, config: &Config, axis: Axis, off: f64) -> Line {
        let m0 = config.m0_counts;
        match axis {
            Axis::Press => {
                let m0 = (m0 + off).max(config.contact_counts);
                Line { features: [8.5, m0, 0.0, 0.0], rows: [m0 / 16.0; 16], ..self.like }
            }
            Axis::Turn => {
                Line { features: [8.5, m0, 0.0, 1e-3 * off], rows: [m0 / 16.0; 16], ..self.like }
            }
        }
    }

    /// Growth of a small error in the loop of the law over the plant: last second over the second
    /// after two, of ten.
    fn growth(&self, strain: &Strain) -> f64 {
        let (axis, config) = (strain.axis, strain.config());
        let old = thesis::Law::new(&config);
        let contact = Contact::new(&config.model, config.m0_counts).unwrap();
        let mut memory = Memory::new(&config.model);
        let dt_s = JOB.as_secs_f64();
        let (mut off, mut pending) = (1e-3 * if axis == Axis::Press { 15_000.0 } else { 2e3 }, 0.0);
        let mut commands = vec![0.0; TAPS];
        let mut scans = vec![off; strain.late as usize + 1];
        let mut most = [1e-12_f64; 2];
        for job in 0..4_000 {
            let arrives = job % 2 == 1;
            if job % 2 == 0 {
                scans.rotate_right(1);
                scans[0] = off;
            }
            let image = self.image(&config, axis, scans[strain.late as usize]);
            let touch = image.touch(&Touch { trusted: true, contact: true, ..Touch::default() });
            let step = if strain.law == Name::Model {
                if arrives {
                    let shown = (&touch, Some(&image));
                    memory = observe(&config, &contact, &memory, shown, (dt_s, dt_s));
                }
                let step = displacement_of_job(&config, &memory, 8.5, dt_s);
                memory = after_job(&config.model, &memory, &step, dt_s);
                step[axis.index()]
            } else {
                if arrives {
                    pending = 0.5 * old.displacement(&touch, 8.5)[axis.index()];
                }
                pending
            };
            commands.rotate_right(1);
            commands[0] = step;
            off += self.taps.iter().zip(&commands).map(|(h, u)| h * u).sum::<f64>();
            match job {
                800..1_200 => most[0] = most[0].max(off.abs()),
                3_600.. => most[1] = most[1].max(off.abs()),
                _ => {}
            }
            if off.is_nan() || off.abs() > 1e5 {
                return f64::INFINITY;
            }
        }
        most[1] / most[0]
    }

    /// The gain, in terms of the default one, at which a small error neither grows nor dies away.
    fn gain_limit(&self, law: Name, axis: Axis) -> f64 {
        let bears = |gain| self.growth(&Strain { law, axis, gain, late: 0 }) < 1.0;
        let (mut low, mut high) = (0.05, 2_000.0);
        assert!(bears(low) && !bears(high), "the limit is not within {low} and {high}");
        while high / low > 1.01 {
            let middle = (low * high).sqrt();
            if bears(middle) { low = middle } else { high = middle }
        }
        low
    }

    /// The first lateness (scans) that the loop does not bear.
    fn late_limit(&self, law: Name, axis: Axis, gain: f64) -> u32 {
        let bears = |late| self.growth(&Strain { law, axis, gain, late }) < 1.0;
        (0..100).find(|late| !bears(*late)).expect("some lateness is too much")
    }
}

/// Rms of what is controlled, about its mean, over the last second and a half of a run.
fn swing(strain: &Strain) -> f64 {
    let kept = run(&strain.scene(0.0, RUN_S), 1);
    let (_, y) = commanded_and_done(&kept, strain.axis);
    let last = &y[y.len().saturating_sub(600)..];
    let mean = last.iter().sum::<f64>() / last.len() as f64;
    (last.iter().map(|y| (y - mean) * (y - mean)).sum::<f64>() / last.len() as f64).sqrt()
}

/// A loop that is strained ever more, and where it gives way.
struct Found {
    /// What the linear loop says.
    limit: f64,
    /// Before and behind it, as parts of it, and how the stack swings there.
    tried: [(f64, f64); 2],
}

impl Found {
    /// Says so; calm is a swing of less than `most_calm`, behind the limit it is thrice that.
    fn told(&self, what: &str, most_calm: f64) {
        let [(before, calm), (after, swings)] = self.tried;
        println!(
            "| {what} | {:.3} | {calm:.3} at {before:.2} | {swings:.3} at {after:.2} |",
            self.limit
        );
        let parts = format!("{what}: limit {}: {:?}", self.limit, self.tried);
        assert!((0.79..1.0).contains(&before) && after > 1.0 && after <= 1.21, "{parts}");
        assert!(calm < most_calm && swings > 3.0 * most_calm, "{parts}");
    }
}

/// By the gain, images on time.
fn by_gain(plant: &Plant, law: Name, axis: Axis) -> Found {
    let limit = plant.gain_limit(law, axis);
    let at = |part: f64| (part, swing(&Strain { law, axis, gain: part * limit, late: 0 }));
    Found { limit, tried: [at(0.8), at(1.2)] }
}

/// By images that are late.
fn by_delay(plant: &Plant, (law, axis, gain): (Name, Axis, f64)) -> Found {
    let limit = plant.late_limit(law, axis, gain);
    let part = |late: u32| f64::from(late) / f64::from(limit);
    let at = |late: u32| (part(late), swing(&Strain { law, axis, gain, late }));
    // Whole scans within a fifth of the limit.
    let (before, after) = ((limit * 4).div_ceil(5), (limit * 6 / 5).min(LATE_MAX));
    Found { limit: f64::from(limit), tried: [at(before), at(after)] }
}

/// What the counts of the encoders and their beat leave of calm: mrad, counts (a newton).
const CALM_MRAD: f64 = 0.5;
const CALM_COUNTS: f64 = 1_000.0;

#[test]
fn the_stack_swings_about_z_where_the_linear_loop_says_that_the_thesis_s_law_will() {
    let (law, axis) = (Name::Thesis, Axis::Turn);
    let plant = Plant::identified(axis);
    by_gain(&plant, law, axis).told("theta_z, thesis, gain over the thesis's", CALM_MRAD);
}

#[test]
fn the_stack_swings_along_z_where_the_linear_loop_says_that_the_law_model_will() {
    let (law, axis) = (Name::Model, Axis::Press);
    let plant = Plant::identified(axis);
    for gain in [1.0, 2.0] {
        let what = format!("press, model, gain x {gain}, scans late");
        by_delay(&plant, (law, axis, gain)).told(&what, CALM_COUNTS);
    }
}
