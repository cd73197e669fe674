//! Contacts that a thread has solved lately. Runs of one scene over many seeds solve each of their
//! contacts once, and so does a law whose model is that of the pad which is simulated.

use std::cell::RefCell;
use std::collections::VecDeque;

use super::Invalid;
use super::cylinder::LineContact;
use super::layer::Layer;

/// How many contacts are kept: a scene has at most two pads, a table and the models of a law.
const CONTACTS_KEPT: usize = 8;

/// What a line contact is solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Problem {
    layer: Layer,
    radius_mm: f64,
    penetration_max_mm: f64,
    has_base: bool,
}

/// What was solved, with its problem.
type Solved = VecDeque<(Problem, LineContact)>;

thread_local! {
    /// The newest first.
    static SOLVED: RefCell<Solved> = const { RefCell::new(Solved::new()) };
}

/// The contact that [`LineContact::new`] solves or, where `has_base` is false,
/// [`LineContact::without_base`]: a copy where this thread has solved it lately. Allocates.
///
/// # Errors
/// As these two.
pub fn line_contact(
    layer: &Layer,
    radius_mm: f64,
    penetration_max_mm: f64,
    has_base: bool,
) -> Result<LineContact, Invalid> {
    let problem = Problem { layer: *layer, radius_mm, penetration_max_mm, has_base };
    SOLVED.with_borrow_mut(|solved| {
        if let Some(place) = solved.iter().position(|(known, _)| *known == problem) {
            solved.make_contiguous()[..=place].rotate_right(1);
            return Ok(solved[0].1.clone());
        }
        let solve = if has_base { LineContact::new } else { LineContact::without_base };
        let contact = solve(layer, radius_mm, penetration_max_mm)?;
        solved.truncate(CONTACTS_KEPT - 1);
        solved.push_front((problem, contact.clone()));
        Ok(contact)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept() -> usize {
        SOLVED.with_borrow(VecDeque::len)
    }

    #[test]
    fn a_contact_is_solved_once_and_is_the_same() {
        let layer = Layer::new(0.8, 2.0, 0.49).unwrap();
        for has_base in [true, false] {
            let solve = if has_base { LineContact::new } else { LineContact::without_base };
            let fresh = format!("{:?}", solve(&layer, 23.0, 0.16).unwrap());
            for _ in 0..2 {
                let again = line_contact(&layer, 23.0, 0.16, has_base).unwrap();
                assert_eq!(format!("{again:?}"), fresh);
            }
        }
        assert_eq!(kept(), 2);
        // Others push the oldest out, and one that is asked for stays.
        for i in 0..CONTACTS_KEPT {
            line_contact(&layer, 5.0 + i as f64, 0.16, false).unwrap();
            line_contact(&layer, 23.0, 0.16, false).unwrap();
        }
        assert_eq!(kept(), CONTACTS_KEPT);
        assert!(SOLVED.with_borrow(|solved| solved[0].0.radius_mm == 23.0));
    }

    #[test]
    fn what_cannot_be_solved_is_refused_each_time_and_not_kept() {
        let layer = Layer::new(0.8, 2.0, 0.49).unwrap();
        for bad in [f64::NAN, -1.0, 0.9] {
            for _ in 0..2 {
                assert!(line_contact(&layer, 23.0, bad, true).is_err());
            }
        }
        assert_eq!(kept(), 0);
    }
}
