//! How accurately a contact is solved: one choice for plane and space.

/// Accuracy of a solution against the time that it takes.
///
/// An error is the largest difference of the stress at the base (of an image, where there are
/// tactels) from the exact one, divided by the largest such stress. [`Accuracy::Default`] means the
/// same everywhere: the error is below one part in a thousand, which no tactel resolves. What each
/// solver promises beyond that:
///
/// | variant   | anywhere | plane | sphere | pin or bar | without ends |
/// |-----------|---------:|------:|-------:|-----------:|-------------:|
/// | `Fast`    |     1e-2 |  5e-3 |   6e-4 |       1e-2 |         5e-6 |
/// | `Default` |     1e-3 |  1e-5 |   1e-4 |       1e-3 |         5e-6 |
/// | `Fine`    |     6e-4 |  1e-8 |   2e-7 |       6e-4 |         5e-6 |
///
/// Plane is [`Indenter`]; its tilted bars reach 1e-7 with `Fine`. The other columns are bodies in
/// space; a pin or bar reaches 1e-4 with `Fine` away from its ends. In the plane the same bounds
/// hold for the edges of the contact relative to its width and for the descent. Held by
/// `contact/tests/accuracy.rs`, `contact/tests/plane.rs` and the tests of `contact/tests/space`.
///
/// [`Indenter`]: crate::plane::Indenter
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Accuracy {
    /// For control periods: read from tables or solved with few points.
    Fast,
    /// Where nothing else is asked: below one part in a thousand.
    #[default]
    Default,
    /// As exact as the method gets, for references.
    Fine,
}
