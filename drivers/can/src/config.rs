//! The configuration of drives on a CAN bus as a machine file states it.

use std::ops::RangeInclusive;

use serde::Deserialize;
use taktil_drivers_cia402::Mode;
use taktil_hal::{CHANNELS, DriveLoop, Invalid, Nanos};

taktil_hal::explained! {
    /// Drives on a CAN bus. Only `interface` and `nodes` have no default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// The kernel's interface, such as `can0`, whose bit rate `ip link` sets; or the path of a
        /// socket of Unix behind which another process has a bus.
        pub interface: String,
        /// What the drives speak. Default `canopen`.
        pub protocol: Protocol,
        /// What the drives follow. A half for drives commands them in every mode; codes of a half
        /// for converters are torques, and there is none in the other modes. An ODrive follows
        /// torques only. Default `torque`.
        pub mode: DriveMode,
        /// The drives: joint n is at the n-th of them.
        pub nodes: Vec<NodeConfig>,
        /// The greatest torque that a code may ask for: in thousandths of the rated torque for
        /// `canopen`, in mNm for the others. A code is one of them. Default 1000.
        pub torque_max: i32 [1.0, 32767.0],
        /// The greatest velocity that may be asked for, of either sign (counts/s); needed for the
        /// mode `velocity`.
        pub velocity_max_counts_s: Option<u32> [1.0, 2147483647.0],
        /// The greatest step of a target from one cycle to the next in the mode `position`
        /// (counts). Default 1000.
        pub step_max_counts: u32 [1.0, 2147483647.0],
        /// Period of the lane in which the halves are used (us). Default 2500.
        pub period_us: u32 [100.0, 100000.0],
        /// Longest wait for the answers of a cycle, as a part of `period_us`. Default 0.6.
        pub wait_share: f64 [0.01, 0.9],
        /// A drive that has not answered for longer than this is lost (ms). Default 50.
        pub lost_ms: u32 [10.0, 10000.0],
        /// After half this time without a sign of life a drive switches its torque off by itself
        /// (ms). Default 100.
        pub silence_ms: u32 [10.0, 10000.0],
        /// A drive that has been wanted for longer than this and is not enabled takes
        /// `drive_power` away (ms). Default 1000.
        pub enable_ms: u32 [1.0, 10000.0],
        /// How long the opening waits for an answer of a drive (ms). Default 500.
        pub open_wait_ms: u32 [1.0, 10000.0],
        /// Number of this host among the nodes; moteus's own tools have 0. Default 127.
        pub host_id: u8 [0.0, 127.0],
        /// Bit of object 60FE:01 of the first drive that lifts the brakes; leave it out for drives
        /// that do so by themselves. For `canopen`. Default: none.
        pub brake_bit: Option<u8> [0.0, 31.0],
        /// Whether a target waits for bit 12 of the statusword, by which a drive says that it
        /// follows. For `canopen`. Default true.
        pub follow_bit: bool,
    }
}

taktil_hal::explained! {
    /// What drives speak.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Protocol {
        /// CANopen (CiA 301) with the drive profile CiA 402, in cyclic synchronous torque mode.
        #[default]
        Canopen,
        /// The registers of mjbots moteus, over CAN FD.
        Moteus,
        /// CANSimple of ODrive.
        Odrive,
    }
}

taktil_hal::explained! {
    /// What drives follow.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum DriveMode {
        /// Torques.
        #[default]
        Torque,
        /// Velocities.
        Velocity,
        /// Positions, on the scale of the encoders.
        Position,
    }
}

impl DriveMode {
    /// The cyclic mode of CiA 402.
    pub(crate) const fn cyclic(self) -> Mode {
        Mode::cyclic(self.control_loop())
    }

    /// The loop that the drives close.
    pub(crate) const fn control_loop(self) -> DriveLoop {
        match self {
            DriveMode::Torque => DriveLoop::Torque,
            DriveMode::Velocity => DriveLoop::Velocity,
            DriveMode::Position => DriveLoop::Position,
        }
    }
}

taktil_hal::explained! {
    /// A drive.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct NodeConfig {
        /// Its number on the bus.
        pub id: u8 [0.0, 127.0],
        /// The rated torque that the drive has to have (mNm), because the torque limits of the arm
        /// are computed from it; 0 for whatever it has. For `canopen`. Default 0.
        pub rated_torque_mnm: u32,
        /// Counts of a turn of the motor. For moteus and ODrive, which measure turns. Default
        /// 65536.
        pub counts_per_turn: u32 [1.0, 16777216.0],
    }
}

impl Default for NodeConfig {
    fn default() -> NodeConfig {
        NodeConfig { id: 0, rated_torque_mnm: 0, counts_per_turn: 65_536 }
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            interface: String::new(),
            protocol: Protocol::default(),
            mode: DriveMode::default(),
            nodes: Vec::new(),
            torque_max: 1_000,
            velocity_max_counts_s: None,
            step_max_counts: 1_000,
            period_us: 2_500,
            wait_share: 0.6,
            lost_ms: 50,
            silence_ms: 100,
            enable_ms: 1_000,
            open_wait_ms: 500,
            host_id: 127,
            brake_bit: None,
            follow_bit: true,
        }
    }
}

/// Times in milliseconds that the config takes.
const TIMES_MS: RangeInclusive<u32> = 10..=10_000;

impl Config {
    /// Checks every field against the bounds that it states.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.interface.is_empty() {
            let remedy = "name an interface such as can0, or the path of a socket";
            return Err(Invalid::new("interface", "is missing", remedy));
        }
        if self.nodes.is_empty() || self.nodes.len() > CHANNELS {
            let what = format!("{} drives are configured", self.nodes.len());
            return Err(Invalid::new("nodes", what, format!("give 1 to {CHANNELS}")));
        }
        for (index, node) in self.nodes.iter().enumerate() {
            self.check_node(index, node)?;
        }
        within("torque_max", self.torque_max, 1..=32_767)?;
        self.check_mode()?;
        within("period_us", self.period_us, 100..=100_000)?;
        within("wait_share", self.wait_share, 0.01..=0.9)?;
        within("lost_ms", self.lost_ms, TIMES_MS)?;
        within("silence_ms", self.silence_ms, TIMES_MS)?;
        within("enable_ms", self.enable_ms, 1..=10_000)?;
        within("open_wait_ms", self.open_wait_ms, 1..=10_000)?;
        within("host_id", self.host_id, 0..=127)?;
        if self.protocol == Protocol::Canopen && self.host_id == 0 {
            let what = "0 stands for all nodes";
            return Err(Invalid::new("host_id", what, "give 1 to 127, and to no drive"));
        }
        if let Some(bit) = self.brake_bit {
            within("brake_bit", bit, 0..=31)?;
            if self.protocol != Protocol::Canopen {
                let what = "only drives of CANopen have object 60FE";
                return Err(Invalid::new("brake_bit", what, "leave it out"));
            }
        }
        Ok(())
    }

    fn check_mode(&self) -> Result<(), Invalid> {
        let most = i32::MAX.cast_unsigned();
        within("step_max_counts", self.step_max_counts, 1..=most)?;
        if let Some(velocity_max) = self.velocity_max_counts_s {
            within("velocity_max_counts_s", velocity_max, 1..=most)?;
        } else if self.mode == DriveMode::Velocity {
            let remedy = "give the highest velocity that may be asked for";
            return Err(Invalid::new("velocity_max_counts_s", "nothing bounds this mode", remedy));
        }
        if self.mode != DriveMode::Torque && self.protocol == Protocol::Odrive {
            let what = "an ODrive follows torques only here";
            return Err(Invalid::new("mode", what, "leave it out"));
        }
        Ok(())
    }

    /// Lowest and highest target of a half for drives.
    pub(crate) fn target_range(&self) -> (i32, i32) {
        match self.mode {
            DriveMode::Torque => (-self.torque_max, self.torque_max),
            DriveMode::Velocity => {
                let most = self.velocity_max_counts_s.unwrap_or(1);
                let most = i32::try_from(most).unwrap_or(i32::MAX);
                (-most, most)
            }
            // Where a drive may be led is bounded by its steps, not by its counter.
            DriveMode::Position => (i32::MIN, i32::MAX),
        }
    }

    fn check_node(&self, index: usize, node: &NodeConfig) -> Result<(), Invalid> {
        let place = format!("nodes[{index}]");
        let (low, high) = match self.protocol {
            Protocol::Canopen | Protocol::Moteus => (1, 127),
            Protocol::Odrive => (0, 63),
        };
        within(&format!("{place}.id"), node.id, low..=high)?;
        within(&format!("{place}.counts_per_turn"), node.counts_per_turn, 1..=16_777_216)?;
        let is_other = |other: &NodeConfig| other.id == node.id;
        let is_host = self.protocol != Protocol::Odrive && node.id == self.host_id;
        if is_host || self.nodes[..index].iter().any(is_other) {
            let what = format!("{} is the number of another node", node.id);
            let remedy = "give each drive and `host_id` a number of its own";
            return Err(Invalid::new(format!("{place}.id"), what, remedy));
        }
        Ok(())
    }

    /// Most frames that a cycle hands over: a question, a torque and a control frame for each
    /// drive, a SYNC and two heartbeats, one of each output half.
    pub(crate) fn cycle_frames(&self) -> usize {
        let for_each = if self.protocol == Protocol::Canopen { 2 } else { 3 };
        for_each * self.nodes.len() + 3
    }

    /// Longest wait for the answers of a cycle.
    pub(crate) fn wait(&self) -> Nanos {
        Nanos((f64::from(self.period_us) * 1e3 * self.wait_share) as i64)
    }

    /// Half the longest silence: what the drives are told.
    pub(crate) fn watchdog_ms(&self) -> u32 {
        self.silence_ms / 2
    }
}

fn within<T>(place: &str, value: T, range: RangeInclusive<T>) -> Result<(), Invalid>
where
    T: PartialOrd + std::fmt::Display,
{
    if range.contains(&value) {
        return Ok(());
    }
    let what = format!("{value} is out of bounds");
    Err(Invalid::new(place, what, format!("give {} to {}", range.start(), range.end())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Config {
        let nodes = vec![NodeConfig { id: 1, ..NodeConfig::default() }];
        Config { interface: "can0".to_owned(), nodes, ..Config::default() }
    }

    #[test]
    fn every_bound_is_checked_and_named() {
        assert_eq!(good().check(), Ok(()));
        let node = |id| {
            vec![
                NodeConfig { id: 1, ..NodeConfig::default() },
                NodeConfig { id, ..NodeConfig::default() },
            ]
        };
        let coarse = vec![NodeConfig { id: 1, counts_per_turn: 0, ..NodeConfig::default() }];
        for (place, bad) in [
            ("interface", Config { interface: String::new(), ..good() }),
            ("nodes", Config { nodes: Vec::new(), ..good() }),
            ("nodes", Config { nodes: vec![NodeConfig::default(); 33], ..good() }),
            ("nodes[1].id", Config { nodes: node(0), ..good() }),
            ("nodes[1].id", Config { nodes: node(1), ..good() }),
            ("nodes[1].id", Config { nodes: node(127), ..good() }),
            ("nodes[1].id", Config { nodes: node(64), protocol: Protocol::Odrive, ..good() }),
            ("nodes[0].counts_per_turn", Config { nodes: coarse, ..good() }),
            ("torque_max", Config { torque_max: 32_768, ..good() }),
            ("velocity_max_counts_s", Config { mode: DriveMode::Velocity, ..good() }),
            ("velocity_max_counts_s", Config { velocity_max_counts_s: Some(0), ..good() }),
            ("step_max_counts", Config { step_max_counts: u32::MAX, ..good() }),
            ("mode", Config { mode: DriveMode::Position, protocol: Protocol::Odrive, ..good() }),
            ("period_us", Config { period_us: 99, ..good() }),
            ("wait_share", Config { wait_share: f64::NAN, ..good() }),
            ("lost_ms", Config { lost_ms: 9, ..good() }),
            ("silence_ms", Config { silence_ms: 9, ..good() }),
            ("enable_ms", Config { enable_ms: 0, ..good() }),
            ("open_wait_ms", Config { open_wait_ms: 0, ..good() }),
            ("host_id", Config { host_id: 0, ..good() }),
            ("host_id", Config { host_id: 128, ..good() }),
            ("brake_bit", Config { brake_bit: Some(32), ..good() }),
            ("brake_bit", Config { brake_bit: Some(0), protocol: Protocol::Moteus, ..good() }),
        ] {
            assert_eq!(bad.check().unwrap_err().place, place, "{bad:?}");
        }
    }

    #[test]
    fn a_section_is_read_and_strange_keys_are_refused() {
        let text = "interface = 'can0'\nprotocol = 'moteus'\nnodes = [{ id = 1 }, { id = 2 }]";
        let config: Config = toml::from_str(text).unwrap();
        assert_eq!((config.protocol, config.nodes[1].id), (Protocol::Moteus, 2));
        assert!(toml::from_str::<Config>("bitrate = 1000000").is_err());
        assert!(toml::from_str::<Config>("nodes = [{ number = 1 }]").is_err());
    }
}
