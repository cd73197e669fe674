//! The descriptions that come with the driver, and how the text of any description is read.

use taktil_hal::Invalid;

use crate::description::Description;

/// How the file of a description ends, by which it is told from a name.
pub(crate) const BOARD_FILE_SUFFIX: &str = ".toml";
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

/// The text of a description that comes with the driver.
pub(crate) fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED_BOARDS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}
