//! One hostile input: the files that hold it and the command that reads it.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::content::{Content, Verdict, judge, remove};
use crate::process::{Folder, TAKTIL};

/// Processor time of one process (s). An optimised program gets what people would wait for; one
/// that is built for tests, on a machine that does other things, ten times that.
const PROCESSOR_TIME_MAX_S: u32 = if cfg!(debug_assertions) { 20 } else { 2 };
/// Address space of one process (KiB): a number of a file that is taken for a size ends here.
const ADDRESS_SPACE_MAX_KIB: u32 = 6_000_000;
/// Time after which a process waits for something that does not come (s): no measure, on a machine
/// that does other things.
const WAITING_TIME_MAX_S: u32 = 120;

/// One input.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    /// What is hostile in it.
    pub(crate) name: String,
    /// The arguments; they name the files.
    pub(crate) arguments: Vec<String>,
    pub(crate) files: Vec<(String, Content)>,
    pub(crate) verdict: Verdict,
}

impl Case {
    /// An input in a single file, which is the argument `FILE`.
    pub(crate) fn in_file(
        name: impl Into<String>,
        arguments: &[&str],
        file: &str,
        content: Content,
        verdict: Verdict,
    ) -> Case {
        let arguments = arguments.iter().map(|word| word.replace("FILE", file)).collect();
        Case { name: name.into(), arguments, files: vec![(file.to_owned(), content)], verdict }
    }

    /// Runs the program over the input; what is wrong with how it took it, in words.
    pub(crate) fn complaint(&self, folder: &Folder) -> Option<String> {
        for (name, content) in &self.files {
            content.write(&folder.join(name));
        }
        let output = run(folder.path(), &self.arguments);
        for (name, _) in &self.files {
            remove(&folder.join(name));
        }
        let found = judge(&output, self.verdict)?;
        let said = String::from_utf8_lossy(&output.stderr);
        let head: String = said.chars().take(400).collect();
        let words = self.arguments.join(" ");
        Some(format!("{}: taktil {words}: {found}\n{head}", self.name))
    }
}

/// Runs the program; the kernel ends it when it takes too much time or memory, and `timeout` when
/// it waits for something that does not come.
fn run(folder: &Path, arguments: &[String]) -> Output {
    let limits = format!(
        "ulimit -t {PROCESSOR_TIME_MAX_S}; ulimit -v {ADDRESS_SPACE_MAX_KIB}; \
         exec timeout -k 1 {WAITING_TIME_MAX_S} \"$0\" \"$@\""
    );
    let mut command = Command::new("sh");
    command.args(["-c", &limits, TAKTIL]).args(arguments);
    command.current_dir(folder).stdin(Stdio::null()).output().unwrap()
}
