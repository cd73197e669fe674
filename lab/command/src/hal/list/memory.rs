//! Registers in memory: UIO devices with their maps, and PCI devices with the files of their
//! memory.

use std::path::Path;

use serde_json::Value;

use super::{Found, Group, below, is_permitted, line_of, names_in, target_name};

/// The flag of a PCI region that is memory (include/linux/ioport.h, `IORESOURCE_MEM`).
const MEMORY_REGION_FLAG: u64 = 0x200;
/// Base classes of PCI devices that are no boards of a lab: storage, network, display, multimedia,
/// memory, bridge, system parts, input, docking station, processor and serial bus.
const COMMON_CLASSES: [u64; 11] =
    [0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x08, 0x09, 0x0a, 0x0b, 0x0c];
/// The subclass of bridges of no common kind, as which interface chips of boards appear.
const OTHER_BRIDGE_CLASS: u64 = 0x0680;

/// The UIO devices of the tree.
pub(super) fn uio_devices(root: &Path) -> Group {
    let mut group =
        Group { key: "uio", title: "UIO devices (driver \"regmap\")", ..Group::default() };
    let folder = root.join("sys/class/uio");
    let Ok(names) = names_in(&folder) else {
        group.not_seen.push(
            "the kernel has no UIO loaded: load the board's module, or `modprobe uio_pci_generic`"
                .to_owned(),
        );
        return group;
    };
    for name in names {
        let class = folder.join(&name);
        let node = root.join("dev").join(&name);
        let mut found = Found::new(below(root, &node));
        found.add_some("uio_name", line_of(&class.join("name")));
        found.add_some("pci_id", pci_id(&class.join("device")));
        found.add("permitted", is_permitted(&node));
        let maps = names_in(&class.join("maps")).unwrap_or_default();
        let map = |map: &String| {
            let own = class.join("maps").join(map);
            let text = |key: &str| line_of(&own.join(key)).unwrap_or_default();
            let at = format!("{map}: {} bytes at {}", text("size"), text("addr"));
            Value::from(format!("{at} {}", text("name")).trim_end().to_owned())
        };
        found.add("maps", maps.iter().map(map).collect::<Vec<_>>());
        group.found.push(found);
    }
    group
}

/// The PCI devices of the tree with memory that no driver of the kernel has taken, and that are not
/// of a kind that every computer has.
pub(super) fn pci_devices(root: &Path) -> Group {
    let mut group =
        Group { key: "pci", title: "PCI memory (driver \"regmap\")", ..Group::default() };
    let folder = root.join("sys/bus/pci/devices");
    let Ok(names) = names_in(&folder) else {
        group.not_seen.push("this host shows no PCI bus".to_owned());
        return group;
    };
    let mut common = 0;
    for name in names {
        let device = folder.join(&name);
        let class = line_of(&device.join("class")).and_then(|text| hexadecimal(&text));
        let class = class.unwrap_or(0) >> 8;
        if COMMON_CLASSES.contains(&(class >> 8)) && class != OTHER_BRIDGE_CLASS {
            common += 1;
            continue;
        }
        let regions = memory_regions(root, &device);
        if regions.is_empty() {
            common += 1;
            continue;
        }
        let mut found = Found::new(below(root, &device));
        found.add_some("pci_id", pci_id(&device));
        found.add_some("kernel_driver", target_name(&device.join("driver")));
        found.add("enabled", line_of(&device.join("enable")).is_some_and(|text| text != "0"));
        found.add("regions", regions);
        group.found.push(found);
    }
    if common > 0 {
        let what = "parts of the computer itself, such as bridges and network cards, left out";
        group.not_seen.push(format!("{common} {what}; `lspci -nn` shows them"));
    }
    group
}

fn pci_id(device: &Path) -> Option<String> {
    let part = |key: &str| Some(line_of(&device.join(key))?.trim_start_matches("0x").to_owned());
    Some(format!("{}:{}", part("vendor")?, part("device")?))
}

fn hexadecimal(text: &str) -> Option<u64> {
    u64::from_str_radix(text.trim_start_matches("0x"), 16).ok()
}

/// The regions of a device that are memory and have a file, each with its size.
fn memory_regions(root: &Path, device: &Path) -> Vec<Value> {
    let table = std::fs::read_to_string(device.join("resource")).unwrap_or_default();
    let region = |(number, line): (usize, &str)| {
        let words: Vec<u64> = line.split_whitespace().filter_map(hexadecimal).collect();
        let [first, last, flags] = words.as_slice() else { return None };
        let file = device.join(format!("resource{number}"));
        if flags & MEMORY_REGION_FLAG == 0 || last < first || !file.exists() {
            return None;
        }
        let rights = if is_permitted(&file) { "" } else { ", not permitted" };
        Some(Value::from(format!("{}: {} bytes{rights}", below(root, &file), last - first + 1)))
    };
    table.lines().enumerate().filter_map(region).collect()
}
