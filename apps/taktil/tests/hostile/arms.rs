//! Robot descriptions that are no robots: deep, large, looped, and with numbers that are none.

use crate::content::Verdict;

/// How deep elements stand within each other, and how many there are of some.
const ELEMENTS_NESTED: usize = 20_000;
/// Links of a large file.
const LINKS_COUNT: usize = 5_000;

fn robot(inner: &str) -> String {
    format!("<robot name=\"r\">{inner}</robot>")
}

fn joint(name: &str, kind: &str, parent: &str, child: &str) -> String {
    format!(
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/>\
         <child link=\"{child}\"/>\
         <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
    )
}

fn links(count: usize) -> String {
    (0..count).map(|number| format!("<link name=\"l{number}\"/>")).collect()
}

/// A chain of `count` joints of a kind behind a turning one.
fn chain(count: usize, kind: &str) -> String {
    let joints =
        (2..count).map(|n| joint(&format!("j{n}"), kind, &format!("l{}", n - 1), &format!("l{n}")));
    let first = joint("j1", "revolute", "l0", "l1");
    robot(&format!("{}{first}{}", links(count), joints.collect::<String>()))
}

/// Links that are all fixed to the base, and one that turns.
fn star(count: usize) -> String {
    let joints = (2..count).map(|n| joint(&format!("j{n}"), "fixed", "l0", &format!("l{n}")));
    let first = joint("j1", "revolute", "l0", "l1");
    robot(&format!("{}{first}{}", links(count), joints.collect::<String>()))
}

/// A good arm of one joint with something else in it.
fn altered(from: &str, to: &str) -> String {
    let good = robot(&format!("{}{}", links(2), joint("j1", "revolute", "l0", "l1")));
    let text = good.replace(from, to);
    assert_ne!(text, good, "{from}");
    text
}

/// Names, texts, and whether they have to be refused.
pub(crate) fn kinds() -> Vec<(&'static str, String, Verdict)> {
    let mut all = trees();
    all.extend(numbers());
    all.extend(words());
    all
}

/// What is wrong with elements, links and joints.
fn trees() -> Vec<(&'static str, String, Verdict)> {
    use Verdict::Refused;
    let spaces: String = (0..ELEMENTS_NESTED).map(|n| format!("<a xmlns:n{n}=\"x\">")).collect();
    let attributes: String = (0..ELEMENTS_NESTED).map(|n| format!(" a{n}=\"1\"")).collect();
    vec![
        ("20,000 elements within each other", robot(&nested("a", ELEMENTS_NESTED)), Refused),
        ("200,000 unclosed elements", "<robot>".to_owned() + &"<a>".repeat(200_000), Refused),
        ("200,000 empty elements", robot(&"<a/>".repeat(200_000)), Refused),
        ("200,000 comments", robot(&"<!-- -->".repeat(200_000)), Refused),
        ("closing elements only", "</a>".repeat(ELEMENTS_NESTED), Refused),
        ("namespaces within each other", robot(&spaces), Refused),
        ("an element of many attributes", format!("<robot{attributes}/>"), Refused),
        ("an attribute twice", "<robot name=\"a\" name=\"b\"/>".to_owned(), Refused),
        ("entities of entities", laughs(), Refused),
        ("an entity of a file", entity_of_file(), Refused),
        ("a chain of 5,000 fixed links", chain(LINKS_COUNT, "fixed"), Refused),
        ("a chain of 5,000 turning links", chain(LINKS_COUNT, "revolute"), Refused),
        ("5,000 fixed links side by side", star(LINKS_COUNT), Refused),
        (
            "a loop",
            robot(&format!(
                "{}{}{}",
                links(2),
                joint("a", "fixed", "l0", "l1"),
                joint("b", "fixed", "l1", "l0")
            )),
            Refused,
        ),
        (
            "a loop beside a base",
            robot(&format!(
                "{}{}{}",
                links(3),
                joint("a", "fixed", "l1", "l2"),
                joint("b", "fixed", "l2", "l1")
            )),
            Refused,
        ),
        ("a link that holds itself", altered("link=\"l1\"", "link=\"l0\""), Refused),
        ("a link twice", altered("<link name=\"l1\"/>", "<link name=\"l0\"/>"), Refused),
        ("a link that is not there", altered("<link name=\"l1\"/>", ""), Refused),
    ]
}

/// What is wrong with numbers.
fn numbers() -> Vec<(&'static str, String, Verdict)> {
    use Verdict::{Any, Refused};
    vec![
        (
            "limits exchanged",
            altered("lower=\"-1\" upper=\"1\"", "lower=\"1\" upper=\"-1\""),
            Refused,
        ),
        ("a limit that is no number", altered("lower=\"-1\"", "lower=\"nan\""), Refused),
        ("an infinite limit", altered("upper=\"1\"", "upper=\"inf\""), Any),
        ("a limit in degrees", altered("upper=\"1\"", "upper=\"180\""), Refused),
        ("a limit of two numbers", altered("upper=\"1\"", "upper=\"1 2\""), Refused),
        ("a speed below 0", altered("velocity=\"1\"", "velocity=\"-1\""), Refused),
        ("a huge speed", altered("velocity=\"1\"", "velocity=\"1e308\""), Any),
        ("an axis of length 0", altered("xyz=\"0 0 1\"", "xyz=\"0 0 0\""), Refused),
        ("an axis of nan", altered("xyz=\"0 0 1\"", "xyz=\"nan 0 0\""), Refused),
        ("a tiny axis", altered("xyz=\"0 0 1\"", "xyz=\"5e-324 0 0\""), Any),
        ("an axis of four numbers", altered("xyz=\"0 0 1\"", "xyz=\"0 0 1 1\""), Refused),
        ("an axis of a million numbers", altered("0 0 1", &"0 ".repeat(1 << 19)), Refused),
        ("a mass below 0", with_mass("-1", "1"), Refused),
        ("a mass of nan", with_mass("nan", "1"), Refused),
        ("an inertia below 0", with_mass("1", "-1"), Any),
        ("a huge inertia", with_mass("1", "1e308"), Any),
        (
            "a place that overflows",
            altered("<axis", "<origin xyz=\"1e308 1e308 1e308\"/><axis"),
            Any,
        ),
        ("a turn of infinity", altered("<axis", "<origin rpy=\"inf 0 0\"/><axis"), Refused),
    ]
}

/// What is wrong with names and the text around.
fn words() -> Vec<(&'static str, String, Verdict)> {
    use Verdict::{Any, Refused};
    let long = "n".repeat(1 << 20);
    vec![
        ("a long name", altered("\"j1\"", &format!("\"{long}\"")), Refused),
        ("escape sequences as a name", altered("\"j1\"", "\"&#x1b;[2J\""), Any),
        ("escape sequences in the text", altered("<axis", "\u{1b}[2J<axis"), Any),
        ("turned writing as a name", altered("\"j1\"", "\"\u{202e}1j\""), Any),
        ("no type", altered("type=\"revolute\"", ""), Refused),
        ("a long type", altered("revolute", &long), Refused),
        ("a joint that is planar", altered("revolute", "planar"), Refused),
        ("a macro", altered("<axis", "<xacro:a xmlns:xacro=\"http://xacro\"/><axis"), Refused),
        ("HTML", "<!DOCTYPE html><html><body/></html>".to_owned(), Refused),
        ("text behind the end", altered("</robot>", "</robot> x"), Any),
        ("two roots", altered("</robot>", "</robot><robot/>"), Refused),
        (
            "UTF-16 promised",
            altered("<robot", "<?xml version=\"1.0\" encoding=\"UTF-16\"?><robot"),
            Any,
        ),
    ]
}

fn nested(name: &str, depth: usize) -> String {
    format!("<{name}>").repeat(depth) + &format!("</{name}>").repeat(depth)
}

fn with_mass(mass: &str, moment: &str) -> String {
    let inertial = format!(
        "<link name=\"l1\"><inertial><mass value=\"{mass}\"/><inertia ixx=\"{moment}\" ixy=\"0\" \
         ixz=\"0\" iyy=\"{moment}\" iyz=\"0\" izz=\"{moment}\"/></inertial></link>"
    );
    altered("<link name=\"l1\"/>", &inertial)
}

fn laughs() -> String {
    let entities: String = (1..9)
        .map(|n| format!("<!ENTITY e{n} \"{}\">", format!("&e{};", n - 1).repeat(10)))
        .collect();
    format!("<!DOCTYPE robot [<!ENTITY e0 \"ha\">{entities}]><robot name=\"&e8;\"/>")
}

fn entity_of_file() -> String {
    "<!DOCTYPE robot [<!ENTITY e SYSTEM \"file:///etc/passwd\">]><robot>&e;</robot>".to_owned()
}
