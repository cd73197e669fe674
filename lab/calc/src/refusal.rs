//! Converts errors of the contact's solvers to failures of a request, with the request's own field
//! names.

use taktil_contact::Invalid;
use taktil_contact::plane::Refusal;

use super::field::Failure;

/// Error code of a contact that consists of more than one interval.
pub(super) const SPLIT_CONTACT_CODE: &str = "separated";

/// The failure of a value that a solver rejects, under the name of the request's field.
pub(super) fn failure(invalid: &Invalid) -> Failure {
    let field = match invalid.place.as_str() {
        "thickness_mm" => "t_mm",
        "poisson" => "nu",
        "width_mm" => "shape.flat.width_mm",
        "height_mm" => "shape.flat.height_mm",
        "radius_mm" => "shape.cylinder.radius_mm",
        "coulomb" => "friction.coulomb",
        "edges_mm" => "shape",
        other => other,
    };
    Failure::range(field, format!("`{field}`: {}; {}", invalid.what, invalid.remedy))
}

/// The failure of a load or a move that a solver rejects.
pub(super) fn refusal_failure(refusal: Refusal) -> Failure {
    let code = match refusal {
        Refusal::Toppling => "topples",
        Refusal::Sliding => "slides",
        Refusal::Tension | Refusal::NotFinite => "out_of_range",
        Refusal::TooWide | Refusal::OutsideTable | Refusal::OnLastNode => "unreachable",
        Refusal::SplitContact => SPLIT_CONTACT_CODE,
        Refusal::NotConverged | Refusal::EdgeSeparation => "not_converged",
    };
    Failure::new(code, Some("load"), refusal.to_string())
}
