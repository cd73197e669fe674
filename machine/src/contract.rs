//! The contract with the kernel in a configuration: one word for all items, or a table of items.

use core::fmt;

use serde::de::{Error, MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer};
use taktil_rtcore::contract::{Demands, Item, Weight};
use taktil_rtcore::explain::{Explain, Key};
use taktil_rtcore::live::Contract;

/// `contract = "hard"`, `contract = "soft"`, or `[contract]` with some items.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ContractConfig(Contract);

impl ContractConfig {
    /// Priority, CPU, memory and PREEMPT_RT are required: for boards.
    pub const HARD: ContractConfig = ContractConfig(Contract::Hard);
    /// Every item is only reported: for a simulated robot.
    pub const SOFT: ContractConfig = ContractConfig(Contract::Soft);

    /// The contract in the executor's form.
    #[must_use]
    pub fn contract(self) -> Contract {
        self.0
    }
}

impl Explain for ContractConfig {
    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        Items::list(path, about, range, keys);
    }
}

/// The words that name a whole contract.
pub const CONTRACT_NAMES: [&str; 2] = ["hard", "soft"];

taktil_rtcore::explained! {
    /// What missing an item means.
    #[derive(Clone, Copy, Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum WeightName {
        /// The run is refused before any output is armed.
        Hard,
        /// It is reported.
        Soft,
        /// Nothing is said.
        None,
    }
}

impl WeightName {
    fn weight(self) -> Weight {
        match self {
            WeightName::Hard => Weight::Hard,
            WeightName::Soft => Weight::Soft,
            WeightName::None => Weight::None,
        }
    }
}

taktil_rtcore::explained! {
    /// The table; what is absent keeps a board's weight.
    #[derive(Clone, Copy, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Items {
        /// Every lane's thread has the `SCHED_FIFO` priority, or the reservation, that it asked
        /// for. Default `hard`.
        fifo: Option<WeightName>,
        /// Every lane that names a CPU runs there and nowhere else. Default `hard`.
        cpu: Option<WeightName>,
        /// All memory is locked. Default `hard`.
        memory: Option<WeightName>,
        /// The kernel is built with PREEMPT_RT. Default `hard`.
        preempt_rt: Option<WeightName>,
        /// Real-time threads are not throttled. Default `soft`.
        throttling: Option<WeightName>,
        /// No limit on processor time without a wait (RLIMIT_RTTIME). Default `soft`.
        rttime: Option<WeightName>,
        /// The control group has a real-time budget, where groups have such a thing. Default
        /// `soft`.
        cgroup: Option<WeightName>,
        /// Every CPU with frequency scaling runs the governor `performance`. Default `soft`.
        governor: Option<WeightName>,
        /// Every CPU that a lane may use is isolated. Default `soft`.
        isolation: Option<WeightName>,
        /// The clock source can be read without leaving the processor. Default `soft`.
        clocksource: Option<WeightName>,
        /// `/dev/cpu_dma_latency` is held at 0. Default `soft`.
        dma_latency: Option<WeightName>,
    }
}

impl Items {
    fn demands(&self) -> Demands {
        let named = |item| match item {
            Item::Fifo => self.fifo,
            Item::Cpu => self.cpu,
            Item::Memory => self.memory,
            Item::PreemptRt => self.preempt_rt,
            Item::Throttling => self.throttling,
            Item::Rttime => self.rttime,
            Item::Cgroup => self.cgroup,
            Item::Governor => self.governor,
            Item::Isolation => self.isolation,
            Item::Clocksource => self.clocksource,
            Item::DmaLatency => self.dma_latency,
        };
        Item::ALL.into_iter().fold(Demands::BOARD, |demands, item| {
            named(item).map_or(demands, |name| demands.with(item, name.weight()))
        })
    }
}

/// Reads a word or a table. It is written by hand so that an error names the word or the key.
struct ContractVisitor;

impl<'de> Visitor<'de> for ContractVisitor {
    type Value = ContractConfig;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("`hard`, `soft` or a table of items")
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<ContractConfig, E> {
        match word {
            "hard" => Ok(ContractConfig::HARD),
            "soft" => Ok(ContractConfig::SOFT),
            other => Err(E::unknown_variant(other, &CONTRACT_NAMES)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<ContractConfig, A::Error> {
        let items = Items::deserialize(MapAccessDeserializer::new(table))?;
        Ok(ContractConfig(Contract::Items(items.demands())))
    }
}

impl<'de> Deserialize<'de> for ContractConfig {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<ContractConfig, D::Error> {
        from.deserialize_any(ContractVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct File {
        contract: ContractConfig,
    }

    fn read(text: &str) -> Result<Contract, String> {
        let file: Result<File, _> = toml::from_str(text);
        file.map(|file| file.contract.contract()).map_err(|error| error.to_string())
    }

    #[test]
    fn one_word_or_item_by_item() {
        assert_eq!(read("contract = \"hard\""), Ok(Contract::Hard));
        assert_eq!(read("contract = \"soft\""), Ok(Contract::Soft));
        let mut text = "[contract]\n".to_owned();
        for item in Item::ALL {
            text += &format!("{} = \"none\"\n", item.name());
        }
        let all = read(&text).unwrap().demands();
        assert!(Item::ALL.iter().all(|item| all.of(*item) == Weight::None));
        let some = read("[contract]\npreempt_rt = \"soft\"\ncpu = \"soft\"").unwrap().demands();
        assert_eq!(some.of(Item::PreemptRt), Weight::Soft);
        assert_eq!(some.of(Item::Cpu), Weight::Soft);
        assert_eq!(some.of(Item::Fifo), Weight::Hard, "a board's weight where nothing is said");
        assert_eq!(some.of(Item::Governor), Weight::Soft);
        let hard = read("contract = \"hard\"").unwrap().demands();
        assert_eq!(hard.of(Item::PreemptRt), Weight::Hard);
    }

    #[test]
    fn invalid_contracts_are_rejected_by_name() {
        for (text, says) in [
            ("contract = \"firm\"", "unknown variant `firm`"),
            ("contract = 1", "`hard`, `soft` or a table"),
            ("contract = []", "`hard`, `soft` or a table"),
            ("[contract]\nfifi = \"hard\"", "unknown field `fifi`"),
            ("[contract]\nfifo = \"firm\"", "unknown variant `firm`"),
            ("[contract]\nfifo = true", "fifo"),
        ] {
            let found = read(text).unwrap_err();
            assert!(found.contains(says), "not `{says}` in {found}");
        }
    }
}
