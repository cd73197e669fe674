//! The result of the check of the programmed moves, as text for the closing table.

use taktil_record::summary::{MoveSummary, MoveVerdict};

/// Largest distance from the path that is rounding (mm).
const ROUNDING_MM: f64 = 1e-4;
/// Largest angle to the path that is rounding (deg).
const ROUNDING_DEG: f64 = 1e-5;

/// The result and a note to it, for a row of the closing table.
pub(super) fn verdict_and_note(check: &MoveSummary) -> (String, String) {
    let count = check.moves;
    match check.verdict {
        MoveVerdict::Passed => {
            let mut note = format!(
                "at most {:.0} % of a joint's speed, {:.0} % of its torque",
                100.0 * check.speed_share,
                100.0 * check.torque_share
            );
            // Rounding in the damped steps past a singularity is not a deviation.
            if check.path_error_mm > ROUNDING_MM || check.path_error_deg > ROUNDING_DEG {
                note += &format!(
                    "; past the wrist singularity {:.2} mm and {:.2} deg off its path",
                    check.path_error_mm, check.path_error_deg
                );
            }
            (format!("{count} checked, {:.2} s", check.duration_s), note)
        }
        MoveVerdict::Refused => {
            let joint = check.joint_name.as_ref().map_or(String::new(), |name| format!("{name} "));
            let reason = check.reason.as_deref().unwrap_or("no reason given");
            let ratio = check.ratio.map_or_else(String::new, |ratio| format!(" by {ratio:.2}"));
            let t_s = check.t_s;
            let when = if t_s > 0.0 { format!(", {t_s:.2} s on") } else { String::new() };
            (format!("REFUSED from move {count}"), format!("{joint}{reason}{ratio}{when}"))
        }
        MoveVerdict::Looking => {
            (format!("{count} checked"), "the run ended while the rest was looked at".into())
        }
    }
}

#[cfg(test)]
mod tests {
    use taktil_lab_scene::moves::move_summary;
    use taktil_rtcore::Payload;
    use taktil_signal::MoveCheck;

    use super::*;

    fn row(check: &MoveCheck) -> (String, String) {
        verdict_and_note(&move_summary(check, &["joint 1".into(), "joint 2 (`elbow`)".into()]))
    }

    #[test]
    fn a_refusal_names_move_joint_reason_and_time() {
        let check =
            MoveCheck { verdict: 3, moves: 2, reason: 1, joint: 2, t_s: 2.93, ..MoveCheck::ZERO };
        let (what, note) = row(&check);
        assert_eq!(what, "REFUSED from move 2");
        assert_eq!(note, "joint 2 (`elbow`) would leave its limits, 2.93 s on");
        let fast = MoveCheck { reason: 3, ratio: 1.5, ..check };
        assert!(row(&fast).1.contains("too fast by 1.50"));
        let unknown = MoveCheck { verdict: 3, reason: 99, ..check };
        assert!(row(&unknown).1.contains("no reason given"));
    }

    #[test]
    fn a_pass_states_how_much_of_the_joints_it_uses() {
        let check = MoveCheck {
            verdict: 2,
            moves: 3,
            duration_s: 2.5,
            speed_share: 0.3,
            torque_share: 0.416,
            ..MoveCheck::ZERO
        };
        let (what, note) = row(&check);
        assert_eq!(what, "3 checked, 2.50 s");
        assert_eq!(note, "at most 30 % of a joint's speed, 42 % of its torque");
        let off = MoveCheck { path_error_m: 0.001, path_error_rad: 0.01, ..check };
        assert!(row(&off).1.contains("1.00 mm and 0.57 deg off"));
    }
}
