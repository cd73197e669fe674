//! `taktil bench contact`: the contact models against each other and against what the thesis
//! states. Prints work against precision and the statements with our numbers, and draws the
//! figures. Refuses to judge statements by itself: the verdicts stand in
//! `docs/measurements/contact.md`.

mod beside;
mod block;
mod bricks;
mod chapter3;
mod chapter4;
mod chapter5;
mod curves;
mod held;
mod rolls;
mod statements;
mod work;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktil_machine_console::out;

use super::space;
use taktil_machine_console::option::create_folder;

/// What to do.
#[derive(Clone, Debug, clap::Args)]
pub struct Plan {
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

/// Measures, prints, draws.
///
/// # Errors
/// A folder that cannot be written to.
pub fn run(plan: &Plan) -> anyhow::Result<ExitCode> {
    if let Some(out) = &plan.out {
        create_folder("--out", out)?;
    }
    let mut text = statements::table()?;
    let ends = [block::ends(0.8)?, block::ends(25.4)?];
    text.extend(ends.iter().map(block::statement));
    if !plan.no_timing {
        text += "\n";
        text += &work::table()?;
        rolls::table(&mut text)?;
        bricks::table(&mut text)?;
        text += "\n";
        text += &beside::table(&plan.python, &std::env::current_exe()?);
    }
    if plan.json {
        out::line(serde_json::json!({ "tables": taktil_lab_plot::tables::json(&text) }))?;
    } else {
        out::text(text)?;
    }
    let drawn = plan.out.as_ref().map_or(Ok(Vec::new()), |folder| draw(folder, &ends))?;
    for path in drawn.iter().filter(|_| !plan.json) {
        out::line(format_args!("wrote {}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Every figure of the thesis that shows numbers; where they are.
fn draw(folder: &Path, ends: &[block::Ends; 2]) -> anyhow::Result<Vec<PathBuf>> {
    let mut figures = chapter3::all()?;
    figures.push(("fig-3-5-free-ends-thin.svg", block::figure(&ends[0])));
    figures.push(("fig-3-6-free-ends-thick.svg", block::figure(&ends[1])));
    for part in [chapter4::all()?, held::all()?, chapter5::all()?] {
        figures.extend(part);
    }
    let mut drawn = Vec::new();
    for (name, picture) in figures {
        let path = folder.join(name);
        std::fs::write(&path, picture.file()).with_context(|| path.display().to_string())?;
        drawn.push(path);
    }
    drawn.extend(space::pictures(folder)?);
    Ok(drawn)
}
