//! The CPUs of this machine, as the kernel lists them. Refuses to guess: a list that cannot be read
//! or understood is no list.

use std::collections::BTreeSet;

/// Where the kernel lists the CPUs that are switched on, isolated ones among them.
const ONLINE: &str = "/sys/devices/system/cpu/online";
/// More CPUs than this are a misreading.
const CPUS_MAX: usize = 8192;

/// The CPUs that are switched on; `None` when the kernel does not say.
#[must_use]
pub fn online() -> Option<BTreeSet<usize>> {
    parse(&std::fs::read_to_string(ONLINE).ok()?)
}

/// A list of the kernel's form: `0-3,5`.
#[must_use]
pub fn parse(list: &str) -> Option<BTreeSet<usize>> {
    let mut cpus = BTreeSet::new();
    for part in list.trim().split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last) = (first.parse::<usize>().ok()?, last.parse::<usize>().ok()?);
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
        assert_eq!(parse("0\n"), Some(BTreeSet::from([0])));
        assert_eq!(parse("0-2,5,7-8\n"), Some(BTreeSet::from([0, 1, 2, 5, 7, 8])));
        for bad in ["", "\n", "a", "3-1", "1-", "-1", "0,,1", "0-99999999999", "0-9999"] {
            assert_eq!(parse(bad), None, "{bad:?}");
        }
    }

    #[test]
    fn this_machine_has_a_cpu() {
        assert!(online().is_none_or(|cpus| !cpus.is_empty()));
    }
}
