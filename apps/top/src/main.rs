//! The `taktil-top` process: a running machine on a terminal, over ssh too.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use taktil_machine_client::SERVICE_SOCKET;
use taktil_machine_console::out;
use taktil_top::{MachineView, draw};

/// Time between two pictures.
const PICTURE_INTERVAL: Duration = Duration::from_millis(100);

/// A running machine on a terminal of 80 by 24 or more: lanes, joints, image, state, faults.
///
/// It only watches, but for the space bar, which asks for a stop. Any user may run it who may use
/// the machine's socket. Ends by q or Ctrl-C.
#[derive(Parser, Debug)]
#[command(
    name = "taktil-top",
    version,
    after_help = "Exit codes: 0 ended by q or Ctrl-C, 1 the terminal failed."
)]
struct Arguments {
    /// Socket of the run or the service
    #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
    at: PathBuf,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut view = MachineView::new(arguments.at);
    let mut terminal = match ratatui::try_init() {
        Ok(terminal) => terminal,
        Err(error) => {
            out::warn(format_args!("error: no terminal: {error}"));
            return ExitCode::from(1);
        }
    };
    let ended = watch(&mut terminal, &mut view);
    ratatui::restore();
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            out::warn(format_args!("error: {error:#}"));
            ExitCode::from(1)
        }
    }
}

fn watch(terminal: &mut ratatui::DefaultTerminal, view: &mut MachineView) -> anyhow::Result<()> {
    loop {
        view.refresh();
        terminal.draw(|frame| draw(frame, view))?;
        if !event::poll(PICTURE_INTERVAL)? {
            continue;
        }
        let Event::Key(key) = event::read()? else { continue };
        if key.kind != KeyEventKind::Press {
            continue;
        }
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return Ok(()),
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Ok(()),
            KeyCode::Char(' ') => view.stop(),
            _ => {}
        }
    }
}
