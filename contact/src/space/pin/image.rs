//! The image of a contact: the point loads that stand for its slices, and the mean stress that they
//! give each tactel. Nothing here allocates.

use super::super::tactels::Shares;
use super::contact::RowContact;
use super::line_loads::{image_cutoff, line_loads, line_spacing};
use super::pose::PlanarPose;
use super::solver::Pin;
use super::spread_loads::{has_halved_spacing, spread_loads};

impl Pin {
    /// Adds the image of the contact to `image`, stresses in MPa; nothing without contact, or when
    /// the pose is not finite.
    pub fn image(&self, shares: &Shares, pose: PlanarPose, image: &mut [f64]) {
        self.seen_loads(shares, pose, |place, force| shares.add(image, place, force));
    }

    /// Calls with place on the array in mm and force in N of the point loads that stand for the
    /// contact under its tactels, except those of slices that are too far off the array.
    pub(super) fn seen_loads(
        &self,
        shares: &Shares,
        pose: PlanarPose,
        mut of: impl FnMut([f64; 2], f64),
    ) {
        let (s, c) = (libm::sin(pose.rot_rad), libm::cos(pose.rot_rad));
        let place = |u: f64, v: f64| [pose.x_mm + u * c - v * s, pose.y_mm + u * s + v * c];
        let orientation = self.orientation();
        row_loads(
            self.used_row(),
            shares.mean_over_mm(),
            |[w, about_mm]| shares.sees(place(0.0, orientation.along_pin(w)), about_mm),
            |[u, w], force| of(place(u, orientation.along_pin(w)), force),
        );
    }

    /// Calls with place (across, along) in mm and force in N of point loads that stand for the
    /// contact.
    pub fn loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let orientation = self.orientation();
        let along_pin = |[u, w]: [f64; 2], force| of([u, orientation.along_pin(w)], force);
        row_loads(self.used_row(), None, |_| true, along_pin);
    }

    /// Length along the axis that each of [`Pin::loads`] stands for, mm: a slice's, or the distance
    /// of the lines that loads lie on. 0 without contact at a level of lines.
    #[must_use]
    pub fn load_length_mm(&self) -> f64 {
        let contact = self.used_row();
        let row = &contact.row;
        let spacing = match row.resolution.lines {
            Some(lines) => line_spacing(contact, image_cutoff(row, lines, None)),
            None if has_halved_spacing(row, image_cutoff(row, row.resolution.points, None)) => {
                0.5 * row.h
            }
            None => row.h,
        };
        spacing * row.layer.thickness_mm
    }
}

/// Calls with place (across, along) in mm and force in N of point loads that stand for the contact
/// of a row under tactels of `pitch_mm`, or under points of the base. Slices are left out that are
/// not `seen`, which is asked with their middle along the axis and their extent about it, mm.
fn row_loads(
    contact: &RowContact,
    pitch_mm: Option<f64>,
    seen: impl Fn([f64; 2]) -> bool,
    of: impl FnMut([f64; 2], f64),
) {
    let (row, resolution) = (&contact.row, contact.row.resolution);
    match resolution.lines {
        Some(lines) => line_loads(contact, image_cutoff(row, lines, pitch_mm), seen, of),
        None => spread_loads(contact, image_cutoff(row, resolution.points, pitch_mm), seen, of),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::radial::Influence;
    use super::super::super::tactels::{Array, Fineness, Sampling, Shares};
    use super::super::super::{Accuracy, Prescribed};
    use super::super::{Pin, PlanarPose, Profile};

    /// Most loads of an image, and most tactels that they add to.
    const LOADS_MAX: usize = 4000;
    const SEEN_MAX: usize = 110_000;

    /// Bounds the time of an image without a clock, by the number of its loads and of the tactels
    /// that they add to.
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
                    pin.press(Prescribed::PenetrationMm(0.05 * t), tilt_rad).expect("a contact");
                    let mut loads = 0;
                    let pose = PlanarPose { x_mm: 0.3, y_mm: -0.2, rot_rad };
                    pin.seen_loads(&shares, pose, |_, _| loads += 1);
                    let seen = loads * (shares.side() * shares.side()).min(array.len());
                    most = [most[0].max(loads), most[1].max(seen)];
                }
            }
        }
        assert!((500..LOADS_MAX).contains(&most[0]) && most[1] < SEEN_MAX, "{most:?}");
    }
}
