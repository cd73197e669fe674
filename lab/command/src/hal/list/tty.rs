//! Serial ports: those with a device behind them, with the USB device that they belong to, the
//! names that stay, and whoever has them open.

use std::path::{Path, PathBuf};

use serde_json::Value;
use taktil_drivers_serial::{Config, SerialFile};

use super::{Found, Group, below, is_permitted, line_of, names_in, target_name};

/// The serial ports of the tree; with `open` each is opened for a moment.
pub(super) fn ports(root: &Path, open: bool) -> Group {
    let mut group = Group {
        key: "serial_ports",
        title: "Serial ports (driver \"serial\")",
        ..Group::default()
    };
    let folder = root.join("sys/class/tty");
    let names = match names_in(&folder) {
        Ok(names) => names,
        Err(error) => {
            group.not_seen.push(format!("{}: {error}", below(root, &folder)));
            return group;
        }
    };
    let stable = stable_names(root);
    let (users, hidden) = open_files(root);
    for name in names {
        let class = folder.join(&name);
        // The kernel names ports of an old serial card that is not there; their kind is 0.
        let is_there = class.join("device").exists()
            && line_of(&class.join("type")).is_none_or(|kind| kind != "0");
        if is_there {
            group.found.push(port(root, &name, &class, &stable, &users, open));
        }
    }
    if hidden > 0 && !group.found.is_empty() {
        group.not_seen.push(format!(
            "who else has a port open: {hidden} processes belong to other users; run it as root"
        ));
    }
    if !open && !group.found.is_empty() {
        let what = "whether a port is locked, and takes the low-latency setting";
        group.not_seen.push(format!("{what}: it would have to be opened; add --open"));
    }
    group
}

fn port(
    root: &Path,
    name: &str,
    class: &Path,
    stable: &[(PathBuf, String)],
    users: &[(String, String)],
    open: bool,
) -> Found {
    let node = root.join("dev").join(name);
    let path = format!("/dev/{name}");
    let mut found = Found::new(&*path);
    let driver = target_name(&class.join("device/driver"));
    found.add_some("driver", driver.clone());
    if let Some(usb) = usb_device(root, class) {
        let text = |key: &str| line_of(&usb.join(key));
        let id = text("idVendor").zip(text("idProduct"));
        found.add_some("usb_id", id.map(|(vendor, product)| format!("{vendor}:{product}")));
        let words: Vec<String> = ["manufacturer", "product"].into_iter().filter_map(text).collect();
        found.add_some("usb_name", (!words.is_empty()).then(|| words.join(" ")));
        found.add_some("usb_serial", text("serial"));
    }
    let names: Vec<Value> = stable
        .iter()
        .filter(|(target, _)| target.file_name() == Path::new(&path).file_name())
        .map(|(_, link)| link.clone().into())
        .collect();
    if !names.is_empty() {
        found.add("stable_names", names);
    }
    found.add("permitted", is_permitted(&node));
    low_latency(&mut found, class, driver.as_deref());
    let by: Vec<Value> = users
        .iter()
        .filter(|(target, _)| *target == path)
        .map(|(_, user)| user.clone().into())
        .collect();
    if !by.is_empty() {
        found.add("busy", true);
        found.add("opened_by", by);
    } else if open {
        try_to_open(&mut found, &path);
    }
    found
}

/// What can be said of the delay between port and process without opening the port.
fn low_latency(found: &mut Found, class: &Path, driver: Option<&str>) {
    let timer = class.join("device/latency_timer");
    if let Some(ms) = line_of(&timer).and_then(|text| text.parse::<u32>().ok()) {
        found.add("latency_timer_ms", ms);
        found.add("timer_settable", is_permitted(&timer));
    }
    let known = match driver {
        Some("ftdi_sio" | "serial8250" | "serial" | "port") => "can be set: the driver does so",
        Some("cdc_acm") => "needs no setting: nothing waits in this port",
        _ => return,
    };
    found.add("low_latency", known);
}

/// Opens the port as the driver does and closes it at once.
fn try_to_open(found: &mut Found, path: &str) {
    match SerialFile::open(&Config { path: path.to_owned(), ..Config::default() }) {
        Ok(port) => {
            found.add("busy", false);
            found.add("takes_low_latency", port.is_low_latency());
        }
        Err(error) => {
            let is_busy = error.to_string().to_lowercase().contains("busy");
            found.add("busy", if is_busy { Value::Bool(true) } else { Value::Null });
            found.add("cannot_be_opened", error.to_string());
        }
    }
}

/// The USB device above a class entry.
fn usb_device(root: &Path, class: &Path) -> Option<PathBuf> {
    let real = std::fs::canonicalize(class).ok()?;
    let root = std::fs::canonicalize(root).ok()?;
    let above = real.ancestors().take_while(|folder| folder.starts_with(&root));
    above.map(Path::to_owned).find(|folder| folder.join("idVendor").is_file())
}

/// The links below /dev/serial, as what they point at and their own name.
fn stable_names(root: &Path) -> Vec<(PathBuf, String)> {
    let mut links = Vec::new();
    for kind in ["by-id", "by-path"] {
        let folder = root.join("dev/serial").join(kind);
        for name in names_in(&folder).unwrap_or_default() {
            let link = folder.join(name);
            if let Ok(target) = std::fs::read_link(&link) {
                links.push((target, below(root, &link)));
            }
        }
    }
    links
}

/// The terminals that processes have open, as path and process, and how many processes could not be
/// looked at.
fn open_files(root: &Path) -> (Vec<(String, String)>, usize) {
    let folder = root.join("proc");
    let (mut users, mut hidden) = (Vec::new(), 0);
    let names = names_in(&folder).unwrap_or_default();
    for process in names.iter().filter(|name| name.bytes().all(|byte| byte.is_ascii_digit())) {
        let own = folder.join(process);
        let Ok(descriptors) = names_in(&own.join("fd")) else {
            hidden += usize::from(own.exists());
            continue;
        };
        let command = line_of(&own.join("comm")).unwrap_or_default();
        for descriptor in descriptors {
            let target = std::fs::read_link(own.join("fd").join(descriptor));
            let Some(target) = target.ok().and_then(|path| path.to_str().map(str::to_owned)) else {
                continue;
            };
            let user = format!("{command} ({process})");
            if target.starts_with("/dev/tty") && !users.contains(&(target.clone(), user.clone())) {
                users.push((target, user));
            }
        }
    }
    (users, hidden)
}
