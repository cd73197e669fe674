//! Draws pictures and writes tables of a log, for `taktil plot`. An unknown name is an error that
//! lists the known ones.
//!
//! Pictures are SVG that this crate writes itself. The same log yields the same bytes, no font or
//! browser is needed, and pictures are legible on light and on dark displays.

pub mod arm_view;
pub mod axis;
pub mod chart;
mod csv;
pub mod finger;
pub mod heat;
pub mod histogram;
pub mod markdown;
pub mod svg;
pub mod timing;
pub mod views;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use taktil_machine_console::out;

use svg::Figure;
use taktil_record::Log;
use views::VIEWS;

/// The arguments of `taktil plot`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlotArgs {
    /// The log.
    pub log: PathBuf,
    /// Views (`features`, `image`, `timing` ...) or signals (`sense.joints`, `sense.joints.q_rad`);
    /// empty for every view that the log allows.
    pub what: Vec<String>,
    /// Tables instead of pictures.
    pub csv: bool,
    /// Directory to write to; `-` sends a single table or picture to the output. Without it a
    /// directory beside the log, named after it.
    pub out: Option<PathBuf>,
}

/// Height of a panel of a picture.
const PANEL_HEIGHT_PX: f64 = 130.0;
/// Most lines of a panel; with more of them it is not readable.
const LINES_PER_PANEL_MAX: usize = 12;

/// One result that is written to a file.
struct OutputFile {
    /// Name of the file without its extension.
    name: String,
    /// Content of the file.
    text: String,
}

/// The names of all views, for help texts.
#[must_use]
pub fn view_names() -> Vec<&'static str> {
    VIEWS.iter().map(|view| view.0).chain(["arm", "image", "timing"]).collect()
}

/// Writes the pictures or tables, and prints the name of each file on `output`.
///
/// # Errors
/// A log that cannot be opened, a name that is neither a view nor a signal, a view whose signals
/// are not in the log, or a path that cannot be written.
pub fn run(args: &PlotArgs, output: &mut dyn Write) -> anyhow::Result<()> {
    let log = Log::open(&args.log)?;
    let named = !args.what.is_empty();
    let wanted: Vec<String> = if named {
        args.what.clone()
    } else {
        view_names().into_iter().map(str::to_owned).collect()
    };
    let mut files = Vec::new();
    for name in &wanted {
        match output_file(&log, name, args.csv)? {
            Some(file) => files.push(file),
            None if named => bail!("{}", absence_message(&log, name)),
            None => {}
        }
    }
    if files.is_empty() {
        let shown = args.log.display();
        bail!("{shown} holds nothing that a picture could show; name the log of another run");
    }
    let ending = if args.csv { "csv" } else { "svg" };
    if args.out.as_deref() == Some(Path::new("-")) {
        let [only] = files.as_slice() else {
            bail!("`--out -` takes one view; name it with `--what`");
        };
        out::deliver(output, &only.text)?;
        return Ok(());
    }
    let directory = args.out.clone().unwrap_or_else(|| default_directory(&args.log));
    std::fs::create_dir_all(&directory)
        .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    for file in &files {
        let path = directory.join(format!("{}.{ending}", file.name));
        std::fs::write(&path, &file.text)
            .with_context(|| format!("cannot write {}", path.display()))?;
        out::deliver(output, &format!("{}\n", path.display()))?;
    }
    if let Some(damage) = log.damage() {
        out::deliver(output, &format!("note: the log is {damage}\n"))?;
    }
    Ok(())
}

/// The directory beside a log that takes its pictures: `run-plots` beside `run.mcap`.
fn default_directory(log: &Path) -> PathBuf {
    let stem = log.file_stem().map_or_else(|| "log".into(), |stem| stem.to_string_lossy());
    log.with_file_name(format!("{stem}-plots"))
}

fn output_file(log: &Log, name: &str, csv: bool) -> anyhow::Result<Option<OutputFile>> {
    let text = match name {
        "image" => image(log, csv),
        // A picture only: the numbers are those of `world.truth`.
        "arm" if csv => None,
        "arm" => arm_figure(log).map(|figure| figure.svg_document()),
        "timing" => timing::page(log, csv)?,
        _ => {
            let view = views::view(log, name).or_else(|| views::signal_view(log, name));
            match view {
                None => None,
                Some(view) if csv => Some(csv::view_csv(&view)),
                Some(mut view) => {
                    let all = view.panels.len();
                    view.panels.retain(|panel| panel.lines.len() <= LINES_PER_PANEL_MAX);
                    if view.panels.is_empty() {
                        bail!("`{name}` has too many elements for lines; add `--csv`");
                    }
                    let left_out = all - view.panels.len();
                    let title = match left_out {
                        0 => view.title,
                        n => format!("{} ({n} fields with many elements are left out)", view.title),
                    };
                    let strip = views::state_strip(log);
                    let figure =
                        chart::stacked_panels(&title, &view.panels, &strip, PANEL_HEIGHT_PX);
                    Some(figure.svg_document())
                }
            }
        }
    };
    let name: String = name.chars().map(|c| if c == '/' { '_' } else { c }).collect();
    Ok(text.map(|text| OutputFile { name, text }))
}

fn image(log: &Log, csv: bool) -> Option<String> {
    if csv {
        let times = log.series("tactile_scan.image")?.t_s;
        let images = views::image_panels(log, &times);
        let rows: Vec<_> = times.into_iter().zip(images).collect();
        return (!rows.is_empty()).then(|| csv::images_csv(&rows));
    }
    snapshot_figure(log).map(|figure| figure.svg_document())
}

/// Arm, pin and table at four moments of the rolling; `None` when the log is not of the simulated
/// PUMA 260.
#[must_use]
pub fn arm_figure(log: &Log) -> Option<Figure> {
    arm_view::figure(log, &views::snapshot_times_s(log))
}

/// The tactile image at four moments of the rolling; `None` when the log has no image.
#[must_use]
pub fn snapshot_figure(log: &Log) -> Option<Figure> {
    let images = views::image_panels(log, &views::snapshot_times_s(log));
    (!images.is_empty()).then(|| heat::heat_maps("tactile image", &images))
}

fn absence_message(log: &Log, name: &str) -> String {
    if name == "timing" {
        return "the log holds no timing figures: they are written at the end of a run".to_owned();
    }
    let signals: Vec<&str> = log.channels().iter().map(|c| c.signal.as_str()).collect();
    if view_names().contains(&name) {
        return format!("the log lacks the signals of `{name}`; it has: {}", signals.join(", "));
    }
    format!(
        "`{name}` is neither a view ({}) nor a signal of this log ({})",
        view_names().join(", "),
        signals.join(", ")
    )
}
