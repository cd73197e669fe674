//! Pictures and tables of a log: `taktil plot`. Refuses names it does not know, and says which
//! signals a picture would need.
//!
//! Pictures are hand-written SVG: the same log makes the same bytes, no font or browser is needed,
//! and they can be read in light and dark viewers.

pub mod axis;
pub mod chart;
mod csv;
pub mod finger;
pub mod heat;
pub mod histogram;
pub mod svg;
pub mod tables;
pub mod timing;
pub mod views;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use taktil_machine_console::out;

use svg::Figure;
use taktil_record::Log;
use views::VIEWS;

/// What `taktil plot` was asked for.
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

/// Panels of a picture are this high (px).
const PANEL_HEIGHT: f64 = 130.0;
/// A panel with more lines than this is not readable.
const LINES_MAX: usize = 12;

/// One result: file name without its ending, and the text in it.
struct Product {
    name: String,
    text: String,
}

/// Every view's name, for help texts.
#[must_use]
pub fn view_names() -> Vec<&'static str> {
    VIEWS.iter().map(|view| view.0).chain(["image", "timing"]).collect()
}

/// Makes the pictures or tables; names each file that was written on `output`.
///
/// # Errors
/// A log that cannot be opened, a name that is no view and no signal, a view whose signals are not
/// in the log, a place that cannot be written.
pub fn run(args: &PlotArgs, output: &mut dyn Write) -> anyhow::Result<()> {
    let log = Log::open(&args.log)?;
    let named = !args.what.is_empty();
    let wanted: Vec<String> = if named {
        args.what.clone()
    } else {
        view_names().into_iter().map(str::to_owned).collect()
    };
    let mut products = Vec::new();
    for name in &wanted {
        match product(&log, name, args.csv)? {
            Some(product) => products.push(product),
            None if named => bail!("{}", absent(&log, name)),
            None => {}
        }
    }
    if products.is_empty() {
        bail!("{} holds nothing that a picture could show", args.log.display());
    }
    let ending = if args.csv { "csv" } else { "svg" };
    if args.out.as_deref() == Some(Path::new("-")) {
        let [only] = products.as_slice() else {
            bail!("`--out -` takes one view; name it with `--what`");
        };
        out::deliver(output, &only.text)?;
        return Ok(());
    }
    let directory = args.out.clone().unwrap_or_else(|| beside(&args.log));
    std::fs::create_dir_all(&directory)
        .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    for product in &products {
        let path = directory.join(format!("{}.{ending}", product.name));
        std::fs::write(&path, &product.text)
            .with_context(|| format!("cannot write {}", path.display()))?;
        out::deliver(output, &format!("{}\n", path.display()))?;
    }
    if let Some(damage) = log.damage() {
        out::deliver(output, &format!("note: the log is {damage}\n"))?;
    }
    Ok(())
}

/// `run.mcap` gets `run-plots` beside it.
fn beside(log: &Path) -> PathBuf {
    let stem = log.file_stem().map_or_else(|| "log".into(), |stem| stem.to_string_lossy());
    log.with_file_name(format!("{stem}-plots"))
}

fn product(log: &Log, name: &str, csv: bool) -> anyhow::Result<Option<Product>> {
    let text = match name {
        "image" => image(log, csv),
        "timing" => timing::page(log, csv)?,
        _ => {
            let view = views::view(log, name).or_else(|| views::signal_view(log, name));
            match view {
                None => None,
                Some(view) if csv => Some(csv::view_csv(&view)),
                Some(mut view) => {
                    let all = view.panels.len();
                    view.panels.retain(|panel| panel.lines.len() <= LINES_MAX);
                    if view.panels.is_empty() {
                        bail!("`{name}` has too many elements for lines; add `--csv`");
                    }
                    let left_out = all - view.panels.len();
                    let title = match left_out {
                        0 => view.title,
                        n => format!("{} ({n} fields with many elements are left out)", view.title),
                    };
                    let strip = views::states(log);
                    let figure = chart::stack(&title, &view.panels, &strip, PANEL_HEIGHT);
                    Some(figure.file())
                }
            }
        }
    };
    let name: String = name.chars().map(|c| if c == '/' { '_' } else { c }).collect();
    Ok(text.map(|text| Product { name, text }))
}

fn image(log: &Log, csv: bool) -> Option<String> {
    if csv {
        let times = log.series("tactile_scan.image")?.t_s;
        let images = views::images(log, &times);
        let rows: Vec<_> = times.into_iter().zip(images).collect();
        return (!rows.is_empty()).then(|| csv::images_csv(&rows));
    }
    snapshots(log).map(|figure| figure.file())
}

/// The tactile image at four moments of the rolling; `None` when the log has no image.
#[must_use]
pub fn snapshots(log: &Log) -> Option<Figure> {
    let images = views::images(log, &views::moments_s(log));
    (!images.is_empty()).then(|| heat::heat_maps("tactile image", &images))
}

fn absent(log: &Log, name: &str) -> String {
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
