//! Reads which CPUs of this host are online. A list that cannot be read or parsed, or that is
//! empty, counts as unknown.

use std::collections::BTreeSet;

/// File in which the kernel lists the online CPUs, including isolated ones.
const ONLINE_PATH: &str = "/sys/devices/system/cpu/online";

/// The online CPUs; `None` when they are unknown.
#[must_use]
pub fn online() -> Option<BTreeSet<usize>> {
    let list = taktil_rtcore::cpus::parse(&std::fs::read_to_string(ONLINE_PATH).ok()?);
    list.filter(|cpus| !cpus.is_empty())
}
