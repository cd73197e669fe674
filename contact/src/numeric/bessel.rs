//! Bessel functions J of the orders 0, 1 ... at one argument, all at once. The recurrence between
//! orders runs upwards for orders below the argument, and downwards from a much higher order for
//! orders above it (Miller's algorithm; Abramowitz and Stegun 9.12).

use core::f64::consts::PI;

/// Orders above the last wanted one, and above the argument, at which the downward recurrence
/// begins.
const EXTRA_ORDERS: usize = 100;
/// Values of the recurrence above this are scaled down together, before they overflow.
const RESCALING_LIMIT: f64 = 1e120;

/// Writes J_0(z), J_1(z) ... for a finite z of either sign.
pub(crate) fn orders(z: f64, out: &mut [f64]) {
    let x = z.abs();
    if out.len() as f64 <= x {
        recur_upwards(x, out);
    } else {
        recur_downwards(x, out);
    }
    if z < 0.0 {
        out.iter_mut().skip(1).step_by(2).for_each(|odd| *odd = -*odd);
    }
}

fn recur_upwards(x: f64, out: &mut [f64]) {
    let (mut now, mut next, twice) = (libm::j0(x), libm::j1(x), 2.0 / x);
    for (order, value) in out.iter_mut().enumerate() {
        *value = now;
        (now, next) = (next, twice * (order + 1) as f64 * next - now);
    }
}

fn recur_downwards(x: f64, out: &mut [f64]) {
    out.fill(0.0);
    if x == 0.0 {
        out.iter_mut().take(1).for_each(|first| *first = 1.0);
        return;
    }
    // J_0 + 2 J_2 + 2 J_4 + ... = 1.
    let begin = 2 * ((out.len().max(x as usize) + EXTRA_ORDERS) / 2);
    let (mut above, mut now, mut sum) = (0.0, 1e-30, 0.0);
    for order in (0..=begin).rev() {
        if let Some(value) = out.get_mut(order) {
            *value = now;
        }
        if order.is_multiple_of(2) {
            sum += if order == 0 { now } else { 2.0 * now };
        }
        (above, now) = (now, 2.0 * order as f64 / x * now - above);
        if now.abs() > RESCALING_LIMIT {
            (above, now, sum) =
                (above / RESCALING_LIMIT, now / RESCALING_LIMIT, sum / RESCALING_LIMIT);
            out.iter_mut().skip(order).for_each(|value| *value /= RESCALING_LIMIT);
        }
    }
    out.iter_mut().for_each(|value| *value /= sum);
}

/// A table of pi (-1)^k J_2k, or J_2k+1 if `odd` is 1, k fastest, on a grid that begins one point
/// before 0, because a cubic needs that neighbour.
pub(crate) fn table(points: usize, density: f64, cosines: usize, odd: usize) -> Vec<f64> {
    let mut table = Vec::with_capacity(points * cosines);
    let mut all = vec![0.0; 2 * cosines - 1 + odd];
    for i in 0..points {
        orders((i as f64 - 1.0) / density, &mut all);
        let wanted = all[odd..].iter().step_by(2).zip([PI, -PI].into_iter().cycle());
        table.extend(wanted.map(|(value, sign)| sign * value));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_orders_are_the_functions_of_one() {
        let mut found = [0.0; 192];
        for z in [-0.125, 0.0, 1e-9, 0.125, 1.0, 7.3, 40.0, 191.9, 192.0, 350.0, 4000.0] {
            for count in [1, 2, 9, 50, 192] {
                orders(z, &mut found[..count]);
                for (order, value) in found[..count].iter().enumerate() {
                    let wanted = libm::jn(order as i32, z);
                    assert!((value - wanted).abs() < 3e-14, "J_{order}({z}) {value} {wanted}");
                }
            }
        }
    }
}
