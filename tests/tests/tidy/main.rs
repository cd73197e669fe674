//! The house rules as a test: who may import whom, where `unsafe` may stand, what a line may say in
//! which room, how long a file may be, and whether the records are complete. STYLE.md says the same
//! for people. Refuses opinions that a machine cannot check.
//!
//! Every rule is a function from text to complaints, and every rule is shown a text that it must
//! complain about: a rule that cannot fail protects nothing.

mod calls;
mod imports;
mod records;
mod sizes;
mod source;
mod text;
mod unsafety;

use source::Tree;

/// Fails with all complaints at once, one a line.
fn none(rule: &str, complaints: &[String]) {
    assert!(complaints.is_empty(), "{rule}: {} complaint(s)\n{}", complaints.len(), {
        complaints.join("\n")
    });
}

#[test]
fn the_tree_is_found() {
    let tree = Tree::read();
    assert!(tree.rust.len() > 50, "only {} Rust files found", tree.rust.len());
    for path in ["hal/src/lib.rs", "apps/taktil/src/main.rs", "tests/tests/tidy/main.rs"] {
        assert!(tree.rust.iter().any(|file| file.path == path), "{path} is not among them");
    }
}

#[test]
fn crates_import_what_the_table_allows() {
    let table = imports::Table::parse(&source::read("ARCHITECTURE.md"));
    none("imports", &imports::violations(&table, &imports::crates()));
}

#[test]
fn the_service_cannot_contain_a_simulator() {
    let reached = imports::reached("apps/taktild", &imports::crates());
    assert!(reached.contains("hal"), "the graph is empty: {reached:?}");
    assert!(!reached.contains("sim"), "the shipped service reaches sim through {reached:?}");
}

#[test]
fn unsafe_stands_where_it_is_listed_and_is_argued() {
    none("unsafe", &unsafety::violations(&Tree::read().rust));
}

#[test]
fn every_module_opens_with_its_purpose() {
    none("module docs", &text::undocumented_modules(&Tree::read().rust));
}

#[test]
fn no_line_is_in_the_wrong_room() {
    none("banned calls", &calls::violations(&Tree::read().rust, calls::BANS));
}

#[test]
fn files_functions_and_lines_stay_short() {
    let ratchet = sizes::Ratchet::parse(&source::read("tests/tests/tidy/ratchet.toml"));
    none("sizes", &sizes::violations(&Tree::read().rust, &ratchet));
}

#[test]
fn no_file_is_a_package_or_a_recording() {
    none("bytes", &sizes::heavy(&Tree::read().sizes));
}

#[test]
fn no_text_speaks_of_one_machine() {
    none("words", &text::foreign_words(&Tree::read().text));
}

#[test]
fn no_room_is_a_junk_drawer() {
    none("names", &text::junk_drawers(&Tree::read().text));
}

#[test]
fn ignored_tests_say_why() {
    none("ignored tests", &text::ignored_without_reason(&Tree::read().rust));
}

#[test]
fn every_decision_is_listed() {
    let (index, files) = records::decisions();
    none("decisions", &records::unlisted(&index, &files));
}

#[test]
fn every_dependency_has_its_reason() {
    let root = source::read("Cargo.toml");
    let record = source::read(records::DEPENDENCIES);
    none("dependencies", &records::unexplained(&root, &record));
    let outside = source::read(records::OUTSIDE);
    none("outside", &records::unexplained_outside(&Tree::read().text, &root, &outside));
}

#[test]
fn members_take_versions_from_the_root() {
    none("versions", &records::own_versions(&Tree::read().text));
}

#[test]
fn every_relative_link_resolves() {
    let tree = Tree::read();
    none("links", &records::dead_links(&tree.text, |path| source::root().join(path).exists()));
}

#[test]
fn the_toolchain_is_pinned_and_the_lock_file_is_public() {
    let toolchain = source::read("rust-toolchain.toml");
    let manifest = source::read("Cargo.toml");
    none("toolchain", &records::unpinned(&toolchain, &manifest));
    let ignore = source::read(".gitignore");
    none("build output", &records::taken_output(&ignore));
    none("lock file", &records::lock_file(&source::read("Cargo.lock"), &ignore));
}
