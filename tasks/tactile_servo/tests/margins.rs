//! Gain and delay margins of the loop of the law `model`. They are predicted from the linear loop
//! of one axis, sampled at two jobs an image, with its queue of delayed commands and the observer's
//! steady gains, and confirmed with the law itself and a delayed finger.

use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::config::law_name::LawName;
use taktil_tasks_tactile_servo::law::Observation;
use taktil_tasks_tactile_servo::law::model::jacobian::ContactModel;
use taktil_tasks_tactile_servo::law::model::{
    ModelState, job_displacement, observe, state_after_job,
};
use taktil_tasks_tactile_servo::perception::TouchFeatures;
use taktil_tasks_tactile_servo::perception::line::Line;

const DT_S: f64 = 0.0025;
/// Jobs whose commands the law takes for under way: 7.5 ms of delay and an image 2.5 ms old.
const UNDER_WAY: usize = 4;
/// Most jobs of delay that are tried.
const DELAY_JOBS_MAX: usize = 256;
/// Variance of theta_z in the images here (mrad^2).
const YAW_VARIANCE_MRAD2: f64 = 10.0;

/// Steady gains of the observer of (way, rate) for the axis theta_z, by iterating Riccati's
/// equation: process noise of 2 mrad/sqrt s and 60 mrad/s/sqrt s, an error of the model of 2 mrad.
fn steady_gains() -> [f64; 2] {
    let (way, rate, model) = (2.0, 60.0, 2.0);
    let t = DT_S * UNDER_WAY as f64;
    let (mut p, mut gains) = ([1e4, 0.0, 1e4], [0.0; 2]);
    for _ in 0..5_000 {
        for _ in 0..2 {
            let [a, b, d] = p;
            p = [
                a + 2.0 * DT_S * b + DT_S * DT_S * d + way * way * DT_S,
                b + DT_S * d,
                d + rate * rate * DT_S,
            ];
        }
        let [a, b, d] = p;
        let (ga, gd) = (a - t * b, b - t * d);
        let spread = ga - t * gd + YAW_VARIANCE_MRAD2 + model * model;
        gains = [ga / spread, gd / spread];
        p = [a - ga * ga / spread, b - ga * gd / spread, d - gd * gd / spread];
    }
    gains
}

/// Growth of the linear loop in an image period with this gain (1/s), when commands are carried out
/// `late` jobs after they were given.
fn growth(gain_per_s: f64, late: usize) -> f64 {
    let [ke, kd] = steady_gains();
    let (mut p, mut e, mut d) = (1.0, 0.3, -0.2);
    let mut commands = [0.0; DELAY_JOBS_MAX];
    let mut size = [0.0; 2];
    let mut scale = 0.0;
    for image in 0..4_000 {
        let seen = p;
        for job in 0..2 {
            if job == 1 {
                let under_way: f64 = commands[..UNDER_WAY].iter().sum();
                let innovation = seen - (e + under_way - d * DT_S * UNDER_WAY as f64);
                e += ke * innovation;
                d += kd * innovation;
            }
            let step = (gain_per_s * e + d) * DT_S;
            commands.rotate_right(1);
            commands[0] = step;
            e += d * DT_S - step;
            p -= commands[late];
        }
        let norm = (p * p + e * e + d * d).sqrt().max(1e-200);
        for part in [&mut p, &mut e, &mut d].into_iter().chain(&mut commands) {
            *part /= norm;
        }
        scale += libm::log(norm);
        if image == 1_999 {
            size[0] = scale;
        }
    }
    size[1] = scale;
    libm::exp((size[1] - size[0]) / 2_000.0)
}

/// The shortest delay, in jobs, that the linear loop does not bear.
fn limit_jobs(gain_per_s: f64) -> usize {
    (UNDER_WAY..DELAY_JOBS_MAX)
        .find(|late| growth(gain_per_s, *late) >= 1.0)
        .expect("some delay is too long")
}

/// The image of an even load whose line is turned by so much.
fn line(yaw_mrad: f64) -> Line {
    Line {
        features: [8.5, 15_000.0, 0.0, 1e-3 * yaw_mrad],
        variance: [1e-3, 2e5, 4e6, 1e-6 * YAW_VARIANCE_MRAD2],
        weighted: [15_000.0, 0.0],
        weighted_variance: [2e5, 4e6],
        y_c: 8.5,
        rows: [15_000.0 / 16.0; 64],
        saturated: 0,
        interpolated: 0,
    }
}

/// Largest yaw (mrad) in the second after two and in the last one of ten, of the law itself, from 2
/// mrad at first.
fn law(gain_per_s: f64, late: usize) -> [f64; 2] {
    let mut config = Config { law: LawName::Model, ..Config::default() };
    config.model.gain_per_s[3] = gain_per_s;
    config.model.speed[3] = 1e9;
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut state = ModelState::new(&config.model);
    let (mut yaw, mut seen) = (2.0, line(2.0));
    let mut commands = [0.0; DELAY_JOBS_MAX];
    let mut most = [0.0_f64; 2];
    for job in 0..4_000 {
        if job % 2 == 0 {
            seen = line(yaw);
        } else {
            let touch = seen.refined_features(&TouchFeatures {
                trusted: true,
                contact: true,
                ..TouchFeatures::default()
            });
            let image = Observation::new(&touch, Some(&seen), DT_S, DT_S);
            state = observe(&config, &contact, &state, &image);
        }
        let step = job_displacement(&config, &state, 8.5, DT_S);
        state = state_after_job(&config.model, &state, &step, DT_S);
        commands.rotate_right(1);
        commands[0] = step[3];
        // A turn of the sensor takes the image back.
        yaw -= commands[late];
        match job {
            800..1_200 => most[0] = most[0].max(yaw.abs()),
            3_600.. => most[1] = most[1].max(yaw.abs()),
            _ => {}
        }
        if yaw.is_nan() || yaw.abs() > 1e9 {
            return [1.0, f64::INFINITY];
        }
    }
    most
}

#[test]
fn the_law_loses_stability_at_the_delay_of_the_linear_analysis() {
    for gain in [4.0, 8.0, 16.0, 40.0] {
        let limit = limit_jobs(gain);
        let ms = 1e3 * DT_S * limit as f64;
        println!("| {gain} | {limit} jobs, {ms} ms |");
        let [early, last] = law(gain, limit * 4 / 5);
        assert!(last < 0.7 * early + 1e-6, "{gain}: before {limit}: {early} to {last} mrad");
        let [early, last] = law(gain, (limit * 6).div_ceil(5));
        assert!(
            last > 1.5 * early || last > 100.0,
            "{gain}: after {limit}: {early} to {last} mrad"
        );
    }
}

#[test]
fn the_default_gain_tolerates_more_than_twice_the_configured_delay() {
    let default = Config::default().model.gain_per_s[3];
    assert!(limit_jobs(default) > 2 * UNDER_WAY, "{}", limit_jobs(default));
}
