//! Comedi boards: device nodes with the kernel's driver, the board and its subdevices.

use std::path::Path;

use serde_json::Value;
use taktil_drivers_comedi::{Board, DeviceFile};

use super::{Found, Group, below, is_permitted, line_of, names_in};

/// The nodes of the tree. A node of this host is opened, which changes nothing on the board.
pub(super) fn nodes(root: &Path, is_recorded: bool) -> Group {
    let mut group =
        Group { key: "comedi", title: "Comedi boards (driver \"comedi\")", ..Group::default() };
    let folder = root.join("dev");
    let names = names_in(&folder).unwrap_or_default();
    for name in names {
        let number = name.strip_prefix("comedi");
        // Nodes of single subdevices, such as `comedi0_subd1`, belong to one of these.
        let is_board = number
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()));
        if !is_board {
            continue;
        }
        let path = folder.join(&name);
        let shown = below(root, &path);
        let mut found = Found::new(&*shown);
        let class = root.join("sys/class/comedi").join(&name);
        found.add_some("kernel_driver", line_of(&class.join("driver_name")));
        found.add_some("kernel_board", line_of(&class.join("board_name")));
        found.add("permitted", is_permitted(&path));
        if is_recorded {
            group.not_seen.push(format!("{shown}: its subdevices, on behalf of a recorded tree"));
        } else if let Err(reason) = ask(&mut found, &shown) {
            group.not_seen.push(format!("{shown}: its subdevices ({reason})"));
        }
        group.found.push(found);
    }
    if group.found.is_empty() && !root.join("proc/comedi").exists() {
        let what = "the kernel has no Comedi loaded: load the board's module, such as";
        group.not_seen.push(format!("{what} `modprobe comedi_test`"));
    }
    group
}

fn ask(found: &mut Found, path: &str) -> Result<(), String> {
    let board = DeviceFile::open(path).map_err(|bad| bad.into_invalid().what)?;
    let info = board.device_info().map_err(|error| error.desc().to_owned())?;
    found.add("driver", info.driver);
    found.add("board", info.board);
    let subdevices = board.subdevices().map_err(|error| error.desc().to_owned())?;
    let line = |(number, entry): (usize, &taktil_drivers_comedi::board::SubdeviceInfo)| {
        Value::from(format!("{number} {} x {}", entry.kind_name(), entry.channels))
    };
    let lines: Vec<Value> = subdevices.iter().enumerate().map(line).collect();
    found.add("subdevices", lines);
    Ok(())
}
