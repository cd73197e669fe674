//! Reads arms from URDF files: the serial chain from the base to a tip, with the bodies that are
//! fixed to it. Files are parsed at load; what runs is a [`Chain`] of fixed size. Joints beside or
//! behind the chain are held at a place that the caller gives, with the bodies behind them welded
//! there. Errors are: a tip that is not clear, names that occur twice or are missing, links without
//! a parent, joints that move beside or behind the chain and are not held, joints of the chain that
//! mimic others or move in several directions. Shapes, colours and safety controllers are not read.

mod document;
mod hold;
mod markup;
mod size;
mod tree;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, JointKind, JointSpec};
use taktil_mechanics::rigid_body::Body;
use taktil_rtcore::Invalid;

use self::document::{Document, Inertia, Joint, JointType, Link};
use self::hold::Holder;
use self::tree::Tree;
use crate::source::{FileKind, Located, Source};

/// Time in which a joint gets to its speed where the file gives no acceleration (s).
pub(crate) const ACCELERATION_TIME_S: f64 = 0.2;
/// No link is heavier (kg).
const LINK_MASS_MAX_KG: f64 = 1e5;
/// A joint without ends may turn so often either way (rad): more than any run turns it.
pub const CONTINUOUS_ANGLE_MAX_RAD: f64 = 1e6;
/// More than that is no turning joint with ends but one that was given in degrees (rad).
const REVOLUTE_ANGLE_MAX_RAD: f64 = 62.9;
/// What files round off their inertias, in parts of the largest moment.
const INERTIA_ROUNDING_MAX: f64 = 1e-4;
/// The same for the moments of flat and thin bodies, of which one is the sum of the others.
const TRIANGLE_INEQUALITY_TOLERANCE: f64 = 0.05;

/// Stands for a speed, an acceleration or an effort that nothing limits (rad/s, rad/s^2, N m): more
/// than any joint has.
pub const UNBOUNDED_LIMIT: f64 = 1e9;

/// What of a file is wanted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// The link at the end of the chain; needed where there are several ends.
    pub tip: Option<String>,
    /// Joints that do not move, and where they stay (rad or m, in the joint's own direction).
    pub hold: BTreeMap<String, f64>,
    /// Whether joints beside or behind the chain that `hold` does not name stay at the place
    /// nearest to zero within their limits. Otherwise they are errors.
    pub hold_others: bool,
    /// Joints behind which nothing is carried: those of fingers that have chains of their own.
    pub left_out: BTreeSet<String>,
}

impl Selection {
    /// The chain to this tip, nothing held.
    #[must_use]
    pub fn to(tip: Option<&str>) -> Selection {
        Selection { tip: tip.map(str::to_owned), ..Selection::default() }
    }
}

/// What a file does not say of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lacks {
    /// The lower and the upper end of its range.
    pub range: bool,
    /// Its largest speed.
    pub speed: bool,
    /// Its largest torque or force.
    pub effort: bool,
}

/// Whether something is lacking.
pub type IsLacking = fn(&Lacks) -> bool;

/// A joint that does not move.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldJoint {
    /// Its name.
    pub name: String,
    /// Where it stays (rad or m).
    pub at: f64,
}

/// A serial chain as a file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDescription {
    /// Name of the robot.
    pub name: String,
    /// Names of the moving joints, base first.
    pub names: Vec<String>,
    /// The joints with the bodies that they carry. What the file does not say is wide: a turn of
    /// [`CONTINUOUS_ANGLE_MAX_RAD`] either way, speed and effort [`UNBOUNDED_LIMIT`].
    pub joints: Vec<JointSpec>,
    /// What the file does not say of each of them.
    pub lacks: Vec<Lacks>,
    /// Joints that are held, in the order of the file.
    pub held: Vec<HeldJoint>,
    /// Links behind the first joint for which the file gives no mass, in the order of the file.
    pub massless: Vec<String>,
    /// What was passed over although it says something about motion, in words.
    pub notes: Vec<String>,
    /// Why the torques of the arm would be wrong: each is an error for whoever moves it.
    pub unsound: Vec<Invalid>,
    /// Name of the tip.
    pub tip: String,
    /// Its frame in the frame of the last joint.
    pub tool: Pose,
}

impl ArmDescription {
    /// The chain of so many joints, to be moved.
    ///
    /// # Errors
    /// As [`ArmDescription::kinematic_chain`], and inertias that no body has.
    pub fn chain<const N: usize>(&self) -> Result<Chain<N>, Invalid> {
        match self.unsound.first() {
            Some(unsound) => Err(unsound.clone()),
            None => self.kinematic_chain(),
        }
    }

    /// The chain of so many joints, of which only frames, and torques at rest, are asked.
    ///
    /// # Errors
    /// Another number of joints, or what [`Chain::new`] refuses; the place is the joint's name.
    pub fn kinematic_chain<const N: usize>(&self) -> Result<Chain<N>, Invalid> {
        let Ok(joints) = <&[JointSpec; N]>::try_from(self.joints.as_slice()) else {
            let what = format!("{} moving joints on the way to `{}`", self.joints.len(), self.tip);
            return Err(Invalid::new("", what, format!("name an arm of {N} joints")));
        };
        Chain::new(joints, &self.tool).map_err(|bad| {
            let place = self.names.get(bad.joint).map_or(self.tip.as_str(), String::as_str);
            Invalid::new(place, bad.what, "correct the joint or the link behind it")
        })
    }
}

impl ArmDescription {
    /// The joints of which the file does not say something.
    pub fn lacking(&self, what: IsLacking) -> Vec<&str> {
        let joints = self.names.iter().zip(&self.lacks);
        joints.filter(|(_, lacks)| what(lacks)).map(|(name, _)| name.as_str()).collect()
    }

    /// What is held, what was passed over, and what a machine file has to add for motion, a line
    /// each.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if !self.held.is_empty() {
            let held: Vec<String> =
                self.held.iter().map(|joint| format!("{} at {}", joint.name, joint.at)).collect();
            lines.push(format!("held (rad or m): {}", held.join(", ")));
        }
        lines.extend(self.notes.iter().map(|note| format!("note: {note}")));
        let unsound = self.unsound.iter();
        lines.extend(unsound.map(|bad| format!("not to be moved: `{}`: {}", bad.place, bad.what)));
        let unknown: [(IsLacking, &str); 3] = [
            (|lacks| lacks.range, "no range is given, to move it needs `[arm] limits_deg`"),
            (|lacks| lacks.speed, "no speed is given, to move it needs `[arm] speed_deg_s`"),
            (
                |lacks| lacks.effort,
                "no effort is given, motor and gear alone limit the torque, or `[arm] effort_nm`",
            ),
        ];
        for (what, says) in unknown {
            let names = self.lacking(what);
            if !names.is_empty() {
                lines.push(format!("{says}: {}", names.join(", ")));
            }
        }
        let carried: f64 = self.joints.iter().map(|joint| joint.body.mass_kg).sum();
        if carried == 0.0 {
            lines.push("no masses are given: gravity and inertia are not known".to_owned());
        } else if !self.massless.is_empty() {
            lines.push(format!("links without mass: {}", self.massless.join(", ")));
        }
        lines
    }
}

/// Reads a file.
///
/// # Errors
/// What the file lacks, at the line of the joint or link where there is one.
pub fn load(path: &Path, selection: &Selection) -> Result<ArmDescription, Located> {
    let source = Source::read(path, FileKind::Arm)?;
    read(&source.text, selection).map_err(|invalid| locate(&source, invalid))
}

/// Puts a complaint of [`read`] or of a chain from it at its place in the text: where a text is
/// malformed, else where the joint or link that is the complaint's place has its name.
#[must_use]
pub fn locate(source: &Source, invalid: Invalid) -> Located {
    let (span, invalid) = match Document::parse(&source.text) {
        Ok(document) => (document.span(&invalid.place), invalid),
        Err(malformed) => (Some(malformed.span), malformed.invalid),
    };
    let Invalid { place, what, remedy } = invalid;
    let mark = span.map(|span| source.mark(&span));
    let what = if place.is_empty() { what } else { format!("`{place}`: {what}") };
    Located { path: source.path.clone(), mark, what, remedy }
}

/// The chain that a text describes.
///
/// # Errors
/// The place is the name of the joint or link, empty for the whole.
pub fn read(text: &str, selection: &Selection) -> Result<ArmDescription, Invalid> {
    let mut robot = Document::parse(text)?;
    let held = Holder::new(&robot, selection)?.hold(&mut robot);
    let tree = Tree::new(&robot)?;
    let tip = tree.tip(selection.tip.as_deref())?.to_owned();
    let way = tree.joints_to(&tip);
    let (mut names, mut joints, mut lacks) = (Vec::new(), Vec::<JointSpec>::new(), Vec::new());
    let mut mount = Pose::IDENTITY;
    for joint in &way {
        mount = mount.compose(&joint.origin);
        if joint.kind == JointType::Fixed {
            continue;
        }
        names.push(joint.name.clone());
        let (spec, lack) = joint_spec(joint, &mount)?;
        joints.push(spec);
        lacks.push(lack);
        mount = Pose::IDENTITY;
    }
    let mut unsound = Vec::new();
    let massless = carry_links(&robot, &tree, &names, &mut joints, &mut unsound, selection, &tip)?;
    if joints.is_empty() {
        let what = format!("no moving joint on the way to `{tip}`");
        return Err(Invalid::new("", what, "name another tip"));
    }
    let (name, notes) = (robot.name, robot.notes);
    let tool = mount;
    Ok(ArmDescription { name, names, joints, lacks, held, massless, notes, unsound, tip, tool })
}

/// The names of all joints of a text, in its order.
///
/// # Errors
/// As [`read`].
pub fn joint_names(text: &str) -> Result<Vec<String>, Invalid> {
    Ok(Document::parse(text)?.joints.into_iter().map(|joint| joint.name).collect())
}

/// The link from which a joint of a text starts, by the joint's name; `None` where it has no such
/// joint.
///
/// # Errors
/// As [`read`].
pub fn link_before(text: &str, joint: &str) -> Result<Option<String>, Invalid> {
    let joints = Document::parse(text)?.joints;
    Ok(joints.into_iter().find(|other| other.name == joint).map(|other| other.parent))
}

/// The names of all links of a text, in its order.
///
/// # Errors
/// As [`read`].
pub fn link_names(text: &str) -> Result<Vec<String>, Invalid> {
    Ok(Document::parse(text)?.links.into_iter().map(|link| link.name).collect())
}

/// Adds the body of each link to the joint that carries it; returns the links without a mass.
fn carry_links(
    robot: &Document,
    tree: &Tree,
    names: &[String],
    joints: &mut [JointSpec],
    unsound: &mut Vec<Invalid>,
    selection: &Selection,
    tip: &str,
) -> Result<Vec<String>, Invalid> {
    let moving: BTreeMap<&str, usize> =
        names.iter().enumerate().map(|(index, name)| (name.as_str(), index)).collect();
    let mut massless = Vec::new();
    for (index, link) in robot.links.iter().enumerate() {
        if tree.is_behind(index, &selection.left_out) {
            continue;
        }
        let (carrier, at) = tree.moving_parent(index);
        let Some(carrier) = carrier else { continue };
        let Some(index) = moving.get(carrier).copied() else {
            let what = format!("moves beside or behind the way to `{tip}`");
            let remedy = "hold it (`[arm.hold]` or `hold_others` in a machine file, --hold \
                          JOINT=PLACE), make it fixed, or name another tip";
            return Err(Invalid::new(carrier, what, remedy));
        };
        let body = link_body(link).expressed_in(&at);
        if !(0.0..=LINK_MASS_MAX_KG).contains(&body.mass_kg) {
            let what = format!("a mass of {} kg", body.mass_kg);
            return Err(Invalid::new(&link.name, what, "give 0 to 100 t"));
        }
        if !is_physical_inertia(&link.inertia) {
            let what = "its inertia is no body's: the moment about some axis would be negative, \
                        or larger than the sum of the two others";
            let remedy = "give the moments about its centre of mass";
            unsound.push(Invalid::new(&link.name, what, remedy));
        }
        if body.mass_kg > 0.0 {
            joints[index].body = body.combine(&joints[index].body);
        } else {
            massless.push(link.name.clone());
        }
    }
    Ok(massless)
}

/// The body of a link in the frame of the link.
fn link_body(link: &Link) -> Body {
    let i = &link.inertia;
    let own = Body {
        mass_kg: link.mass_kg,
        com_m: DVec3::ZERO,
        inertia_kg_m2: glam::DMat3::from_cols(
            DVec3::new(i.ixx, i.ixy, i.ixz),
            DVec3::new(i.ixy, i.iyy, i.iyz),
            DVec3::new(i.ixz, i.iyz, i.izz),
        ),
    };
    own.expressed_in(&link.inertial_frame)
}

/// Whether the tensor is that of some body: no axis has a negative moment, nor one that is larger
/// than the sum of the two others. What is not finite is for the chain to refuse.
fn is_physical_inertia(i: &Inertia) -> bool {
    let half = 0.5 * (i.ixx + i.iyy + i.izz);
    let spread = Inertia {
        ixx: half * (1.0 + TRIANGLE_INEQUALITY_TOLERANCE) - i.ixx,
        iyy: half * (1.0 + TRIANGLE_INEQUALITY_TOLERANCE) - i.iyy,
        izz: half * (1.0 + TRIANGLE_INEQUALITY_TOLERANCE) - i.izz,
        ixy: -i.ixy,
        ixz: -i.ixz,
        iyz: -i.iyz,
    };
    is_positive_semidefinite(i) && is_positive_semidefinite(&spread)
}

/// All principal minors of a symmetric tensor, to rounding.
fn is_positive_semidefinite(i: &Inertia) -> bool {
    let size = [i.ixx, i.iyy, i.izz, i.ixy, i.ixz, i.iyz]
        .into_iter()
        .fold(0.0, |a: f64, b| a.max(b.abs()));
    let unit = |x: f64| if size > 0.0 { x / size } else { 0.0 };
    let [xx, yy, zz] = [i.ixx, i.iyy, i.izz].map(unit);
    let [xy, xz, yz] = [i.ixy, i.ixz, i.iyz].map(unit);
    let minors = [
        xx,
        yy,
        zz,
        xx * yy - xy * xy,
        xx * zz - xz * xz,
        yy * zz - yz * yz,
        xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz),
    ];
    minors.into_iter().all(|minor| minor.is_nan() || minor >= -INERTIA_ROUNDING_MAX)
}

fn joint_spec(joint: &Joint, mount: &Pose) -> Result<(JointSpec, Lacks), Invalid> {
    let refuse = |what: &str, remedy: &str| Err(Invalid::new(&joint.name, what, remedy));
    let motion = match joint.kind {
        JointType::Revolute | JointType::Continuous => JointKind::Revolute,
        JointType::Prismatic => JointKind::Prismatic,
        _ => {
            return refuse(
                "is neither revolute, continuous, prismatic nor fixed",
                "describe it by joints of these kinds, or hold it at 0",
            );
        }
    };
    if let Some(mimic) = &joint.mimic {
        let what = format!("mimics another joint, `{}`", mimic.joint);
        return refuse(&what, "an arm's joints move by themselves: hold it, or name another tip");
    }
    let limit = &joint.limit;
    let endless = joint.kind == JointType::Continuous;
    let farthest = limit.range.map_or(0.0, |[lower, upper]| lower.abs().max(upper.abs()));
    if motion == JointKind::Revolute && !endless && farthest > REVOLUTE_ANGLE_MAX_RAD {
        return refuse(
            "its limits are more than ten turns either way",
            "give radians, not degrees, or call it continuous",
        );
    }
    if limit.acceleration.is_some_and(|acceleration| acceleration <= 0.0) {
        return refuse("has an acceleration of 0", "give more than 0, or leave it out");
    }
    let wide = [-CONTINUOUS_ANGLE_MAX_RAD, CONTINUOUS_ANGLE_MAX_RAD];
    let [q_min, q_max] = limit.range.filter(|_| !endless).unwrap_or(wide);
    let speed_max = limit.velocity.unwrap_or(UNBOUNDED_LIMIT);
    let acceleration = (speed_max / ACCELERATION_TIME_S).min(UNBOUNDED_LIMIT);
    let spec = JointSpec {
        origin: *mount,
        axis: joint.axis,
        kind: motion,
        q_min,
        q_max,
        speed_max,
        acceleration_max: limit.acceleration.unwrap_or(acceleration),
        effort_max: limit.effort.unwrap_or(UNBOUNDED_LIMIT),
        ..JointSpec::default()
    };
    let lacks = Lacks {
        range: limit.range.is_none() && !endless,
        speed: limit.velocity.is_none(),
        effort: limit.effort.is_none(),
    };
    Ok((spec, lacks))
}
