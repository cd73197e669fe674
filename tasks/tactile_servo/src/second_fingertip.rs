//! The images of a second fingertip that touches the pin from the other side, for the law `model`.
//! An image counts only when it was made at the time of the finger's image; without one the law
//! goes by the finger's image alone.

use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Input, Invalid, Io, Output, Ports, Sample, StateHash};
use taktil_signal::{FingertipPair, TactileImage};

use crate::config::Config;
use crate::config::opposed::OpposedFingertip;
use crate::law::model::opposed::{ArrayResponse, theta_z_rad};
use crate::law::{Fingertip, Law};
use crate::perception::line::Line;
use crate::perception::touch_features;

/// The other fingertip: the image of its array from a port, its place and pad from the
/// configuration.
pub(crate) struct SecondFingertip {
    image: Input<TactileImage>,
    pair: Output<FingertipPair>,
    fingertip: OpposedFingertip,
    /// Distance of the finger's columns (mm).
    pitch_mm: f64,
    response: ArrayResponse,
    in_contact: bool,
    /// The newest line, and when it was acquired.
    line: Option<(i64, Line)>,
    /// Column of the pin in the first image with a line: the pin lay there when the baseline was
    /// taken.
    baseline_column: Option<f64>,
    /// Column of the finger's line minus that of this fingertip, when both first had a line.
    column_offset: Option<f64>,
}

impl Fold for SecondFingertip {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.in_contact).add(&self.line.is_some()).add(&self.column_offset.is_some());
        hash.add(&self.column_offset.unwrap_or(0.0)).add(&self.baseline_column.unwrap_or(0.0));
        if let Some((at, line)) = &self.line {
            hash.add(at).add(&line.features[..]);
        }
    }
}

impl SecondFingertip {
    /// Declares `opposed` and `fingertip_pair` where the configuration has a second fingertip;
    /// allocates.
    ///
    /// # Errors
    /// A layer that the theory of contact cannot take.
    pub(crate) fn new(
        config: &Config,
        ports: &mut Ports,
    ) -> Result<Option<SecondFingertip>, Invalid> {
        let Some(opposed) = config.opposed else { return Ok(None) };
        let response = ArrayResponse::new(&opposed, &config.model, config.m0_counts);
        Ok(Some(SecondFingertip {
            image: ports.array_input("opposed"),
            pair: ports.output("fingertip_pair"),
            fingertip: opposed,
            pitch_mm: config.array.pitch_x_mm,
            response: response.map_err(|bad| bad.within("opposed"))?,
            in_contact: false,
            line: None,
            baseline_column: None,
            column_offset: None,
        }))
    }

    /// Resets the state when the state TACTILE-SERVO is entered.
    pub(crate) fn reset(&mut self) {
        (self.in_contact, self.line, self.column_offset) = (false, None, None);
    }

    /// Reads a new image, if there is one.
    pub(crate) fn read_image(&mut self, config: &Config, law: &mut dyn Law, io: &mut Io<'_>) {
        let Some(image) = io.view(&self.image).and_then(Sample::fresh) else { return };
        let tactels = usize::from(image.rows) * usize::from(image.cols);
        let above = config.contact_limit_counts(image.noise_counts, tactels, self.in_contact);
        let threshold = config.threshold(image.noise_counts);
        let touch = touch_features(image, &self.fingertip.array, threshold, above);
        self.in_contact = touch.contact;
        let line = law.line(config, image, &touch, Fingertip::Opposed).filter(|_| touch.trusted);
        self.line = line.map(|line| {
            let baseline_column = *self.baseline_column.get_or_insert(line.features[0]);
            (image.acquired_ns, self.response.squeezing_line(&line, baseline_column))
        });
    }

    /// The line of the image that was made with the finger's, which was acquired at `at_ns`.
    pub(crate) fn line(&self, config: &Config, at_ns: i64) -> Option<(OpposedFingertip, Line)> {
        let (own_ns, line) = self.line?;
        let near = (own_ns - at_ns).unsigned_abs() as f64 <= 0.5e6 * config.image_period_ms;
        near.then_some((self.fingertip, line))
    }

    /// Reports what both fingertips measure of the pin, with the finger at `tool`.
    pub(crate) fn report(
        &mut self,
        at_ns: i64,
        finger: &Line,
        opposed: &Line,
        tool: &Pose,
        io: &mut Io<'_>,
    ) {
        let pitch_mm = self.pitch_mm;
        let ([x, m0, m_x, theta], [x2, m02, m_x2, theta2]) = (finger.features, opposed.features);
        // In columns of the finger.
        let x2_here = x2 * (self.fingertip.array.pitch_x_mm / pitch_mm);
        let column_offset = *self.column_offset.get_or_insert(x - x2_here);
        let pair = FingertipPair {
            acquired_ns: at_ns,
            m0: [m0, m02],
            m_x: [m_x, m_x2],
            x_c: [x, x2],
            theta_z_rad: [theta, theta2],
            theta_z_by_other_rad: theta_z_rad(&self.fingertip, opposed, tool),
            mismatch_mm: (x - x2_here - column_offset) * pitch_mm,
        };
        io.write(&self.pair, pair);
    }
}
