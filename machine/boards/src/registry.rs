//! Drivers by name: those of this repository, and those that a program outside it registers at its
//! start. A name that occurs twice and a second registration are errors.

use std::sync::OnceLock;

use taktil_hal::Invalid;
use taktil_machine::device::SIMULATOR;

use crate::driver::Driver;
use crate::house::HOUSE_DRIVERS;

static OWN_DRIVERS: OnceLock<&'static [Driver]> = OnceLock::new();

/// Registers the drivers of this program, once, before anything is loaded.
///
/// # Errors
/// A second call; a name that occurs twice, is a driver of this repository, or is no valid name.
pub fn register(drivers: &'static [Driver]) -> Result<(), Invalid> {
    check(drivers)?;
    OWN_DRIVERS.set(drivers).map_err(|_| {
        let what = "the drivers of this program were named already";
        Invalid::new("device", what, "name all of them in one call")
    })
}

fn check(drivers: &[Driver]) -> Result<(), Invalid> {
    for (at, Driver { name, .. }) in drivers.iter().enumerate() {
        let place = format!("device.{name}");
        let first = name.bytes().next().is_some_and(|c| c.is_ascii_lowercase());
        let rest = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_' || c == b'-';
        if !first || !name.bytes().all(rest) {
            let remedy = "begin with a lower-case letter; go on with such, digits, `_` and `-`";
            return Err(Invalid::new(place, format!("`{name}` is no name of a driver"), remedy));
        }
        let house = HOUSE_DRIVERS.iter().any(|driver| driver.name == *name);
        if house || *name == SIMULATOR || drivers[..at].iter().any(|other| other.name == *name) {
            let what = format!("two drivers are called `{name}`");
            return Err(Invalid::new(place, what, "give one of them another name"));
        }
    }
    Ok(())
}

/// All drivers of this program.
pub fn drivers() -> impl Iterator<Item = &'static Driver> {
    HOUSE_DRIVERS.iter().chain(OWN_DRIVERS.get().copied().unwrap_or_default())
}

/// The driver of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Driver> {
    drivers().find(|driver| driver.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::OpenError;
    use taktil_machine::own::Section;

    use crate::driver::Opened;
    use crate::epoch::Epoch;

    fn none(_: &Section, _: &Epoch) -> Result<Opened, OpenError> {
        Ok(Opened::default())
    }

    fn refused(names: &[&'static str]) -> String {
        let all: Vec<Driver> = names
            .iter()
            .map(|name| Driver { name, open: none, keys: Vec::new, make_safe: None })
            .collect();
        check(&all).map_or_else(|bad| bad.to_string(), |()| String::new())
    }

    #[test]
    fn names_that_cannot_be_told_apart_or_written_are_refused() {
        assert_eq!(refused(&["ati-netft", "dac_2"]), "");
        for house in ["mesa", "serial", "comedi", "regmap", "simulator"] {
            assert!(refused(&[house]).contains("two drivers"), "{house}");
        }
        assert!(refused(&["own", "own"]).contains("two drivers"));
        for bad in ["", "Own", "2own", "own.x", "o wn"] {
            assert!(refused(&[bad]).contains("no name of a driver"), "{bad:?}");
        }
    }
}
