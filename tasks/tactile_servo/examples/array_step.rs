//! One step of the law `model` by arrays of 4 x 4 to 32 x 32 tactels: what it reads wrong with the
//! thesis's noise, in the middle of the pad and in hard cases, and, run under callgrind with two
//! numbers of images, how many instructions it takes.
//!
//! ```text
//! cargo run --profile dist -p taktil-tasks-tactile-servo --example array_step
//! valgrind --tool=callgrind target/dist/examples/array_step 32 1000
//! ```
//! Without arguments it prints the table of errors; with a number of rows and a number of images it
//! takes so many steps and prints their sum only.

use std::hint::black_box;

use taktil_signal::TactileImage;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::config::array::Array;
use taktil_tasks_tactile_servo::law::Observation;
use taktil_tasks_tactile_servo::law::model::jacobian::ContactModel;
use taktil_tasks_tactile_servo::law::model::{
    ModelState, job_displacement, observe, state_after_job,
};
use taktil_tasks_tactile_servo::perception::line::{Line, LineFinder, LineParameters};
use taktil_tasks_tactile_servo::perception::{TouchFeatures, touch_features};

/// Seconds between two jobs.
const DT_S: f64 = 0.0025;
/// Number of images that are used in turn.
const IMAGE_COUNT: usize = 64;
/// Load of the images (counts).
const LOAD_COUNTS: f64 = 15_000.0;
/// Noise on a tactel (counts).
const NOISE_COUNTS: f64 = 50.0;
/// Width of the pads (mm), whatever the number of their tactels.
const PAD_MM: f64 = 25.4;

/// A line of load: its place at the middle of the rows (mm), its direction (rad), its load
/// (counts).
#[derive(Clone, Copy)]
struct Place {
    x_mm: f64,
    theta_rad: f64,
    counts: f64,
}

/// Where the lines of a table's row are drawn.
#[derive(Clone, Copy)]
enum Case {
    /// Over the middle half of the pad.
    Middle,
    /// Within a pitch of the edge of the pad.
    Edge,
    /// Over the middle half, with a tenth of the load.
    Grazing,
    /// The load of a grazing line on a single tactel.
    OneTactel,
    /// Nothing but noise.
    Lost,
}

impl Case {
    const ALL: [Case; 5] = [Case::Middle, Case::Edge, Case::Grazing, Case::OneTactel, Case::Lost];

    fn name(self) -> &'static str {
        match self {
            Case::Middle => "middle",
            Case::Edge => "edge",
            Case::Grazing => "grazing",
            Case::OneTactel => "one tactel",
            Case::Lost => "lost",
        }
    }

    fn place(self, lcg: &mut Lcg, pitch_mm: f64) -> Place {
        let (along, turn) = (lcg.unit() - 0.5, 0.2 * (lcg.unit() - 0.5));
        let middle = Place { x_mm: 0.5 * PAD_MM * along, theta_rad: turn, counts: LOAD_COUNTS };
        match self {
            Case::Middle => middle,
            Case::Edge => {
                let in_mm = (along + 0.5) * pitch_mm;
                Place { x_mm: 0.5 * PAD_MM - in_mm, theta_rad: 0.0, ..middle }
            }
            Case::Grazing | Case::OneTactel => Place { counts: 0.1 * LOAD_COUNTS, ..middle },
            Case::Lost => Place { counts: 0.0, ..middle },
        }
    }
}

/// A repeatable sequence of numbers.
struct Lcg(u64);

impl Lcg {
    /// A number from 0 to 1.
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 40) as f64 / f64::from(1 << 24)
    }

    /// A number with mean zero and deviation one, the sum of twelve.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

/// What a law keeps of an array.
struct Step {
    config: Config,
    contact: ContactModel,
    finder: LineFinder,
    state: ModelState,
}

impl Step {
    fn new(count: u32) -> Step {
        let pitch_mm = PAD_MM / f64::from(count);
        let array = Array { rows: count, cols: count, pitch_x_mm: pitch_mm, pitch_y_mm: pitch_mm };
        let mut config = Config { array, ..Config::default() };
        // The layer spreads a line over two columns at least.
        config.model.pad_thickness_mm = (0.8 * pitch_mm).max(0.8);
        config.model.pad_mpa = (2.0 * 0.8 / config.model.pad_thickness_mm).max(0.5);
        config.x_c_high = f64::from(count) - 1.0;
        let contact = ContactModel::new(&config.model, &array, config.m0_counts).expect("a layer");
        let state = ModelState::new(&config.model);
        Step { finder: LineFinder::new(&array), config, contact, state }
    }

    /// The image of a line load of the layer's own width, with noise.
    fn image(&self, lcg: &mut Lcg, place: Place) -> TactileImage {
        let array = &self.config.array;
        let (rows, cols) = (array.row_count(), array.col_count());
        let mut image = TactileImage::new(array.rows as u16, array.cols as u16);
        image.valid.fill(1);
        (image.baseline_ready, image.noise_counts) = (1, NOISE_COUNTS as f32);
        let spread_mm = 0.6 * self.config.model.pad_thickness_mm + 0.6;
        let left_of = |u: f64| 0.5 * libm::erfc(-u / (spread_mm * core::f64::consts::SQRT_2));
        for row in 0..rows {
            let y_mm = (row as f64 + 1.0 - array.middle_row()) * array.pitch_y_mm;
            let at_mm = place.x_mm - y_mm * libm::tan(place.theta_rad);
            for col in 0..cols {
                let off = (col as f64 + 0.5 - array.middle_column()) * array.pitch_x_mm - at_mm;
                let share = left_of(off + array.pitch_x_mm) - left_of(off);
                let counts = place.counts / rows as f64 * share + NOISE_COUNTS * lcg.normal();
                image.counts[row * cols + col] = counts as f32;
            }
        }
        image
    }

    /// The image of a case at a place.
    fn image_of(&self, case: Case, lcg: &mut Lcg, place: Place) -> TactileImage {
        let is_point = matches!(case, Case::OneTactel);
        let spread = Place { counts: if is_point { 0.0 } else { place.counts }, ..place };
        let mut image = self.image(lcg, spread);
        if is_point {
            let array = &self.config.array;
            let col = (place.x_mm / array.pitch_x_mm + 0.5 * array.col_count() as f64) as usize;
            image.counts[array.row_count() / 2 * array.col_count() + col] += place.counts as f32;
        }
        image
    }

    fn seen(&mut self, image: &TactileImage) -> (TouchFeatures, Option<Line>) {
        let config = &self.config;
        let touch = touch_features(
            image,
            &config.array,
            config.threshold(image.noise_counts),
            config.contact_counts,
        );
        let known = LineParameters {
            profile: self.contact.profile(),
            noise_counts: f64::from(image.noise_counts),
            speed_cols_s: self.state.line_speed_cols_s(&config.array),
        };
        let line = self.finder.line(image, &touch, &known);
        (touch, line.map(|line| line.scaled(self.contact.band_correction())))
    }

    /// From an image to the displacements of two jobs; returns the second along z (mm).
    fn step(&mut self, image: &TactileImage) -> f64 {
        let (touch, line) = self.seen(image);
        let seen = Observation::new(&touch, line.as_ref(), DT_S, DT_S);
        self.state = observe(&self.config, &self.contact, &self.state, &seen);
        let mut moved = [0.0; 4];
        for _ in 0..2 {
            let target = self.config.array.middle_column();
            moved = job_displacement(&self.config, &self.state, target, DT_S);
            self.state = state_after_job(&self.config.model, &self.state, &moved, DT_S);
        }
        moved[1]
    }
}

/// Prints the errors of an array over drawn lines.
fn print_errors(count: u32, case: Case) {
    let (mut step, mut lcg) = (Step::new(count), Lcg(1));
    let (mut squares, mut contacts, mut lines, trials) = ([0.0; 3], 0_u32, 0_u32, 2000_u32);
    let pitch_mm = PAD_MM / f64::from(count);
    for _ in 0..trials {
        let place = case.place(&mut lcg, pitch_mm);
        let image = step.image_of(case, &mut lcg, place);
        let (touch, line) = step.seen(&image);
        contacts += u32::from(touch.contact);
        let Some(line) = line else { continue };
        lines += 1;
        let array = &step.config.array;
        let y_mm = (line.y_c - array.middle_row()) * array.pitch_y_mm;
        let due_mm = place.x_mm - y_mm * libm::tan(place.theta_rad);
        let found_mm = (line.features[0] - array.middle_column()) * array.pitch_x_mm;
        let errors = [
            found_mm - due_mm,
            (line.features[3] - place.theta_rad).to_degrees(),
            100.0 * (line.features[1] / place.counts - 1.0),
        ];
        for (square, error) in squares.iter_mut().zip(errors) {
            *square += error * error;
        }
    }
    let [x_mm, theta_deg, load] = squares.map(|sum| match lines {
        0 => "-".to_owned(),
        lines => format!("{:.3}", (sum / f64::from(lines)).sqrt()),
    });
    println!(
        "| {} | {count} x {count} | {pitch_mm:.2} | {contacts} | {lines} | {x_mm} | {theta_deg} | \
         {load} |",
        case.name()
    );
}

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|text| text.parse::<u32>().ok());
    let (Some(count), Some(images)) = (numbers.next(), numbers.next()) else {
        println!(
            "| case | tactels | pitch, mm | contacts of 2000 | lines of 2000 | x, mm | direction, \
             deg | load, % |"
        );
        println!("|---|---|---|---|---|---|---|---|");
        for case in Case::ALL {
            for count in [4, 8, 16, 24, 32] {
                print_errors(count, case);
            }
        }
        return;
    };
    let (mut step, mut lcg) = (Step::new(count), Lcg(1));
    let drawn: Vec<TactileImage> = (0..IMAGE_COUNT)
        .map(|k| {
            let x_mm = 0.3 * PAD_MM * (k as f64 / IMAGE_COUNT as f64 - 0.5);
            step.image(&mut lcg, Place { x_mm, theta_rad: 0.02, counts: LOAD_COUNTS })
        })
        .collect();
    let mut sum = 0.0;
    for k in 0..images as usize {
        sum += step.step(black_box(&drawn[k % IMAGE_COUNT]));
    }
    println!("{sum}");
}
