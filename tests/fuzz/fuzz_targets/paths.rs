//! Paul's joint and Cartesian motion laid point by point from any finite numbers: refused with a
//! reason, or continuous and finite at every instant, asked for in and far outside its time.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taktil_fuzz::{Numbers, finite, rigid};
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};

/// Times of ordinary and of odd size.
fn time(n: &mut Numbers<'_>) -> f64 {
    match n.byte() % 4 {
        0 => n.number(1e12),
        _ => (1.0 + f64::from(n.byte())) / 64.0,
    }
}

fn instants(duration_s: f64, corners_s: &[f64], n: &mut Numbers<'_>) -> Vec<f64> {
    let mut all = vec![0.0, duration_s, -1.0, 2.0 * duration_s, f64::MAX, f64::MIN];
    all.extend(corners_s);
    all.extend((0..16).map(|i| duration_s * f64::from(i) / 16.0));
    all.push(n.number(f64::MAX));
    all
}

fn joints(n: &mut Numbers<'_>) {
    // Angles and times whose quotients are numbers.
    let most = 1e9;
    let Ok(mut path) = JointPath::<7>::rest(&n.vector(most), time(n)) else { return };
    for _ in 0..n.byte() % 40 {
        if path.push(&n.vector(most), time(n)).is_err() {
            return;
        }
    }
    let corners = path.corners_s().to_vec();
    for t in instants(path.duration_s(), &corners, n) {
        let at = path.at(t);
        finite("joints", at.q.iter().chain(at.qd.iter()).chain(at.qdd.iter()));
        for i in 0..7 {
            let (low, high) = path.points().iter().fold((f64::MAX, f64::MIN), |span, point| {
                (span.0.min(point[i]), span.1.max(point[i]))
            });
            let slack = 1e-9 * (1.0 + low.abs().max(high.abs()));
            assert!(
                at.q[i] >= low - slack && at.q[i] <= high + slack,
                "joint {i} leaves its points"
            );
        }
    }
    finite("peaks", path.peak_speed().iter().chain(path.peak_acceleration().iter()));
}

fn poses(n: &mut Numbers<'_>) {
    let blend = [Blend::Paul, Blend::Smooth, Blend::So3][usize::from(n.byte() % 3)];
    let Ok(mut path) = CartesianPath::rest(&n.pose(1e6), time(n), blend) else { return };
    for _ in 0..n.byte() % 12 {
        if path.push(&n.pose(1e6), time(n)).is_err() {
            return;
        }
    }
    let corners = path.corners_s().to_vec();
    for t in instants(path.duration_s(), &corners, n) {
        let at = path.at(t);
        rigid("pose", &at.pose);
        finite("velocity", &at.velocity_m_s.to_array());
        finite("angular velocity", &at.angular_rad_s.to_array());
    }
    // Ends where it was told to.
    let last = path.points()[path.points().len() - 1];
    let end = path.at(path.duration_s()).pose;
    let off = (end.translation - last.translation).length();
    assert!(off <= 1e-9 * (1.0 + last.translation.length()), "ends {off} m off");
    let turned = (end.rotation - last.rotation).to_cols_array();
    assert!(turned.iter().all(|x| x.abs() < 1e-9), "ends turned away: {turned:?}");
}

fuzz_target!(|bytes: &[u8]| {
    let mut n = Numbers::new(bytes);
    if n.byte() % 2 == 0 { joints(&mut n) } else { poses(&mut n) }
});
