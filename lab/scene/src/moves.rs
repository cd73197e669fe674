//! The result of the check of the programmed moves, for the summary of a run. A queue that was not
//! checked to its end does not count as good.

use taktil_machine::operator::status::REFUSAL_REASONS;
use taktil_record::summary::{MoveSummary, MoveVerdict, SingularDistances};
use taktil_signal::MoveCheck;

use super::statistics::finite;

/// The verdict of the check; `names` are the names of the joints.
#[must_use]
pub fn move_summary(check: &MoveCheck, names: &[String]) -> MoveSummary {
    let verdict = match check.verdict {
        2 => MoveVerdict::Passed,
        3 => MoveVerdict::Refused,
        _ => MoveVerdict::Looking,
    };
    // Reasons and joints are numbered from 1; 0 stands for none.
    let index = |number: u32| usize::try_from(number).ok()?.checked_sub(1);
    let reason = index(check.reason).and_then(|n| REFUSAL_REASONS.get(n));
    let [shoulder, elbow, wrist] = check.singular.map(finite);
    MoveSummary {
        verdict,
        moves: check.moves,
        reason: reason.map(|&reason| reason.to_owned()),
        joint: (check.joint > 0).then_some(check.joint),
        joint_name: index(check.joint).and_then(|n| names.get(n)).cloned(),
        t_s: check.t_s,
        ratio: (check.ratio > 0.0).then_some(check.ratio).and_then(finite),
        duration_s: check.duration_s,
        speed_share: check.speed_share,
        torque_share: check.torque_share,
        singular_distance: SingularDistances { shoulder, elbow, wrist },
        path_error_mm: check.path_error_m * 1e3,
        path_error_deg: check.path_error_rad.to_degrees(),
    }
}
