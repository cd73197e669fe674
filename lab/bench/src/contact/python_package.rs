//! Measures the Python package ContactMechanics beside our solver: the same sphere by penetration,
//! in turns. The script asks this program through `calc`, so that both clocks run in one process
//! tree. Where Python or the package is missing, the table says so.

use std::path::Path;
use std::process::{Command, Stdio};

const SCRIPT: &str = include_str!("contact_mechanics.py");
const TITLE: &str =
    "sphere R = 10, t = 0.8, nu = 0.49, 5 N, ContactMechanics beside ours: image of 16 x 16";
const REMEDY: &str = "pip install ContactMechanics, and give its Python by --python";

/// The script's table; where there is none, one of why.
pub(super) fn table(python: &Path, taktil: &Path) -> String {
    let run = Command::new(python).arg("-c").arg(SCRIPT).arg(taktil).stdin(Stdio::null()).output();
    let why = match run {
        Ok(output) if output.status.success() => {
            return format!("{TITLE}\n{}", String::from_utf8_lossy(&output.stdout));
        }
        Ok(output) => {
            let told = String::from_utf8_lossy(&output.stderr);
            let last = told.lines().rfind(|line| !line.trim().is_empty());
            last.unwrap_or("it failed and gave no reason").replace('|', "/")
        }
        Err(error) => error.to_string(),
    };
    let name = python.display();
    format!("{TITLE}\nmethod | left out\nContactMechanics | {name}: {why}; {REMEDY}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_named_with_its_remedy() {
        let none = table(Path::new("/nonexistent/python"), Path::new("taktil"));
        assert!(none.contains("/nonexistent/python: ") && none.contains("pip install"), "{none}");
        // A program that takes any argument and fails without a word.
        let silent = table(Path::new("false"), Path::new("taktil"));
        assert!(silent.contains("false: it failed and gave no reason"), "{silent}");
        let rows = taktil_lab_plot::markdown::tables_as_json(&silent);
        assert_eq!(rows[0]["rows"][0]["method"], "ContactMechanics", "programs are told, too");
        // One that succeeds: what it says is the table.
        let said = table(Path::new("echo"), Path::new("PATH"));
        assert!(said.starts_with(TITLE) && said.trim_end().ends_with("PATH"), "{said}");
    }
}
