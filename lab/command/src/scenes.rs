//! `taktil scene`: checks scene files without running them, and prints the schema of a scene file.

use std::path::PathBuf;
use std::process::ExitCode;

use taktil_machine_console::out;

use taktil_lab_scene::assembly::load_checked_scene;
use taktil_machine_console::option::BadOption;

/// What is asked about scenes.
#[derive(Clone, Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub struct SceneArgs {
    /// Print the JSON Schema of scene files, made from what the parser asks for
    #[arg(long)]
    schema: bool,
    #[command(subcommand)]
    command: Option<SceneCommand>,
}

/// What is done with scene files.
#[derive(Clone, Debug, clap::Subcommand)]
enum SceneCommand {
    /// Read scenes with their machines and build all that would run, without running it.
    ///
    /// Every file that cannot be run is complained about, with file, line, column, key and remedy.
    /// Exit code 0: all can be run; 2: at least one cannot.
    Check {
        /// Scene files (TOML)
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
}

/// Executes the command.
///
/// # Errors
/// [`BadOption`] when the command line names neither a command nor `--schema`.
pub fn run(arguments: &SceneArgs) -> anyhow::Result<ExitCode> {
    if arguments.schema {
        let schema = taktil_lab_scene::schema::schema().map_err(anyhow::Error::msg)?;
        out::line(serde_json::to_string_pretty(&schema)?)?;
    }
    match &arguments.command {
        Some(SceneCommand::Check { files }) => check(files),
        None if arguments.schema => Ok(ExitCode::SUCCESS),
        None => Err(BadOption("say `check FILE...` or `--schema`".to_owned()).into()),
    }
}

fn check(files: &[PathBuf]) -> anyhow::Result<ExitCode> {
    let mut sound = true;
    for file in files {
        match load_checked_scene(file) {
            Ok(scene) => {
                out::line(format_args!("ok  {}: {}", file.display(), scene.title))?;
            }
            Err(bad) => {
                sound = false;
                out::warn(&bad);
            }
        }
    }
    Ok(if sound { ExitCode::SUCCESS } else { ExitCode::from(2) })
}
