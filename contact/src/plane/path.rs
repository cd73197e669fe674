//! What drives the general contact solver and what each place of it may do. Refuses loads that
//! topple an indenter; all else that it is given the solver in [`super::grip`] checks.

use super::bed::Bed;
use super::{Load, Refusal};

/// The law along x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    /// No shear.
    Free,
    /// Shear in proportion to pressure, by this factor, everywhere.
    Proportional(f64),
    /// Stick up to this many times the pressure, then slip; infinite: never slip.
    Coulomb(f64),
}

impl Law {
    /// Shear per pressure where it slips, or is prescribed.
    pub(super) fn shear(self, status: Status) -> f64 {
        match (self, status) {
            (Self::Proportional(factor), _) => factor,
            (Self::Coulomb(mu), Status::SlipForward) => mu,
            (Self::Coulomb(mu), Status::SlipBack) => -mu,
            _ => 0.0,
        }
    }
}

/// What is prescribed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
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

impl Drive {
    /// Descent, tilt and place along x, where they are what is prescribed.
    pub(super) fn pose(&self) -> Option<[f64; 3]> {
        match *self {
            Self::Move { dz_mm, dx_mm } => Some([dz_mm, 0.0, dx_mm]),
            Self::Pose { dz_mm, slope, dx_mm } => Some([dz_mm, slope, dx_mm]),
            Self::Loads { .. } | Self::Upright(_) => None,
        }
    }
}

/// Refuses loads whose resultant is not between the outermost places under an indenter.
pub(super) fn stands(drive: &Drive, bed: &Bed, height_mm: &[f64]) -> Result<(), Refusal> {
    let Drive::Loads { load, height_mm: above } = drive else { return Ok(()) };
    let lever = load.q_n_mm * above / load.p_n_mm.max(f64::MIN_POSITIVE);
    let mut places = [f64::INFINITY, f64::NEG_INFINITY];
    // What the outermost stand for.
    let mut ends = places;
    let under = bed.x_mm.iter().zip(&bed.width_mm).zip(height_mm).filter(|(_, h)| h.is_finite());
    for ((x, width), _) in under {
        places = [places[0].min(*x), places[1].max(*x)];
        ends = [ends[0].min(x - 0.5 * width), ends[1].max(x + 0.5 * width)];
    }
    let within = |[low, high]: [f64; 2]| lever > low && lever < high;
    match (within(places), within(ends)) {
        (true, _) => Ok(()),
        (false, true) => Err(Refusal::OnCorner),
        (false, false) => Err(Refusal::Topples),
    }
}

/// A drive part of the way from another of its kind, or from nothing.
pub(super) fn between(start: Option<Drive>, drive: &Drive, f: f64) -> Drive {
    let mix = |a: f64, b: f64| a + f * (b - a);
    let mean = |a: Load, b: Load| Load {
        p_n_mm: mix(a.p_n_mm, b.p_n_mm),
        q_n_mm: mix(a.q_n_mm, b.q_n_mm),
    };
    match (*drive, start) {
        (Drive::Loads { load, height_mm }, Some(Drive::Loads { load: from, .. })) => {
            Drive::Loads { load: mean(from, load), height_mm }
        }
        (Drive::Loads { load, height_mm }, _) => {
            Drive::Loads { load: mean(Load::default(), load), height_mm }
        }
        (Drive::Upright(load), Some(Drive::Upright(from))) => Drive::Upright(mean(from, load)),
        (Drive::Upright(load), _) => Drive::Upright(mean(Load::default(), load)),
        (Drive::Move { .. } | Drive::Pose { .. }, _) => {
            let to = drive.pose().unwrap_or_default();
            let from = start.and_then(|start| start.pose()).unwrap_or_default();
            let [dz_mm, slope, dx_mm] = [0, 1, 2].map(|i| mix(from[i], to[i]));
            Drive::Pose { dz_mm, slope, dx_mm }
        }
    }
}

/// What a place does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Does not touch.
    Apart,
    /// Touches and sticks (or slides freely, without a law along x).
    Stick,
    /// Slips with shear towards +x on the layer.
    SlipForward,
    /// Slips with shear towards -x.
    SlipBack,
}

/// A place that comes to touch first does as its neighbour: a stick of its own, beside slip, would
/// be torn off again.
pub(super) fn entering(status: &[Status], i: usize) -> Status {
    let beside = |d: usize| [i.checked_sub(d), Some(i + d)];
    let of = |j: Option<usize>| j.and_then(|j| status.get(j)).copied();
    let mut near = (1..status.len()).flat_map(beside).filter_map(of);
    let touching = near.find(|s| *s != Status::Apart);
    touching.unwrap_or(Status::Stick)
}
