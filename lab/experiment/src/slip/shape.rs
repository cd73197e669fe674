//! Observes a run without noise for how the image changes by sliding: with that known, and white
//! noise on every tactel, the place of the load is known to the standard deviation of the noise
//! over the root of the sum of the squared changes (S. M. Kay, *Estimation Theory*, 1993, section
//! 3.9). A derivative of one image by differences of its tactels knows less of a sharp edge.

use taktil_lab_world::ObjectTruth;
use taktil_rtcore::payload::Field;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{FromRecord, Nanos, Payload};
use taktil_signal::TactileImage;

/// The change is taken from the first image after so much sliding to the first one after so much
/// (mm): far enough apart that whole counts hardly show, near enough that it is one of the begin.
const FIRST_MM: f64 = 0.05;
const SECOND_MM: f64 = 0.25;

/// An image, and how far the body had slid by then (mm).
struct SlidImage {
    slid_mm: f64,
    counts: Vec<f64>,
}

/// Keeps two images.
pub(crate) struct ShapeWatch {
    object: Option<usize>,
    image: Option<(usize, Vec<Field>)>,
    from: Nanos,
    last: Option<Nanos>,
    slid_mm: f64,
    first: Option<SlidImage>,
    second: Option<SlidImage>,
}

impl ShapeWatch {
    pub(crate) fn new(catalog: &Catalog, from: Nanos) -> ShapeWatch {
        let image = catalog.find("tactile_scan.image");
        ShapeWatch {
            object: catalog.find("world.object"),
            image: image.map(|id| (id, catalog.signals[id].fields.to_vec())),
            from,
            last: None,
            slid_mm: 0.0,
            first: None,
            second: None,
        }
    }

    fn take_image(&mut self, image: &TactileImage) {
        let next = || SlidImage {
            slid_mm: self.slid_mm,
            counts: image.counts.iter().map(|counts| f64::from(*counts)).collect(),
        };
        if self.first.is_none() && self.slid_mm >= FIRST_MM {
            self.first = Some(next());
        } else if self.second.is_none() && self.slid_mm >= SECOND_MM {
            self.second = Some(next());
        }
    }

    /// Standard deviation of the place along the slip at the best (mm) in noise of this standard
    /// deviation (counts), with the load as a whole unknown.
    pub(crate) fn place_bound_mm(&self, noise_counts: f64) -> Option<f64> {
        let (first, second) = (self.first.as_ref()?, self.second.as_ref()?);
        let way_mm = second.slid_mm - first.slid_mm;
        let (mut changes, mut loads, mut both) = (0.0, 0.0, 0.0);
        for (a, b) in first.counts.iter().zip(&second.counts) {
            let (change, load) = ((b - a) / way_mm, 0.5 * (a + b));
            changes += change * change;
            loads += load * load;
            both += change * load;
        }
        let bound = noise_counts / (changes - both * both / loads).sqrt();
        Some(bound).filter(|bound| bound.is_finite())
    }
}

impl Observer for ShapeWatch {
    fn record(&mut self, record: &Record<'_>) {
        if Some(record.signal) == self.object {
            if let Some(object) = ObjectTruth::decode(record.body) {
                let t = Nanos(object.t_ns);
                let since_s = self.last.map_or(0.0, |last| (t - last).as_secs_f64());
                self.last = Some(t);
                if t >= self.from {
                    self.slid_mm += 1e3 * object.slip_m_s * since_s;
                }
            }
        } else if let Some((image, fields)) = &self.image
            && record.signal == *image
            && let Some(image) = TactileImage::from_record(fields, record.body)
        {
            self.take_image(&image);
        }
    }
}
