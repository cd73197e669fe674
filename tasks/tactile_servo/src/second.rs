//! The images of a second fingertip that touches the pin from the other side, for the law `model`.
//! Refuses an image that was not made with the finger's, and to be needed: without it the law goes
//! by the finger's alone.

use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Input, Invalid, Io, Output, Ports, StateHash};
use taktil_signal::{Pair, TactileImage};

use crate::config::Config;
use crate::drive::Drive;
use crate::law::model::jacobian::PITCH_MM;
use crate::law::model::opposed::{Opposed, Sight};
use crate::perception::line::Line;
use crate::perception::touch;

/// The other fingertip: its array by a port, its place and pad by the configuration.
pub(crate) struct Second {
    image: Input<TactileImage>,
    pair: Output<Pair>,
    opposed: Opposed,
    sight: Sight,
    touched: bool,
    /// The newest line, and when it was acquired.
    line: Option<(i64, Line)>,
    /// The column where the pin lay when it was first felt.
    lay: Option<f64>,
    /// Columns of the finger less its own when the pin was first felt by both.
    apart: Option<f64>,
}

impl Fold for Second {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.touched).add(&self.line.is_some()).add(&self.apart.is_some());
        hash.add(&self.apart.unwrap_or(0.0)).add(&self.lay.unwrap_or(0.0));
        if let Some((at, line)) = &self.line {
            hash.add(at).add(&line.features[..]);
        }
    }
}

impl Second {
    /// Declares `opposed` and `pair` where the configuration has a second fingertip; allocates.
    ///
    /// # Errors
    /// A layer that the theory of contact cannot take.
    pub(crate) fn new(config: &Config, ports: &mut Ports) -> Result<Option<Second>, Invalid> {
        let Some(opposed) = config.opposed else { return Ok(None) };
        let sight = opposed.sight(&config.model, config.m0_counts);
        Ok(Some(Second {
            image: ports.input("opposed"),
            pair: ports.output("pair"),
            opposed,
            sight: sight.map_err(|bad| bad.within("opposed"))?,
            touched: false,
            line: None,
            lay: None,
            apart: None,
        }))
    }

    /// Forgets, at the beginning of a stay.
    pub(crate) fn reset(&mut self) {
        (self.touched, self.line, self.apart) = (false, None, None);
    }

    /// Takes a new image in, where there is one.
    pub(crate) fn take(&mut self, config: &Config, law: &Drive, io: &mut Io<'_>) {
        let Some(image) = io.read(&self.image).fresh() else { return };
        let tactels = usize::from(image.rows) * usize::from(image.cols);
        let above = config.contact_above(image.noise_counts, tactels, self.touched);
        let touch = touch(&image, config.threshold(image.noise_counts), above);
        self.touched = touch.contact;
        let line = law.line_by(config, 1.0, &image, &touch).filter(|_| touch.trusted);
        self.line = line.map(|line| {
            let lay = *self.lay.get_or_insert(line.features[0]);
            (image.acquired_ns, self.sight.squeeze(&line, lay))
        });
    }

    /// The line of the image that was made with the finger's, which was acquired at `at_ns`.
    pub(crate) fn line(&self, config: &Config, at_ns: i64) -> Option<(Opposed, Line)> {
        let (own_ns, line) = self.line?;
        let near = (own_ns - at_ns).unsigned_abs() as f64 <= 0.5e6 * config.image_period_ms;
        near.then_some((self.opposed, line))
    }

    /// Says what both feel of the pin, with the finger at `tool`.
    pub(crate) fn report(
        &mut self,
        at_ns: i64,
        (own, other): (&Line, &Line),
        tool: &Pose,
        io: &mut Io<'_>,
    ) {
        let ([x, m0, m_x, theta], [x2, m02, m_x2, theta2]) = (own.features, other.features);
        let apart = *self.apart.get_or_insert(x - x2);
        let pair = Pair {
            acquired_ns: at_ns,
            m0: [m0, m02],
            m_x: [m_x, m_x2],
            x_c: [x, x2],
            theta_z_rad: [theta, theta2],
            theta_z_by_other_rad: self.opposed.theta_z_rad(other, tool),
            mismatch_mm: (x - x2 - apart) * PITCH_MM,
        };
        io.write(&self.pair, pair);
    }
}
