//! Measures the Python package ContactMechanics beside our solver: the same sphere by penetration,
//! in turns. The script calls this program through `calc`, so that both clocks run in one process
//! tree. Where Python or the package is missing, the table says so.

use std::path::Path;
use std::process::{Command, Stdio};

const PYTHON_SCRIPT: &str = include_str!("contact_mechanics.py");
const TABLE_TITLE: &str =
    "sphere R = 10, t = 0.8, nu = 0.49, 5 N, ContactMechanics beside ours: image of 16 x 16";
const REMEDY: &str = "pip install ContactMechanics, and give its Python by --python";

/// The script's table; where there is none, a table with the reason.
pub(super) fn table(python: &Path, taktil: &Path) -> String {
    let run =
        Command::new(python).arg("-c").arg(PYTHON_SCRIPT).arg(taktil).stdin(Stdio::null()).output();
    let why = match run {
        Ok(output) if output.status.success() => {
            return format!("{TABLE_TITLE}\n{}", String::from_utf8_lossy(&output.stdout));
        }
        Ok(output) => {
            let told = String::from_utf8_lossy(&output.stderr);
            let last = told.lines().rfind(|line| !line.trim().is_empty());
            last.unwrap_or("it failed and gave no reason").replace('|', "/")
        }
        Err(error) => error.to_string(),
    };
    let name = python.display();
    format!("{TABLE_TITLE}\nmethod | left out\nContactMechanics | {name}: {why}; {REMEDY}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_programs_are_named_with_their_remedy() {
        let none = table(Path::new("/nonexistent/python"), Path::new("taktil"));
        assert!(none.contains("/nonexistent/python: ") && none.contains("pip install"), "{none}");
        // A program that accepts any argument and fails without output.
        let silent = table(Path::new("false"), Path::new("taktil"));
        assert!(silent.contains("false: it failed and gave no reason"), "{silent}");
        let rows = taktil_lab_plot::markdown::tables_as_json(&silent);
        assert_eq!(rows[0]["rows"][0]["method"], "ContactMechanics", "programs are told, too");
        // A program that succeeds: its output is the table.
        let said = table(Path::new("echo"), Path::new("PATH"));
        assert!(said.starts_with(TABLE_TITLE) && said.trim_end().ends_with("PATH"), "{said}");
    }
}
