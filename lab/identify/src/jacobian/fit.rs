//! The feature Jacobian by least squares through rests, what it can distinguish, and which motions
//! and features form a square task. Test motions that were always made together are an error,
//! because they cannot be separated afterwards.
//!
//! ```text
//! F(rest) = F_run + drift t + J X(rest)    each feature by itself, rests weighted alike
//! B = J / deviation, rests taken alike     singular values: how surely a combination is seen
//! ```
//! A motion leaves friction that holds a joint or the contact on one side. This offset is the same
//! for the run of rests to which the motion led, so each run has a level of its own; where that
//! would take more than a third of the rests, all runs share one level. The uncertainty of an entry
//! is the larger of two values. The first assumes that all rests have the same residual variance,
//! which is at least the noise of the images. The second uses the residuals of the rests that
//! determine this entry (MacKinnon and White, J. Econometrics 29, 1985, HC3).
//!
//! Motions and features of the task are found by pivoted orthogonalisation (Businger and Golub
//! 1965). Each step picks the motion that the remaining features show best, as long as the smallest
//! singular value of the picked motions is large enough to be detected. Then the features that show
//! these motions best are picked.

use nalgebra::{DMatrix, DVector};

use super::rests::{FEATURE_COUNT, MOTION_COUNT, Rest};

/// Smallest number of rests beyond the number of unknowns.
const SPARE_RESTS_MIN: usize = 4;
/// Smallest root mean square of a test motion (mm, mrad); a smaller one counts as not made.
const MOTION_RMS_MIN: f64 = 1e-3;
/// Largest condition number of the test motions, each scaled to its own size.
const TEST_CONDITION_MAX: f64 = 20.0;
/// Motions are detected when every combination of them changes the features by this many standard
/// deviations of the fit.
const DETECTION_DEVIATIONS: f64 = 3.0;

/// A value with two standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Two standard deviations.
    pub error: f64,
}

/// The result of one feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Index of the feature.
    pub feature: usize,
    /// Change of the feature with each motion that was made.
    pub entries: Vec<Estimate>,
    /// One standard deviation of each entry, with equal residual variance in all rests.
    pub uniform_deviation: Vec<f64>,
    /// Change with time alone (per s).
    pub drift: Estimate,
    /// Standard deviation in one image.
    pub noise: f64,
    /// Root mean square of the residuals of the rests' means.
    pub residual: f64,
    /// Mean over the rests.
    pub mean: f64,
}

/// The result of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct Identification {
    /// The motions that were made, and their root mean squares.
    pub motions: Vec<(usize, f64)>,
    /// Condition number of the test motions.
    pub test_condition: f64,
    /// The features that are defined at every rest.
    pub rows: Vec<Row>,
    /// Singular values of B, largest first.
    pub singular_values: Vec<f64>,
}

/// A square task: motions and equally many features, as indices into `moved` and `rows`.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Columns of the Jacobian.
    pub motions: Vec<usize>,
    /// Rows of the Jacobian.
    pub features: Vec<usize>,
}

/// Fits the feature Jacobian through the rests.
///
/// # Errors
/// Too few rests, or motions that were made together; the text is a sentence.
pub fn fit(rests: &[Rest]) -> Result<Identification, String> {
    let n = rests.len() as f64;
    let mean = |j: usize| rests.iter().map(|rest| rest.motion[j]).sum::<f64>() / n.max(1.0);
    let size = |j: usize| {
        let off = rests.iter().map(|rest| rest.motion[j] - mean(j));
        (off.map(|off| off * off).sum::<f64>() / n.max(1.0)).sqrt()
    };
    let moved: Vec<(usize, f64)> = (0..MOTION_COUNT)
        .map(|j| (j, size(j)))
        .filter(|(_, size)| *size > MOTION_RMS_MIN)
        .collect();
    let mut runs = 1 + rests.last().map_or(0, |rest| rest.run);
    if 3 * runs > rests.len() || rests.len() < runs + 1 + moved.len() + SPARE_RESTS_MIN {
        runs = 1;
    }
    let unknowns = runs + 1 + moved.len();
    if moved.is_empty() || rests.len() < unknowns + SPARE_RESTS_MIN {
        let (got, moved) = (rests.len(), moved.len());
        return Err(format!(
            "{got} rests in contact with {moved} motions between them; stand at least {} times, \
             some tenths of a second each",
            unknowns + SPARE_RESTS_MIN
        ));
    }
    let middle_s = rests.iter().map(|rest| rest.at_s).sum::<f64>() / n;
    let design = DMatrix::from_fn(rests.len(), unknowns, |i, j| match j {
        _ if j < moved.len() => rests[i].motion[moved[j].0] - mean(moved[j].0),
        _ if j == moved.len() => rests[i].at_s - middle_s,
        _ => f64::from(u8::from(runs == 1 || rests[i].run + moved.len() + 1 == j)),
    });
    let tested = design.columns(0, moved.len()).into_owned();
    let test_condition = condition(&scaled(&tested));
    if test_condition > TEST_CONDITION_MAX {
        return Err(format!(
            "the test motions were made together (condition number {test_condition:.0}); make them \
             one by one, both ways"
        ));
    }
    let normal = (design.transpose() * &design).try_inverse();
    let normal = normal.ok_or("the rests do not fix a line")?;
    let rows =
        (0..FEATURE_COUNT).filter_map(|f| row(rests, f, &design, &normal, moved.len())).collect();
    let mut found =
        Identification { motions: moved, test_condition, rows, singular_values: Vec::new() };
    let mut singular_values: Vec<f64> =
        found.scaled_jacobian().singular_values().iter().copied().collect();
    singular_values.sort_by(|a, b| b.total_cmp(a));
    found.singular_values = singular_values;
    Ok(found)
}

/// Fits one feature; `None` when it is undefined at a rest.
fn row(
    rests: &[Rest],
    feature: usize,
    design: &DMatrix<f64>,
    normal: &DMatrix<f64>,
    moved: usize,
) -> Option<Row> {
    let values: Vec<f64> = rests.iter().map(|rest| rest.mean[feature]).collect::<Option<_>>()?;
    let values = DVector::from_vec(values);
    let best = normal * design.transpose() * &values;
    let left = &values - design * &best;
    let n = rests.len() as f64;
    let images: f64 = rests.iter().map(|rest| rest.images as f64).sum();
    let variance =
        rests.iter().map(|r| r.variance[feature] * r.images as f64).sum::<f64>() / images;
    // With equal residual variance in all rests, which is at least the noise of the images.
    let even = left.norm_squared() / (n - best.len() as f64);
    let even = even.max(variance * n / images);
    // The weight of each rest in an entry.
    let pull = normal * design.transpose();
    let lone = |i: usize| 1.0 - (design.row(i) * pull.column(i))[0];
    let of = |j: usize| {
        let parts = (0..left.len()).map(|i| pull[(j, i)] * left[i] / lone(i).max(0.05));
        let spread = parts.map(|part| part * part).sum::<f64>();
        let least = even * normal[(j, j)];
        Estimate { value: best[j], error: 2.0 * spread.max(least).sqrt() }
    };
    Some(Row {
        feature,
        entries: (0..moved).map(of).collect(),
        uniform_deviation: (0..moved).map(|j| (even * normal[(j, j)]).sqrt()).collect(),
        drift: of(moved),
        noise: variance.sqrt(),
        residual: (left.norm_squared() / n).sqrt(),
        mean: values.mean(),
    })
}

/// Columns scaled to length 1.
fn scaled(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out = matrix.clone();
    for mut column in out.column_iter_mut() {
        let norm = column.norm();
        column.unscale_mut(norm.max(f64::MIN_POSITIVE));
    }
    out
}

/// Ratio of the largest to the smallest singular value.
fn condition(matrix: &DMatrix<f64>) -> f64 {
    let values = matrix.singular_values();
    let (low, high) = (values.min(), values.max());
    if low > 0.0 { high / low } else { f64::INFINITY }
}

/// Picks columns by pivoted orthogonalisation: the largest remainder comes next.
fn pivot_columns(matrix: &DMatrix<f64>, least: f64, most: usize) -> Vec<usize> {
    let (mut rest, mut picked) = (matrix.clone(), Vec::new());
    while picked.len() < most.min(matrix.nrows()) {
        let norms = (0..rest.ncols()).map(|j| (j, rest.column(j).norm()));
        let Some((best, norm)) = norms.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        if norm.is_nan() || norm < least {
            break;
        }
        let axis = rest.column(best) / norm;
        for mut column in rest.column_iter_mut() {
            let part = column.dot(&axis);
            column.axpy(-part, &axis, 1.0);
        }
        picked.push(best);
    }
    picked
}

impl Identification {
    /// B: every entry over its standard deviation.
    #[must_use]
    pub fn scaled_jacobian(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.rows.len(), self.motions.len(), |i, j| {
            // Each row has one scale; otherwise columns that are parallel would not seem so.
            let row = &self.rows[i];
            row.entries[j].value / row.uniform_deviation[j].max(f64::MIN_POSITIVE)
        })
    }

    /// The motions, out of the allowed ones, that the features distinguish, and equally many
    /// features that show them.
    #[must_use]
    pub fn task(&self, motions: &[usize], features: &[usize]) -> Task {
        let allowed = |all: &[usize], one: usize| all.is_empty() || all.contains(&one);
        let rows: Vec<usize> =
            (0..self.rows.len()).filter(|i| allowed(features, self.rows[*i].feature)).collect();
        let columns: Vec<usize> =
            (0..self.motions.len()).filter(|j| allowed(motions, self.motions[*j].0)).collect();
        let signal = self.scaled_jacobian().select_rows(&rows).select_columns(&columns);
        let mut picked = pivot_columns(&signal, DETECTION_DEVIATIONS, columns.len());
        // The remainder of a motion beside those before it is at least the smallest singular value.
        // The pivots alone would therefore keep two motions that are nearly the same.
        while !picked.is_empty()
            && signal.select_columns(&picked).singular_values().min() < DETECTION_DEVIATIONS
        {
            picked.pop();
        }
        let shown = signal.select_columns(&picked).transpose();
        let shown = pivot_columns(&shown, f64::MIN_POSITIVE, picked.len());
        let mut task = Task {
            motions: picked.into_iter().map(|j| columns[j]).collect(),
            features: shown.into_iter().map(|i| rows[i]).collect(),
        };
        task.motions.sort_unstable();
        task.features.sort_unstable();
        task
    }

    /// One standard deviation of each motion of a task from one image (mm, mrad).
    #[must_use]
    pub fn resolution(&self, task: &Task) -> Option<Vec<f64>> {
        let noise = |i: usize| self.rows[i].noise;
        let jacobian = DMatrix::from_fn(task.features.len(), task.motions.len(), |i, j| {
            self.rows[task.features[i]].entries[task.motions[j]].value / noise(task.features[i])
        });
        let back = jacobian.try_inverse()?;
        Some((0..task.motions.len()).map(|j| back.row(j).norm()).collect())
    }
}
