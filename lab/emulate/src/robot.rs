//! The simulated robot with its emulated boards as one machine in time.

use std::path::Path;

use anyhow::anyhow;
use taktil_drivers_regmap_emulator::Emulator;
use taktil_drivers_serial_emulator::Line;
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Invalid, Nanos};
use taktil_lab_scene::scene::Scene;
use taktil_machine_console::option::BadOption;
use taktil_sim::World;

use crate::array::{ShownArray, TactileLine};
use crate::board::{BoardKind, Traffic};
use crate::card::{Card, MOTORS_MAX};
use crate::drives::DriveBus;
use crate::memory::MemoryBoard;
use crate::segment::DriveSegment;
use crate::simulated::SimulatedRobot;
use crate::wiring::CardWiring;
use crate::wrist::WristBox;

/// Names of the simulator's arrays, for people.
const ARRAY_NAMES: [&str; 2] = ["the finger's array", "the array opposed to the finger"];
/// Seeds of two boards differ by this, so that faults hit different messages of theirs.
const SEED_STEP: u64 = 0x9e37_79b9;

/// What a board is made of.
enum Part {
    Card(Box<Card>),
    Line(Box<TactileLine>),
    Memory(Box<MemoryBoard>),
    Segment(Box<DriveSegment>),
    Bus(Box<DriveBus>),
    Wrist(Box<WristBox>),
}

/// A board with its name.
struct NamedBoard {
    name: String,
    /// What it is, for people.
    description: String,
    part: Part,
}

/// The simulated robot of a scene behind emulated boards. Only [`EmulatedRobot::advance`] moves it.
///
/// The world follows the boards: it is integrated to an instant when a card is asked something, or
/// shows the scan of an instant, so that its bits depend on what the hosts say and not on how often
/// somebody looks. [`EmulatedRobot::integrate`] brings it up to date in between.
pub struct EmulatedRobot {
    robot: SimulatedRobot,
    boards: Vec<NamedBoard>,
    now: Nanos,
}

impl EmulatedRobot {
    /// The robot of `scene` at its start, behind `boards`: a card, a board of registers or drives
    /// for its motors, encoders and lines, a box for its wrist, and tactile boards, the first of
    /// which shows the finger's array, the second one the array opposed to it. `seed` is that of
    /// the simulator's noise, and decides which messages the faults of `plan` hit.
    ///
    /// # Errors
    /// An error in the scene, located; [`BadOption`] for a board that the scene has nothing for, or
    /// a fault that its board cannot have.
    pub fn new(
        scene: &Scene,
        boards: &[BoardKind],
        plan: &FaultPlan,
        seed: u64,
    ) -> anyhow::Result<EmulatedRobot> {
        let robot = SimulatedRobot::new(scene, seed)?;
        let names = board_names(boards);
        check_targets(plan, &names)?;
        let (mut made, mut arrays) = (Vec::new(), 0);
        for (index, (kind, name)) in boards.iter().copied().zip(names).enumerate() {
            let own_seed = seed.wrapping_add(SEED_STEP.wrapping_mul(index as u64));
            check_faults(plan, kind, &name, robot.joints())?;
            let (description, part) = match kind {
                _ if kind.is_motor_board()
                    && boards[..index].iter().any(|other| other.is_motor_board()) =>
                {
                    let what = "the scene has one set of motors; name one board for them, once";
                    return Err(BadOption(format!("{name}: {what}")).into());
                }
                BoardKind::Mesa => card(&robot, plan, &name, own_seed)?,
                BoardKind::Ethercat => {
                    let segment = DriveSegment::new(&robot, plan.clone(), &name, own_seed);
                    let segment = segment.map_err(bad_fault)?;
                    (DriveSegment::description(&robot), Part::Segment(Box::new(segment)))
                }
                BoardKind::Regmap | BoardKind::VmeArm => {
                    memory(&robot, kind, plan, &name, own_seed)?
                }
                BoardKind::Can => bus(&robot, plan, &name, own_seed),
                BoardKind::Netft => {
                    let wrist = WristBox::new(plan.clone(), &name, own_seed);
                    (wrist.description(), Part::Wrist(Box::new(wrist)))
                }
                BoardKind::Myrmex
                | BoardKind::Flexitac
                | BoardKind::WeissWts
                | BoardKind::WeissDsa => {
                    arrays += 1;
                    line(&robot, kind, arrays - 1, &name, plan, own_seed)?
                }
            };
            made.push(NamedBoard { name, description, part });
        }
        let mut emulated = EmulatedRobot { robot, boards: made, now: Nanos::ZERO };
        emulated.integrate();
        Ok(emulated)
    }

    /// The instant that has been reached, since power came on.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.now
    }

    /// Lets the world stand still, so that boards can be opened before anything moves. Before
    /// [`EmulatedRobot::advance`] was called; without it world and boards begin together.
    #[must_use]
    pub fn with_waiting_world(mut self) -> EmulatedRobot {
        self.robot.hold();
        self
    }

    /// Starts a world that waits: its time is 0 now. One that runs goes on.
    pub fn start_world(&mut self) {
        self.robot.start(self.now);
    }

    /// The simulated world, as it was integrated last.
    #[must_use]
    pub fn world(&self) -> &World {
        self.robot.world()
    }

    /// How many boards there are.
    #[must_use]
    pub fn board_count(&self) -> usize {
        self.boards.len()
    }

    /// The name of a board in plans and messages: that of its kind, with a number from the second
    /// one of a kind on. Empty for a board that does not exist.
    #[must_use]
    pub fn name(&self, board: usize) -> &str {
        self.boards.get(board).map_or("", |board| &board.name)
    }

    /// What a board is and serves, for people.
    #[must_use]
    pub fn description(&self, board: usize) -> &str {
        self.boards.get(board).map_or("", |board| &board.description)
    }

    /// Whether a board is registers in a file, which [`EmulatedRobot::attach_file`] gives it.
    #[must_use]
    pub fn is_memory(&self, board: usize) -> bool {
        self.boards.get(board).is_some_and(|board| matches!(board.part, Part::Memory(_)))
    }

    /// Puts a board of registers behind a file, which is made. Without one it does nothing.
    ///
    /// # Errors
    /// A file that cannot be made, or a fault that the board cannot have.
    pub fn attach_file(&mut self, board: usize, path: &Path) -> anyhow::Result<()> {
        match self.boards.get_mut(board).map(|board| &mut board.part) {
            Some(Part::Memory(memory)) => memory.attach(path),
            _ => Ok(()),
        }
    }

    /// Whether a driver waits for bits of a board of registers, which then has to run all the time.
    pub(crate) fn has_busy_bits(&self, board: usize) -> bool {
        match self.boards.get(board).map(|board| &board.part) {
            Some(Part::Memory(memory)) => memory.has_busy_bits(),
            _ => false,
        }
    }

    /// Gives the board of registers away, to a thread that lets it run; it stays linked to the
    /// robot. `None` for other boards, and for one without a file.
    pub(crate) fn detach_memory(&mut self, board: usize) -> Option<Emulator> {
        match self.boards.get_mut(board).map(|board| &mut board.part) {
            Some(Part::Memory(memory)) => memory.detach(),
            _ => None,
        }
    }

    /// Whether a board takes datagrams over UDP; the others take frames of a CAN bus or bytes, or
    /// are registers in a file.
    #[must_use]
    pub fn is_card(&self, board: usize) -> bool {
        let part = self.boards.get(board).map(|board| &board.part);
        matches!(part, Some(Part::Card(_) | Part::Wrist(_)))
    }

    /// Whether a board takes frames of a CAN bus, as Linux lays them out.
    #[must_use]
    pub fn is_bus(&self, board: usize) -> bool {
        self.boards.get(board).is_some_and(|board| matches!(board.part, Part::Bus(_)))
    }

    /// Whether a board takes frames on a network interface.
    #[must_use]
    pub fn is_segment(&self, board: usize) -> bool {
        self.boards.get(board).is_some_and(|board| matches!(board.part, Part::Segment(_)))
    }

    /// Whether the cable of a serial board is plugged in.
    #[must_use]
    pub fn is_plugged(&self, board: usize) -> bool {
        match self.boards.get(board).map(|board| &board.part) {
            Some(Part::Line(line)) => line.is_plugged(self.now),
            _ => true,
        }
    }

    /// What passed between a board and its host.
    #[must_use]
    pub fn traffic(&self, board: usize) -> Option<Traffic> {
        Some(match &self.boards.get(board)?.part {
            Part::Card(card) => card.traffic(),
            Part::Segment(segment) => segment.traffic(),
            Part::Line(line) => line.traffic(),
            Part::Memory(memory) => memory.traffic(),
            Part::Bus(bus) => bus.traffic(),
            Part::Wrist(wrist) => wrist.traffic(),
        })
    }

    /// The next instant at which a board does something by itself.
    #[must_use]
    pub fn next_event(&self) -> Nanos {
        let events = self.boards.iter().map(|board| match &board.part {
            Part::Card(card) => card.next_event(),
            Part::Segment(segment) => segment.next_event(),
            Part::Line(line) => line.next_event(),
            Part::Memory(memory) => memory.next_event(),
            Part::Bus(bus) => bus.next_event(),
            Part::Wrist(wrist) => wrist.next_event(),
        });
        events.min().unwrap_or(Nanos::MAX)
    }

    /// The next instant at which [`EmulatedRobot::deliver`] may have something from a board.
    #[must_use]
    pub fn next_due(&self, board: usize) -> Nanos {
        match self.boards.get(board).map(|board| &board.part) {
            Some(Part::Card(card)) => card.next_due(),
            Some(Part::Segment(segment)) => segment.next_due(),
            Some(Part::Line(line)) => line.next_event(),
            Some(Part::Bus(bus)) => bus.next_due(),
            Some(Part::Wrist(wrist)) => wrist.next_event(),
            Some(Part::Memory(_)) | None => Nanos::MAX,
        }
    }

    /// Moves the boards on to `to`, through every instant at which one of them does something, and
    /// the world as far as they look at it; an instant that has passed changes nothing.
    pub fn advance(&mut self, to: Nanos) {
        while self.now < to {
            let next = self.next_event().max(self.now).min(to);
            self.now = next;
            for board in &mut self.boards {
                match &mut board.part {
                    Part::Card(card) => card.step(next, &mut self.robot),
                    Part::Segment(segment) => segment.step(next, &mut self.robot),
                    Part::Line(line) => line.step(next, &mut self.robot),
                    Part::Memory(memory) => memory.step(next, &mut self.robot),
                    Part::Bus(bus) => bus.step(next, &mut self.robot),
                    Part::Wrist(wrist) => wrist.step(next, &mut self.robot),
                }
            }
        }
    }

    /// Integrates the world up to now, and lets the cards read it.
    pub fn integrate(&mut self) {
        self.robot.advance(self.now);
        for board in &mut self.boards {
            match &mut board.part {
                Part::Card(card) => card.read(self.now, &mut self.robot),
                Part::Segment(segment) => segment.read(self.now, &mut self.robot),
                Part::Bus(bus) => bus.read(&mut self.robot),
                _ => {}
            }
        }
    }

    /// Hands a datagram, or bytes of a serial line, to a board now.
    pub fn receive(&mut self, board: usize, bytes: &[u8]) {
        if self.is_card(board) || self.is_bus(board) || self.is_segment(board) {
            self.integrate();
        }
        match self.boards.get_mut(board).map(|board| &mut board.part) {
            Some(Part::Card(card)) => card.receive(self.now, bytes, &mut self.robot),
            Some(Part::Segment(segment)) => segment.receive(self.now, bytes, &mut self.robot),
            Some(Part::Line(line)) => line.receive(self.now, bytes, &mut self.robot),
            Some(Part::Bus(bus)) => bus.receive(self.now, bytes, &mut self.robot),
            Some(Part::Wrist(wrist)) => wrist.receive(self.now, bytes, &mut self.robot),
            Some(Part::Memory(_)) | None => {}
        }
    }

    /// Gives what a board has said by now and was not given yet: each datagram or frame, or all
    /// bytes of a serial line at once.
    pub fn deliver(&mut self, board: usize, take: &mut dyn FnMut(&[u8])) {
        match self.boards.get_mut(board).map(|board| &mut board.part) {
            Some(Part::Card(card)) => card.outbox.drain(..).for_each(|packet| take(&packet)),
            Some(Part::Segment(segment)) => {
                segment.outbox.drain(..).for_each(|frame| take(&frame));
            }
            Some(Part::Bus(bus)) => bus.outbox.drain(..).for_each(|frame| take(&frame)),
            Some(Part::Wrist(wrist)) => wrist.outbox.drain(..).for_each(|record| take(&record)),
            Some(Part::Line(line)) if !line.outbox.is_empty() => {
                take(&line.outbox);
                line.outbox.clear();
            }
            _ => {}
        }
    }
}

fn bad_fault(bad: Invalid) -> BadOption {
    BadOption(format!("--fault {}: {}; {}", bad.place, bad.what, bad.remedy))
}

/// The names of boards: those of their kinds, with a number from the second one of a kind on.
pub(crate) fn board_names(boards: &[BoardKind]) -> Vec<String> {
    let name = |(index, kind): (usize, &BoardKind)| {
        let before = boards[..index].iter().filter(|other| *other == kind).count();
        if before == 0 { kind.name().to_owned() } else { format!("{kind}-{}", before + 1) }
    };
    boards.iter().enumerate().map(name).collect()
}

/// Refuses faults that a board cannot have. Drives may have them one by one, other boards as a
/// whole.
fn check_faults(
    plan: &FaultPlan,
    kind: BoardKind,
    name: &str,
    joints: usize,
) -> Result<(), BadOption> {
    if kind == BoardKind::Ethercat {
        // Faults of a segment may befall single devices, which it checks itself.
        return Ok(());
    }
    if kind != BoardKind::Can {
        return plan.check_kinds(name, kind.fault_kinds()).map_err(bad_fault);
    }
    let whole = |fault: &Fault| Fault { channel: None, ..fault.clone() };
    let on_bus = FaultPlan::new(plan.faults().iter().map(whole).collect());
    on_bus.check_kinds(name, kind.fault_kinds()).map_err(bad_fault)?;
    let is_strange = |fault: &&Fault| {
        fault.target == name && fault.channel.is_some_and(|drive| usize::from(drive) > joints)
    };
    match plan.faults().iter().find(is_strange) {
        None => Ok(()),
        Some(fault) => {
            let text = format!("--fault {fault}: `{name}` has drives 1 to {joints}; name one");
            Err(BadOption(text))
        }
    }
}

/// Refuses faults of boards that are not there.
fn check_targets(plan: &FaultPlan, names: &[String]) -> anyhow::Result<()> {
    // Parts of a board of registers have names of their own, such as `regmap.encoders`.
    let whole = |target: &str| target.split('.').next().unwrap_or("").to_owned();
    let strange =
        |target: &str| !target.is_empty() && !names.iter().any(|name| *name == whole(target));
    match plan.faults().iter().find(|fault| strange(&fault.target)) {
        None => Ok(()),
        Some(fault) => {
            let known = names.join(", ");
            let text = format!("--fault target: no board `{}`; it is {known}", fault.target);
            Err(BadOption(text).into())
        }
    }
}

fn memory(
    robot: &SimulatedRobot,
    kind: BoardKind,
    plan: &FaultPlan,
    name: &str,
    seed: u64,
) -> anyhow::Result<(String, Part)> {
    let text = kind.registers().ok_or_else(|| anyhow!("{name} has no registers"))?;
    let board = MemoryBoard::new(robot, text, plan.clone(), name, seed)?;
    Ok((board.description(robot), Part::Memory(Box::new(board))))
}

fn bus(robot: &SimulatedRobot, plan: &FaultPlan, name: &str, seed: u64) -> (String, Part) {
    let bus = DriveBus::new(robot, plan.clone(), name, seed);
    (bus.description(), Part::Bus(Box::new(bus)))
}

fn card(
    robot: &SimulatedRobot,
    plan: &FaultPlan,
    name: &str,
    seed: u64,
) -> anyhow::Result<(String, Part)> {
    if robot.joints() > MOTORS_MAX {
        let text = format!(
            "{name}: a 7I77 drives {MOTORS_MAX} motors, the scene's arm has {}; take a scene whose \
             arm has fewer joints",
            robot.joints()
        );
        return Err(BadOption(text).into());
    }
    let wiring = CardWiring::STANDARD;
    let index = if robot.index_pulse_places().is_empty() { "without" } else { "with" };
    let feed = wiring.watchdog_feed.map_or(String::new(), |at| format!(", watchdog feed {at}"));
    let description = format!(
        "7I92 with a 7I77: {} motors and encoders {index} index pulses, 10 V for full-scale \
         current; field outputs: enable {}, brake release {}{feed}; field inputs: drive power {}, \
         emergency stop {} and {}",
        robot.joints(),
        wiring.enable,
        wiring.brake_release,
        wiring.drive_power,
        wiring.estop_a,
        wiring.estop_b
    );
    let card = Card::new(robot, wiring, plan.clone(), name, seed);
    Ok((description, Part::Card(Box::new(card))))
}

fn line(
    robot: &SimulatedRobot,
    kind: BoardKind,
    array: usize,
    name: &str,
    plan: &FaultPlan,
    seed: u64,
) -> anyhow::Result<(String, Part)> {
    let shapes = robot.arrays();
    let Some(shape) = shapes.get(array) else {
        let (what, remedy) = match shapes.len() {
            0 => ("no tactile array", "[world.tactile] present = true"),
            1 => ("one tactile array", "[world.opposed], such as opposed-pads.toml"),
            count => {
                let text = format!("{name}: the scene has {count} tactile arrays; leave it out");
                return Err(BadOption(text).into());
            }
        };
        let remedy = format!("leave the board out, or take a scene with {remedy}");
        return Err(BadOption(format!("{name}: the scene has {what}; {remedy}")).into());
    };
    let rate_hz = robot.scan_rate_hz();
    let board = kind.tactile_board(shape.rows, shape.cols, rate_hz);
    let board = board.ok_or_else(|| anyhow!("{name} is no tactile board"))?;
    let (board_bits, tactels) = (kind.tactel_bits(), shape.rows * shape.cols);
    if board.tactels() != tactels {
        let text = format!(
            "{name}: the board has {} tactels, the scene's array {} x {}; take another board",
            board.tactels(),
            shape.rows,
            shape.cols
        );
        return Err(BadOption(text).into());
    }
    let description = format!(
        "{}: {} x {} tactels of {board_bits} bits, {rate_hz:.0} scans/s until it is told otherwise",
        ARRAY_NAMES.get(array).unwrap_or(&"an array"),
        shape.rows,
        shape.cols
    );
    let line = Line::new(board, name, plan.clone(), seed).map_err(bad_fault)?;
    let shown = ShownArray { index: array, array_bits: shape.bits, board_bits };
    Ok((description, Part::Line(Box::new(TactileLine::new(line, shown)))))
}
