//! Reads which CPUs of this machine are online. A list that cannot be read or understood, or that
//! is empty, counts as no list.

use std::collections::BTreeSet;

/// Where the kernel lists the CPUs that are switched on, isolated ones among them.
const ONLINE_PATH: &str = "/sys/devices/system/cpu/online";

/// The CPUs that are switched on; `None` when the kernel does not say.
#[must_use]
pub fn online() -> Option<BTreeSet<usize>> {
    let list = taktil_rtcore::cpus::parse(&std::fs::read_to_string(ONLINE_PATH).ok()?);
    list.filter(|cpus| !cpus.is_empty())
}
