//! Takes a board into use: locks its subdevices, sets counters and directions up, and puts the
//! outputs at their safe values. Each step that the board refuses is named with the channel that
//! needs it.

use std::sync::Arc;

use nix::errno::Errno;
use taktil_hal::{ErrorKind, Nanos, OpenError};

use crate::board::{Board, Instruction, InstructionList};
use crate::config::{Config, CounterSetup, EncoderChannel};
use crate::error;
use crate::exchange::{Statistics, Tally};
use crate::outputs::{ComediAnalogOut, ComediDigitalOut};
use crate::sharing::Shared;
use crate::uapi;
use crate::wiring::{Counter, DigitalLine, Wiring};

/// A board that is being taken into use.
pub(crate) struct Setup<'a> {
    pub(crate) board: Arc<dyn Board>,
    pub(crate) config: &'a Config,
    pub(crate) wiring: &'a Wiring,
    pub(crate) statistics: Shared<Statistics>,
}

/// The output halves, safe.
pub(crate) struct Outputs {
    pub(crate) analog_out: Option<ComediAnalogOut>,
    pub(crate) digital_out: Option<ComediDigitalOut>,
}

impl Setup<'_> {
    fn failed(&self, action: &str, errno: Errno) -> OpenError {
        error::from_errno(&self.config.path, action, errno)
    }

    pub(crate) fn tally(&self) -> Tally {
        Tally::new(self.statistics.clone())
    }

    /// Locks every subdevice that is used, so that no other process can make it busy.
    pub(crate) fn lock(&self) -> Result<(), OpenError> {
        for subdevice in self.wiring.subdevices() {
            self.board
                .lock(subdevice)
                .map_err(|errno| self.failed(&format!("locking subdevice {subdevice}"), errno))?;
        }
        Ok(())
    }

    /// Makes the counters count and the input lines inputs.
    pub(crate) fn inputs(&self) -> Result<(), OpenError> {
        let pairs = self.config.encoders.iter().zip(&self.wiring.counters);
        for (at, (wanted, counter)) in pairs.enumerate() {
            for words in counter_words(wanted) {
                self.configure(&format!("setting up encoders[{at}]"), *counter, &words)?;
            }
        }
        for (name, line) in
            ["drive_power", "estop_a_closed", "estop_b_closed"].iter().zip(&self.wiring.lines_in)
        {
            self.direct(&format!("lines_in.{name}"), *line, uapi::LINE_INPUT_CONFIG)?;
        }
        Ok(())
    }

    /// Makes the output halves and puts them at their safe values; levels come before directions,
    /// so that no line is ever driven to another one.
    pub(crate) fn outputs(&self) -> Result<Outputs, OpenError> {
        let silence = Nanos::from_millis(i64::from(self.config.watchdog_ms));
        let (analog, lines) = (&self.wiring.analog_out, &self.wiring.lines_out);
        let refused = |half: &str, kind: ErrorKind| {
            let what = format!("the safe values of {half} were refused ({})", kind.name());
            let remedy = "check board and cable, and that no acquisition runs on it";
            error::device(&self.config.path, what, remedy)
        };
        let mut digital_out = (!lines.is_empty())
            .then(|| ComediDigitalOut::new(self.board.clone(), lines, silence, self.tally()));
        if let Some(half) = &mut digital_out {
            half.write_safe().map_err(|kind| refused("lines_out", kind))?;
            for (name, line) in ["enable", "brake_release", "watchdog_feed"].iter().zip(lines) {
                self.direct(&format!("lines_out.{name}"), *line, uapi::LINE_OUTPUT_CONFIG)?;
            }
            half.write_safe().map_err(|kind| refused("lines_out", kind))?;
        }
        let mut analog_out = (!analog.is_empty())
            .then(|| ComediAnalogOut::new(self.board.clone(), analog, silence, self.tally()));
        if let Some(half) = &mut analog_out {
            half.write_safe().map_err(|kind| refused("analog_out", kind))?;
        }
        Ok(Outputs { analog_out, digital_out })
    }

    /// Checks that no direction was changed by that of another line: many chips direct their lines
    /// in groups.
    pub(crate) fn check_directions(&self) -> Result<(), OpenError> {
        for (lines, direction) in [(&self.wiring.lines_in, 0), (&self.wiring.lines_out, 1)] {
            for line in lines.iter().filter(|line| line.has_direction) {
                let words = [uapi::LINE_QUERY_CONFIG, 0];
                let mut list = config_list(line.subdevice, u32::from(line.channel), &words);
                // A board that cannot be asked is taken at its word.
                let answer = self.execute_alone(&mut list).ok().and(list.instructions().first());
                if answer.is_some_and(|answer| answer.words()[1] != direction) {
                    let what = format!(
                        "channel {} of subdevice {} took the direction of another line",
                        line.channel, line.subdevice
                    );
                    let remedy = "the board directs lines in groups: put inputs and outputs into \
                                  different groups";
                    return Err(error::device(&self.config.path, what, remedy));
                }
            }
        }
        Ok(())
    }

    fn direct(&self, place: &str, line: DigitalLine, direction: u32) -> Result<(), OpenError> {
        if !line.has_direction {
            return Ok(());
        }
        let mut list = config_list(line.subdevice, u32::from(line.channel), &[direction]);
        self.execute_alone(&mut list)
            .map_err(|errno| self.failed(&format!("directing {place}"), errno))
    }

    fn configure(&self, action: &str, counter: Counter, words: &[u32]) -> Result<(), OpenError> {
        let mut list = config_list(counter.subdevice, counter.channel_word, words);
        self.execute_alone(&mut list).map_err(|errno| self.failed(action, errno))
    }

    /// Executes a list of one instruction; one that ends before it has failed.
    fn execute_alone(&self, list: &mut InstructionList) -> Result<(), Errno> {
        let executed = self.board.execute(list)?;
        if executed == 1 { Ok(()) } else { Err(Errno::EIO) }
    }
}

fn config_list(subdevice: u32, channel_word: u32, words: &[u32]) -> InstructionList {
    let kind = uapi::CONFIG_INSTRUCTION;
    InstructionList::new(vec![Instruction::new(kind, subdevice, channel_word, words)])
}

/// The configurations that make a counter count, in order.
fn counter_words(wanted: &EncoderChannel) -> Vec<Vec<u32>> {
    match wanted.setup {
        CounterSetup::Running => Vec::new(),
        CounterSetup::Armed => {
            let mut all = vec![vec![uapi::RESET_CONFIG]];
            for gate in 0..2 {
                all.push(vec![uapi::GATE_SOURCE_CONFIG, gate, uapi::GATE_DISABLED_SELECT]);
            }
            for (track, source) in [(0, wanted.source_a), (1, wanted.source_b)] {
                if let Some(source) = source {
                    all.push(vec![uapi::OTHER_SOURCE_CONFIG, track, source]);
                }
            }
            let mode = wanted.mode.unwrap_or(uapi::QUADRATURE_MODE_BITS);
            all.push(vec![uapi::COUNTER_MODE_CONFIG, mode]);
            all.push(vec![uapi::ARM_CONFIG, uapi::ARM_AT_ONCE_SELECT]);
            all
        }
        CounterSetup::Quadrature => {
            vec![vec![uapi::QUADRATURE_CONFIG, wanted.mode.unwrap_or(0), 0, 0]]
        }
        CounterSetup::Preload => vec![vec![0]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_armed_counter_is_reset_first_and_armed_last() {
        let mut wanted = EncoderChannel::new(0, CounterSetup::Armed);
        wanted.source_a = Some(9);
        let due: [&[u32]; 6] = [
            &[34],
            &[2001, 0, 0x8000],
            &[2001, 1, 0x8000],
            &[2005, 0, 9],
            &[4097, 0x0203_0000],
            &[31, 0],
        ];
        assert_eq!(counter_words(&wanted), due);
        wanted.mode = Some(7);
        assert_eq!(counter_words(&wanted)[4], [4097, 7]);
    }

    #[test]
    fn other_counters_get_one_configuration_or_none() {
        let words = |setup| counter_words(&EncoderChannel::new(0, setup));
        assert_eq!(words(CounterSetup::Quadrature), [vec![1003, 0, 0, 0]]);
        assert_eq!(words(CounterSetup::Preload), [vec![0]]);
        assert!(words(CounterSetup::Running).is_empty());
    }
}
