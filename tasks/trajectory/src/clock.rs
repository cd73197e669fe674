//! The time of a path, which can be stopped and started again independently of the real time, and
//! with it the motion along the path. Its rate falls and rises as the speed does in Paul's
//! transitions, so that the acceleration of the arm is as continuous as on the path itself. The
//! time never runs backwards, and a transition of the rate is finished before the next one begins.
//!
//! With `q(s)` the path, `s` its time and `r = ds/dt`: `dq/dt = r q'`, `d2q/dt2 = r^2 q'' + dr/dt
//! q'`. Coming to rest takes two tau and one tau of the path's time, and at most `3/4 q'/tau` of
//! acceleration, which is what Paul's transition to rest asks for.

use taktil_mechanics::paul::Setpoint;
use taktil_rtcore::{Fold, StateHash};

/// A transition of the rate between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ramp {
    /// The part of the transition that has passed, 0 to 1.
    h: f64,
    /// Half its time (s).
    tau_s: f64,
    /// Whether the rate rises to 1; otherwise it falls to 0.
    up: bool,
}

/// The clock of one path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    t_s: f64,
    rate: f64,
    /// Change of the rate (1/s).
    slope: f64,
    ramp: Option<Ramp>,
    wanted: bool,
}

impl Clock {
    /// At the beginning of a path, running or at rest.
    #[must_use]
    pub fn new(running: bool) -> Clock {
        let rate = f64::from(u8::from(running));
        Clock { t_s: 0.0, rate, slope: 0.0, ramp: None, wanted: running }
    }

    /// Running, at `t_s` (s) of a path.
    #[must_use]
    pub fn running_at(t_s: f64) -> Clock {
        Clock { t_s, ..Clock::new(true) }
    }

    /// The path's time (s).
    #[must_use]
    pub fn t_s(&self) -> f64 {
        self.t_s
    }

    /// True when the path's time runs as fast as the real time.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.ramp.is_none() && self.rate > 0.0
    }

    /// True when the path's time stands.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.ramp.is_none() && self.rate == 0.0
    }

    /// Runs, or comes to rest, from now on.
    pub fn set_running(&mut self, running: bool) {
        self.wanted = running;
    }

    /// Advances by `dt_s` (s) of real time; coming to rest takes two `tau_s` (s).
    pub fn advance(&mut self, dt_s: f64, tau_s: f64) {
        if self.ramp.is_none() && self.wanted != (self.rate > 0.0) {
            self.ramp = Some(Ramp { h: 0.0, tau_s, up: self.wanted });
        }
        let Some(ramp) = &mut self.ramp else {
            self.t_s += self.rate * dt_s;
            return;
        };
        let span = 2.0 * ramp.tau_s;
        let before = ramp.h;
        ramp.h = (before + dt_s / span).min(1.0);
        self.t_s += span * (way(ramp.h, ramp.up) - way(before, ramp.up));
        let h = ramp.h;
        let (part, slope) = (h * h * (3.0 - 2.0 * h), 6.0 * h * (1.0 - h) / span);
        (self.rate, self.slope) = if ramp.up { (part, slope) } else { (1.0 - part, -slope) };
        if h >= 1.0 {
            let left_s = dt_s - span * (1.0 - before);
            self.rate = f64::from(u8::from(ramp.up));
            self.t_s += self.rate * left_s.max(0.0);
            (self.ramp, self.slope) = (None, 0.0);
        }
    }

    /// Converts a setpoint of the path to real time.
    #[must_use]
    pub fn with_speed_of<const N: usize>(&self, at: &Setpoint<N>) -> Setpoint<N> {
        Setpoint {
            q: at.q,
            qd: at.qd * self.rate,
            qdd: at.qdd * (self.rate * self.rate) + at.qd * self.slope,
        }
    }
}

/// The integral of the rate over the part `h` of a ramp.
fn way(h: f64, up: bool) -> f64 {
    let rising = h * h * h * (1.0 - 0.5 * h);
    if up { rising } else { h - rising }
}

impl Fold for Clock {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.t_s).add(&self.rate).add(&self.wanted).add(&self.ramp.is_some());
        if let Some(ramp) = &self.ramp {
            hash.add(&ramp.h).add(&ramp.tau_s).add(&ramp.up);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;
    use taktil_mechanics::paul::JointPath;

    const DT_S: f64 = 0.0025;
    const TAU_S: f64 = 0.1;

    /// Setpoints along a path through a corner, with the clock told what `wants` says at a tick.
    fn run(wants: impl Fn(usize) -> Option<bool>, ticks: usize) -> (JointPath, Vec<Setpoint>) {
        let point = |a: f64| Joints::repeat(a);
        let points = [point(0.0), point(0.5), point(-0.2)];
        let path = JointPath::new(&points, &[0.7, 0.9], TAU_S).unwrap();
        let mut clock = Clock::new(true);
        let mut setpoints = Vec::new();
        for tick in 0..ticks {
            if let Some(running) = wants(tick) {
                clock.set_running(running);
            }
            clock.advance(DT_S, TAU_S);
            setpoints.push(clock.with_speed_of(&path.at(clock.t_s())));
        }
        (path, setpoints)
    }

    #[test]
    fn without_a_word_it_is_the_time_of_the_day() {
        let (path, setpoints) = run(|_| None, 900);
        for (tick, at) in setpoints.iter().enumerate() {
            let wanted = path.at(DT_S * (tick + 1) as f64);
            assert!((at.q - wanted.q).amax() < 1e-12 && (at.qd - wanted.qd).amax() < 1e-11);
        }
    }

    #[test]
    fn a_stop_anywhere_stays_on_the_path_and_the_acceleration_is_bounded_and_continuous() {
        let (path, plain) = run(|_| None, 900);
        let most = path.peak_acceleration()[0];
        let jerk = plain.windows(2).map(|w| (w[1].qdd - w[0].qdd).amax()).fold(0.0, f64::max);
        for stop in (0..760).step_by(19) {
            let wants = |tick| match tick {
                t if t == stop => Some(false),
                t if t == stop + 120 => Some(true),
                _ => None,
            };
            let (path, setpoints) = run(wants, 1200);
            let still = &setpoints[stop + 90];
            assert_eq!((still.qd.amax(), still.qdd.amax()), (0.0, 0.0), "stands: {stop}");
            for pair in setpoints.windows(2) {
                let [a, b] = pair else { unreachable!() };
                // The derivatives belong to the angles, and no step is larger than Paul's own.
                let slope = (b.q - a.q) / DT_S - (a.qd + b.qd) * 0.5;
                assert!(slope.amax() < 1e-3, "{stop}: {slope}");
                let slope = (b.qd - a.qd) / DT_S - (a.qdd + b.qdd) * 0.5;
                assert!(slope.amax() < 0.1, "{stop}: {slope}");
                assert!(b.qdd.amax() <= most * (1.0 + 1e-9), "{stop}: {} of {most}", b.qdd[0]);
                assert!((b.qdd - a.qdd).amax() <= 2.0 * jerk, "{stop}");
            }
            let end = setpoints.last().unwrap();
            assert_eq!((end.q, end.qd), (path.points()[2], Joints::zeros()), "it got there");
        }
    }

    #[test]
    fn coming_to_rest_takes_one_tau_of_the_path_and_nothing_is_lost_in_a_long_tick() {
        for dt_s in [0.0025, 0.003, 0.07, 1.0] {
            let mut clock = Clock::new(true);
            clock.advance(0.5, TAU_S);
            clock.set_running(false);
            for _ in 0..200 {
                clock.advance(dt_s, TAU_S);
            }
            assert!((clock.t_s() - 0.6).abs() < 1e-12 && clock.is_at_rest(), "{dt_s}");
            clock.set_running(true);
            let mut day_s = 0.0;
            while day_s < 0.999_999 {
                clock.advance(dt_s, TAU_S);
                day_s += dt_s;
            }
            assert!((clock.t_s() - 0.6 - day_s + 0.1).abs() < 1e-9 && clock.is_running());
        }
    }

    #[test]
    fn a_change_of_mind_waits_for_the_end_of_the_transition() {
        let mut clock = Clock::new(true);
        clock.set_running(false);
        clock.advance(0.05, TAU_S);
        clock.set_running(true);
        clock.advance(0.1, TAU_S);
        assert!(clock.rate < 0.2 && !clock.is_at_rest() && !clock.is_running());
        for _ in 0..6 {
            clock.advance(0.05, TAU_S);
        }
        assert!(clock.is_running());
        let rest = Clock::new(false);
        assert!(rest.is_at_rest() && rest.t_s() == 0.0);
    }
}
