//! `taktil bench contact`: the contact models against each other and against what the thesis
//! states. Prints work against precision and the statements with our numbers, and draws the
//! figures. Refuses to judge statements by itself: the verdicts stand in
//! `docs/measurements/contact.md`.

mod block;
mod bricks;
mod chapter3;
mod chapter4;
mod chapter5;
mod curves;
mod held;
mod statements;
mod work;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktild::out;

use super::space;
use crate::plot::svg::Figure;
use crate::run::folder;

/// What to do.
#[derive(Clone, Debug, clap::Args)]
pub struct Plan {
    /// Folder for the figures (SVG); none are drawn without it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the timing, whose figures differ from run to run
    #[arg(long)]
    no_timing: bool,
}

/// Measures, prints, draws.
///
/// # Errors
/// A folder that cannot be written to.
pub fn run(plan: &Plan) -> anyhow::Result<ExitCode> {
    if let Some(out) = &plan.out {
        folder("--out", out)?;
    }
    out::text(statements::table()?)?;
    let ends = [block::ends(0.8)?, block::ends(25.4)?];
    for ends in &ends {
        out::text(block::statement(ends))?;
    }
    if !plan.no_timing {
        out::text(format_args!("\n{}", work::table()?))?;
    }
    if let Some(folder) = &plan.out {
        draw(folder, &ends)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Every figure of the thesis that shows numbers.
fn draw(folder: &Path, ends: &[block::Ends; 2]) -> anyhow::Result<()> {
    let mut figures = chapter3::all()?;
    figures.push(("fig-3-5-free-ends-thin.svg", block::figure(&ends[0])));
    figures.push(("fig-3-6-free-ends-thick.svg", block::figure(&ends[1])));
    for part in [chapter4::all()?, held::all()?, chapter5::all()?] {
        figures.extend(part);
    }
    for (name, picture) in figures {
        write(folder, name, &picture)?;
    }
    for path in space::pictures(folder)? {
        out::line(format_args!("wrote {}", path.display()))?;
    }
    Ok(())
}

fn write(folder: &Path, name: &str, picture: &Figure) -> anyhow::Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, picture.file()).with_context(|| path.display().to_string())?;
    out::line(format_args!("wrote {}", path.display()))?;
    Ok(())
}
