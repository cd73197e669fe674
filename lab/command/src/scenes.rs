//! `taktil scene`: lists, prints and copies the scenes that the program holds, checks scene files
//! without running them, and prints the schema of a scene file.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktil_machine::shipped::{self, ShippedFile};
use taktil_machine::source::{FileKind, Source};
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
    /// List the scenes that the program holds, each with its title
    List,
    /// Print a scene: a file, or one that the program holds, by its name
    Show {
        /// For example roll-pin, held/light or a file (TOML)
        scene: PathBuf,
    },
    /// Write a scene that the program holds to a folder, with the machine file, the arm and the
    /// tables of motion that it names, to be changed there.
    ///
    /// The files get the paths below the folder that they have below the repository. Where one of
    /// them exists and differs nothing is written.
    Copy {
        /// For example roll-pin or held/light
        scene: PathBuf,
        /// Folder; it is made when it does not exist
        #[arg(default_value = ".")]
        folder: PathBuf,
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
        Some(SceneCommand::List) => list(),
        Some(SceneCommand::Show { scene }) => show(scene),
        Some(SceneCommand::Copy { scene, folder }) => copy(scene, folder),
        None if arguments.schema => Ok(ExitCode::SUCCESS),
        None => Err(BadOption(
            "say `list`, `show SCENE`, `copy SCENE FOLDER`, `check FILE...` or `--schema`"
                .to_owned(),
        )
        .into()),
    }
}

fn check(files: &[PathBuf]) -> anyhow::Result<ExitCode> {
    let mut sound = true;
    for file in files {
        match load_checked_scene(file) {
            Ok(scene) => {
                out::line(format_args!("ok  {}: {}", file.display(), scene.title))?;
                for remark in &scene.arm_remarks {
                    out::line(format_args!("    the arm: {remark}"))?;
                }
            }
            Err(bad) => {
                sound = false;
                out::warn(&bad);
            }
        }
    }
    Ok(if sound { ExitCode::SUCCESS } else { ExitCode::from(2) })
}

/// The shipped scenes, by their names below the folder of the scenes.
fn shipped_scenes() -> impl Iterator<Item = (&'static str, ShippedFile)> {
    let prefix = format!("{}/", shipped::SCENES_FOLDER);
    let named = move |file: ShippedFile| {
        let name = file.path.strip_prefix(&prefix)?.strip_suffix(".toml")?;
        let is_scene = file.text.contains("\nduration_s = ") || file.text.starts_with("duration_s");
        is_scene.then_some((name, file))
    };
    shipped::files().filter_map(named)
}

fn list() -> anyhow::Result<ExitCode> {
    let scenes: Vec<_> = shipped_scenes().collect();
    let width = scenes.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    for (name, file) in scenes {
        let title = file.text.parse::<toml::Table>().ok();
        let title = title.as_ref().and_then(|table| table.get("title")?.as_str()).unwrap_or("");
        out::line(format_args!("{name:width$}  {title}"))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn show(scene: &Path) -> anyhow::Result<ExitCode> {
    match Source::read(scene, FileKind::Scene) {
        Ok(source) => {
            out::text(&source.text)?;
            Ok(ExitCode::SUCCESS)
        }
        Err(bad) => {
            out::warn(&bad);
            Ok(ExitCode::from(2))
        }
    }
}

fn copy(name: &Path, folder: &Path) -> anyhow::Result<ExitCode> {
    let Some(file) = shipped::find(name, true) else {
        let what = format!("there is no scene `{}` in this program", name.display());
        return Err(BadOption(format!("{what}; `taktil scene list` names them")).into());
    };
    let scene = match load_checked_scene(Path::new(file.path)) {
        Ok(scene) => scene,
        Err(bad) => {
            out::warn(&bad);
            return Ok(ExitCode::from(2));
        }
    };
    let mut files: Vec<ShippedFile> =
        scene.files().filter_map(|path| shipped::find(path, true)).collect();
    // The arm is named in the text of the scene or of its machine.
    let texts = [file.text, scene.machine_text()];
    files.extend(shipped::files().filter(|file| {
        let name = Path::new(file.path).file_name().and_then(|name| name.to_str());
        let is_named = name.is_some_and(|name| texts.iter().any(|text| text.contains(name)));
        file.path.ends_with(".urdf") && is_named
    }));
    // What lies there as it is here stays; what was changed is somebody's work.
    let is_other = |file: &&ShippedFile| {
        let path = folder.join(file.path);
        path.exists() && std::fs::read_to_string(path).ok().as_deref() != Some(file.text)
    };
    if let Some(other) = files.iter().find(is_other) {
        let path = folder.join(other.path);
        let what = format!("{} exists and differs; name another folder", path.display());
        return Err(BadOption(what).into());
    }
    for file in &files {
        let path = folder.join(file.path);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).with_context(|| parent.display().to_string())?;
        }
        std::fs::write(&path, file.text).with_context(|| path.display().to_string())?;
        out::line(path.display())?;
    }
    out::line(format_args!("run it: taktil run {}", folder.join(file.path).display()))?;
    Ok(ExitCode::SUCCESS)
}
