//! Tests the law `model` with a pin between two springs: pads of rows whose loads follow the law of
//! the contact, a finger that carries out its commands after a delay, and a table that moves. There
//! is no arm and no friction: the tests check the Jacobian, the observer, the delay and the limits.

use nalgebra::Matrix4;
use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::config::law_name::LawName;
use taktil_tasks_tactile_servo::law::Observation;
use taktil_tasks_tactile_servo::law::model::jacobian::{
    ContactModel, FeatureMeasurement, displacement,
};
use taktil_tasks_tactile_servo::law::model::{
    ModelState, job_displacement, observe, state_after_job,
};
use taktil_tasks_tactile_servo::perception::TouchFeatures;
use taktil_tasks_tactile_servo::perception::line::Line;

const PITCH_MM: f64 = 1.5875;
const DT_S: f64 = 0.0025;
/// Counts a newton.
const COUNTS_PER_N: f64 = 4095.0 / 4.0;

/// A finger over a pin: what it stands off by, along and about its axes.
struct Plant {
    contact: LineContact,
    /// x mm from the middle, z mm pressed, theta_x mrad, theta_z mrad of the pin on the sensor.
    at: [f64; 4],
    /// Sums by the shape over plain ones.
    shape_off: f64,
}

impl Plant {
    fn new() -> Plant {
        let layer = Layer::new(0.8, 2.0, 0.49).unwrap();
        let contact = LineContact::new(&layer, 23.0, 0.16).unwrap();
        Plant { contact, at: [0.0, 0.02, 0.0, 0.0], shape_off: 1.0 }
    }

    /// Depth of the load that is wanted (mm).
    fn due_mm(&self) -> f64 {
        self.contact.penetration_mm(15_000.0 / COUNTS_PER_N / 25.4)
    }

    fn line(&self) -> Line {
        let [x, z, theta_x, theta_z] = self.at;
        let mut rows = [0.0; 64];
        let (mut m0, mut m_x) = (0.0, 0.0);
        for (index, row) in (0_u8..).zip(&mut rows[..16]) {
            let arm = f64::from(index) - 7.5;
            let deep = z + 1e-3 * theta_x * arm * PITCH_MM;
            *row = COUNTS_PER_N * PITCH_MM * self.contact.load_n_mm(deep);
            m0 += *row;
            m_x += arm * *row;
        }
        Line {
            features: [8.5 - 0.5 * x / PITCH_MM, m0, m_x, 1e-3 * theta_z],
            variance: [1e-3, 2e5, 4e6, 1e-5],
            weighted: [self.shape_off * m0, self.shape_off * m_x],
            weighted_variance: [2e5, 4e6],
            y_c: 8.5 + if m0 > 0.0 { m_x / m0 } else { 0.0 },
            rows,
            saturated: 0,
            interpolated: 0,
        }
    }

    fn touch(&self) -> TouchFeatures {
        let line = self.line();
        let contact = line.features[1] > 1000.0;
        let plain = TouchFeatures { trusted: true, contact, ..TouchFeatures::default() };
        if contact { line.refined_features(&plain) } else { plain }
    }
}

/// Without anything behind the pad: the plant's finger is where it is told to be.
fn rigid() -> Config {
    let mut config = Config { law: LawName::Model, ..Config::default() };
    config.model.support_n_mm = 1e6;
    config.model.support_nm_rad = 1e6;
    config
}

/// What one fingertip makes of it.
fn of_one(jacobian: Matrix4<f64>, error: [f64; 4], variance: [f64; 4]) -> ([f64; 4], [f64; 4]) {
    displacement([&FeatureMeasurement { jacobian, error, variance }])
}

#[test]
fn the_jacobian_at_the_set_point_is_that_of_the_rows_by_differences() {
    let config = rigid();
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut plant = Plant::new();
    let due = plant.due_mm();
    for (x, yaw) in [(0.0, 0.0), (4.0, 60.0), (-4.0, -30.0)] {
        let at = [x, due, 0.0, yaw];
        plant.at = at;
        let found = contact.jacobian(&plant.line());
        for (motion, step) in [(0, 1e-2), (1, 1e-4), (2, 1e-2), (3, 1e-2)] {
            let mut side = |sign: f64| {
                plant.at = at;
                plant.at[motion] += sign * step * if motion == 3 { -1.0 } else { 1.0 };
                let [x_c, m0, m_x, theta_z] = plant.line().features;
                [x_c, m0, m_x, 1e3 * theta_z]
            };
            let (above, below) = (side(1.0), side(-1.0));
            // The plant's x_c is that of the middle row: the rest is not in it.
            for feature in 0..4 {
                let slope = (above[feature] - below[feature]) / (2.0 * step);
                let entry = found[(feature, motion)];
                if feature == 0 && motion > 0 {
                    continue;
                }
                let size = slope.abs().max(0.02 * found[(feature, feature)].abs());
                assert!((entry - slope).abs() < 0.02 * size, "{feature} {motion}: {entry} {slope}");
            }
        }
    }
}

#[test]
fn the_displacement_is_the_whole_way_to_the_set_point_from_wherever_it_touches() {
    let config = rigid();
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut plant = Plant::new();
    let due = plant.due_mm();
    let exact = [1e-6, 1.0, 1.0, 1e-6];
    // Accuracy and light, heavy, tilted with all rows, with half of them, with three at one end.
    for (z, tilt) in
        [(0.01, 0.0), (0.09, 0.0), (0.04, 1.5), (0.02, -2.5), (-0.01, 4.0), (-0.05, -8.0)]
    {
        plant.at = [0.0, z, tilt, 0.0];
        let line = plant.line();
        let [_, m0, m_x, _] = line.features;
        let error = [0.0, config.m0_counts - m0, -m_x, 0.0];
        let (way, _) = of_one(contact.jacobian(&line), error, exact);
        assert!((way[1] - (due - z)).abs() < 0.1 * (due - z).abs() + 1e-3, "{z} {tilt}: {way:?}");
        assert!((way[2] + tilt).abs() < 0.1 * tilt.abs() + 0.02, "{z} {tilt}: {way:?}");
    }
    // A single row says which way, and that the rest has to come down.
    let mut line = plant.line();
    line.rows = [0.0; 64];
    line.rows[15] = 1_500.0;
    line.features = [8.0, 1_500.0, 7.5 * 1_500.0, 0.0];
    let noisy = [1e-2, 2e5, 4e6, 1.0];
    let error = [0.0, 13_500.0, -7.5 * 1_500.0, 0.0];
    let (way, _) = of_one(contact.jacobian(&line), error, noisy);
    assert!(way[1] > 0.05 && way[2] < -3.0, "{way:?}");
}

#[test]
fn rows_beside_the_pin_have_no_stiffness() {
    let config = rigid();
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut plant = Plant::new();
    plant.at[1] = 0.05;
    let mut line = plant.line();
    let (mut m0, mut m_x) = (0.0, 0.0);
    for (index, row) in line.rows.iter_mut().enumerate() {
        if !(4..12).contains(&index) {
            *row = 0.0;
        }
        m0 += *row;
        m_x += *row * (index as f64 - 7.5);
    }
    line.features = [8.5, m0, m_x, 0.0];
    let depths = contact.depths(&line);
    assert_eq!(depths.present.iter().filter(|on| **on).count(), 8);
    assert!((depths.middle_mm - 0.05).abs() < 2e-3 && depths.per_row_mm.abs() < 1e-4, "{depths:?}");
}

#[test]
fn a_direction_that_cannot_be_seen_is_not_moved_along() {
    let config = rigid();
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut plant = Plant::new();
    plant.at[1] = 0.03;
    let jacobian = contact.jacobian(&plant.line());
    let blind = [1e-3, 2e5, 1e12, 1e6];
    let (way, spread) = of_one(jacobian, [0.0, 0.0, 3e5, 1.0], blind);
    assert!(way.iter().all(|part| part.is_finite() && part.abs() < 50.0), "{way:?}");
    assert!(spread[2] > 1e3 && spread[3] > 1e2, "{spread:?}");
    let (way, _) = of_one(jacobian, [f64::MAX; 4], [f64::MAX; 4]);
    assert!(way.iter().all(|part| !part.is_nan()), "{way:?}");
}

/// Seconds of the closed loop over a plant whose table moves with `table` (units a second, of x, z,
/// theta_x, theta_z), finger `late` jobs behind; ways left after each job.
fn follow(config: &Config, table: [f64; 4], late: usize, seconds: f64) -> Vec<[f64; 4]> {
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut state = ModelState::new(&config.model);
    let mut plant = Plant::new();
    let mut queue = vec![[0.0; 4]; late];
    let mut images = vec![];
    let mut ways = vec![];
    let due = plant.due_mm();
    for job in 0..(seconds / DT_S) as usize {
        if job % 2 == 0 {
            images.push((plant.touch(), plant.line()));
        } else if let Some((touch, line)) = images.last() {
            state =
                observe(config, &contact, &state, &Observation::new(touch, Some(line), DT_S, DT_S));
        }
        let step = job_displacement(config, &state, 8.5, DT_S);
        state = state_after_job(&config.model, &state, &step, DT_S);
        queue.insert(0, step);
        let now = queue.pop().unwrap();
        let signs = [1.0, 1.0, 1.0, -1.0];
        for i in 0..4 {
            let moved = if i == 3 { now[i] - table[i] * DT_S } else { table[i] * DT_S + now[i] };
            plant.at[i] += signs[i] * moved;
        }
        ways.push([plant.at[0], plant.at[1] - due, plant.at[2], plant.at[3]]);
    }
    ways
}

#[test]
fn a_table_that_moves_evenly_is_followed_without_lag() {
    // 10 mm/s of slide would be half of the limit, 87 mrad/s are 5 deg/s, 262 are 15.
    for (rate, lag_mrad) in [(87.3, 1.0), (262.0, 3.0)] {
        let ways = follow(&rigid(), [3.0, -0.5, 40.0, rate], 3, 3.0);
        let last = ways.last().unwrap();
        assert!(last[3].abs() < lag_mrad, "yaw {} mrad behind", last[3]);
        assert!(last[0].abs() < 0.05 && last[1].abs() < 1e-3 && last[2].abs() < 0.1, "{last:?}");
        let most = ways.iter().map(|way| way[3].abs()).fold(0.0, f64::max);
        assert!(most < 0.35 * rate, "at first {most} mrad behind");
    }
}

#[test]
fn a_shape_that_is_wrong_does_not_move_the_load() {
    let (config, mut plant) = (rigid(), Plant::new());
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    for shape_off in [0.8, 1.25, 5.0, f64::NAN] {
        plant.shape_off = shape_off;
        // The sum that is wanted: nothing is left to go along z, whatever the sum by the shape is.
        plant.at = [0.0, plant.due_mm(), 0.0, 0.0];
        let mut state = ModelState::new(&config.model);
        for _ in 0..400 {
            let (touch, line) = (plant.touch(), plant.line());
            state = observe(
                &config,
                &contact,
                &state,
                &Observation::new(&touch, Some(&line), DT_S, DT_S),
            );
        }
        let [_, z, ..] = job_displacement(&config, &state, 8.5, DT_S);
        assert!(z.abs() < 1e-5, "{shape_off}: {z}");
    }
}

#[test]
fn more_delay_than_stated_is_borne_to_twice_as_much() {
    for late in 0..=6 {
        let ways = follow(&rigid(), [0.0, 0.0, 0.0, 50.0], late, 4.0);
        let late_part = &ways[ways.len() - 200..];
        let most = late_part.iter().map(|way| way[3].abs()).fold(0.0, f64::max);
        assert!(most < 1.0, "{late} jobs late: {most} mrad");
    }
}

#[test]
fn nothing_is_remembered_of_a_contact_that_is_lost() {
    let config = rigid();
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let mut plant = Plant::new();
    let fresh = ModelState::new(&config.model);
    let (touch, line) = (plant.touch(), plant.line());
    let image = Observation::new(&touch, Some(&line), DT_S, DT_S);
    let felt = observe(&config, &contact, &fresh, &image);
    assert!(felt.has_image() && felt.column(&config.array).is_some());
    plant.at[1] = -1.0;
    let free = plant.touch();
    let lost = observe(&config, &contact, &felt, &Observation::new(&free, None, DT_S, DT_S));
    assert_eq!(lost, fresh);
    assert_eq!(job_displacement(&config, &lost, 2.0, DT_S), [0.0; 4]);
    // An image that cannot be believed changes nothing.
    let blind = TouchFeatures::default();
    let image = Observation::new(&blind, None, DT_S, DT_S);
    assert_eq!(observe(&config, &contact, &felt, &image), felt);
}

#[test]
fn a_delay_of_more_jobs_than_are_remembered_is_refused_and_so_is_such_an_image() {
    let mut config = rigid();
    assert_eq!(config.check_period(DT_S), Ok(()));
    config.image_period_ms = 1.0;
    for (delay_ms, sound) in [(30.0, true), (30.1, false), (40.0, false)] {
        config.model.delay_ms = delay_ms;
        let refused = config.check_period(1e-3).err().map(|bad| bad.place);
        assert_eq!(refused.as_deref(), (!sound).then_some("model.delay_ms"), "{delay_ms}");
        let other = Config { law: LawName::Thesis, ..config.clone() };
        assert_eq!(other.check_period(1e-3), Ok(()), "another law has no such delay");
    }
    for dt_s in [f64::NAN, 0.0] {
        assert!(config.check_period(dt_s).is_err());
    }
    config.model.delay_ms = 20.0;
    let contact = ContactModel::new(&config.model, &config.array, config.m0_counts).unwrap();
    let plant = Plant::new();
    let (touch, line) = (plant.touch(), plant.line());
    let state = ModelState::new(&config.model);
    let careful = config.clone();
    let seen = |age_s: f64, dt_s: f64| {
        observe(&careful, &contact, &state, &Observation::new(&touch, Some(&line), age_s, dt_s))
            != state
    };
    assert!(seen(0.012, 1e-3) && !seen(0.0135, 1e-3), "32 jobs are remembered");
    assert!(seen(0.0135, DT_S));
    config.model.delay_ms = 30.0;
    let late =
        observe(&config, &contact, &state, &Observation::new(&touch, Some(&line), 0.002, 1e-3));
    assert_ne!(late, state, "what is accepted bears an image that is late");
}
