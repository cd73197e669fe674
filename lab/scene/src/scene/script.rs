//! `[[operator]]`: the requests of the operator of a scene, the keys that are held and the moves
//! that are typed, one after the other. Unknown verbs and frames, deflections outside their range
//! and moves that no arm could make are errors.

use serde::Deserialize;
use taktil_machine::operator::command::{CommandContext, OperatorCommand, parse};
use taktil_rtcore::{Invalid, Nanos};
use taktil_signal::{JogFrame, OperatorMove, Verb};

use super::DURATION_MAX_S;

/// Largest number of half cycles of one step.
const HALF_CYCLES_MAX: u32 = 64;
/// Longest time for which keys are held, s.
const HOLD_TIME_MAX_S: f64 = 3600.0;

taktil_rtcore::explained! {
    /// One entry of the list: `verb`, `jog` with `for_s`, or `command`.
    #[derive(Clone, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub(super) struct StepFile {
        /// What is asked for: `enable`, `calibrate`, `idle`, `manual_uncalibrated`, `manual_joint`,
        /// `manual_cartesian`, `trajectory`, `trajectory_user`, `tactile_servo`, `stop` or `reset`.
        verb: Option<String>,
        /// How far the six axes are pushed, -1 to 1.
        jog: Option<[f64; 6]>,
        /// What the axes of a jog are: `joints` (default), the first six; `base` or `tool`, three
        /// translations along the axes of that frame and three turns about them; `outer`, the last
        /// six joints.
        frame: Option<String>,
        /// How long the keys of a jog are held, s, at most 3600; a jog needs it.
        for_s: Option<f64>,
        /// The keys of a jog are pushed to and fro so many times instead, 1 to 64: the first time
        /// for `for_s`, then less and less far, and end where they began. Default: pushed once, one
        /// way.
        half_cycles: Option<u32>,
        /// What is typed in TRAJECTORY/USER: a move, `pause`, `resume`, `clear`, or `wait`.
        command: Option<String>,
        /// The step is not done before this instant, s. Default 0.
        #[serde(default)]
        at_s: f64,
    }
}

/// One line of the operator's script.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The action.
    pub act: OperatorAction,
    /// The action begins no earlier than this instant.
    pub at: Nanos,
}

/// An action of the operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OperatorAction {
    /// Makes a request.
    Ask(Verb),
    /// Holds keys, as soon as and as long as the machine is in a MANUAL state.
    Hold {
        /// Deflection of the axes, -1 to 1.
        axes: [f64; 6],
        /// The frame of the axes.
        frame: JogFrame,
        /// Duration of the deflection.
        span: Nanos,
    },
    /// Types a move, as soon as the machine is in TRAJECTORY/USER.
    Type(OperatorMove),
    /// Waits until every typed move is done.
    Rest,
}

/// Checks the list and returns the script.
pub(super) fn script(steps: &[StepFile], context: &CommandContext) -> Result<Vec<Step>, Invalid> {
    let mut script = Vec::new();
    for (index, file) in steps.iter().enumerate() {
        let within = |bad: Invalid| bad.within(&format!("operator[{index}]"));
        let step = file.check(context).map_err(within)?;
        match file.half_cycles {
            Some(count) => script.extend(decaying_cycles(&step, count).map_err(within)?),
            None => script.push(step),
        }
    }
    Ok(script)
}

impl StepFile {
    fn check(&self, context: &CommandContext) -> Result<Step, Invalid> {
        let at = instant(self.at_s, "at_s", 0.0, DURATION_MAX_S)?;
        let keys = self.frame.is_some() || self.for_s.is_some();
        let act = match (&self.verb, &self.jog, &self.command) {
            (Some(verb), None, None) => {
                if keys {
                    let what = "`frame` and `for_s` belong to a jog";
                    return Err(Invalid::new("verb", what, "leave them out"));
                }
                OperatorAction::Ask(verb_named(verb)?)
            }
            (None, Some(axes), None) => self.hold(axes)?,
            (None, None, Some(_)) if keys => {
                let what = "`frame` and `for_s` belong to a jog";
                return Err(Invalid::new("command", what, "leave them out"));
            }
            (None, None, Some(words)) => parse_typed(words, context)?,
            _ => {
                let what = "a step is a verb, a jog or a command";
                return Err(Invalid::new(
                    "",
                    what,
                    "give exactly one of `verb`, `jog` and `command`",
                ));
            }
        };
        Ok(Step { act, at })
    }

    fn hold(&self, axes: &[f64; 6]) -> Result<OperatorAction, Invalid> {
        if let Some(axis) = axes.iter().position(|axis| !(-1.0..=1.0).contains(axis)) {
            let what = format!("is {}", axes[axis]);
            return Err(Invalid::new(format!("jog[{axis}]"), what, "give -1 to 1"));
        }
        let name = self.frame.as_deref().unwrap_or("joints");
        let frame = JogFrame::ALL.into_iter().find(|frame| frame.name() == name);
        let frame = frame.ok_or_else(|| {
            let what = format!("there is no frame `{name}`");
            Invalid::new("frame", what, "frames are: joints, base, tool, outer")
        })?;
        let for_s = self.for_s.ok_or_else(|| {
            Invalid::new("for_s", "a jog without a time", "say how many seconds the keys are held")
        })?;
        let span = instant(for_s, "for_s", 1e-3, HOLD_TIME_MAX_S)?;
        Ok(OperatorAction::Hold { axes: *axes, frame, span })
    }
}

/// The steps of a jog that goes to and fro `half_cycles` times with decreasing amplitude. The
/// deflection that joint friction holds decreases with it, as remanence does in a decaying field.
fn decaying_cycles(step: &Step, half_cycles: u32) -> Result<Vec<Step>, Invalid> {
    let OperatorAction::Hold { axes, frame, span } = step.act else {
        let what = "only keys swing";
        return Err(Invalid::new("half_cycles", what, "give it with a `jog`"));
    };
    if !(1..=HALF_CYCLES_MAX).contains(&half_cycles) {
        let what = format!("is {half_cycles}");
        return Err(Invalid::new("half_cycles", what, format!("give 1 to {HALF_CYCLES_MAX}")));
    }
    let (count, whole) = (i64::from(half_cycles), span.0);
    // The position after each half swing, on alternating sides.
    let place = |ways: i64| whole * (count - ways + 1) / count;
    let way = |ways: i64| {
        let from = if ways == 1 { 0 } else { place(ways - 1) };
        let to = if ways > count { 0 } else { place(ways) };
        let axes = if ways % 2 == 1 { axes } else { axes.map(|axis| -axis) };
        Step { act: OperatorAction::Hold { axes, frame, span: Nanos(from + to) }, ..*step }
    };
    Ok((1..=count + 1).map(way).collect())
}

/// Parses the words of `say`: a move, or a wait for all moves.
fn parse_typed(words: &str, context: &CommandContext) -> Result<OperatorAction, Invalid> {
    let order = parse(words, context).map_err(|bad| {
        let what =
            if bad.place.is_empty() { bad.what } else { format!("{}: {}", bad.place, bad.what) };
        Invalid::new("command", what, bad.remedy)
    })?;
    match order {
        Some(OperatorCommand::Move(typed)) => Ok(OperatorAction::Type(typed)),
        Some(OperatorCommand::Wait) => Ok(OperatorAction::Rest),
        _ => {
            let what = format!("`{words}` is nothing to type");
            Err(Invalid::new("command", what, "say a move, pause, resume, clear or wait"))
        }
    }
}

fn verb_named(name: &str) -> Result<Verb, Invalid> {
    Verb::from_name(name).filter(|verb| *verb != Verb::None).ok_or_else(|| {
        let verbs: Vec<&str> = Verb::ALL[1..].iter().map(|verb| verb.name()).collect();
        let remedy = format!("verbs are: {}", verbs.join(", "));
        Invalid::new("verb", format!("there is no verb `{name}`"), remedy)
    })
}

fn instant(seconds: f64, place: &str, least: f64, most: f64) -> Result<Nanos, Invalid> {
    if !(least..=most).contains(&seconds) {
        let what = format!("{seconds} s does not fit a run");
        return Err(Invalid::new(place, what, format!("give {least} to {most} seconds")));
    }
    #[expect(clippy::cast_possible_truncation, reason = "at most a day of nanoseconds")]
    let nanos = Nanos((seconds * 1e9).round() as i64);
    Ok(nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Step, Invalid> {
        let step: StepFile = toml::from_str(text).unwrap();
        script(&[step], &CommandContext::default()).map(|list| list[0])
    }

    #[test]
    fn verbs_and_keys_are_read() {
        let ask = read("verb = \"enable\"\nat_s = 1.5").unwrap();
        assert_eq!(
            ask,
            Step { act: OperatorAction::Ask(Verb::Enable), at: Nanos::from_millis(1500) }
        );
        let hold = read("jog = [0, 0, -1, 0, 0, 0.5]\nframe = \"tool\"\nfor_s = 2").unwrap();
        let axes = [0.0, 0.0, -1.0, 0.0, 0.0, 0.5];
        let span = Nanos::from_secs(2);
        assert_eq!(hold.act, OperatorAction::Hold { axes, frame: JogFrame::Tool, span });
        let typed = read("command = \"move by 0 0 5 straight\"").unwrap().act;
        assert!(
            matches!(typed, OperatorAction::Type(word) if word.values[2] == 0.005),
            "{typed:?}"
        );
        assert_eq!(read("command = \"wait\"").unwrap().act, OperatorAction::Rest);
    }

    #[test]
    fn keys_that_swing_come_to_rest_where_they_began() {
        let keys = "jog = [0, 0, 0.5, 0, 0, 0]\nfor_s = 0.3\nat_s = 2";
        let steps: Vec<StepFile> =
            vec![toml::from_str(&format!("{keys}\nhalf_cycles = 3")).unwrap()];
        let steps = script(&steps, &CommandContext::default()).unwrap();
        let ways: Vec<(f64, i64)> = steps
            .iter()
            .map(|step| {
                let OperatorAction::Hold { axes, span, .. } = step.act else { panic!("{step:?}") };
                assert_eq!(step.at, Nanos::from_secs(2));
                (axes[2], span.0 / 1_000_000)
            })
            .collect();
        assert_eq!(ways, [(0.5, 300), (-0.5, 500), (0.5, 300), (-0.5, 100)]);
        for (text, place) in [
            (format!("{keys}\nhalf_cycles = 0"), "operator[0].half_cycles"),
            (format!("{keys}\nhalf_cycles = 65"), "operator[0].half_cycles"),
            ("verb = \"stop\"\nhalf_cycles = 2".to_owned(), "operator[0].half_cycles"),
        ] {
            assert_eq!(read(&text).unwrap_err().place, place, "{text}");
        }
    }

    #[test]
    fn impossible_steps_are_rejected_with_their_place() {
        let keys = "jog = [0, 0, 1, 0, 0, 0]";
        for (text, place) in [
            ("at_s = 1.0".to_owned(), "operator[0]"),
            (format!("verb = \"stop\"\n{keys}"), "operator[0]"),
            ("verb = \"fly\"".to_owned(), "operator[0].verb"),
            ("verb = \"none\"".to_owned(), "operator[0].verb"),
            ("verb = \"stop\"\nfor_s = 1".to_owned(), "operator[0].verb"),
            ("verb = \"stop\"\nat_s = -1".to_owned(), "operator[0].at_s"),
            ("verb = \"stop\"\nat_s = nan".to_owned(), "operator[0].at_s"),
            ("command = \"move\"".to_owned(), "operator[0].command"),
            ("command = \"enable\"".to_owned(), "operator[0].command"),
            ("command = \"\"".to_owned(), "operator[0].command"),
            ("command = \"wait\"\nfor_s = 1".to_owned(), "operator[0].command"),
            ("command = \"wait\"\nverb = \"stop\"".to_owned(), "operator[0]"),
            (keys.to_owned(), "operator[0].for_s"),
            (format!("{keys}\nfor_s = 0"), "operator[0].for_s"),
            (format!("{keys}\nfor_s = inf"), "operator[0].for_s"),
            (format!("{keys}\nfor_s = 1\nframe = \"world\""), "operator[0].frame"),
            ("jog = [0, 0, 2, 0, 0, 0]\nfor_s = 1".to_owned(), "operator[0].jog[2]"),
            ("jog = [nan, 0, 0, 0, 0, 0]\nfor_s = 1".to_owned(), "operator[0].jog[0]"),
        ] {
            assert_eq!(read(&text).unwrap_err().place, place, "{text}");
        }
    }
}
