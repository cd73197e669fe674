//! Facts that several checks need: the kernel's configuration, the isolated CPUs, and the limits
//! and capabilities of a process.

use std::collections::BTreeMap;

use super::cpulist::CpuList;
use super::gunzip::gunzip;
use super::host::{Host, ReadError, ReadErrorKind};

/// Bit of the capability that allows any scheduling policy.
pub(super) const CAP_SYS_NICE: u32 = 23;
/// Bit of the capability that allows any amount of locked memory.
pub(super) const CAP_IPC_LOCK: u32 = 14;

/// A resource limit of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Limit {
    /// Unlimited.
    Unlimited,
    /// This much, in the limit's own unit.
    Value(u64),
}

/// The options with which the kernel was built.
#[derive(Clone, Debug, Default)]
pub(super) struct Config {
    options: BTreeMap<String, String>,
    /// Path of the file.
    pub(super) from: String,
}

impl Config {
    /// True when `CONFIG_<name>` is built in.
    #[must_use]
    pub(super) fn is_enabled(&self, name: &str) -> bool {
        self.options.get(name).is_some_and(|value| value == "y")
    }

    fn read(host: &Host) -> Result<Config, ReadError> {
        let packed = "proc/config.gz";
        let mut error = match host.bytes(packed) {
            Ok(bytes) => match gunzip(&bytes) {
                Ok(text) => return Config::parse(packed, &String::from_utf8_lossy(&text)),
                Err(why) => {
                    ReadError { path: packed.to_owned(), kind: ReadErrorKind::Unreadable(why) }
                }
            },
            Err(error) => error,
        };
        let Ok(release) = host.text("proc/sys/kernel/osrelease") else { return Err(error) };
        let named = |c: char| c.is_ascii_alphanumeric() || ".-_+~".contains(c);
        if !release.chars().all(named) {
            return Err(error);
        }
        for path in [format!("boot/config-{release}"), format!("lib/modules/{release}/config")] {
            match host.text(&path) {
                Ok(text) => return Config::parse(&path, &text),
                Err(other) if other.kind != ReadErrorKind::Absent => error = other,
                Err(_) => {}
            }
        }
        Err(error)
    }

    fn parse(path: &str, text: &str) -> Result<Config, ReadError> {
        let mut options = BTreeMap::new();
        for line in text.lines() {
            let option = line.trim().strip_prefix("CONFIG_").and_then(|rest| rest.split_once('='));
            if let Some((name, value)) = option {
                options.insert(name.to_owned(), value.to_owned());
            }
        }
        if options.is_empty() {
            return Err(ReadError::unintelligible(path));
        }
        Ok(Config { options, from: format!("/{path}") })
    }
}

/// Facts that more than one check uses.
#[derive(Clone, Debug)]
pub(super) struct Facts {
    /// The kernel's configuration.
    pub(super) config: Result<Config, ReadError>,
    /// CPUs that are online.
    pub(super) online: Result<CpuList, ReadError>,
    /// CPUs that the scheduler leaves alone.
    pub(super) isolated: Result<CpuList, ReadError>,
    /// CPUs of the lanes: the requested ones, otherwise the isolated ones.
    pub(super) lanes: CpuList,
    /// Limits of the process by their names in `/proc/self/limits`.
    pub(super) limits: Result<BTreeMap<String, Limit>, ReadError>,
    /// Effective capabilities.
    pub(super) capabilities: Result<u64, ReadError>,
}

impl Facts {
    /// Reads the facts; `asked` are the requested CPUs of the lanes.
    #[must_use]
    pub(super) fn read(host: &Host, asked: Option<&CpuList>) -> Facts {
        let isolated = isolated(host);
        let lanes = asked.or(isolated.as_ref().ok()).cloned().unwrap_or_default();
        Facts {
            config: Config::read(host),
            online: online(host),
            isolated,
            lanes,
            limits: limits(host),
            capabilities: capabilities(host),
        }
    }

    /// Whether the process has a capability; false when that cannot be read.
    #[must_use]
    pub(super) fn has_capability(&self, capability: u32) -> bool {
        self.capabilities.as_ref().is_ok_and(|held| held >> capability & 1 == 1)
    }

    /// A limit by its name.
    ///
    /// # Errors
    /// The error with which the limits were read.
    pub(super) fn limit(&self, name: &str) -> Result<Limit, ReadError> {
        let limits = self.limits.as_ref().map_err(Clone::clone)?;
        limits.get(name).copied().ok_or_else(|| ReadError::unintelligible(LIMITS_PATH))
    }

    /// The CPUs to check: those of the lanes, otherwise all that are online.
    #[must_use]
    pub(super) fn checked_cpus(&self) -> CpuList {
        if self.lanes.is_empty() {
            self.online.clone().unwrap_or_default()
        } else {
            self.lanes.clone()
        }
    }

    /// CPUs to propose for lanes: those of the lanes, otherwise the last of several that are
    /// online.
    #[must_use]
    pub(super) fn proposed_lane_cpus(&self) -> CpuList {
        if !self.lanes.is_empty() {
            return self.lanes.clone();
        }
        let online = self.online.clone().unwrap_or_default();
        CpuList(online.0.iter().skip(1).next_back().copied().into_iter().collect())
    }

    /// CPUs that remain for everything else.
    #[must_use]
    pub(super) fn other_cpus(&self) -> CpuList {
        self.online.clone().unwrap_or_default().without(&self.proposed_lane_cpus())
    }
}

const LIMITS_PATH: &str = "proc/self/limits";

/// Reads a file that holds a list of CPUs.
///
/// # Errors
/// A file that cannot be read or is not such a list.
pub(super) fn cpu_list(host: &Host, path: &str) -> Result<CpuList, ReadError> {
    CpuList::parse(&host.text(path)?).ok_or_else(|| ReadError::unintelligible(path))
}

/// CPUs that are online; an empty list is an error.
///
/// # Errors
/// A file that cannot be read, is not a list, or is empty.
pub(super) fn online(host: &Host) -> Result<CpuList, ReadError> {
    let path = "sys/devices/system/cpu/online";
    let list = cpu_list(host, path)?;
    if list.is_empty() { Err(ReadError::unintelligible(path)) } else { Ok(list) }
}

/// CPUs that are isolated at boot or by a partition of control groups.
fn isolated(host: &Host) -> Result<CpuList, ReadError> {
    let at_boot = cpu_list(host, "sys/devices/system/cpu/isolated");
    match (at_boot, cpu_list(host, "sys/fs/cgroup/cpuset.cpus.isolated")) {
        (Ok(mut boot), Ok(partition)) => {
            boot.0.extend(partition.0);
            Ok(boot)
        }
        (Err(_), Ok(partition)) if !partition.is_empty() => Ok(partition),
        (boot, _) => boot,
    }
}

fn limits(host: &Host) -> Result<BTreeMap<String, Limit>, ReadError> {
    let text = host.text(LIMITS_PATH)?;
    let mut out = BTreeMap::new();
    for name in ["Max locked memory", "Max realtime priority", "Max realtime timeout"] {
        let soft = text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next());
        match soft.map(|soft| (soft, soft.parse())) {
            Some(("unlimited", _)) => out.insert(name.to_owned(), Limit::Unlimited),
            Some((_, Ok(value))) => out.insert(name.to_owned(), Limit::Value(value)),
            _ => None,
        };
    }
    if out.is_empty() { Err(ReadError::unintelligible(LIMITS_PATH)) } else { Ok(out) }
}

fn capabilities(host: &Host) -> Result<u64, ReadError> {
    let path = "proc/self/status";
    let text = host.text(path)?;
    let word = text.lines().find_map(|line| line.strip_prefix("CapEff:"));
    word.and_then(|word| u64::from_str_radix(word.trim(), 16).ok())
        .ok_or_else(|| ReadError::unintelligible(path))
}
