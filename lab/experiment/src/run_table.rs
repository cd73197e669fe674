//! The table of all runs of a command, as CSV and as JSON. A row is written as soon as its run is
//! done, so that an interruption loses none, and a command that goes on reads them again.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context, bail};
use serde_json::{Map, Value, json};

use crate::chapter6::MEASURES;
use crate::evaluation::Evaluation;

/// What a run was of, and what was measured: a number for each of [`MEASURES`], or none.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RunRow {
    pub(crate) scene: String,
    pub(crate) law: String,
    pub(crate) seed: u64,
    pub(crate) values: Vec<Option<f64>>,
}

impl RunRow {
    pub(crate) fn new(scene: &str, law: &str, seed: u64, verdict: &Evaluation) -> RunRow {
        let values = MEASURES.iter().map(|measure| (measure.of)(verdict)).collect();
        RunRow { scene: scene.to_owned(), law: law.to_owned(), seed, values }
    }

    /// The row as a line of CSV. Numbers have as many digits as it takes to read them back.
    fn csv_line(&self) -> String {
        let mut line = format!("{},{},{}", quoted(&self.scene), self.law, self.seed);
        for value in &self.values {
            line += &format!(",{}", value.map_or(String::new(), |value| value.to_string()));
        }
        line.push('\n');
        line
    }

    /// A row from its line; `None` for a line that was cut or is none.
    fn from_csv_line(line: &str) -> Option<RunRow> {
        let (scene, rest) = match line.strip_prefix('"') {
            Some(quoted) => {
                let (scene, rest) = quoted.split_once("\",")?;
                (scene.replace("\"\"", "\""), rest)
            }
            None => line.split_once(',').map(|(scene, rest)| (scene.to_owned(), rest))?,
        };
        let mut cells = rest.split(',');
        let (law, seed) = (cells.next()?.to_owned(), cells.next()?.parse().ok()?);
        let value = |cell: &str| match cell {
            "" => Some(None),
            text => text.parse().ok().map(Some),
        };
        let values: Vec<Option<f64>> = cells.map(value).collect::<Option<_>>()?;
        (values.len() == MEASURES.len()).then_some(RunRow { scene, law, seed, values })
    }

    fn json(&self) -> Value {
        let number = |(measure, value): (&crate::chapter6::Measure, &Option<f64>)| {
            (measure.what.to_owned(), json!(value))
        };
        let measured: Map<String, Value> = MEASURES.iter().zip(&self.values).map(number).collect();
        json!({ "scene": self.scene, "law": self.law, "seed": self.seed, "measured": measured })
    }
}

/// A cell of CSV, in quotation marks where it has to be.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\"").replace('\n', " "))
    } else {
        text.to_owned()
    }
}

fn heading() -> String {
    let names = MEASURES.map(|measure| format!("\"{}\"", measure.what)).join(",");
    format!("scene,law,seed,{names}\n")
}

/// A table that is being written.
pub(crate) struct RunTable(File);

impl RunTable {
    /// Begins a table; what the file held is gone.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(crate) fn create(path: &Path) -> anyhow::Result<RunTable> {
        let shown = path.display();
        let mut file = File::create(path).with_context(|| format!("cannot write {shown}"))?;
        file.write_all(heading().as_bytes()).with_context(|| format!("cannot write {shown}"))?;
        Ok(RunTable(file))
    }

    /// Goes on with a table, and hands out its whole rows. What was cut at its end is written over.
    ///
    /// # Errors
    /// A file that cannot be read or written, or one with other columns.
    pub(crate) fn resume(path: &Path) -> anyhow::Result<(RunTable, Vec<RunRow>)> {
        let shown = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {shown}"))?;
        let Some(lines) = text.strip_prefix(&heading()) else {
            bail!(
                "{shown} has other columns than this program writes: remove it, or name another \
                 folder"
            );
        };
        let mut whole = heading().len();
        let mut rows = Vec::new();
        for line in lines.split_inclusive('\n') {
            let row = line.strip_suffix('\n').and_then(RunRow::from_csv_line);
            let Some(row) = row else { break };
            rows.push(row);
            whole += line.len();
        }
        let file = OpenOptions::new().append(true).open(path);
        let file = file.with_context(|| format!("cannot write {shown}"))?;
        file.set_len(whole as u64).with_context(|| format!("cannot write {shown}"))?;
        Ok((RunTable(file), rows))
    }

    /// Appends a row by one write, so that rows of several threads do not mix.
    ///
    /// # Errors
    /// A write that fails.
    pub(crate) fn append(&self, row: &RunRow) -> anyhow::Result<()> {
        (&self.0).write_all(row.csv_line().as_bytes()).context("cannot write the table of runs")
    }
}

/// Writes rows as JSON: what was run, and each run.
///
/// # Errors
/// A file that cannot be written.
pub(crate) fn write_json(path: &Path, about: Value, rows: &[RunRow]) -> anyhow::Result<()> {
    let runs: Vec<Value> = rows.iter().map(RunRow::json).collect();
    let text = serde_json::to_string_pretty(&json!({ "about": about, "runs": runs }))?;
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scene: &str, seed: u64) -> RunRow {
        let mut values = vec![None; MEASURES.len()];
        (values[0], values[3]) = (Some(1.0 / 3.0), Some(-0.0));
        RunRow { scene: scene.to_owned(), law: "model".to_owned(), seed, values }
    }

    #[test]
    fn rows_are_read_back_bit_for_bit() {
        for scene in ["roll-pin", "a, b", "a \"b\" c"] {
            let row = row(scene, 7);
            assert_eq!(RunRow::from_csv_line(row.csv_line().trim_end()), Some(row));
        }
        assert_eq!(RunRow::from_csv_line("roll-pin,model,7,0.3"), None);
        assert_eq!(RunRow::from_csv_line(""), None);
    }

    #[test]
    fn a_table_that_was_cut_goes_on_after_its_last_whole_row() {
        let name = format!("taktil-run-table-{}.csv", std::process::id());
        let path = std::env::temp_dir().join(name);
        let table = RunTable::create(&path).unwrap();
        (1..=3).for_each(|seed| table.append(&row("roll", seed)).unwrap());
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 5]).unwrap();
        let (table, rows) = RunTable::resume(&path).unwrap();
        assert_eq!(rows, [row("roll", 1), row("roll", 2)]);
        table.append(&row("roll", 3)).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole);
        std::fs::write(&path, "scene,law\n").unwrap();
        assert!(RunTable::resume(&path).is_err());
        std::fs::remove_file(&path).unwrap();
    }
}
