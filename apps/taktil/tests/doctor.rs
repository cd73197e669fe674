//! `taktil doctor`: recorded hosts yield the recorded answers; missing, empty, damaged and
//! unreadable files yield `unknown`, and the program always ends with an answer; nothing is
//! changed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use taktil_lab_host::doctor::{CpuList, Host, Report, Verdict, examine, script, table, to_json};

const RECORDED_HOSTS: [(&str, u8); 6] = [
    ("rt-pc-good", 0),
    ("arm-board", 0),
    ("throttled", 1),
    ("unreadable", 1),
    ("vm-no-rt", 2),
    ("group-without-budget", 2),
];

fn folder(host: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/hosts").join(host)
}

fn report(tree: &Path) -> Report {
    examine(&Host::recorded(tree).unwrap(), None)
}

fn doctor(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_taktil")).arg("doctor").args(arguments).output().unwrap()
}

/// Every file of a tree with its bytes, by its path in the tree.
fn files(tree: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut open = vec![tree.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let bytes = std::fs::read(&path).unwrap();
                out.insert(path.strip_prefix(tree).unwrap().to_owned(), bytes);
            }
        }
    }
    out
}

/// A copy of a recorded tree that a test may modify.
fn copy(host: &str, name: &str) -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("doctor").join(name);
    let _ = std::fs::remove_dir_all(&target);
    for (path, bytes) in files(&folder(host).join("tree")) {
        let path = target.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    target
}

fn verdict(report: &Report, row: &str) -> Verdict {
    report.row(row).unwrap_or_else(|| panic!("no row {row}")).verdict
}

#[test]
fn recorded_hosts_give_the_recorded_answers() {
    for (host, exit) in RECORDED_HOSTS {
        let report = report(&folder(host).join("tree"));
        assert_eq!(report.exit(), exit, "{host}: {}", report.verdict());
        let expected = |file: &str| std::fs::read_to_string(folder(host).join(file)).unwrap();
        assert_eq!(table(&report), expected("expected.txt"), "{host}");
        assert_eq!(script(&report), expected("expected.sh"), "{host}");
        let json: serde_json::Value = serde_json::from_str(&expected("expected.json")).unwrap();
        assert_eq!(to_json(&report), json, "{host}");
    }
}

#[test]
fn each_defect_is_found_alone() {
    let cpu = "sys/devices/system/cpu";
    let cases = [
        ("proc/sys/kernel/sched_rt_runtime_us", "0\n", "RT throttling", Verdict::Bad),
        ("proc/sys/kernel/sched_rt_runtime_us", "500000\n", "RT throttling", Verdict::Warn),
        ("proc/sys/kernel/sched_rt_runtime_us", "-1\n", "RT throttling", Verdict::Ok),
        ("proc/sys/kernel/sched_rt_runtime_us", "-7\n", "RT throttling", Verdict::Unknown),
        ("proc/sys/kernel/sched_rt_period_us", "0\n", "RT throttling", Verdict::Unknown),
        ("proc/cpuinfo", "flags : fpu hypervisor\n", "virtual machine", Verdict::Bad),
        ("sys/class/dmi/id/sys_vendor", "VMware, Inc.\n", "virtual machine", Verdict::Bad),
        ("proc/self/limits", "Max realtime priority  79  79\n", "SCHED_FIFO", Verdict::Bad),
        ("proc/self/limits", "Max realtime priority  79  79\n", "RLIMIT_RTPRIO", Verdict::Bad),
        ("proc/self/limits", "Max realtime priority  80  80\n", "RLIMIT_RTPRIO", Verdict::Ok),
        ("proc/self/limits", "Max locked memory  65536  65536\n", "memory lock", Verdict::Bad),
        ("proc/self/limits", "Max locked memory  65536  65536\n", "SCHED_FIFO", Verdict::Unknown),
        ("proc/self/status", "CapEff:\tseven\n", "SCHED_DEADLINE", Verdict::Unknown),
        ("proc/swaps", "Filename\n/dev/sda2\n", "swap", Verdict::Warn),
        ("proc/900/comm", "numad\n", "irqbalance/numad", Verdict::Warn),
        ("proc/irq/8/effective_affinity_list", "3\n", "IRQ affinity", Verdict::Warn),
        ("proc/irq/8/effective_affinity_list", "\n", "IRQ affinity", Verdict::Ok),
        (&format!("{cpu}/isolated"), "\n", "isolated CPUs", Verdict::Warn),
        (&format!("{cpu}/isolated"), "\n", "IRQ affinity", Verdict::Unknown),
        (&format!("{cpu}/nohz_full"), "2\n", "nohz_full", Verdict::Warn),
        (&format!("{cpu}/smt/active"), "1\n", "SMT", Verdict::Ok),
        (&format!("{cpu}/smt/active"), "yes\n", "SMT", Verdict::Unknown),
        (
            &format!("{cpu}/cpu3/cpufreq/scaling_governor"),
            "ondemand\n",
            "CPU governor",
            Verdict::Warn,
        ),
        (&format!("{cpu}/cpu3/cpuidle/state2/disable"), "0\n", "C-states", Verdict::Warn),
        (
            "sys/kernel/mm/transparent_hugepage/enabled",
            "[always] never\n",
            "transparent huge pages",
            Verdict::Warn,
        ),
        ("proc/sys/kernel/numa_balancing", "2\n", "NUMA balancing", Verdict::Warn),
        (
            "sys/devices/system/clocksource/clocksource0/current_clocksource",
            "jiffies\n",
            "clocksource",
            Verdict::Bad,
        ),
        ("proc/config.gz", "no gzip\n", "debug options", Verdict::Ok),
        ("boot/config-6.12.48+deb13-rt-amd64", "CONFIG_KASAN=y\n", "debug options", Verdict::Bad),
        (
            "boot/config-6.12.48+deb13-rt-amd64",
            "CONFIG_DEBUG_PREEMPT=y\n",
            "debug options",
            Verdict::Warn,
        ),
        (
            "boot/config-6.12.48+deb13-rt-amd64",
            "CONFIG_RT_GROUP_SCHED=y\n",
            "RT group budget",
            Verdict::Unknown,
        ),
    ];
    for (at, (path, text, row, expected)) in cases.into_iter().enumerate() {
        check_row(&format!("alone-{at}"), path, text, row, expected);
    }
}

/// Checks the verdict of a row after one file of the good host has another text.
fn check_row(name: &str, path: &str, text: &str, row: &str, expected: Verdict) {
    let tree = copy("rt-pc-good", name);
    let path = tree.join(path);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    assert_eq!(verdict(&report(&tree), row), expected, "{}: {text:?}", path.display());
}

#[test]
fn each_disturbance_is_found_alone() {
    let turbo = "sys/devices/system/cpu/intel_pstate/no_turbo";
    let cases = [
        ("proc/900/comm", "ptp4l\n", "time of day", Verdict::Warn),
        ("proc/600/comm", "bash\n", "time of day", Verdict::Warn),
        ("proc/600/comm", "systemd-timesyn\n", "time of day", Verdict::Ok),
        (
            "sys/bus/usb-serial/devices/ttyUSB1/latency_timer",
            "16",
            "serial adapters",
            Verdict::Warn,
        ),
        ("sys/bus/usb-serial/devices/ttyUSB1/port_number", "0", "serial adapters", Verdict::Ok),
        (
            "sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
            "-1",
            "serial adapters",
            Verdict::Unknown,
        ),
        (turbo, "0\n", "turbo", Verdict::Warn),
        (turbo, "2\n", "turbo", Verdict::Unknown),
        ("sys/kernel/tracing/available_tracers", "nop\n", "firmware noise", Verdict::Warn),
        ("sys/kernel/tracing/available_tracers", "hwlat\n", "firmware noise", Verdict::Unknown),
    ];
    for (at, (path, text, row, expected)) in cases.into_iter().enumerate() {
        check_row(&format!("beside-{at}"), path, text, row, expected);
    }
}

#[test]
fn a_real_time_kernel_is_known_by_any_of_three_signs() {
    let tree = copy("rt-pc-good", "signs");
    let version = tree.join("proc/sys/kernel/version");
    std::fs::write(&version, "#1 SMP PREEMPT_DYNAMIC\n").unwrap();
    assert_eq!(verdict(&report(&tree), "real-time kernel"), Verdict::Ok, "by /sys");
    std::fs::remove_file(tree.join("sys/kernel/realtime")).unwrap();
    assert_eq!(verdict(&report(&tree), "real-time kernel"), Verdict::Ok, "by configuration");
    std::fs::remove_dir_all(tree.join("boot")).unwrap();
    assert_eq!(verdict(&report(&tree), "real-time kernel"), Verdict::Bad);
    std::fs::remove_file(version).unwrap();
    assert_eq!(verdict(&report(&tree), "real-time kernel"), Verdict::Ok, "by /proc/version");
    std::fs::remove_file(tree.join("proc/version")).unwrap();
    let blind = report(&tree);
    assert_eq!(verdict(&blind, "real-time kernel"), Verdict::Unknown);
    assert_eq!(blind.exit(), 1, "what matters most and is not known is no clean bill");
}

#[test]
fn turbo_has_another_switch_elsewhere_and_some_have_none() {
    let tree = copy("rt-pc-good", "turbo");
    std::fs::remove_dir_all(tree.join("sys/devices/system/cpu/intel_pstate")).unwrap();
    assert_eq!(verdict(&report(&tree), "turbo"), Verdict::Unknown);
    let boost = tree.join("sys/devices/system/cpu/cpufreq/boost");
    std::fs::create_dir_all(boost.parent().unwrap()).unwrap();
    for (text, expected) in [("0\n", Verdict::Ok), ("1\n", Verdict::Warn)] {
        std::fs::write(&boost, text).unwrap();
        assert_eq!(verdict(&report(&tree), "turbo"), expected);
    }
}

#[test]
fn one_sibling_of_each_core_is_stopped() {
    let tree = copy("throttled", "siblings");
    for (cpu, list) in [(2, "2,6"), (3, "3,7"), (6, "2,6"), (7, "3,7")] {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list");
        let path = tree.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, list).unwrap();
    }
    let cpus = CpuList::parse("2,3,6,7").unwrap();
    let report = examine(&Host::recorded(&tree).unwrap(), Some(&cpus));
    let stop = ["cpu6", "cpu7"].map(|cpu| format!("echo 0 > /sys/devices/system/cpu/{cpu}/online"));
    assert_eq!(report.row("SMT").unwrap().fix.commands, stop);
    assert_eq!(verdict(&report, "isolated CPUs"), Verdict::Warn);
}

#[test]
fn damaged_files_are_never_a_good_result() {
    let garbage: &[u8] = b"\x00\xff\xfe\x1b[31m ;;::--,,==[[]] $(spoil) `spoil`\n\x07\x80";
    for host in ["rt-pc-good", "throttled", "vm-no-rt", "group-without-budget"] {
        let tree = copy(host, &format!("spoiled-{host}"));
        let before = report(&tree);
        for (path, bytes) in files(&tree) {
            let name = path.to_string_lossy().into_owned();
            // A process may have any name; the kernel lists no controllers as an empty line.
            let tells = !name.ends_with("comm") && !name.ends_with("cgroup.controllers");
            let path = tree.join(&path);
            for spoiled in [Some(garbage), Some(b"".as_slice()), Some(b"\n".as_slice()), None] {
                std::fs::remove_file(&path).unwrap();
                match spoiled {
                    Some(bytes) => std::fs::write(&path, bytes).unwrap(),
                    None => std::fs::create_dir(&path).unwrap(),
                }
                let after = report(&tree);
                for (old, new) in before.rows.iter().zip(&after.rows) {
                    let better = old.verdict != Verdict::Ok && new.verdict == Verdict::Ok;
                    // Where one of two CPUs has no list of its own, the list of the other is used.
                    let said = format!("{host}: {name} spoiled with {spoiled:?}: {new:?}");
                    assert!(!(better && tells), "{said}");
                    assert!(!new.found.chars().any(char::is_control), "{said}");
                    assert!(!new.found.is_empty(), "{said}");
                }
                assert!(!script(&after).lines().any(|line| line.contains("spoil")), "{name}");
                let _ = (table(&after), to_json(&after));
                let _ = std::fs::remove_file(&path);
                let _ = std::fs::remove_dir(&path);
                std::fs::write(&path, &bytes).unwrap();
            }
        }
        assert_eq!(report(&tree), before, "{host} was put back");
    }
}

#[test]
fn an_empty_tree_is_unknown_throughout() {
    let good = files(&folder("rt-pc-good").join("tree"));
    for (name, bytes) in [("nothing", None), ("zeros", Some(vec![])), ("noise", Some(vec![255; 9]))]
    {
        let tree = Path::new(env!("CARGO_TARGET_TMPDIR")).join("doctor").join(name);
        let _ = std::fs::remove_dir_all(&tree);
        std::fs::create_dir_all(tree.join("proc")).unwrap();
        for path in good.keys().filter(|path| !path.ends_with("comm")) {
            let Some(bytes) = &bytes else { continue };
            let path = tree.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        let report = report(&tree);
        assert_eq!(report.exit(), 1, "{name}");
        for row in &report.rows {
            // A governor with an unknown name is not `performance`.
            let allowed = row.name == "CPU governor" && row.verdict == Verdict::Warn;
            assert!(row.verdict == Verdict::Unknown || allowed, "{name}: {row:?}");
        }
    }
}

#[test]
fn links_do_not_lead_out_of_a_recorded_tree() {
    let tree = copy("rt-pc-good", "links");
    let swaps = tree.join("proc/swaps");
    std::fs::remove_file(&swaps).unwrap();
    std::os::unix::fs::symlink("/proc/swaps", &swaps).unwrap();
    let row = report(&tree).row("swap").unwrap().clone();
    assert_eq!(row.verdict, Verdict::Unknown);
    assert!(row.found.contains("link out"), "{row:?}");
}

#[test]
fn the_running_host_is_left_as_it_was() {
    let status = || std::fs::read_to_string("/proc/self/status").unwrap();
    let policy = || {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
        let after_name = stat.rsplit(')').next().unwrap().to_owned();
        after_name.split_whitespace().nth(38).unwrap().to_owned()
    };
    let before = policy();
    let report = examine(&Host::live(), None);
    assert_eq!(policy(), before);
    let locked = status().lines().find(|line| line.starts_with("VmLck")).unwrap().to_owned();
    assert_eq!(locked.split_whitespace().nth(1), Some("0"), "{locked}");
    assert!(report.live);
    assert!(report.rows.iter().all(|row| !row.found.is_empty()));
    let skipped = "a recorded tree";
    assert!(!report.rows.iter().any(|row| row.found.contains(skipped)));
}

#[test]
fn the_command_line_answers_0_1_and_2_and_writes_nothing() {
    for (host, exit) in RECORDED_HOSTS {
        let tree = folder(host).join("tree");
        let root = tree.to_str().unwrap();
        let before = files(&tree);
        let shown = doctor(&["--root", root]);
        assert_eq!(shown.status.code(), Some(i32::from(exit)), "{host}");
        let expected = std::fs::read(folder(host).join("expected.txt")).unwrap();
        assert_eq!(shown.stdout, expected, "{host}");
        let json = doctor(&["--root", root, "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
        assert_eq!(json["exit"], exit, "{host}");
        assert_eq!(json["rows"].as_array().unwrap().len(), 29, "{host}");
        assert_eq!(doctor(&["--root", root, "--fix-script"]).status.code(), Some(i32::from(exit)));
        let script = folder(host).join("expected.sh");
        let parsed = Command::new("sh").arg("-n").arg(script).status().unwrap();
        assert!(parsed.success(), "{host}: the script is no shell script");
        assert_eq!(files(&tree), before, "{host} was changed");
    }
    let good = folder("rt-pc-good").join("tree");
    let good = good.to_str().unwrap();
    for bad in [
        &["--root", "no-such-folder"][..],
        &["--root", env!("CARGO_BIN_EXE_taktil")],
        &["--root", env!("CARGO_MANIFEST_DIR")],
        &["--root", good, "--cpus", "3-1"],
        &["--root", good, "--cpus", ""],
        &["--root", good, "--cpus", "99"],
        &["--root", good, "--cpus", "2-99"],
        &["--root", good, "--json", "--fix-script"],
    ] {
        let said = doctor(bad);
        assert_eq!(said.status.code(), Some(2), "{bad:?}");
        assert!(said.stdout.is_empty() && !said.stderr.is_empty(), "{bad:?}");
    }
    let said = doctor(&["--root", good, "--cpus", "2,99"]).stderr;
    let said = String::from_utf8_lossy(&said);
    assert!(said.contains("CPU 99 does not run here; choose of 0-3"), "{said}");
    assert_eq!(doctor(&["--root", good, "--cpus", "2,3"]).status.code(), Some(0));
}
