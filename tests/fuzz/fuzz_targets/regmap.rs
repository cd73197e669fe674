//! Whatever stands in the registers of a board: the identity, numbers of blocks, busy bits, counts
//! and codes of any content, changed between the jobs. The driver refuses the board with a place
//! and a remedy, or runs: no panic, no reading from the future, no code beyond the converters'
//! range.
#![no_main]

use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use taktil_drivers_regmap::registers::{BLOCK_BYTES, Register};
use taktil_drivers_regmap::{Board, Config, Description, Halves, RegisterFile, SHIPPED_BOARDS};
use taktil_fuzz::Numbers;
use taktil_hal::{CHANNELS, DacCode, ErrorKind, LinesOut, Nanos, TactileFrame};

/// Registers of a block.
const REGISTERS_COUNT: usize = BLOCK_BYTES / 2;
/// Most changes of registers before the board is opened, and before a job.
const CHANGES_MAX: u8 = 24;
/// Most jobs of a board.
const JOBS_MAX: usize = 16;
/// Rows and columns of the frame in the project's own layout.
const FRAME_ROWS: usize = 16;

/// A described board, and the words by which it is known: offset and content.
struct Kind {
    config: Config,
    identity: &'static [(usize, u16)],
}

fn kind(board: &str, identity: &'static [(usize, u16)]) -> Kind {
    let text = SHIPPED_BOARDS.iter().find(|(name, _)| *name == board).expect("it is shipped").1;
    // A busy bit that stays is looked at as often as the description says, in every job.
    let text = text.replace("polls = 1000", "polls = 10");
    let description = Description::from_toml(&text).expect("a shipped description is good");
    let mut config = Config { relay_ms: Some(10), ..Config::described("fuzz", "") };
    config.registers = Some(description);
    if board == "vme-arm" {
        // Two channels are joints' business, six are gauges.
        (config.analog_in_channels, config.gauge_channels) = (vec![0, 1], (2..8).collect());
    }
    Kind { config, identity }
}

/// A whole cell whose blocks are numbered, and a bus with a latch, a conversion and busy bits.
static KINDS: LazyLock<[Kind; 2]> = LazyLock::new(|| {
    [
        kind("taktil", &[(0x000, 0x544b), (0x002, 1)]),
        kind("vme-arm", &[(0x000, 0x5331), (0x102, 0x8605)]),
    ]
});

/// One block for all inputs, which each of them begins anew.
static REGISTERS: LazyLock<Arc<RegisterFile>> =
    LazyLock::new(|| Arc::new(RegisterFile::anonymous().expect("memory for a block")));

fn write(offset: usize, word: u16) {
    let register = Register::from_offset(offset).expect("an even offset inside the block");
    REGISTERS.write(register, word);
}

/// Some registers change: by a word, to the word of a neighbour, or by one.
fn change(numbers: &mut Numbers<'_>) {
    for _ in 0..numbers.byte() % CHANGES_MAX {
        let (at, how) = (usize::from(numbers.byte()), numbers.byte());
        // Most changes are of the first registers: those behind are the frame's.
        let at = if how & 8 == 0 { at } else { at + 0x100 } % REGISTERS_COUNT;
        let neighbour = (at + usize::from(how >> 4)) % REGISTERS_COUNT;
        let read = |at: usize| Register::from_offset(2 * at).map_or(0, |at| REGISTERS.read(at));
        let word = match how & 3 {
            0 => u16::from_be_bytes([numbers.byte(), numbers.byte()]),
            1 => u16::from(numbers.byte()),
            2 => read(neighbour),
            _ => read(at).wrapping_add(1),
        };
        write(2 * at, word);
    }
}

fn sample(halves: &mut Halves, release: Nanos, frame: &mut TactileFrame) {
    if let Some(half) = &mut halves.encoders
        && let Ok(reading) = half.sample(release)
    {
        assert!(reading.acquired <= release);
        let again = half.sample(release).expect("the same release has the same answer");
        assert_eq!(reading.value, again.value);
    }
    if let Some(half) = &mut halves.analog_in {
        let (low, high) = half.code_range();
        if let Ok(reading) = half.sample(release) {
            let wired = &reading.value[..half.channels()];
            assert!(wired.iter().all(|code| (low..=high).contains(code)), "{wired:?}");
        }
    }
    if let Some(half) = &mut halves.force_torque {
        let _ = half.sample(release).map(|reading| assert!(reading.acquired <= release));
    }
    if let Some(half) = &mut halves.tactile {
        let full_scale = half.full_scale();
        if half.sample(release, frame).is_ok() {
            assert!(frame.acquired <= release);
            assert!(frame.values.iter().all(|value| *value <= full_scale));
        }
    }
    if let Some(half) = &mut halves.digital_in {
        let _ = half.sample(release).map(|reading| assert!(reading.acquired <= release));
    }
}

fn commit(halves: &mut Halves, release: Nanos, feed: bool) {
    if let Some(half) = &mut halves.analog_out {
        let (low, high) = half.code_range();
        let _ = half.commit(release, &[if feed { low } else { high }; CHANNELS]);
        let beyond = half.commit(release, &[DacCode(high.0 + 1); CHANNELS]);
        assert!(beyond.is_err_and(|error| error.kind == ErrorKind::OutOfRange));
    }
    if let Some(half) = &mut halves.digital_out {
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        let _ = half.commit(release, &lines);
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut numbers = Numbers::new(bytes);
    let kind = &KINDS[usize::from(numbers.byte() & 1)];
    (0..REGISTERS_COUNT).for_each(|at| write(2 * at, 0));
    kind.identity.iter().for_each(|(offset, word)| write(*offset, *word));
    change(&mut numbers);
    let mut halves = match Board::attach_halves(REGISTERS.clone(), &kind.config) {
        Ok(halves) => halves,
        Err(refused) => {
            let text = refused.to_string();
            assert!(!refused.place().is_empty() && text.contains("; "), "{text}");
            return;
        }
    };
    let mut frame = TactileFrame::new(FRAME_ROWS, FRAME_ROWS);
    let mut release = Nanos::from_millis(100);
    for step in 0..JOBS_MAX {
        if !numbers.any() && step > 2 {
            break;
        }
        change(&mut numbers);
        release += Nanos::from_micros(2_500);
        sample(&mut halves, release, &mut frame);
        commit(&mut halves, release, step % 2 == 0);
    }
});
