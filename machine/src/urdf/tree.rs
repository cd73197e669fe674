//! The tree of links and joints of a robot description: who holds which link. Every name is looked
//! up once, so that the time grows with the file's size and not with its square.

use std::collections::{BTreeMap, BTreeSet};

use taktil_mechanics::Pose;
use taktil_rtcore::Invalid;

use super::document::{Document, Joint, JointType};

/// Joints between the base and a link: the frame of each link is composed of those of the joints
/// that hold it, one by one. Real descriptions have some 20.
const DEPTH_MAX: usize = 256;
/// Names of links that a complaint lists.
const LISTED_NAMES_MAX: usize = 12;

/// Links by their names, and the joints that hold them.
pub(super) struct Tree<'a> {
    robot: &'a Document,
    indices: BTreeMap<&'a str, usize>,
    /// What holds each link.
    holders: Vec<Option<Holder<'a>>>,
    /// Whether a link holds another one.
    holds: Vec<bool>,
}

/// What holds a link.
#[derive(Clone, Copy)]
struct Holder<'a> {
    joint: &'a Joint,
    /// Index of the link nearer to the base.
    parent: usize,
}

impl<'a> Tree<'a> {
    /// Joins links and joints.
    ///
    /// # Errors
    /// Names that occur twice or are missing, links that two joints hold, several bases, loops, and
    /// a tree that is too deep.
    pub(super) fn new(robot: &'a Document) -> Result<Tree<'a>, Invalid> {
        if robot.links.is_empty() {
            return Err(Invalid::new("", "has no link", "name a robot description in XML"));
        }
        let indices = unique("links", robot.links.iter().map(|link| link.name.as_str()))?;
        unique("joints", robot.joints.iter().map(|joint| joint.name.as_str()))?;
        let mut holders = vec![None; robot.links.len()];
        let mut holds = vec![false; robot.links.len()];
        let mut held_twice = None;
        for joint in &robot.joints {
            let of = |end: &str| {
                indices.get(end).copied().ok_or_else(|| {
                    let what = format!("names a link `{end}` that is not there");
                    let names = robot.links.iter().map(|link| link.name.as_str());
                    Invalid::new(
                        &joint.name,
                        what,
                        format!("links of this file are: {}", list(names)),
                    )
                })
            };
            let (parent, child) = (of(&joint.parent)?, of(&joint.child)?);
            holds[parent] = true;
            if holders[child].is_some() {
                held_twice = Some(held_twice.map_or(child, |first: usize| first.min(child)));
            } else {
                holders[child] = Some(Holder { joint, parent });
            }
        }
        if let Some(link) = held_twice {
            let name = &robot.links[link].name;
            return Err(Invalid::new(name, "two joints hold this link", "a chain has no loops"));
        }
        let tree = Tree { robot, indices, holders, holds };
        tree.check_base()?;
        tree.check_depth()?;
        Ok(tree)
    }

    /// That every link hangs from one base.
    fn check_base(&self) -> Result<(), Invalid> {
        let mut bases = self.robot.links.iter().zip(&self.holders);
        let mut next = || bases.find(|(_, holder)| holder.is_none()).map(|(link, _)| &link.name);
        if let (Some(base), Some(loose)) = (next(), next()) {
            let what = format!("hangs from nothing, and so does `{base}`");
            return Err(Invalid::new(loose, what, "join them, if only by a fixed joint"));
        }
        Ok(())
    }

    /// That the way from every link to the base ends, and is not too long.
    fn check_depth(&self) -> Result<(), Invalid> {
        let most = DEPTH_MAX.min(self.robot.joints.len());
        for (index, link) in self.robot.links.iter().enumerate() {
            if self.joints_above(index).take(most + 1).count() <= most {
                continue;
            }
            let (what, remedy) = match most < DEPTH_MAX {
                true => ("its joints form a loop".to_owned(), "a chain begins at a base"),
                false => (
                    format!("more than {DEPTH_MAX} joints hold it, or they form a loop"),
                    "join links that are fixed to each other",
                ),
            };
            return Err(Invalid::new(&link.name, what, remedy));
        }
        Ok(())
    }

    /// The joints that hold the link of an index, from the link to the base.
    fn joints_above(&self, link: usize) -> impl Iterator<Item = &'a Joint> {
        let above = move |holder: &Holder<'a>| self.holders[holder.parent];
        std::iter::successors(self.holders[link], above).map(|holder| holder.joint)
    }

    /// The joints from the base to a link.
    pub(super) fn joints_to(&self, link: &str) -> Vec<&'a Joint> {
        let index = self.indices.get(link);
        let mut joints: Vec<&Joint> =
            index.map(|index| self.joints_above(*index).collect()).unwrap_or_default();
        joints.reverse();
        joints
    }

    /// Whether the link of an index is behind one of these joints.
    pub(super) fn is_behind(&self, link: usize, joints: &BTreeSet<String>) -> bool {
        !joints.is_empty() && self.joints_above(link).any(|joint| joints.contains(&joint.name))
    }

    /// The moving joint that carries the link of an index, and the link's frame in that joint's;
    /// none where the link is fixed to the base.
    pub(super) fn moving_parent(&self, link: usize) -> (Option<&'a str>, Pose) {
        let mut seen = Pose::IDENTITY;
        for joint in self.joints_above(link) {
            if joint.kind != JointType::Fixed {
                return (Some(&joint.name), seen);
            }
            seen = joint.origin.compose(&seen);
        }
        (None, seen)
    }

    /// The link at the end: the one of this name, or else the only one that holds no other.
    ///
    /// # Errors
    /// No such link; several ends.
    pub(super) fn tip(&self, name: Option<&str>) -> Result<&'a str, Invalid> {
        let links = self.robot.links.iter().map(|link| link.name.as_str());
        let mut ends = links.zip(&self.holds).filter(|(_, holds)| !**holds).map(|(name, _)| name);
        if let Some(name) = name {
            return self.indices.get_key_value(name).map(|(name, _)| *name).ok_or_else(|| {
                let remedy = format!("ends of this file are: {}", list(ends));
                Invalid::new("", format!("there is no link `{name}`"), remedy)
            });
        }
        match (ends.clone().count(), ends.next()) {
            (1, Some(end)) => Ok(end),
            (count, first) => {
                let remedy =
                    format!("name one as the tip: {}", list(first.into_iter().chain(ends)));
                Err(Invalid::new("", format!("{count} links end this tree"), remedy))
            }
        }
    }
}

/// Names with their places.
///
/// # Errors
/// A name that occurs twice.
fn unique<'a>(
    kind: &str,
    names: impl Iterator<Item = &'a str>,
) -> Result<BTreeMap<&'a str, usize>, Invalid> {
    let mut indices = BTreeMap::new();
    for (index, name) in names.enumerate() {
        if indices.insert(name, index).is_some() {
            let what = format!("two {kind} have this name");
            return Err(Invalid::new(name, what, "give each its own"));
        }
    }
    Ok(indices)
}

/// Names for a complaint: the first ones, and how many more there are.
fn list<'a>(mut names: impl Iterator<Item = &'a str>) -> String {
    let first: Vec<&str> = names.by_ref().take(LISTED_NAMES_MAX).collect();
    let more = names.count();
    let mut text = first.join(", ");
    if more > 0 {
        text += &format!(", and {more} more");
    }
    text
}
