//! Compares for `taktil bench contact` the contact models with each other and with the statements
//! of the thesis. It prints work against precision and the statements beside our numbers, and draws
//! the figures. The verdicts on the statements stand in `docs/measurements/contact.md`.

mod bricks;
mod chapter3;
mod chapter4;
mod chapter5;
mod curves;
mod free_ends;
mod methods;
mod no_slip;
mod python_package;
mod rolls;
mod statements;
mod work;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktil_lab_progress::Progress;
use taktil_machine_console::out;

use super::space;
use taktil_machine_console::option::create_folder;

/// The options of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Folder for the figures (SVG); none are drawn without it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the timing, whose figures differ from run to run
    #[arg(long)]
    no_timing: bool,
    /// Python that may have the package ContactMechanics, which is timed beside ours if it has
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// One JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

/// Measures, prints the tables and draws the figures.
///
/// # Errors
/// A folder that cannot be written to.
pub fn run(plan: &Options) -> anyhow::Result<ExitCode> {
    if let Some(out) = &plan.out {
        create_folder("--out", out)?;
    }
    let mut progress = Progress::new("parts", if plan.no_timing { 2 } else { 6 });
    let mut text = statements::table()?;
    progress.advance();
    let ends = [free_ends::free_end_stresses(0.8)?, free_ends::free_end_stresses(25.4)?];
    text.extend(ends.iter().map(free_ends::statement));
    progress.advance();
    if !plan.no_timing {
        text += "\n";
        text += &work::table()?;
        progress.advance();
        rolls::table(&mut text)?;
        progress.advance();
        bricks::table(&mut text)?;
        progress.advance();
        text += "\n";
        text += &python_package::table(&plan.python, &std::env::current_exe()?);
        progress.advance();
    }
    drop(progress);
    if plan.json {
        out::line(
            serde_json::json!({ "tables": taktil_lab_plot::markdown::tables_as_json(&text) }),
        )?;
    } else {
        out::text(text)?;
    }
    let drawn = plan.out.as_ref().map_or(Ok(Vec::new()), |folder| draw(folder, &ends))?;
    for path in drawn.iter().filter(|_| !plan.json) {
        out::line(format_args!("wrote {}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Draws every figure of the thesis that shows numbers, and returns the paths.
fn draw(folder: &Path, ends: &[free_ends::FreeEndStresses; 2]) -> anyhow::Result<Vec<PathBuf>> {
    let mut progress = Progress::new("chapters drawn", 4);
    let mut figures = chapter3::figures()?;
    progress.advance();
    figures.push(("fig-3-5-free-ends-thin.svg", free_ends::figure(&ends[0])));
    figures.push(("fig-3-6-free-ends-thick.svg", free_ends::figure(&ends[1])));
    for chapter in [chapter4::figures, no_slip::figures, chapter5::figures] {
        figures.extend(chapter()?);
        progress.advance();
    }
    drop(progress);
    let mut drawn = Vec::new();
    for (name, picture) in figures {
        let path = folder.join(name);
        std::fs::write(&path, picture.svg_document())
            .with_context(|| path.display().to_string())?;
        drawn.push(path);
    }
    drawn.extend(space::write_pin_images(folder)?);
    Ok(drawn)
}
