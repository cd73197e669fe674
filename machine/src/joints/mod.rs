//! How the joints are wired to the boards: which encoder and which converter belongs to which
//! joint, which way they count and drive, and their scales. With it an arm with other encoders, a
//! reversed motor or swapped channels runs by its machine file alone.
//!
//! [`JointsConfig::applied_to`] puts the scales into the arm's model, [`JointsConfig::connect`]
//! puts channels and signs between the arm and its boards. The same section describes how a
//! simulated robot is wired ([`JointsConfig::as_wired`]), where it is not as the machine file says.

mod drives;
mod halves;

use serde::Deserialize;
use taktil_hal::{CHANNELS, Devices};
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::Invalid;

use crate::robot::AnyRobot;
use crate::with_robot;
use drives::{ConnectedDriveIn, ConnectedDriveOut, DriveChannel};
use halves::{ConnectedAnalogOut, ConnectedEncoders, EncoderChannel, OutputChannel};

/// Largest scale that a number of the section may have.
const SCALE_MAX: f64 = 1e8;

taktil_rtcore::explained! {
    /// `[joints]`: how the joints are wired, one number for each joint. What is left out is as the
    /// arm has it: channels in the order of the joints, signs +1, the arm's own scales.
    #[derive(Clone, Debug, Default, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct JointsConfig {
        /// Channel of each joint's encoder, counted from 0.
        pub encoder_channel: Option<Vec<f64>>,
        /// 1, or -1 for an encoder that counts down where the joint's angle grows.
        pub encoder_sign: Option<Vec<f64>>,
        /// Encoder counts of one motor turn, after quadrature.
        pub counts_per_rev: Option<Vec<f64>>,
        /// Motor turns in one turn of the joint that the motor drives; couplings to other joints
        /// are scaled with it.
        pub gear: Option<Vec<f64>>,
        /// Channel of the converter before each motor's amplifier, counted from 0.
        pub motor_channel: Option<Vec<f64>>,
        /// 1, or -1 for a motor that turns the other way at a positive code.
        pub motor_sign: Option<Vec<f64>>,
        /// Torque constants of the motors (N m/A).
        pub torque_constant_nm_a: Option<Vec<f64>>,
        /// Currents of the amplifiers at `full_scale_codes` (A).
        pub current_max_a: Option<Vec<f64>>,
        /// Code at which an amplifier gives `current_max_a`; with it the codes of the board are
        /// scaled. Default: the arm's own converter, 2048 for 12 bits.
        pub full_scale_codes: Option<Vec<f64>>,
        /// In place of `full_scale_codes`: the voltage at which an amplifier gives `current_max_a`
        /// (V), for a board that tells its volts per code.
        pub full_scale_v: Option<Vec<f64>>,
        /// In place of both: codes of the board for one N m of the motor's torque.
        pub codes_per_nm: Option<Vec<f64>>,
        /// In place of all three: volts for one N m of the motor's torque (V/(N m)).
        pub volts_per_nm: Option<Vec<f64>>,
        /// Current that a motor gets at most (A), at most `current_max_a`. Default: that.
        pub current_limit_a: Option<Vec<f64>>,
    }
}

/// What is wired to each joint, checked.
#[derive(Clone, Debug)]
struct Wired<const N: usize> {
    encoder_channel: [usize; N],
    encoder_sign: [f64; N],
    motor_channel: [usize; N],
    motor_sign: [f64; N],
}

fn list<const N: usize>(
    place: &str,
    given: Option<&Vec<f64>>,
    usual: impl Fn(usize) -> f64,
) -> Result<[f64; N], Invalid> {
    match given {
        None => Ok(core::array::from_fn(usual)),
        Some(list) => taktil_signal::per_joint::<N>(place, list),
    }
}

fn channels<const N: usize>(place: &str, given: Option<&Vec<f64>>) -> Result<[usize; N], Invalid> {
    let numbers = list::<N>(place, given, |i| i as f64)?;
    let mut channels = [0; N];
    for (i, number) in numbers.into_iter().enumerate() {
        if number.fract() != 0.0 || !(0.0..CHANNELS as f64).contains(&number) {
            let remedy = format!("give whole numbers from 0 to {}", CHANNELS - 1);
            return Err(Invalid::new(
                format!("{place}[{i}]"),
                format!("{number} is no channel"),
                remedy,
            ));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked")]
        let channel = number as usize;
        if let Some(other) = channels[..i].iter().position(|known| *known == channel) {
            let what = format!("channel {channel} is that of joint {} already", other + 1);
            return Err(Invalid::new(format!("{place}[{i}]"), what, "give each joint its own"));
        }
        channels[i] = channel;
    }
    Ok(channels)
}

fn signs<const N: usize>(place: &str, given: Option<&Vec<f64>>) -> Result<[f64; N], Invalid> {
    let signs = list::<N>(place, given, |_| 1.0)?;
    match signs.iter().position(|sign| sign.abs() != 1.0) {
        None => Ok(signs),
        Some(i) => {
            let what = format!("{} is no sign", signs[i]);
            Err(Invalid::new(format!("{place}[{i}]"), what, "give 1 or -1"))
        }
    }
}

/// Positive numbers of sensible size.
fn scales<const N: usize>(
    place: &str,
    given: Option<&Vec<f64>>,
    usual: &JointVector<N>,
) -> Result<JointVector<N>, Invalid> {
    let numbers = list::<N>(place, given, |i| usual[i])?;
    if let Some(i) =
        numbers.iter().position(|x| !(1e-9..=SCALE_MAX).contains(x)).filter(|_| given.is_some())
    {
        let what = format!("{} is no scale", numbers[i]);
        let remedy = "give a number above 0; directions are given by signs";
        return Err(Invalid::new(format!("{place}[{i}]"), what, remedy));
    }
    Ok(JointVector::from(numbers))
}

impl JointsConfig {
    fn wired<const N: usize, A: Arm<N>>(&self, _: &Robot<N, A>) -> Result<Wired<N>, Invalid> {
        Ok(Wired {
            encoder_channel: channels("encoder_channel", self.encoder_channel.as_ref())?,
            encoder_sign: signs("encoder_sign", self.encoder_sign.as_ref())?,
            motor_channel: channels("motor_channel", self.motor_channel.as_ref())?,
            motor_sign: signs("motor_sign", self.motor_sign.as_ref())?,
        })
    }

    /// The arm with the gears, encoders and motors of the section.
    ///
    /// # Errors
    /// A list of another length than the arm has joints, or a number that is no scale; the place is
    /// in the section.
    pub fn applied_to(&self, robot: AnyRobot) -> Result<AnyRobot, Invalid> {
        Ok(match robot {
            AnyRobot::Puma260(robot) => AnyRobot::Puma260(Box::new(self.scaled(*robot)?)),
            AnyRobot::Six(robot) => AnyRobot::Six(Box::new(self.scaled(*robot)?)),
            AnyRobot::Seven(robot) => AnyRobot::Seven(Box::new(self.scaled(*robot)?)),
            AnyRobot::TwoFingers(robot) => AnyRobot::TwoFingers(Box::new(self.scaled(*robot)?)),
            AnyRobot::ThreeFingers(robot) => AnyRobot::ThreeFingers(Box::new(self.scaled(*robot)?)),
            AnyRobot::TwoFingersOnArm(robot) => {
                AnyRobot::TwoFingersOnArm(Box::new(self.scaled(*robot)?))
            }
            AnyRobot::ThreeFingersOnArm(robot) => {
                AnyRobot::ThreeFingersOnArm(Box::new(self.scaled(*robot)?))
            }
        })
    }

    fn scaled<const N: usize, A: Arm<N>>(
        &self,
        robot: Robot<N, A>,
    ) -> Result<Robot<N, A>, Invalid> {
        self.wired(&robot)?;
        let mut robot = robot;
        if self.gear.is_some() || self.counts_per_rev.is_some() {
            let own = JointVector::<N>::from_fn(|i, _| robot.gears.gear_matrix()[(i, i)].abs());
            let gear = scales("gear", self.gear.as_ref(), &own)?;
            let counts = robot.gears.counts_per_revolution();
            let counts = scales("counts_per_rev", self.counts_per_rev.as_ref(), &counts)?;
            robot.gears = robot.gears.rescaled(&gear.component_div(&own), &counts);
        }
        let drive = &mut robot.drive;
        let constant = self.torque_constant_nm_a.as_ref();
        drive.torque_constant_nm_a =
            scales("torque_constant_nm_a", constant, &drive.torque_constant_nm_a)?;
        drive.current_max_a =
            scales("current_max_a", self.current_max_a.as_ref(), &drive.current_max_a)?;
        if self.current_limit_a.is_some() {
            let limit =
                scales("current_limit_a", self.current_limit_a.as_ref(), &drive.current_max_a)?;
            if let Some(i) = (0..N).find(|i| limit[*i] > drive.current_max_a[*i]) {
                let what = format!(
                    "{} A is above `current_max_a`, {} A",
                    limit[i], drive.current_max_a[i]
                );
                return Err(Invalid::new(format!("current_limit_a[{i}]"), what, "give less"));
            }
        }
        if self.changes_torque() {
            let peak = robot.drive.peak_joint_torque(&robot.gears);
            robot.torque_max_nm =
                robot.torque_max_nm.inf(&peak.component_mul(&self.limit_ratio(&robot)?));
        }
        Ok(robot)
    }

    fn changes_torque(&self) -> bool {
        self.torque_constant_nm_a.is_some()
            || self.current_max_a.is_some()
            || self.current_limit_a.is_some()
            || self.gear.is_some()
    }

    /// Largest current over that at full scale.
    fn limit_ratio<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<JointVector<N>, Invalid> {
        let most = robot.drive.current_max_a;
        Ok(scales("current_limit_a", self.current_limit_a.as_ref(), &most)?.component_div(&most))
    }

    /// Codes of the board for one code of the arm's own converter.
    fn code_scale<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
        volts_per_code: &[f64],
        channel: &[usize],
    ) -> Result<Vec<f64>, Invalid> {
        let given = [
            ("full_scale_codes", &self.full_scale_codes),
            ("full_scale_v", &self.full_scale_v),
            ("codes_per_nm", &self.codes_per_nm),
            ("volts_per_nm", &self.volts_per_nm),
        ];
        let mut stated = given.iter().filter_map(|(name, list)| Some((*name, list.as_ref()?)));
        let Some((name, numbers)) = stated.next() else { return Ok(vec![1.0; N]) };
        if let Some((other, _)) = stated.next() {
            let what = format!("stands beside `{name}`, and both say how codes become torque");
            return Err(Invalid::new(other, what, format!("leave `{other}` or `{name}` out")));
        }
        let numbers = scales::<N>(name, Some(numbers), &JointVector::zeros())?;
        let own_codes = f64::from(-robot.drive.code_range().0);
        let mut scale = vec![1.0; N];
        for (i, scale) in scale.iter_mut().enumerate() {
            let volts = || match volts_per_code.get(channel[i]) {
                Some(volts) if *volts > 0.0 => Ok(*volts),
                _ => {
                    let what =
                        format!("the board of channel {} does not tell volts per code", channel[i]);
                    let remedy = "give `full_scale_codes` or `codes_per_nm`";
                    Err(Invalid::new(name, what, remedy))
                }
            };
            let full_codes = match name {
                "full_scale_codes" => numbers[i],
                "full_scale_v" => numbers[i] / volts()?,
                "codes_per_nm" => numbers[i] * robot.drive.full_scale_nm(i),
                _ => numbers[i] * robot.drive.full_scale_nm(i) / volts()?,
            };
            *scale = full_codes / own_codes;
        }
        Ok(scale)
    }

    /// Puts the wiring between the arm's joints and the boards: the halves that come back count and
    /// drive in the order and direction of the joints. `volts_per_code` is that of the D/A board's
    /// channels, empty where it does not tell. Halves that the section leaves alone stay as they
    /// are.
    ///
    /// # Errors
    /// A channel that the board does not have, or a scale that is missing; the place is in the
    /// section.
    pub fn connect(
        &self,
        robot: &AnyRobot,
        mut devices: Devices,
        volts_per_code: &[f64],
    ) -> Result<Devices, Invalid> {
        with_robot!(robot, robot => {
            let wired = self.wired(robot)?;
            let scale = self.code_scale(robot, volts_per_code, &wired.motor_channel)?;
            let ratio = self.limit_ratio(robot)?;
            let full = f64::from(-robot.drive.code_range().0);
            devices.encoders = match devices.encoders.take() {
                Some(half) if self.encoder_channel.is_some() || self.encoder_sign.is_some() => {
                    let to = |i: usize| EncoderChannel {
                        channel: wired.encoder_channel[i],
                        scale: wired.encoder_sign[i],
                        disc_counts: None,
                    };
                    let all: Vec<EncoderChannel> = (0..robot.home_rad.len()).map(to).collect();
                    Some(Box::new(ConnectedEncoders::new(half, &all)?))
                }
                other => other,
            };
            devices.analog_out = match devices.analog_out.take() {
                Some(half) if self.rewires_outputs() => {
                    let to = |i: usize| OutputChannel {
                        channel: wired.motor_channel[i],
                        scale: wired.motor_sign[i] * scale[i],
                        limit_codes: ratio[i] * full,
                    };
                    let all: Vec<OutputChannel> = (0..robot.home_rad.len()).map(to).collect();
                    Some(Box::new(ConnectedAnalogOut::new(half, &all)?))
                }
                other => other,
            };
            if self.rewires_drives() {
                let to = |i: usize| DriveChannel {
                    caller: i,
                    channel: wired.motor_channel[i],
                    counts: wired.encoder_sign[i],
                    codes: wired.motor_sign[i] * scale[i],
                    limit_codes: ratio[i] * full,
                };
                connect_drives((0..robot.home_rad.len()).map(to).collect(), &mut devices)?;
            }
        });
        Ok(devices)
    }

    /// What is left of the section for whoever finds out how the joints are wired: what a code of
    /// the board is worth.
    ///
    /// # Errors
    /// That is not the same for every channel, or is given by a torque, which is to be found out
    /// too; the place is in the section.
    pub fn without_wiring(&self) -> Result<JointsConfig, Invalid> {
        for (place, list) in
            [("codes_per_nm", &self.codes_per_nm), ("volts_per_nm", &self.volts_per_nm)]
        {
            if list.is_some() {
                let what = "says how codes become torque, which is to be found out";
                let remedy = "give `full_scale_v` or `full_scale_codes` of the amplifiers instead";
                return Err(Invalid::new(place, what, remedy));
            }
        }
        for (place, list) in
            [("full_scale_codes", &self.full_scale_codes), ("full_scale_v", &self.full_scale_v)]
        {
            if list.iter().flatten().any(|one| Some(one) != list.iter().flatten().next()) {
                let what = "differs from joint to joint, and their channels are to be found out";
                let remedy = "give one number for all, and put the difference into `current_max_a`";
                return Err(Invalid::new(place, what, remedy));
            }
        }
        Ok(JointsConfig {
            full_scale_codes: self.full_scale_codes.clone(),
            full_scale_v: self.full_scale_v.clone(),
            ..JointsConfig::default()
        })
    }

    /// Whether the section says what a code of the board is worth.
    #[must_use]
    pub fn states_code_scale(&self) -> bool {
        self.full_scale_codes.is_some()
            || self.full_scale_v.is_some()
            || self.codes_per_nm.is_some()
            || self.volts_per_nm.is_some()
    }

    fn rewires_drives(&self) -> bool {
        self.rewires_outputs() || self.encoder_sign.is_some()
    }

    fn rewires_outputs(&self) -> bool {
        self.motor_channel.is_some()
            || self.motor_sign.is_some()
            || self.states_code_scale()
            || self.current_limit_a.is_some()
    }

    /// The halves of a simulated robot of the arm `robot`, wired as the section says: what counts
    /// and drives in the order of the joints does so by the section's channels, directions and
    /// scales.
    ///
    /// # Errors
    /// As [`JointsConfig::applied_to`].
    pub fn as_wired(
        &self,
        robot: &AnyRobot,
        mut devices: Devices,
        volts_per_code: &[f64],
    ) -> Result<Devices, Invalid> {
        if *self == JointsConfig::default() {
            return Ok(devices);
        }
        let scaled = self.applied_to(robot.clone())?;
        with_robot!(robot, robot => {
            let wired = self.wired(robot)?;
            let joints = robot.home_rad.len();
            let gears = robot.gears.gear_matrix();
            let counts = counts_ratio(&scaled, gears, &robot.gears.counts_per_revolution());
            let turns = turns_ratio(&scaled, robot.gears.gear_matrix());
            let torque = torque_ratio(&scaled, &robot.drive, &turns);
            let discs = with_robot!(&scaled, scaled =>
                scaled.gears.counts_per_revolution().as_slice().to_vec());
            let channel = &wired.motor_channel;
            let scale = with_robot!(&scaled, scaled =>
                self.code_scale(scaled, volts_per_code, channel))?;
            let encoder_channels = 1 + wired.encoder_channel.iter().copied().max().unwrap_or(0);
            if let Some(half) = devices.encoders.take() {
                // Channel c shows the joint whose channel it is, and an encoder that stands still
                // where none is.
                let joint_of = |channel: usize| {
                    wired.encoder_channel.iter().position(|own| *own == channel)
                };
                let to = |channel: usize| match joint_of(channel) {
                    Some(joint) => EncoderChannel {
                        channel: joint,
                        scale: wired.encoder_sign[joint] * counts[joint],
                        disc_counts: (turns[joint] != 1.0).then(|| whole_counts(discs[joint])),
                    },
                    None => EncoderChannel { channel: 0, scale: 0.0, disc_counts: None },
                };
                let all: Vec<EncoderChannel> = (0..encoder_channels.max(joints)).map(to).collect();
                devices.encoders = Some(Box::new(ConnectedEncoders::new(half, &all)?));
            }
            if let Some(half) = devices.analog_out.take() {
                let to = |joint: usize| OutputChannel {
                    channel: joint,
                    scale: wired.motor_sign[joint] * torque[joint] / scale[joint],
                    limit_codes: f64::INFINITY,
                };
                let all: Vec<OutputChannel> = (0..joints).map(to).collect();
                let half = ConnectedAnalogOut::new(half, &all)?;
                devices.analog_out = Some(Box::new(half.reading(&wired.motor_channel)));
            }
            let to = |joint: usize| DriveChannel {
                caller: wired.motor_channel[joint],
                channel: joint,
                counts: wired.encoder_sign[joint] / counts[joint],
                codes: wired.motor_sign[joint] * torque[joint] / scale[joint],
                limit_codes: f64::INFINITY,
            };
            connect_drives((0..joints).map(to).collect(), &mut devices)?;
        });
        Ok(devices)
    }
}

/// Puts the wiring before drives that close a loop.
fn connect_drives(all: Vec<DriveChannel>, devices: &mut Devices) -> Result<(), Invalid> {
    if let Some(half) = devices.drive_out.take() {
        devices.drive_out = Some(Box::new(ConnectedDriveOut::new(half, all.clone())?));
    }
    if let Some(half) = devices.drive_in.take() {
        devices.drive_in = Some(Box::new(ConnectedDriveIn::new(half, all)?));
    }
    Ok(())
}

/// Counts of each motor's encoder over those of the arm with these gears.
fn counts_ratio<const N: usize>(
    scaled: &AnyRobot,
    gears: &taktil_mechanics::spatial::JointMatrix<N>,
    counts: &JointVector<N>,
) -> Vec<f64> {
    with_robot!(scaled, robot => (0..N).map(|i| {
        let own = gears[(i, i)] * counts[i];
        let gear = robot.gears.gear_matrix();
        gear[(i, i)] * robot.gears.counts_per_revolution()[i] / own
    }).collect())
}

/// Turns of each motor over those of the arm with these gears.
fn turns_ratio<const N: usize>(
    scaled: &AnyRobot,
    gears: &taktil_mechanics::spatial::JointMatrix<N>,
) -> Vec<f64> {
    with_robot!(scaled, robot =>
        (0..N).map(|i| robot.gears.gear_matrix()[(i, i)] / gears[(i, i)]).collect())
}

/// What each motor of these drives has to give for one code, over what it gives: the torque of the
/// wired motor at full scale times the turns that it makes for one of this one's.
fn torque_ratio<const N: usize>(
    scaled: &AnyRobot,
    drive: &taktil_mechanics::transmission::Drive<N>,
    turns: &[f64],
) -> Vec<f64> {
    with_robot!(scaled, robot => (0..N)
        .map(|i| turns[i] * robot.drive.full_scale_nm(i) / drive.full_scale_nm(i))
        .collect())
}

/// The counts of a disc as a whole number.
#[expect(clippy::cast_possible_truncation, reason = "scales are at most 1e8")]
fn whole_counts(counts: f64) -> i64 {
    counts.round() as i64
}
