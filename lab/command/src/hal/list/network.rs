//! Network interfaces that carry a bus: CAN interfaces, and Ethernet interfaces on which an
//! EtherCAT segment may be.

use std::path::Path;

use super::{Found, Group, line_of, names_in, target_name};

/// Hardware types as `linux/if_arp.h` numbers them: `ARPHRD_ETHER` and `ARPHRD_CAN`.
const ETHERNET_TYPE: &str = "1";
const CAN_TYPE: &str = "280";
/// The shortest queue that holds a cycle of six drives.
const CAN_QUEUE_MIN: u32 = 14;

/// CAN interfaces, with what the driver would refuse them for.
pub(super) fn can_interfaces(root: &Path) -> Group {
    let title = "CAN interfaces (driver \"can\")";
    let mut group = interfaces(root, Group { key: "can", title, ..Group::default() }, CAN_TYPE);
    for found in &mut group.found {
        let queue = line_of(&root.join("sys/class/net").join(&found.name).join("tx_queue_len"));
        let queue = queue.and_then(|text| text.parse::<u32>().ok());
        found.add_some("queue_frames", queue);
        // An interface without a queue hands frames on at once.
        if queue.is_some_and(|frames| (1..CAN_QUEUE_MIN).contains(&frames)) {
            found.add("remedy", format!("ip link set {} txqueuelen 64", found.name));
        }
    }
    group
}

/// Ethernet interfaces. A segment wants one of its own, up and without an address.
pub(super) fn ethernet_interfaces(root: &Path) -> Group {
    let title = "Ethernet interfaces (driver \"ethercat\", on one of its own)";
    let group = Group { key: "ethernet", title, ..Group::default() };
    let mut group = interfaces(root, group, ETHERNET_TYPE);
    for found in &mut group.found {
        let folder = root.join("sys/class/net").join(&found.name);
        found.add_some("address", line_of(&folder.join("address")));
        found.add_some("speed_mbit_s", line_of(&folder.join("speed")).filter(|text| text != "-1"));
    }
    group
}

fn interfaces(root: &Path, mut group: Group, hardware: &str) -> Group {
    let folder = root.join("sys/class/net");
    let names = match names_in(&folder) {
        Ok(names) => names,
        Err(error) => {
            group.not_seen.push(format!("/sys/class/net ({error})"));
            return group;
        }
    };
    for name in names {
        let about = folder.join(&name);
        if line_of(&about.join("type")).as_deref() != Some(hardware) {
            continue;
        }
        let mut found = Found::new(name);
        found.add_some("state", line_of(&about.join("operstate")));
        found.add_some("kernel_driver", target_name(&about.join("device/driver")));
        group.found.push(found);
    }
    group
}
