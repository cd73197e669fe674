//! Makes wrong variants of the executor's own file by changing one word each. A replacement that
//! finds nothing is an error, because the file has changed and the variant would be the correct
//! file.

use std::path::Path;

const SOURCE: &str = "../../rtcore/src/live/flags.rs";

/// Name of the variant, what stands in the file, what stands there instead.
const WRONG: [(&str, &str, &str); 8] = [
    (
        "done_relaxed_store",
        "self.0.store(jobs, Ordering::Release)",
        "self.0.store(jobs, Ordering::Relaxed)",
    ),
    (
        "done_relaxed_load",
        "// Acquire: pairs with the store in `publish`.\n        self.0.load(Ordering::Acquire)",
        "self.0.load(Ordering::Relaxed)",
    ),
    (
        "start_relaxed_store",
        "self.0.store(signal as u8, Ordering::Release)",
        "self.0.store(signal as u8, Ordering::Relaxed)",
    ),
    (
        "start_relaxed_load",
        "match self.0.load(Ordering::Acquire)",
        "match self.0.load(Ordering::Relaxed)",
    ),
    (
        "arrivals_relaxed_add",
        "self.0.fetch_add(1, Ordering::Release)",
        "self.0.fetch_add(1, Ordering::Relaxed)",
    ),
    (
        "arrivals_load_and_store",
        "self.0.fetch_add(1, Ordering::Release)",
        "self.0.store(self.0.load(Ordering::Acquire) + 1, Ordering::Release)",
    ),
    (
        "slip_load_and_store",
        "self.0.fetch_max(ns, Ordering::Relaxed)",
        "if ns > self.0.load(Ordering::Relaxed) { self.0.store(ns, Ordering::Relaxed) }",
    ),
    (
        "storms_load_and_store",
        "self.0.fetch_add(storms, Ordering::Relaxed)",
        "self.0.store(self.0.load(Ordering::Relaxed) + storms, Ordering::Relaxed)",
    ),
];

fn main() {
    println!("cargo::rerun-if-changed={SOURCE}");
    println!("cargo::rerun-if-changed=build.rs");
    let source = std::fs::read_to_string(SOURCE).expect("the executor's file is there");
    // An included file may not begin with a comment on the module around it, and stands deeper
    // here.
    let body: String = source
        .lines()
        .filter(|line| !line.starts_with("//!"))
        .map(|line| format!("{}\n", line.replace("pub(super)", "pub(crate)")))
        .collect();
    let out = std::env::var("OUT_DIR").expect("cargo says where");
    let write = |name: &str, text: &str| {
        std::fs::write(Path::new(&out).join(format!("{name}.rs")), text)
            .expect("it can be written");
    };
    write("right", &body);
    for (name, from, to) in WRONG {
        assert!(body.contains(from), "{name}: `{from}` does not stand in {SOURCE}");
        write(name, &body.replacen(from, to, 1));
    }
}
