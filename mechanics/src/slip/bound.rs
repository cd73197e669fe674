//! The soonest that sliding can be noticed, whatever the test: the delay of the matched filter that
//! knows direction and speed of the slip and the place before it without error, and may give one
//! false alarm in so many hours (Neyman and Pearson, Phil. Trans. A 231, 1933; for a known signal
//! in white noise the test on the matched filter is the most powerful one).

use super::{normal_quantile, normal_tail};

/// Instants between two frames at which the slip may begin, over which the bound is a mean.
const ONSET_COUNT: usize = 64;
/// Frames after which a slip counts as never noticed.
const FRAMES_MAX: usize = 2_000;

/// What limits the test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameLimits {
    /// Standard deviation of the place along the slip in one frame (mm).
    pub place_mm: f64,
    /// Time between two frames (s).
    pub frame_s: f64,
    /// From a frame's instant to the job that may act by it (s).
    pub latency_s: f64,
    /// False alarms that are allowed in an hour.
    pub false_alarms_per_h: f64,
}

/// The delay (s) within which a share of all slips of this speed (mm/s), which begin at any instant
/// between two frames, can be noticed at the best; infinite where the numbers define none.
///
/// Slip that began `u` before a frame has gone by `v (u + j T)` in the frames that follow, so that
/// the matched filter's distance is the root of the sum of their squares over the noise, and its
/// power `Q(z_false - distance)`.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "small counts")]
pub fn delay_s(limits: &FrameLimits, speed_mm_s: f64, share: f64) -> f64 {
    let FrameLimits { place_mm, frame_s, latency_s, false_alarms_per_h } = *limits;
    let alarm = false_alarms_per_h * frame_s / 3600.0;
    let usable = speed_mm_s > 0.0 && place_mm > 0.0 && frame_s > 0.0 && alarm > 0.0 && alarm < 0.5;
    if !usable || !(0.0..1.0).contains(&share) || !speed_mm_s.is_finite() {
        return f64::INFINITY;
    }
    let z_false = normal_quantile(alarm);
    // Squares of the distances so far, and the powers that they give, for each onset.
    let mut squares = [0.0; ONSET_COUNT];
    let mut powers = [0.0; ONSET_COUNT];
    for frame in 0..FRAMES_MAX {
        // Onsets close before a frame come first: they have waited the shortest time.
        for onset in 0..ONSET_COUNT {
            let since_s = frame_s * (frame as f64 + (onset as f64 + 0.5) / ONSET_COUNT as f64);
            let distance = speed_mm_s * since_s / place_mm;
            squares[onset] += distance * distance;
            powers[onset] = normal_tail(z_false - libm::sqrt(squares[onset]));
            let mean = powers.iter().sum::<f64>() / ONSET_COUNT as f64;
            if mean >= share {
                return since_s + latency_s;
            }
        }
    }
    f64::INFINITY
}

/// The probability with which the matched filter that knows the path of a slip has noticed it in
/// frames by which it had gone so far: `squares_mm2` is the sum of the squares of these distances
/// (mm^2). 0 where the numbers define none.
#[must_use]
pub fn path_power(limits: &FrameLimits, squares_mm2: f64) -> f64 {
    let FrameLimits { place_mm, frame_s, false_alarms_per_h, .. } = *limits;
    let alarm = false_alarms_per_h * frame_s / 3600.0;
    if !(place_mm > 0.0 && alarm > 0.0 && alarm < 0.5 && squares_mm2 > 0.0) {
        return 0.0;
    }
    normal_tail(normal_quantile(alarm) - libm::sqrt(squares_mm2) / place_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: FrameLimits =
        FrameLimits { place_mm: 0.05, frame_s: 0.005, latency_s: 0.0, false_alarms_per_h: 1.0 };

    #[test]
    fn without_noise_the_next_frame_tells_and_with_it_slow_slips_take_longer() {
        let quiet = FrameLimits { place_mm: 1e-9, ..LIMITS };
        // 95 % of the onsets have met a frame after 95 % of the time between two.
        assert!((delay_s(&quiet, 20.0, 0.95) - 0.95 * 0.005).abs() < 2e-4);
        let delays = [50.0, 20.0, 5.0, 2.0].map(|speed| delay_s(&LIMITS, speed, 0.95));
        assert!(delays.is_sorted() && delays[0] > 0.004, "{delays:?}");
        // Far from the frame time the delay grows by the speed to the power -2/3.
        let slow = [0.02, 0.01].map(|speed| delay_s(&LIMITS, speed, 0.95));
        assert!((slow[1] / slow[0] - 1.587).abs() < 0.05, "{slow:?}");
    }

    #[test]
    fn the_power_on_a_path_is_the_one_that_the_delay_is_for() {
        for (place_mm, speed_mm_s) in [(0.05, 20.0), (0.03, 5.0), (0.06, 50.0)] {
            let limits = FrameLimits { place_mm, ..LIMITS };
            let within_s = delay_s(&limits, speed_mm_s, 0.95);
            // Onsets at 200 instants between two frames.
            let share = (0..200).map(|onset| {
                let since_s =
                    |frame: i32| 0.005 * (f64::from(frame) + (f64::from(onset) + 0.5) / 200.0);
                let frames = (0..100).map(since_s).take_while(|since_s| *since_s <= within_s);
                let gone_mm = frames.map(|since_s| speed_mm_s * since_s);
                path_power(&limits, gone_mm.map(|gone_mm| gone_mm * gone_mm).sum())
            });
            // The delay is one of 64 instants between two frames.
            let share = share.sum::<f64>() / 200.0;
            assert!((share - 0.95).abs() < 0.02, "{place_mm}, {speed_mm_s}: {share}");
        }
        assert!(path_power(&LIMITS, 1.0) > 0.999 && path_power(&LIMITS, 1e-6) < 1e-5);
        for bad in [f64::NAN, 0.0, -1.0] {
            assert_eq!(path_power(&LIMITS, bad), 0.0, "{bad}");
            assert_eq!(path_power(&FrameLimits { place_mm: bad, ..LIMITS }, 1.0), 0.0, "{bad}");
        }
    }

    #[test]
    fn numbers_that_define_no_delay_give_infinity() {
        for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            assert_eq!(delay_s(&LIMITS, bad, 0.95), f64::INFINITY, "{bad}");
            let noisy = FrameLimits { place_mm: bad, ..LIMITS };
            assert_eq!(delay_s(&noisy, 20.0, 0.95), f64::INFINITY, "{bad}");
        }
        assert_eq!(delay_s(&LIMITS, 20.0, f64::NAN), f64::INFINITY);
    }
}
