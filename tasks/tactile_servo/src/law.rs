//! Figure 6.4 of the thesis: from the features of an image to a displacement of the sensor, `dX =
//! J_s^-1 (F_d - F_a)`, for F = (x_c, M0, M_x, theta_z) and X = (x, z, theta_x, theta_z) of the
//! sensor frame. Refuses to move while the image cannot be believed, and every component whose
//! feature the image does not define.
//!
//! The thesis gives `J_s = diag(20, 20000, 200000, 1000)`, found by trial, without units or signs.
//! Taken here, as an assumption: X in (mm, mm, mrad, mrad), theta_z in mrad, x_c in columns, M_x in
//! counts x rows about the middle line. In millimetres its 20000 counts/mm is near the stiffness of
//! the position servo at the finger, and its 1000 makes the turn follow with a time constant of 5
//! s, which is the weak loop that the thesis reports. Signs follow from geometry ([`SIGNS`]):
//! - x: a sensor that moves by +x over a pin that rolls takes the pin along by half of it, so the
//!   contact moves by -1/2 in the sensor: x_c falls.
//! - z: points out of the face; +z presses and M0 grows.
//! - theta_x: a turn about x moves the face at +y along +z (x cross y = z), so the load grows
//!   there: M_x grows.
//! - theta_z: a turn of the sensor by +a about z turns the image by -a: theta_z falls.

use taktil_mechanics::Joints;
use taktil_mechanics::tactile::{Image, features, moments};
use taktil_rtcore::{Fold, StateHash};
use taktil_signal::{MAX_TACTELS, TactileImage};

use crate::config::Config;

/// Signs of the diagonal of the feature Jacobian for (x_c, M0, M_x, theta_z).
pub const SIGNS: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];

/// What an image says. Every number is finite, whatever the image held.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Touch {
    /// The baseline is known and at least half of the tactels are valid.
    pub trusted: bool,
    /// There is load enough for the features to mean anything.
    pub contact: bool,
    /// Sum of the counts.
    pub m0: f64,
    /// First moment about the middle line (counts x rows).
    pub m_x: f64,
    /// Centroid (column number), inside the array; absent without contact.
    pub x_c: Option<f64>,
    /// Centroid (row number), inside the array; absent without contact.
    pub y_c: Option<f64>,
    /// Direction of the long axis (rad); absent without contact and for a round image.
    pub theta_z_rad: Option<f64>,
}

/// Features of an image: tactels below `threshold_counts` count 0 (0: no threshold), and there is
/// contact when their sum is above `contact_counts`.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "row and column numbers are small")]
pub fn touch(image: &TactileImage, threshold_counts: f64, contact_counts: f64) -> Touch {
    let (rows, cols) = (usize::from(image.rows), usize::from(image.cols));
    let tactels = rows * cols;
    if tactels == 0 || tactels > MAX_TACTELS || image.baseline_ready != 1 {
        return Touch::default();
    }
    let mut valid = [false; MAX_TACTELS];
    for (index, mark) in valid.iter_mut().enumerate() {
        *mark = image.valid[index] == 1 && image.counts[index].is_finite();
    }
    let marks = &valid[..tactels];
    let Ok(view) = Image::new(rows, cols, &image.counts[..tactels], Some(marks)) else {
        return Touch::default();
    };
    let threshold = if threshold_counts > 0.0 { threshold_counts } else { f64::NEG_INFINITY };
    let found = features(&moments(&view, threshold));
    let contact = found.m0 > contact_counts;
    let inside = |centre: Option<f64>, size: usize| {
        centre.filter(|c| contact && (1.0..=size as f64).contains(c))
    };
    Touch {
        trusted: 2 * marks.iter().filter(|mark| **mark).count() >= tactels,
        contact,
        m0: found.m0,
        m_x: found.m_x_centred,
        x_c: inside(found.x_c, cols),
        y_c: inside(found.y_c, rows),
        theta_z_rad: found.theta_z_rad.filter(|_| contact),
    }
}

/// The centroid's way to and fro between two columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    low: f64,
    high: f64,
    tolerance: f64,
    upwards: bool,
    reversals: u32,
}

impl Fold for Heading {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.upwards).add(&self.reversals);
    }
}

impl Heading {
    /// Heads for the lower column first.
    #[must_use]
    pub fn new(config: &Config) -> Heading {
        Heading {
            low: config.x_c_low,
            high: config.x_c_high,
            tolerance: config.x_c_tolerance,
            upwards: false,
            reversals: 0,
        }
    }

    /// The column headed for.
    #[must_use]
    pub fn x_c(&self) -> f64 {
        if self.upwards { self.high } else { self.low }
    }

    /// How often it turned.
    #[must_use]
    pub fn reversals(&self) -> u32 {
        self.reversals
    }

    /// Turns when the centroid is nearer to the column headed for than the tolerance.
    pub fn update(&mut self, x_c: Option<f64>) {
        if x_c.is_some_and(|x_c| (x_c - self.x_c()).abs() < self.tolerance) {
            self.upwards = !self.upwards;
            self.reversals = self.reversals.wrapping_add(1);
        }
    }
}

/// The law without its memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Desired M0, M_x (counts, counts x rows) and theta_z (mrad).
    desired: [f64; 3],
    /// Diagonal of the feature Jacobian with its signs.
    jacobian: [f64; 4],
    /// Most that one image may move (mm, mm, mrad, mrad).
    limits: [f64; 4],
    roll_from_counts: f64,
    seek_mm: f64,
}

impl Law {
    /// The law of a checked table.
    #[must_use]
    pub fn new(config: &Config) -> Law {
        let period_s = config.image_period_ms * 1e-3;
        let mut jacobian = config.feature_jacobian;
        for (size, sign) in jacobian.iter_mut().zip(SIGNS) {
            *size *= sign;
        }
        let speeds = [config.roll_mm_s, config.press_mm_s, config.tilt_mrad_s, config.turn_mrad_s];
        Law {
            desired: [config.m0_counts, config.m_x_counts, config.theta_z_mrad],
            jacobian,
            limits: speeds.map(|speed| speed * period_s),
            roll_from_counts: config.roll_from_counts,
            seek_mm: config.seek_mm_s * period_s,
        }
    }

    /// The displacement (dx, dz, dtheta_x, dtheta_z) of the sensor for one new image (mm, mm, mrad,
    /// mrad), towards column `x_c_desired`.
    ///
    /// Each component is cut off at its speed limit by itself. Without contact only z moves,
    /// towards the surface; with an image that cannot be believed nothing does.
    #[must_use]
    pub fn displacement(&self, touch: &Touch, x_c_desired: f64) -> [f64; 4] {
        if !touch.trusted {
            return [0.0; 4];
        }
        if !touch.contact {
            return [0.0, self.seek_mm, 0.0, 0.0];
        }
        let [m0, m_x, theta_z_mrad] = self.desired;
        let rolls = touch.m0 >= self.roll_from_counts;
        let error = [
            touch.x_c.filter(|_| rolls).map_or(0.0, |x_c| x_c_desired - x_c),
            m0 - touch.m0,
            m_x - touch.m_x,
            touch.theta_z_rad.map_or(0.0, |theta_z| theta_z_mrad - 1e3 * theta_z),
        ];
        let mut step = [0.0; 4];
        for i in 0..4 {
            step[i] = (error[i] / self.jacobian[i]).clamp(-self.limits[i], self.limits[i]);
        }
        step
    }
}

/// A displacement (mm, mm, mrad, mrad) as a small motion of the tool frame `[v; w]` (m, rad); y and
/// theta_y are not the law's.
#[must_use]
pub fn tool_motion(displacement: &[f64; 4]) -> Joints {
    let [x, z, theta_x, theta_z] = displacement.map(|value| value * 1e-3);
    Joints::new(x, 0.0, z, theta_x, 0.0, theta_z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Payload;

    fn image(load: &[(usize, usize, f32)]) -> TactileImage {
        let mut image = TactileImage {
            rows: 16,
            cols: 16,
            valid: [1; 256],
            baseline_ready: 1,
            ..TactileImage::ZERO
        };
        for (x, y, counts) in load {
            image.counts[(y - 1) * 16 + x - 1] = *counts;
        }
        image
    }

    fn of(image: &TactileImage) -> Touch {
        touch(image, 150.0, 500.0)
    }

    fn law() -> Law {
        Law::new(&Config::default())
    }

    #[test]
    fn a_point_is_where_it_is() {
        let found = of(&image(&[(3, 12, 2000.0)]));
        assert!(found.trusted && found.contact);
        assert_eq!((found.x_c, found.y_c), (Some(3.0), Some(12.0)));
        assert_eq!((found.m0, found.m_x, found.theta_z_rad), (2000.0, 7000.0, None));
    }

    #[test]
    fn an_empty_an_unready_or_a_blind_image_moves_nothing_wrong() {
        let zero = of(&image(&[]));
        assert!(zero.trusted && !zero.contact && zero.x_c.is_none());
        assert_eq!(law().displacement(&zero, 2.0), [0.0, 0.03, 0.0, 0.0], "seek");
        assert_eq!(of(&TactileImage::ZERO), Touch::default());
        let mut unready = image(&[(3, 12, 2000.0)]);
        unready.baseline_ready = 0;
        assert_eq!(of(&unready), Touch::default());
        let mut blind = image(&[(16, 16, 2000.0)]);
        blind.valid[..129].fill(0);
        assert!(!of(&blind).trusted);
        assert_eq!(law().displacement(&of(&blind), 2.0), [0.0; 4]);
        blind.valid[128] = 1;
        assert!(of(&blind).trusted, "exactly half is enough");
        for (rows, cols) in [(0, 16), (16, 17), (u16::MAX, u16::MAX)] {
            let odd = TactileImage { rows, cols, ..image(&[]) };
            assert_eq!(of(&odd), Touch::default());
        }
    }

    #[test]
    fn values_that_are_no_numbers_or_huge_do_no_harm() {
        let mut odd = image(&[(3, 12, 2000.0)]);
        odd.counts[5] = f32::NAN;
        odd.counts[6] = f32::INFINITY;
        odd.counts[7] = f32::NEG_INFINITY;
        assert_eq!(of(&odd).x_c, Some(3.0));
        for counts in [f32::MAX, f32::MIN, f32::NAN, -1e30] {
            for threshold in [0.0, 150.0] {
                let mut all = image(&[]);
                all.counts = [counts; 256];
                let found = touch(&all, threshold, 500.0);
                let step = law().displacement(&found, 2.0);
                assert!(step.iter().all(|x| x.is_finite()), "{counts}: {step:?}");
                assert!(found.m0.is_finite() && found.m_x.is_finite());
            }
        }
    }

    #[test]
    fn contact_begins_above_its_limit() {
        assert!(!of(&image(&[(8, 8, 500.0)])).contact);
        assert!(of(&image(&[(8, 8, 500.1)])).contact);
    }

    #[test]
    fn without_a_threshold_negative_noise_counts() {
        let mut noisy = image(&[(8, 8, 1000.0)]);
        noisy.counts[0] = -100.0;
        noisy.counts[1] = 100.0;
        assert_eq!(touch(&noisy, 0.0, 500.0).m0, 1000.0);
        assert_eq!(touch(&noisy, 50.0, 500.0).m0, 1100.0);
        assert_eq!(touch(&noisy, 100.0, 500.0).m0, 1100.0, "the threshold itself is let in");
        assert_eq!(touch(&noisy, 100.1, 500.0).m0, 1000.0);
        // A centroid that noise drives off the array is none.
        let mut wild = image(&[(8, 8, 600.0)]);
        wild.counts[255] = 5000.0;
        wild.counts[0] = -5000.0;
        let found = touch(&wild, 0.0, 500.0);
        assert!(found.contact && found.x_c.is_none() && found.y_c.is_none());
        assert_eq!(law().displacement(&found, 2.0)[0], 0.0);
    }

    #[test]
    fn each_component_answers_its_feature_with_its_gain_and_sign() {
        let at = Touch {
            trusted: true,
            contact: true,
            m0: 15_000.0,
            m_x: 0.0,
            x_c: Some(2.0),
            y_c: Some(8.5),
            theta_z_rad: Some(0.0),
        };
        assert_eq!(law().displacement(&at, 2.0).map(f64::abs), [0.0; 4]);
        let left = law().displacement(&Touch { x_c: Some(1.5), ..at }, 2.0);
        assert_eq!(left, [-0.025, 0.0, 0.0, -0.0]);
        let light = law().displacement(&Touch { m0: 14_800.0, ..at }, 2.0);
        assert_eq!(light[1], 0.01);
        let heavy_at_plus_y = law().displacement(&Touch { m_x: 2000.0, ..at }, 2.0);
        assert_eq!(heavy_at_plus_y[2], -0.01);
        let turned = law().displacement(&Touch { theta_z_rad: Some(0.05), ..at }, 2.0);
        assert!((turned[3] - 0.05).abs() < 1e-15);
        let undefined = Touch { x_c: None, theta_z_rad: None, ..at };
        assert_eq!(law().displacement(&undefined, 15.0), [0.0; 4]);
    }

    #[test]
    fn speeds_are_cut_off_exactly_at_their_limits() {
        let far = Touch {
            trusted: true,
            contact: true,
            m0: 1e6,
            m_x: -1e9,
            x_c: Some(16.0),
            y_c: Some(8.5),
            theta_z_rad: Some(-1.57),
        };
        let limits = [0.055, -0.02, 0.5, -0.5];
        for (got, limit) in law().displacement(&far, 2.0).iter().zip(limits) {
            assert!((got - limit).abs() < 1e-15, "{got} is not {limit}");
        }
    }

    #[test]
    fn a_pin_that_is_hardly_pressed_is_not_rolled() {
        let mut at = Touch { trusted: true, contact: true, x_c: Some(8.0), ..Touch::default() };
        at.m0 = 5999.0;
        assert_eq!(law().displacement(&at, 2.0)[0], 0.0);
        at.m0 = 6000.0;
        assert!(law().displacement(&at, 2.0)[0] > 0.0, "towards column 2 the sensor moves by +x");
    }

    #[test]
    fn the_heading_turns_inside_the_tolerance_only() {
        let mut heading = Heading::new(&Config::default());
        let mut seen = |x_c: Option<f64>| {
            heading.update(x_c);
            (heading.x_c(), heading.reversals())
        };
        assert_eq!(seen(None), (2.0, 0));
        assert_eq!(seen(Some(2.5)), (2.0, 0), "the limit itself is outside");
        assert_eq!(seen(Some(2.499)), (15.0, 1));
        assert_eq!(seen(Some(2.0)), (15.0, 1));
        assert_eq!(seen(Some(14.501)), (2.0, 2));
        assert_eq!(seen(Some(f64::NAN)), (2.0, 2));
    }

    #[test]
    fn a_displacement_becomes_a_motion_of_the_tool_in_metres_and_radians() {
        let motion = tool_motion(&[1.0, 2.0, 3.0, 4.0]);
        assert_eq!(motion, Joints::new(0.001, 0.0, 0.002, 0.003, 0.0, 0.004));
    }
}
