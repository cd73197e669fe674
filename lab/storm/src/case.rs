//! One case of a storm: which scene, for how long, with which faults. A seed draws all of it, so
//! that a seed is a run.

use std::path::PathBuf;

use anyhow::Context;
use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan, SplitMix};
use taktil_lab_scene::scene::Scene;
use taktil_machine::source::Source;
use taktil_machine_fault::kinds_of_half;

/// The scenes of a storm, with their weights: those that pay for nothing more often.
const STORM_SCENES: [(&str, &str, usize); 3] = [
    ("free.toml", include_str!("../../../sim/scenes/storm/free.toml"), 4),
    ("limits.toml", include_str!("../../../sim/scenes/storm/limits.toml"), 2),
    ("touch.toml", include_str!("../../../sim/scenes/storm/touch.toml"), 4),
];
/// The machine of these scenes.
const MACHINE_TEXT: &str = include_str!("../../../sim/scenes/machine/puma260.toml");

/// Time without faults after the last one in a recoverable case: a stop of at most a second, the
/// operator's two acts, and the two seconds within which the arm has to be ready and follow.
pub const CALM_TIME: Nanos = Nanos::from_millis(4_500);
/// Shortest and longest time in which faults may begin.
const STORM_TIME_S: (f64, f64) = (2.0, 9.0);
/// Earliest begin of a fault: drawn from zero on, because power comes on then.
const FAULTS_MAX: usize = 6;
/// Motors of the arm of these scenes.
const MOTOR_COUNT: usize = 6;

/// What a storm may contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Campaign {
    /// Faults that end, after which the machine has to come back.
    Recoverable,
    /// Whatever there is; the machine has to be safe.
    Anything,
}

impl Campaign {
    /// The word of the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Campaign::Recoverable => "recoverable",
            Campaign::Anything => "anything",
        }
    }
}

/// One run of a storm.
#[derive(Clone, Debug)]
pub struct Case {
    /// The seed of scene, operator and chance.
    pub seed: u64,
    /// The campaign that it belongs to.
    pub campaign: Campaign,
    /// The scene.
    pub scene: Scene,
    /// Its faults.
    pub plan: FaultPlan,
    /// From then on the operator only brings the machine back, in a recoverable case.
    pub calm_from: Nanos,
    /// When it ends.
    pub until: Nanos,
}

/// A scene of the storm, from the texts in this program.
fn built_in_scene(index: usize) -> anyhow::Result<Scene> {
    let (name, text, _) = STORM_SCENES[index];
    let source = |path: PathBuf, text: &str| Source { path, text: text.to_owned() };
    let scene = source(PathBuf::from("sim/scenes/storm").join(name), text);
    let machine = source(PathBuf::from("sim/scenes/machine/puma260.toml"), MACHINE_TEXT);
    let none = |file: &str| Err(format!("there is no file `{file}` in this program"));
    let scene = Scene::of(scene, Some(machine), &none);
    Ok(seen_by_operator(scene.with_context(|| format!("the scene {name}"))?))
}

/// The scene with an operator who sees where the arm stands.
fn seen_by_operator(mut scene: Scene) -> Scene {
    scene.machine.wiring.insert("operator.truth".to_owned(), "world.truth".to_owned());
    scene
}

/// The scenes from which cases are drawn: read once.
#[derive(Clone, Debug)]
pub struct Scenes {
    all: Vec<(Scene, usize)>,
}

impl Scenes {
    /// Those in this program.
    ///
    /// # Errors
    /// A scene that cannot be used.
    pub fn built_in() -> anyhow::Result<Scenes> {
        let scene = |index: usize| Ok((built_in_scene(index)?, STORM_SCENES[index].2));
        let all: anyhow::Result<Vec<_>> = (0..STORM_SCENES.len()).map(scene).collect();
        Ok(Scenes { all: all? })
    }

    /// One scene only.
    #[must_use]
    pub fn only(scene: Scene) -> Scenes {
        Scenes { all: vec![(seen_by_operator(scene), 1)] }
    }

    fn draw(&self, random: &mut SplitMix) -> &Scene {
        let sum: usize = self.all.iter().map(|(_, weight)| weight).sum();
        let mut left = random.below(sum);
        let drawn = self.all.iter().find(|(_, weight)| {
            let here = left < *weight;
            left = left.saturating_sub(*weight);
            here
        });
        drawn.map_or(&self.all[0].0, |(scene, _)| scene)
    }
}

impl Case {
    /// The case of a seed. With a `plan` the faults are these instead of drawn ones; with a
    /// `length` faults may begin until then.
    #[must_use]
    pub fn draw(
        scenes: &Scenes,
        seed: u64,
        campaign: Campaign,
        plan: Option<&FaultPlan>,
        length: Option<Nanos>,
    ) -> Case {
        let mut random = SplitMix::new(seed ^ 0x5354_4f52_4d00_0000);
        let scene = scenes.draw(&mut random).clone();
        let (shortest, longest) = STORM_TIME_S;
        let drawn = Nanos((1e9 * (shortest + (longest - shortest) * random.unit())) as i64);
        let storm = length.unwrap_or(drawn);
        let drawn = draw_plan(&mut random, &scene, campaign, storm);
        // The instants of a case do not depend on which of its faults are left out.
        let given = plan.map_or(&[] as &[Fault], |plan| plan.faults());
        let ends = drawn.faults().iter().chain(given).map(fault_end);
        let last = ends.filter(|end| *end < Nanos::MAX).max().unwrap_or(Nanos::ZERO);
        let calm_from = last.max(storm) + Nanos::from_millis(100);
        let plan = plan.cloned().unwrap_or(drawn);
        Case { seed, campaign, scene, plan, calm_from, until: calm_from + CALM_TIME }
    }

    /// The same case with other faults and the same instants.
    #[must_use]
    pub fn with_plan(&self, plan: FaultPlan) -> Case {
        Case { plan, ..self.clone() }
    }

    /// Whether the scene has something to touch.
    #[must_use]
    pub fn has_touch(&self) -> bool {
        self.scene.world.pin.present
    }
}

/// When a fault has ended; that of the clock lasts as long as its value.
#[must_use]
pub fn fault_end(fault: &Fault) -> Nanos {
    match fault.kind {
        FaultKind::ClockGap => fault.at + Nanos((fault.value * 1e9) as i64),
        FaultKind::Restart => fault.at,
        _ => fault.end(),
    }
}

/// What faults may befall, with its kinds and the number of its channels.
fn targets(scene: &Scene) -> Vec<(&'static str, &'static [FaultKind], usize)> {
    let mut all: Vec<(&'static str, &'static [FaultKind], usize)> = vec![
        ("encoders", kinds_of_half("encoders"), MOTOR_COUNT),
        ("analog_out", kinds_of_half("analog_out"), MOTOR_COUNT),
        ("digital_in", kinds_of_half("digital_in"), 3),
        ("digital_out", kinds_of_half("digital_out"), 3),
        ("tactile", kinds_of_half("tactile"), 256),
        ("operator", &OPERATOR_KINDS, 0),
        ("lane.servo", &taktil_rtcore::injection::LANE_KINDS, 0),
        ("clock", &[FaultKind::ClockGap], 0),
        ("task.joint_servo", &taktil_rtcore::injection::TASK_KINDS, 0),
        ("task.setpoint", &taktil_rtcore::injection::TASK_KINDS, 0),
        ("task.sense", &taktil_rtcore::injection::TASK_KINDS, 0),
        ("task.trajectory", &taktil_rtcore::injection::TASK_KINDS, 0),
        ("task.supervisor", &taktil_rtcore::injection::TASK_KINDS, 0),
        ("task.actuate", &taktil_rtcore::injection::TASK_KINDS, 0),
    ];
    let lanes = &scene.machine.lane;
    if lanes.contains_key("touch") {
        all.push(("lane.touch", &taktil_rtcore::injection::LANE_KINDS, 0));
        all.push(("task.tactile_scan", &taktil_rtcore::injection::TASK_KINDS, 0));
    }
    let stands = |name: &str| lanes.values().any(|lane| lane.tasks.iter().any(|t| t == name));
    all.retain(|(name, ..)| name.strip_prefix("task.").is_none_or(stands));
    all.retain(|(name, ..)| name.strip_prefix("lane.").is_none_or(|lane| lanes.contains_key(lane)));
    all
}

/// The kinds that can befall the operator.
pub const OPERATOR_KINDS: [FaultKind; 3] =
    [FaultKind::Flood, FaultKind::Silence, FaultKind::Unplugged];

/// Whether the machine may have to be started anew after this fault, or somebody has to look at the
/// arm, so that it is none of a recoverable case.
#[must_use]
pub fn is_irrecoverable(target: &str, kind: FaultKind) -> bool {
    match kind {
        FaultKind::Panic => true,
        // The zero of the joints is wrong afterwards, and nothing says so without index pulses.
        FaultKind::LostCounts => true,
        FaultKind::Inversion => target == "encoders" || target == "analog_out",
        _ => false,
    }
}

fn draw_plan(random: &mut SplitMix, scene: &Scene, campaign: Campaign, storm: Nanos) -> FaultPlan {
    let mut menu: Vec<(&str, FaultKind, usize)> = Vec::new();
    for (target, kinds, channels) in targets(scene) {
        menu.extend(kinds.iter().map(|kind| (target, *kind, channels)));
    }
    if campaign == Campaign::Recoverable {
        menu.retain(|(target, kind, _)| !is_irrecoverable(target, *kind));
    }
    // A swarm: each run has only a part of the kinds, so that rare ones meet each other.
    let share = 0.1 + 0.5 * random.unit();
    menu.retain(|_| random.unit() < share);
    if menu.is_empty() {
        return FaultPlan::default();
    }
    let count = random.below(FAULTS_MAX + 1);
    let faults = (0..count).map(|_| {
        let (target, kind, channels) = menu[random.below(menu.len())];
        let channel = (channels > 0 && random.below(4) > 0)
            .then(|| u16::try_from(1 + random.below(channels)).unwrap_or(1));
        let at = Nanos((random.unit() * storm.0 as f64) as i64);
        let duration = draw_duration(random, kind, campaign);
        Fault {
            kind,
            target: target.to_owned(),
            channel,
            at,
            duration,
            value: kind.draw_value(random),
        }
    });
    FaultPlan::new(faults.collect())
}

/// Short faults are more frequent; in a recoverable case each ends.
fn draw_duration(random: &mut SplitMix, kind: FaultKind, campaign: Campaign) -> Nanos {
    if campaign == Campaign::Anything && random.below(4) == 0 {
        return Nanos::MAX;
    }
    let longest = if kind == FaultKind::Panic { 0.01 } else { 2.0 };
    let part = random.unit() * random.unit() * random.unit();
    Nanos((1e9 * (0.0025 + longest * part)) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_draws_one_case_that_a_machine_can_have() {
        let scenes = Scenes::built_in().unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        for seed in 0..200 {
            for campaign in [Campaign::Recoverable, Campaign::Anything] {
                let case = Case::draw(&scenes, seed, campaign, None, None);
                let again = Case::draw(&scenes, seed, campaign, None, None);
                assert_eq!((&case.plan, case.until), (&again.plan, again.until));
                for fault in case.plan.faults() {
                    kinds.insert(fault.kind);
                    let text = fault.to_string();
                    assert!(text.parse::<Fault>().is_ok(), "{text}");
                    if campaign == Campaign::Recoverable {
                        assert!(fault_end(fault) < case.calm_from, "{text}");
                        assert!(!is_irrecoverable(&fault.target, fault.kind), "{text}");
                    }
                }
            }
        }
        assert!(kinds.len() > 20, "{kinds:?}");
    }
}
