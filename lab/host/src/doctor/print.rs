//! Prints the doctor's answer as a table for people, an object for programs, and a script for
//! administrators. Of the text of a host, only numbers enter the script.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::Report;
use super::finding::{Row, Verdict};

/// Columns of the table.
const TABLE_COLUMNS: usize = 100;
/// Where the findings begin: after name, verdict and severity.
const FINDING_COLUMN: usize = 44;

/// The table, one row for each check, with the verdict in the last line.
#[must_use]
pub fn table(report: &Report) -> String {
    let mut out = String::from(match report.live {
        true => "this host, as it runs now\n\n",
        false => "a recorded tree: what has to be tried was not\n\n",
    });
    let _ = writeln!(out, "{:24}{:10}{:10}found", "check", "verdict", "severity");
    for row in &report.rows {
        let head = format!("{:24}{:10}{:10}", row.name, row.verdict.word(), row.severity.word());
        paragraph(&mut out, &head, &row.found);
        if row.verdict != Verdict::Ok {
            paragraph(&mut out, "", &format!("expected: {}", row.expectation));
        }
        if !row.remedy.is_empty() {
            paragraph(&mut out, "", &format!("remedy: {}", row.remedy));
        }
    }
    let _ = writeln!(
        out,
        "\n{} ok, {} warn, {} bad, {} unknown",
        report.count(Verdict::Ok),
        report.count(Verdict::Warn),
        report.count(Verdict::Bad),
        report.count(Verdict::Unknown)
    );
    let _ = writeln!(out, "{}", report.verdict());
    out
}

/// Words from column [`FINDING_COLUMN`] on, wrapped at [`TABLE_COLUMNS`].
fn paragraph(out: &mut String, head: &str, text: &str) {
    let mut line = format!("{head:FINDING_COLUMN$}");
    let mut used = FINDING_COLUMN;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if used > FINDING_COLUMN && used + 1 + length > TABLE_COLUMNS {
            let _ = writeln!(out, "{}", line.trim_end());
            line = " ".repeat(FINDING_COLUMN);
            used = FINDING_COLUMN;
        }
        if used > FINDING_COLUMN {
            line.push(' ');
            used += 1;
        }
        line.push_str(word);
        used += length;
    }
    let _ = writeln!(out, "{}", line.trim_end());
}

/// The report as one JSON object.
#[must_use]
pub fn to_json(report: &Report) -> Value {
    json!({
        "live": report.live,
        "exit": report.exit(),
        "verdict": report.verdict(),
        "rows": report.rows.iter().map(Row::json).collect::<Vec<Value>>(),
    })
}

/// A shell script of the remedies. Commands hold until the next boot; boot parameters come last.
#[must_use]
pub fn script(report: &Report) -> String {
    let mut out = String::from(
        "#!/bin/sh\n\
         # Remedies that `taktil doctor` proposes. Read them before you run them, as root.\n\
         # What is echoed or set holds until the next boot. One refused command stops no other.\n\
         set -u\n",
    );
    let mut parameters: Vec<&str> = Vec::new();
    let mut done: Vec<&str> = Vec::new();
    for row in report.rows.iter().filter(|row| row.verdict != Verdict::Ok) {
        if row.remedy.is_empty() {
            continue;
        }
        let _ = writeln!(out, "\n# {} ({}): {}", row.name, row.severity.word(), row.remedy);
        for command in &row.fix.commands {
            if !done.contains(&command.as_str()) {
                done.push(command);
                let _ = writeln!(out, "{command}");
            }
        }
        for parameter in &row.fix.boot {
            if !parameters.contains(&parameter.as_str()) {
                parameters.push(parameter);
            }
        }
    }
    if !parameters.is_empty() {
        let _ = write!(
            out,
            "\n# Boot parameters, for GRUB on Debian and its kin. They act after the next boot.\n\
             mkdir -p /etc/default/grub.d\n\
             cat >> /etc/default/grub.d/60-taktil.cfg <<'EOF'\n\
             GRUB_CMDLINE_LINUX=\"$GRUB_CMDLINE_LINUX {}\"\n\
             EOF\n\
             update-grub\n",
            parameters.join(" ")
        );
    }
    out
}
