//! The encoding of typed moves for a port: from a checked step to numbers and back. Numbers that
//! are no move decode to nothing.

use taktil_mechanics::Pose;
use taktil_mechanics::spatial::JointVector;
use taktil_signal::{MoveKind, OperatorMove};

use crate::config::{Goal, Step};

/// Encodes a checked step as a message without a sequence number. With `now` it replaces the moves
/// typed before.
#[must_use]
pub fn encode<const N: usize>(step: &Step<N>, now: bool) -> OperatorMove {
    let mut values = [0.0; 12];
    let kind = match &step.goal {
        Goal::Joints(q) => {
            values[..N].copy_from_slice(q.as_slice());
            MoveKind::Joints
        }
        Goal::Tool(pose) => {
            values[..9].copy_from_slice(&pose.rotation_rows());
            values[9..].copy_from_slice(&pose.translation.to_array());
            MoveKind::Tool
        }
        Goal::By(shift) => {
            values[..3].copy_from_slice(shift);
            MoveKind::By
        }
    };
    OperatorMove {
        values,
        t_s: step.t_s.unwrap_or(0.0),
        kind: kind as u32,
        straight: u32::from(step.straight),
        now: u32::from(now),
        sequence: 0,
    }
}

/// A message that is not a move.
#[must_use]
pub fn command(kind: MoveKind) -> OperatorMove {
    OperatorMove { kind: kind as u32, ..OperatorMove::default() }
}

/// True when the message is a move.
#[must_use]
pub fn is_move(word: &OperatorMove) -> bool {
    decode::<6>(word).is_some()
}

/// Decodes a message into a step; `None` when it is not a move. Whether the arm can make the move
/// is checked elsewhere.
#[must_use]
pub fn decode<const N: usize>(word: &OperatorMove) -> Option<Step<N>> {
    let v = &word.values;
    let goal = match MoveKind::from_code(word.kind)? {
        MoveKind::Joints => Goal::Joints(JointVector::from_fn(|i, _| v[i])),
        MoveKind::Tool => {
            let rows = [v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]];
            Goal::Tool(Pose::from_rows(&rows, &[v[9], v[10], v[11]]))
        }
        MoveKind::By => Goal::By([v[0], v[1], v[2]]),
        MoveKind::None | MoveKind::Pause | MoveKind::Resume | MoveKind::Clear => return None,
    };
    let t_s = (word.t_s != 0.0).then_some(word.t_s);
    Some(Step { goal, straight: word.straight == 1, t_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;
    use taktil_mechanics::spatial::rotation_y;

    #[test]
    fn a_step_comes_back_as_it_was() {
        let pose =
            Pose::from_rows(&[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], &[0.3, 0.1, 0.2]);
        let turned = Pose::new(rotation_y(0.2) * pose.rotation, pose.translation);
        let goals = [
            Goal::Joints(Joints::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
            Goal::Tool(turned),
            Goal::By([0.1, -0.2, 0.3]),
        ];
        for goal in goals {
            for (straight, t_s) in [(false, None), (true, Some(1.5))] {
                let step = Step { goal, straight, t_s };
                let word = encode(&step, true);
                assert_eq!((decode(&word), word.now), (Some(step), 1));
                assert!(is_move(&word));
            }
        }
        for kind in [MoveKind::None, MoveKind::Pause, MoveKind::Resume, MoveKind::Clear] {
            assert_eq!(decode::<6>(&command(kind)), None);
        }
        assert_eq!(decode::<6>(&OperatorMove { kind: 99, ..OperatorMove::default() }), None);
    }
}
