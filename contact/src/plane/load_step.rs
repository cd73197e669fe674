//! The input of the solver in [`super::frictional`]: load steps and the friction law, and the
//! status that a place may have. Loads that topple an indenter are refused here.

use super::compliance::SurfaceCompliance;
use super::{Load, Refusal};

/// Friction law of the traction along x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrictionLaw {
    /// No shear.
    Free,
    /// Shear in proportion to pressure, by this factor, everywhere.
    Proportional(f64),
    /// Stick up to this many times the pressure, then slip; infinite: never slip.
    Coulomb(f64),
}

impl FrictionLaw {
    /// Shear per pressure where it slips, or is prescribed.
    pub(super) fn shear_ratio(self, status: ContactStatus) -> f64 {
        match (self, status) {
            (Self::Proportional(factor), _) => factor,
            (Self::Coulomb(mu), ContactStatus::SlipForward) => mu,
            (Self::Coulomb(mu), ContactStatus::SlipBack) => -mu,
            _ => 0.0,
        }
    }
}

/// What is prescribed of the indenter in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadStep {
    /// Loads at `height_mm` above the surface at x = 0; the indenter tilts as it must.
    Loads {
        /// P and Q.
        load: Load,
        /// Height of the loads.
        height_mm: f64,
    },
    /// Loads on an indenter that is held upright.
    Upright(Load),
    /// Descent and place along x of an upright indenter.
    Move {
        /// Descent in mm.
        dz_mm: f64,
        /// Place along x in mm.
        dx_mm: f64,
    },
    /// Descent at x = 0, tilt and place along x of the indenter.
    Pose {
        /// Descent in mm.
        dz_mm: f64,
        /// Further descent per mm of x.
        slope: f64,
        /// Place along x in mm.
        dx_mm: f64,
    },
}

impl LoadStep {
    /// Descent, tilt and place along x, if they are prescribed.
    pub(super) fn pose(&self) -> Option<[f64; 3]> {
        match *self {
            Self::Move { dz_mm, dx_mm } => Some([dz_mm, 0.0, dx_mm]),
            Self::Pose { dz_mm, slope, dx_mm } => Some([dz_mm, slope, dx_mm]),
            Self::Loads { .. } | Self::Upright(_) => None,
        }
    }
}

/// Refuses loads whose resultant is not between the outermost places under an indenter, since no
/// pressure balances their moment.
pub(super) fn check_resultant(
    step: &LoadStep,
    compliance: &SurfaceCompliance,
    height_mm: &[f64],
) -> Result<(), Refusal> {
    let LoadStep::Loads { load, height_mm: above } = step else { return Ok(()) };
    let lever = load.q_n_mm * above / load.p_n_mm.max(f64::MIN_POSITIVE);
    let mut places = [f64::INFINITY, f64::NEG_INFINITY];
    // The outer ends of the cells at the outermost places.
    let mut ends = places;
    let under = compliance
        .x_mm
        .iter()
        .zip(&compliance.width_mm)
        .zip(height_mm)
        .filter(|(_, h)| h.is_finite());
    for ((x, width), _) in under {
        places = [places[0].min(*x), places[1].max(*x)];
        ends = [ends[0].min(x - 0.5 * width), ends[1].max(x + 0.5 * width)];
    }
    let within = |[low, high]: [f64; 2]| lever > low && lever < high;
    match (within(places), within(ends)) {
        (true, _) => Ok(()),
        (false, true) => Err(Refusal::OnLastNode),
        (false, false) => Err(Refusal::Toppling),
    }
}

/// The step a part of the way from another one of its kind, or from no load.
pub(super) fn interpolate(start: Option<LoadStep>, step: &LoadStep, f: f64) -> LoadStep {
    let mix = |a: f64, b: f64| a + f * (b - a);
    let mean = |a: Load, b: Load| Load {
        p_n_mm: mix(a.p_n_mm, b.p_n_mm),
        q_n_mm: mix(a.q_n_mm, b.q_n_mm),
    };
    match (*step, start) {
        (LoadStep::Loads { load, height_mm }, Some(LoadStep::Loads { load: from, .. })) => {
            LoadStep::Loads { load: mean(from, load), height_mm }
        }
        (LoadStep::Loads { load, height_mm }, _) => {
            LoadStep::Loads { load: mean(Load::default(), load), height_mm }
        }
        (LoadStep::Upright(load), Some(LoadStep::Upright(from))) => {
            LoadStep::Upright(mean(from, load))
        }
        (LoadStep::Upright(load), _) => LoadStep::Upright(mean(Load::default(), load)),
        (LoadStep::Move { .. } | LoadStep::Pose { .. }, _) => {
            let to = step.pose().unwrap_or_default();
            let from = start.and_then(|start| start.pose()).unwrap_or_default();
            let [dz_mm, slope, dx_mm] = [0, 1, 2].map(|i| mix(from[i], to[i]));
            LoadStep::Pose { dz_mm, slope, dx_mm }
        }
    }
}

/// Contact status of a place of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContactStatus {
    /// Does not touch.
    Apart,
    /// Touches and sticks (or slides freely, without a law along x).
    Stick,
    /// Slips with shear towards +x on the layer.
    SlipForward,
    /// Slips with shear towards -x.
    SlipBack,
}

/// Status of a place that comes into contact: that of its nearest neighbour in contact, because a
/// place that sticks alone beside slipping ones would leave the contact again.
pub(super) fn status_on_contact(status: &[ContactStatus], i: usize) -> ContactStatus {
    let beside = |d: usize| [i.checked_sub(d), Some(i + d)];
    let of = |j: Option<usize>| j.and_then(|j| status.get(j)).copied();
    let mut near = (1..status.len()).flat_map(beside).filter_map(of);
    let touching = near.find(|s| *s != ContactStatus::Apart);
    touching.unwrap_or(ContactStatus::Stick)
}
