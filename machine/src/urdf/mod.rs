//! Reads arms from URDF files: the serial chain from the base to a tip, with the bodies that are
//! fixed to it. Files are parsed at load; what runs is a [`Chain`] of fixed size. Errors are: a tip
//! that is not clear, names that occur twice or are missing, links without a parent, joints that
//! move beside or behind the chain, mimicking joints, and joints other than revolute, continuous
//! and prismatic. Shapes, colours and safety controllers are not read.

mod document;
mod size;
mod tree;

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, JointKind, JointSpec};
use taktil_mechanics::rigid_body::Body;
use taktil_rtcore::Invalid;

use self::document::{Document, Inertia, Joint, JointType, Link};
use self::tree::Tree;
use crate::source::{FileKind, Located, Source};

/// Time in which a joint gets to its speed where the file gives no acceleration (s).
const ACCELERATION_TIME_S: f64 = 0.2;
/// No link is heavier (kg).
const LINK_MASS_MAX_KG: f64 = 1e5;
/// A joint without ends may turn so often either way (rad): more than any run turns it.
const CONTINUOUS_ANGLE_MAX_RAD: f64 = 1e6;
/// More than that is no turning joint with ends but one that was given in degrees (rad).
const REVOLUTE_ANGLE_MAX_RAD: f64 = 62.9;
/// What files round off their inertias, in parts of the largest moment.
const INERTIA_ROUNDING_MAX: f64 = 1e-4;
/// The same for the moments of flat and thin bodies, of which one is the sum of the others.
const TRIANGLE_INEQUALITY_TOLERANCE: f64 = 0.05;

/// A serial chain as a file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDescription {
    /// Name of the robot.
    pub name: String,
    /// Names of the moving joints, base first.
    pub names: Vec<String>,
    /// The joints with the bodies that they carry.
    pub joints: Vec<JointSpec>,
    /// Name of the tip.
    pub tip: String,
    /// Its frame in the frame of the last joint.
    pub tool: Pose,
}

impl ArmDescription {
    /// The chain of so many joints.
    ///
    /// # Errors
    /// Another number of joints, or what [`Chain::new`] refuses; the place is the joint's name.
    pub fn chain<const N: usize>(&self) -> Result<Chain<N>, Invalid> {
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

/// Reads a file; `tip` names the link at the end of the chain, needed where there are several.
///
/// # Errors
/// What the file lacks, at the line of the joint or link where there is one.
pub fn load(path: &Path, tip: Option<&str>) -> Result<ArmDescription, Located> {
    let source = Source::read(path, FileKind::Arm)?;
    read(&source.text, tip).map_err(|invalid| locate(&source, invalid))
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
pub fn read(text: &str, tip: Option<&str>) -> Result<ArmDescription, Invalid> {
    let robot = Document::parse(text)?;
    let tree = Tree::new(&robot)?;
    let tip = tree.tip(tip)?.to_owned();
    let way = tree.joints_to(&tip);
    let (mut names, mut joints) = (Vec::new(), Vec::<JointSpec>::new());
    let mut mount = Pose::IDENTITY;
    for joint in &way {
        mount = mount.compose(&joint.origin);
        if joint.kind == JointType::Fixed {
            continue;
        }
        names.push(joint.name.clone());
        joints.push(joint_spec(joint, &mount)?);
        mount = Pose::IDENTITY;
    }
    let moving: BTreeMap<&str, usize> =
        names.iter().enumerate().map(|(index, name)| (name.as_str(), index)).collect();
    for (index, link) in robot.links.iter().enumerate() {
        let (carrier, at) = tree.moving_parent(index);
        let Some(carrier) = carrier else { continue };
        let Some(index) = moving.get(carrier).copied() else {
            let what = format!("moves beside or behind the way to `{tip}`");
            return Err(Invalid::new(carrier, what, "make it fixed, or name another tip"));
        };
        let body = link_body(link).expressed_in(&at);
        if !(0.0..=LINK_MASS_MAX_KG).contains(&body.mass_kg) {
            let what = format!("a mass of {} kg", body.mass_kg);
            return Err(Invalid::new(&link.name, what, "give 0 to 100 t"));
        }
        if !is_physical_inertia(&link.inertia) {
            let what = "its inertia is no body's: the moment about some axis would be negative, \
                        or larger than the sum of the two others";
            return Err(Invalid::new(
                &link.name,
                what,
                "give the moments about its centre of mass",
            ));
        }
        if body.mass_kg > 0.0 {
            joints[index].body = body.combine(&joints[index].body);
        }
    }
    if joints.is_empty() {
        let what = format!("no moving joint on the way to `{tip}`");
        return Err(Invalid::new("", what, "name another tip"));
    }
    Ok(ArmDescription { name: robot.name, names, joints, tip, tool: mount })
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

fn joint_spec(joint: &Joint, mount: &Pose) -> Result<JointSpec, Invalid> {
    let refuse = |what: &str, remedy: &str| Err(Invalid::new(&joint.name, what, remedy));
    let motion = match joint.kind {
        JointType::Revolute | JointType::Continuous => JointKind::Revolute,
        JointType::Prismatic => JointKind::Prismatic,
        _ => {
            return refuse(
                "is neither revolute, continuous, prismatic nor fixed",
                "describe it by joints of these kinds",
            );
        }
    };
    if joint.is_mimic {
        return refuse("mimics another joint", "an arm's joints move by themselves");
    }
    let limit = &joint.limit;
    if !(limit.velocity > 0.0 && limit.effort > 0.0) {
        return refuse(
            "has no limit of speed or effort",
            "give <limit lower upper effort velocity>, effort and velocity above 0",
        );
    }
    let endless = joint.kind == JointType::Continuous;
    let farthest = limit.lower.abs().max(limit.upper.abs());
    if !endless && farthest.is_infinite() {
        return refuse("has no lower or no upper limit", "give both, or call it continuous");
    }
    if motion == JointKind::Revolute && !endless && farthest > REVOLUTE_ANGLE_MAX_RAD {
        return refuse(
            "its limits are more than ten turns either way",
            "give radians, not degrees, or call it continuous",
        );
    }
    if limit.acceleration.is_some_and(|acceleration| acceleration <= 0.0) {
        return refuse("has an acceleration of 0", "give more than 0, or leave it out");
    }
    Ok(JointSpec {
        origin: *mount,
        axis: joint.axis,
        kind: motion,
        q_min: if endless { -CONTINUOUS_ANGLE_MAX_RAD } else { limit.lower },
        q_max: if endless { CONTINUOUS_ANGLE_MAX_RAD } else { limit.upper },
        speed_max: limit.velocity,
        acceleration_max: limit.acceleration.unwrap_or(limit.velocity / ACCELERATION_TIME_S),
        effort_max: limit.effort,
        ..JointSpec::default()
    })
}
