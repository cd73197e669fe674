//! The rules of STYLE.md and ARCHITECTURE.md that a machine can check: who may import whom, where
//! `unsafe` may stand, what a line may say in which crate, how long a file may be, how names and
//! comments are made, and whether the records are complete.
//!
//! Every rule is a function from text to complaints, and every rule is shown a text that it must
//! complain about: a rule that cannot fail protects nothing. Rules with exceptions count them in
//! `ratchet.toml`; the test that fails prints the file as it should be.

mod calls;
mod circles;
mod commands;
mod comments;
mod constants;
mod imports;
mod old_names;
mod planted;
mod ratchet;
mod records;
mod requirements;
mod sizes;
mod source;
mod structure;
mod text;
mod tokens;
mod tuples;
mod unsafety;
mod uses;

use source::Tree;

/// Fails with all complaints at once, one a line.
fn assert_no_complaints(rule: &str, complaints: &[String]) {
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
    assert_no_complaints("imports", &imports::violations(&table, &imports::crates()));
}

#[test]
fn the_service_cannot_contain_a_simulator() {
    let reachable = imports::reachable("apps/taktild", &imports::crates());
    assert!(reachable.contains("hal"), "the graph is empty: {reachable:?}");
    let instruments = imports::instruments(&reachable);
    assert!(instruments.is_empty(), "the shipped service reaches {instruments:?}: {reachable:?}");
}

#[test]
fn the_counts_of_the_ratchet_are_todays() {
    let tree = Tree::read();
    let circles = circles::circles(&tree.rust);
    let findings: ratchet::Findings = vec![
        ("alike_tuple_members", tuples::alike_members(&tree.rust)),
        ("constants_of_one_word", constants::of_one_word(&tree.rust)),
        ("refusals_of_nothing", comments::refusing_nothing(&tree.rust)),
        ("comments_that_are_fragments", comments::fragments(&tree.rust)),
        ("modules_without_first_sentence", comments::first_sentences(&tree.rust)),
        ("circles_of_files", circles::by_crate(&circles)),
        ("circles_beyond_the_limit", circles::beyond_limit(&circles)),
        ("circles_where_none_may_be", circles::in_closed_folders(&circles)),
        ("crates_too_large", structure::large_crates(&tree.rust)),
        ("applications_as_libraries", structure::applications_as_libraries(&tree.text)),
        ("pages_without_example", structure::pages_without_example(&tree.rust)),
    ];
    let text = source::read("tests/tests/tidy/ratchet.toml");
    assert_no_complaints("ratchet", &ratchet::violations(&text, &findings));
}

#[test]
fn old_names_do_not_come_back() {
    let tree = Tree::read();
    let list = source::read("tests/tests/tidy/old_names.txt");
    assert_no_complaints("old names", &old_names::violations(&list, &tree.rust, &tree.text));
}

#[test]
fn pages_name_what_exists() {
    let exists = |path: &str| source::root().join(path).exists();
    let known = commands::Known {
        program: commands::command_line(),
        targets: commands::targets(&imports::metadata()),
        exists: &exists,
    };
    assert_no_complaints("pages", &commands::violations(&Tree::read().text, &known));
}

#[test]
fn every_requirement_names_tests_that_exist() {
    let faults = requirements::fault_names(&source::read("rtcore/src/fault.rs"));
    assert!(faults.len() > 30, "only {} faults found", faults.len());
    let read = |path: &std::path::Path| std::fs::read_to_string(source::root().join(path)).ok();
    let page = source::read("docs/requirements.md");
    assert_no_complaints("requirements", &requirements::complaints(&page, &faults, read));
}

#[test]
fn the_repository_keeps_its_shape() {
    let paths: Vec<String> = Tree::read().sizes.into_iter().map(|(path, _)| path).collect();
    assert_no_complaints("folders at the root", &structure::top_folders(&paths));
    assert_no_complaints("circles of folders", &structure::circles_of_folders(&imports::crates()));
}

#[test]
fn unsafe_stands_where_it_is_listed_and_is_argued() {
    assert_no_complaints("unsafe", &unsafety::violations(&Tree::read().rust));
}

#[test]
fn every_module_opens_with_its_purpose() {
    assert_no_complaints("module docs", &text::undocumented_modules(&Tree::read().rust));
}

#[test]
fn no_line_is_in_the_wrong_room() {
    assert_no_complaints("banned calls", &calls::violations(&Tree::read().rust, calls::BANS));
}

#[test]
fn files_functions_and_lines_stay_short() {
    let ratchet = sizes::Ratchet::parse(&source::read("tests/tests/tidy/ratchet.toml"));
    assert_no_complaints("sizes", &sizes::violations(&Tree::read().rust, &ratchet));
}

#[test]
fn no_file_is_a_package_or_a_recording() {
    assert_no_complaints("bytes", &sizes::oversized_files(&Tree::read().sizes));
}

#[test]
fn no_text_mentions_a_particular_machine() {
    assert_no_complaints("words", &text::foreign_words(&Tree::read().text));
}

#[test]
fn no_room_is_a_junk_drawer() {
    assert_no_complaints("names", &text::junk_drawers(&Tree::read().text));
}

#[test]
fn ignored_tests_say_why() {
    assert_no_complaints("ignored tests", &text::ignored_without_reason(&Tree::read().rust));
}

#[test]
fn planted_bugs_apply() {
    let folder = source::root().join("tests/planted");
    let names = std::fs::read_dir(&folder).expect("tests/planted").flatten();
    let patches: Vec<(String, String)> = names
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".patch"))
        .map(|name| format!("tests/planted/{name}"))
        .map(|path| (path.clone(), source::read(&path)))
        .collect();
    assert!(patches.len() > 10, "only {} patches found", patches.len());
    match planted::stale(&source::root(), &patches) {
        Some(stale) => assert_no_complaints("planted bugs", &stale),
        None => eprintln!("skipped: there is no program git that could try them"),
    }
}

#[test]
fn every_decision_is_listed() {
    let (index, files) = records::decisions();
    assert_no_complaints("decisions", &records::unlisted_decisions(&index, &files));
}

#[test]
fn every_dependency_has_its_reason() {
    let root = source::read("Cargo.toml");
    let record = source::read(records::DEPENDENCIES);
    assert_no_complaints("dependencies", &records::unexplained_dependencies(&root, &record));
    let outside = source::read(records::OUTSIDE);
    assert_no_complaints(
        "outside",
        &records::unexplained_outside(&Tree::read().text, &root, &outside),
    );
}

#[test]
fn members_take_versions_from_the_root() {
    assert_no_complaints("versions", &records::own_versions(&Tree::read().text));
}

#[test]
fn every_relative_link_resolves() {
    let tree = Tree::read();
    assert_no_complaints(
        "links",
        &records::dead_links(&tree.text, |path| source::root().join(path).exists()),
    );
}

#[test]
fn the_toolchain_is_pinned_and_the_lock_file_is_public() {
    let toolchain = source::read("rust-toolchain.toml");
    let manifest = source::read("Cargo.toml");
    assert_no_complaints("toolchain", &records::unpinned_toolchain(&toolchain, &manifest));
    let ignore = source::read(".gitignore");
    assert_no_complaints("build output", &records::tracked_output(&ignore));
    assert_no_complaints("lock file", &records::lock_file(&source::read("Cargo.lock"), &ignore));
}
