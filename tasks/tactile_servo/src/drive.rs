//! The law that was chosen, with its memory. Refuses to choose: that is the configuration's.

use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Invalid, StateHash};
use taktil_signal::{TactileImage, Wrench};

use crate::config::Config;
use crate::law::model::jacobian::Contact;
use crate::law::model::opposed::Opposed;
use crate::law::{Name, hybrid_force, model, projector_pid, task_frame, thesis};
use crate::perception::Touch;
use crate::perception::line::{Known, Line, line};

/// What an image showed, and where there is one what another fingertip's showed, with the finger's
/// pose.
pub(crate) type Seen<'a> = (&'a Touch, Option<&'a Line>, Option<(&'a Opposed, &'a Line, &'a Pose)>);

/// A law and what it remembers.
#[expect(clippy::large_enum_variant, reason = "one of it exists, and the lane path has no heap")]
#[derive(Clone, Debug)]
pub(crate) enum Drive {
    Thesis(thesis::Law),
    ProjectorPid(projector_pid::Memory),
    Model(Contact, model::Memory),
    /// What the wrist feels, and the memory of its PID.
    HybridForce(Touch, projector_pid::Memory),
    TaskFrame(task_frame::Law, task_frame::Memory),
}

impl Fold for Drive {
    fn fold(&self, hash: &mut StateHash) {
        match self {
            Drive::Thesis(_) => {}
            Drive::ProjectorPid(memory) => {
                hash.add(memory);
            }
            Drive::Model(_, memory) => {
                hash.add(memory);
            }
            Drive::HybridForce(felt, memory) => {
                hash.add(felt).add(memory);
            }
            Drive::TaskFrame(_, memory) => {
                hash.add(memory);
            }
        }
    }
}

impl Drive {
    /// The law that the configuration names; allocates.
    pub(crate) fn new(config: &Config) -> Result<Drive, Invalid> {
        Ok(match config.law {
            Name::Thesis => Drive::Thesis(thesis::Law::new(config)),
            Name::ProjectorPid => Drive::ProjectorPid(projector_pid::Memory::default()),
            Name::Model => Drive::Model(
                Contact::new(&config.model, config.m0_counts)?,
                model::Memory::new(&config.model),
            ),
            Name::HybridForce | Name::HybridForceTouch => {
                Drive::HybridForce(Touch::default(), projector_pid::Memory::default())
            }
            Name::TaskFrame => {
                let law = task_frame::Law::new(&config.task_frame);
                let law = law.map_err(|bad| bad.within("task_frame"))?;
                Drive::TaskFrame(law, task_frame::Memory::default())
            }
        })
    }

    /// Set points or speeds were edited.
    pub(crate) fn retune(&mut self, config: &Config) {
        match self {
            Drive::Thesis(law) => *law = thesis::Law::new(config),
            Drive::ProjectorPid(_) | Drive::HybridForce(..) | Drive::TaskFrame(..) => {}
            Drive::Model(contact, _) => contact.aim(config.m0_counts),
        }
    }

    /// Forgets, at the beginning of a stay.
    pub(crate) fn reset(&mut self, config: &Config) {
        match self {
            Drive::Thesis(_) => {}
            Drive::ProjectorPid(memory) => *memory = projector_pid::Memory::default(),
            Drive::Model(_, memory) => *memory = model::Memory::new(&config.model),
            Drive::HybridForce(felt, memory) => {
                (*felt, *memory) = (Touch::default(), projector_pid::Memory::default());
            }
            Drive::TaskFrame(_, memory) => *memory = task_frame::Memory::default(),
        }
    }

    /// Takes the wrist's newest wrench in; what a law that goes by it feels.
    pub(crate) fn wrench(
        &mut self,
        config: &Config,
        wrench: Option<&Wrench>,
        touch: &Touch,
    ) -> Option<Touch> {
        let Drive::HybridForce(felt, memory) = self else { return None };
        *felt = hybrid_force::felt(config, wrench, touch);
        if felt.trusted && !felt.contact {
            // The law is not asked while nothing is touched.
            *memory = projector_pid::Memory::default();
        }
        Some(*felt)
    }

    /// The line of an image, for the law that goes by it.
    pub(crate) fn line(
        &self,
        config: &Config,
        image: &TactileImage,
        touch: &Touch,
    ) -> Option<Line> {
        let Drive::Model(contact, _) = self else { return None };
        self.line_by(config, contact.whole(), image, touch)
    }

    /// The same of any fingertip's image whose sums are to be multiplied by `whole`.
    pub(crate) fn line_by(
        &self,
        config: &Config,
        whole: f64,
        image: &TactileImage,
        touch: &Touch,
    ) -> Option<Line> {
        let Drive::Model(contact, memory) = self else { return None };
        let known = Known {
            shape: contact.shape(),
            noise_counts: match f64::from(image.noise_counts) {
                measured if measured > 0.0 => measured,
                _ => config.model.noise_counts,
            },
            speed_cols_s: memory.line_cols_s(),
        };
        line(image, touch, &known).map(|line| line.scaled(whole))
    }

    /// How fast the finger gives way along the pin, for a law that does; others hold it.
    pub(crate) fn yields_per_s(&self, config: &Config) -> Option<f64> {
        matches!(self, Drive::Model(..)).then_some(config.model.yield_per_s)
    }

    /// Motion along the sensor's x, along its y and about its y (m, m, rad) where the law has its
    /// own say in it, with the tool where it is: what a task moves is the last answer, what it does
    /// not is taken back at `rate_per_s` within `span_s`.
    pub(crate) fn others(
        &mut self,
        tool: &Pose,
        (rate_per_s, span_s): (f64, f64),
    ) -> [Option<f64>; 3] {
        let Drive::TaskFrame(law, memory) = self else { return [None; 3] };
        let across = memory.across(tool).correction(rate_per_s, span_s).0;
        let [x, y, theta_y] = law.moves();
        let asked = memory.others.map(|part| 1e-3 * part);
        [(!x).then_some(across), y.then_some(asked[0]), theta_y.then_some(asked[1])]
    }

    /// The column by which the heading turns.
    pub(crate) fn column(&self, touch: &Touch) -> Option<f64> {
        match self {
            Drive::Model(_, memory) => memory.column(),
            Drive::HybridForce(felt, _) => felt.x_c,
            Drive::Thesis(_) | Drive::ProjectorPid(_) | Drive::TaskFrame(..) => touch.x_c,
        }
    }

    /// Takes an image in of this age; laws that answer images do so here.
    pub(crate) fn image(
        &mut self,
        config: &Config,
        (touch, line, other): Seen<'_>,
        times: (f64, f64),
        x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        match self {
            Drive::Thesis(law) => Some(law.displacement(touch, x_c_desired)),
            Drive::ProjectorPid(memory) => {
                let aim = (x_c_desired, config.image_period_ms * 1e-3);
                let (step, next) = projector_pid::displacement(config, memory, touch, aim);
                *memory = next;
                Some(step)
            }
            Drive::Model(contact, memory) => {
                let other = |_: &Line, jacobian: &_| {
                    let (opposed, line, tool) = other?;
                    Some(opposed.felt(config, line, jacobian, tool))
                };
                let seen = ((touch, line), other);
                *memory = model::observe_both(config, contact, memory, seen, times);
                None
            }
            Drive::TaskFrame(law, memory) => {
                let ([x, _, z, theta_x, _, theta_z], next) =
                    task_frame::displacement(config, law, memory, touch);
                *memory = next;
                Some([x, z, theta_x, theta_z])
            }
            Drive::HybridForce(..) => None,
        }
    }

    /// What is asked for in a job without an answer to an image, by a law that answers jobs.
    pub(crate) fn job(&mut self, config: &Config, x_c_desired: f64, dt_s: f64) -> Option<[f64; 4]> {
        match self {
            Drive::Thesis(_) | Drive::ProjectorPid(_) | Drive::TaskFrame(..) => None,
            Drive::Model(_, memory) => {
                Some(model::displacement_of_job(config, memory, x_c_desired, dt_s))
            }
            Drive::HybridForce(felt, memory) => {
                let aim = (x_c_desired, dt_s);
                let (step, next) = projector_pid::displacement(config, memory, felt, aim);
                *memory = next;
                Some(step)
            }
        }
    }

    /// This much of it was carried out.
    pub(crate) fn carried_out(&mut self, config: &Config, step: &[f64; 4], dt_s: f64) {
        if let Drive::Model(_, memory) = self {
            *memory = model::after_job(&config.model, memory, step, dt_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_contact_leaves_nothing_of_the_wrist_laws_integral() {
        let config = Config { law: Name::HybridForce, ..Config::default() };
        let wrench = |press_n: f64| Wrench {
            force_n: [0.0, 0.0, -press_n],
            baseline_ready: 1,
            ..taktil_rtcore::Payload::ZERO
        };
        let image = Touch::default();
        let mut law = Drive::new(&config).unwrap();
        let mut steps = Vec::new();
        for press_n in [14.6, 14.6, 0.0, 14.6] {
            let felt = law.wrench(&config, Some(&wrench(press_n)), &image).unwrap();
            // As the task does it: the law is asked while something is touched.
            steps.extend(felt.contact.then(|| law.job(&config, 8.5, 0.0025).unwrap()));
        }
        assert_ne!(steps[0], steps[1], "it has a memory");
        assert_eq!(steps[0], steps[2], "and starts anew");
    }
}
