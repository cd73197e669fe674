//! Explains the keys of a configuration. [`explained!`](crate::explained) stands around a structure
//! into which a text is read: the doc comments of its fields are then also what a schema, and with
//! it an editor, says of the keys. It is part of this crate because the simulator and the tasks
//! share no other crate below them except mathematics. Neither the format of a configuration nor
//! reading and checking it belong here.

use std::collections::BTreeMap;

/// One key of a configuration, for schemas and for people.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Dotted path from the section that was asked, `[]` for each element of a list, `*` for each
    /// name of a table whose names are free.
    pub path: String,
    /// What it means, with unit and default: the doc comment of the field, or of the structure
    /// where the field has none.
    pub about: String,
    /// The numbers that are accepted, ends included, where the declaration states them.
    pub range: Option<(f64, f64)>,
    /// What each of its words means, in the order of their declaration, where it is one of some
    /// words.
    pub words: &'static [&'static str],
}

/// A type that may stand under a key and says what it means.
pub trait Explain {
    /// What its words mean, in the order of their declaration.
    const WORDS: &'static [&'static str] = &[];

    /// Adds the key at `path`, which means `about`, and those inside it to the list.
    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        let words = Self::WORDS;
        keys.push(Key { path: path.to_owned(), about: about.trim().to_owned(), range, words });
    }

    /// All keys inside, in the order of the declarations.
    #[must_use]
    fn keys() -> Vec<Key> {
        let mut keys = Vec::new();
        Self::list("", "", None, &mut keys);
        keys
    }
}

/// A place inside a section; the outermost one has no name.
#[must_use]
pub fn inside(place: &str, key: &str) -> String {
    // A key that is a word of the language is written raw.
    let key = key.strip_prefix("r#").unwrap_or(key);
    if place.is_empty() { key.to_owned() } else { format!("{place}.{key}") }
}

macro_rules! leaves {
    ($($Type:ty),*) => { $(impl Explain for $Type {})* };
}

leaves!(bool, u8, u16, u32, u64, usize, i32, i64, f64, String, std::path::PathBuf);

impl<T: Explain> Explain for Option<T> {
    const WORDS: &'static [&'static str] = T::WORDS;

    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        T::list(path, about, range, keys);
    }
}

/// A list says once what it is; the range is that of its numbers.
fn list_all<T: Explain>(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
    String::list(path, about, None, keys);
    T::list(&format!("{path}[]"), "", range, keys);
}

impl<T: Explain> Explain for Vec<T> {
    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        list_all::<T>(path, about, range, keys);
    }
}

impl<T: Explain, const N: usize> Explain for [T; N] {
    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        list_all::<T>(path, about, range, keys);
    }
}

impl<T: Explain> Explain for BTreeMap<String, T> {
    fn list(path: &str, about: &str, range: Option<(f64, f64)>, keys: &mut Vec<Key>) {
        String::list(path, about, None, keys);
        T::list(&inside(path, "*"), "", range, keys);
    }
}

/// Declares a structure, or an enumeration of words, as it stands, and lets it [`Explain`] itself
/// by its doc comments. They come first; then `derive`, then `serde`, and before a variant
/// `default`. A field may be followed by `[lowest, highest]` for the numbers that are accepted;
/// whoever states a range here checks it as well.
///
/// ```
/// use taktil_hal::explain::Explain;
///
/// taktil_hal::explained! {
///     /// A lamp.
///     #[derive(Default)]
///     pub struct Lamp {
///         /// How bright it is (lm). Default 0.
///         pub flux_lm: f64 [0.0, 1e4],
///         /// What it shines at.
///         pub aims: Vec<Aim>,
///     }
/// }
/// taktil_hal::explained! {
///     /// What a lamp shines at.
///     #[derive(Default)]
///     pub enum Aim {
///         /// The wall.
///         #[default]
///         Wall,
///         /// The ceiling.
///         Ceiling,
///     }
/// }
///
/// let keys = Lamp::keys();
/// assert_eq!(keys[0].path, "flux_lm");
/// assert_eq!(keys[0].about, "How bright it is (lm). Default 0.");
/// assert_eq!(keys[2].path, "aims[]");
/// assert_eq!(keys[2].about, "What a lamp shines at.");
/// assert_eq!(keys[2].words, ["The wall.", "The ceiling."]);
/// ```
#[macro_export]
macro_rules! explained {
    (
        $(#[doc = $about:expr])*
        $(#[derive($($derive:tt)*)])*
        $(#[serde($($container:tt)*)])*
        $visible:vis struct $Name:ident { $(
            $(#[doc = $doc:expr])*
            $(#[serde($($field:tt)*)])*
            $shown:vis $key:ident : $ty:ty $([$low:expr, $high:expr])?,
        )* }
    ) => {
        $(#[doc = $about])*
        $(#[derive($($derive)*)])*
        $(#[serde($($container)*)])*
        $visible struct $Name { $(
            $(#[doc = $doc])*
            $(#[serde($($field)*)])*
            $shown $key: $ty,
        )* }

        impl $crate::explain::Explain for $Name {
            fn list(
                path: &str,
                about: &str,
                _range: Option<(f64, f64)>,
                keys: &mut Vec<$crate::explain::Key>,
            ) {
                if !path.is_empty() {
                    let own = concat!($($about, "\n",)*);
                    let about = if about.is_empty() { own } else { about };
                    <String as $crate::explain::Explain>::list(path, about, None, keys);
                }
                $({
                    let range: Option<(f64, f64)> = None $(.or(Some(($low, $high))))?;
                    let about = concat!($($doc, "\n",)*).trim();
                    let path = $crate::explain::inside(path, stringify!($key));
                    <$ty as $crate::explain::Explain>::list(&path, about, range, keys);
                })*
            }
        }
    };
    (
        $(#[doc = $about:expr])*
        $(#[derive($($derive:tt)*)])*
        $(#[serde($($container:tt)*)])*
        $visible:vis enum $Name:ident { $(
            $(#[doc = $doc:expr])*
            $(#[default $($default:tt)?])?
            $(#[serde($($variant:tt)*)])*
            $Word:ident,
        )* }
    ) => {
        $(#[doc = $about])*
        $(#[derive($($derive)*)])*
        $(#[serde($($container)*)])*
        $visible enum $Name { $(
            $(#[doc = $doc])*
            $(#[default $($default)?])?
            $(#[serde($($variant)*)])*
            $Word,
        )* }

        impl $crate::explain::Explain for $Name {
            const WORDS: &'static [&'static str] = &[$(concat!($($doc, "\n",)*).trim_ascii()),*];

            fn list(
                path: &str,
                about: &str,
                range: Option<(f64, f64)>,
                keys: &mut Vec<$crate::explain::Key>,
            ) {
                let own = concat!($($about, "\n",)*);
                let about = if about.is_empty() { own } else { about };
                let (path, about) = (path.to_owned(), about.trim().to_owned());
                keys.push($crate::explain::Key { path, about, range, words: Self::WORDS });
            }
        }
    };
}
