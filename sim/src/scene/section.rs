//! The declaration of a section of a scene: its keys, their meaning and the range of every number
//! stand in one place, from which the parser, the check and the schema are made
//! ([`taktil_hal::explain`]). This module knows no particular section.

pub(crate) use taktil_hal::explain::inside;

use super::{Invalid, invalid};

/// A value that a key may hold.
pub trait Value {
    /// Refuses NaN, infinities and everything outside `range`, at `place`.
    ///
    /// # Errors
    /// [`Invalid`] with the place.
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid>;
}

/// The consistency of the keys of a section.
pub trait Consistency {
    /// Refuses keys that contradict each other; every number is in its range already.
    ///
    /// # Errors
    /// [`Invalid`] with its place inside the section at `place`.
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        let _ = place;
        Ok(())
    }
}

/// Refuses NaN, infinities and everything outside the range.
fn within(place: &str, value: f64, range: Option<(f64, f64)>) -> Result<(), Invalid> {
    // A number without a range of its own must be finite.
    let (low, high) = range.unwrap_or((f64::MIN, f64::MAX));
    if (low..=high).contains(&value) {
        return Ok(());
    }
    let plain = value == 0.0 || !value.is_finite() || (1e-6..1e9).contains(&value.abs());
    let shown = if plain { format!("{value}") } else { format!("{value:e}") };
    Err(invalid(place, format!("is {shown}"), &format!("give a number from {low} to {high}")))
}

impl Value for f64 {
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
        within(place, *self, range)
    }
}

impl Value for u32 {
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
        within(place, f64::from(*self), range)
    }
}

impl Value for bool {
    fn check(&self, _place: &str, _range: Option<(f64, f64)>) -> Result<(), Invalid> {
        Ok(())
    }
}

impl Value for String {
    fn check(&self, _place: &str, _range: Option<(f64, f64)>) -> Result<(), Invalid> {
        Ok(())
    }
}

impl<T: Value> Value for Option<T> {
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
        self.as_ref().map_or(Ok(()), |value| value.check(place, range))
    }
}

fn each<T: Value>(values: &[T], place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
    let one = |(i, value): (usize, &T)| value.check(&format!("{place}[{i}]"), range);
    values.iter().enumerate().try_for_each(one)
}

impl<T: Value> Value for Vec<T> {
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
        each(self, place, range)
    }
}

impl<T: Value, const N: usize> Value for [T; N] {
    fn check(&self, place: &str, range: Option<(f64, f64)>) -> Result<(), Invalid> {
        each(self, place, range)
    }
}

/// Declares a section: documented keys in the order in which they are checked, each with its type
/// and, for numbers, `[lowest, highest]`. The section implements [`Consistency`] for the conditions
/// between its keys.
macro_rules! section {
    (
        $(#[doc = $about:expr])*
        $(#[derive($($derive:ident),*)])?
        $(#[serde($($container:tt)*)])*
        pub struct $Name:ident { $(
            $(#[doc = $doc:expr])*
            $(#[serde($($field:tt)*)])*
            $key:ident : $ty:ty $([$low:expr, $high:expr])?,
        )* }
    ) => {
        taktil_hal::explained! {
            $(#[doc = $about])*
            $(#[derive($($derive),*)])?
            #[derive(Clone, Debug, PartialEq, serde::Deserialize)]
            #[serde(deny_unknown_fields)]
            $(#[serde($($container)*)])*
            pub struct $Name { $(
                $(#[doc = $doc])*
                $(#[serde($($field)*)])*
                pub $key: $ty $([$low, $high])?,
            )* }
        }

        impl $crate::scene::section::Value for $Name {
            fn check(
                &self,
                place: &str,
                _range: Option<(f64, f64)>,
            ) -> Result<(), $crate::scene::Invalid> {
                use $crate::scene::section::{Consistency, inside};
                $({
                    let range: Option<(f64, f64)> = None $(.or(Some(($low, $high))))?;
                    self.$key.check(&inside(place, stringify!($key)), range)?;
                })*
                self.check_consistency(place)
            }
        }
    };
}

/// Makes plain enumerations values of keys.
macro_rules! names {
    ($($Name:ty),*) => { $(
        impl $crate::scene::section::Value for $Name {
            fn check(
                &self,
                _place: &str,
                _range: Option<(f64, f64)>,
            ) -> Result<(), $crate::scene::Invalid> {
                Ok(())
            }
        }
    )* };
}

pub(crate) use {names, section};
