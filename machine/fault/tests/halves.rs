//! Each kind of fault on each half, from one plan: what passes is what the plan says, before,
//! during and after the fault, and the undisturbed halves keep the promises of the traits.

use taktil_hal::fault::{Fault, FaultKind, FaultPlan};
use taktil_hal::{
    AnalogOut, Arrival, CHANNELS, Counts, DacCode, Devices, DigitalIn, DigitalOut, Encoders, Error,
    ErrorKind, LinesIn, LinesOut, Nanos, Reading, TactileArray, TactileFrame,
};
use taktil_machine_fault::{decorate, kinds_of_half};

const CYCLE_PERIOD: Nanos = Nanos::from_millis(1);

/// Six encoders that count up by ten a millisecond.
struct Turning;

impl Encoders for Turning {
    fn joints(&self) -> usize {
        6
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let mut value = [Counts(0); CHANNELS];
        value[..6].fill(Counts(10 * (release.0 / CYCLE_PERIOD.0) as i32));
        Ok(Reading { value, acquired: release })
    }
}

/// Converters and lines that tell what reached them, through a ring.
struct Board(wire::Sender);

/// A place in which a test finds what reached a board.
mod wire {
    use taktil_hal::link::{Receiver, link};
    use taktil_hal::{CHANNELS, DacCode, Nanos};

    pub(super) type Word = [DacCode; CHANNELS];
    pub(super) type Sender = taktil_hal::link::Sender<Word>;

    pub(super) fn pair() -> (Sender, Receiver<Word>) {
        link(256)
    }

    pub(super) fn newest(from: &mut Receiver<Word>) -> Option<Word> {
        from.newest(Nanos::MAX).map(|word| word.value)
    }
}

impl AnalogOut for Board {
    fn channels(&self) -> usize {
        6
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(-2048), DacCode(2047))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let _ = self.0.send(*codes, release, release);
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        let _ = self.0.send([DacCode(0); CHANNELS], Nanos::ZERO, Nanos::ZERO);
        Ok(())
    }

    fn safe_value(&self) -> DacCode {
        DacCode(0)
    }

    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(50)
    }
}

struct Cell;

impl DigitalIn for Cell {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let value = LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true };
        Ok(Reading { value, acquired: release })
    }
}

impl DigitalOut for Cell {
    fn commit(&mut self, _release: Nanos, _lines: &LinesOut) -> Result<(), Error> {
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(50)
    }
}

/// An array of 4 x 4 that scans each millisecond; each tactel shows its index.
struct Pad(u32);

impl TactileArray for Pad {
    fn rows(&self) -> usize {
        4
    }

    fn cols(&self) -> usize {
        4
    }

    fn full_scale(&self) -> u16 {
        4095
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        self.0 += 1;
        frame.sequence = self.0;
        frame.acquired = release;
        for (index, value) in frame.values.iter_mut().enumerate() {
            *value = 100 * self.0 as u16 + index as u16;
        }
        frame.valid.fill(true);
        Ok(Arrival::New)
    }
}

fn plan(texts: &[&str]) -> FaultPlan {
    FaultPlan::new(texts.iter().map(|text| text.parse::<Fault>().unwrap()).collect())
}

fn ms(ms: i64) -> Nanos {
    CYCLE_PERIOD * ms
}

fn encoders(texts: &[&str]) -> Box<dyn Encoders> {
    let devices = Devices { encoders: Some(Box::new(Turning)), ..Devices::default() };
    decorate(devices, &plan(texts), 1).unwrap().encoders.unwrap()
}

/// The counts of two channels from 0 ms on.
fn counts(texts: &[&str]) -> Vec<Result<(i32, i32), ErrorKind>> {
    let mut half = encoders(texts);
    let count = |at| match half.sample(ms(at)) {
        Ok(reading) => {
            assert_eq!(half.sample(ms(at)), Ok(reading), "the same release, the same reading");
            Ok((reading.value[0].0, reading.value[2].0))
        }
        Err(error) => Err(error.kind),
    };
    (0..6).map(count).collect()
}

/// A frame's number and its first two counts; none where there is no new frame.
type FrameOutcome = Result<Option<(u32, u16, u16)>, ErrorKind>;

#[test]
fn counters_do_what_the_plan_says_on_the_channel_that_it_names() {
    let during =
        |kind: &str| counts(&[&format!("kind={kind} target=encoders.3 at=0.002 for=0.002")]);
    let well = [0, 10, 20, 30, 40, 50];
    let third = |kind: &str| -> Vec<i32> {
        let both: Vec<_> = during(kind).into_iter().map(Result::unwrap).collect();
        assert!(both.iter().map(|both| both.0).eq(well), "{kind}: the first channel is well");
        both.into_iter().map(|both| both.1).collect()
    };
    assert_eq!(third("jump value=500"), [0, 10, 520, 530, 40, 50]);
    assert_eq!(third("frozen"), [0, 10, 10, 10, 40, 50]);
    assert_eq!(third("dead"), [0, 10, 0, 0, 40, 50]);
    assert_eq!(third("inversion"), [0, 10, 0, -10, 0, 10], "counts backwards, and no step");
    assert_eq!(third("lost_counts value=0.5"), [0, 10, 15, 20, 30, 40]);
}

#[test]
fn boards_that_do_not_answer_say_so_and_come_back() {
    for (kind, error) in [
        ("unplugged", ErrorKind::Lost),
        ("silence", ErrorKind::Stale),
        ("failing value=1", ErrorKind::Transient),
    ] {
        let seen = counts(&[&format!("kind={kind} target=encoders at=0.002 for=0.002")]);
        assert_eq!(seen[1], Ok((10, 10)), "{kind}");
        assert_eq!(seen[2..4], [Err(error); 2], "{kind}");
        assert_eq!(seen[4], Ok((40, 40)), "{kind}");
    }
    let restarted = counts(&["kind=restart target=encoders at=0.002 for=0.001"]);
    assert_eq!(restarted[2..5], [Ok((0, 0)), Ok((10, 10)), Ok((20, 20))]);
}

#[test]
fn words_are_lost_late_latched_and_turned() {
    let outputs = |text: &str| -> Vec<Option<i32>> {
        let (sender, mut receiver) = wire::pair();
        let devices = Devices { analog_out: Some(Box::new(Board(sender))), ..Devices::default() };
        let mut half = decorate(devices, &plan(&[text]), 1).unwrap().analog_out.unwrap();
        let mut output = |at: i64| {
            let answer = half.commit(ms(at), &[DacCode(100 + at as i32); CHANNELS]);
            let word = wire::newest(&mut receiver).map(|word| word[1].0);
            answer.ok().and(word)
        };
        (0..5).map(&mut output).collect()
    };
    let span = "target=analog_out at=0.002 for=0.002";
    let all =
        |middle: [Option<i32>; 2]| vec![Some(100), Some(101), middle[0], middle[1], Some(104)];
    for (kind, middle) in [
        ("loss value=1", [None, None]),
        ("failing value=1", [None, None]),
        ("unplugged", [None, None]),
        ("frozen", [Some(101), Some(101)]),
        ("dead", [Some(0), Some(0)]),
        ("hot", [Some(2047), Some(2047)]),
        ("inversion", [Some(-102), Some(-103)]),
        ("delay value=0.001", [Some(101), Some(102)]),
    ] {
        assert_eq!(outputs(&format!("kind={kind} {span}")), all(middle), "{kind}");
    }
    let one = outputs("kind=dead target=analog_out.1 at=0.002 for=0.002");
    assert_eq!(one, all([Some(102), Some(103)]), "another channel");
}

#[test]
fn lines_break_stick_bounce_and_disagree() {
    let lines = |text: &str| -> Vec<[bool; 3]> {
        let devices = Devices { digital_in: Some(Box::new(Cell)), ..Devices::default() };
        let mut half = decorate(devices, &plan(&[text]), 1).unwrap().digital_in.unwrap();
        let line = |at| {
            let lines = half.sample(ms(at)).unwrap().value;
            [lines.drive_power, lines.estop_a_closed, lines.estop_b_closed]
        };
        (0..6).map(line).collect()
    };
    let disagree = lines("kind=dead target=digital_in.2 at=0.002 for=0.002");
    assert_eq!(disagree[1..5], [[true; 3], [true, false, true], [true, false, true], [true; 3]]);
    let bounce = lines("kind=bounce target=digital_in.1 at=0.001 for=0.004 value=0.001");
    let power: Vec<bool> = bounce.iter().map(|lines| lines[0]).collect();
    assert_eq!(power, [true, false, true, false, true, true]);
    let open = lines("kind=dead target=digital_in at=0.002 for=0.001");
    assert_eq!(open[2], [false; 3]);
}

#[test]
fn frames_are_lost_torn_repeated_late_and_spoilt() {
    let frames = |text: &str| -> Vec<FrameOutcome> {
        let mut devices = Devices::default();
        devices.tactile.insert("tactile".to_owned(), Box::new(Pad(0)));
        let mut half = decorate(devices, &plan(&[text]), 1).unwrap().tactile.remove("tactile");
        let half = half.as_mut().unwrap();
        let mut frame = TactileFrame::of(half.as_ref());
        let mut sample = |at| match half.sample(ms(at), &mut frame) {
            Ok(Arrival::New) => Ok(Some((frame.sequence, frame.values[0], frame.values[15]))),
            Ok(Arrival::Held) => Ok(None),
            Err(error) => Err(error.kind),
        };
        (1..6).map(&mut sample).collect()
    };
    let span = "target=tactile at=0.002 for=0.002";
    let well = |n: u32| Ok(Some((n, 100 * n as u16, 100 * n as u16 + 15)));
    let all = |middle: [FrameOutcome; 2]| vec![well(1), middle[0], middle[1], well(4), well(5)];
    for (kind, middle) in [
        ("loss value=1", [Ok(None); 2]),
        ("silence", [Ok(None); 2]),
        ("unplugged", [Err(ErrorKind::Lost); 2]),
        ("truncation value=1", [Err(ErrorKind::Transient); 2]),
        ("torn value=1", [Ok(Some((2, 200, 115))), Ok(Some((3, 300, 115)))]),
        ("frozen", [Ok(Some((2, 100, 115))), Ok(Some((3, 100, 115)))]),
        ("dead", [Ok(Some((2, 0, 0))), Ok(Some((3, 0, 0)))]),
        ("hot", [Ok(Some((2, 4095, 4095))), Ok(Some((3, 4095, 4095)))]),
    ] {
        assert_eq!(frames(&format!("kind={kind} {span}")), all(middle), "{kind}");
    }
    let one = frames("kind=hot target=tactile.16 at=0.002 for=0.002");
    assert_eq!(one, all([Ok(Some((2, 200, 4095))), Ok(Some((3, 300, 4095)))]));
}

#[test]
fn what_cannot_befall_a_half_is_refused_with_its_key() {
    let devices = || Devices { encoders: Some(Box::new(Turning)), ..Devices::default() };
    for (text, place) in [
        ("kind=jump value=5", "fault[0].target"),
        ("kind=jump target=analog_in value=5", "fault[0].target"),
        ("kind=jump target=encoders.7 value=5", "fault[0].target"),
        ("kind=hot target=encoders", "fault[0].kind"),
    ] {
        let refused = decorate(devices(), &plan(&[text]), 1).unwrap_err();
        assert_eq!(refused.place, place, "{text}: {refused}");
    }
    let lane = decorate(devices(), &plan(&["kind=silence target=lane.servo"]), 1);
    assert!(lane.is_ok(), "lanes are not the halves' affair");
}

#[test]
fn every_kind_can_befall_something_and_no_half_has_a_kind_twice() {
    let halves = [
        "encoders",
        "analog_out",
        "analog_in",
        "digital_in",
        "digital_out",
        "force_torque",
        "tactile",
    ];
    let elsewhere = [
        FaultKind::Reordering,
        FaultKind::Lateness,
        FaultKind::Overrun,
        FaultKind::ClockGap,
        FaultKind::Panic,
        FaultKind::NotFinite,
        FaultKind::Flood,
    ];
    for kind in FaultKind::ALL {
        let befalls = halves.iter().any(|half| kinds_of_half(half).contains(&kind));
        assert!(befalls != elsewhere.contains(&kind), "{kind:?}");
    }
    for half in halves {
        let mut kinds = kinds_of_half(half).to_vec();
        kinds.sort();
        kinds.dedup();
        assert_eq!(kinds.len(), kinds_of_half(half).len(), "{half}");
    }
}
