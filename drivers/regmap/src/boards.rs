//! Finds the description of a board: one that comes with the driver, a file, or the project's own
//! layout with the widths that the configuration states.

use std::fs::File;
use std::io::Read;

use taktil_hal::Invalid;

use crate::config::Config;
use crate::description::Description;
use crate::registers::TACTILE_ROWS;

/// How the file of a description ends, by which it is told from a name.
pub(crate) const BOARD_FILE_SUFFIX: &str = ".toml";
/// The largest file of a description.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Name and text of the descriptions that come with the driver.
pub const SHIPPED_BOARDS: [(&str, &str); 5] = [
    ("taktil", include_str!("../boards/taktil.toml")),
    ("dvme-628", include_str!("../boards/dvme-628.toml")),
    ("lxvme-s01", include_str!("../boards/lxvme-s01.toml")),
    ("vme-8605", include_str!("../boards/vme-8605.toml")),
    ("vme-arm", include_str!("../boards/vme-arm.toml")),
];

impl Description {
    /// Reads and checks the text of a description.
    ///
    /// # Errors
    /// The first thing that is wrong. What is no TOML or has an unknown or missing key is at the
    /// line of the text.
    pub fn from_toml(text: &str) -> Result<Description, Invalid> {
        let description: Description = toml::from_str(text).map_err(|error| {
            let before = error.span().map_or(0, |span| span.start.min(text.len()));
            let line = text.as_bytes()[..before].iter().filter(|byte| **byte == b'\n').count() + 1;
            let what = error.message().replace('\n', " ");
            Invalid::new(format!("line {line}"), what, "correct that line of the description")
        })?;
        description.check()?;
        Ok(description)
    }
}

/// Refuses a name that is neither a file's nor that of a shipped description.
pub(crate) fn check_name(board: &str) -> Result<(), Invalid> {
    if board.ends_with(BOARD_FILE_SUFFIX) || shipped(board).is_some() {
        return Ok(());
    }
    let names = SHIPPED_BOARDS.map(|(name, _)| name).join(", ");
    let remedy = format!("name a file that ends in {BOARD_FILE_SUFFIX}, or one of: {names}");
    Err(Invalid::new("board", format!("`{board}` is no description that is known"), remedy))
}

fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED_BOARDS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

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
        debug_assert_eq!(tactile.rows, TACTILE_ROWS);
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
