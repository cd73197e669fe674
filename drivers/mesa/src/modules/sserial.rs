//! Smart serial with a 7I77: commands of the port's processor, states of the channels, and how six
//! analog codes are packed into user registers. Source: the SSLBP chapter of the 7I76E manual,
//! `SSLBP.INC` for the states, the process data that a 7I77 describes itself for the packing.

use crate::config::REMOTE_OUTPUTS;

/// Register: command; reads 0 when the last one is done.
pub(crate) const COMMAND_REGISTER: u32 = 0;
/// Register: a bit for each channel whose exchange failed.
pub(crate) const DATA_REGISTER: u32 = 1;
/// Register: control and status of a channel.
pub(crate) const STATUS_REGISTER: u32 = 2;
/// Register: the first user register of a channel; the others follow.
pub(crate) const USER_REGISTER: u32 = 3;
/// User registers that are written.
pub(crate) const USER_REGISTERS: usize = 3;

/// Command: stop all channels.
pub(crate) const STOP_COMMAND: u32 = 0x0800;
/// Command: start channels in normal mode, with their mask.
pub(crate) const START_COMMAND: u32 = 0x0900;
/// Command: start channels in setup mode, with their mask.
pub(crate) const SETUP_COMMAND: u32 = 0x0f00;
/// Command: exchange data with channels, with their mask.
pub(crate) const DO_IT_COMMAND: u32 = 0x1000;
/// A command that the processor ignores.
pub(crate) const IGNORED_COMMAND: u32 = 0x8000_0000;

/// Status: the remote has a fault; bit 24 then says that its watchdog has bitten.
const REMOTE_FAULT: u32 = 1 << 8;
/// Status: no remote answers.
const NO_REMOTE: u32 = 1 << 14;
/// Status: the channel is not started.
const NOT_READY: u32 = 1 << 15;
/// What only a stop and a start clear.
pub(crate) const RESTART_MASK: u32 = REMOTE_FAULT | NO_REMOTE | NOT_READY;

/// The name of a 7I77 in its second user register in setup mode.
pub(crate) const NAME_WORD: u32 = u32::from_le_bytes(*b"7I77");
/// Top byte of the unit number of field terminals.
pub(crate) const FIELD_UNIT: u32 = 0x12;
/// Top byte of the unit number of analog outputs.
pub(crate) const ANALOG_UNIT: u32 = 0x11;

/// Width of a code (bits).
const CODE_BITS: u32 = 13;
/// Mask of a code.
const CODE_MASK: u32 = (1 << CODE_BITS) - 1;
/// Lowest code: -10 V.
pub(crate) const CODE_MIN: i32 = -4_096;
/// Highest code: 10 V.
pub(crate) const CODE_MAX: i32 = 4_095;
/// Place of the bit without which all analog outputs stay off.
const ANALOG_ENABLE_BIT: u32 = 78;
/// Place of the bit that switches the spindle-enable output on.
const SPINDLE_ENABLE_BIT: u32 = 79;

/// Command: halts the port's processor, whatever it does.
pub(crate) const RESET_COMMAND: u32 = 0x4000;
/// Command: lets the processor begin anew.
pub(crate) const CLEAR_COMMAND: u32 = 0x0001;

/// The user registers for the codes of one 7I77, each in range; `enabled` switches the outputs on,
/// `spindle` the spindle-enable output.
pub(crate) fn pack(
    codes: &[i32; REMOTE_OUTPUTS],
    enabled: bool,
    spindle: bool,
) -> [u32; USER_REGISTERS] {
    let mut bits = u128::from(enabled) << ANALOG_ENABLE_BIT;
    bits |= u128::from(spindle) << SPINDLE_ENABLE_BIT;
    let mut shift = 0;
    for code in codes {
        bits |= u128::from(code.cast_unsigned() & CODE_MASK) << shift;
        shift += CODE_BITS;
    }
    // The upper half of the 96 bits is empty from bit 80 on.
    [bits as u32, (bits >> 32) as u32, (bits >> 64) as u32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_13_bits_stand_side_by_side_from_bit_0() {
        assert_eq!(pack(&[1, 0, 0, 0, 0, 0], false, false), [1, 0, 0]);
        assert_eq!(pack(&[0, 1, 0, 0, 0, 0], false, false), [1 << 13, 0, 0]);
        assert_eq!(pack(&[0, 0, 1, 0, 0, 0], false, false), [1 << 26, 0, 0]);
        assert_eq!(pack(&[0, 0, 0, 0, 0, 1], false, false), [0, 0, 2]);
        assert_eq!(pack(&[-1; 6], false, false), [u32::MAX, u32::MAX, 0x3fff]);
        assert_eq!(pack(&[0, 0, -4_096, 0, 0, 0], false, false), [0, 1 << 6, 0]);
        assert_eq!(pack(&[0; 6], true, false), [0, 0, 1 << 14]);
        assert_eq!(pack(&[0; 6], false, true), [0, 0, 1 << 15]);
    }
}
