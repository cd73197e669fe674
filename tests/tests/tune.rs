//! The script that prepares a computer for lanes, on a tree that stands for `/proc`, `/sys` and
//! `/run`: what it changes, what it leaves, and that it puts every value back.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use taktil_tests::root;

/// Files of a computer with four CPUs, as the kernel prints them.
const FILES: [(&str, &str); 9] = [
    ("sys/devices/system/cpu/online", "0-3\n"),
    ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "schedutil\n"),
    ("sys/devices/system/cpu/cpu2/cpufreq/scaling_governor", "schedutil\n"),
    ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "performance\n"),
    ("proc/irq/default_smp_affinity", "f\n"),
    ("proc/irq/0/smp_affinity_list", "0\n"),
    ("proc/irq/24/smp_affinity_list", "0-3\n"),
    ("proc/irq/25/smp_affinity_list", "2\n"),
    ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
];

struct Tree(PathBuf);

impl Tree {
    fn new(name: &str) -> Tree {
        let tree = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("tune-{name}"));
        let _ = fs::remove_dir_all(&tree);
        for (name, text) in FILES {
            let path = tree.join(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("folders can be made");
            fs::write(path, text).expect("the build folder can be written");
        }
        Tree(tree)
    }

    fn tune(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(root().join("systemd/taktil-tune"));
        command.args(arguments).env("TAKTIL_TUNE_ROOT", &self.0).output().expect("it is a program")
    }

    fn values(&self) -> BTreeMap<&'static str, String> {
        let value = |name| fs::read_to_string(self.0.join(name)).expect("it is there");
        FILES.into_iter().map(|(name, _)| (name, value(name))).collect()
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn everything_that_it_changes_it_puts_back() {
    let tree = Tree::new("whole");
    let before = tree.values();
    let on = tree.tune(&["on", "2-3"]);
    assert_eq!(on.status.code(), Some(0), "{}", said(&on));
    let changed = tree.values();
    for (name, value) in [
        ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "schedutil\n"),
        ("sys/devices/system/cpu/cpu2/cpufreq/scaling_governor", "performance\n"),
        ("proc/irq/default_smp_affinity", "3\n"),
        ("proc/irq/24/smp_affinity_list", "0,1\n"),
        ("proc/irq/25/smp_affinity_list", "0,1\n"),
        ("proc/sys/kernel/sched_rt_runtime_us", "-1\n"),
    ] {
        assert_eq!(changed[name], value, "{name}");
    }
    let status = String::from_utf8(tree.tune(&["status"]).stdout).expect("text");
    assert!(status.contains("/proc/sys/kernel/sched_rt_runtime_us was 950000"), "{status}");
    assert!(!status.contains("cpu3/"), "what was right already is not its own: {status}");
    let twice = tree.tune(&["on", "2-3"]);
    assert_eq!(twice.status.code(), Some(2), "twice would forget what was there before");
    let off = tree.tune(&["off"]);
    assert_eq!(off.status.code(), Some(0), "{}", said(&off));
    assert_eq!(tree.values(), before);
    assert_eq!(tree.tune(&["off"]).status.code(), Some(0), "off is off");
    assert_eq!(tree.tune(&["status"]).stdout, b"off\n");
}

#[test]
fn bad_lists_of_cpus_change_nothing() {
    let tree = Tree::new("bad");
    let before = tree.values();
    for (cpus, says) in [("", "is no list"), ("2;reboot", "is no list"), ("0-3", "leaves no CPU")] {
        let output = tree.tune(&["on", cpus]);
        assert_eq!(output.status.code(), Some(2), "{cpus}");
        assert!(said(&output).contains(says), "{cpus}: {}", said(&output));
    }
    assert_eq!(tree.tune(&[]).status.code(), Some(2));
    assert_eq!(tree.values(), before);
    assert_eq!(tree.tune(&["on", "3"]).status.code(), Some(0), "nothing is left over");
}
