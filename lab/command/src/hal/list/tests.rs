//! A tree of /dev, /proc and /sys with one board of each kind, as it is shown to people and to
//! programs.

use std::os::unix::fs::symlink;

use super::*;

/// A folder that goes when the test ends.
struct Tree(PathBuf);

impl Tree {
    fn new(name: &str) -> Tree {
        let path = std::env::temp_dir().join(format!("taktil-list-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Tree(path)
    }

    fn file(&self, path: &str, text: &str) {
        let path = self.0.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn link(&self, path: &str, target: &str) {
        let path = self.0.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn fact(found: &Found, key: &str) -> String {
    found.facts.iter().find(|(name, _)| *name == key).map_or(String::new(), |(_, v)| shown(v))
}

/// An FTDI adapter that a process has open, and the empty place of an old port.
fn with_ports(tree: &Tree) {
    let usb = "sys/devices/usb1/1-1";
    for (key, text) in [
        ("idVendor", "0403\n"),
        ("idProduct", "6001\n"),
        ("manufacturer", "FTDI\n"),
        ("product", "FT232R\n"),
        ("serial", "A50285BI\n"),
    ] {
        tree.file(&format!("{usb}/{key}"), text);
    }
    let port = format!("{usb}/1-1:1.0/ttyUSB0");
    tree.file(&format!("{port}/latency_timer"), "16\n");
    tree.link(&format!("{port}/driver"), "../../../../../bus/usb-serial/drivers/ftdi_sio");
    tree.file(&format!("{port}/tty/ttyUSB0/dev"), "188:0\n");
    tree.link(&format!("{port}/tty/ttyUSB0/device"), "../../../ttyUSB0");
    tree.link("sys/class/tty/ttyUSB0", &format!("../../../{port}/tty/ttyUSB0"));
    tree.file("sys/devices/platform/serial8250/tty/ttyS1/type", "0\n");
    tree.link("sys/devices/platform/serial8250/tty/ttyS1/device", "../../../serial8250");
    tree.link("sys/class/tty/ttyS1", "../../devices/platform/serial8250/tty/ttyS1");
    tree.file("sys/class/tty/tty1/dev", "4:1\n");
    tree.file("dev/ttyUSB0", "");
    tree.link("dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00-port0", "../../ttyUSB0");
    tree.file("proc/42/comm", "minicom\n");
    tree.link("proc/42/fd/3", "/dev/ttyUSB0");
}

#[test]
fn a_port_shows_its_usb_device_the_name_that_stays_and_who_has_it() {
    let tree = Tree::new("ports");
    with_ports(&tree);
    let group = tty::ports(&tree.0, false);
    assert_eq!(group.found.len(), 1, "{group:?}");
    let port = &group.found[0];
    assert_eq!(port.name, "/dev/ttyUSB0");
    for (key, text) in [
        ("driver", "ftdi_sio"),
        ("usb_id", "0403:6001"),
        ("usb_name", "FTDI FT232R"),
        ("usb_serial", "A50285BI"),
        ("stable_names", "/dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00-port0"),
        ("latency_timer_ms", "16"),
        ("busy", "yes"),
        ("opened_by", "minicom (42)"),
    ] {
        assert_eq!(fact(port, key), text, "{key}");
    }
    assert!(group.not_seen.iter().any(|reason| reason.contains("add --open")));
}

#[test]
fn boards_in_memory_show_ids_maps_and_files_and_the_computer_s_own_parts_are_counted() {
    let tree = Tree::new("memory");
    let board = "sys/bus/pci/devices/0000:03:00.0";
    for (key, text) in [
        ("vendor", "0x10b5\n"),
        ("device", "0x9050\n"),
        ("class", "0x068000\n"),
        ("enable", "1\n"),
        ("resource0", ""),
        ("resource2", ""),
        (
            "resource",
            "0x00000000f7c00000 0x00000000f7c0007f 0x0000000000040200\n0x000000000000e000 \
             0x000000000000e07f 0x0000000000040101\n0x00000000f7c10000 0x00000000f7c10fff \
             0x0000000000040200\n",
        ),
    ] {
        tree.file(&format!("{board}/{key}"), text);
    }
    tree.file("sys/bus/pci/devices/0000:00:00.0/class", "0x060000\n");
    let group = memory::pci_devices(&tree.0);
    assert_eq!(group.found.len(), 1, "{group:?}");
    assert_eq!(fact(&group.found[0], "pci_id"), "10b5:9050");
    let regions = fact(&group.found[0], "regions");
    assert!(regions.contains("/resource0: 128 bytes"), "{regions}");
    assert!(regions.contains("/resource2: 4096 bytes"), "{regions}");
    assert!(!regions.contains("resource1"), "{regions}");
    assert!(group.not_seen[0].starts_with("1 parts"), "{group:?}");
    tree.file("sys/class/uio/uio0/name", "cell\n");
    tree.file("sys/class/uio/uio0/maps/map0/size", "0x1000\n");
    tree.file("sys/class/uio/uio0/maps/map0/addr", "0xf7c00000\n");
    let group = memory::uio_devices(&tree.0);
    assert_eq!(group.found[0].name, "/dev/uio0");
    assert_eq!(fact(&group.found[0], "uio_name"), "cell");
    assert_eq!(fact(&group.found[0], "maps"), "map0: 0x1000 bytes at 0xf7c00000");
    assert_eq!(fact(&group.found[0], "permitted"), "no");
}

#[test]
fn a_host_without_any_board_says_what_it_could_not_look_at() {
    let tree = Tree::new("empty");
    let question = card::Question { named: Vec::new(), wait: Nanos(1), is_recorded: false };
    let groups = [
        tty::ports(&tree.0, false),
        card::cards(&tree.0, &question),
        comedi::nodes(&tree.0, true),
        memory::uio_devices(&tree.0),
        memory::pci_devices(&tree.0),
    ];
    for group in &groups {
        assert!(group.found.is_empty() && !group.not_seen.is_empty(), "{group:?}");
    }
    assert!(groups[1].not_seen[0].contains("--udp 10.10.10.10"));
    let text = as_text(&groups);
    assert_eq!(text.matches("none found").count(), groups.len(), "{text}");
    let value: Value = serde_json::from_str(&as_json(&groups)).unwrap();
    assert_eq!(value["uio"]["found"], Value::Array(Vec::new()));
    assert!(value["pci"]["not_seen"][0].is_string());
}

#[test]
fn a_comedi_node_of_a_subdevice_is_no_board() {
    let tree = Tree::new("comedi");
    for name in ["comedi0", "comedi0_subd1", "comedi10", "comedix"] {
        tree.file(&format!("dev/{name}"), "");
    }
    tree.file("sys/class/comedi/comedi0/board_name", "comedi_test\n");
    let group = comedi::nodes(&tree.0, true);
    let names: Vec<&str> = group.found.iter().map(|found| found.name.as_str()).collect();
    assert_eq!(names, ["/dev/comedi0", "/dev/comedi10"]);
    assert_eq!(fact(&group.found[0], "kernel_board"), "comedi_test");
}

#[test]
fn interfaces_of_buses_are_told_apart_with_what_a_driver_would_refuse() {
    let tree = Tree::new("network");
    for (name, kind, queue) in
        [("can0", "280", "10"), ("can1", "280", "64"), ("vcan0", "280", "0"), ("eth1", "1", "1000")]
    {
        tree.file(&format!("sys/class/net/{name}/type"), &format!("{kind}\n"));
        tree.file(&format!("sys/class/net/{name}/operstate"), "up\n");
        tree.file(&format!("sys/class/net/{name}/tx_queue_len"), &format!("{queue}\n"));
    }
    tree.file("sys/class/net/eth1/address", "02:00:00:00:00:01\n");
    tree.file("sys/class/net/eth1/speed", "-1\n");
    tree.file("sys/class/net/lo/type", "772\n");
    tree.link("sys/class/net/can0/device/driver", "../../../bus/usb/drivers/gs_usb");
    let buses = network::can_interfaces(&tree.0);
    let remedies: Vec<(&str, String)> =
        buses.found.iter().map(|found| (&*found.name, fact(found, "remedy"))).collect();
    let longer = "ip link set can0 txqueuelen 64".to_owned();
    assert_eq!(remedies, [("can0", longer), ("can1", String::new()), ("vcan0", String::new())]);
    assert_eq!(fact(&buses.found[0], "kernel_driver"), "gs_usb");
    let cables = network::ethernet_interfaces(&tree.0);
    assert_eq!(cables.found.len(), 1);
    assert_eq!(fact(&cables.found[0], "address"), "02:00:00:00:00:01");
    assert_eq!(fact(&cables.found[0], "speed_mbit_s"), "");
    let nothing = Tree::new("no-network");
    assert!(network::can_interfaces(&nothing.0).not_seen[0].contains("/sys/class/net"));
}
