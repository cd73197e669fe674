//! Measures for `taktil bench contact3d` time against error of contact in three dimensions, and
//! draws the images of a pin under each of its motions. Tables are built once, before the clock
//! starts.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::PlanarPose;
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_machine_console::out;
use taktil_rtcore::linux;

use taktil_lab_plot::heat::{ImagePanel, PrincipalAxis, labelled_heat_maps};
use taktil_lab_progress::Progress;
use taktil_machine_console::option::{BadOption, create_folder};

/// The options of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Runs of each method, in turns; the median counts
    #[arg(long, value_name = "N", default_value_t = 11)]
    pub rounds: u32,
    /// Folder for the images of a pin under each motion (SVG); none without it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// One JSON object instead of the table
    #[arg(long)]
    pub json: bool,
}

/// The layer of the thesis.
const LAYER: Layer = Layer { thickness_mm: 0.8, youngs_mpa: 27.58, poisson: 0.49 };
/// The sphere that is pressed.
const SPHERE: Shape = Shape::Sphere { radius_mm: 10.0 };
/// The pin that is pressed.
const PIN: Shape = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(50.0) };
const SPHERE_POSE: Pose = pose_of(0.4, -0.3, 0.0, 0.0);
const PIN_POSE: Pose = pose_of(0.7, -0.4, 0.35, 0.001);
const ENDLESS_CYLINDER_POSE: Pose = pose_of(0.7, -0.4, 0.35, 0.0);
/// Ratio of the penetration or force of the starting contact of a warm start to the requested one.
const WARM_START_FACTOR: f64 = 1.01;

const fn pose_of(x_mm: f64, y_mm: f64, rot_rad: f64, tilt_rad: f64) -> Pose {
    Pose { planar: PlanarPose { x_mm, y_mm, rot_rad }, tilt_rad }
}

/// The result of one method on one problem.
struct Row {
    problem: &'static str,
    method: String,
    image_error: f64,
    force_error: f64,
    centroid_mm: f64,
    cold_us: f64,
    warm_us: f64,
}

/// Measures, prints the table and draws the pictures.
///
/// # Errors
/// [`BadOption`] for a number of runs that cannot be used; a folder that cannot be written.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    if !(1..=10_000).contains(&plan.rounds) {
        return Err(BadOption(format!("--rounds {}: give 1 to 10000", plan.rounds)).into());
    }
    if let Some(out) = &plan.out {
        create_folder("--out", out)?;
    }
    let table = table(plan.rounds)?;
    if plan.json {
        let tables = taktil_lab_plot::markdown::tables_as_json(&table);
        out::line(serde_json::json!({ "rounds": plan.rounds, "tables": tables }))?;
    } else {
        out::text(table)?;
    }
    let pictures = plan.out.as_ref().map_or(Ok(Vec::new()), |folder| write_pin_images(folder))?;
    for path in pictures.iter().filter(|_| !plan.json) {
        out::line(path.display())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The table of work against precision, in Markdown.
///
/// # Errors
/// An error of a contact; none occurs with these problems.
pub fn table(rounds: u32) -> anyhow::Result<String> {
    let mut rows = Vec::new();
    let problems = [
        ("sphere, R 10, 5 N", SPHERE, SPHERE_POSE, Prescribed::ForceN(5.0)),
        ("pin, R 23, L 50, tilted, rotated", PIN, PIN_POSE, Prescribed::PenetrationMm(0.03)),
        (
            "cylinder without ends, R 23, 0.7 N/mm",
            Shape::Cylinder { radius_mm: 23.0, length_mm: None },
            ENDLESS_CYLINDER_POSE,
            Prescribed::ForceN(0.7),
        ),
    ];
    let mut progress = Progress::new("problems", problems.len());
    for (problem, shape, pose, drive) in problems {
        let (exact, force) = reference_solution(shape, pose, drive)?;
        let levels: &[Accuracy] = match shape {
            Shape::Cylinder { length_mm: None, .. } => &[Accuracy::Default],
            _ => &[Accuracy::Fast, Accuracy::Default, Accuracy::Fine],
        };
        for level in levels.iter().copied() {
            rows.push(scene_row(problem, shape, pose, drive, level, (&exact, force), rounds)?);
        }
        if shape == SPHERE {
            for spacing in [0.2, 0.1, 0.05] {
                rows.push(cells_row(problem, spacing, (&exact, force), rounds)?);
            }
        }
        progress.advance();
    }
    drop(progress);
    let mut out = String::from(
        "| problem | method | image error | force error | centroid, mm | cold, us | warm, us |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for row in &rows {
        let Row { problem, method, image_error, force_error, .. } = row;
        writeln!(
            out,
            "| {problem} | {method} | {image_error:.1e} | {force_error:.1e} | \
             {:.1e} | {:.0} | {:.0} |",
            row.centroid_mm, row.cold_us, row.warm_us
        )?;
    }
    Ok(out)
}

/// Image and force at the finest level, with which the others are compared.
fn reference_solution(
    shape: Shape,
    pose: Pose,
    drive: Prescribed,
) -> anyhow::Result<(Vec<f64>, f64)> {
    let mut scene = Scene::new(&LAYER, shape, &Array::THESIS, Sampling::Area, Accuracy::Fine)?;
    let touch = scene.press(drive, pose)?;
    let mut image = vec![0.0; Array::THESIS.len()];
    scene.image(&mut image)?;
    Ok((image, touch.force_n))
}

fn scene_row(
    problem: &'static str,
    shape: Shape,
    pose: Pose,
    drive: Prescribed,
    level: Accuracy,
    (exact, force): (&[f64], f64),
    rounds: u32,
) -> anyhow::Result<Row> {
    let mut scene = Scene::new(&LAYER, shape, &Array::THESIS, Sampling::Area, level)?;
    let neighbour = match drive {
        Prescribed::ForceN(force) => Prescribed::ForceN(WARM_START_FACTOR * force),
        Prescribed::PenetrationMm(delta) => Prescribed::PenetrationMm(WARM_START_FACTOR * delta),
    };
    let mut image = vec![0.0; Array::THESIS.len()];
    // The deeper contact is solved first, so that its tables suffice for everything that is timed.
    scene.press(neighbour, pose)?;
    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    let mut found = 0.0;
    for _ in 0..rounds {
        scene.press(neighbour, pose)?;
        let start = linux::monotonic();
        black_box(scene.press(drive, pose)?);
        scene.image(&mut image)?;
        warm.push(linux::monotonic() - start);
        scene.release();
        let start = linux::monotonic();
        found = scene.press(drive, pose)?.force_n;
        scene.image(&mut image)?;
        cold.push(linux::monotonic() - start);
    }
    let method = match (shape, level) {
        (Shape::Cylinder { length_mm: None, .. }, _) => "plane problem, one level".to_owned(),
        (Shape::Sphere { .. }, Accuracy::Fast) => "looked up, fast".to_owned(),
        (Shape::Sphere { .. }, _) => format!("integral equation, {level:?}").to_lowercase(),
        _ => format!("slices, {level:?}").to_lowercase(),
    };
    Ok(Row {
        problem,
        method,
        image_error: relative_error(&image, exact),
        force_error: (found / force - 1.0).abs(),
        centroid_mm: centroid_error_mm(&image, exact)?,
        cold_us: median_us(&mut cold),
        warm_us: median_us(&mut warm),
    })
}

fn cells_row(
    problem: &'static str,
    spacing_mm: f64,
    (exact, force): (&[f64], f64),
    rounds: u32,
) -> anyhow::Result<Row> {
    let influence = Influence::new(&LAYER)?;
    let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT)?;
    let delta = sphere_penetration()?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few dozen")]
    let side = (2.4 / spacing_mm).round() as usize;
    let cells = Cells { columns: side, rows: side, spacing_mm };
    let mut surface = Surface::new(&influence, &cells)?;
    let heights: Vec<f64> = (0..side * side)
        .map(|cell| {
            let [x, y] = cells.place_mm(cell);
            10.0 - (100.0 - x * x - y * y).sqrt()
        })
        .collect();
    let place = [SPHERE_POSE.planar.x_mm, SPHERE_POSE.planar.y_mm];
    let mut image = vec![0.0; Array::THESIS.len()];
    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    let mut found = 0.0;
    for _ in 0..rounds {
        surface.press(&heights, Prescribed::PenetrationMm(WARM_START_FACTOR * delta))?;
        for times in [&mut warm, &mut cold] {
            let start = linux::monotonic();
            found = surface.press(&heights, Prescribed::PenetrationMm(delta))?.force_n;
            image.fill(0.0);
            surface.image(&shares, place, &mut image);
            times.push(linux::monotonic() - start);
            surface.release();
        }
    }
    Ok(Row {
        problem,
        method: format!("cells of {spacing_mm} mm"),
        image_error: relative_error(&image, exact),
        force_error: (found / force - 1.0).abs(),
        centroid_mm: centroid_error_mm(&image, exact)?,
        cold_us: median_us(&mut cold),
        warm_us: median_us(&mut warm),
    })
}

fn sphere_penetration() -> anyhow::Result<f64> {
    let mut scene = Scene::new(&LAYER, SPHERE, &Array::THESIS, Sampling::Area, Accuracy::Fine)?;
    let touch = scene.press(Prescribed::ForceN(5.0), SPHERE_POSE)?;
    touch.penetration_mm.context("a sphere has a penetration")
}

/// Largest difference of two images, as a fraction of the peak of the exact one.
fn relative_error(image: &[f64], exact: &[f64]) -> f64 {
    let peak = exact.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let off = image.iter().zip(exact).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
    off / peak
}

fn centroid_error_mm(image: &[f64], exact: &[f64]) -> anyhow::Result<f64> {
    let of = |image: &[f64]| -> anyhow::Result<[f64; 2]> {
        let found = image_features(&Array::THESIS, image, Part::Full)?;
        Ok([found.xc.context("no centroid")?, found.yc.context("no centroid")?])
    };
    let (a, b) = (of(image)?, of(exact)?);
    Ok((a[0] - b[0]).abs().max((a[1] - b[1]).abs()))
}

fn median_us(times: &mut [taktil_rtcore::Nanos]) -> f64 {
    times.sort_unstable();
    times.get(times.len() / 2).map_or(0.0, |time| time.as_micros_f64())
}

/// Images of a pin under each of its motions (the thesis's figures 5.6 to 5.9).
///
/// # Errors
/// A folder that cannot be written.
pub fn write_pin_images(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let pin = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(30.0) };
    let mut scene = Scene::new(&LAYER, pin, &Array::THESIS, Sampling::Area, Accuracy::Default)?;
    let mut written = Vec::new();
    for (name, title, thesis, step) in MOTIONS {
        let (mut images, mut read) = (Vec::new(), Vec::new());
        for s in [-2.0, -1.0, 0.0, 1.0, 2.0] {
            let (title, delta, pose) = step(s);
            scene.press(Prescribed::PenetrationMm(delta), pose)?;
            let mut image = vec![0.0; Array::THESIS.len()];
            scene.image(&mut image)?;
            let found = image_features(&Array::THESIS, &image, Part::Full)?;
            let largest = image.iter().fold(0.0_f64, |most, szz| most.max(-1e3 * szz));
            let turned = found.theta_long_rad.map_or(f64::NAN, f64::to_degrees);
            let [x, y] = [found.xc, found.yc].map(|place| place.unwrap_or(f64::NAN));
            // The direction is mapped to -90 to 90 degrees.
            let turned = turned.rem_euclid(180.0) - 90.0;
            read.push([-found.m0, largest, x, y, turned]);
            // Column and row numbers count from 1; the axis turns from y towards -x.
            let number = |mm: f64| mm / Array::THESIS.pitch_mm + 8.5;
            let axis = (found.xc, found.yc, found.theta_long_rad);
            let axis = match axis {
                (Some(x), Some(y), Some(theta)) => Some(PrincipalAxis {
                    x_c: number(x),
                    y_c: number(y),
                    theta_rad: theta - core::f64::consts::FRAC_PI_2,
                }),
                _ => None,
            };
            let counts = image.iter().map(|szz| -1e3 * szz).collect();
            images.push(ImagePanel { title, rows: 16, cols: 16, counts, valid: Vec::new(), axis });
        }
        let path = folder.join(format!("contact-pin-{name}.svg"));
        let [here, place] = image_remarks(&read);
        let remarks = [format!("thesis: {thesis}"), here, place];
        std::fs::write(&path, labelled_heat_maps(title, "kPa", &remarks, &images).svg_document())
            .with_context(|| format!("{}", path.display()))?;
        written.push(path);
    }
    Ok(written)
}

/// Remarks below a row of images: forces, peaks, centroids and axes, from the first image to the
/// last.
fn image_remarks(read: &[[f64; 5]]) -> [String; 2] {
    let all = |i: usize, digits: usize| {
        // The sign of a negative zero is removed.
        let one = |row: &[f64; 5]| format!("{:.digits$}", row[i] + 0.0).replace("-0.00", "0.00");
        read.iter().map(one).collect::<Vec<_>>().join(", ")
    };
    [
        format!("here a force of {} N, at most {} kPa", all(0, 1), all(1, 0)),
        format!(
            "centroid at x = {} mm, y = {} mm; axis {} degrees from y",
            all(2, 2),
            all(3, 2),
            all(4, 2)
        ),
    ]
}

/// Title, penetration and pose of a step.
type PoseOfStep = fn(f64) -> (String, f64, Pose);

/// Name of the file, title, statement of the thesis, and the pose of each step.
const MOTIONS: [(&str, &str, &str, PoseOfStep); 4] = [
    (
        "along-x",
        "Figure 5.8: a pin, R 23, L 30 mm, 0.03 mm deep, moved along x",
        "the image is translated by as much, and does not change in any other way",
        |s| (format!("x = {} mm", 2.0 * s), 0.03, pose_of(2.0 * s, 0.0, 0.0, 0.0)),
    ),
    (
        "into",
        "Figure 5.6: a pin, R 23, L 30 mm, moved into the layer",
        "a larger force raises the largest stress and the area of contact; symmetric",
        |s| {
            let depth = 0.03 + 0.01 * s;
            (format!("{depth:.3} mm deep"), depth, pose_of(0.0, 0.0, 0.0, 0.0))
        },
    ),
    (
        "about-x",
        "Figure 5.9: a pin, R 23, L 30 mm, 0.03 mm deep at its middle, tilted about x",
        "the stress is skewed along the pin, large in one half and small in the other",
        |s| (format!("{s} mrad"), 0.03, pose_of(0.0, 0.0, 0.0, 1e-3 * s)),
    ),
    (
        "about-z",
        "Figure 5.7: a pin, R 23, L 30 mm, 0.03 mm deep, turned about z",
        "the image turns about z by the same angle",
        |s| {
            let degrees = 15.0 * s;
            (format!("{degrees} deg"), 0.03, pose_of(0.0, 0.0, degrees.to_radians(), 0.0))
        },
    ),
];
