//! Reads the comma-separated reference files by column name. A missing column fails the test.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::rc::Rc;
use taktil_mechanics::{Joints, Matrix6, Pose};

/// Text of one file of the fixtures.
pub(crate) fn text(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// A parsed TOML file of the fixtures.
pub(crate) fn toml(name: &str) -> toml::Table {
    text(name).parse().unwrap()
}

/// A list of numbers in a TOML table.
pub(crate) fn list(table: &toml::Table, key: &str) -> Vec<f64> {
    table[key].as_array().unwrap().iter().map(number).collect()
}

/// Six numbers in a TOML table.
pub(crate) fn joints(table: &toml::Table, key: &str) -> Joints {
    Joints::from_iterator(list(table, key))
}

/// A number of TOML, whole or not.
pub(crate) fn number(value: &toml::Value) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "small numbers written without a point")]
    value.as_float().unwrap_or_else(|| value.as_integer().unwrap() as f64)
}

/// One row of a file.
pub(crate) struct Row {
    columns: Rc<BTreeMap<String, usize>>,
    fields: Vec<String>,
}

/// All rows of a file.
pub(crate) fn rows(name: &str) -> Vec<Row> {
    let text = text(name);
    let mut lines = text.lines();
    let columns: BTreeMap<String, usize> =
        lines.next().unwrap().split(',').enumerate().map(|(i, c)| (c.to_owned(), i)).collect();
    let columns = Rc::new(columns);
    lines
        .map(|line| {
            let fields: Vec<String> = line.split(',').map(str::to_owned).collect();
            assert_eq!(fields.len(), columns.len(), "{name}: {line}");
            Row { columns: Rc::clone(&columns), fields }
        })
        .collect()
}

impl Row {
    pub(crate) fn word(&self, column: &str) -> &str {
        let Some(index) = self.columns.get(column) else { panic!("no column {column}") };
        &self.fields[*index]
    }

    pub(crate) fn num(&self, column: &str) -> f64 {
        self.word(column).parse().unwrap()
    }

    /// Columns `name1` to `name6`.
    pub(crate) fn joints(&self, name: &str) -> Joints {
        Joints::from_fn(|i, _| self.num(&format!("{name}{}", i + 1)))
    }

    /// Columns r11..r33 and px, py, pz.
    pub(crate) fn pose(&self) -> Pose {
        let r = core::array::from_fn(|i| self.num(&format!("r{}{}", i / 3 + 1, i % 3 + 1)));
        Pose::from_rows(&r, &[self.num("px"), self.num("py"), self.num("pz")])
    }

    /// Columns j11..j66.
    pub(crate) fn matrix(&self) -> Matrix6 {
        Matrix6::from_fn(|r, c| self.num(&format!("j{}{}", r + 1, c + 1)))
    }
}
