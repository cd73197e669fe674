//! Reads the links and joints that a URDF text holds, with the defaults of the format: an origin is
//! zero, an axis is the x axis, a link without `<inertial>` has no mass; what a joint's `<limit>`
//! leaves out is not known. Shapes, colours and elements of other programs are passed over.

use std::fmt::Display;
use std::ops::Range;

use glam::{DMat3, DQuat, DVec3};
use roxmltree::{Attribute, Node};
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};
use taktil_rtcore::Invalid;

use super::{markup, size};

/// Longest name of a robot, joint or link (bytes).
const NAME_BYTES_MAX: usize = 256;
/// The version from which an origin may hold a quaternion.
const VERSION_OF_QUATERNIONS: Version = Version { major: 1, minor: 1 };
/// The version from which what a limit leaves out is no limit; before it is 0.
const VERSION_OF_OPEN_LIMITS: Version = Version { major: 1, minor: 2 };

/// What a text holds.
pub(super) struct Document {
    /// Name of the robot.
    pub(super) name: String,
    /// The links in the order of the file.
    pub(super) links: Vec<Link>,
    /// The joints in the order of the file.
    pub(super) joints: Vec<Joint>,
    /// What was passed over although it says something about motion, in words.
    pub(super) notes: Vec<String>,
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
    /// What it follows, if it follows another joint.
    pub(super) mimic: Option<Mimic>,
}

/// A joint's place as a function of another one's: `multiplier` times that plus `offset`.
pub(super) struct Mimic {
    /// Name of the joint that it follows.
    pub(super) joint: String,
    pub(super) multiplier: f64,
    /// Rad or m.
    pub(super) offset: f64,
}

/// How far and how fast a joint may move (rad or m); `None` where the file does not say. A speed or
/// an effort of 0, which many files give where none is known, says nothing.
#[derive(Default)]
pub(super) struct Limit {
    /// Lower and upper end.
    pub(super) range: Option<[f64; 2]>,
    pub(super) effort: Option<f64>,
    pub(super) velocity: Option<f64>,
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
        let tags = markup::tags_of(text);
        let tree = roxmltree::Document::parse(&tags).map_err(|error| {
            let what = format!("is no URDF: {error}");
            let line = error.pos().row;
            let above = text.split_inclusive('\n').take(line.saturating_sub(1) as usize);
            let start = above.map(str::len).sum();
            let span = start..start + text[start..].lines().next().map_or(0, str::len);
            let invalid = Invalid::new("", what, "name a robot description in XML");
            Malformed { span, line, invalid }
        })?;
        let robot = tree.root_element();
        if let Some((node, name)) =
            robot.descendants().find_map(|node| Some((node, macro_name(node)?)))
        {
            let what = format!("`xacro:{name}` is a macro of xacro");
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
        let (mut links, mut joints, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        for node in robot.children() {
            match node.tag_name().name() {
                "link" => links.push(link(node, version, &mut notes)?),
                "joint" => joints.push(joint(node, version, &mut notes)?),
                _ => {}
            }
        }
        let name = match robot.attribute_node("name") {
            Some(name) => short_name(robot, &name)?,
            None => String::new(),
        };
        Ok(Document { name, links, joints, notes })
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

/// The name of a macro of xacro, whether or not its prefix is declared.
fn macro_name<'a>(node: Node<'a, '_>) -> Option<&'a str> {
    let tag = node.tag_name();
    match tag.namespace() {
        Some(space) => space.contains("xacro").then_some(tag.name()),
        None => tag.name().strip_prefix("xacro_"),
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
    let line = node.document().text_pos_at(span.start).row;
    Malformed { span, line, invalid: Invalid::new(owner_name(node), what.to_string(), remedy) }
}

/// The name of the joint or link that an element is, or stands in.
fn owner_name<'a>(node: Node<'a, '_>) -> &'a str {
    let is_named = |around: &Node| ["link", "joint"].contains(&around.tag_name().name());
    node.ancestors().find(is_named).and_then(|around| around.attribute("name")).unwrap_or_default()
}

/// The element of a name below another one: the first one, as other readers of the format do.
fn child<'a, 'text>(node: Node<'a, 'text>, name: &str) -> Option<Node<'a, 'text>> {
    node.children().find(|below| below.tag_name().name() == name)
}

/// What a link or joint gives more than once, of which the first is taken.
fn repeated(node: Node, notes: &mut Vec<String>) {
    for name in ["inertial", "mass", "inertia", "origin", "axis", "limit", "mimic"] {
        let Some(again) = node.children().filter(|below| below.tag_name().name() == name).nth(1)
        else {
            continue;
        };
        let line = node.document().text_pos_at(again.range().start).row;
        let owner = owner_name(node);
        notes.push(format!("`{owner}`: line {line}: a second <{name}> is not read"));
    }
}

/// An element that URDF demands.
fn demanded_child<'a, 'text>(
    node: Node<'a, 'text>,
    name: &str,
) -> Result<Node<'a, 'text>, Malformed> {
    child(node, name).ok_or_else(|| {
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
    let Some(origin) = child(node, "origin") else { return Ok(pose(DVec3::ZERO, DVec3::ZERO)) };
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

fn link(node: Node, version: Version, notes: &mut Vec<String>) -> Result<Link, Malformed> {
    let name = demanded(node, "name")?;
    let mut link = Link {
        name: short_name(node, &name)?,
        span: name.range(),
        mass_kg: 0.0,
        inertial_frame: pose(DVec3::ZERO, DVec3::ZERO),
        inertia: Inertia::default(),
    };
    repeated(node, notes);
    let Some(inertial) = child(node, "inertial") else { return Ok(link) };
    repeated(inertial, notes);
    link.inertial_frame = origin(inertial, version)?;
    match child(inertial, "mass") {
        Some(mass) => link.mass_kg = demanded_number(mass, "value")?,
        None => notes.push(format!("`{}`: its <inertial> has no <mass>: taken as 0 kg", link.name)),
    }
    let Some(inertia) = child(inertial, "inertia") else {
        notes.push(format!("`{}`: its <inertial> has no <inertia>: a point mass", link.name));
        return Ok(link);
    };
    let moment = |name: &str| demanded_number(inertia, name);
    link.inertia = Inertia {
        ixx: moment("ixx")?,
        ixy: moment("ixy")?,
        ixz: moment("ixz")?,
        iyy: moment("iyy")?,
        iyz: moment("iyz")?,
        izz: moment("izz")?,
    };
    Ok(link)
}

fn joint(node: Node, version: Version, notes: &mut Vec<String>) -> Result<Joint, Malformed> {
    repeated(node, notes);
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
        axis: match child(node, "axis").and_then(|axis| Some((axis, axis.attribute_node("xyz")?))) {
            Some((axis, xyz)) => DVec3::from_array(numbers(axis, xyz)?),
            None => DVec3::X,
        },
        limit: match child(node, "limit") {
            Some(element) => limit(element, version)?,
            None => Limit::default(),
        },
        mimic: match child(node, "mimic") {
            Some(element) => Some(mimic(element)?),
            None => None,
        },
    })
}

fn mimic(node: Node) -> Result<Mimic, Malformed> {
    Ok(Mimic {
        joint: demanded(node, "joint")?.value().to_owned(),
        multiplier: number(node, "multiplier")?.unwrap_or(1.0),
        offset: number(node, "offset")?.unwrap_or(0.0),
    })
}

fn limit(node: Node, version: Version) -> Result<Limit, Malformed> {
    let sizes = ["effort", "velocity", "acceleration", "deceleration", "jerk"];
    for name in ["lower", "upper"].into_iter().chain(sizes) {
        let Some(attribute) = node.attribute_node(name) else { continue };
        let [value] = numbers(node, attribute)?;
        if value.is_nan() || (value < 0.0 && sizes.contains(&name)) {
            let what = format!("`{name}` is {value}");
            return Err(complaint_at(node, attribute.range(), what, "give a number, or none"));
        }
    }
    // Before version 1.2 an end that is left out is 0; since then there is none.
    let absent = if version < VERSION_OF_OPEN_LIMITS { 0.0 } else { f64::INFINITY };
    let lower = number(node, "lower")?.unwrap_or(-absent);
    let upper = number(node, "upper")?.unwrap_or(absent);
    if upper < lower {
        let what = format!("its lower limit {lower} is not below the upper {upper}");
        return Err(complaint(node, what, "exchange them"));
    }
    let known = |size: &f64| *size > 0.0 && size.is_finite();
    Ok(Limit {
        range: (lower < upper && lower.is_finite() && upper.is_finite()).then_some([lower, upper]),
        effort: number(node, "effort")?.filter(known),
        velocity: number(node, "velocity")?.filter(known),
        acceleration: number(node, "acceleration")?.filter(|acceleration| acceleration.is_finite()),
    })
}
