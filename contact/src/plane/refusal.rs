//! The reasons why a plane contact has no solution. They are plain values without text, because the
//! solver runs inside control periods. The functions that return them state when.

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// A load or move that is not finite, or beyond 1e30.
    NotFinite,
    /// P below 0, or Q without P under friction or a moment.
    Tension,
    /// The moment tips the bar over: |Q| h >= P W/2.
    Toppling,
    /// Coulomb's law cannot hold the tangential load: |Q| >= mu P.
    Sliding,
    /// The contact would be wider than 0.98 of a cylinder's diameter or than the solver's points
    /// can resolve.
    TooWide,
    /// The search for an edge, or for the places that stick and slip, did not converge; the last
    /// state stays. Under friction far above 1 there need not be any solution.
    NotConverged,
    /// A bar that stands nearly on its corner, which its table leaves out.
    OutsideTable,
    /// A bar that stands beyond the middle of the last cell, or of the last node of a mesh, under
    /// it, which alone would have to carry it.
    OnLastNode,
    /// Friction without a limit, and no state that obeys it: a place that sticks would be in
    /// tension, and apart it would overlap.
    EdgeSeparation,
    /// A tangential traction of several times the pressure pulls the layer off the bar inside the
    /// contact, which then is not one interval.
    SplitContact,
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a load or move is beyond 1e30, or no number: give a smaller one",
            Self::Tension => "P is below 0, or Q acts without P: press the indenter on",
            Self::Toppling => {
                "the bar topples: |Q| times its height reaches P times half its width; lower either"
            }
            Self::Sliding => "the indenter slides: |Q| reaches mu P; take less Q, or more friction",
            Self::TooWide => "the contact grows too wide: press less or take a smaller indenter",
            Self::NotConverged => {
                "no contact that obeys every rule was found: take a smaller step or load, or less \
                 friction"
            }
            Self::OutsideTable => "the bar stands nearly on its corner: take the solver",
            Self::OnLastNode => {
                "the bar does not topple, but stands beyond its last cell or node: take more of \
                 them, less Q, or a lower bar"
            }
            Self::EdgeSeparation => {
                "what never slips is torn off at an edge: give a coefficient of friction"
            }
            Self::SplitContact => {
                "so much friction parts the contact in two: take cells, or a smaller Q"
            }
        })
    }
}

impl std::error::Error for Refusal {}
