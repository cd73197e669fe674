//! The picture of a live run on a terminal of 80 by 24 characters.

use std::time::Duration;

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use taktil_lab_command::run::{Options, run};
use taktil_top::{MachineView, draw};

fn picture(view: &MachineView) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(80, 24)).unwrap();
    terminal.draw(|frame| draw(frame, view)).unwrap();
    let buffer = terminal.backend().buffer().clone();
    let row = |y: u16| (0..80).map(|x| buffer[(x, y)].symbol().to_owned()).collect::<String>();
    (0..24).map(row).collect()
}

#[test]
fn a_machine_that_is_not_there_is_told_and_found_when_it_comes() {
    let folder = std::env::temp_dir().join(format!("taktil-top-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let socket = folder.join("op");
    let mut view = MachineView::new(socket.clone());
    view.refresh();
    let text = picture(&view).join("\n");
    assert!(text.contains("no machine at"), "{text}");

    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes/roll-pin.toml");
    let options = Options {
        scene: scene.into(),
        operator: Some(socket),
        for_s: Some(6.0),
        json: true,
        ..Options::default()
    };
    let machine = std::thread::spawn(move || run(&options).map(|_| ()));
    let mut seen = Vec::new();
    // The run ends by itself, so that the loop does too.
    while !machine.is_finished() {
        view.refresh();
        if view.is_connected() {
            seen.push(picture(&view));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    machine.join().unwrap().unwrap();
    let any = |words: &[&str]| {
        seen.iter().any(|rows| words.iter().all(|word| rows.iter().any(|row| row.contains(word))))
    };
    assert!(any(&["SIMULATED", "TACTILE-SERVO", "mode MOVING", "no fault"]), "{:#?}", seen.last());
    assert!(any(&["servo", "touch", "world", "2.50", "5.00"]), "the lanes with their periods");
    assert!(any(&["  1 [", "  6 [", "-180.0"]), "six joints with their angles");
    assert!(any(&["touch: M0", "██"]), "the image of the pressed pin");
    assert!(any(&["allowed: ", "stop", "idle"]), "what is allowed");
    view.refresh();
    assert!(picture(&view).join("\n").contains("GONE"), "the end is told");
    let _ = std::fs::remove_dir_all(&folder);
}
