//! What several checks want to know: the kernel's configuration, the CPUs set aside, limits and
//! capabilities of a process. Refuses judgement: that is the checks' affair.

use std::collections::BTreeMap;

use super::cpulist::CpuList;
use super::gunzip::gunzip;
use super::host::{Gap, Host, Why};

/// Bit of the capability that allows any scheduling policy.
pub(super) const CAP_SYS_NICE: u32 = 23;
/// Bit of the capability that allows any amount of locked memory.
pub(super) const CAP_IPC_LOCK: u32 = 14;

/// A limit of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Limit {
    /// None.
    Unlimited,
    /// This much, in the limit's own unit.
    Value(u64),
}

/// The options with which the kernel was built.
#[derive(Clone, Debug, Default)]
pub(super) struct Config {
    options: BTreeMap<String, String>,
    /// The file.
    pub(super) from: String,
}

impl Config {
    /// True when `CONFIG_<name>` is built in.
    #[must_use]
    pub(super) fn on(&self, name: &str) -> bool {
        self.options.get(name).is_some_and(|value| value == "y")
    }

    fn read(host: &Host) -> Result<Config, Gap> {
        let packed = "proc/config.gz";
        let mut gap = match host.bytes(packed) {
            Ok(bytes) => match gunzip(&bytes) {
                Ok(text) => return Config::parse(packed, &String::from_utf8_lossy(&text)),
                Err(why) => Gap { path: packed.to_owned(), why: Why::Unreadable(why) },
            },
            Err(gap) => gap,
        };
        let Ok(release) = host.text("proc/sys/kernel/osrelease") else { return Err(gap) };
        let named = |c: char| c.is_ascii_alphanumeric() || ".-_+~".contains(c);
        if !release.chars().all(named) {
            return Err(gap);
        }
        for path in [format!("boot/config-{release}"), format!("lib/modules/{release}/config")] {
            match host.text(&path) {
                Ok(text) => return Config::parse(&path, &text),
                Err(other) if other.why != Why::Absent => gap = other,
                Err(_) => {}
            }
        }
        Err(gap)
    }

    fn parse(path: &str, text: &str) -> Result<Config, Gap> {
        let mut options = BTreeMap::new();
        for line in text.lines() {
            let option = line.trim().strip_prefix("CONFIG_").and_then(|rest| rest.split_once('='));
            if let Some((name, value)) = option {
                options.insert(name.to_owned(), value.to_owned());
            }
        }
        if options.is_empty() {
            return Err(Gap::garbage(path));
        }
        Ok(Config { options, from: format!("/{path}") })
    }
}

/// Facts that more than one check uses.
#[derive(Clone, Debug)]
pub(super) struct Facts {
    /// The kernel's configuration.
    pub(super) config: Result<Config, Gap>,
    /// CPUs that run.
    pub(super) online: Result<CpuList, Gap>,
    /// CPUs that the scheduler leaves alone.
    pub(super) isolated: Result<CpuList, Gap>,
    /// CPUs of the lanes: as asked for, else the isolated ones.
    pub(super) lanes: CpuList,
    /// Limits of the process by their names in `/proc/self/limits`.
    pub(super) limits: Result<BTreeMap<String, Limit>, Gap>,
    /// Effective capabilities.
    pub(super) capabilities: Result<u64, Gap>,
}

impl Facts {
    /// Reads them; `asked` are the CPUs that the lanes are to use, where somebody said so.
    #[must_use]
    pub(super) fn gather(host: &Host, asked: Option<&CpuList>) -> Facts {
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

    /// Whether the process holds a capability; what cannot be read is not held.
    #[must_use]
    pub(super) fn may(&self, capability: u32) -> bool {
        self.capabilities.as_ref().is_ok_and(|held| held >> capability & 1 == 1)
    }

    /// A limit by its name.
    ///
    /// # Errors
    /// The gap.
    pub(super) fn limit(&self, name: &str) -> Result<Limit, Gap> {
        let limits = self.limits.as_ref().map_err(Clone::clone)?;
        limits.get(name).copied().ok_or_else(|| Gap::garbage(LIMITS))
    }

    /// The CPUs to judge: the lanes', else all that run.
    #[must_use]
    pub(super) fn judged(&self) -> CpuList {
        if self.lanes.is_empty() {
            self.online.clone().unwrap_or_default()
        } else {
            self.lanes.clone()
        }
    }

    /// CPUs to propose for lanes: the lanes', else the last of several that run.
    #[must_use]
    pub(super) fn proposed(&self) -> CpuList {
        if !self.lanes.is_empty() {
            return self.lanes.clone();
        }
        let online = self.online.clone().unwrap_or_default();
        CpuList(online.0.iter().skip(1).next_back().copied().into_iter().collect())
    }

    /// CPUs that are left for everything else.
    #[must_use]
    pub(super) fn others(&self) -> CpuList {
        self.online.clone().unwrap_or_default().without(&self.proposed())
    }
}

const LIMITS: &str = "proc/self/limits";

/// A file that holds a list of CPUs.
///
/// # Errors
/// The gap, also when the text is no such list.
pub(super) fn cpus(host: &Host, path: &str) -> Result<CpuList, Gap> {
    CpuList::parse(&host.text(path)?).ok_or_else(|| Gap::garbage(path))
}

/// CPUs that run; that there is none cannot be.
///
/// # Errors
/// The gap, also when the list is empty or none.
pub(super) fn online(host: &Host) -> Result<CpuList, Gap> {
    let path = "sys/devices/system/cpu/online";
    let list = cpus(host, path)?;
    if list.is_empty() { Err(Gap::garbage(path)) } else { Ok(list) }
}

/// Isolated at boot, or by a partition of control groups.
fn isolated(host: &Host) -> Result<CpuList, Gap> {
    let at_boot = cpus(host, "sys/devices/system/cpu/isolated");
    match (at_boot, cpus(host, "sys/fs/cgroup/cpuset.cpus.isolated")) {
        (Ok(mut boot), Ok(partition)) => {
            boot.0.extend(partition.0);
            Ok(boot)
        }
        (Err(_), Ok(partition)) if !partition.is_empty() => Ok(partition),
        (boot, _) => boot,
    }
}

fn limits(host: &Host) -> Result<BTreeMap<String, Limit>, Gap> {
    let text = host.text(LIMITS)?;
    let mut out = BTreeMap::new();
    for name in ["Max locked memory", "Max realtime priority", "Max realtime timeout"] {
        let soft = text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next());
        match soft.map(|soft| (soft, soft.parse())) {
            Some(("unlimited", _)) => out.insert(name.to_owned(), Limit::Unlimited),
            Some((_, Ok(value))) => out.insert(name.to_owned(), Limit::Value(value)),
            _ => None,
        };
    }
    if out.is_empty() { Err(Gap::garbage(LIMITS)) } else { Ok(out) }
}

fn capabilities(host: &Host) -> Result<u64, Gap> {
    let path = "proc/self/status";
    let text = host.text(path)?;
    let word = text.lines().find_map(|line| line.strip_prefix("CapEff:"));
    word.and_then(|word| u64::from_str_radix(word.trim(), 16).ok())
        .ok_or_else(|| Gap::garbage(path))
}
