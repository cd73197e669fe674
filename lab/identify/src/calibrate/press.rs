//! The load of each image: force, position and rotation of the contact; and the loads that a layer
//! of rubber puts on the tactels under it. A contact that is not a pin across the rows, and images
//! without the sensor's instants or counts, are errors.

use taktil_contact::cylinder::LineContact;
use taktil_contact::layer;
use taktil_rtcore::Nanos;
use taktil_sim::scene::ScanStamp;
use taktil_sim::{ArrayGeometry, Truth, WorldConfig};

use taktil_record::series::Series;

/// Smallest distance, in columns, of the contact line from the outer edge of the first or the last
/// column, in any row. Images of a nearer line are left out, because the pin leaves the pad there.
const EDGE_MARGIN_COLUMNS: f64 = 0.5;
/// Smallest force of an image that is used (N).
const FORCE_MIN_N: f64 = 2.0;
/// Smallest number of images that determine the noise without a load.
pub const UNLOADED_IMAGES_MIN: usize = 20;
/// Largest penetration that is solved, in thicknesses.
const PENETRATION_RATIO_MAX: f64 = 0.2;
/// Largest number of steps to the penetration of a force.
const ITERATIONS_MAX: usize = 60;

/// One image with its load.
#[derive(Clone, Debug)]
pub struct LoadedImage {
    /// Counts above the baseline, row by row; NaN where the tactel is invalid.
    pub counts: Vec<f64>,
    /// Normal force (N).
    pub force_n: f64,
    /// Position of the contact line in column numbers, from 1: the mean weighted by the rows'
    /// loads.
    pub x_c: f64,
    /// Direction of the line, from the sensor's y towards -x (rad).
    pub yaw_rad: f64,
    /// Rotation of the finger against the pin about the sensor's x (rad).
    pub tilt_rad: f64,
}

impl LoadedImage {
    /// The load of an image of this array with these counts; `None` when the force was too small or
    /// the contact was too near to an edge of the pad.
    #[must_use]
    pub fn of(counts: Vec<f64>, array: &ArrayGeometry, truth: &Truth) -> Option<LoadedImage> {
        let x_c = truth.contact_x_tactels.filter(|_| truth.finger_normal_n >= FORCE_MIN_N)?;
        let (force_n, yaw_rad) = (truth.finger_normal_n, truth.pin_yaw_rad);
        let [middle, middle_row] = [array.cols, array.rows].map(|n| 0.5 * (n + 1) as f64);
        let across = middle_row * (array.pitch_y_m / array.pitch_x_m);
        let reach = (x_c - middle).abs() + across * libm::tan(yaw_rad).abs();
        let inside = reach <= 0.5 * array.cols as f64 - EDGE_MARGIN_COLUMNS;
        inside.then_some(LoadedImage { counts, force_n, x_c, yaw_rad, tilt_rad: truth.tilt_rad })
    }
}

/// What is known of pad and pin before the calibration.
#[derive(Clone, Debug)]
pub struct Pad {
    /// Rows, columns and pitches of the array.
    pub array: ArrayGeometry,
    /// Radius of the pin (mm).
    pub radius_mm: f64,
    /// The layer's thickness as given (mm).
    pub thickness_mm: f64,
    /// Poisson's ratio of the layer as given.
    pub poisson: f64,
    /// Full scale of a tactel (N).
    pub full_scale_n: f64,
    /// Counts at full scale.
    pub full_counts: f64,
    /// Largest count above the rest level that the converter reports.
    pub rail_counts: f64,
    /// Number of frames over which the rest level is a mean.
    pub baseline_frames: f64,
}

impl Pad {
    /// Takes the geometry from the scene; its stiffness and its tactels' response are not used. The
    /// rest level is the mean of `frames` frames.
    ///
    /// # Errors
    /// A scene in which no pin is rolled, or whose images do not carry their instants.
    pub fn of(world: &WorldConfig, frames: u32) -> Result<Pad, String> {
        let tactile = &world.tactile;
        if !world.pin.present {
            return Err(
                "its scene has no pin (pin.present = false); record one in which a pin is \
                        rolled, such as sim/scenes/roll-pin.toml"
                    .to_owned(),
            );
        }
        if tactile.row_us > 0.0
            || (tactile.stamp == ScanStamp::Delivered && tactile.delay_scans > 0)
        {
            return Err("its images were not made at the instant that they carry \
                        (tactile.row_us, tactile.stamp); record with rows read at once and \
                        stamped when scanned"
                .to_owned());
        }
        let rubber = &world.finger.rubber;
        let full_counts = f64::from(tactile.full_counts());
        Ok(Pad {
            array: tactile.geometry(),
            radius_mm: world.pin.radius_mm,
            thickness_mm: rubber.thickness_mm,
            poisson: rubber.poisson,
            full_scale_n: tactile.full_scale_n,
            full_counts,
            rail_counts: full_counts - tactile.rest_counts,
            baseline_frames: f64::from(frames.max(1)),
        })
    }

    /// Solves the pin on a layer of 1 MPa.
    ///
    /// # Errors
    /// A contact that cannot be solved.
    pub fn layer(&self, thickness_mm: f64, poisson: f64) -> Result<Layer, String> {
        let deepest_mm = (PENETRATION_RATIO_MAX * thickness_mm).min(0.2 * self.radius_mm);
        layer::Layer::new(thickness_mm, 1.0, poisson)
            .and_then(|layer| LineContact::new(&layer, self.radius_mm, deepest_mm))
            .map(|contact| Layer { contact, array: self.array })
            .map_err(|bad| format!("the contact cannot be solved: {} {}", bad.place, bad.what))
    }
}

/// A solved contact of the pin on a layer of 1 MPa.
pub struct Layer {
    contact: LineContact,
    array: ArrayGeometry,
}

impl Layer {
    /// Force on each tactel (N) for a rubber of this modulus.
    #[must_use]
    pub fn loads(&self, press: &LoadedImage, youngs_mpa: f64) -> Vec<f64> {
        let ArrayGeometry { rows, cols, .. } = self.array;
        let [pitch_x_mm, pitch_y_mm] =
            [self.array.pitch_x_m, self.array.pitch_y_m].map(|m| 1e3 * m);
        let middle = 0.5 * (rows + 1) as f64;
        let across = libm::cos(press.yaw_rad);
        let width_mm = pitch_y_mm / across;
        let per_row_mm = pitch_y_mm * libm::tan(press.tilt_rad);
        let lean = |row: usize| per_row_mm * (row as f64 + 1.0 - middle);
        let deep_mm = self.depth_mm(press.force_n / (youngs_mpa * width_mm), &lean);
        let row_n =
            |row: usize| youngs_mpa * width_mm * self.contact.load_n_mm(deep_mm + lean(row));
        // The position of the line is a mean weighted by the rows' loads, not the position at the
        // middle row, because a finger that leans presses some rows more.
        let turned = libm::tan(press.yaw_rad) * (pitch_y_mm / pitch_x_mm);
        let (mut sum_n, mut first) = (0.0, 0.0);
        for row in 0..rows {
            let load_n = row_n(row);
            (sum_n, first) = (sum_n + load_n, first + load_n * (row as f64 + 1.0));
        }
        let mean = if sum_n > 0.0 { first / sum_n } else { middle };
        let mut loads = vec![0.0; rows * cols];
        for row in 0..rows {
            let (load_n, delta_mm) = (row_n(row), deep_mm + lean(row));
            if load_n <= 0.0 {
                continue;
            }
            let line = press.x_c - turned * (row as f64 + 1.0 - mean);
            let shares = self.contact.base_shares(delta_mm);
            let share =
                |edge: usize| shares.left_of(across * pitch_x_mm * (edge as f64 + 0.5 - line));
            let mut left = share(0);
            for column in 0..cols {
                let right = share(column + 1);
                loads[row * cols + column] = load_n * (right - left);
                left = right;
            }
        }
        loads
    }

    /// Penetration in the middle row (mm) at which the rows' line loads sum to `sum_n_mm`, by
    /// Newton's method inside a bracket; the sum increases with the penetration.
    fn depth_mm(&self, sum_n_mm: f64, lean: &impl Fn(usize) -> f64) -> f64 {
        let count = self.array.rows;
        let rows = |f: fn(&LineContact, f64) -> f64, deep_mm: f64| {
            (0..count).map(|row| f(&self.contact, deep_mm + lean(row))).sum::<f64>()
        };
        let most = lean(0).abs().max(lean(count - 1).abs());
        let mut high = self.contact.penetration_mm(sum_n_mm / count as f64) + most;
        let mut low = -most;
        let mut deep = high - most;
        for _ in 0..ITERATIONS_MAX {
            let excess = rows(LineContact::load_n_mm, deep) - sum_n_mm;
            if excess > 0.0 {
                high = deep;
            } else {
                low = deep;
            }
            let newton = deep - excess / rows(LineContact::stiffness_n_mm2, deep);
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let moved = (next - deep).abs();
            deep = next;
            if excess == 0.0 || moved < 1e-14 {
                break;
            }
        }
        deep
    }
}

/// The images of a log with their loads.
#[derive(Clone, Debug)]
pub struct LoadedImages {
    /// Every image under a load, with the load at its instant.
    pub presses: Vec<LoadedImage>,
    /// Standard deviation of a tactel's readings without a load (counts); `None` when there are too
    /// few.
    pub rest_noise_counts: Option<f64>,
    /// Number of images without a load.
    pub rest_images: usize,
}

/// The images of a log, one row each.
#[derive(Clone, Debug)]
pub struct Images {
    /// Instant of each image (s).
    pub at_s: Vec<f64>,
    array: ArrayGeometry,
    counts: Vec<Vec<f64>>,
}

/// Sums over the images without a load.
#[derive(Default)]
struct UnloadedSums {
    images: usize,
    sums: Vec<[f64; 2]>,
}

impl UnloadedSums {
    fn add(&mut self, counts: &[f64]) {
        self.images += 1;
        self.sums.resize(counts.len(), [0.0; 2]);
        for (sums, count) in self.sums.iter_mut().zip(counts) {
            (sums[0], sums[1]) = (sums[0] + count, sums[1] + count * count);
        }
    }

    /// Tactels that were invalid at any time are NaN and left out.
    fn noise(&self) -> Option<f64> {
        let n = self.images as f64;
        let squares = self.sums.iter().map(|[sum, square]| square - sum * sum / n);
        let known: Vec<f64> = squares.filter(|square| square.is_finite()).collect();
        (self.images >= UNLOADED_IMAGES_MIN && !known.is_empty()).then(|| {
            let mean = known.iter().sum::<f64>() / ((n - 1.0) * known.len() as f64);
            mean.max(0.0).sqrt()
        })
    }
}

impl Images {
    /// The images of `tactile_scan.image`, made by this array, each once, from the baseline on.
    ///
    /// # Errors
    /// Fields that the signal lacks, an array of another size, or no image.
    pub fn of(images: &Series, array: &ArrayGeometry) -> Result<Images, String> {
        let field = |name: &str| {
            images.column(name).ok_or_else(|| format!("`tactile_scan.image` has no field `{name}`"))
        };
        let (counts, valid) = (field("counts")?, field("valid")?);
        let (ready, sequence) = (field("baseline_ready")?, field("sequence")?);
        let acquired = field("acquired_ns")?;
        let tactels = array.tactels();
        if (counts.width, valid.width) != (tactels, tactels) {
            return Err(format!("its images have {} tactels, not {tactels}", counts.width));
        }
        let mut all = Images { at_s: Vec::new(), array: *array, counts: Vec::new() };
        let mut last = f64::NAN;
        for row in 0..images.len() {
            if ready.values[row] == 0.0 || sequence.values[row] == last {
                continue;
            }
            last = sequence.values[row];
            let believed = counts.row(row).iter().zip(valid.row(row));
            let or_nan = |count: &f64, valid: &f64| if *valid > 0.0 { *count } else { f64::NAN };
            all.at_s.push(1e-9 * acquired.values[row]);
            all.counts.push(believed.map(|(count, valid)| or_nan(count, valid)).collect());
        }
        if all.at_s.is_empty() {
            return Err("it has no image above a baseline (`tactile_scan.image` with \
                        baseline_ready); record with the operator's `calibrate`"
                .to_owned());
        }
        Ok(all)
    }

    /// Leaves out the images from the first one later than `until`, and returns how many.
    pub fn end_at(&mut self, until: Nanos) -> usize {
        let whole = self.at_s.len();
        let later = |at_s: &f64| Nanos((1e9 * at_s).round() as i64) > until;
        let kept = self.at_s.iter().position(later).unwrap_or(whole);
        self.at_s.truncate(kept);
        self.counts.truncate(kept);
        whole - kept
    }

    /// The images with the loads at their instants.
    ///
    /// # Errors
    /// No image under a load.
    pub fn with_truths(self, truths: &[Truth]) -> Result<LoadedImages, String> {
        let (mut presses, mut rest) = (Vec::new(), UnloadedSums::default());
        for (counts, truth) in self.counts.into_iter().zip(truths) {
            if truth.finger_normal_n <= 0.0 {
                rest.add(&counts);
            }
            presses.extend(LoadedImage::of(counts, &self.array, truth));
        }
        if presses.is_empty() {
            return Err(format!(
                "none of its images was made under {FORCE_MIN_N} N of a pin or more; record a run \
                 in which the pin is rolled"
            ));
        }
        Ok(LoadedImages { presses, rest_noise_counts: rest.noise(), rest_images: rest.images })
    }
}
