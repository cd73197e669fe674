//! Sends requests to the filter and reads reference tables. Missing reference data is a failure,
//! because a golden test has to run.

use serde_json::Value;

/// Answers to a text of requests, in order.
pub(crate) fn ask_text(text: &[u8]) -> Vec<Value> {
    let mut out = Vec::new();
    taktil_lab_calc::filter(&mut &text[..], &mut out).unwrap();
    let out = String::from_utf8(out).unwrap();
    assert!(out.is_empty() || out.ends_with('\n'));
    out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Answers to requests, all of which have to succeed; the ids are the indices and have to return.
pub(crate) fn ask(requests: &[Value]) -> Vec<Value> {
    let mut text = String::new();
    for (id, request) in requests.iter().enumerate() {
        let mut request = request.clone();
        request["id"] = id.into();
        text.push_str(&format!("{request}\n"));
    }
    let answers = ask_text(text.as_bytes());
    assert_eq!(answers.len(), requests.len());
    for (id, answer) in answers.iter().enumerate() {
        assert_eq!(answer["id"], id);
        assert_eq!(answer["ok"], true, "{answer}");
    }
    answers
}

/// Numbers of a list, nested or not, in order.
pub(crate) fn flat(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(flat).collect(),
        other => vec![other.as_f64().unwrap_or_else(|| panic!("{other} is not a number"))],
    }
}

/// A reference table with named columns.
pub(crate) struct Table {
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

fn fixture(path: &str) -> String {
    let full = format!("{}/../../tests/fixtures/{path}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&full).unwrap_or_else(|error| panic!("{full}: {error}"))
}

impl Table {
    /// Reads `tests/fixtures/PATH`, a CSV file with a heading and `rows` rows.
    pub(crate) fn read(path: &str, rows: usize) -> Table {
        let text = fixture(path);
        let mut lines = text.lines();
        let split = |line: &str| line.split(',').map(|cell| cell.trim().to_owned()).collect();
        let names = split(lines.next().unwrap());
        let table = Table { names, rows: lines.map(split).collect() };
        assert_eq!(table.rows.len(), rows, "{path}");
        table
    }

    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    pub(crate) fn word(&self, row: usize, name: &str) -> &str {
        let column = self.names.iter().position(|n| n == name);
        &self.rows[row][column.unwrap_or_else(|| panic!("no column {name}"))]
    }

    pub(crate) fn number(&self, row: usize, name: &str) -> f64 {
        let word = self.word(row, name);
        word.parse().unwrap_or_else(|_| panic!("{name}: {word}"))
    }

    /// `count` numbers from the column `name` on.
    pub(crate) fn numbers(&self, row: usize, name: &str, count: usize) -> Vec<f64> {
        let start = self.names.iter().position(|n| n == name).unwrap();
        self.rows[row][start..start + count].iter().map(|word| word.parse().unwrap()).collect()
    }
}

/// A TOML file of `tests/fixtures` as a value.
pub(crate) fn toml_table(path: &str) -> toml::Table {
    fixture(path).parse().unwrap()
}

/// All pairs within `tolerance` of each other.
pub(crate) fn assert_near(got: &[f64], want: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (i, (a, b)) in got.iter().zip(want).enumerate() {
        assert!((a - b).abs() <= tolerance, "{what} [{i}]: {a} for {b}");
    }
}
