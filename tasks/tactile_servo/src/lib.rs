//! The task that moves the arm by touch. It extracts features from every new tactile image, and in
//! the state TACTILE-SERVO the law that the configuration names turns them into a displacement of
//! the sensor, which is integrated into desired joints. The task does not start from joints that
//! are not calibrated, does not move on an image that is old or not trusted, and holds near a
//! singularity.
//!
//! - In: `control`, `desired` (delayed), `joints`, `image`; `wrench` with a law that goes by the
//!   wrist; `opposed` with a second fingertip.
//! - Out: `goal`, `features`, `contact`; `fingertip_pair` with a second fingertip; `slip` where it
//!   is observed; `phase` with a task in phases.
//! - Rate: every job of the servo lane, 400 Hz; images arrive at 200 Hz.
//! - Source: P. Sikka, *The Role of Tactile Sensing in Robot Manipulation*, University of Alberta,
//!   1994, chapters 5 and 6; each law names its own.
//!
//! ```text
//! image -> features -> displacement dX of the sensor -> dtheta = J_tool^-1 dX -> desired joints
//!          ([`perception`])  ([`law`])            ([`joint_integrator`], at the desired joints)
//! ```
//! The arm is any that has an [`Arm`]; its tool frame is the sensor's. What an arm of more than six
//! joints has left goes towards the joints at which the law took over.
//!
//! A law that answers images gives one step for each image, which is spread evenly over the jobs
//! until the next one, so that the position servo sees a steady set point; the law `model` answers
//! every job. Without contact no law drives: [`contact_phase`] seeks, holds or retracts, and
//! reports it; a task in phases ([`law::phases`]) says itself what is done. The two motions that
//! touch cannot see are held by the encoders, or yield ([`encoder_hold`]).

mod activation;
pub mod config;
pub mod contact_phase;
pub mod encoder_hold;
pub mod heading;
pub mod joint_integrator;
pub mod law;
mod parameters;
pub mod perception;
mod phase_control;
mod second_fingertip;
mod slip_observer;

pub use config::Config;

use activation::Activation;
use config::opposed::OpposedFingertip;
use contact_phase::ContactPhase;
use encoder_hold::{Drift, UnfeltMotion, compliant_step_m};
use heading::Heading;
use joint_integrator::{JointIntegrator, joint_step, lead_limited_step, posture_wish};
use law::active::ActiveLaw;
use law::phases::PhasesLaw;
use law::{Fingertip, Observation, OpposedObservation, tool_motion};
use parameters::Parameters;
use perception::line::Line;
use perception::{TouchFeatures, touch_features};
use phase_control::PhasePorts;
use second_fingertip::SecondFingertip;
use slip_observer::SlipObserver;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::{
    Contact, ControlState, Desired, Features, Goal, JointState, Slip, State, TactileImage,
    WRENCH_SATURATED, Wrench, defined,
};

/// The task.
pub struct TactileServo<const N: usize = 6, A: Arm<N> = Puma260> {
    control: Input<ControlState>,
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    image: Input<TactileImage>,
    /// Present with a law that goes by the wrist.
    wrench: Option<Input<Wrench>>,
    /// Present when the configuration has a second fingertip.
    second_fingertip: Option<SecondFingertip>,
    goal: Output<Goal<N>>,
    features: Output<Features>,
    contact: Output<Contact>,
    /// Present where slip is observed, with its port.
    slip: Option<(SlipObserver, Output<Slip>)>,
    /// Present with a task in phases.
    phases: Option<PhasePorts>,
    arm: A,
    config: Config,
    law: ActiveLaw,
    heading: Heading,
    activation: Activation<N>,
    /// When the machine last entered TACTILE-SERVO.
    entered_ns: i64,
    /// Features by which the law acts: those of the newest image since the law took over, or those
    /// of the wrench with a law that goes by the wrist.
    control_features: TouchFeatures,
    /// Features of the newest image.
    image_features: TouchFeatures,
    phase: ContactPhase,
    parameters: Parameters,
    /// Load above which the arm is overloaded (counts), and how long it has been above (s).
    overload_counts: f64,
    overloaded_s: f64,
}

/// A load above the limit raises the fault after this time (s), that of eight images at 200 Hz, and
/// after so many images where they come more slowly.
const OVERLOAD_S: f64 = 0.04;
const OVERLOAD_IMAGES: f64 = 4.0;

impl<const N: usize, A: Arm<N>> TactileServo<N, A> {
    /// Declares `control`, `desired`, `joints`, `image`, `goal`, `features` and `contact`, `wrench`
    /// with a law that uses the wrist, `slip` and `phase` where they are configured, and the
    /// parameters `m0_counts`, `roll_mm_s` and `press_mm_s`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(
        config: Config,
        robot: &Robot<N, A>,
        ports: &mut Ports,
    ) -> Result<TactileServo<N, A>, Invalid> {
        config.check()?;
        let parameters = Parameters::new(&config, ports);
        Ok(TactileServo {
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            image: ports.array_input("image"),
            wrench: config.uses_wrench().then(|| ports.input("wrench")),
            second_fingertip: SecondFingertip::new(&config, ports)?,
            goal: ports.output("goal"),
            features: ports.output("features"),
            contact: ports.output("contact"),
            slip: config.slip.map(|slip| (SlipObserver::new(&slip, &config), ports.output("slip"))),
            phases: PhasePorts::new(&config, ports),
            arm: robot.arm,
            overload_counts: config.overload_ratio * config.load_counts(),
            law: ActiveLaw::new(&config)?,
            heading: Heading::new(&config),
            config,
            activation: Activation::Inactive,
            entered_ns: 0,
            control_features: TouchFeatures::default(),
            image_features: TouchFeatures::default(),
            phase: ContactPhase::default(),
            overloaded_s: 0.0,
            parameters,
        })
    }

    fn update_activation(
        &mut self,
        control: Option<ControlState>,
        desired: Option<Desired<N>>,
        joints: Option<&JointState<N>>,
    ) -> Result<(), FaultCode> {
        let Some(control) = control.filter(|c| c.state == State::TactileServo as u32) else {
            self.activation = Activation::Inactive;
            return Ok(());
        };
        let stays = !matches!(self.activation, Activation::Inactive)
            && control.entered_ns == self.entered_ns;
        if stays {
            let moved = matches!(self.activation, Activation::Active { datum, .. }
                if joints.is_none_or(|joints| joints.datum != datum));
            if moved {
                self.activation = Activation::Refused;
                return Err(FaultCode::MoveRefused);
            }
            return Ok(());
        }
        self.entered_ns = control.entered_ns;
        self.heading = Heading::new(&self.config);
        self.law.reset(&self.config);
        if let Some(second) = &mut self.second_fingertip {
            second.reset();
        }
        self.control_features = TouchFeatures::default();
        self.phase = ContactPhase::default();
        let start = desired.filter(|desired| desired.valid == 1);
        match (start, joints.filter(|joints| joints.calibrated == 1)) {
            (Some(start), Some(joints)) => {
                let integrator = JointIntegrator::new(&JointVector::from(start.q_rad));
                self.activation =
                    Activation::Active { integrator, datum: joints.datum, drift: Drift::default() };
                Ok(())
            }
            _ => {
                self.activation = Activation::Refused;
                Err(FaultCode::MoveRefused)
            }
        }
    }

    /// Extracts the features of a new image, reports them, and lets the law answer where the joints
    /// are known; `outcome` is that of the job so far.
    fn take_image(
        &mut self,
        image: &TactileImage,
        joints: Option<&JointState<N>>,
        cycle: &Cycle,
        mut outcome: Result<(), FaultCode>,
        io: &mut Io<'_>,
    ) -> Result<(), FaultCode> {
        let config = &self.config;
        let tactels = usize::from(image.rows) * usize::from(image.cols);
        let noise = image.noise_counts;
        let above = config.contact_limit_counts(noise, tactels, self.image_features.contact);
        let touch = touch_features(image, &config.array, config.threshold(noise), above);
        let line = self.law.line(config, image, &touch, Fingertip::Carried);
        self.image_features = touch;
        if let Some((observer, port)) = &mut self.slip {
            let slip = observer.observe(image, &touch, config.threshold(noise));
            io.write(port, slip);
            if let Some(phases) = &mut self.phases {
                phases.take_slip(&slip);
            }
        }
        self.advance_phases_with_image(cycle, io);
        if let Some(joints) = joints {
            let age_s = (cycle.release - Nanos(image.acquired_ns)).as_secs_f64();
            let tool = self.arm.tool_pose(&JointVector::from(joints.q_rad));
            let opposed = self.opposed_line(image, line.as_ref(), &tool, io);
            let opposed = opposed.as_ref().map(|(fingertip, line)| OpposedObservation {
                fingertip,
                line,
                tool: &tool,
            });
            let observation = Observation {
                features: &touch,
                line: line.as_ref(),
                opposed,
                age_s: age_s.clamp(0.0, 1.0),
                dt_s: cycle.dt.as_secs_f64(),
            };
            outcome = outcome.and(self.answer_image(&observation, joints));
        }
        io.write(&self.features, self.report(image, &touch, line.as_ref()));
        outcome
    }

    /// Passes a new image to the law, and adds the step of a law that answers images.
    fn answer_image(
        &mut self,
        observation: &Observation<'_>,
        joints: &JointState<N>,
    ) -> Result<(), FaultCode> {
        let touch = observation.features;
        if !matches!(self.activation, Activation::Active { .. }) {
            return Ok(());
        }
        if !self.config.law.uses_wrench() {
            self.control_features = *touch;
            self.heading.update(self.law.column(touch));
        }
        let step = self.law.observe(&self.config, observation, self.heading.x_c());
        let Some(step) = step.filter(|_| touch.contact) else { return Ok(()) };
        let jobs = self.jobs_per_image(observation.dt_s);
        let image_s = self.config.image_period_ms * 1e-3;
        let share = self.add_displacement(&step, joints, jobs, image_s)?;
        if let Some([y, theta_y]) = self.law.phases().map(PhasesLaw::commanded_y) {
            let [x, z, theta_x, theta_z] = step;
            self.record_phase_motion(&[x, y, z, theta_x, theta_y, theta_z], share);
        }
        Ok(())
    }

    /// The line in the image of the second fingertip that belongs to `image`, the finger's; writes
    /// what both saw to the port `fingertip_pair`.
    fn opposed_line(
        &mut self,
        image: &TactileImage,
        line: Option<&Line>,
        tool: &Pose,
        io: &mut Io<'_>,
    ) -> Option<(OpposedFingertip, Line)> {
        let second = self.second_fingertip.as_mut()?;
        let (opposed, other) = second.line(&self.config, image.acquired_ns)?;
        second.report(image.acquired_ns, line?, &other, tool, io);
        Some((opposed, other))
    }

    /// Reports a change of contact, and adds the step of one job: that of a law that answers jobs,
    /// or the motion towards contact while there is none.
    fn advance_job(
        &mut self,
        joints: &JointState<N>,
        cycle: &Cycle,
        io: &mut Io<'_>,
    ) -> Result<(), FaultCode> {
        if !matches!(self.activation, Activation::Active { .. }) {
            return Ok(());
        }
        if self.phases.is_some() {
            return self.advance_phase_job(joints, cycle, io);
        }
        let dt_s = cycle.dt.as_secs_f64();
        if let Some(event) = self.phase.advance(&self.config, &self.control_features, dt_s) {
            io.write(&self.contact, Contact { at_ns: cycle.release.0, ..event });
        }
        if !self.phase.is_touching() {
            let blind = !self.control_features.trusted;
            let z_mm = if blind { 0.0 } else { self.phase.speed_mm_s(&self.config) * dt_s };
            self.law.record_executed(&self.config, &[0.0, z_mm, 0.0, 0.0], dt_s);
            if z_mm == 0.0 {
                return Ok(());
            }
            let share = self.add_displacement(&[0.0, z_mm, 0.0, 0.0], joints, 1, dt_s);
            self.phase.add_travel(z_mm * share.unwrap_or(0.0));
            return share.map(|_| ());
        }
        let Some(step) = self.law.command(&self.config, self.heading.x_c(), dt_s) else {
            return Ok(());
        };
        let share = self.add_displacement(&step, joints, 1, dt_s);
        let done = step.map(|part| part * share.unwrap_or(0.0));
        self.law.record_executed(&self.config, &done, dt_s);
        share.map(|_| ())
    }

    /// Whether the load was far above its set point for too long while the law drove.
    fn check_overload(&mut self, dt_s: f64) -> Result<(), FaultCode> {
        let driving = matches!(self.activation, Activation::Active { .. });
        let limit =
            self.overload_counts.max(self.config.overload_ratio * self.config.load_counts());
        let above = driving && self.image_features.trusted && self.image_features.m0 > limit;
        self.overloaded_s = if above { self.overloaded_s + dt_s } else { 0.0 };
        let most_s = OVERLOAD_S.max(OVERLOAD_IMAGES * 1e-3 * self.config.image_period_ms);
        if self.overloaded_s > most_s { Err(FaultCode::Overload) } else { Ok(()) }
    }

    /// Adds a displacement of the sensor, to be carried out within `jobs` jobs that last `span_s`;
    /// returns the share of it that the
    /// bound on the lead allows.
    fn add_displacement(
        &mut self,
        step: &[f64; 4],
        joints: &JointState<N>,
        jobs: u32,
        span_s: f64,
    ) -> Result<f64, FaultCode> {
        let Activation::Active { integrator, drift, .. } = &mut self.activation else {
            return Ok(0.0);
        };
        let target = *integrator.target();
        let measured = JointVector::from(joints.q_rad);
        let tool = self.arm.tool_pose(&measured);
        drift.update(&tool);
        let mut motion = tool_motion(step);
        (motion[1], motion[4]) = drift.correction(self.config.drift_correction_per_s, span_s);
        let unfelt = self.law.encoder_motions(&self.config, &tool, span_s);
        match unfelt.y {
            UnfeltMotion::Held => {}
            UnfeltMotion::Yielding(rate_per_s) => {
                let wanted = self.arm.tool_pose(&target);
                motion[1] = compliant_step_m(&wanted, &tool, rate_per_s, span_s);
            }
            UnfeltMotion::Commanded(y_m) => motion[1] = y_m,
        }
        if let UnfeltMotion::Commanded(theta_y_rad) = unfelt.theta_y {
            motion[4] = theta_y_rad;
        }
        motion[0] = unfelt.x_m.unwrap_or(motion[0]);
        let rate_per_s = self.config.posture_per_s;
        let wish = posture_wish(&target, integrator.posture(), rate_per_s, span_s);
        let distance_min = self.config.singular_distance_min;
        let step = joint_step(&self.arm, &target, &motion, &wish, distance_min)?;
        let part =
            lead_limited_step(&target, &measured, &step, self.config.max_lead_deg.to_radians());
        integrator.add(&part, jobs);
        let size = step.norm_squared();
        Ok(if size > 0.0 { part.dot(&step) / size } else { 1.0 })
    }

    fn report(&self, image: &TactileImage, touch: &TouchFeatures, line: Option<&Line>) -> Features {
        let touch = &line.map_or(*touch, |line| line.refined_features(touch));
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        let centroid = touch.x_c.is_some() && touch.y_c.is_some();
        let hides = || self.config.hides_load(image.noise_counts, image.rows, image.cols);
        let is_uncertain = !touch.contact && (!touch.trusted || hides());
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
                | bit(touch.theta_z_rad.is_some(), defined::THETA_Z)
                | bit(is_uncertain, defined::CONTACT_UNCERTAIN),
            sequence: image.sequence,
            reversals: self.heading.reversals(),
            active: u32::from(matches!(self.activation, Activation::Active { .. })),
        }
    }

    /// Jobs until the next image, at least 1.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped first")]
    fn jobs_per_image(&self, dt_s: f64) -> u32 {
        let jobs = self.config.image_period_ms * 1e-3 / dt_s;
        if jobs.is_finite() { jobs.round().clamp(1.0, 1e4) as u32 } else { 1 }
    }
}

impl<const N: usize, A: Arm<N>> Task for TactileServo<N, A> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.parameters.read(io, &mut self.config) {
            self.law.retune(&self.config);
        }
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let dt_s = cycle.dt.as_secs_f64();
        let mut outcome = self.update_activation(control, desired, joints.as_ref());
        if let Some(second) = &mut self.second_fingertip {
            second.read_image(&self.config, &mut *self.law, io);
        }
        if let (Some((observer, _)), Some(joints)) = (&mut self.slip, &joints) {
            let tool = self.arm.tool_pose(&JointVector::from(joints.q_rad));
            observer.record_pose(cycle.release.0, &tool);
        }
        if let Some(phases) = &mut self.phases {
            phases.begin_job();
        }
        let image = self.image;
        let seen = io.with_fresh_array(&image, |image, io| {
            self.take_image(image, joints.as_ref(), cycle, outcome, io)
        });
        outcome = seen.unwrap_or(outcome);
        if let Some(input) = &self.wrench {
            let wrench = io.read(input).usable();
            if let Some(phases) = &mut self.phases {
                phases.take_wrench(wrench.as_ref());
            }
            if let Some(features) =
                self.law.observe_wrench(&self.config, wrench.as_ref(), &self.image_features)
            {
                self.control_features = features;
                self.heading.update(self.law.column(&features));
            }
            let is_saturated = |wrench: Wrench| wrench.baseline_ready == WRENCH_SATURATED;
            let drives = matches!(self.activation, Activation::Active { .. });
            if drives && self.phase.is_touching() && wrench.is_some_and(is_saturated) {
                // A law that does not know how hard it presses has no business in contact.
                outcome = outcome.and(Err(FaultCode::ForceUnknown));
            }
        }
        if let Some(joints) = &joints {
            outcome = outcome.and(self.advance_job(joints, cycle, io));
        }
        outcome = outcome.and(self.check_overload(dt_s));
        let is_ended = self.law.phases().is_some_and(PhasesLaw::is_ended);
        let goal = self.activation.next_goal(dt_s, is_ended);
        io.write(&self.goal, goal);
        outcome
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.heading).add(&self.entered_ns).add(&self.phase).add(&self.law);
        hash.add(&self.overloaded_s).add(&self.control_features).add(&self.image_features);
        if let Some(second) = &self.second_fingertip {
            hash.add(second);
        }
        if let Some((observer, _)) = &self.slip {
            hash.add(observer);
        }
        if let Some(phases) = &self.phases {
            hash.add(phases);
        }
        match &self.activation {
            Activation::Inactive => hash.word(0),
            Activation::Refused => hash.word(1),
            Activation::Active { integrator, datum, drift } => {
                hash.word(2).add(integrator).add(datum).add(drift)
            }
        };
    }

    fn stop(&mut self) {
        self.activation = Activation::Inactive;
    }
}
