//! The image of a contact: point loads that stand for its slices, and what tactels see of them. It
//! refuses nothing and allocates nothing.

use super::super::tactels::Shares;
use super::row::Row;
use super::{Pin, Stand};

impl Pin {
    /// Adds the image of the contact to `image`, stresses in MPa; nothing without contact, or when
    /// the stand is not finite.
    pub fn image(&self, shares: &Shares, stand: Stand, image: &mut [f64]) {
        self.seen_loads(shares, stand, |place, force| shares.add(image, place, force));
    }

    /// Calls with place on the array in mm and force in N of the point loads that stand for the
    /// contact under its tactels, save those of slices that are too far off it.
    pub(super) fn seen_loads(
        &self,
        shares: &Shares,
        stand: Stand,
        mut of: impl FnMut([f64; 2], f64),
    ) {
        let (s, c) = (libm::sin(stand.rot_rad), libm::cos(stand.rot_rad));
        let place = |u: f64, v: f64| [stand.x_mm + u * c - v * s, stand.y_mm + u * s + v * c];
        let lie = self.lie();
        self.rows[self.at].loads(
            shares.mean_over_mm(),
            |[w, about_mm]| shares.sees(place(0.0, lie.place(w)), about_mm),
            |[u, w], force| of(place(u, lie.place(w)), force),
        );
    }

    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact.
    pub fn loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let lie = self.lie();
        self.rows[self.at].loads(None, |_| true, |[u, w], force| of([u, lie.place(w)], force));
    }

    /// Length along the axis that each of [`Pin::loads`] stands for, mm: a slice's, or the distance
    /// of the lines that loads lie on. 0 without contact at a level of lines.
    #[must_use]
    pub fn load_length_mm(&self) -> f64 {
        let row = &self.rows[self.at];
        let apart = match row.fineness.lines {
            Some(lines) => row.lines_apart(row.cutoff(lines, None)),
            None if row.halved(row.cutoff(row.fineness.points, None)) => 0.5 * row.h,
            None => row.h,
        };
        apart * row.layer.thickness_mm
    }
}

impl Row {
    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact under tactels of `pitch_mm`, or under points of the base. Left out is what is not
    /// `seen`: its middle along the axis and its reach about that, mm.
    fn loads(
        &self,
        pitch_mm: Option<f64>,
        seen: impl Fn([f64; 2]) -> bool,
        of: impl FnMut([f64; 2], f64),
    ) {
        match self.fineness.lines {
            Some(lines) => self.lined_loads(self.cutoff(lines, pitch_mm), seen, of),
            None => self.spread_loads(self.cutoff(self.fineness.points, pitch_mm), seen, of),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::Drive;
    use super::super::super::radial::Influence;
    use super::super::super::tactels::{Array, Fineness, Sampling};
    use super::super::Profile;
    use super::*;
    use crate::Accuracy;

    /// Most loads of an image, and most tactels that they add to.
    const LOADS_MAX: usize = 4000;
    const SEEN_MAX: usize = 110_000;

    /// The time of an image without a clock: its loads, and the tactels that they add to.
    #[test]
    fn wide_bars_on_thin_layers_take_few_loads() {
        let mut most = [0, 0];
        for t in [0.3, 0.36, 0.8, 1.2, 2.3] {
            let layer = Layer::new(t, 27.58, 0.5).expect("a sound layer");
            let influence = Influence::new(&layer).expect("a layer");
            let (array, area) = (Array::THESIS, Sampling::Area);
            let shares = Shares::new(&influence, &array, area, Fineness::FAST).expect("tables");
            for (width_mm, length_mm) in [(12.0, 24.0), (8.0, 36.0)] {
                let (profile, ends) =
                    (Profile::Bar { width_mm }, [-0.5, 0.5].map(|p| p * length_mm));
                let mut pin =
                    Pin::new(&layer, profile, ends, 0.1 * t, Accuracy::Fast).expect("a bar");
                for (rot_rad, tilt_rad) in [(0.0, 0.0), (0.785, 0.0), (1.2, 0.2 * t / length_mm)] {
                    pin.press(Drive::PenetrationMm(0.05 * t), tilt_rad).expect("a contact");
                    let mut loads = 0;
                    let stand = Stand { x_mm: 0.3, y_mm: -0.2, rot_rad };
                    pin.seen_loads(&shares, stand, |_, _| loads += 1);
                    let seen = loads * (shares.side() * shares.side()).min(array.len());
                    most = [most[0].max(loads), most[1].max(seen)];
                }
            }
        }
        assert!((500..LOADS_MAX).contains(&most[0]) && most[1] < SEEN_MAX, "{most:?}");
    }
}
