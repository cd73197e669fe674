//! The table that sets laws side by side: medians over the seeds, and the differences to the first
//! law seed by seed with their intervals.

use taktil_lab_plot::axis::format_number;

use crate::chapter6::MEASURES;
use crate::statistics::{MeanInterval, median};

/// What stands where there is no value.
const NO_VALUE: &str = "\u{2013}";

/// A measure of one law, a value for each seed in the order of the seeds.
pub(crate) type SeedValues = Vec<Option<f64>>;

/// The heading of a table over these laws.
pub(crate) fn heading(laws: &[&str]) -> Vec<String> {
    let mut head = vec!["measure".to_owned()];
    head.extend(laws.iter().map(|law| format!("{law}: median (least .. most)")));
    let first = laws.first().copied().unwrap_or_default();
    let later = laws.iter().skip(1);
    head.extend(later.map(|law| format!("{law} - {first}: mean [95 %]")));
    head
}

/// The rows of a table: `values` has, for each law, a list for each measure of [`MEASURES`].
/// Measures without any value are left out.
pub(crate) fn rows(values: &[Vec<SeedValues>]) -> Vec<Vec<String>> {
    let has_value =
        |measure: usize| values.iter().any(|law| law[measure].iter().any(Option::is_some));
    let row = |measure: usize| {
        let mut row = vec![MEASURES[measure].what.to_owned()];
        row.extend(values.iter().map(|law| median_cell(&law[measure])));
        let first = values.first().map(|law| &law[measure]);
        let later = values.iter().skip(1).zip(first.into_iter().cycle());
        row.extend(later.map(|(law, first)| difference_cell(first, &law[measure])));
        row
    };
    (0..MEASURES.len()).filter(|measure| has_value(*measure)).map(row).collect()
}

/// Median, least and most as text, with the number of runs that have a value where some have none.
pub(crate) fn median_cell(values: &[Option<f64>]) -> String {
    let found: Vec<f64> = values.iter().flatten().copied().collect();
    let Some(middle) = median(&found) else { return NO_VALUE.to_owned() };
    let mut text = format_number(middle);
    let least = found.iter().copied().fold(f64::INFINITY, f64::min);
    let most = found.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if least < most {
        text += &format!(" ({} .. {})", format_number(least), format_number(most));
    }
    if found.len() < values.len() {
        text += &format!(", {} of {} runs", found.len(), values.len());
    }
    text
}

/// The mean of the differences on seeds on which both have a value. A star marks an interval
/// without zero.
pub(crate) fn difference_cell(first: &[Option<f64>], other: &[Option<f64>]) -> String {
    let pairs = first.iter().zip(other);
    let differences: Vec<f64> =
        pairs.filter_map(|(first, other)| Some((*other)? - (*first)?)).collect();
    let Some(difference) = MeanInterval::of(&differences) else { return NO_VALUE.to_owned() };
    let mut text = format_number(difference.mean);
    match difference.interval {
        Some([low, high]) => {
            text += &format!(" [{} .. {}]", format_number(low), format_number(high));
        }
        None => text += &format!(" [{} pairs]", difference.pairs),
    }
    if difference.is_significant() {
        text.push('*');
    }
    text
}

/// A table in Markdown.
pub(crate) fn markdown(head: &[String], rows: &[Vec<String>]) -> String {
    let mut out = format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len()));
    for row in rows {
        out += &format!("| {} |\n", row.join(" | "));
    }
    out
}

/// What the cells mean, for the foot of a page.
pub(crate) const LEGEND: &str = "Differences are taken seed by seed; their interval holds the mean \
    in 95 % of such experiments (bootstrap, BCa, 4000 resamples; with fewer than four seeds there \
    is none). A star marks an interval without zero.";

#[cfg(test)]
mod tests {
    use super::*;

    fn law(values: &[Option<f64>]) -> Vec<SeedValues> {
        let mut all = vec![vec![None; values.len()]; MEASURES.len()];
        all[3] = values.to_vec();
        all
    }

    #[test]
    fn laws_are_compared_on_the_same_seeds() {
        let first = law(&[Some(1.0), Some(2.0), Some(3.0), Some(4.0), None]);
        let other = law(&[Some(1.5), Some(2.5), Some(3.5), Some(4.5), Some(9.0)]);
        let rows = rows(&[first, other]);
        assert_eq!(rows.len(), 1);
        assert_eq!(rows[0][1], "2.5 (1 .. 4), 4 of 5 runs");
        // The seed that has no value for the first law is no pair.
        assert_eq!(rows[0][3], "0.5 [0.5 .. 0.5]*");
        assert_eq!(heading(&["a", "b"])[3], "b - a: mean [95 %]");
    }

    #[test]
    fn no_ratio_is_made_of_what_is_nearly_zero() {
        let (first, other) = (law(&[Some(1e-12); 4]), law(&[Some(1e-3); 4]));
        let rows = rows(&[first, other]);
        assert!(rows[0][3].starts_with("0.001"), "{:?}", rows[0]);
    }
}
