//! A root search in one variable that keeps a bracket once it has one; secant steps inside it. It
//! refuses nothing: callers bound the number of steps and check what they get.

/// The bracket, place and value on either side.
pub(crate) struct BracketedSearch {
    low: Option<[f64; 2]>,
    high: Option<[f64; 2]>,
}

impl BracketedSearch {
    pub(crate) fn new() -> Self {
        Self { low: None, high: None }
    }

    /// Notes f(x); `f` rises with x. Gives the next place, `newton` being the wish.
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
