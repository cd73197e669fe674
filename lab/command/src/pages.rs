//! Manual pages and shell completions, made from the definitions of the command lines, so that they
//! say what the programs say.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use clap_complete::Shell;
use taktil_machine_console::out;

/// What is asked about manual pages.
#[derive(Clone, Debug, clap::Args)]
pub struct ManualArgs {
    /// Folder to write the pages to; it is made where it is missing
    folder: PathBuf,
}

/// What is asked about completions.
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionArgs {
    /// The shell that is to complete
    #[arg(value_enum)]
    shell: Shell,
}

/// Sections of the manual: commands of anybody, and commands of the administrator.
const SECTION_USER: &str = "1";
const SECTION_ADMINISTRATOR: &str = "8";

/// Writes a page for each program and each subcommand of `taktil`, all levels deep.
///
/// # Errors
/// The folder cannot be written.
pub fn write_manual(arguments: &ManualArgs, taktil: clap::Command) -> anyhow::Result<ExitCode> {
    let folder = &arguments.folder;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{} cannot be made: name another folder", folder.display()))?;
    write_pages(folder, taktil, SECTION_USER)?;
    for service in
        [taktil_machine_service::process::definition(), taktil_machine_service::safe::definition()]
    {
        write_pages(folder, service, SECTION_ADMINISTRATOR)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write_pages(folder: &Path, program: clap::Command, section: &str) -> anyhow::Result<()> {
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let name = program.get_name().to_owned();
    write_page(folder, program, &name, section)
}

/// Writes the page of a command, and those of its subcommands as `NAME-SUBCOMMAND`.
fn write_page(
    folder: &Path,
    command: clap::Command,
    name: &str,
    section: &str,
) -> anyhow::Result<()> {
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        let full = format!("{name}-{}", below.get_name());
        write_page(folder, below.clone(), &full, section)?;
    }
    // The manual's title has to live as long as the program; there are a few dozen of them.
    let title: &'static str = name.to_owned().leak();
    let page = clap_mangen::Man::new(command.name(title).display_name(title))
        .title(title.to_uppercase())
        .section(section)
        .source(format!("taktil {}", env!("CARGO_PKG_VERSION")))
        .manual("Taktil");
    let mut text = Vec::new();
    page.render(&mut text)?;
    let path = folder.join(format!("{name}.{section}"));
    std::fs::write(&path, text)
        .with_context(|| format!("{} cannot be written: name another folder", path.display()))
}

/// Prints what makes a shell complete `taktil`.
///
/// # Errors
/// Standard output cannot be written.
pub fn print_completions(
    arguments: &CompletionArgs,
    mut taktil: clap::Command,
) -> anyhow::Result<ExitCode> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut taktil, "taktil", &mut text);
    out::text(String::from_utf8(text)?)?;
    Ok(ExitCode::SUCCESS)
}
