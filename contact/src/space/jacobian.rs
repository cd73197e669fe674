//! Feature Jacobians of an indenter: how the features of its image change as it is moved and
//! turned, by central differences at two steps, extrapolated. The error's estimate is what the two
//! steps differ by, what another level of accuracy makes of the same derivative, and what the level
//! is known to leave.
//!
//! Where the array's edge cuts a pin, it is moved with its ends held, and the ends are moved along
//! it: by as much as the edge runs along the axis, times a derivative that is that of a shift along
//! the axis and that of the length. So few pins are solved, and those cut into as many slices.
//!
//! Motions are about the indenter's origin on the surface: dx, dy along the array, dz into the
//! layer, right-handed rotations about x, y (which tilt a long indenter, positive about x lowering
//! the side towards -y) and z (up). A rotation about x or y is one about the indenter's slope, one
//! about z and a roll about its own axis; of an axis that is tilted the one about z is the roll's
//! part times the sine of the tilt. A round body's roll changes nothing: a sphere's rotations are
//! columns of 0; a bar's roll is the exact rate of its pressure ([`super::pin::Roll`]). What a
//! motion or a feature does not define (dz of a line load, the axis of a round image) is absent,
//! and so is then the condition number.

use super::super::Invalid;
use super::super::features::{ImageFeatures, Part, image_features};
use super::Prescribed;
pub use super::motion::Motion;
use super::pin::ContactedEnds;
use super::scene::{Pose, Scene, SceneState, Shape};

/// A feature of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// Sum of szz times area, N.
    M0,
    /// Sum of x szz times area, N mm.
    My,
    /// Sum of y szz times area, N mm.
    Mx,
    /// Centroid's x, mm.
    Xc,
    /// Centroid's y, mm.
    Yc,
    /// Central second moment along x, N mm^2.
    MuXx,
    /// Mixed central second moment, N mm^2.
    MuXy,
    /// Central second moment along y, N mm^2.
    MuYy,
    /// Angle of the long axis from +x, rad.
    ThetaLong,
}

impl Feature {
    fn of(self, features: &ImageFeatures) -> Option<f64> {
        match self {
            Self::M0 => Some(features.m0),
            Self::My => Some(features.my),
            Self::Mx => Some(features.mx),
            Self::Xc => features.xc,
            Self::Yc => features.yc,
            Self::MuXx => features.mu_xx,
            Self::MuXy => features.mu_xy,
            Self::MuYy => features.mu_yy,
            Self::ThetaLong => features.theta_long_rad,
        }
    }
}

/// Derivatives of features with respect to motions.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureJacobian {
    /// Number of motions: entries a row.
    pub motions: usize,
    /// Derivatives, feature after feature.
    pub values: Vec<Option<f64>>,
    /// Estimated error of each: what two steps of the differences and two levels of accuracy leave
    /// between them; absent where the other level has no such contact.
    pub errors: Vec<Option<f64>>,
    /// Largest over smallest singular value, in the units of the rows and columns as they are;
    /// absent when an entry is, and for a matrix without full rank.
    pub condition: Option<f64>,
    /// The contact at which they were taken.
    pub state: SceneState,
}

/// Smallest part of the largest singular value that counts as rank.
const RANK_TOLERANCE: f64 = 1e-10;
/// The error over the difference to another level, which is off by a part of it.
const LEVEL_DIFFERENCE_FACTOR: f64 = 1.5;
/// A rotation that tilts an edge by no more than this part of itself is its roll.
const ROLL_TOLERANCE: f64 = 1e-12;

/// Differentiates the features of a scene at a contact. With a force the penetration found for it
/// is what the motions start from. Allocates.
///
/// The level beside which the errors are taken is the default one, and of a scene at that level the
/// fine one; of a pin with ends or slopes the fast one, which is off by more than the default and
/// takes less. What a pin's level is known to leave, of the feature's largest derivative with
/// respect to a motion of the same unit, is added.
///
/// # Errors
/// What pressing refuses there and nearby; no feature or no motion.
pub fn feature_jacobian(
    scene: &mut Scene,
    prescribed: Prescribed,
    pose: Pose,
    features: &[Feature],
    motions: &[Motion],
) -> Result<FeatureJacobian, Invalid> {
    for (place, empty) in [("features", features.is_empty()), ("motions", motions.is_empty())] {
        if empty {
            return Err(Invalid::new(place, "the list is empty".to_owned(), "name at least one"));
        }
    }
    let mut out = differences(scene, prescribed, pose, features, motions, true)?;
    let other = scene
        .at_other_level()
        .and_then(|mut other| differences(&mut other, prescribed, pose, features, motions, false))
        .map_or_else(|_| vec![None; out.values.len()], |other| other.values);
    let accuracy = scene.accuracy();
    let rows = out.values.chunks_exact(motions.len()).zip(other.chunks_exact(motions.len()));
    for (errors, (values, other)) in out.errors.chunks_exact_mut(motions.len()).zip(rows) {
        for (n, error) in errors.iter_mut().enumerate() {
            let alike = motions
                .iter()
                .zip(values)
                .filter(|(m, _)| m.is_rotation() == motions[n].is_rotation());
            let size = alike.filter_map(|(_, value)| *value).fold(0.0_f64, |s, v| s.max(v.abs()));
            let apart =
                values[n].zip(other[n]).map(|(a, b)| LEVEL_DIFFERENCE_FACTOR * (a - b).abs());
            *error = error.zip(apart).map(|(steps, levels)| steps + levels + accuracy * size);
        }
    }
    Ok(out)
}

/// Differences at the scene's own level, extrapolated from two steps or of the shorter one alone;
/// their errors are of the steps.
fn differences(
    scene: &mut Scene,
    prescribed: Prescribed,
    pose: Pose,
    features: &[Feature],
    motions: &[Motion],
    extrapolated: bool,
) -> Result<FeatureJacobian, Invalid> {
    let state = scene.press(prescribed, pose)?;
    let differenced = DifferencedContact {
        prescribed: state.penetration_mm.map_or(prescribed, Prescribed::PenetrationMm),
        pose,
        features,
        extrapolated,
        rolled: scene.rolled()?,
    };
    // A contact just touched grows on one side of where it is only.
    if matches!(prescribed, Prescribed::ForceN(_)) && state.force_n <= 0.0 {
        let none = vec![None; features.len() * motions.len()];
        let (values, errors) = (none.clone(), none);
        return Ok(FeatureJacobian {
            motions: motions.len(),
            values,
            errors,
            condition: None,
            state,
        });
    }
    let reach = scene.hold_ends();
    let found = differenced.derivative_columns(scene, motions, reach, state);
    // The scene is left at the contact asked for.
    scene.release_ends();
    let derivative_columns = found?;
    scene.press(prescribed, pose)?;
    let all = |of: fn(&Slope) -> f64| -> Vec<Option<f64>> {
        let row =
            |row: usize| derivative_columns.iter().map(move |column| column[row].as_ref().map(of));
        (0..features.len()).flat_map(row).collect()
    };
    let values = all(|slope| slope.value);
    let condition = condition(&values, motions.len());
    let errors = all(|slope| slope.error);
    Ok(FeatureJacobian { motions: motions.len(), values, errors, condition, state })
}

/// A derivative and what its steps leave open.
#[derive(Clone, Copy, Debug, Default)]
struct Slope {
    value: f64,
    error: f64,
}

/// Derivatives of features; absent where undefined.
type Column = Vec<Option<Slope>>;

/// What differences are taken of.
struct DifferencedContact<'a> {
    prescribed: Prescribed,
    pose: Pose,
    features: &'a [Feature],
    extrapolated: bool,
    /// The image's rate under a roll.
    rolled: Vec<f64>,
}

impl DifferencedContact<'_> {
    /// Derivatives with respect to motions, of a contact as it stands.
    fn derivative_columns(
        &self,
        scene: &mut Scene,
        motions: &[Motion],
        reach: Option<ContactedEnds>,
        state: SceneState,
    ) -> Result<Vec<Column>, Invalid> {
        let shape = scene.shape();
        let here = rolled_features(scene, &[], 0.0)?;
        let defined: Vec<bool> = self.features.iter().map(|f| f.of(&here).is_some()).collect();
        let mut columns = vec![vec![None; self.features.len()]; motions.len()];
        // Those along the array first: they leave the contact as it is.
        for carried in [true, false] {
            for (column, motion) in columns.iter_mut().zip(motions) {
                let Some(effect) = effect(shape, self.pose, *motion) else { continue };
                if carried == (scene.keeps_contact() && effect.is_along()) {
                    let step = scene.step(*motion, state.penetration_mm);
                    *column = self.along(scene, effect, step, carried)?;
                }
            }
        }
        if let Some(reach) = reach {
            self.add_end_motion(scene, motions, reach, state.penetration_mm, &mut columns)?;
        }
        for column in &mut columns {
            for (slope, defined) in column.iter_mut().zip(&defined) {
                *slope = slope.filter(|_| *defined);
            }
        }
        Ok(columns)
    }

    /// Derivatives along one motion, the ends of the indenter moving with it.
    fn along(
        &self,
        scene: &mut Scene,
        effect: Effect,
        step: f64,
        carried: bool,
    ) -> Result<Column, Invalid> {
        let mut at = |amount: f64| {
            let (prescribed, pose) = effect.after(self.prescribed, self.pose, amount);
            if carried {
                scene.set_pose(pose);
            } else {
                scene.press(prescribed, pose)?;
            }
            rolled_features(scene, &self.rolled, amount * effect.roll)
        };
        let narrow = [at(0.5 * step)?, at(-0.5 * step)?];
        let wide = if self.extrapolated { Some([at(step)?, at(-step)?]) } else { None };
        Ok(self.slopes((&narrow, wide.as_ref()), step))
    }

    /// Adds what it does that the array's edge runs along the axis meanwhile.
    fn add_end_motion(
        &self,
        scene: &mut Scene,
        motions: &[Motion],
        reach: ContactedEnds,
        penetration_mm: Option<f64>,
        columns: &mut [Column],
    ) -> Result<(), Invalid> {
        let (prescribed, pose, shape) = (self.prescribed, self.pose, scene.shape());
        let rates: Vec<Option<[(f64, f64); 2]>> = motions
            .iter()
            .map(|motion| {
                let effect = effect(shape, pose, *motion)?;
                Some(scene.ends_rate(pose, |amount| effect.after(prescribed, pose, amount).1))
            })
            .collect();
        if rates.iter().flatten().flatten().all(|rate| *rate == (0.0, 0.0)) {
            return Ok(());
        }
        let step = scene.step(Motion::X, penetration_mm);
        let (s, c) = (libm::sin(pose.planar.rot_rad), libm::cos(pose.planar.rot_rad));
        let outward = Effect { x: -s, y: c, deeper: libm::tan(pose.tilt_rad), ..Effect::default() };
        scene.press(prescribed, pose)?;
        let shifted = self.along(scene, outward, step, false)?;
        let longer = if reach == ContactedEnds::Both {
            scene.press(prescribed, pose)?;
            let mut at = |by: f64| {
                let of = |scene: &Scene| rolled_features(scene, &[], 0.0);
                let found = scene.lengthened(prescribed, pose, by, of)?;
                Ok::<ImageFeatures, Invalid>(found.unwrap_or_default())
            };
            let pair = [at(0.5 * step)?, at(-0.5 * step)?];
            self.slopes((&pair, None), step)
        } else {
            vec![Some(Slope::default()); self.features.len()]
        };
        for (column, rates) in columns.iter_mut().zip(&rates) {
            let Some([first, second]) = *rates else { continue };
            let (mean, half) = match reach {
                ContactedEnds::Both => {
                    let off = 0.5 * (first.1 + second.1);
                    ((0.5 * (first.0 + second.0), off), (0.5 * (second.0 - first.0), off))
                }
                ContactedEnds::One(end) => ([first, second][end], (0.0, 0.0)),
            };
            for (slope, (shifted, longer)) in column.iter_mut().zip(shifted.iter().zip(&longer)) {
                let known = slope.zip(*shifted).zip(*longer);
                *slope = known.map(|((slope, a), b)| Slope {
                    value: slope.value + mean.0 * a.value + half.0 * b.value,
                    error: slope.error
                        + mean.0.abs() * a.error
                        + half.0.abs() * b.error
                        + mean.1 * a.value.abs()
                        + half.1 * b.value.abs(),
                });
            }
        }
        Ok(())
    }

    /// Slopes between features at half a step and at a whole one.
    fn slopes(
        &self,
        (narrow, wide): (&[ImageFeatures; 2], Option<&[ImageFeatures; 2]>),
        step: f64,
    ) -> Column {
        let slope = |feature: Feature, pair: &[ImageFeatures; 2], step: f64| {
            let mut rise = feature.of(&pair[0])? - feature.of(&pair[1])?;
            if feature == Feature::ThetaLong {
                // An axis turned by half a turn is the same axis.
                rise -= core::f64::consts::PI * (rise / core::f64::consts::PI).round();
            }
            Some(rise / (2.0 * step))
        };
        let one = |feature: &Feature| {
            let fine = slope(*feature, narrow, 0.5 * step)?;
            let coarse = wide.map_or(Some(fine), |wide| slope(*feature, wide, step))?;
            Some(Slope { value: (4.0 * fine - coarse) / 3.0, error: (fine - coarse).abs() / 3.0 })
        };
        self.features.iter().map(one).collect()
    }
}

/// Features of the image of a contact, with so much of a roll's rate added.
fn rolled_features(scene: &Scene, rolled: &[f64], roll: f64) -> Result<ImageFeatures, Invalid> {
    let mut image = vec![0.0; scene.array().len()];
    scene.image(&mut image)?;
    for (value, rate) in image.iter_mut().zip(rolled) {
        *value += roll * rate;
    }
    image_features(scene.array(), &image, Part::Full)
}

/// What one unit of a motion changes.
#[derive(Clone, Copy, Debug, Default)]
struct Effect {
    x: f64,
    y: f64,
    deeper: f64,
    rot: f64,
    tilt: f64,
    roll: f64,
}

impl Effect {
    /// Whether it moves the indenter along the array only.
    fn is_along(self) -> bool {
        self.deeper == 0.0 && self.tilt == 0.0 && self.roll == 0.0
    }

    fn after(self, prescribed: Prescribed, mut pose: Pose, amount: f64) -> (Prescribed, Pose) {
        pose.planar.x_mm += self.x * amount;
        pose.planar.y_mm += self.y * amount;
        pose.planar.rot_rad += self.rot * amount;
        pose.tilt_rad += self.tilt * amount;
        let prescribed = match prescribed {
            Prescribed::PenetrationMm(delta) => {
                Prescribed::PenetrationMm(delta + self.deeper * amount)
            }
            Prescribed::ForceN(force) => Prescribed::ForceN(force),
        };
        (prescribed, pose)
    }
}

fn effect(shape: Shape, pose: Pose, motion: Motion) -> Option<Effect> {
    let none = Effect::default();
    let (s, c) = (libm::sin(pose.planar.rot_rad), libm::cos(pose.planar.rot_rad));
    let round = matches!(shape, Shape::Sphere { .. });
    let line = matches!(shape, Shape::Edge { .. });
    // A rotation about x raises the place (x, y) by y: the axis (-s, c) by c a length, the side
    // (c, s) by s. The roll's axis leans down by the tilt: what it has of z is turned back.
    let lean = libm::tan(pose.tilt_rad);
    let longer = (1.0 + lean * lean).sqrt();
    let tilt = |part: f64, roll: f64| {
        if round {
            return Some(none);
        }
        let turned = Effect { tilt: -part, roll: roll * longer, rot: roll * lean, ..none };
        (!line || part.abs() < ROLL_TOLERANCE).then_some(turned)
    };
    match motion {
        Motion::X => Some(Effect { x: 1.0, ..none }),
        Motion::Y => Some(Effect { y: 1.0, ..none }),
        Motion::Z => (!line).then_some(Effect { deeper: 1.0, ..none }),
        Motion::RotX => tilt(c, -s),
        Motion::RotY => tilt(s, c),
        Motion::RotZ => Some(Effect { rot: if round { 0.0 } else { 1.0 }, ..none }),
    }
}

/// Ratio of the largest and the smallest singular value of rows of `columns` numbers.
#[must_use]
pub fn condition(values: &[Option<f64>], columns: usize) -> Option<f64> {
    let known: Option<Vec<f64>> = values.iter().copied().collect();
    let known = known.filter(|known| columns > 0 && !known.is_empty())?;
    let rows = known.len() / columns;
    // One-sided rotations on the shorter set of vectors.
    let (count, length) = (rows.min(columns), rows.max(columns));
    let entry = |vector: usize, place: usize| {
        if rows <= columns {
            known[vector * columns + place]
        } else {
            known[place * columns + vector]
        }
    };
    let mut vectors: Vec<Vec<f64>> =
        (0..count).map(|v| (0..length).map(|p| entry(v, p)).collect()).collect();
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(x, y)| x * y).sum() };
    for _ in 0..60 {
        let mut turned = false;
        for i in 0..count {
            for j in i + 1..count {
                let (p, q) = (dot(&vectors[i], &vectors[i]), dot(&vectors[j], &vectors[j]));
                let r = dot(&vectors[i], &vectors[j]);
                if r.abs() <= 1e-15 * (p * q).sqrt() {
                    continue;
                }
                turned = true;
                let zeta = (q - p) / (2.0 * r);
                let size = zeta.abs() + (1.0 + zeta * zeta).sqrt();
                let tangent = if zeta < 0.0 { -1.0 / size } else { 1.0 / size };
                let c = 1.0 / (1.0 + tangent * tangent).sqrt();
                let s = c * tangent;
                let (low, high) = vectors.split_at_mut(j);
                for (x, y) in low[i].iter_mut().zip(&mut high[0]) {
                    (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
                }
            }
        }
        if !turned {
            break;
        }
    }
    let sizes: Vec<f64> = vectors.iter().map(|v| dot(v, v).sqrt()).collect();
    let largest = sizes.iter().fold(0.0_f64, |most, size| most.max(*size));
    let smallest = sizes.iter().fold(f64::INFINITY, |least, size| least.min(*size));
    (smallest > RANK_TOLERANCE * largest).then(|| largest / smallest)
}
