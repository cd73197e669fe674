//! Follows touch: features of every new tactile image, and in TACTILE-SERVO the law that the
//! configuration names on them, integrated into desired joints. Refuses to start from joints that
//! are not calibrated, to move on an image that is not new or cannot be believed, and to act near a
//! singularity.
//!
//! ```text
//! image -> features -> displacement dX of the sensor -> dtheta = J_tool^-1 dX -> desired joints
//!          ([`perception`])  ([`law`])                  ([`follow`], at the desired joints)
//! ```
//! Images come at 200 Hz, jobs at 400 Hz. A law that answers images gives one step for each, spread
//! evenly over the jobs until the next one, so that the position servo sees a steady set point; the
//! law `model` answers every job. Without contact no law drives: [`phase`] seeks, holds or draws
//! back, and says so. The two motions that touch cannot see are held by the encoders, or give way
//! ([`unfelt`]).

pub mod config;
mod drive;
pub mod follow;
pub mod heading;
pub mod law;
pub mod perception;
pub mod phase;
mod second;
pub mod unfelt;

pub use config::Config;

use config::M0_MAX;
use drive::{Drive, Seen};
use follow::{Follower, joint_step, within_lead};
use heading::Heading;
use law::model::opposed::Opposed;
use law::tool_motion;
use perception::line::Line;
use perception::{Touch, touch};
use phase::Phase;
use second::Second;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Nanos, Output, Param, Payload, Ports, StateHash, Task,
};
use taktil_signal::{
    Contact, ControlState, Desired, Features, Goal, JointState, State, TactileImage, Wrench,
    defined,
};
use unfelt::Drift;

/// Whether the law has the arm.
#[expect(clippy::large_enum_variant, reason = "one of it exists, and the lane path has no heap")]
#[derive(Clone, Copy, Debug)]
enum Stay {
    /// Another state has it.
    Away,
    /// The law drives, from joints with this datum.
    Driving { follower: Follower, datum: u32, drift: Drift },
    /// The stay in the state could not begin, or the zero of the joints moved.
    Refused,
}

/// The task.
pub struct TactileServo {
    control: Input<ControlState>,
    desired: Input<Desired>,
    joints: Input<JointState>,
    image: Input<TactileImage>,
    /// Of a law that goes by the wrist.
    wrench: Option<Input<Wrench>>,
    /// Where there is one, and the law goes by it.
    second: Option<Second>,
    goal: Output<Goal>,
    features: Output<Features>,
    contact: Output<Contact>,
    arm: Puma260,
    config: Config,
    law: Drive,
    heading: Heading,
    stay: Stay,
    /// When the present stay in TACTILE-SERVO began.
    entered_ns: i64,
    /// What the newest image of this stay said, or the wrist with a law that goes by it.
    seen: Touch,
    /// What the newest image said.
    touched: Touch,
    phase: Phase,
    knobs: Knobs,
    /// Load above which something is wrong (counts), and for how long it was (s).
    overload_counts: f64,
    overloaded_s: f64,
}

/// A load above the limit is borne for this time (s): eight images.
const OVERLOAD_S: f64 = 0.04;

/// What may be edited while the servo runs.
#[derive(Clone, Copy, Debug)]
struct Knobs {
    m0: Param,
    roll: Param,
    press: Param,
}

impl Knobs {
    fn new(config: &Config, ports: &mut Ports) -> Knobs {
        // Below these the load would never count as contact, or never roll.
        let least = config.contact_counts.max(config.roll_from_counts);
        let m0 = config.m0_counts;
        Knobs {
            m0: ports.parameter("m0_counts", m0, least..=(4.0 * m0).min(M0_MAX)),
            roll: ports.tunable("roll_mm_s", config.roll_mm_s),
            press: ports.tunable("press_mm_s", config.press_mm_s),
        }
    }

    /// Puts edited values into the configuration; true when there were any.
    fn take(&self, io: &Io<'_>, config: &mut Config) -> bool {
        let now = io.parameters(&[self.m0, self.roll, self.press]);
        let before = [config.m0_counts, config.roll_mm_s, config.press_mm_s];
        [config.m0_counts, config.roll_mm_s, config.press_mm_s] = now;
        now != before
    }
}

impl TactileServo {
    /// Declares `control`, `desired`, `joints`, `image`, `goal`, `features` and `contact`, `wrench`
    /// with a law that feels the wrist, and the parameters `m0_counts`, `roll_mm_s` and
    /// `press_mm_s`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(config: Config, ports: &mut Ports) -> Result<TactileServo, Invalid> {
        config.check()?;
        let knobs = Knobs::new(&config, ports);
        Ok(TactileServo {
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            image: ports.input("image"),
            wrench: config.law.feels_the_wrist().then(|| ports.input("wrench")),
            second: Second::new(&config, ports)?,
            goal: ports.output("goal"),
            features: ports.output("features"),
            contact: ports.output("contact"),
            arm: Puma260::reference(),
            overload_counts: config.overload_share * config.load_counts(),
            law: Drive::new(&config)?,
            heading: Heading::new(&config),
            config,
            stay: Stay::Away,
            entered_ns: 0,
            seen: Touch::default(),
            touched: Touch::default(),
            phase: Phase::default(),
            overloaded_s: 0.0,
            knobs,
        })
    }

    fn settle(
        &mut self,
        control: Option<ControlState>,
        desired: Option<Desired>,
        joints: Option<&JointState>,
    ) -> Result<(), FaultCode> {
        let Some(control) = control.filter(|c| c.state == State::TactileServo as u32) else {
            self.stay = Stay::Away;
            return Ok(());
        };
        let stays = !matches!(self.stay, Stay::Away) && control.entered_ns == self.entered_ns;
        if stays {
            let moved = matches!(self.stay, Stay::Driving { datum, .. }
                if joints.is_none_or(|joints| joints.datum != datum));
            if moved {
                self.stay = Stay::Refused;
                return Err(FaultCode::MoveRefused);
            }
            return Ok(());
        }
        self.entered_ns = control.entered_ns;
        self.heading = Heading::new(&self.config);
        self.law.reset(&self.config);
        if let Some(second) = &mut self.second {
            second.reset();
        }
        self.seen = Touch::default();
        self.phase = Phase::default();
        let start = desired.filter(|desired| desired.valid == 1);
        match (start, joints.filter(|joints| joints.calibrated == 1)) {
            (Some(start), Some(joints)) => {
                let follower = Follower::new(&Joints::from(start.q_rad));
                self.stay =
                    Stay::Driving { follower, datum: joints.datum, drift: Drift::default() };
                Ok(())
            }
            _ => {
                self.stay = Stay::Refused;
                Err(FaultCode::MoveRefused)
            }
        }
    }

    /// Takes one new image in and adds the step of a law that answers images.
    fn image(
        &mut self,
        seen: Seen<'_>,
        joints: &JointState,
        (age_s, dt_s): (f64, f64),
    ) -> Result<(), FaultCode> {
        let touch = seen.0;
        if !matches!(self.stay, Stay::Driving { .. }) {
            return Ok(());
        }
        if self.wrench.is_none() {
            self.seen = *touch;
            self.heading.update(self.law.column(touch));
        }
        let times = (age_s, dt_s);
        let step = self.law.image(&self.config, seen, times, self.heading.x_c());
        let Some(step) = step.filter(|_| touch.contact) else { return Ok(()) };
        let jobs = self.jobs_per_image(dt_s);
        let image_s = self.config.image_period_ms * 1e-3;
        self.drive(&step, joints, (jobs, image_s)).map(|_| ())
    }

    /// What the second fingertip saw with the finger's image; says what both feel.
    fn other(
        &mut self,
        image: &TactileImage,
        line: Option<&Line>,
        tool: &Pose,
        io: &mut Io<'_>,
    ) -> Option<(Opposed, Line)> {
        let second = self.second.as_mut()?;
        let (opposed, other) = second.line(&self.config, image.acquired_ns)?;
        second.report(image.acquired_ns, (line?, &other), tool, io);
        Some((opposed, other))
    }

    /// Says what happened to contact, and adds the step of one job: that of a law that answers
    /// jobs, or the way towards contact while there is none.
    fn job(
        &mut self,
        joints: &JointState,
        cycle: &Cycle,
        io: &mut Io<'_>,
    ) -> Result<(), FaultCode> {
        if !matches!(self.stay, Stay::Driving { .. }) {
            return Ok(());
        }
        let dt_s = cycle.dt.as_secs_f64();
        if let Some(event) = self.phase.advance(&self.config, &self.seen, dt_s) {
            io.write(&self.contact, Contact { at_ns: cycle.release.0, ..event });
        }
        if !self.phase.touches() {
            let blind = !self.seen.trusted;
            let z_mm = if blind { 0.0 } else { self.phase.speed_mm_s(&self.config) * dt_s };
            self.law.carried_out(&self.config, &[0.0, z_mm, 0.0, 0.0], dt_s);
            if z_mm == 0.0 {
                return Ok(());
            }
            let share = self.drive(&[0.0, z_mm, 0.0, 0.0], joints, (1, dt_s));
            self.phase.went(z_mm * share.unwrap_or(0.0));
            return share.map(|_| ());
        }
        let Some(step) = self.law.job(&self.config, self.heading.x_c(), dt_s) else {
            return Ok(());
        };
        let share = self.drive(&step, joints, (1, dt_s));
        let done = step.map(|part| part * share.unwrap_or(0.0));
        self.law.carried_out(&self.config, &done, dt_s);
        share.map(|_| ())
    }

    /// Whether the load was far above its set point for too long while the law drove.
    fn overload(&mut self, dt_s: f64) -> Result<(), FaultCode> {
        let driving = matches!(self.stay, Stay::Driving { .. });
        let limit =
            self.overload_counts.max(self.config.overload_share * self.config.load_counts());
        let above = driving && self.touched.trusted && self.touched.m0 > limit;
        self.overloaded_s = if above { self.overloaded_s + dt_s } else { 0.0 };
        if self.overloaded_s > OVERLOAD_S { Err(FaultCode::Overload) } else { Ok(()) }
    }

    /// Adds a displacement of the sensor, to be carried out within `jobs` jobs that last `span_s`;
    /// returns how much of it was let through.
    fn drive(
        &mut self,
        step: &[f64; 4],
        joints: &JointState,
        (jobs, span_s): (u32, f64),
    ) -> Result<f64, FaultCode> {
        let Stay::Driving { follower, drift, .. } = &mut self.stay else { return Ok(0.0) };
        let target = *follower.target();
        let measured = Joints::from(joints.q_rad);
        let tool = self.arm.tool_pose(&measured);
        drift.watch(&tool);
        let mut motion = tool_motion(step);
        (motion[1], motion[4]) = drift.correction(self.config.hold_unfelt_per_s, span_s);
        if let Some(rate_per_s) = self.law.yields_per_s(&self.config) {
            let wanted = self.arm.tool_pose(&target);
            motion[1] = unfelt::way_given(&wanted, &tool, rate_per_s, span_s);
        }
        let held = (self.config.hold_unfelt_per_s, span_s);
        for (i, part) in [0, 1, 4].into_iter().zip(self.law.others(&tool, held)) {
            motion[i] = part.unwrap_or(motion[i]);
        }
        let whole = joint_step(&self.arm, &target, &motion, self.config.singular_distance_min)?;
        let part = within_lead(&target, &measured, &whole, self.config.max_lead_deg.to_radians());
        follower.add(&part, jobs);
        let size = whole.norm_squared();
        Ok(if size > 0.0 { part.dot(&whole) / size } else { 1.0 })
    }

    fn report(&self, image: &TactileImage, touch: &Touch, line: Option<&Line>) -> Features {
        let touch = &line.map_or(*touch, |line| line.touch(touch));
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        let centroid = touch.x_c.is_some() && touch.y_c.is_some();
        Features {
            acquired_ns: image.acquired_ns,
            m0: touch.m0,
            m_x: touch.m_x,
            x_c: touch.x_c.filter(|_| centroid).unwrap_or(0.0),
            y_c: touch.y_c.filter(|_| centroid).unwrap_or(0.0),
            theta_z_rad: touch.theta_z_rad.unwrap_or(0.0),
            x_c_desired: self.heading.x_c(),
            defined: bit(touch.contact, defined::CONTACT)
                | bit(centroid, defined::CENTROID)
                | bit(touch.theta_z_rad.is_some(), defined::THETA_Z),
            sequence: image.sequence,
            reversals: self.heading.reversals(),
            active: u32::from(matches!(self.stay, Stay::Driving { .. })),
        }
    }

    fn next_goal(&mut self, dt_s: f64) -> Goal {
        match &mut self.stay {
            Stay::Away => Goal::ZERO,
            Stay::Refused => Goal { done: 1, ..Goal::ZERO },
            Stay::Driving { follower, .. } => {
                let (q, step) = follower.advance();
                let qd = if dt_s > 0.0 { step / dt_s } else { Joints::zeros() };
                Goal { q_rad: q.into(), qd_rad_s: qd.into(), valid: 1, done: 0 }
            }
        }
    }

    /// Jobs until the next image, at least 1.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped first")]
    fn jobs_per_image(&self, dt_s: f64) -> u32 {
        let jobs = self.config.image_period_ms * 1e-3 / dt_s;
        if jobs.is_finite() { jobs.round().clamp(1.0, 1e4) as u32 } else { 1 }
    }
}

impl Task for TactileServo {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.knobs.take(io, &mut self.config) {
            self.law.retune(&self.config);
        }
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let image = io.read(&self.image).fresh();
        let dt_s = cycle.dt.as_secs_f64();
        let mut outcome = self.settle(control, desired, joints.as_ref());
        if let Some(second) = &mut self.second {
            second.take(&self.config, &self.law, io);
        }
        if let Some(image) = image {
            let config = &self.config;
            let tactels = usize::from(image.rows) * usize::from(image.cols);
            let noise = image.noise_counts;
            let above = config.contact_above(noise, tactels, self.touched.contact);
            let touch = touch(&image, config.threshold(noise), above);
            let line = self.law.line(config, &image, &touch);
            self.touched = touch;
            if let Some(joints) = &joints {
                let age_s = (cycle.release - Nanos(image.acquired_ns)).as_secs_f64();
                let tool = self.arm.tool_pose(&Joints::from(joints.q_rad));
                let other = self.other(&image, line.as_ref(), &tool, io);
                let other = other.as_ref().map(|(opposed, line)| (opposed, line, &tool));
                let seen = (&touch, line.as_ref(), other);
                outcome = outcome.and(self.image(seen, joints, (age_s.clamp(0.0, 1.0), dt_s)));
            }
            io.write(&self.features, self.report(&image, &touch, line.as_ref()));
        }
        if let Some(input) = &self.wrench {
            let wrench = io.read(input).usable();
            if let Some(felt) = self.law.wrench(&self.config, wrench.as_ref(), &self.touched) {
                self.seen = felt;
                self.heading.update(self.law.column(&felt));
            }
        }
        if let Some(joints) = &joints {
            outcome = outcome.and(self.job(joints, cycle, io));
        }
        outcome = outcome.and(self.overload(dt_s));
        let goal = self.next_goal(dt_s);
        io.write(&self.goal, goal);
        outcome
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.heading).add(&self.entered_ns).add(&self.phase).add(&self.law);
        hash.add(&self.overloaded_s).add(&self.seen).add(&self.touched);
        if let Some(second) = &self.second {
            hash.add(second);
        }
        match &self.stay {
            Stay::Away => hash.word(0),
            Stay::Refused => hash.word(1),
            Stay::Driving { follower, datum, drift } => {
                hash.word(2).add(follower).add(datum).add(drift)
            }
        };
    }

    fn stop(&mut self) {
        self.stay = Stay::Away;
    }
}
