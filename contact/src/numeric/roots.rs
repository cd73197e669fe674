//! A root search in one variable that keeps a bracket once it has one and proposes the caller's
//! Newton or secant step as long as that stays inside it. Callers bound the number of steps.

/// The bracket: place and value of the function on either side of the root.
pub(crate) struct BracketedSearch {
    low: Option<[f64; 2]>,
    high: Option<[f64; 2]>,
}

impl BracketedSearch {
    pub(crate) fn new() -> Self {
        Self { low: None, high: None }
    }

    /// Takes the value f(x) of an increasing function and returns the next place: `newton` if it
    /// lies inside the bracket, otherwise the bracket's middle.
    pub(crate) fn next(&mut self, x: f64, f: f64, newton: f64) -> f64 {
        if f < 0.0 {
            self.low = Some([x, f]);
        } else {
            self.high = Some([x, f]);
        }
        match (self.low, self.high) {
            (Some(low), Some(high)) => {
                if newton > low[0].min(high[0]) && newton < low[0].max(high[0]) {
                    newton
                } else {
                    0.5 * (low[0] + high[0])
                }
            }
            _ => newton,
        }
    }
}
