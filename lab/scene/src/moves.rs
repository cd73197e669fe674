//! What the check of the programmed moves said, for the closing table and the summary. Refuses to
//! call a queue good that was not looked at to its end.

use serde_json::{Value, json};
use taktil_machine::operator::status::REFUSAL_REASONS;
use taktil_signal::MoveCheck;

/// Deviations below these are rounding.
const ROUNDING_MM: f64 = 1e-4;
const ROUNDING_DEG: f64 = 1e-5;

/// The verdict as JSON; `names` are those of the joints.
pub fn json(check: &MoveCheck, names: &[String]) -> Value {
    let verdict = match check.verdict {
        2 => "passed",
        3 => "refused",
        _ => "looking",
    };
    let reason =
        usize::try_from(check.reason).ok().and_then(|n| REFUSAL_REASONS.get(n.checked_sub(1)?));
    json!({
        "verdict": verdict,
        "moves": check.moves,
        "reason": reason,
        "joint": (check.joint > 0).then_some(check.joint),
        "joint_name": usize::try_from(check.joint).ok().and_then(|n| names.get(n.checked_sub(1)?)),
        "t_s": check.t_s,
        "ratio": (check.ratio > 0.0).then_some(check.ratio),
        "duration_s": check.duration_s,
        "speed_share": check.speed_share,
        "torque_share": check.torque_share,
        "singular_distance": {
            "shoulder": check.singular[0],
            "elbow": check.singular[1],
            "wrist": check.singular[2],
        },
        "off_path_mm": check.off_path_m * 1e3,
        "off_path_deg": check.off_path_rad.to_degrees(),
    })
}

/// The row of the closing table: what, and a note.
pub fn words(moves: &Value) -> Option<(String, String)> {
    let number = |key: &str| moves[key].as_f64().unwrap_or(0.0);
    let count = &moves["moves"];
    match moves["verdict"].as_str()? {
        "passed" => {
            let mut note = format!(
                "at most {:.0} % of a joint's speed, {:.0} % of its torque",
                100.0 * number("speed_share"),
                100.0 * number("torque_share")
            );
            // What damped steps leave is no deviation.
            if number("off_path_mm") > ROUNDING_MM || number("off_path_deg") > ROUNDING_DEG {
                note += &format!(
                    "; past the wrist singularity {:.2} mm and {:.2} deg off its path",
                    number("off_path_mm"),
                    number("off_path_deg")
                );
            }
            Some((format!("{count} checked, {:.2} s", number("duration_s")), note))
        }
        "refused" => {
            let named = moves["joint_name"].as_str().map(|name| format!("{name} "));
            let joint = named.unwrap_or_default();
            let why = moves["reason"].as_str().unwrap_or("no reason given");
            let ratio = moves["ratio"].as_f64();
            let ratio = ratio.map_or_else(String::new, |ratio| format!(" by {ratio:.2}"));
            let at = number("t_s");
            let when = if at > 0.0 { format!(", {at:.2} s on") } else { String::new() };
            Some((format!("REFUSED from move {count}"), format!("{joint}{why}{ratio}{when}")))
        }
        _ => {
            Some((format!("{count} checked"), "the run ended while the rest was looked at".into()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Payload;

    fn of(check: &MoveCheck) -> Value {
        json(check, &["joint 1".into(), "joint 2 (`elbow`)".into()])
    }

    #[test]
    fn a_refusal_names_move_joint_reason_and_time() {
        let check =
            MoveCheck { verdict: 3, moves: 2, reason: 1, joint: 2, t_s: 2.93, ..MoveCheck::ZERO };
        let (what, note) = words(&of(&check)).unwrap();
        assert_eq!(what, "REFUSED from move 2");
        assert_eq!(note, "joint 2 (`elbow`) would leave its limits, 2.93 s on");
        let fast = MoveCheck { reason: 3, ratio: 1.5, ..check };
        assert!(words(&of(&fast)).unwrap().1.contains("too fast by 1.50"));
    }

    #[test]
    fn a_pass_states_its_cost_and_nothing_said_is_no_row() {
        let check = MoveCheck {
            verdict: 2,
            moves: 3,
            duration_s: 2.5,
            speed_share: 0.3,
            torque_share: 0.416,
            ..MoveCheck::ZERO
        };
        let (what, note) = words(&of(&check)).unwrap();
        assert_eq!(what, "3 checked, 2.50 s");
        assert_eq!(note, "at most 30 % of a joint's speed, 42 % of its torque");
        let off = MoveCheck { off_path_m: 0.001, off_path_rad: 0.01, ..check };
        assert!(words(&of(&off)).unwrap().1.contains("1.00 mm and 0.57 deg off"));
        assert_eq!(words(&Value::Null), None);
        let unknown = MoveCheck { verdict: 3, reason: 99, ..check };
        assert!(words(&of(&unknown)).unwrap().1.contains("no reason given"));
    }
}
