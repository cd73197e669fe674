//! The whole power state machine beside a table and a drive that are written from the standard's
//! diagram, not from the code under test.

use taktil_drivers_cia402::power::RESET_CYCLES_MAX;
use taktil_drivers_cia402::{
    Command, Controlword, EnableLine, Goal, Inhibition, PowerStateMachine, QuickStopOption, State,
    Statusword,
};

/// Goals in the order of the table's columns.
const GOALS: [Goal; 3] = [Goal::Enabled, Goal::QuickStop, Goal::Disabled];

/// A class of statuswords, then the controlword towards: enabled, enabled while inhibited, quick
/// stop, disabled; each without and with bit 0x80 of a reset that is asked for at this step. `e/d`
/// stands for enable operation where 605A is 5 to 8 and for disable voltage elsewhere.
const TABLE: &str = "
0000 not-ready   d    d    q    d     d    d    q    d
0040 disabled    s    d    q    d     s    d    q    d
0021 ready       o    d    q    d     o    d    q    d
0023 switched-on e    d    q    d     e    d    q    d
0027 enabled     e    d    q    d     e    d    q    d
0007 quick-stop  e/d  d    q    d     e/d  d    q    d
000f reaction    d    d    d    d     d    d    d    d
0008 fault       d    d    d    d     r    r    r    r
0044 illegal     d    d    d    d     d    d    d    d
0009 illegal     d    d    d    d     d    d    d    d
0002 illegal     d    d    d    d     d    d    d    d
0001 illegal     d    d    d    d     d    d    d    d
";

fn word(cell: &str, option: QuickStopOption) -> Controlword {
    let word = match (cell, option) {
        ("d", _) | ("e/d", QuickStopOption::Leaves) => 0x0000,
        ("q", _) => 0x0002,
        ("s", _) => 0x0006,
        ("o", _) => 0x0007,
        ("e", _) | ("e/d", QuickStopOption::Stays) => 0x000f,
        ("r", _) => 0x0080,
        _ => panic!("{cell}"),
    };
    Controlword(word)
}

/// A machine that has put out one word with bit 7 at 0, free or waiting for another wish.
fn machine(option: QuickStopOption, is_inhibited: bool) -> PowerStateMachine {
    let mut machine = PowerStateMachine::with_quick_stop(option);
    let goal = if is_inhibited { Goal::Enabled } else { Goal::Disabled };
    let command = Command { goal, fault_reset: false };
    machine.step(Statusword(0x0040), Command::default());
    machine.step(Statusword(if is_inhibited { 0x0044 } else { 0x0040 }), command);
    let due = if is_inhibited { Inhibition::NewWish } else { Inhibition::None };
    assert_eq!(machine.inhibition(), due);
    machine
}

#[test]
fn every_class_of_words_with_every_goal_gives_the_word_of_the_table() {
    let mut cells = 0;
    for line in TABLE.trim().lines() {
        let parts: Vec<&str> = line.split_whitespace().collect();
        let status = u16::from_str_radix(parts[0], 16).unwrap();
        for option in [QuickStopOption::Leaves, QuickStopOption::Stays] {
            for (column, cell) in parts[2..].iter().enumerate() {
                let (fault_reset, column) = (column >= 4, column % 4);
                let goal = GOALS[column.saturating_sub(1)];
                let due = word(cell, option);
                // Bits that say nothing about the state change nothing.
                for other in [0x0000, 0xff90, 0x1210, 0x8080] {
                    let mut machine = machine(option, column == 1);
                    let command = Command { goal, fault_reset };
                    let got = machine.step(Statusword(status | other), command);
                    assert_eq!(got, due, "{line}: {goal:?}, {option:?}, reset {fault_reset}");
                    cells += 1;
                }
            }
        }
    }
    assert_eq!(cells, 12 * 2 * 8 * 4);
}

/// A drive that obeys the diagram of the standard, transition by transition.
struct Drive {
    state: State,
    last: u16,
    option: i16,
}

impl Drive {
    fn word(&self) -> Statusword {
        Statusword(match self.state {
            State::NotReadyToSwitchOn => 0x0200,
            State::SwitchOnDisabled => 0x0250,
            State::ReadyToSwitchOn => 0x0231,
            State::SwitchedOn => 0x0233,
            State::OperationEnabled => 0x1237,
            State::QuickStopActive => 0x0217,
            State::FaultReactionActive => 0x021f,
            State::Fault => 0x0218,
        })
    }

    fn obey(&mut self, word: u16) {
        let has = |bits: u16, value: u16| word & bits == value;
        let shut_down = has(0x87, 0x06);
        let switch_on = has(0x8f, 0x07);
        let enable = has(0x8f, 0x0f);
        let disable_voltage = has(0x82, 0x00);
        let quick_stop = has(0x86, 0x02);
        let reset = word & 0x80 != 0 && self.last & 0x80 == 0;
        self.last = word;
        self.state = match self.state {
            State::NotReadyToSwitchOn => State::SwitchOnDisabled,
            State::SwitchOnDisabled if shut_down => State::ReadyToSwitchOn,
            State::ReadyToSwitchOn if switch_on || enable => State::SwitchedOn,
            State::SwitchedOn if enable => State::OperationEnabled,
            State::SwitchedOn | State::OperationEnabled if shut_down => State::ReadyToSwitchOn,
            State::OperationEnabled if switch_on => State::SwitchedOn,
            State::OperationEnabled if quick_stop => State::QuickStopActive,
            State::ReadyToSwitchOn | State::SwitchedOn if quick_stop => State::SwitchOnDisabled,
            State::QuickStopActive if enable && self.option >= 5 => State::OperationEnabled,
            State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::OperationEnabled
            | State::QuickStopActive
                if disable_voltage =>
            {
                State::SwitchOnDisabled
            }
            State::FaultReactionActive => State::Fault,
            State::Fault if reset => State::SwitchOnDisabled,
            state => state,
        };
    }
}

/// Runs both for so many cycles; the states that the drive went through.
fn run(
    machine: &mut PowerStateMachine,
    drive: &mut Drive,
    command: Command,
    cycles: usize,
) -> Vec<State> {
    let cycle = |_| {
        let word = machine.step(drive.word(), command);
        drive.obey(word.0);
        drive.state
    };
    (0..cycles).map(cycle).collect()
}

fn ask(goal: Goal) -> Command {
    Command { goal, fault_reset: false }
}

#[test]
fn from_every_state_every_goal_is_reached_and_operation_only_when_it_is_wanted() {
    for option in [0, 2, 5, 6] {
        for state in State::ALL {
            for goal in GOALS {
                let mut machine =
                    PowerStateMachine::with_quick_stop(QuickStopOption::from_code(option));
                let mut drive = Drive { state, last: 0x0080, option };
                let way = run(&mut machine, &mut drive, ask(goal), 8);
                let due = match (state, goal) {
                    (State::Fault | State::FaultReactionActive, _) => State::Fault,
                    (_, Goal::Enabled) => State::OperationEnabled,
                    (State::OperationEnabled | State::QuickStopActive, Goal::QuickStop) => {
                        State::QuickStopActive
                    }
                    _ => State::SwitchOnDisabled,
                };
                assert_eq!(drive.state, due, "{option}: {state:?} towards {goal:?}: {way:?}");
                let enabled = way.contains(&State::OperationEnabled);
                assert!(goal == Goal::Enabled || !enabled, "{state:?}, {goal:?}: {way:?}");
            }
        }
    }
}

#[test]
fn a_fault_takes_a_reset_and_a_new_wish() {
    let mut machine = PowerStateMachine::new();
    let mut drive = Drive { state: State::SwitchOnDisabled, last: 0, option: 2 };
    run(&mut machine, &mut drive, ask(Goal::Enabled), 4);
    assert_eq!(drive.state, State::OperationEnabled);
    drive.state = State::FaultReactionActive;
    // Neither the wish that stands nor a new one is a reset.
    run(&mut machine, &mut drive, ask(Goal::Enabled), 5);
    run(&mut machine, &mut drive, ask(Goal::Disabled), 2);
    run(&mut machine, &mut drive, ask(Goal::Enabled), 5);
    assert_eq!((drive.state, machine.inhibition()), (State::Fault, Inhibition::Reset));
    // A reset while the wish stands ends the fault and moves nothing.
    let reset = Command { goal: Goal::Enabled, fault_reset: true };
    let way = run(&mut machine, &mut drive, reset, 10);
    assert_eq!((way[0], drive.state), (State::SwitchOnDisabled, State::SwitchOnDisabled));
    assert_eq!(machine.inhibition(), Inhibition::NewWish);
    run(&mut machine, &mut drive, ask(Goal::Disabled), 1);
    run(&mut machine, &mut drive, ask(Goal::Enabled), 4);
    assert_eq!(drive.state, State::OperationEnabled);
}

#[test]
fn one_request_makes_one_edge_of_bounded_length() {
    let mut machine = PowerStateMachine::new();
    let reset = Command { goal: Goal::Disabled, fault_reset: true };
    // The drive does not leave its fault, as when the cause is still there.
    let bits: Vec<bool> = (0..2 * RESET_CYCLES_MAX)
        .map(|_| machine.step(Statusword(0x0218), reset).has_fault_reset())
        .collect();
    assert!(!bits[0], "the word before may have had bit 7 set");
    let edges = bits.windows(2).filter(|pair| !pair[0] && pair[1]).count();
    let length = bits.iter().filter(|bit| **bit).count();
    assert_eq!((edges, length), (1, RESET_CYCLES_MAX as usize));
    assert!(machine.needs_reset());
    machine.step(Statusword(0x0218), Command::default());
    assert_eq!(machine.step(Statusword(0x0218), reset), Controlword::FAULT_RESET);
}

#[test]
fn a_reset_that_is_asked_for_during_the_reaction_does_not_count() {
    let mut machine = PowerStateMachine::new();
    let reset = Command { goal: Goal::Disabled, fault_reset: true };
    for status in [0x021f, 0x021f, 0x0218, 0x0218] {
        assert_eq!(machine.step(Statusword(status), reset), Controlword::DISABLE_VOLTAGE);
    }
}

#[test]
fn a_fault_that_went_by_itself_is_acknowledged_all_the_same() {
    let mut machine = PowerStateMachine::new();
    machine.step(Statusword(0x0218), Command::default());
    let mut drive = Drive { state: State::NotReadyToSwitchOn, last: 0, option: 2 };
    run(&mut machine, &mut drive, ask(Goal::Enabled), 6);
    assert_eq!((drive.state, machine.needs_reset()), (State::SwitchOnDisabled, true));
    let reset = Command { goal: Goal::Disabled, fault_reset: true };
    assert_eq!(machine.step(drive.word(), reset), Controlword::DISABLE_VOLTAGE);
    run(&mut machine, &mut drive, ask(Goal::Enabled), 4);
    assert_eq!(drive.state, State::OperationEnabled);
}

#[test]
fn a_drive_that_leaves_operation_by_itself_stays_out_until_it_is_wanted_anew() {
    for left in [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::QuickStopActive,
    ] {
        let mut machine = PowerStateMachine::new();
        let mut drive = Drive { state: State::SwitchOnDisabled, last: 0, option: 2 };
        run(&mut machine, &mut drive, ask(Goal::Enabled), 5);
        drive.state = left;
        run(&mut machine, &mut drive, ask(Goal::Enabled), 20);
        assert_eq!(drive.state, State::SwitchOnDisabled, "{left:?}");
        run(&mut machine, &mut drive, ask(Goal::Disabled), 1);
        run(&mut machine, &mut drive, ask(Goal::Enabled), 4);
        assert_eq!(drive.state, State::OperationEnabled, "{left:?}");
    }
}

/// A drive led by one line.
struct Lined {
    machine: PowerStateMachine,
    line: EnableLine,
    drive: Drive,
}

impl Lined {
    fn enabled() -> Lined {
        let drive = Drive { state: State::SwitchOnDisabled, last: 0, option: 2 };
        let (machine, line) = (PowerStateMachine::new(), EnableLine::default());
        let mut lined = Lined { machine, line, drive };
        assert_eq!(lined.cycles(true, false, 5), State::OperationEnabled);
        lined
    }

    fn cycles(&mut self, enable: bool, is_told: bool, count: usize) -> State {
        for _ in 0..count {
            let command = self.line.command(enable, &self.machine, is_told);
            self.drive.obey(self.machine.step(self.drive.word(), command).0);
        }
        self.drive.state
    }
}

#[test]
fn one_line_resets_a_fault_that_nobody_was_told_of_by_its_first_edge_and_enables_by_its_second() {
    let mut lined = Lined::enabled();
    lined.drive.state = State::FaultReactionActive;
    assert_eq!(lined.cycles(true, false, 50), State::Fault);
    assert_eq!(lined.cycles(false, false, 5), State::Fault);
    assert_eq!(lined.cycles(true, false, 50), State::SwitchOnDisabled);
    assert_eq!(lined.cycles(false, false, 1), State::SwitchOnDisabled);
    assert_eq!(lined.cycles(true, false, 5), State::OperationEnabled);
}

#[test]
fn one_line_resets_a_fault_that_was_told_and_enables_by_the_same_edge() {
    let mut lined = Lined::enabled();
    lined.drive.state = State::FaultReactionActive;
    assert_eq!(lined.cycles(true, true, 500), State::Fault, "a line that stands resets nothing");
    assert_eq!(lined.cycles(false, true, 50), State::Fault, "nor does one that falls");
    assert_eq!(lined.cycles(true, true, 8), State::OperationEnabled);
    // A fault that comes back under the same edge waits for the next one.
    lined.drive.state = State::Fault;
    assert_eq!(lined.cycles(true, true, 500), State::Fault);
    assert_eq!(lined.cycles(false, true, 1), State::Fault);
    assert_eq!(lined.cycles(true, true, 8), State::OperationEnabled);
}

#[test]
fn a_line_that_rises_while_the_drive_still_reacts_resets_it_afterwards() {
    for (is_told, end) in [(true, State::OperationEnabled), (false, State::SwitchOnDisabled)] {
        let mut lined = Lined::enabled();
        lined.drive.state = State::FaultReactionActive;
        for enable in [true, false, true] {
            lined.cycles(enable, is_told, 1);
            lined.drive.state = State::FaultReactionActive;
        }
        assert_eq!(lined.cycles(true, is_told, 20), end);
    }
}

#[test]
fn a_drive_that_cannot_be_reset_is_not_enabled_when_its_fault_goes_by_itself() {
    let mut lined = Lined::enabled();
    lined.drive.state = State::Fault;
    lined.cycles(true, true, 3);
    lined.cycles(false, true, 3);
    for _ in 0..2 * RESET_CYCLES_MAX {
        lined.cycles(true, true, 1);
        lined.drive.state = State::Fault;
    }
    lined.drive.state = State::SwitchOnDisabled;
    assert_eq!(lined.cycles(true, true, 50), State::SwitchOnDisabled);
    assert_eq!(lined.cycles(false, true, 1), State::SwitchOnDisabled);
    assert_eq!(lined.cycles(true, true, 8), State::OperationEnabled);
}
