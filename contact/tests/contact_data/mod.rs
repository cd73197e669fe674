//! Reads the reference tables.

/// The numbers of a table, one row a line, without its heading.
pub(crate) fn rows(text: &str) -> Vec<Vec<f64>> {
    let number = |cell: &str| cell.trim().parse::<f64>().expect("a number in the table");
    let row = |line: &str| line.split(',').map(number).collect();
    let rows: Vec<Vec<f64>> = text.lines().skip(1).map(row).collect();
    assert!(!rows.is_empty(), "an empty table checks nothing");
    rows
}

/// The cells of a table as words, one row a line, without its heading.
#[allow(dead_code, reason = "tables of numbers alone do not need it")]
pub(crate) fn words(text: &str) -> Vec<Vec<String>> {
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}
