//! Finds the description of a board: one that comes with the driver, a file, or the project's own
//! layout with the widths that the configuration states.

use std::fs::File;
use std::io::Read;

use taktil_hal::Invalid;

use crate::config::Config;
use crate::description::Description;
use crate::shipped::{SHIPPED_BOARDS, check_name, shipped};

/// The largest file of a description.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// The description of the board that a configuration is about.
pub(crate) fn description(config: &Config) -> Result<Description, Invalid> {
    if let Some(description) = &config.registers {
        return Ok(description.clone());
    }
    if config.board.is_empty() {
        return own_layout(config);
    }
    let at_board = |bad: Invalid| {
        let what = format!("{}: {}: {}", config.board, bad.place, bad.what);
        Invalid::new("board", what, bad.remedy)
    };
    if let Some(text) = shipped(&config.board) {
        return Description::from_toml(text).map_err(at_board);
    }
    check_name(&config.board)?;
    let text = text_of_file(&config.board).map_err(|error| {
        let what = format!("{} cannot be read ({error})", config.board);
        Invalid::new("board", what, "name the file of the board's description")
    })?;
    Description::from_toml(&text).map_err(at_board)
}

fn text_of_file(path: &str) -> std::io::Result<String> {
    let mut text = String::new();
    let read = File::open(path)?.take(FILE_BYTES_MAX + 1).read_to_string(&mut text)?;
    if read as u64 > FILE_BYTES_MAX {
        return Err(std::io::Error::other("it is larger than 1 MB"));
    }
    Ok(text)
}

/// The project's own layout, with the widths of the configuration.
fn own_layout(config: &Config) -> Result<Description, Invalid> {
    let mut own = Description::from_toml(SHIPPED_BOARDS[0].1)?;
    if let Some(encoders) = &mut own.encoders {
        encoders.bits = config.counter_bits;
    }
    if let Some(outputs) = &mut own.analog_out {
        outputs.bits = config.dac_bits;
    }
    if let Some(inputs) = &mut own.analog_in {
        inputs.bits = config.adc_bits;
    }
    if let Some(gauges) = &mut own.force_torque {
        gauges.bits = config.gauge_bits;
    }
    if let Some(tactile) = &mut own.tactile {
        (tactile.bits, tactile.scan_us) = (config.tactile_bits, config.tactile_scan_us);
    }
    own.check()?;
    Ok(own)
}

/// How many bytes are mapped.
pub(crate) fn window_bytes(config: &Config, description: &Description) -> usize {
    if config.is_described() { description.length_bytes } else { config.length_bytes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::*;

    #[test]
    fn every_shipped_description_is_sound() {
        for (name, text) in SHIPPED_BOARDS {
            assert!(
                Description::from_toml(text).is_ok(),
                "{name}: {:?}",
                Description::from_toml(text)
            );
        }
    }

    #[test]
    fn the_shipped_layout_is_that_of_the_register_map() {
        let own = own_layout(&Config::default()).unwrap();
        assert_eq!(own.length_bytes, BLOCK_BYTES);
        let block = |first: Option<usize>, begin: Option<usize>, end: Option<usize>| {
            [begin, first, end].map(Option::unwrap)
        };
        let of = |block: Block| {
            let first = block.words.get(0).unwrap();
            [block.begin, first, block.end].map(Register::offset_bytes)
        };
        let encoders = own.encoders.unwrap();
        let found = block(Some(encoders.offset), encoders.begin_offset, encoders.end_offset);
        assert_eq!(found, of(ENCODERS));
        assert_eq!(encoders.latch_offset, Some(ENCODER_LATCH.offset_bytes()));
        let index = own.index.unwrap();
        assert_eq!(block(Some(index.offset), index.begin_offset, index.end_offset), of(INDEX));
        let seen = INDEX.words.get(2 * LAYOUT_CHANNELS).unwrap();
        assert_eq!(index.seen_offset, seen.offset_bytes());
        let inputs = own.analog_in.unwrap();
        assert_eq!(block(Some(inputs.offset), inputs.begin_offset, inputs.end_offset), of(ADC));
        let gauges = own.force_torque.unwrap();
        let found = block(Some(gauges.offset), gauges.begin_offset, gauges.end_offset);
        assert_eq!(found, of(FORCE_TORQUE));
        let tactile = own.tactile.unwrap();
        assert_eq!([tactile.begin_offset, tactile.offset, tactile.end_offset], of(TACTILE));
        assert_eq!((tactile.rows, tactile.cols), (TACTILE_ROWS, TACTILE_COLS));
        let outputs = own.analog_out.unwrap();
        assert_eq!(outputs.offset, DAC.get(0).unwrap().offset_bytes());
        assert_eq!(outputs.strobe_offset, Some(DAC_STROBE.offset_bytes()));
        let identity: Vec<_> = own.identity.iter().map(|e| (e.offset, e.value)).collect();
        let due = [(ID.offset_bytes(), ID_VALUE), (VERSION.offset_bytes(), VERSION_VALUE)];
        assert_eq!(identity, due.map(|(offset, value)| (offset, u32::from(value))));
    }
}
