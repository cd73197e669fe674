//! Drawn pins and bars: any size, layer and pose, from lying on their whole length to standing on a
//! corner, and a much finer solution of each. Shared by the test and the timed sweep.

use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::scene::Pose;
use taktil_contact::space::{Prescribed, tactels::Shares};

pub(crate) struct Draws(pub(crate) u64);

impl Draws {
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        low + (high - low) * f64::from((self.0 >> 33) as u32) / f64::from(1_u32 << 31)
    }

    fn over_decades(&mut self, low: f64, high: f64) -> f64 {
        libm::exp(self.between(libm::log(low), libm::log(high)))
    }

    /// Rubber 0.3 to 2.3 mm thick, every fourth time of Poisson's ratio 0.5.
    pub(crate) fn rubber(&mut self) -> Layer {
        let nu = self.between(0.0, 2.0 / 3.0).min(0.5);
        Layer::new(self.between(0.3, 2.3), 27.58, nu).expect("a sound layer")
    }

    /// Side of a tactel, 0.5 to 2.5 mm.
    pub(crate) fn pitch_mm(&mut self) -> f64 {
        self.between(0.5, 2.5)
    }

    /// A pin or a bar 18 to 70 thicknesses long, lying or touching on half of its length or more,
    /// its deeper end over 16 by 16 tactels.
    pub(crate) fn long(&mut self, rubber: Layer, pitch_mm: f64) -> Drawn {
        let t = rubber.thickness_mm;
        let length_mm = t * self.between(18.0, 70.0);
        let depth_mm = t * self.between(0.01, 0.1);
        let profile = if self.between(0.0, 2.0) < 1.0 {
            Profile::Bar { width_mm: self.between(0.4, 8.0) }
        } else {
            Profile::Cylinder { radius_mm: self.between(2.0, 45.0) }
        };
        let lying = self.between(0.0, 1.0) < 0.4;
        let touched_mm = length_mm * self.between(0.5, 2.5);
        let sign = if self.between(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        let slope = if lying { 0.0 } else { depth_mm / touched_mm };
        let rot_rad = self.between(-1.6, 1.6);
        let away = sign * 0.5 * length_mm;
        let (s, c) = (libm::sin(rot_rad), libm::cos(rot_rad));
        let reach = 0.8 * 8.0 * pitch_mm;
        let (x_mm, y_mm) =
            (self.between(-reach, reach) + away * s, self.between(-reach, reach) - away * c);
        let planar = PlanarPose { x_mm, y_mm, rot_rad };
        let delta_mm = depth_mm - 0.5 * length_mm * slope;
        let pose = Pose { planar, tilt_rad: sign * libm::atan(slope) };
        let (touched_mm, made_mm) = (2.0 * length_mm, (2.0 * depth_mm).min(0.9 * t));
        Drawn { rubber, profile, length_mm, touched_mm, made_mm, delta_mm, pose }
    }

    /// A pin, every third time a bar, that touches on some part of its length.
    pub(crate) fn pin(&mut self, rubber: Layer) -> Drawn {
        self.pin_within(rubber, [40.0, 8.0])
    }

    /// The same up to a length and a bar's width, mm.
    pub(crate) fn pin_within(&mut self, rubber: Layer, largest: [f64; 2]) -> Drawn {
        let depth = |draws: &mut Self| draws.between(0.01, 0.1);
        self.pressed(rubber, largest, depth)
    }

    /// A pin, every third time a bar, pressed far less than the 0.1 to 0.3 thicknesses that its
    /// tables are made for.
    pub(crate) fn shallow(&mut self, rubber: Layer) -> Drawn {
        let depth = |draws: &mut Self| draws.over_decades(5e-4, 5e-2);
        let mut drawn = self.pressed(rubber, [40.0, 8.0], depth);
        let deepest = match drawn.profile {
            Profile::Cylinder { radius_mm } => 0.3 * radius_mm,
            _ => f64::INFINITY,
        };
        drawn.made_mm = (rubber.thickness_mm * self.between(0.1, 0.3)).min(deepest);
        drawn
    }

    fn pressed(
        &mut self,
        rubber: Layer,
        [longest, widest]: [f64; 2],
        depth: impl Fn(&mut Self) -> f64,
    ) -> Drawn {
        let t = rubber.thickness_mm;
        let length_mm = self.between(3.0, longest).max(t);
        let bar = self.between(0.0, 3.0) < 1.0;
        let depth_mm = t * depth(self);
        let profile = if bar {
            Profile::Bar { width_mm: self.between(0.4, widest) }
        } else {
            Profile::Cylinder { radius_mm: self.between(2.0, 45.0) }
        };
        let steepest = libm::tan(0.19) / depth_mm;
        let touched_mm = (length_mm * self.over_decades(0.003, 4.0)).max(1.0 / steepest);
        let sign = if self.between(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        let slope = depth_mm / touched_mm;
        let rot_rad = self.between(-1.6, 1.6);
        // The middle of what touches stands near the middle of the array.
        let away = sign * (0.5 * length_mm - 0.5 * touched_mm.min(length_mm));
        let (s, c) = (libm::sin(rot_rad), libm::cos(rot_rad));
        let (x_mm, y_mm) = (self.between(-5.0, 5.0) + away * s, self.between(-5.0, 5.0) - away * c);
        let planar = PlanarPose { x_mm, y_mm, rot_rad };
        let delta_mm = depth_mm - 0.5 * length_mm * slope;
        let pose = Pose { planar, tilt_rad: sign * libm::atan(slope) };
        let made_mm = (2.0 * depth_mm).min(0.9 * t);
        Drawn { rubber, profile, length_mm, touched_mm, made_mm, delta_mm, pose }
    }
}

#[derive(Debug)]
pub(crate) struct Drawn {
    pub(crate) rubber: Layer,
    profile: Profile,
    pub(crate) length_mm: f64,
    touched_mm: f64,
    /// Depth that its tables are made for.
    made_mm: f64,
    /// Penetration at the middle.
    pub(crate) delta_mm: f64,
    pub(crate) pose: Pose,
}

impl Drawn {
    /// The pin.
    pub(crate) fn pin(&self, level: Accuracy) -> Pin {
        self.part(self.length_mm, self.made_mm, level)
    }

    /// Whether it is a bar.
    pub(crate) fn is_bar(&self) -> bool {
        matches!(self.profile, Profile::Bar { .. })
    }

    /// Whether less than a thickness of the pin touches.
    pub(crate) fn on_corner(&self) -> bool {
        self.touched_mm < self.rubber.thickness_mm
    }

    /// Depth of the end that touches, mm.
    fn depth_mm(&self) -> f64 {
        let far = 0.5 * self.pose.tilt_rad.signum() * self.length_mm;
        self.delta_mm + libm::tan(self.pose.tilt_rad) * far
    }

    /// A part of the pin, of a length from the end that touches, with tables for a depth.
    fn part(&self, length_mm: f64, made_mm: f64, level: Accuracy) -> Pin {
        let sign = self.pose.tilt_rad.signum();
        let far = 0.5 * sign * self.length_mm;
        let near = far - sign * length_mm;
        let ends = [far.min(near), far.max(near)];
        Pin::new(&self.rubber, self.profile, ends, made_mm, level).expect("a pin")
    }

    /// Force and image of a pin that is there only where it touches, and a little further, its
    /// tables made for twice its depth.
    pub(crate) fn exact(&self, level: Accuracy, shares: &Shares, image: &mut [f64]) -> f64 {
        let t = self.rubber.thickness_mm;
        let length = self.length_mm.min(1.4 * self.touched_mm + t);
        let made_mm = (2.0 * self.depth_mm()).min(0.9 * t);
        let mut pin = self.part(length, made_mm, level);
        let drive = Prescribed::PenetrationMm(self.delta_mm);
        let state = pin.press(drive, self.pose.tilt_rad).expect("a contact");
        let cut = length < self.length_mm && state.length_mm > 0.97 * length;
        assert!(!cut, "{self:?} touches further than it should: {state:?}");
        image.fill(0.0);
        pin.image(shares, self.pose.planar, image);
        state.force_n
    }
}
