//! Edits of parameters while a scene runs. An instant that lies outside a run is an error.

use taktil_rtcore::{Invalid, Nanos, Transaction};

use super::{DURATION_MAX_S, EditFile};

/// The edits of a scene as transactions.
pub(super) fn transactions(files: &[EditFile]) -> Result<Vec<Transaction>, Invalid> {
    let one = |(index, file): (usize, &EditFile)| {
        if !(file.at_s.is_finite() && (0.0..=DURATION_MAX_S).contains(&file.at_s)) {
            return Err(Invalid::new(
                format!("edit[{index}].at_s"),
                format!("{} s is not an instant of a run", file.at_s),
                "give 0 or more seconds",
            ));
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most a day of nanoseconds")]
        let at = Nanos((file.at_s * 1e9).round() as i64);
        let set = file.set.iter().map(|(name, value)| (name.clone(), *value)).collect();
        Ok(Transaction { at, set })
    };
    files.iter().enumerate().map(one).collect()
}
