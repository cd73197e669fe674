//! The ranges of outputs that somebody declared: the joints of a goal against the limits of the
//! arm, torques against what its drives give, flags and the numbers of enumerations against those
//! that there are. Payloads of a program's own declare none; their ports do, by `output_within`.

use taktil_machine::robot::AnyRobot;
use taktil_rtcore::Mode;
use taktil_rtcore::harness::OutputPort;
use taktil_signal::{JogFrame, MoveKind, State, Verb};

use crate::number::{Number, Place, places};
use crate::scenario::speed_max_rad_s;

/// How far beyond a limit rounding may lead, relative to the limit.
const RELATIVE_ROUNDING: f64 = 1e-9;

/// The range of one element of an output.
#[derive(Clone, Debug)]
struct Limit {
    field: &'static str,
    place: Place,
    element: usize,
    low: f64,
    high: f64,
    /// The flag without which the element means nothing.
    only_if: Option<Place>,
}

/// The ranges of all outputs of a task.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ranges {
    outputs: Vec<(&'static str, Vec<Limit>)>,
}

/// A range for each element of a field of this name.
type FieldRange = (&'static str, Vec<(f64, f64)>);

/// The ranges that are declared for a payload of `signal` by its name without the number of joints.
fn field_ranges(type_name: &str, robot: &AnyRobot) -> Vec<FieldRange> {
    let flag = |name| (name, vec![(0.0, 1.0)]);
    let code = |name, last: u32| (name, vec![(0.0, f64::from(last))]);
    let speeds = speed_max_rad_s(robot).iter().map(|speed| (-speed, *speed)).collect();
    let torques = robot.torque_max_nm().iter().map(|torque| (-torque, *torque)).collect();
    let joints = |limits| vec![("q_rad", robot.limits_rad()), ("qd_rad_s", limits), flag("valid")];
    let last_state = State::ALL.len() as u32 - 1;
    match type_name.trim_end_matches(|c: char| c.is_ascii_digit()) {
        "Goal" => [joints(speeds), vec![flag("done")]].concat(),
        "Desired" => [joints(speeds), vec![code("source", last_state)]].concat(),
        "Torque" => vec![("tau_nm", torques)],
        "Request" => vec![code("verb", Verb::ALL.len() as u32 - 1)],
        "JogCommand" => {
            vec![("axes", vec![(-1.0, 1.0); 6]), code("frame", JogFrame::ALL.len() as u32 - 1)]
        }
        "OperatorMove" => vec![
            code("kind", MoveKind::ALL.len() as u32 - 1),
            flag("straight"),
            flag("now"),
            ("t_s", vec![(0.0, f64::MAX)]),
        ],
        "ModeStatus" => vec![code("mode", Mode::ALL.len() as u32 - 1), code("action", 3)],
        "ControlState" => {
            vec![code("state", last_state), code("mode", Mode::ALL.len() as u32 - 1)]
        }
        _ => Vec::new(),
    }
}

impl Ranges {
    /// The ranges of these outputs on a machine with this arm.
    pub(crate) fn new(outputs: &[OutputPort], robot: &AnyRobot) -> Ranges {
        let limits = |output: &OutputPort| {
            let places = places(&output.fields);
            let named = || output.fields.iter().zip(&places);
            let valid = named().find(|(field, _)| field.name == "valid").map(|(_, place)| *place);
            let ranges = field_ranges(&output.type_name, robot);
            let mut limits = Vec::new();
            for (field, place) in named() {
                let range = ranges.iter().find(|(name, _)| *name == field.name);
                let Some((_, range)) = range.filter(|(_, range)| range.len() == place.count) else {
                    continue;
                };
                limits.extend(range.iter().enumerate().map(|(element, (low, high))| Limit {
                    field: field.name,
                    place: *place,
                    element,
                    low: *low,
                    high: *high,
                    only_if: valid.filter(|_| place.is_real()),
                }));
            }
            (output.name, limits)
        };
        Ranges { outputs: outputs.iter().map(limits).collect() }
    }

    /// Number of elements whose range is known.
    pub(crate) fn count(&self) -> usize {
        self.outputs.iter().map(|(_, limits)| limits.len()).sum()
    }

    /// The first element of a written value that is out of its range, as text.
    pub(crate) fn violation(&self, output: usize, body: &[u8]) -> Option<String> {
        let (name, limits) = self.outputs.get(output)?;
        limits.iter().find_map(|limit| {
            let applies = limit.only_if.is_none_or(|flag| flag.get(body, 0) == Number::Whole(1));
            let value = match limit.place.get(body, limit.element) {
                Number::Real(real) => real,
                Number::Whole(whole) => whole as f64,
            };
            let slack = |end: f64| end.abs() * RELATIVE_ROUNDING;
            let (low, high) = (limit.low - slack(limit.low), limit.high + slack(limit.high));
            if !applies || (low..=high).contains(&value) {
                return None;
            }
            let Limit { field, element, low, high, place, .. } = limit;
            let index = if place.count > 1 { format!("[{element}]") } else { String::new() };
            Some(format!("{name}.{field}{index} is {value:?}, beyond {low:.4} to {high:.4}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use taktil_rtcore::Payload;
    use taktil_signal::Goal;

    use super::*;

    #[test]
    fn a_goal_beyond_a_joint_is_named_and_one_that_is_not_valid_is_not() {
        let robot = AnyRobot::puma260();
        let output = OutputPort {
            name: "goal",
            type_name: "Goal".into(),
            fields: <Goal>::FIELDS.into(),
            size: <Goal>::SIZE,
        };
        let ranges = Ranges::new(&[output], &robot);
        assert_eq!(ranges.count(), 14);
        let check = |goal: Goal| {
            let mut body = vec![0; <Goal>::SIZE];
            goal.encode(&mut body);
            ranges.violation(0, &body)
        };
        let mut goal = Goal { valid: 1, ..Goal::ZERO };
        assert_eq!(check(goal), None);
        goal.q_rad[5] = robot.limits_rad()[5].1;
        assert_eq!(check(goal), None, "the limit itself");
        goal.q_rad[5] += 1e-6;
        assert!(check(goal).unwrap().starts_with("goal.q_rad[5] is 4.66"), "{:?}", check(goal));
        assert_eq!(check(Goal { valid: 0, ..goal }), None);
        assert!(check(Goal { done: 2, ..Goal::ZERO }).unwrap().contains("goal.done is 2"));
    }
}
