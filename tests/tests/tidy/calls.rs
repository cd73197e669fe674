//! What a line may not say in which crate. The rule works on text and sees no more than the listed
//! words; the compiler's lints (clippy.toml) see through names. Every exception has a reason, and
//! one that nothing uses is a complaint.

use crate::source::{Rust, is_word};

/// A ban: words that code may not hold in some rooms.
pub(crate) struct Ban {
    /// What the words do, for the complaint.
    pub(crate) what: &'static str,
    /// Whole words; a `*` at the end lets the word go on.
    pub(crate) words: &'static [&'static str],
    /// Path prefixes where the ban holds; an empty one stands for everywhere.
    pub(crate) rooms: &'static [&'static str],
    /// Path prefixes where it does not, and why. A file that stops using its exception loses it.
    pub(crate) except: &'static [(&'static str, &'static str)],
    /// Whether tests are bound too.
    pub(crate) tests: bool,
    /// What to write instead.
    pub(crate) remedy: &'static str,
}

/// Everywhere.
const ALL: &[&str] = &[""];
/// Crates whose results are the same bits on every machine.
const DETERMINISTIC: &[&str] = &[
    "hal/src/",
    "mechanics/src/",
    "contact/src/",
    "rtcore/src/",
    "signal/src/",
    "tasks/",
    "sim/src/",
];
/// Crates whose code runs inside a lane.
const LANE: &[&str] = &[
    "hal/src/",
    "mechanics/src/",
    "contact/src/",
    "rtcore/src/",
    "signal/src/",
    "tasks/",
    "sim/src/",
    "drivers/",
];
/// Crates that know neither threads nor a kernel.
const PURE: &[&str] = &[
    "hal/src/",
    "mechanics/src/",
    "contact/src/",
    "signal/src/",
    "tasks/",
    "sim/src/",
    "drivers/",
];

/// The house's bans.
pub(crate) const BANS: &[Ban] = &[
    Ban {
        what: "asks the time",
        words: &["Instant", "SystemTime", "clock_gettime", "ClockId"],
        rooms: ALL,
        except: &[
            ("rtcore/src/linux.rs", "the one place that asks the kernel"),
            ("rtcore/src/linux/clock.rs", "the one place that asks the kernel"),
            ("lab/calc/src/request.rs", "times a computation for whoever asks"),
            ("drivers/mesa/src/port.rs", "names the clock by which the kernel ends a wait"),
            ("drivers/ethercat/src/port.rs", "names the clock by which the kernel ends a wait"),
            ("drivers/can/src/port.rs", "names the clock by which the kernel ends a wait"),
        ],
        tests: false,
        remedy: "take the release from `Cycle`, or a `Nanos` as an argument",
    },
    Ban {
        what: "prints",
        words: &["println!", "eprintln!", "print!", "eprint!"],
        rooms: ALL,
        except: &[("machine/build.rs", "a build script speaks to cargo")],
        tests: false,
        remedy: "return a value; the command line says it by `console::out`, which does not panic",
    },
    Ban {
        what: "is debris",
        words: &["dbg!", concat!("to", "do!"), "unimplemented!"],
        rooms: ALL,
        except: &[],
        tests: true,
        remedy: "finish it",
    },
    Ban {
        what: "calls an elementary function of the platform",
        words: ELEMENTARY,
        rooms: DETERMINISTIC,
        except: &[],
        tests: true,
        remedy: "call `libm::`, or multiply out",
    },
    Ban {
        what: "takes Fourier transforms, whose last bits are the processor's",
        words: &["realfft*", "rustfft*"],
        rooms: ALL,
        except: &[("contact/src/space/fourier.rs", "the one place that convolves cells")],
        tests: true,
        remedy: "convolve by `contact::space`'s cells, and hash nothing of it",
    },
    Ban {
        what: "stands on cells, whose last bits are the processor's",
        words: &["space::surface*", "space::grip*"],
        rooms: &["hal/src/", "rtcore/src/", "signal/src/", "tasks/", "sim/src/"],
        except: &[],
        tests: true,
        remedy: "press a sphere, a pin or a bar: their bits are the same everywhere",
    },
    Ban {
        what: "orders memory by hand",
        words: &[
            "UnsafeCell",
            "Atomic*",
            "Ordering::Relaxed",
            "Ordering::Acquire",
            "Ordering::Release",
            "Ordering::AcqRel",
            "Ordering::SeqCst",
        ],
        rooms: ALL,
        except: &[
            ("machine/boards/src/epoch.rs", "one word that is written once, before the first job"),
            ("rtcore/src/guard.rs", "a switch that any thread may read"),
            ("rtcore/src/linux/runaway.rs", "a limit of the process, read by a signal's handler"),
            ("rtcore/src/live", "start and stop of the lanes' threads"),
            ("rtcore/src/mapping.rs", "a reader after the end must find writes in their order"),
            ("rtcore/src/activity.rs", "the task that runs now, for whoever looks from outside"),
            ("rtcore/src/lateness.rs", "counts for whoever looks from outside"),
            ("rtcore/src/virtual_time.rs", "the flag that stops a run"),
            ("rtcore/src/replay.rs", "the flag that stops a replay"),
            ("drivers/regmap/src/io.rs", "a register file is shared with a device"),
            ("drivers/regmap/src/acquisition.rs", "halves in different lanes start a conversion"),
            ("drivers/exchange/src/share.rs", "halves share an exchange, one at a time"),
            ("drivers/ethercat/src/health.rs", "counts for whoever looks from outside"),
            ("drivers/mesa/src/link.rs", "counts for whoever looks from outside"),
            ("drivers/serial/src/monitor.rs", "counts for whoever looks from outside"),
            ("drivers/netft/src/monitor.rs", "counts for whoever looks from outside"),
            ("drivers/can/src/monitor.rs", "counts for whoever looks from outside"),
            ("lab/command/src/run", "a signal sets the flag that ends a run"),
            ("lab/scene/src/", "virtual time asks for a flag that ends it"),
            ("lab/experiment/src/", "threads take runs off a plan until a flag ends them"),
            ("lab/host/src/jitter/", "a flag ends the load's threads and a measurement"),
            ("machine/service/src/service.rs", "a flag ends the service"),
            ("machine/service/src/recording.rs", "whether an operator wants a recording"),
            ("machine/operator/src/", "words between the server's thread and the records'"),
            ("machine/src/operator/mod.rs", "a stop overtakes the ring"),
            ("machine/console/src/background.rs", "counts what a thread has still to do"),
            ("machine/console/src/signals.rs", "a signal sets the flag that ends a program"),
        ],
        tests: false,
        remedy: "send values through `hal::link` or a port",
    },
    Ban {
        what: "names the scheduler, an affinity, a memory lock or a clock sleep",
        words: &[
            "thread_priority*",
            "ThreadPriority*",
            "sched_*",
            "CpuSet",
            "mlock*",
            "munlock*",
            "clock_nanosleep",
            "setrlimit",
        ],
        rooms: ALL,
        except: &[("rtcore/src/linux", "the one place that asks the kernel")],
        tests: true,
        remedy: "declare it in the lane's configuration",
    },
    Ban {
        what: "starts or suspends a thread",
        words: &["thread::spawn", "thread::sleep", "thread::Builder", "thread::scope"],
        rooms: PURE,
        except: &[],
        tests: false,
        remedy: "lanes and their threads belong to rtcore",
    },
    Ban {
        what: "waits for another thread",
        words: &["Mutex", "RwLock", "Condvar", "Barrier", "mpsc", "OnceLock", "LazyLock"],
        rooms: LANE,
        except: &[
            ("rtcore/src/live.rs", "lanes' threads answer once, before the first job"),
            ("rtcore/src/linux/runaway.rs", "what a signal did before, set once and then read"),
            ("drivers/comedi/src/sharing.rs", "a lock that is tried and never waited for"),
        ],
        tests: false,
        remedy: "send values through `hal::link` or a port",
    },
    Ban {
        what: "opens a file or parses text",
        words: &[
            "std::fs",
            "fs::*",
            "File::*",
            "OpenOptions",
            "BufReader",
            "toml::*",
            "serde_json::*",
        ],
        rooms: ALL,
        except: &[
            ("lab/", "instruments know files and formats"),
            ("machine/", "descriptions are files, and so is what `cpus` asks the kernel"),
            ("record/src/", "a recording is a file"),
            ("drivers/regmap/src/io.rs", "a register file is a device node"),
            ("drivers/regmap/src/boards.rs", "the registers of a board are described by a file"),
            ("drivers/regmap/src/shipped.rs", "descriptions of boards are TOML"),
            ("drivers/regmap/emulator/src/memory.rs", "an emulated board is a shared file"),
            ("drivers/comedi/src/device.rs", "a Comedi board is a device node"),
            ("drivers/template/src/lib.rs", "channels of the kernel's industrial I/O are files"),
            ("drivers/serial/src/port.rs", "a serial port is a device node"),
            ("drivers/serial/emulator/src/terminal.rs", "a pseudo-terminal has a link as its name"),
            ("rtcore/src/linux.rs", "what the kernel says of itself, before the first job"),
            ("rtcore/src/mapping.rs", "a flight recorder is a file in memory, made before a run"),
        ],
        tests: false,
        remedy: "take a value; applications read and parse",
    },
    Ban {
        what: "draws a random number",
        words: &["rand_chacha", "ChaCha*", "rand_core", "rand::*"],
        rooms: ALL,
        except: &[("sim/src/prng.rs", "one seed, one stream a source")],
        tests: false,
        remedy: "take a stream of sim's generator",
    },
    Ban {
        what: "has an order that differs from run to run",
        words: &["HashMap", "HashSet", "RandomState"],
        rooms: DETERMINISTIC,
        except: &[],
        tests: false,
        remedy: "BTreeMap, BTreeSet or a sorted array",
    },
    Ban {
        what: "panics on the lane path",
        words: &["panic!", "unreachable!", ".unwrap("],
        rooms: &["tasks/", "signal/src/"],
        except: &[],
        tests: false,
        remedy: "refuse the value, raise a fault, keep the last good one",
    },
];

/// Methods and paths whose last bits depend on the platform.
const ELEMENTARY: &[&str] = &[
    ".sin(",
    ".cos(",
    ".tan(",
    ".asin(",
    ".acos(",
    ".atan(",
    ".atan2(",
    ".sin_cos(",
    ".sinh(",
    ".cosh(",
    ".tanh(",
    ".asinh(",
    ".acosh(",
    ".atanh(",
    ".exp(",
    ".exp2(",
    ".exp_m1(",
    ".ln(",
    ".ln_1p(",
    ".log(",
    ".log2(",
    ".log10(",
    ".powi(",
    ".powf(",
    ".hypot(",
    ".cbrt(",
    ".mul_add(",
    "f64::sin",
    "f64::cos",
    "f64::tan",
    "f64::exp",
    "f64::ln",
    "f64::powi",
    "f64::powf",
    "f64::atan2",
    "f64::hypot",
    "f64::mul_add",
];

/// Complaints of the bans about the tree.
pub(crate) fn violations(files: &[Rust], bans: &[Ban]) -> Vec<String> {
    let mut found = Vec::new();
    for ban in bans {
        for file in files {
            if !ban.except.iter().any(|(prefix, _)| file.path.starts_with(prefix)) {
                found.extend(in_file(file, ban));
            }
        }
        for (prefix, reason) in ban.except {
            let used = files
                .iter()
                .filter(|file| file.path.starts_with(prefix))
                .any(|file| file.lines.iter().any(|line| banned_word(&line.code, ban).is_some()));
            if !used {
                found
                    .push(format!("{prefix}: no line {}; drop its exception ({reason})", ban.what));
            }
        }
    }
    found
}

/// Complaints of one ban about one file, its exceptions apart.
pub(crate) fn in_file(file: &Rust, ban: &Ban) -> Vec<String> {
    if !ban.rooms.iter().any(|room| file.path.starts_with(room)) {
        return Vec::new();
    }
    let mut found = Vec::new();
    for (number, line) in file.lines.iter().enumerate() {
        if line.test && !ban.tests {
            continue;
        }
        if let Some(word) = banned_word(&line.code, ban) {
            let place = format!("{}:{}", file.path, number + 1);
            found.push(format!("{place}: `{word}` {}; {}", ban.what, ban.remedy));
        }
    }
    found
}

/// The first banned word on a line.
fn banned_word(code: &str, ban: &Ban) -> Option<&'static str> {
    ban.words.iter().find(|word| find_word(code, word)).copied()
}

/// Whether `code` holds `word` as a whole; a `*` at its end lets the word go on.
pub(crate) fn find_word(code: &str, word: &str) -> bool {
    let (core, open) = word.strip_suffix('*').map_or((word, false), |core| (core, true));
    code.match_indices(core).any(|(at, _)| {
        let before = code[..at].chars().next_back();
        let after = code[at + core.len()..].chars().next();
        let starts = !core.starts_with(is_word) || !before.is_some_and(is_word);
        let ends = open || !core.ends_with(is_word) || !after.is_some_and(is_word);
        starts && ends
    })
}

#[test]
fn words_are_whole_words() {
    assert!(find_word("let t = Instant::now();", "Instant"));
    assert!(!find_word("let t = Instantly::now();", "Instant"));
    assert!(!find_word("eprintln!(x)", "println!"));
    assert!(find_word("AtomicBool::new(true)", "Atomic*"));
    assert!(!find_word("NonAtomic", "Atomic*"));
    assert!(find_word("x.sin()", ".sin("));
    assert!(!find_word("libm::sin(x)", ".sin("));
    assert!(!find_word("x.sin_cos()", ".sin("));
}

#[test]
fn every_ban_can_complain_and_can_be_silent() {
    for ban in BANS {
        let room = format!("{}src/x.rs", ban.rooms[0].trim_end_matches("src/"));
        for word in ban.words {
            let spoken = word.replace('*', "x");
            let bad = Rust::new(&room, &format!("//! x\nfn f() {{ a{spoken} {spoken}b) }}\n"));
            let bad_word = Rust::new(&room, &format!("//! x\nfn f() {{ {spoken} }}\n"));
            let complaints = in_file(&bad, ban).len() + in_file(&bad_word, ban).len();
            assert!(complaints > 0, "`{word}` in {room} goes unseen");
            let comment =
                Rust::new(&room, &format!("//! {spoken}\nfn f() {{ g(\"{spoken}\") }}\n"));
            assert!(in_file(&comment, ban).is_empty(), "`{word}` in a comment or a string");
            let test =
                format!("//! x\n#[cfg(test)]\nmod tests {{\n    fn f() {{ {spoken} }}\n}}\n");
            let test = in_file(&Rust::new(&room, &test), ban);
            assert_eq!(test.is_empty(), !ban.tests, "`{word}` in a test");
        }
    }
}

#[test]
fn a_ban_holds_in_its_rooms_only() {
    let clocks = BANS.iter().find(|ban| ban.what == "asks the time").expect("there is such a ban");
    let clocks = Ban { except: &[("rtcore/src/linux.rs", "asks")], ..*clocks };
    let raw = "//! x\nfn f() { Instant::now() }\n";
    let tree = [Rust::new("rtcore/src/linux.rs", raw), Rust::new("sim/src/x.rs", raw)];
    let found = violations(&tree, &[clocks]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].starts_with("sim/src/x.rs:2: "));
}

#[test]
fn an_exception_that_nothing_uses_is_seen() {
    for ban in BANS {
        let found = violations(&[], core::slice::from_ref(ban));
        assert_eq!(found.len(), ban.except.len(), "{}", ban.what);
    }
}
