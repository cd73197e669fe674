//! Converts tables in Markdown to JSON, so that people and programs read the same results. A cell
//! that is not a finite number stays text.

use serde_json::{Map, Value, json};

/// Every table of a text: its rows as objects with the column names as keys, and the line of text
/// above the table as its title.
#[must_use]
pub fn tables_as_json(text: &str) -> Value {
    let mut tables = Vec::new();
    let (mut title, mut names): (&str, Vec<&str>) = ("", Vec::new());
    let mut rows: Vec<Value> = Vec::new();
    let mut close = |title: &str, rows: &mut Vec<Value>| {
        if !rows.is_empty() {
            tables.push(json!({ "title": title, "rows": std::mem::take(rows) }));
        }
    };
    for line in text.lines().map(str::trim) {
        if !line.contains(" | ") && !line.starts_with("|--") {
            close(title, &mut rows);
            names.clear();
            if !line.is_empty() {
                title = line.trim_start_matches('#').trim();
            }
            continue;
        }
        let cells = || line.trim_matches('|').split('|').map(str::trim);
        if names.is_empty() {
            names = cells().collect();
        } else if !line.starts_with("|--") {
            let row = names
                .iter()
                .zip(cells())
                .map(|(name, cell)| ((*name).to_owned(), cell_value(cell)));
            rows.push(Value::Object(row.collect::<Map<_, _>>()));
        }
    }
    close(title, &mut rows);
    Value::Array(tables)
}

fn cell_value(cell: &str) -> Value {
    let number = cell.parse::<f64>().ok().filter(|number| number.is_finite());
    number.map_or_else(|| Value::from(cell), Value::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_objects_by_column_and_numbers_are_numbers() {
        let text = "## Fast\n\n| who | us | error |\n|---|---|---|\n| a | 2.5 | 1.0e-9 |\n\
                    | b | - | NaN |\n\nThen\nx | y\n1 | 2\n";
        let tables = tables_as_json(text);
        assert_eq!(tables[0]["title"], "Fast");
        assert_eq!(tables[0]["rows"][0], json!({ "who": "a", "us": 2.5, "error": 1e-9 }));
        assert_eq!(tables[0]["rows"][1], json!({ "who": "b", "us": "-", "error": "NaN" }));
        assert_eq!(tables[1], json!({ "title": "Then", "rows": [{ "x": 1.0, "y": 2.0 }] }));
        assert_eq!(tables_as_json("no table\n\n"), json!([]));
    }
}
