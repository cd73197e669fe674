//! Sets of CPUs in the kernel's notation, such as `0-3,6`.

use std::collections::BTreeSet;
use std::fmt;

use taktil_rtcore::cpus;

/// A set of CPU numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CpuList(pub BTreeSet<usize>);

impl CpuList {
    /// Parses `0-3,6`. An empty text and the kernel's `(null)` are the empty list; `None` means
    /// that the text is not a list.
    #[must_use]
    pub fn parse(text: &str) -> Option<CpuList> {
        cpus::parse(text).map(CpuList)
    }

    /// True when no CPU is in it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The CPUs of `self` that are not in `other`.
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
    fn invalid_lists_are_refused() {
        assert_eq!(CpuList::parse("3-1"), None);
    }
}
