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
/// A second call; a name that occurs twice, is a driver of this repository, or is no valid name; a
/// system call without a valid name.
pub fn register(drivers: &'static [Driver]) -> Result<(), Invalid> {
    check(drivers)?;
    OWN_DRIVERS.set(drivers).map_err(|_| {
        let what = "the drivers of this program were named already";
        Invalid::new("device", what, "name all of them in one call")
    })
}

fn check(drivers: &[Driver]) -> Result<(), Invalid> {
    for (at, driver) in drivers.iter().enumerate() {
        let name = &driver.name;
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
        if let Some(call) = driver.system_calls.iter().find(|call| !call.has_good_name()) {
            let what = format!("`{}` of `{name}` is no name of a system call", call.name);
            let remedy = "name the C library's function, such as `pread64`";
            return Err(Invalid::new(place, what, remedy));
        }
    }
    Ok(())
}

/// All drivers of this program.
pub fn drivers() -> impl Iterator<Item = &'static Driver> {
    HOUSE_DRIVERS.iter().chain(OWN_DRIVERS.get().copied().unwrap_or_default())
}

/// A driver of this repository that this program was built without: what to do about it.
#[must_use]
pub fn left_out(name: &str) -> Option<&'static str> {
    let is_ethercat = name == "ethercat" && find(name).is_none();
    is_ethercat.then_some(
        "this program was built without it: take the one of the package, or build it with \
         `cargo build --release --features ethercat`",
    )
}

/// The driver of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Driver> {
    drivers().find(|driver| driver.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::{OpenError, SystemCall};
    use taktil_machine::own::Section;

    use crate::driver::Opened;
    use crate::epoch::Epoch;

    fn none(_: &Section, _: &Epoch) -> Result<Opened, OpenError> {
        Ok(Opened::default())
    }

    fn refused(names: &[&'static str]) -> String {
        let all: Vec<Driver> = names.iter().map(|name| Driver::new(name, none, Vec::new)).collect();
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

    #[test]
    fn a_system_call_that_is_a_pattern_is_refused() {
        const ANY: &[SystemCall] = &[SystemCall { name: "*", about: "whatever it likes" }];
        let driver = Driver::new("own", none, Vec::new).with_system_calls(ANY);
        let bad = check(&[driver]).unwrap_err().to_string();
        assert!(bad.contains("`*` of `own` is no name of a system call"), "{bad}");
    }

    #[test]
    fn system_calls_of_the_house_are_named_and_explained() {
        for driver in HOUSE_DRIVERS {
            for call in driver.system_calls {
                assert!(call.has_good_name() && !call.about.is_empty(), "{call:?}");
            }
        }
        let calls = |name| find(name).map(|driver| driver.system_calls.len());
        assert_eq!([calls("regmap"), calls("serial")], [Some(0), Some(0)]);
    }
}
