//! Properties that hold for every board and every answer: no panic, codes in their range, counts
//! that follow the disc, outputs that are never half refused.

mod rig;

use std::sync::Arc;

use nix::errno::Errno;
use proptest::prelude::*;
use rig::{ANALOG_IN_SUBDEVICE, COUNTERS_SUBDEVICE, SharedDouble, codes_out, robot_config};
use taktil_drivers_comedi::attach;
use taktil_drivers_comedi::board::{
    Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo,
};
use taktil_drivers_comedi_double::Double;
use taktil_hal::fault::{FaultPlan, FaultTarget};
use taktil_hal::{CHANNELS, DacCode, LinesOut, Nanos};

/// A board that answers anything at all.
#[derive(Debug)]
struct Oracle {
    answers: Vec<u32>,
}

impl Oracle {
    fn answer(&self, at: u32) -> u32 {
        let length = self.answers.len() as u32;
        self.answers[(at % length) as usize].rotate_left(at / length % 32)
    }
}

impl Board for Oracle {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        Ok(DeviceInfo::default())
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        // Kinds in the order in which the configuration finds them, with flags of any kind.
        let made = |kind| SubdeviceInfo { kind, channels: 24, flags: self.answer(kind) };
        Ok([1, 2, 3, 4, 6].map(made).to_vec())
    }

    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        let bits = 8 + self.answer(subdevice) % 25;
        let odd = self.answer(subdevice + 1).is_multiple_of(8);
        let maxdata = if odd { self.answer(subdevice + 2) } else { u32::MAX >> (32 - bits) };
        Ok(vec![ChannelInfo { maxdata, range_type: subdevice << 24 | 1 }; 24])
    }

    fn ranges(&self, range_type: u32) -> Result<Vec<Range>, Errno> {
        let odd = self.answer(range_type >> 24) % 8 == 1;
        let [min, max] = if odd {
            [self.answer(7).cast_signed(), self.answer(8).cast_signed()]
        } else {
            [-10_000_000, 10_000_000]
        };
        Ok(vec![Range { min_millionths: min, max_millionths: max, flags: 0 }])
    }

    fn lock(&self, _subdevice: u32) -> Result<(), Errno> {
        Ok(())
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        let due = list.instructions().len();
        let turn = self.answer(due as u32);
        for instruction in list.instructions_mut() {
            let seed = instruction.subdevice + instruction.channel;
            for (at, word) in instruction.words_mut().iter_mut().enumerate() {
                *word = self.answer(seed + at as u32);
            }
        }
        match turn % 8 {
            0 => Err(Errno::from_raw((turn >> 8) as i32 & 0x7f)),
            1 => Ok(turn as usize),
            _ => Ok(due),
        }
    }
}

/// Six codes and zeros.
fn wide(codes: [i32; 6]) -> [DacCode; CHANNELS] {
    core::array::from_fn(|at| DacCode(codes.get(at).copied().unwrap_or(0)))
}

proptest! {
    #[test]
    fn no_answer_of_a_board_is_a_panic_or_a_code_out_of_range(
        answers in prop::collection::vec(any::<u32>(), 1..64),
    ) {
        let board = Arc::new(Oracle { answers });
        let Ok(mut halves) = attach(board, &robot_config()) else { return Ok(()) };
        for cycle in 0..8 {
            let release = Nanos::from_micros(cycle * 2_500);
            let _ = halves.encoders.as_mut().unwrap().sample(release);
            let _ = halves.force_torque.as_mut().unwrap().sample(release);
            let _ = halves.digital_in.as_mut().unwrap().sample(release);
            let input = halves.analog_in.as_mut().unwrap();
            let (low, high) = input.code_range();
            if let Ok(reading) = input.sample(release) {
                let wired = &reading.value[..input.channels()];
                prop_assert!(wired.iter().all(|code| (low..=high).contains(code)));
            }
            let out = halves.analog_out.as_mut().unwrap();
            let _ = out.commit(release, &[out.code_range().1; CHANNELS]);
            let _ = out.safe();
            let _ = halves.digital_out.as_mut().unwrap().commit(release, &LinesOut::SAFE);
        }
    }

    #[test]
    fn counts_follow_a_disc_that_turns_less_than_half_a_range_a_cycle(
        bits in prop::sample::select(vec![8, 12, 16, 20, 24, 31, 32]),
        steps in prop::collection::vec(-1.0..1.0_f64, 1..60),
    ) {
        let double = SharedDouble::new(Double::robot_board(bits));
        let mut halves = double.open(&robot_config()).unwrap();
        let (mut turned, reach) = (0_i64, (1_i64 << (bits - 1)) - 1);
        for (cycle, step) in (1..).zip(steps) {
            turned += (step * reach as f64) as i64;
            double.look().set_count(COUNTERS_SUBDEVICE, 2, turned);
            let reading = halves.encoders.as_mut().unwrap().sample(Nanos(cycle)).unwrap();
            prop_assert_eq!(reading.value[2].0, turned as i32);
        }
    }

    #[test]
    fn a_refused_commit_changes_no_channel(
        before in prop::array::uniform6(-32_768..=32_767_i32),
        after in prop::array::uniform6(-40_000..=40_000_i32),
    ) {
        let double = SharedDouble::new(Double::robot_board(16));
        let mut halves = double.open(&robot_config()).unwrap();
        let out = halves.analog_out.as_mut().unwrap();
        out.commit(Nanos(0), &wide(before)).unwrap();
        let bad = after.iter().position(|code| !(-32_768..=32_767).contains(code));
        let answer = out.commit(Nanos(1), &wide(after));
        prop_assert_eq!(answer.err().map(|error| usize::from(error.channel)), bad);
        let due = if bad.is_some() { before } else { after };
        prop_assert_eq!(&codes_out(&double)[..6], &wide(due)[..6]);
    }

    #[test]
    fn a_plan_of_a_seed_ends_and_the_board_is_whole_again(seed in any::<u64>()) {
        let double = SharedDouble::new(Double::robot_board(24));
        let mut halves = double.open(&robot_config()).unwrap();
        let length = Nanos::from_millis(500);
        let kinds = &taktil_drivers_comedi_double::EXECUTED_FAULTS;
        let plan = FaultPlan::draw(seed, &[FaultTarget { name: "comedi", kinds }], length);
        double.look().set_plan(plan, seed).unwrap();
        let mut lost = false;
        for cycle in 0..200 {
            let release = Nanos::from_micros(cycle * 2_500);
            double.look().advance(release);
            double.look().set_sample(ANALOG_IN_SUBDEVICE, 0, 0x8000 + cycle as u32);
            let answer = halves.analog_in.as_mut().unwrap().sample(release);
            lost |= answer.is_err_and(|error| error.kind == taktil_hal::ErrorKind::Lost);
        }
        double.look().advance(length);
        if lost {
            drop(halves);
            halves = double.open(&robot_config()).unwrap();
        }
        double.look().set_sample(ANALOG_IN_SUBDEVICE, 0, 0x8123);
        let reading = halves.analog_in.as_mut().unwrap().sample(length).unwrap();
        prop_assert_eq!(reading.value[0].0, 0x123);
    }
}
