//! Writes views as CSV tables: a column `t_s` and one column for each line. Where a line has no
//! value at a time, its cell is empty.

use std::collections::BTreeMap;

use super::chart::Line;
use super::heat::ImagePanel;
use super::views::View;

/// A view as CSV, with a row at every time at which one of its lines has a sample.
#[must_use]
pub(super) fn view_csv(view: &View) -> String {
    let lines: Vec<&Line> = view.panels.iter().flat_map(|panel| &panel.lines).collect();
    let mut rows: BTreeMap<u64, (f64, Vec<f64>)> = BTreeMap::new();
    for (column, line) in lines.iter().enumerate() {
        for (t_s, value) in line.t_s.iter().zip(&line.values) {
            let empty = || (*t_s, vec![f64::NAN; lines.len()]);
            rows.entry(order_preserving_bits(*t_s)).or_insert_with(empty).1[column] = *value;
        }
    }
    let mut out = String::from("t_s");
    for name in column_names(view) {
        out.push(',');
        out.push_str(&quoted_field(&name));
    }
    out.push('\n');
    for (t_s, values) in rows.values() {
        out.push_str(&t_s.to_string());
        for value in values {
            out.push(',');
            if value.is_finite() {
                out.push_str(&value.to_string());
            }
        }
        out.push('\n');
    }
    out
}

/// The names of the columns; a label that occurs in several panels is preceded by its panel's
/// title.
fn column_names(view: &View) -> Vec<String> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    for line in view.panels.iter().flat_map(|panel| &panel.lines) {
        *seen.entry(&line.label).or_default() += 1;
    }
    let named = |panel: &super::chart::Panel| -> Vec<String> {
        let one = |line: &Line| match seen[line.label.as_str()] {
            1 => line.label.clone(),
            _ => format!("{}: {}", panel.title, line.label),
        };
        panel.lines.iter().map(one).collect()
    };
    view.panels.iter().flat_map(named).collect()
}

/// A number's bits as an integer, ordered as the numbers are.
fn order_preserving_bits(x: f64) -> u64 {
    let bits = x.to_bits();
    if bits >> 63 == 0 { bits | (1 << 63) } else { !bits }
}

fn quoted_field(name: &str) -> String {
    if name.contains([',', '"', '\n']) {
        return format!("\"{}\"", name.replace('"', "\"\""));
    }
    name.to_owned()
}

/// Images as CSV: a column `t_s`, then the counts row by row.
#[must_use]
pub(super) fn images_csv(images: &[(f64, ImagePanel)]) -> String {
    let mut out = String::from("t_s");
    let widest = images.iter().map(|(_, image)| image.counts.len()).max().unwrap_or(0);
    let cols = images.first().map_or(1, |(_, image)| image.cols.max(1));
    for index in 0..widest {
        out.push_str(&format!(",r{}c{}", index / cols + 1, index % cols + 1));
    }
    out.push('\n');
    for (t_s, image) in images {
        out.push_str(&t_s.to_string());
        for count in &image.counts {
            out.push_str(&format!(",{count}"));
        }
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::Panel;

    #[test]
    fn times_are_merged_and_gaps_are_empty() {
        let line = |label: &str, t_s: &[f64], values: &[f64]| Line {
            label: label.into(),
            t_s: t_s.to_vec(),
            values: values.to_vec(),
            colour: 0,
            dashed: false,
        };
        let panel = |title: &str, lines| Panel { title: title.into(), lines, ..Panel::default() };
        let view = View {
            name: "x".into(),
            title: "x".into(),
            panels: vec![
                panel("fast", vec![line("a", &[0.0, 0.1, 0.2], &[1.0, f64::NAN, 0.1 + 0.2])]),
                panel("p, slow", vec![line("b", &[0.0, 0.2], &[5.0, -1e-9])]),
                panel("again", vec![line("b", &[-0.5], &[9.0])]),
            ],
        };
        let want = "t_s,a,\"p, slow: b\",again: b\n-0.5,,,9\n0,1,5,\n0.1,,,\n\
                    0.2,0.30000000000000004,-0.000000001,\n";
        assert_eq!(view_csv(&view), want);
    }
}
