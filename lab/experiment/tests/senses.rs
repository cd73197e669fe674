//! Which sense a task needs: each task of the folder has the verdict that its title promises, and a
//! table that says so.

use std::path::Path;

use taktil_lab_experiment::senses::{Needed, page, run_tasks};

#[test]
fn each_task_needs_the_sense_that_it_was_made_for() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/senses");
    let due = [
        ("either", Needed::Either),
        ("force", Needed::Force),
        ("touch", Needed::Touch),
        ("both", Needed::Both),
    ];
    let paths: Vec<_> = due.iter().map(|(name, _)| folder.join(format!("{name}.toml"))).collect();
    let tasks = run_tasks(&paths, 2, None, |_| Ok(())).unwrap().unwrap();
    let text = page(&tasks, "taktil experiment senses");
    println!("{text}");
    for (task, (name, due)) in tasks.iter().zip(due) {
        assert_eq!(task.needed(), due, "{name}: {:?} of 2 seeds held", task.held());
        assert!(text.contains(&format!("| {} |", due.text())), "{name}");
        // What fails fails clearly, not by a hair.
        let [by_touch, by_force, _] = task.held();
        assert!([0, 2].contains(&by_touch) && [0, 2].contains(&by_force), "{name}");
    }
    assert_eq!(text.matches("\n## ").count(), 4);
}

#[test]
fn the_verdict_follows_from_what_each_sense_can_do() {
    assert_eq!(Needed::from_able([true, true, true]), Needed::Either);
    assert_eq!(Needed::from_able([true, false, true]), Needed::Touch);
    assert_eq!(Needed::from_able([false, true, false]), Needed::Force);
    assert_eq!(Needed::from_able([false, false, true]), Needed::Both);
    assert_eq!(Needed::from_able([false, false, false]), Needed::More);
}
