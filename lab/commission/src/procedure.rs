//! The order of a commissioning: the encoders' fineness, the lines, the pose, the pairs of motors
//! and encoders and what joint each of them is ([`crate::pairing`]), then from the outermost joint
//! inwards its range, and at last its torque.

use taktil_hal::CHANNELS;

use crate::cell::Cell;
use crate::excite::{MotorTorques, excite, learn_gain};
use crate::findings::{Findings, JointFindings, Source, TorqueFindings};
use crate::model::Model;
use crate::probe::{COUNTS_PER_DEG_MIN, Pair, PulseLimits, rests, whole};
use crate::servo::Axis;
use crate::stop::Stop;
use crate::travel::{Loops, Pulses, Scale};
use crate::witness::Witness;

/// How long the brakes are lifted without torque, to see whether the arm rests (s).
const REST_S: f64 = 0.5;
/// How long the robot rests between two questions whether somebody has answered (s).
const ASKING_S: f64 = 0.02;
/// Largest disagreement of both halves of a joint's range about its gear, in parts of it: more
/// means that a stop was none, or that the home pose is not where it is said to be.
const DISAGREEMENT_MAX: f64 = 0.05;
/// Largest residual of a fit, in parts of the friction that it finds.
const RESIDUAL_MAX: f64 = 0.3;
/// Change of gravity over a swing, over the friction, from which on gravity tells the torque.
const GRAVITY_SHARE: f64 = 0.5;

/// Hears what is being done.
pub type Progress<'a> = &'a mut dyn FnMut(&str);

/// How a robot is commissioned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Largest torque, in parts of the converters' largest code.
    pub torque_share_max: f64,
    /// Time that the brakes take to open (s).
    pub brake_s: f64,
    /// The only joint whose scales are measured, counted from 0; all when absent.
    pub only_joint: Option<usize>,
    /// Whether joints are moved to their stops. Without it neither counts nor gears are measured.
    pub seek_stops: bool,
    /// Largest torque that is tried on a joint that has not answered, in parts of what overcomes
    /// the friction and gravity of the arm's model. Motors may be weaker than the file says, and
    /// joints stiffer; an encoder that does not count is found out at this torque.
    pub friction_ratio_max: f64,
}

impl Default for Options {
    /// Seven tenths of the largest code, brakes that open at once, all joints, to their stops, four
    /// times the friction.
    fn default() -> Options {
        Options {
            torque_share_max: 0.7,
            brake_s: 0.0,
            only_joint: None,
            seek_stops: true,
            friction_ratio_max: 4.0,
        }
    }
}

/// The commissioning of one robot.
pub struct Commissioning<'a, 'b> {
    pub(crate) cell: &'a mut Cell<'b>,
    pub(crate) model: &'a Model,
    witness: &'a mut dyn Witness,
    pub(crate) progress: Progress<'a>,
    pub(crate) options: Options,
}

/// What a pair of channels is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Identified {
    pub(crate) pair: Pair,
    /// Whether counts and angle, and code and angle, grow together: 1 or -1.
    pub(crate) counts: f64,
    pub(crate) code: f64,
}

impl<'a, 'b> Commissioning<'a, 'b> {
    /// Everything that takes part.
    pub fn new(
        cell: &'a mut Cell<'b>,
        model: &'a Model,
        witness: &'a mut dyn Witness,
        progress: Progress<'a>,
        options: Options,
    ) -> Commissioning<'a, 'b> {
        Commissioning { cell, model, witness, progress, options }
    }

    pub(crate) fn limits<'c>(&self) -> PulseLimits<'c> {
        let Options { torque_share_max, brake_s, .. } = self.options;
        PulseLimits::new(torque_share_max, brake_s)
    }

    /// Runs it to its end. The outputs are safe afterwards, however it ends.
    ///
    /// # Errors
    /// What does not answer, moves without being asked, contradicts what was seen, or nobody can
    /// say.
    pub fn run(mut self) -> Result<Findings, Stop> {
        let outcome = self.all();
        match outcome {
            Ok(mut findings) => {
                self.cell.rest(0.05)?;
                findings.punctuality = self.cell.punctuality();
                Ok(findings)
            }
            Err(stop) => Err(self.cell.fail(stop)),
        }
    }

    fn all(&mut self) -> Result<Findings, Stop> {
        let joints = self.model.joints;
        if self.cell.encoders < joints || self.cell.motors < joints {
            let (encoders, motors) = (self.cell.encoders, self.cell.motors);
            let what = format!("{joints} joints, but {encoders} encoders and {motors} outputs");
            return Err(Stop::new(what, "name the devices of all joints in the machine file"));
        }
        if self.options.seek_stops && !self.cell.has_index {
            let what = "the board reports no index pulses, so that counts cannot be measured";
            return Err(Stop::new(what, "wire them, or leave the stops out: --no-stops"));
        }
        check_fineness(self.model)?;
        check_pose(self.model)?;
        (self.progress)("brakes lifted without torque: does the arm rest?");
        rests(self.cell, REST_S)?;
        let identified = self.identified()?;
        let (findings, mut loops) = self.begin(&identified)?;
        let mut findings = findings;
        let measured: Vec<usize> = (0..joints).rev().filter(|joint| self.takes(*joint)).collect();
        let mut ranges = Ranges::new(joints);
        let mut torques: MotorTorques = [None; CHANNELS];
        for joint in measured.iter().copied() {
            if self.options.seek_stops {
                self.range(&mut loops, joint, &mut ranges, &mut findings.joints[joint])?;
            }
            torques[joint] = learn_gain(self.cell, &mut loops, joint, &torques)?;
        }
        refine(&mut loops, &ranges, &mut findings);
        if !self.options.seek_stops {
            findings.unknown.push("counts of a turn and gears: the stops were left out".to_owned());
        }
        for joint in measured {
            torques[joint] = self.torque(&mut loops, joint, &torques, &mut findings)?;
        }
        Ok(findings)
    }

    fn takes(&self, joint: usize) -> bool {
        self.options.only_joint.is_none_or(|only| only == joint)
    }

    /// Asks the witness until there is an answer, with the brakes on and the boards fed meanwhile.
    pub(crate) fn asked<T>(
        &mut self,
        mut ask: impl FnMut(&mut dyn Witness) -> Result<Option<T>, Stop>,
    ) -> Result<T, Stop> {
        loop {
            if let Some(answer) = ask(self.witness)? {
                return Ok(answer);
            }
            self.cell.rest(ASKING_S)?;
        }
    }

    /// Waits until the witness allows a motion.
    pub(crate) fn allowed(&mut self, joint: usize, what: &str) -> Result<(), Stop> {
        self.asked(|witness| Ok(witness.allow(joint, what)?.then_some(())))
    }

    /// Closes the loops where the joints stand.
    fn begin(&mut self, found: &[Identified]) -> Result<(Findings, Loops<'a>), Stop> {
        let here = self.cell.rest(0.05)?;
        let model = self.model;
        let axes = found.iter().map(|one| Axis::new(one.pair, here.counts[one.pair.encoder]));
        let per_rad = |i: usize| {
            found[i].counts * model.counts_per_rev[i] * model.gear[i] / core::f64::consts::TAU
        };
        let scales = (0..found.len())
            .map(|i| Scale { counts_per_rad: per_rad(i), counts_per_rev: None })
            .collect();
        let code_max = self.options.torque_share_max * f64::from(self.cell.code_max);
        let loops = Loops::new(axes.collect(), scales, model, code_max);
        let joints = found.iter().zip(&model.own_sign).map(|(one, own)| JointFindings {
            encoder_channel: one.pair.encoder,
            encoder_sign: one.counts * own,
            motor_channel: one.pair.motor,
            motor_sign: one.code * own,
            counts_per_rev: None,
            spacing_residual_counts: 0,
            spacings: 0,
            gear: None,
            gear_disagreement: 0.0,
            home_counts: None,
            torque: None,
            torque_constant_nm_a: None,
            breakaway_codes: one.pair.breakaway,
        });
        Ok((Findings { joints: joints.collect(), ..Findings::default() }, loops))
    }

    /// The range of a joint from stop to stop: counts of a turn, gear, home counts.
    fn range(
        &mut self,
        loops: &mut Loops<'_>,
        joint: usize,
        ranges: &mut Ranges,
        findings: &mut JointFindings,
    ) -> Result<(), Stop> {
        let (model, label) = (self.model, self.model.label(joint));
        self.allowed(joint, &format!("{label} to both stops"))?;
        loops_at_rest(self.cell, loops)?;
        let home = 0.0;
        let here = model.home_rad[joint];
        let (down, up) = (here - model.low_rad[joint], model.high_rad[joint] - here);
        // The nearer stop first: the estimates of the scale are then needed less far.
        let first = if up < down { 1.0 } else { -1.0 };
        let mut pulses = Pulses::default();
        let mut spacings = Vec::new();
        let mut ends = [0.0; 2];
        for (at, direction) in [first, -first].into_iter().enumerate() {
            ranges.ends[joint][at] = loops.seek_stop(self.cell, joint, direction, &mut pulses)?;
            let counts = ranges.ends[joint][at][loops.axes[joint].pair.encoder] as f64;
            ends[at] = counts;
            spacings.extend(pulses.spacings());
            let way = if direction > 0.0 { up } else { -down };
            if at == 0 {
                loops.scales[joint].counts_per_rad = (counts - home) / way;
            }
        }
        ranges.first[joint] = first;
        let range = first * (ends[0] - ends[1]);
        let per_rad = range / (up + down);
        let ways = if first > 0.0 { [up, -down] } else { [-down, up] };
        let halves = [(ends[0] - home) / ways[0], (ends[1] - home) / ways[1]];
        findings.gear_disagreement = ((halves[0] - halves[1]) / per_rad).abs();
        loops.scales[joint].counts_per_rad = per_rad;
        self.check_range(joint, findings, per_rad)?;
        let Some(turn) = loops.scales[joint].counts_per_rev else {
            let what = format!("no index pulse came while {label} went from stop to stop");
            return Err(Stop::new(what, "look at the encoder's index wire, or use --no-stops"));
        };
        let turn = median(&spacings).unwrap_or(turn);
        findings.spacings = spacings.len();
        let off = |spacing: &i64| (*spacing as f64 - turn).abs();
        findings.spacing_residual_counts =
            spacings.iter().map(|s| whole(off(s)).into()).max().unwrap_or(0);
        findings.counts_per_rev = Some(turn);
        findings.gear = Some(per_rad.abs() * core::f64::consts::TAU / turn);
        if let Some(place) = pulses.places.last() {
            let past = findings.encoder_sign * (home - *place as f64);
            findings.home_counts = Some(past.rem_euclid(turn));
        }
        (self.progress)(&format!(
            "{label}: {turn} counts a turn, gear {:.4}",
            findings.gear.unwrap_or(0.0)
        ));
        loops.move_to(self.cell, joint, home)?;
        for motor in 0..model.joints {
            if motor != joint && model.coupling(motor, joint) != 0.0 {
                loops.move_to(self.cell, motor, 0.0)?;
            }
        }
        Ok(())
    }

    fn check_range(
        &self,
        joint: usize,
        findings: &JointFindings,
        per_rad: f64,
    ) -> Result<(), Stop> {
        let label = self.model.label(joint);
        if findings.gear_disagreement > DISAGREEMENT_MAX {
            let what = format!(
                "{label} has {:.1} % more counts to one stop than to the other by its range",
                100.0 * findings.gear_disagreement
            );
            let remedy = "is the arm in the pose that the file says, and was nothing in its way?";
            return Err(Stop::new(what, remedy));
        }
        if per_rad.to_radians().abs() < COUNTS_PER_DEG_MIN {
            let what = format!("{label} has {:.1} counts a degree", per_rad.to_radians().abs());
            let remedy = "so coarse an encoder cannot be commissioned within a degree";
            return Err(Stop::new(what, remedy));
        }
        Ok(())
    }

    /// Torque and friction of a joint; returns its torque for one code.
    fn torque(
        &mut self,
        loops: &mut Loops<'_>,
        joint: usize,
        known: &MotorTorques,
        findings: &mut Findings,
    ) -> Result<Option<f64>, Stop> {
        let (model, label) = (self.model, self.model.label(joint));
        self.allowed(joint, &format!("{label} to and fro by up to 20 degrees"))?;
        let Some(fit) = excite(self.cell, loops, joint, known)? else {
            findings.unknown.push(format!("torque of {label}: its motion says nothing"));
            return Ok(None);
        };
        let fits = fit.nm_per_code > 0.0 && fit.residual_nm <= RESIDUAL_MAX * fit.coulomb_nm;
        if !fits {
            let what = format!(
                "the motion of {label} contradicts gravity and inertia of the model: {:.3} N m \
                 are left beside {:.3} N m of friction",
                fit.residual_nm, fit.coulomb_nm
            );
            let remedy =
                "was this joint seen right, and which way? are the masses in the file its?";
            return Err(Stop::new(what, remedy));
        }
        let source = match gravity_change(model, joint) > GRAVITY_SHARE * fit.coulomb_nm {
            true => Source::Gravity,
            false => Source::Inertia,
        };
        let found = &mut findings.joints[joint];
        found.torque = Some(TorqueFindings::of(&fit, source));
        let gear = found.gear.unwrap_or(model.gear[joint]);
        let amperes = model.current_max_a[joint] / model.full_scale_codes;
        found.torque_constant_nm_a = Some(fit.nm_per_code / (gear * amperes));
        if source == Source::Inertia {
            let what = format!(
                "gravity does not show the torque of {label} in this pose; the \
                                inertia of the arm's model does, and its error is that of the model"
            );
            findings.unknown.push(what);
        }
        (self.progress)(&format!(
            "{label}: {:.5} N m a code, friction {:.3} N m",
            fit.nm_per_code, fit.coulomb_nm
        ));
        Ok(Some(fit.nm_per_code))
    }
}

/// Refuses encoders that are too coarse by the file, before anything is powered: the limits of
/// pulses are counts, and a degree has to have enough of them.
fn check_fineness(model: &Model) -> Result<(), Stop> {
    let coarse = (0..model.joints).find(|joint| model.counts_per_deg(*joint) < COUNTS_PER_DEG_MIN);
    let Some(joint) = coarse else { return Ok(()) };
    let turns = model.gear[joint];
    let what = format!(
        "{} has {:.1} counts a degree by the file ({} counts a turn, gear {turns}), and a degree \
         needs {COUNTS_PER_DEG_MIN}",
        model.label(joint),
        model.counts_per_deg(joint),
        model.counts_per_rev[joint],
    );
    let remedy = format!(
        "correct `counts_per_rev` or `gear` in [joints] if the file is wrong; otherwise take an \
         encoder of at least {:.0} counts a turn",
        (360.0 * COUNTS_PER_DEG_MIN / turns).ceil()
    );
    Err(Stop::new(what, remedy))
}

/// Refuses a pose in which the arm falls by its model when its brakes lift: an encoder that does
/// not count would hide it.
fn check_pose(model: &Model) -> Result<(), Stop> {
    let held = model.holding_nm();
    let falls = |joint: &usize| {
        let friction = model.friction_nm[*joint];
        friction > 0.0 && held[*joint].abs() > friction
    };
    let Some(joint) = (0..model.joints).find(falls) else { return Ok(()) };
    let what = format!(
        "by the arm's model {} moves without torque when the brakes lift: gravity {:.2} N m, \
         friction {:.2} N m",
        model.label(joint),
        held[joint].abs(),
        model.friction_nm[joint]
    );
    let remedy = "put it into a pose in which it rests by itself, such as straight up, and say \
                  which with --pose";
    Err(Stop::new(what, remedy))
}

/// Where everything stood at the stops of each joint, and towards which the joint went first: 1 for
/// growing angles; 0 for a joint that was not moved.
struct Ranges {
    ends: Vec<[[i64; CHANNELS]; 2]>,
    first: Vec<f64>,
}

impl Ranges {
    fn new(joints: usize) -> Ranges {
        Ranges { ends: vec![[[0; CHANNELS]; 2]; joints], first: vec![0.0; joints] }
    }
}

/// Takes out of each range what the inner joints gave way, which are coupled to its motor: a motor
/// at a stop pushes them too. Their own scales are known only now.
fn refine(loops: &mut Loops<'_>, ranges: &Ranges, findings: &mut Findings) {
    let model = loops.model;
    for joint in (0..model.joints).filter(|joint| ranges.first[*joint] != 0.0) {
        let [one, other] = &ranges.ends[joint];
        let (at_one, at_other) = (loops.angles(one, 0), loops.angles(other, 0));
        let encoder = loops.axes[joint].pair.encoder;
        let range = ranges.first[joint] * (model.high_rad[joint] - model.low_rad[joint]);
        let yielded: f64 = (0..joint)
            .map(|inner| model.coupling(joint, inner) * (at_one[inner] - at_other[inner]))
            .sum();
        let per_rad = (one[encoder] - other[encoder]) as f64 / (range + yielded);
        loops.scales[joint].counts_per_rad = per_rad;
        let found = &mut findings.joints[joint];
        let turn = found.counts_per_rev;
        found.gear = turn.map(|turn| per_rad.abs() * core::f64::consts::TAU / turn);
    }
}

fn loops_at_rest(cell: &mut Cell<'_>, loops: &mut Loops<'_>) -> Result<(), Stop> {
    loops.settle(cell, 0.3).map(|_| ())
}

/// How much the torque of gravity on a joint changes over a swing (N m).
fn gravity_change(model: &Model, joint: usize) -> f64 {
    let still = vec![0.0; model.joints];
    let at = |angle: f64| {
        let mut q = model.home_rad.clone();
        q[joint] += angle;
        model.torque_nm(&q, &still, &still)[joint]
    };
    (at(0.35) - at(-0.35)).abs()
}

fn median(spacings: &[i64]) -> Option<f64> {
    let mut sorted = spacings.to_vec();
    sorted.sort_unstable();
    sorted.get(sorted.len() / 2).map(|spacing| *spacing as f64)
}
