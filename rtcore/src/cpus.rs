//! Lists of CPUs as the kernel writes them: `0-3,6`. A reversed range, a number that no machine
//! has, and everything else is not such a list.

use std::collections::BTreeSet;

/// One more than the largest CPU number that is believed: the kernel's own upper limit on PCs.
const CPUS_MAX: usize = 8192;

/// Parses a list such as `0-3,6`. An empty text and the kernel's `(null)` are the empty list;
/// `None` says that the text is no list.
#[must_use]
pub fn parse(text: &str) -> Option<BTreeSet<usize>> {
    let text = text.trim();
    let mut cpus = BTreeSet::new();
    if text.is_empty() || text == "(null)" {
        return Some(cpus);
    }
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last) = (first.trim().parse::<usize>(), last.trim().parse::<usize>());
        let (first, last) = (first.ok()?, last.ok()?);
        if first > last || last >= CPUS_MAX {
            return None;
        }
        cpus.extend(first..=last);
    }
    Some(cpus)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_the_kernel_writes_them() {
        for (text, cpus) in [
            ("0\n", &[0][..]),
            ("0-2,5,7-8\n", &[0, 1, 2, 5, 7, 8]),
            ("5,4", &[4, 5]),
            ("1-1", &[1]),
            ("\n", &[]),
            ("(null)", &[]),
        ] {
            assert_eq!(parse(text), Some(cpus.iter().copied().collect()), "{text:?}");
        }
    }

    #[test]
    fn invalid_lists_are_refused() {
        for bad in
            ["3-1", "a", "1-", "-1", "1,,2", ",", "0-99999999999", "1-8192", "0-7:2/4", "\u{0}"]
        {
            assert_eq!(parse(bad), None, "{bad:?}");
        }
    }
}
