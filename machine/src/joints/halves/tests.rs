//! Tests of encoders and converters in another order: what the conformance suite promises, wraps of
//! counts under a scale, reversed ranges, limits, index pulses.

#![expect(clippy::disallowed_types, reason = "a board of a test, which no lane waits for")]

use std::sync::{Arc, Mutex};

use taktil_hal::conformance::{
    CycleDriver, check_analog_out_drop, check_analog_out_observed, check_encoders,
};

use super::*;

/// What a board of the tests shares with its test.
#[derive(Debug, Default)]
struct Shared {
    counts: [i32; CHANNELS],
    pulses: IndexPulses,
    codes: [i32; CHANNELS],
    error: Option<Error>,
}

type SharedBoard = Arc<Mutex<Shared>>;

struct BoardEncoders(SharedBoard, usize);

impl Encoders for BoardEncoders {
    fn joints(&self) -> usize {
        self.1
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let board = self.0.lock().unwrap();
        match board.error {
            Some(error) => Err(error),
            None => Ok(Reading { value: board.counts.map(Counts), acquired: release }),
        }
    }

    fn has_index(&self) -> bool {
        true
    }

    fn index_pulses(&self) -> IndexPulses {
        self.0.lock().unwrap().pulses
    }

    fn index_pulse_reach(&self) -> i32 {
        30_000
    }
}

struct BoardOutputs(SharedBoard, (i32, i32));

impl AnalogOut for BoardOutputs {
    fn channels(&self) -> usize {
        4
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(self.1.0), DacCode(self.1.1))
    }

    fn commit(&mut self, _: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut board = self.0.lock().unwrap();
        if let Some(error) = board.error {
            return Err(error);
        }
        for (i, DacCode(code)) in codes.iter().enumerate().take(4) {
            let bad = Error::on_channel(ErrorKind::OutOfRange, "board", 0);
            if *code < self.1.0 || *code > self.1.1 {
                return Err(bad);
            }
            board.codes[i] = *code;
        }
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.0.lock().unwrap().codes = [0; CHANNELS];
        Ok(())
    }

    fn safe_value(&self) -> DacCode {
        DacCode(0)
    }

    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(50)
    }
}

impl Drop for BoardOutputs {
    fn drop(&mut self) {
        let _ = self.safe();
    }
}

fn channel(channel: usize, scale: f64) -> EncoderChannel {
    EncoderChannel { channel, scale, disc_counts: None }
}

fn connected(all: &[EncoderChannel]) -> (SharedBoard, ConnectedEncoders) {
    let board = SharedBoard::default();
    let half = ConnectedEncoders::new(Box::new(BoardEncoders(board.clone(), 4)), all).unwrap();
    (board, half)
}

fn shown(half: &mut ConnectedEncoders) -> [i32; CHANNELS] {
    half.sample(Nanos::ZERO).unwrap().value.map(|Counts(count)| count)
}

fn output(channel: usize, scale: f64, limit_codes: f64) -> OutputChannel {
    OutputChannel { channel, scale, limit_codes }
}

fn outputs(all: &[OutputChannel]) -> (SharedBoard, ConnectedAnalogOut) {
    let board = SharedBoard::default();
    let half = BoardOutputs(board.clone(), (-2048, 2047));
    (board.clone(), ConnectedAnalogOut::new(Box::new(half), all).unwrap())
}

#[test]
fn connected_halves_keep_the_promises_of_halves() {
    let wiring = [channel(2, -1.0), channel(0, 0.37), channel(3, 0.0)];
    let (board, mut half) = connected(&wiring);
    let mut moved = 0;
    let mut bench = CycleDriver::new(Nanos::ZERO, Nanos::from_micros(2_500), |_| {
        moved += 1;
        board.lock().unwrap().counts[..4].copy_from_slice(&[7 * moved, 1, -3 * moved, 100]);
    });
    assert_eq!(check_encoders(&mut half, &mut bench), []);

    let all = [output(1, -1.0, f64::INFINITY), output(0, 1.0, f64::INFINITY)];
    let (board, mut half) = outputs(&all);
    let mut bench = CycleDriver::stationary();
    // What the joints' own codes are, as read back from the board's channels; a converter reaches
    // one code farther down than up, which a reversed motor does without.
    let mut seen = || {
        let codes = board.lock().unwrap().codes;
        let mut own = [DacCode(0); CHANNELS];
        own[0] = DacCode(if codes[1] == 2047 { -2048 } else { -codes[1] });
        own[1] = DacCode(codes[0]);
        own
    };
    assert_eq!(check_analog_out_observed(&mut half, &mut bench, &mut seen), []);
    assert_eq!(check_analog_out_drop(Box::new(half), &mut bench, &mut seen), []);
}

#[test]
fn each_joint_reads_its_own_channel_direction_and_scale() {
    let (board, mut half) = connected(&[channel(3, 1.0), channel(0, -1.0), channel(1, 2.5)]);
    board.lock().unwrap().counts[..4].copy_from_slice(&[10, 20, 30, 40]);
    let shown = shown(&mut half);
    assert_eq!(shown[..4], [40, -10, 50, 0]);
    assert_eq!(half.joints(), 3);
    assert_eq!(half.index_pulse_reach(), 30_000, "no scale below 1");
}

#[test]
fn a_count_that_wraps_shows_no_jump_at_any_scale() {
    for scale in [1.0, -1.0, 0.37, -2.41, 3.0] {
        let (board, mut half) = connected(&[channel(1, scale)]);
        let start = i32::MAX - 500;
        board.lock().unwrap().counts[1] = start;
        let mut last = shown(&mut half)[0];
        let first = last;
        for step in 1..=200 {
            board.lock().unwrap().counts[1] = start.wrapping_add(10 * step);
            let now = shown(&mut half)[0];
            let moved = f64::from(now.wrapping_sub(last));
            assert!((moved - 10.0 * scale).abs() <= 1.0, "{scale}: {moved} at step {step}");
            last = now;
        }
        let all = f64::from(last.wrapping_sub(first));
        assert!((all - 2000.0 * scale).abs() <= 1.0, "{scale}: {all}");
    }
}

#[test]
fn index_pulses_follow_their_channel_through_scale_and_wrap() {
    let (board, mut half) = connected(&[channel(2, -1.0), channel(1, 0.5), channel(0, 0.0)]);
    assert_eq!(half.index_pulses(), [None; CHANNELS], "before the first reading");
    {
        let mut board = board.lock().unwrap();
        board.counts = [5; CHANNELS];
        board.counts[2] = i32::MAX - 3;
    }
    shown(&mut half);
    {
        let mut board = board.lock().unwrap();
        board.counts[2] = i32::MIN + 6;
        board.counts[1] = 400;
        board.pulses[2] = Some(Counts(i32::MIN + 1));
        board.pulses[1] = Some(Counts(300));
        board.pulses[0] = Some(Counts(3));
    }
    let now = shown(&mut half);
    let pulses = half.index_pulses();
    let Some(Counts(pulse)) = pulses[0] else { panic!("no pulse") };
    assert_eq!(now[0].wrapping_sub(pulse), -5, "as far from the count as on the board");
    assert_eq!(pulses[1], Some(Counts(150)));
    assert_eq!(pulses[2], None, "an encoder that stands still has no pulse");
    assert_eq!(half.index_pulse_reach(), 15_000);
}

#[test]
fn a_disc_that_turns_otherwise_has_pulses_of_its_own() {
    let own = EncoderChannel { channel: 0, scale: -2.0, disc_counts: Some(100) };
    let (board, mut half) = connected(&[own]);
    let mut pulse = |count: i32| {
        board.lock().unwrap().counts[0] = count;
        shown(&mut half);
        half.index_pulses()[0].map(|Counts(count)| count)
    };
    assert_eq!(pulse(0), None);
    assert_eq!(pulse(20), None);
    assert_eq!(pulse(30), Some(-50));
    assert_eq!(pulse(80), Some(-150));
    assert_eq!(pulse(79), Some(-150));
    assert_eq!(pulse(0), Some(-50));
    assert_eq!(pulse(-30), Some(50));
}

#[test]
fn a_channel_that_the_board_lacks_is_refused_with_its_place() {
    let board = || Box::new(BoardEncoders(SharedBoard::default(), 4));
    let refused = ConnectedEncoders::new(board(), &[channel(0, 1.0), channel(4, 1.0)]);
    assert_eq!(refused.map(|_| ()).unwrap_err().place, "encoder_channel[1]");
    let half = Box::new(BoardOutputs(SharedBoard::default(), (-8, 7)));
    let refused = ConnectedAnalogOut::new(half, &[output(9, 1.0, 1.0)]);
    assert_eq!(refused.map(|_| ()).unwrap_err().place, "motor_channel[0]");
}

#[test]
fn codes_go_to_their_channel_reversed_scaled_and_limited() {
    let (board, mut half) = outputs(&[output(2, -1.0, 1000.0), output(0, 0.5, f64::INFINITY)]);
    assert_eq!(half.code_range(), (DacCode(-2048), DacCode(2048)));
    let mut commit = |first: i32, second: i32| {
        let mut codes = [DacCode(0); CHANNELS];
        (codes[0], codes[1]) = (DacCode(first), DacCode(second));
        half.commit(Nanos::ZERO, &codes).map(|()| board.lock().unwrap().codes)
    };
    assert_eq!(commit(300, 101).unwrap()[..4], [51, 0, -300, 0]);
    assert_eq!(commit(-2048, -2048).unwrap()[..4], [-1024, 0, 1000, 0], "limited");
    let refused = commit(2049, 0).unwrap_err();
    assert_eq!((refused.kind, refused.channel), (ErrorKind::OutOfRange, 0));
    let refused = commit(0, -2049).unwrap_err();
    assert_eq!(refused.channel, 1);
    assert_eq!(board.lock().unwrap().codes[..4], [-1024, 0, 1000, 0], "nothing was written");
}

#[test]
fn the_range_of_reversed_and_of_wider_converters_holds_the_arm_s_own() {
    let half = |range, all: &[OutputChannel]| {
        let board = Box::new(BoardOutputs(SharedBoard::default(), range));
        ConnectedAnalogOut::new(board, all).unwrap().code_range()
    };
    let free = f64::INFINITY;
    let reversed = [output(0, -1.0, free), output(1, -1.0, free)];
    assert_eq!(half((-2048, 2047), &reversed), (DacCode(-2048), DacCode(2048)));
    let mixed = [output(0, -1.0, free), output(1, 1.0, free)];
    assert_eq!(half((-2048, 2047), &mixed), (DacCode(-2048), DacCode(2047)));
    let wide = [output(0, 16.0, free), output(1, -16.0, free)];
    let (low, high) = half((-32_768, 32_767), &wide);
    assert!(low.0 <= -2048 && high.0 >= 2047, "{low:?} {high:?}");
}

#[test]
fn an_error_of_the_board_names_the_joint() {
    let lost = |channel| Some(Error::on_channel(ErrorKind::Lost, "board", channel));
    let (board, mut half) = connected(&[channel(3, 1.0), channel(1, 1.0)]);
    board.lock().unwrap().error = lost(1);
    assert_eq!(half.sample(Nanos::ZERO).unwrap_err().channel, 1);
    board.lock().unwrap().error = lost(3);
    assert_eq!(half.sample(Nanos::ZERO).unwrap_err().channel, 0);
    let (board, half) = outputs(&[output(2, 1.0, 9.0), output(3, 1.0, 9.0)]);
    let mut half = half.reading(&[5, 4]);
    board.lock().unwrap().error = lost(3);
    let refused = half.commit(Nanos::ZERO, &[DacCode(0); CHANNELS]).unwrap_err();
    assert_eq!(refused.channel, 4, "the caller's channel");
    assert_eq!(half.channels(), 6);
}
