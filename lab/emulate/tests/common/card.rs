//! The card's configuration for the emulated cabinet.

use taktil_drivers_mesa::{Config, Line, LinesInConfig, LinesOutConfig, Terminal};
use taktil_lab_emulate::CardWiring;

/// A card at this address whose lines are wired as the cabinet has them.
pub(crate) fn card_config(address: &str) -> Config {
    let wiring = CardWiring::STANDARD;
    let field = |number: u32| Line::at(Terminal::Field, number);
    Config {
        address: address.to_owned(),
        lines_in: Some(LinesInConfig {
            drive_power: field(wiring.drive_power),
            estop_a: field(wiring.estop_a),
            estop_b: field(wiring.estop_b),
        }),
        lines_out: Some(LinesOutConfig {
            enable: field(wiring.enable),
            brake_release: field(wiring.brake_release),
            watchdog_feed: wiring.watchdog_feed.map(field),
        }),
        ..Config::default()
    }
}
