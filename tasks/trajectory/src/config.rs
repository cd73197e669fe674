//! `[trajectory]`: the queue of moves. Moves that no arm could make are refused at load: angles
//! outside the limits, tool poses out of reach, speeds above those of the arm.

use serde::Deserialize;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::paul::MAX_POINTS;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};
use taktil_rtcore::Invalid;
use taktil_signal::per_joint;

/// Most moves of a queue: one point of the path is where the arm stands.
pub const MOVES_MAX: usize = MAX_POINTS - 1;
const _: () = assert!(MOVES_MAX == 31, "what `Config::moves` says");
/// Longest displacement of `by_mm`: more than the arm's reach.
const DISPLACEMENT_MAX_MM: f64 = 1500.0;

taktil_rtcore::explained! {
    /// The queue and how it is run. Every key has a default; without moves the state is left at
    /// once.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Moves in order, at most 31. Points between two moves are rounded, not hit, unless the
        /// same goal is given twice. Default none.
        pub moves: Vec<Move>,
        /// Half the time of each transition (s). Default 0.1.
        pub tau_s: f64,
        /// Share of the joints' largest speeds for moves without `t_s`. Default 0.3.
        pub speed: f64,
        /// Speed of the tool point in straight moves without `t_s` (mm/s). Default 50.
        pub line_mm_s: f64,
        /// Speed at which the tool turns in straight moves without `t_s` (deg/s). Default 30.
        pub turn_deg_s: f64,
        /// How the orientation passes the points between straight moves. Default `smooth`.
        pub blend: BlendName,
        /// How far the tool may leave a straight path past a wrist singularity (mm). Default 5.
        pub path_error_max_mm: f64,
        /// How far the tool's orientation may be off a straight path past a wrist singularity
        /// (deg). Default 2.
        pub path_error_max_deg: f64,
    }
}

taktil_rtcore::explained! {
    /// How the orientation passes a point between two straight moves.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum BlendName {
        /// As Paul published it: the angular velocity steps.
        Paul,
        /// Paul's two angles without a step.
        #[default]
        Smooth,
        /// About one axis, without a step.
        So3,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            moves: Vec::new(),
            tau_s: 0.1,
            speed: 0.3,
            line_mm_s: 50.0,
            turn_deg_s: 30.0,
            blend: BlendName::Smooth,
            path_error_max_mm: 5.0,
            path_error_max_deg: 2.0,
        }
    }
}

taktil_rtcore::explained! {
    /// One move: its goal is `joints_deg`, `tool` or `by_mm`.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Move {
        /// Goal as joint angles (deg), one a joint.
        #[serde(default)]
        pub joints_deg: Option<Vec<f64>>,
        /// Goal as a pose of the tool.
        #[serde(default)]
        pub tool: Option<ToolGoal>,
        /// Goal as a displacement of the tool point along the tool's own axes (mm) from where the
        /// move before it ends; the orientation stays. `[0, 0, 5]` goes 5 mm the way the sensor
        /// looks.
        #[serde(default)]
        pub by_mm: Option<[f64; 3]>,
        /// Whether the tool runs straight to its goal, which is `tool` or `by_mm` then; else the
        /// way is straight in joint space. Between a straight move and another the arm rests.
        /// Default false.
        #[serde(default)]
        pub straight: bool,
        /// Time of the segment, corner to corner (s). Default: what `speed`, or for straight moves
        /// `line_mm_s` and `turn_deg_s`, allow.
        #[serde(default)]
        pub t_s: Option<f64>,
    }
}

taktil_rtcore::explained! {
    /// A pose of the tool frame in the base frame. Without `rotation` the sensor looks down,
    /// `R = Rz(yaw) Ry(pitch) Rx(roll) diag(-1, 1, -1)`.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct ToolGoal {
        /// Tool point (mm).
        pub p_mm: [f64; 3],
        /// Rotation matrix row by row, in the place of the three angles. Default none.
        #[serde(default)]
        pub rotation: Option<[f64; 9]>,
        /// Turn of the downward sensor about z0 (deg), applied last. Default 0.
        #[serde(default)]
        pub yaw_deg: f64,
        /// Turn about y0 (deg), applied second. Default 0.
        #[serde(default)]
        pub pitch_deg: f64,
        /// Turn about x0 (deg), applied first. Default 0.
        #[serde(default)]
        pub roll_deg: f64,
    }
}

/// A checked goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal<const N: usize = 6> {
    /// Joint angles (rad).
    Joints(JointVector<N>),
    /// Tool pose in the base frame.
    Tool(Pose),
    /// Displacement in the tool's axes (m).
    By([f64; 3]),
}

/// A checked move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<const N: usize = 6> {
    /// The goal of the move.
    pub goal: Goal<N>,
    /// Whether the tool runs straight to it.
    pub straight: bool,
    /// Time of the segment (s); when absent it follows from the speeds.
    pub t_s: Option<f64>,
}

impl ToolGoal {
    /// The pose.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let p = self.p_mm.map(|x| x * 1e-3);
        if let Some(rows) = &self.rotation {
            return Pose::from_rows(rows, &p);
        }
        let down = Pose::from_rows(&[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], &p);
        let turn = rotation_z(self.yaw_deg.to_radians())
            * rotation_y(self.pitch_deg.to_radians())
            * rotation_x(self.roll_deg.to_radians());
        Pose::new(turn * down.rotation, down.translation)
    }

    fn check(&self) -> Result<(), Invalid> {
        for (axis, value) in self.p_mm.iter().enumerate() {
            if !value.is_finite() {
                return Err(Invalid::new(
                    format!("p_mm[{axis}]"),
                    format!("is {value}"),
                    "give mm",
                ));
            }
        }
        let angles =
            [("yaw_deg", self.yaw_deg), ("pitch_deg", self.pitch_deg), ("roll_deg", self.roll_deg)];
        for (name, value) in angles {
            if value.is_nan() || value.abs() > 360.0 {
                return Err(Invalid::new(name, format!("is {value}"), "give -360 to 360 degrees"));
            }
            if self.rotation.is_some() && value != 0.0 {
                let what = "stands beside a rotation matrix";
                return Err(Invalid::new(name, what, "give either the matrix or the angles"));
            }
        }
        let Some(rows) = &self.rotation else { return Ok(()) };
        let r = self.pose().rotation;
        let unit = (r.transpose() * r).abs_diff_eq(taktil_mechanics::Pose::IDENTITY.rotation, 1e-6);
        if !(unit && r.determinant() > 0.0) {
            return Err(Invalid::new(
                "rotation",
                format!("{rows:?} is no rotation matrix"),
                "give nine numbers row by row, orthonormal to 1e-6, determinant +1",
            ));
        }
        Ok(())
    }
}

impl Move {
    fn check<const N: usize, A: Arm<N>>(&self, robot: &Robot<N, A>) -> Result<Step<N>, Invalid> {
        if let Some(t_s) = self.t_s.filter(|t_s| !(*t_s > 0.0 && *t_s <= 3600.0)) {
            return Err(Invalid::new("t_s", format!("is {t_s}"), "give more than 0, up to 3600 s"));
        }
        let goal = match (&self.joints_deg, &self.tool, &self.by_mm) {
            (Some(_), None, None) if self.straight => {
                let what = "a straight move to joint angles";
                let remedy = "give the goal as tool or by_mm, or leave `straight` out";
                return Err(Invalid::new("straight", what, remedy));
            }
            (Some(degrees), None, None) => Goal::Joints(check_joints(degrees, robot)?),
            (None, Some(tool), None) => {
                tool.check().map_err(|invalid| invalid.within("tool"))?;
                let pose = tool.pose();
                if !robot.arm.is_reachable(&pose) {
                    return Err(Invalid::new(
                        "tool",
                        format!("{:?} mm cannot be reached within the joint limits", tool.p_mm),
                        "choose a pose nearer to the arm",
                    ));
                }
                Goal::Tool(pose)
            }
            (None, None, Some(by_mm)) => {
                if let Some(axis) =
                    by_mm.iter().position(|x| x.is_nan() || x.abs() > DISPLACEMENT_MAX_MM)
                {
                    let what = format!("is {}", by_mm[axis]);
                    let remedy = format!("give -{DISPLACEMENT_MAX_MM} to {DISPLACEMENT_MAX_MM} mm");
                    return Err(Invalid::new(format!("by_mm[{axis}]"), what, remedy));
                }
                Goal::By(by_mm.map(|x| x * 1e-3))
            }
            _ => {
                let what = "has not exactly one goal";
                return Err(Invalid::new("", what, "give one of joints_deg, tool and by_mm"));
            }
        };
        Ok(Step { goal, straight: self.straight, t_s: self.t_s })
    }
}

fn check_joints<const N: usize, A: Arm<N>>(
    degrees: &[f64],
    robot: &Robot<N, A>,
) -> Result<JointVector<N>, Invalid> {
    let degrees = per_joint::<N>("joints_deg", degrees)?;
    let q = JointVector::from(degrees.map(f64::to_radians));
    for joint in 0..N {
        let (low, high) = (robot.arm.q_min()[joint], robot.arm.q_max()[joint]);
        if !(low <= q[joint] && q[joint] <= high) {
            return Err(Invalid::new(
                format!("joints_deg[{joint}]"),
                format!("{} is outside the limits of {}", degrees[joint], robot.joint_label(joint)),
                format!("give {:.1} to {:.1} degrees", low.to_degrees(), high.to_degrees()),
            ));
        }
    }
    Ok(q)
}

impl Config {
    /// The queue, checked against an arm.
    ///
    /// # Errors
    /// Too many moves; a move without exactly one goal, with an angle outside the limits, with a
    /// pose out of reach or no rotation; times that are not positive; a `t_s` below two `tau_s`; a
    /// speed outside 0 to 1; a `tau_s` in which a joint could not turn round at that speed.
    pub fn steps<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<Vec<Step<N>>, Invalid> {
        if self.moves.len() > MOVES_MAX {
            let what = format!("has {} moves", self.moves.len());
            return Err(Invalid::new("moves", what, format!("give at most {MOVES_MAX}")));
        }
        if !(self.speed > 0.0 && self.speed <= 1.0) {
            let what = format!("{} is no share of the largest speed", self.speed);
            return Err(Invalid::new("speed", what, "give more than 0 and at most 1"));
        }
        let positive = [
            ("line_mm_s", self.line_mm_s, 2000.0),
            ("turn_deg_s", self.turn_deg_s, 720.0),
            ("path_error_max_mm", self.path_error_max_mm, 100.0),
            ("path_error_max_deg", self.path_error_max_deg, 90.0),
        ];
        for (name, value, most) in positive {
            if !(value > 0.0 && value <= most) {
                let remedy = format!("give more than 0 and at most {most}");
                return Err(Invalid::new(name, format!("is {value}"), remedy));
            }
        }
        // At a via point a joint may turn round: 3/4 of twice its speed over tau.
        let turn_round = robot.arm.speed_max().component_div(robot.arm.acceleration_max()).max();
        let shortest = 1.5 * self.speed * turn_round;
        if !(self.tau_s >= shortest && self.tau_s <= 60.0) {
            return Err(Invalid::new(
                "tau_s",
                format!("{} s does not suit a speed of {}", self.tau_s, self.speed),
                format!("give {shortest:.4} to 60 s, or less speed"),
            ));
        }
        let mut steps = Vec::with_capacity(self.moves.len());
        for (index, one) in self.moves.iter().enumerate() {
            let place = format!("moves[{index}]");
            steps.push(self.step(one, robot).map_err(|invalid| invalid.within(&place))?);
        }
        Ok(steps)
    }

    /// One move, checked against an arm; whether it can be made from where the arm is then is found
    /// out on the way.
    ///
    /// # Errors
    /// As [`Config::steps`].
    pub fn step<const N: usize, A: Arm<N>>(
        &self,
        one: &Move,
        robot: &Robot<N, A>,
    ) -> Result<Step<N>, Invalid> {
        let step = one.check(robot)?;
        if let Some(t_s) = step.t_s.filter(|t_s| *t_s < 2.0 * self.tau_s) {
            let what = format!("{t_s} s leaves no room for two transitions of {} s", self.tau_s);
            return Err(Invalid::new("t_s", what, "give at least 2 tau_s"));
        }
        Ok(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tool(p_mm: [f64; 3]) -> ToolGoal {
        ToolGoal { p_mm, rotation: None, yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 0.0 }
    }

    fn to_tool(tool: ToolGoal) -> Config {
        let one =
            Move { joints_deg: None, tool: Some(tool), by_mm: None, straight: false, t_s: None };
        Config { moves: vec![one], ..Config::default() }
    }

    fn to_joints(joints_deg: [f64; 6]) -> Config {
        let one = Move {
            joints_deg: Some(joints_deg.to_vec()),
            tool: None,
            by_mm: None,
            straight: false,
            t_s: None,
        };
        Config { moves: vec![one], ..Config::default() }
    }

    fn check(config: &Config) -> Result<(), Invalid> {
        config.steps(&Robot::puma260()).map(|_| ())
    }

    fn place(config: &Config) -> String {
        check(config).unwrap_err().place
    }

    #[test]
    fn sound_queues_are_taken() {
        assert_eq!(check(&Config::default()), Ok(()));
        assert_eq!(check(&to_tool(tool([342.0, -127.0, -149.0]))), Ok(()));
        assert_eq!(check(&to_joints([0.0, 40.0, -153.0, -180.0, 67.0, 180.0])), Ok(()));
    }

    #[test]
    fn the_nominal_sensor_looks_down_and_turns_about_the_base_axes() {
        let rows = tool([1.0, 2.0, 3.0]).pose().rotation_rows();
        assert_eq!(rows, [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]);
        let yawed = ToolGoal { yaw_deg: 90.0, ..tool([0.0; 3]) }.pose().rotation;
        assert!((yawed.x_axis.y + 1.0).abs() < 1e-15, "x_s = -x0 turned to -y0");
        let pitched = ToolGoal { pitch_deg: 10.0, ..tool([0.0; 3]) }.pose().rotation;
        assert!(pitched.z_axis.x < -0.17 && pitched.y_axis.y > 1.0 - 1e-15);
        let rolled = ToolGoal { roll_deg: 10.0, ..tool([0.0; 3]) }.pose().rotation;
        assert!(rolled.z_axis.y > 0.17 && rolled.x_axis.x < -1.0 + 1e-15);
    }

    #[test]
    fn goals_that_cannot_be_reached_are_refused() {
        assert_eq!(place(&to_joints([0.0, 0.0, 0.0, 0.0, 123.0, 0.0])), "moves[0].joints_deg[4]");
        assert_eq!(place(&to_joints([f64::NAN; 6])), "moves[0].joints_deg[0]");
        assert_eq!(place(&to_tool(tool([900.0, 0.0, 0.0]))), "moves[0].tool");
        assert_eq!(place(&to_tool(tool([0.0, f64::NAN, 0.0]))), "moves[0].tool.p_mm[1]");
        let angle = ToolGoal { pitch_deg: f64::INFINITY, ..tool([342.0, -127.0, -149.0]) };
        assert_eq!(place(&to_tool(angle)), "moves[0].tool.pitch_deg");
    }

    #[test]
    fn rotations_must_be_rotations() {
        let with = |rotation: [f64; 9]| {
            to_tool(ToolGoal { rotation: Some(rotation), ..tool([342.0, -127.0, -149.0]) })
        };
        assert_eq!(check(&with([-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0])), Ok(()));
        for bad in [
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0],
            [0.0; 9],
            [f64::NAN; 9],
            [2.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0],
        ] {
            assert_eq!(place(&with(bad)), "moves[0].tool.rotation");
        }
        let both = ToolGoal {
            rotation: Some([-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]),
            yaw_deg: 1.0,
            ..tool([342.0, -127.0, -149.0])
        };
        assert_eq!(place(&to_tool(both)), "moves[0].tool.yaw_deg");
    }

    #[test]
    fn a_move_has_exactly_one_goal() {
        let none = Move { joints_deg: None, tool: None, by_mm: None, straight: false, t_s: None };
        let config = Config { moves: vec![none], ..Config::default() };
        assert_eq!(place(&config), "moves[0]");
        let mut both = to_tool(tool([342.0, -127.0, -149.0]));
        both.moves[0].joints_deg = Some(vec![0.0; 6]);
        assert_eq!(place(&both), "moves[0]");
        let mut by = to_joints([0.0; 6]);
        by.moves[0].by_mm = Some([0.0; 3]);
        assert_eq!(place(&by), "moves[0]");
        by.moves[0].joints_deg = None;
        assert_eq!(check(&by), Ok(()));
        by.moves[0].by_mm = Some([0.0, f64::NAN, 0.0]);
        assert_eq!(place(&by), "moves[0].by_mm[1]");
    }

    #[test]
    fn times_and_speeds_are_checked() {
        let mut config = to_joints([0.0, 40.0, -153.0, -180.0, 67.0, 180.0]);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 0.19] {
            config.moves[0].t_s = Some(bad);
            assert_eq!(place(&config), "moves[0].t_s", "{bad}");
        }
        config.moves[0].t_s = Some(0.2);
        assert_eq!(check(&config), Ok(()));
        for bad in [0.0, 1.1, f64::NAN] {
            assert_eq!(place(&Config { speed: bad, ..Config::default() }), "speed");
        }
        for bad in [0.0, 0.089, f64::NAN, f64::INFINITY] {
            assert_eq!(place(&Config { tau_s: bad, ..Config::default() }), "tau_s");
        }
        let many = vec![config.moves[0].clone(); MOVES_MAX + 1];
        assert_eq!(place(&Config { moves: many, ..Config::default() }), "moves");
    }
}
