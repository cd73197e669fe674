//! Reads the links and joints that a URDF text holds, with the defaults of the format: an origin is
//! zero, an axis is the x axis, a link without `<inertial>` has no mass, a joint without `<limit>`
//! has no speed and no effort. Shapes, colours and elements of other programs are passed over.

use std::fmt::Display;
use std::ops::Range;

use glam::{DMat3, DQuat, DVec3};
use roxmltree::{Attribute, Node};
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};
use taktil_rtcore::Invalid;

use super::size;

/// Longest name of a robot, joint or link (bytes).
const NAME_BYTES_MAX: usize = 256;
/// The version from which an origin may hold a quaternion.
const VERSION_OF_QUATERNIONS: Version = Version { major: 1, minor: 1 };
/// The version from which a limit may hold an acceleration, and what it leaves out is no limit.
const VERSION_OF_ACCELERATIONS: Version = Version { major: 1, minor: 2 };

/// What a text holds.
pub(super) struct Document {
    /// Name of the robot.
    pub(super) name: String,
    /// The links in the order of the file.
    pub(super) links: Vec<Link>,
    /// The joints in the order of the file.
    pub(super) joints: Vec<Joint>,
}

/// A rigid part.
pub(super) struct Link {
    /// Its name.
    pub(super) name: String,
    /// Bytes of the text that name it.
    span: Range<usize>,
    /// Mass (kg).
    pub(super) mass_kg: f64,
    /// Frame of the inertia in the frame of the link; its origin is the centre of mass.
    pub(super) inertial_frame: Pose,
    /// Moments about the centre of mass.
    pub(super) inertia: Inertia,
}

/// Moments and products of inertia (kg m^2).
#[derive(Clone, Copy, Default)]
pub(super) struct Inertia {
    pub(super) ixx: f64,
    pub(super) ixy: f64,
    pub(super) ixz: f64,
    pub(super) iyy: f64,
    pub(super) iyz: f64,
    pub(super) izz: f64,
}

/// How a joint moves.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum JointType {
    /// Turns between two ends.
    Revolute,
    /// Turns without ends.
    Continuous,
    /// Slides between two ends.
    Prismatic,
    /// Does not move.
    Fixed,
    /// Moves in several directions at once: `floating`, `planar` or `spherical`.
    Several,
}

/// What connects two links.
pub(super) struct Joint {
    /// Its name.
    pub(super) name: String,
    /// Bytes of the text that name it.
    span: Range<usize>,
    /// How it moves.
    pub(super) kind: JointType,
    /// Its frame in the frame of the parent link.
    pub(super) origin: Pose,
    /// Name of the link nearer to the base.
    pub(super) parent: String,
    /// Name of the link that it carries.
    pub(super) child: String,
    /// Direction of its motion in its own frame, of any length.
    pub(super) axis: DVec3,
    /// How far and how fast it may move.
    pub(super) limit: Limit,
    /// Whether it follows another joint.
    pub(super) is_mimic: bool,
}

/// How far and how fast a joint may move (rad or m); infinite where there is no limit.
#[derive(Default)]
pub(super) struct Limit {
    pub(super) lower: f64,
    pub(super) upper: f64,
    pub(super) effort: f64,
    pub(super) velocity: f64,
    /// `None` where the file gives none.
    pub(super) acceleration: Option<f64>,
}

/// A complaint about some bytes of the text.
pub(super) struct Malformed {
    /// The bytes.
    pub(super) span: Range<usize>,
    /// The line of the first of them, from 1.
    pub(super) line: u32,
    /// Place, finding and remedy; the place is the name of the joint or link around them.
    pub(super) invalid: Invalid,
}

/// The number behind `version=`. A text without it, or with something else than two numbers there,
/// is of version 1.0.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Version {
    major: u32,
    minor: u32,
}

impl Document {
    /// Reads a text.
    ///
    /// # Errors
    /// What is no XML, no URDF or xacro; numbers that are none, and what URDF demands and is not
    /// there.
    pub(super) fn parse(text: &str) -> Result<Document, Malformed> {
        size::check(text).map_err(|excess| {
            let line =
                1 + text.as_bytes()[..excess.span.start].iter().filter(|b| **b == b'\n').count();
            let line = u32::try_from(line).unwrap_or(u32::MAX);
            let remedy = "leave out what is no link and no joint";
            Malformed { span: excess.span, line, invalid: Invalid::new("", excess.what, remedy) }
        })?;
        let tree = roxmltree::Document::parse(text).map_err(|error| {
            let what = format!("is no URDF: {error}");
            let line = error.pos().row;
            let above = text.split_inclusive('\n').take(line.saturating_sub(1) as usize);
            let start = above.map(str::len).sum();
            let span = start..start + text[start..].lines().next().map_or(0, str::len);
            let invalid = Invalid::new("", what, "name a robot description in XML");
            Malformed { span, line, invalid }
        })?;
        let robot = tree.root_element();
        let macros = |node: &Node| {
            node.is_element() && node.tag_name().namespace().is_some_and(|at| at.contains("xacro"))
        };
        if let Some(node) = robot.descendants().find(macros) {
            let what = format!("`xacro:{}` is a macro of xacro", node.tag_name().name());
            return Err(complaint(node, what, "name what `xacro` makes of this file"));
        }
        if robot.tag_name().name() != "robot" {
            let what = format!("is no URDF: it begins with <{}>", robot.tag_name().name());
            return Err(complaint(
                robot,
                what,
                "name a robot description that begins with <robot>",
            ));
        }
        let version = Version::of_robot(robot);
        let (mut links, mut joints) = (Vec::new(), Vec::new());
        for node in robot.children() {
            match node.tag_name().name() {
                "link" => links.push(link(node, version)?),
                "joint" => joints.push(joint(node, version)?),
                _ => {}
            }
        }
        let name = match robot.attribute_node("name") {
            Some(name) => short_name(robot, &name)?,
            None => String::new(),
        };
        Ok(Document { name, links, joints })
    }

    /// The bytes that name a joint or a link.
    pub(super) fn span(&self, name: &str) -> Option<Range<usize>> {
        let joint = self.joints.iter().find(|joint| joint.name == name).map(|joint| &joint.span);
        let link = || self.links.iter().find(|link| link.name == name).map(|link| &link.span);
        joint.or_else(link).cloned()
    }
}

impl Version {
    fn of_robot(robot: Node) -> Version {
        let parts = robot.attribute("version").and_then(|text| text.trim().split_once('.'));
        let version = parts.and_then(|(major, minor)| {
            Some(Version { major: major.parse().ok()?, minor: minor.parse().ok()? })
        });
        version.unwrap_or(Version { major: 1, minor: 0 })
    }
}

impl From<Malformed> for Invalid {
    fn from(malformed: Malformed) -> Invalid {
        let Malformed { line, invalid, .. } = malformed;
        Invalid::new(invalid.place, format!("line {line}: {}", invalid.what), invalid.remedy)
    }
}

/// A complaint about an element.
fn complaint(node: Node, what: impl Display, remedy: &str) -> Malformed {
    // An element is marked by its first characters, without what it holds.
    let start = node.range().start;
    let end = start + 1 + node.tag_name().name().len();
    complaint_at(node, start..end, what, remedy)
}

/// A complaint about some bytes of an element; the place is the joint or link around it.
fn complaint_at(node: Node, span: Range<usize>, what: impl Display, remedy: &str) -> Malformed {
    let named =
        node.ancestors().find(|around| ["link", "joint"].contains(&around.tag_name().name()));
    let place = named.and_then(|around| around.attribute("name")).unwrap_or_default();
    let line = node.document().text_pos_at(span.start).row;
    Malformed { span, line, invalid: Invalid::new(place, what.to_string(), remedy) }
}

/// The only element of a name below another one.
fn child<'a, 'text>(
    node: Node<'a, 'text>,
    name: &str,
) -> Result<Option<Node<'a, 'text>>, Malformed> {
    let mut found = node.children().filter(|below| below.tag_name().name() == name);
    let first = found.next();
    match found.next() {
        None => Ok(first),
        Some(second) => Err(complaint(second, format!("a second <{name}>"), "leave one")),
    }
}

/// An element that URDF demands.
fn demanded_child<'a, 'text>(
    node: Node<'a, 'text>,
    name: &str,
) -> Result<Node<'a, 'text>, Malformed> {
    child(node, name)?.ok_or_else(|| {
        complaint(node, format!("has no <{name}>"), "add it; the URDF format demands it")
    })
}

/// An attribute that URDF demands.
fn demanded<'a, 'text>(
    node: Node<'a, 'text>,
    name: &str,
) -> Result<Attribute<'a, 'text>, Malformed> {
    node.attribute_node(name).ok_or_else(|| {
        let what = format!("<{}> has no `{name}`", node.tag_name().name());
        complaint(node, what, "add it; the URDF format demands it")
    })
}

/// The value of an attribute that is a name.
fn short_name(node: Node, attribute: &Attribute) -> Result<String, Malformed> {
    let name = attribute.value();
    if name.len() > NAME_BYTES_MAX {
        let what = format!("`{}` has {} bytes", attribute.name(), name.len());
        let remedy = format!("give a name of at most {NAME_BYTES_MAX} bytes");
        return Err(complaint_at(node, attribute.range(), what, &remedy));
    }
    Ok(name.to_owned())
}

/// As many numbers as the attribute has to hold.
fn numbers<const N: usize>(node: Node, attribute: Attribute) -> Result<[f64; N], Malformed> {
    let numbers: Result<Vec<f64>, _> =
        attribute.value().split_whitespace().map(str::parse).collect();
    let numbers = numbers.ok().and_then(|numbers| <[f64; N]>::try_from(numbers).ok());
    numbers.ok_or_else(|| {
        let wanted = if N == 1 { "a number".to_owned() } else { format!("{N} numbers") };
        let what = format!("`{}` is \"{}\"", attribute.name(), attribute.value());
        complaint_at(node, attribute.range(), what, &format!("give {wanted}"))
    })
}

/// The number of an attribute that URDF demands.
fn demanded_number(node: Node, name: &str) -> Result<f64, Malformed> {
    numbers::<1>(node, demanded(node, name)?).map(|[number]| number)
}

/// The number of an attribute, `None` where it is absent.
fn number(node: Node, name: &str) -> Result<Option<f64>, Malformed> {
    let Some(attribute) = node.attribute_node(name) else { return Ok(None) };
    numbers::<1>(node, attribute).map(|[number]| Some(number))
}

/// The three numbers of an attribute, zero where it is absent.
fn vector(node: Node, name: &str) -> Result<DVec3, Malformed> {
    let Some(attribute) = node.attribute_node(name) else { return Ok(DVec3::ZERO) };
    numbers::<3>(node, attribute).map(DVec3::from_array)
}

/// The frame that `<origin>` gives.
fn origin(node: Node, version: Version) -> Result<Pose, Malformed> {
    let Some(origin) = child(node, "origin")? else { return Ok(pose(DVec3::ZERO, DVec3::ZERO)) };
    let translation = vector(origin, "xyz")?;
    let Some(quaternion) = origin.attribute_node("quat_xyzw") else {
        return Ok(pose(translation, vector(origin, "rpy")?));
    };
    // The format ignores quaternions in files of older versions: the arm would be another one.
    if version < VERSION_OF_QUATERNIONS {
        let what = "gives `quat_xyzw`, which URDF knows from version 1.1 on";
        let remedy = "write <robot name=... version=\"1.1\">, or give `rpy`";
        return Err(complaint_at(origin, quaternion.range(), what, remedy));
    }
    if origin.has_attribute("rpy") {
        let what = "an orientation as `rpy` and as `quat_xyzw`";
        return Err(complaint_at(origin, quaternion.range(), what, "leave one of them out"));
    }
    let given = DQuat::from_array(numbers::<4>(origin, quaternion)?);
    let length = given.length();
    if !(length.is_finite() && length > 0.0) {
        let what = format!("`quat_xyzw` has the length {length}, which is no orientation");
        return Err(complaint_at(
            origin,
            quaternion.range(),
            what,
            "give a quaternion of length 1",
        ));
    }
    Ok(Pose::new(DMat3::from_quat(given.normalize()), translation))
}

/// The frame of a translation and of turns about the fixed axes x, y and z, in this order (rad).
fn pose(translation: DVec3, roll_pitch_yaw: DVec3) -> Pose {
    let DVec3 { x: roll, y: pitch, z: yaw } = roll_pitch_yaw;
    let rotation = rotation_z(yaw) * rotation_y(pitch) * rotation_x(roll);
    Pose::new(rotation, translation)
}

fn link(node: Node, version: Version) -> Result<Link, Malformed> {
    let name = demanded(node, "name")?;
    let mut link = Link {
        name: short_name(node, &name)?,
        span: name.range(),
        mass_kg: 0.0,
        inertial_frame: pose(DVec3::ZERO, DVec3::ZERO),
        inertia: Inertia::default(),
    };
    if let Some(inertial) = child(node, "inertial")? {
        let inertia = demanded_child(inertial, "inertia")?;
        let moment = |name: &str| demanded_number(inertia, name);
        link.mass_kg = demanded_number(demanded_child(inertial, "mass")?, "value")?;
        link.inertial_frame = origin(inertial, version)?;
        link.inertia = Inertia {
            ixx: moment("ixx")?,
            ixy: moment("ixy")?,
            ixz: moment("ixz")?,
            iyy: moment("iyy")?,
            iyz: moment("iyz")?,
            izz: moment("izz")?,
        };
    }
    Ok(link)
}

fn joint(node: Node, version: Version) -> Result<Joint, Malformed> {
    let name = demanded(node, "name")?;
    let kind = demanded(node, "type")?;
    let end = |name: &str| demanded(demanded_child(node, name)?, "link").map(|end| end.value());
    Ok(Joint {
        name: short_name(node, &name)?,
        span: name.range(),
        kind: match kind.value() {
            "revolute" => JointType::Revolute,
            "continuous" => JointType::Continuous,
            "prismatic" => JointType::Prismatic,
            "fixed" => JointType::Fixed,
            "floating" | "planar" | "spherical" => JointType::Several,
            unknown => {
                let what = format!("there is no type of joint `{unknown}`");
                let remedy = "give revolute, continuous, prismatic or fixed";
                return Err(complaint_at(node, kind.range(), what, remedy));
            }
        },
        origin: origin(node, version)?,
        parent: end("parent")?.to_owned(),
        child: end("child")?.to_owned(),
        axis: match child(node, "axis")? {
            Some(axis) => DVec3::from_array(numbers(axis, demanded(axis, "xyz")?)?),
            None => DVec3::X,
        },
        limit: match child(node, "limit")? {
            Some(element) => limit(element, version)?,
            None => Limit::default(),
        },
        is_mimic: child(node, "mimic")?.is_some(),
    })
}

fn limit(node: Node, version: Version) -> Result<Limit, Malformed> {
    if version < VERSION_OF_ACCELERATIONS {
        if let Some(acceleration) = node.attribute_node("acceleration") {
            let what = "gives accelerations, which URDF knows from version 1.2 on";
            let remedy = "write <robot name=... version=\"1.2\">";
            return Err(complaint_at(node, acceleration.range(), what, remedy));
        }
        return Ok(Limit {
            lower: number(node, "lower")?.unwrap_or(0.0),
            upper: number(node, "upper")?.unwrap_or(0.0),
            effort: number(node, "effort")?.unwrap_or(0.0),
            velocity: demanded_number(node, "velocity")?,
            acceleration: None,
        });
    }
    let sizes = ["effort", "velocity", "acceleration", "deceleration", "jerk"];
    for name in ["lower", "upper"].into_iter().chain(sizes) {
        let Some(attribute) = node.attribute_node(name) else { continue };
        let [value] = numbers(node, attribute)?;
        if value.is_nan() || (value < 0.0 && sizes.contains(&name)) {
            let what = format!("`{name}` is {value}");
            return Err(complaint_at(node, attribute.range(), what, "give a number, or none"));
        }
    }
    let limit = Limit {
        lower: number(node, "lower")?.unwrap_or(f64::NEG_INFINITY),
        upper: number(node, "upper")?.unwrap_or(f64::INFINITY),
        effort: number(node, "effort")?.unwrap_or(f64::INFINITY),
        velocity: number(node, "velocity")?.unwrap_or(f64::INFINITY),
        acceleration: number(node, "acceleration")?.filter(|acceleration| acceleration.is_finite()),
    };
    if limit.upper < limit.lower {
        let what =
            format!("its lower limit {} is not below the upper {}", limit.lower, limit.upper);
        return Err(complaint(node, what, "exchange them"));
    }
    Ok(limit)
}
