//! Memory of the solver in [`super::solve`], and why it may have no answer.

use super::super::{Drive, Refusal, Why};
use super::direct::Dense;
use super::mixed::Mixed;
use super::strip::{Places, Strips};

/// Least and largest part of a change that a short row takes.
const RELAXED: [f64; 2] = [0.15, 1.5];

/// The same for each slice on its own, and what it becomes after a change that goes the other way
/// or the same way as the one before.
const EACH: [f64; 2] = [0.02, 0.7];
const SWINGING: f64 = 0.6;
const STEADY: f64 = 1.2;
/// On a row that is not short a slice takes all of its change, unless that goes the other way by
/// more than this part of the one before.
const SWUNG: f64 = 0.5;

/// A bar's slice that was let go of so many times stays in the air.
const DROPS: u8 = 2;

/// Memory of the solver; everything is slice after slice.
#[derive(Clone, Debug)]
pub(super) struct Work {
    pub(super) places: Places,
    pub(super) transform: usize,
    /// Penetration that each slice's width belongs to; 0 or less: no contact.
    pub(super) effective: Vec<f64>,
    /// Penetration of the rigid pin.
    pub(super) given: Vec<f64>,
    pub(super) widths: Vec<f64>,
    pub(super) active: Vec<bool>,
    pub(super) rows: Vec<f64>,
    pub(super) transforms: Vec<f64>,
    pub(super) blocks: Vec<f64>,
    /// Cosines of the pressure, and the vectors of conjugate gradients.
    pub(super) a: Vec<f64>,
    pub(super) residual: Vec<f64>,
    pub(super) cured: Vec<f64>,
    pub(super) direction: Vec<f64>,
    pub(super) image: Vec<f64>,
    pub(super) warm: bool,
    /// Whether the widths were read, so that nothing else here belongs to them.
    pub(super) read: bool,
    /// Whether the search begins at widths that were read, near those that are searched for.
    pub(super) begun: bool,
    pub(super) dense: Dense,
    /// Half-widths that the slices' own blocks were factored for.
    pub(super) blocked: Vec<f64>,
    /// Rate of the last contact's force over that of independent slices; 0 when not known.
    pub(super) stiffness: f64,
    /// Changes of the widths' penetrations, this step's and the last one's, and the part of them
    /// that is taken; 0 where all of it always is.
    pub(super) moves: [Vec<f64>; 2],
    pub(super) relaxed: f64,
    /// What the penetration changed by before this step; 0 where the step itself changes it.
    pub(super) shifted: f64,
    /// The part that each slice takes of its own, where they are not one; empty where they are.
    pub(super) parts: Vec<f64>,
    /// How often a bar's slice was let go of since the contact was laid.
    pub(super) dropped: Vec<u8>,
    /// Steps of all widths by what the last ones did.
    pub(super) mixed: Mixed,
}

impl Work {
    pub(super) fn new(slices: usize, strips: &Strips, (transform, room): (usize, usize)) -> Self {
        let (places, free) = (strips.places, strips.is_free());
        let n = places.cosines;
        let per = |count: usize| vec![0.0; slices * count];
        Self {
            places,
            transform,
            effective: per(1),
            given: per(1),
            widths: per(1),
            active: vec![false; slices],
            rows: per(places.len()),
            transforms: per(transform),
            blocks: per(n * n),
            a: per(n),
            residual: per(n),
            cured: per(n),
            direction: per(n),
            image: per(n),
            warm: false,
            read: false,
            begun: false,
            dense: Dense::new(slices, n, (free, room)),
            blocked: per(1),
            stiffness: 0.0,
            moves: [per(1), per(1)],
            relaxed: 0.0,
            shifted: 0.0,
            parts: Vec::new(),
            dropped: vec![0; slices],
            mixed: Mixed::new(slices),
        }
    }

    /// On a row that is short the slices do not respond as plane ones: the part of a change that is
    /// taken then follows from the last two (Aitken's rule).
    pub(super) fn relax(&mut self) {
        self.relaxed = 1.0;
    }

    /// Slice by slice: less of a change that swings, more of one that does not.
    pub(super) fn relax_each(&mut self) {
        self.parts = vec![1.0; self.active.len()];
    }

    /// The part of the changes that all slices take; 1 where each has its own.
    pub(super) fn relaxation(&mut self, first: bool) -> f64 {
        if !self.parts.is_empty() {
            let (most, swung, shifted) =
                if self.relaxed == 0.0 { (1.0, SWUNG, self.shifted) } else { (EACH[1], 0.0, 0.0) };
            let [now, before] = &self.moves;
            for (part, (now, before)) in self.parts.iter_mut().zip(now.iter().zip(before)) {
                // What the penetration moved by is no swing of a slice's own.
                let least = (swung * before.abs()).max(shifted);
                let swings = now * before < 0.0 && now.abs() > least;
                let changed = if swings { SWINGING } else { STEADY };
                *part = if first { most } else { (*part * changed).clamp(EACH[0], most) };
            }
            return 1.0;
        }
        if self.relaxed == 0.0 {
            return 1.0;
        }
        if first {
            self.relaxed = 1.0;
            return 1.0;
        }
        let (mut along, mut size) = (0.0, 0.0);
        let [now, before] = &self.moves;
        for (now, before) in now.iter().zip(before) {
            along += before * (now - before);
            size += (now - before) * (now - before);
        }
        if size > 0.0 {
            self.relaxed = (-self.relaxed * along / size).clamp(RELAXED[0], RELAXED[1]);
        }
        self.relaxed
    }

    /// Whether a slice stays in the air though the layer may reach its middle: beside a wide bar
    /// the rubber bulges there, while the slice as a whole was pulled whenever it touched.
    pub(super) fn stays_off(&self, slice: usize) -> bool {
        self.dropped[slice] >= DROPS
    }

    /// Lets every slice come back; whether there were some that could not.
    pub(super) fn let_back(&mut self) -> bool {
        let some = (0..self.dropped.len()).any(|slice| self.stays_off(slice));
        self.dropped.fill(0);
        some
    }

    /// Prescribes a descent on some slices, where they touch whatever comes.
    pub(super) fn hold(&mut self, descent: impl Fn(usize) -> Option<f64>) {
        for j in 0..self.active.len() {
            let held = descent(j);
            self.active[j] = held.is_some();
            self.given[j] = held.unwrap_or(0.0);
            self.effective[j] = self.given[j];
        }
    }

    /// Largest penetration of the rigid pin.
    pub(super) fn deepest(&self) -> f64 {
        self.given.iter().fold(0.0_f64, |most, given| most.max(*given))
    }

    pub(super) fn clear(&mut self) {
        self.warm = false;
        self.read = false;
        self.begun = false;
        self.stiffness = 0.0;
        self.active.fill(false);
        self.a.fill(0.0);
        self.blocked.fill(0.0);
    }

    pub(super) fn is_warm(&self) -> bool {
        self.warm
    }

    pub(super) fn touches(&self, slice: usize) -> bool {
        self.active[slice]
    }

    /// Half-width in thicknesses and cosines of a slice.
    pub(super) fn slice(&self, slice: usize) -> (f64, &[f64]) {
        let n = self.places.cosines;
        (self.widths[slice], &self.a[slice * n..(slice + 1) * n])
    }

    pub(super) fn row(&self, slice: usize) -> &[f64] {
        let width = self.places.len();
        &self.rows[slice * width..(slice + 1) * width]
    }
}

/// Why a row has no answer.
#[derive(Clone, Copy, Debug)]
pub(super) enum Trouble {
    /// Beyond its tables.
    Beyond,
    /// It fills a row that is not the whole pin; the penetration at the origin that it came to.
    Filled(f64),
    /// So much of the penetration is left: no contact.
    Unsettled(f64),
    /// The slices' system is not positive.
    Indefinite,
}

impl Trouble {
    /// Of what was asked for.
    pub(super) fn refused(self, drive: Drive) -> Refusal {
        match self {
            Self::Beyond | Self::Filled(_) => Refusal::new(drive.place(), Why::Table),
            Self::Unsettled(left) => Refusal::new("length_mm", Why::Unsettled(left)),
            Self::Indefinite => Refusal::new(drive.place(), Why::Indefinite),
        }
    }
}
