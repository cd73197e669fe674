//! Lists of CPUs as the kernel writes them: `0-3,6`. Refuses reversed ranges, numbers that no
//! machine has and everything else that is not such a list.

use std::collections::BTreeSet;
use std::fmt;

/// One more than the largest CPU number that is believed: the kernel's own upper limit on PCs.
const CPUS_MAX: usize = 8192;

/// A set of CPU numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CpuList(pub BTreeSet<usize>);

impl CpuList {
    /// Reads `0-3,6`. Nothing, and the kernel's `(null)`, are the empty list; `None` is no list.
    #[must_use]
    pub fn parse(text: &str) -> Option<CpuList> {
        let text = text.trim();
        let mut out = BTreeSet::new();
        if text.is_empty() || text == "(null)" {
            return Some(CpuList(out));
        }
        for part in text.split(',') {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let first: usize = first.trim().parse().ok()?;
            let last: usize = last.trim().parse().ok()?;
            if first > last || last >= CPUS_MAX {
                return None;
            }
            out.extend(first..=last);
        }
        Some(CpuList(out))
    }

    /// True when no CPU is in it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The CPUs of `self` that `other` lacks.
    #[must_use]
    pub fn without(&self, other: &CpuList) -> CpuList {
        CpuList(self.0.difference(&other.0).copied().collect())
    }

    /// The CPUs in both.
    #[must_use]
    pub fn common(&self, other: &CpuList) -> CpuList {
        CpuList(self.0.intersection(&other.0).copied().collect())
    }
}

impl fmt::Display for CpuList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rest = self.0.iter().copied().peekable();
        let mut comma = "";
        while let Some(first) = rest.next() {
            let mut last = first;
            while rest.next_if(|next| *next == last + 1).is_some() {
                last += 1;
            }
            match last - first {
                0 => write!(f, "{comma}{first}")?,
                1 => write!(f, "{comma}{first},{last}")?,
                _ => write!(f, "{comma}{first}-{last}")?,
            }
            comma = ",";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_read_and_write() {
        for (text, shown) in
            [("0-3,6\n", "0-3,6"), ("", ""), ("(null)", ""), ("5,4", "4,5"), ("1-1", "1")]
        {
            assert_eq!(CpuList::parse(text).unwrap().to_string(), shown, "{text}");
        }
    }

    #[test]
    fn what_is_no_list_is_refused() {
        for bad in ["3-1", "a", "1,,2", "-1", "0-99999999999", "1-8192", "0-7:2/4", "\u{0}"] {
            assert_eq!(CpuList::parse(bad), None, "{bad}");
        }
    }
}
