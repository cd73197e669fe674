//! `taktil bench contact`: the contact models against each other and against what the thesis
//! states. Prints work against precision and the statements with our numbers, and draws the
//! figures. Refuses to judge statements by itself: the verdicts stand in
//! `docs/measurements/contact.md`.

mod curves;
mod figures;
mod statements;
mod work;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;

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
    print!("{}", statements::table()?);
    if !plan.no_timing {
        print!("\n{}", work::table()?);
    }
    if let Some(folder) = &plan.out {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        for (name, picture) in figures::all()? {
            let path = folder.join(name);
            std::fs::write(&path, picture.file()).with_context(|| path.display().to_string())?;
            println!("wrote {}", path.display());
        }
    }
    Ok(ExitCode::SUCCESS)
}
