//! Finds files of one crate that use each other in a circle. An arrow goes from the file that names
//! something to the file that defines it. Declarations of modules, tests, and what a module takes
//! from its own submodules, which are its parts, are no arrows.

use std::collections::{BTreeMap, BTreeSet};

use crate::ratchet::Complaint;
use crate::source::Rust;
use crate::tokens::definitions;
use crate::uses::{Use, uses};

/// Circles that the whole repository may have, and the number beyond it is what the ratchet counts.
const CIRCLES_MAX: usize = 8;
/// Folders in which no two files use each other.
const FOLDERS_WITHOUT_CIRCLES: &[&str] = &["contact/src/space/pin/"];
/// Imports that are followed from one module to the next.
const FORWARDS_MAX: usize = 8;

/// A file as a module of its crate.
struct Module {
    /// Names of modules from the root of the crate.
    path: Vec<String>,
    /// Path of the file.
    file: String,
    defined: BTreeSet<String>,
    uses: Vec<Use>,
}

/// The modules of one crate.
struct Crate {
    modules: Vec<Module>,
    by_path: BTreeMap<Vec<String>, usize>,
}

/// Arrows between files by their paths.
pub(crate) type Arrows = BTreeMap<String, BTreeSet<String>>;

/// Each circle of files, its members sorted.
pub(crate) fn circles(files: &[Rust]) -> Vec<Vec<String>> {
    let mut crates: BTreeMap<&str, Vec<&Rust>> = BTreeMap::new();
    for file in files {
        if let Some((folder, _)) = file.path.split_once("/src/") {
            crates.entry(folder).or_default().push(file);
        }
    }
    let graphs = crates.into_values().map(|files| Crate::new(&files).arrows());
    graphs.flat_map(|arrows| components(&arrows)).collect()
}

/// Complaints about each circle, counted for the crate.
pub(crate) fn by_crate(circles: &[Vec<String>]) -> Vec<Complaint> {
    circles.iter().map(|circle| complaint(circle)).collect()
}

/// Complaints about the circles that are too many in all, counted for the repository.
pub(crate) fn beyond_limit(circles: &[Vec<String>]) -> Vec<Complaint> {
    let text = format!("more than {CIRCLES_MAX} circles of files in all");
    circles.iter().skip(CIRCLES_MAX).map(|_| Complaint::of_room("repository", &text)).collect()
}

/// Complaints about circles where none may be.
pub(crate) fn in_closed_folders(circles: &[Vec<String>]) -> Vec<Complaint> {
    let closed = |file: &String| FOLDERS_WITHOUT_CIRCLES.iter().any(|path| file.starts_with(path));
    let found = circles.iter().filter(|circle| circle.iter().any(closed));
    found.map(|circle| complaint(circle)).collect()
}

fn complaint(circle: &[String]) -> Complaint {
    let text = format!("{} files use each other: {}", circle.len(), circle.join(", "));
    Complaint::new(&circle[0], 1, &text)
}

/// The circles of a graph: groups in which every member reaches every other one.
pub(crate) fn components(arrows: &Arrows) -> Vec<Vec<String>> {
    let reachable = |from: &String| {
        let mut found = BTreeSet::new();
        let mut open = vec![from];
        while let Some(next) = open.pop() {
            let new = arrows.get(next).into_iter().flatten();
            open.extend(new.filter(|name| found.insert((*name).clone())));
        }
        found
    };
    let reachable: BTreeMap<&String, BTreeSet<String>> =
        arrows.keys().map(|name| (name, reachable(name))).collect();
    let mut circles = BTreeSet::new();
    for (name, targets) in &reachable {
        let back = |other: &&String| reachable.get(other).is_some_and(|back| back.contains(*name));
        let circle: Vec<String> = targets.iter().filter(back).cloned().collect();
        if circle.len() > 1 {
            circles.insert(circle);
        }
    }
    circles.into_iter().collect()
}

impl Crate {
    fn new(files: &[&Rust]) -> Crate {
        let mut modules = Vec::new();
        let mut by_path = BTreeMap::new();
        for file in files {
            let tokens = crate::tokens::tokens(file, false);
            let defined = definitions(&tokens).into_iter().filter(|found| found.kind != "module");
            let path = module_path(&file.path);
            // A library's root comes before a program's of the same crate.
            by_path.entry(path.clone()).or_insert(modules.len());
            modules.push(Module {
                path,
                file: file.path.clone(),
                defined: defined.map(|found| found.name).collect(),
                uses: uses(&tokens),
            });
        }
        Crate { modules, by_path }
    }

    /// The arrows from each file to the files whose names it uses.
    fn arrows(&self) -> Arrows {
        let mut arrows = Arrows::new();
        for (from, module) in self.modules.iter().enumerate() {
            let targets = arrows.entry(module.file.clone()).or_default();
            for used in module.uses.iter().filter(|used| !used.forwards) {
                let whole = used.imports && used.name != "*";
                let target = self.target(from, &used.path, whole, FORWARDS_MAX);
                let own = |target: usize| self.modules[target].path.starts_with(&module.path);
                if let Some(target) = target.filter(|target| !own(*target)) {
                    targets.insert(self.modules[target].file.clone());
                }
            }
        }
        arrows
    }

    /// The module that defines what a path names; `None` for names of other crates, and for an
    /// import of a whole module, which says nothing before its names are used.
    fn target(&self, from: usize, path: &[String], imports: bool, left: usize) -> Option<usize> {
        let here = &self.modules[from].path;
        let (first, rest) = path.split_first()?;
        let mut at = match first.as_str() {
            "crate" => Vec::new(),
            "self" => here.clone(),
            "super" => here.split_last()?.1.to_vec(),
            _ => {
                let child = [here.as_slice(), core::slice::from_ref(first)].concat();
                if !self.by_path.contains_key(&child) {
                    return self.forwarded(from, path, left);
                }
                child
            }
        };
        for (number, name) in rest.iter().enumerate() {
            if name == "super" {
                at.pop()?;
                continue;
            }
            if name == "self" {
                continue;
            }
            at.push(name.clone());
            if !self.by_path.contains_key(&at) {
                at.pop();
                let module = *self.by_path.get(&at)?;
                let rest = &rest[number..];
                if self.modules[module].defined.contains(name) {
                    return Some(module);
                }
                return self.forwarded(module, rest, left).or(Some(module));
            }
        }
        self.by_path.get(&at).copied().filter(|_| !imports)
    }

    /// Follows an import of the module that binds the first name of the path.
    fn forwarded(&self, module: usize, path: &[String], left: usize) -> Option<usize> {
        let left = left.checked_sub(1)?;
        let (name, rest) = path.split_first()?;
        let imports = || self.modules[module].uses.iter().filter(|used| used.imports);
        if let Some(import) = imports().find(|import| import.name == *name) {
            let whole: Vec<String> = import.path.iter().chain(rest).cloned().collect();
            return self.target(module, &whole, false, left);
        }
        imports().filter(|import| import.name == "*").find_map(|import| {
            let inside = self.target(module, &import.path, false, left)?;
            let defined = inside != module && self.modules[inside].defined.contains(name);
            defined.then_some(inside)
        })
    }
}

/// The names of a file's module from the root of its crate.
fn module_path(file: &str) -> Vec<String> {
    let inside = file.split_once("/src/").map_or(file, |(_, inside)| inside);
    let inside = inside.strip_suffix(".rs").unwrap_or(inside);
    let mut path: Vec<String> = inside.split('/').map(str::to_string).collect();
    let last = path.last().map_or("", String::as_str);
    if last == "mod" || (path.len() == 1 && (last == "lib" || last == "main")) {
        path.pop();
    }
    path
}

#[cfg(test)]
fn found(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    let files: Vec<Rust> =
        files.iter().map(|(path, raw)| Rust::new(&format!("x/src/{path}"), raw)).collect();
    circles(&files)
}

#[test]
fn files_that_use_each_other_are_seen() {
    let circle = [vec!["x/src/a.rs".to_string(), "x/src/b/mod.rs".to_string()]];
    for (a, b) in [
        ("use crate::b::B;\nstruct A;", "use super::a::A;\nstruct B;"),
        ("fn a() { crate::b::b() }", "use crate::a;\nfn b() { a::a() }"),
        ("use crate::{b::{self, B as C}, c};\nstruct A;", "use crate::a::*;\nstruct B;"),
        ("use crate::B;\nstruct A;", "use crate::A;\nstruct B;"),
    ] {
        let root = "mod a; mod b; pub use a::A; pub use b::B;";
        assert_eq!(found(&[("lib.rs", root), ("a.rs", a), ("b/mod.rs", b)]), circle, "{a}");
    }
    let three = found(&[
        ("a.rs", "use crate::b::B; struct A;"),
        ("b.rs", "use crate::c::C; struct B;"),
        ("c.rs", "use crate::a::A; struct C;"),
    ]);
    assert_eq!(three[0].len(), 3);
    assert_eq!(by_crate(&three)[0].room, "x/src");
}

#[test]
fn declarations_and_tests_are_not_counted_as_imports() {
    assert!(found(&[("lib.rs", "mod a; pub use a::A;"), ("a.rs", "use crate::L;")]).is_empty());
    let test = "#[cfg(test)]\nmod tests {\n    use crate::a::A;\n}\nstruct B;";
    assert!(found(&[("a.rs", "use crate::b::B; struct A;"), ("b.rs", test)]).is_empty());
    assert!(found(&[("a.rs", "use crate::b::B;"), ("b.rs", "use other::a::A;")]).is_empty());
    let sibling = [
        ("p/mod.rs", "mod a; mod b; pub use a::A; use b::B; struct P { b: B }"),
        ("p/a.rs", "struct A;"),
        ("p/b.rs", "use super::A; struct B;"),
    ];
    assert!(found(&sibling).is_empty());
    let part =
        [("p.rs", "mod a; use a::A; struct P { a: A }"), ("p/a.rs", "use super::P; struct A;")];
    assert!(found(&part).is_empty());
}

#[test]
fn circles_beyond_the_limit_are_counted() {
    let circle = vec!["contact/src/space/pin/a.rs".to_string(), "x/src/b.rs".to_string()];
    assert!(beyond_limit(&vec![circle.clone(); CIRCLES_MAX]).is_empty());
    assert_eq!(beyond_limit(&vec![circle.clone(); CIRCLES_MAX + 2]).len(), 2);
    assert_eq!(in_closed_folders(&[circle]).len(), 1);
    assert!(in_closed_folders(&[vec!["x/src/b.rs".to_string()]]).is_empty());
}
