//! Tests the bounds of jogging for any combination of keys: speeds, joint limits and the edges of
//! the arm's workspace.

mod chains;
mod keys;
mod starts;

use super::*;

const DT_S: f64 = 0.0025;

pub(super) fn rates() -> Rates {
    let arm = Puma260::reference();
    Rates {
        joints_rad_s: arm.speed_max_rad_s * 0.1,
        ramp_s: 0.1,
        line_m_s: 0.05,
        turn_rad_s: 0.5,
        off_max_rad: 0.01,
    }
}

fn bent_pose() -> Joints {
    Joints::from([10.0, 40.0, -150.0, 20.0, 40.0, 10.0].map(f64::to_radians))
}

pub(super) fn demand(axis: usize, by: f64, frame: JogFrame) -> JogDemand {
    let mut axes = [0.0; 6];
    axes[axis] = by;
    JogDemand { axes, frame }
}

#[test]
fn a_joint_ramps_up_runs_and_ramps_down() {
    let mut law = Law::new(&Puma260::reference(), &rates(), &bent_pose(), true);
    let full = rates().joints_rad_s[2];
    let held = demand(2, 1.0, JogFrame::Joints);
    let mut last = Joints::zeros();
    for tick in 0..80 {
        let step = law.step(&held, DT_S);
        assert!((step.qd - last).amax() <= full / 0.1 * DT_S * (1.0 + 1e-9), "{tick}");
        last = step.qd;
    }
    assert!((last[2] - full).abs() < 1e-12 && last[0] == 0.0);
    for _ in 0..41 {
        last = law.step(&JogDemand::ZERO, DT_S).qd;
    }
    assert_eq!(last, Joints::zeros(), "at rest a tenth of a second after the key");
}

#[test]
fn joints_stop_at_their_limits_and_go_back() {
    let arm = Puma260::reference();
    for (joint, sign) in (0..6).flat_map(|joint| [(joint, 1.0), (joint, -1.0)]) {
        let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
        let held = demand(joint, sign, JogFrame::Joints);
        let mut q = bent_pose();
        for _ in 0..20_000 {
            q = law.step(&held, DT_S).q;
            assert!(arm.within_limits(&q), "{joint} {sign}: {q}");
        }
        let limit = if sign > 0.0 { arm.q_max_rad[joint] } else { arm.q_min_rad[joint] };
        assert!((q[joint] - limit).abs() < 1e-3, "{joint} {sign}: {} of {limit}", q[joint]);
        let back = demand(joint, -sign, JogFrame::Joints);
        for _ in 0..100 {
            q = law.step(&back, DT_S).q;
        }
        assert!((q[joint] - limit).abs() > 1e-3);
    }
    // Without zeros there are no limits.
    let mut law = Law::new(&arm, &rates(), &arm.q_max_rad, false);
    let q = (0..100).map(|_| law.step(&demand(0, 1.0, JogFrame::Joints), DT_S).q).last().unwrap();
    assert!(q[0] > arm.q_max_rad[0]);
}

#[test]
fn the_tool_runs_along_its_own_axes_or_those_of_the_base() {
    let arm = Puma260::reference();
    let here = arm.tool_pose(&bent_pose());
    for frame in [JogFrame::Base, JogFrame::Tool] {
        for axis in 0..3 {
            let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
            let mut q = bent_pose();
            for _ in 0..200 {
                q = law.step(&demand(axis, 1.0, frame), DT_S).q;
            }
            let moved = arm.tool_pose(&q);
            let way = moved.translation - here.translation;
            let mut wanted = [0.0; 3];
            wanted[axis] = 1.0;
            let wanted = DVec3::from_array(wanted);
            let along = if frame == JogFrame::Tool { here.rotation * wanted } else { wanted };
            assert!((way.normalize() - along).length() < 1e-9, "{frame:?} {axis}");
            assert!((way.length() - 0.0226).abs() < 5e-4, "0.5 s at 50 mm/s less the ramp");
            assert!(moved.rotation.abs_diff_eq(here.rotation, 1e-9));
        }
        for axis in 3..6 {
            let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
            let mut q = bent_pose();
            for _ in 0..120 {
                q = law.step(&demand(axis, -1.0, frame), DT_S).q;
            }
            let moved = arm.tool_pose(&q);
            assert!((moved.translation - here.translation).length() < 1e-9, "on the spot");
            assert!(!moved.rotation.abs_diff_eq(here.rotation, 0.05), "{frame:?} {axis}");
        }
    }
}

#[test]
fn the_tool_stands_at_the_edge_of_reach_and_comes_back() {
    let arm = Puma260::reference();
    let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
    let mut q = bent_pose();
    let mut last = Joints::zeros();
    let mut stood = law.step(&JogDemand::ZERO, DT_S);
    for tick in 0..8000 {
        let step = law.step(&demand(0, 1.0, JogFrame::Base), DT_S);
        let share = step.qd.component_div(&arm.speed_max_rad_s).amax();
        assert!(share <= 0.6 + 1e-9 && arm.within_limits(&step.q), "{tick}: {share}");
        let change = (step.qd - last).component_div(&(arm.acceleration_max_rad_s2 * DT_S));
        assert!(change.amax() < 1.0 + 1e-9, "{tick}: {} of the acceleration", change.amax());
        last = step.qd;
        (stood, q) = (step, step.q);
    }
    let edge_of = |step: &Step| step.obstacle.map(|obstacle| (obstacle.kind, obstacle.joint));
    assert_eq!(edge_of(&stood), Some((JogObstacle::Branch, Some(2))), "the arm is stretched");
    assert!(stood.qd.amax() < 1e-3, "stands: {}", stood.qd);
    let edge = arm.tool_pose(&q).translation.x;
    assert!(edge > arm.tool_pose(&bent_pose()).translation.x + 0.05, "it went some way");
    let creeping = law.step(&demand(0, 1.0, JogFrame::Base), DT_S).qd;
    assert!(creeping.amax() < 0.1, "and stands: {creeping}");
    for _ in 0..200 {
        q = law.step(&demand(0, -1.0, JogFrame::Base), DT_S).q;
    }
    assert!(arm.tool_pose(&q).translation.x < edge - 0.01, "it comes back");
}

#[test]
fn no_edge_in_any_direction_takes_a_joint_s_speed_at_once() {
    let arm = Puma260::reference();
    let (mut worst, mut beyond, mut ticks) = (0.0f64, 0, 0);
    for direction in (0..728).step_by(5) {
        // Every mixture of -1, 0, 1 along and about the six axes.
        let mut rest = direction;
        let axes = [0; 6].map(|_| {
            let axis = f64::from(rest % 3) - 1.0;
            rest /= 3;
            axis
        });
        let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
        let mut last = Joints::zeros();
        for _ in 0..1800 {
            let step = law.step(&JogDemand { axes, frame: JogFrame::Base }, DT_S);
            let change = (step.qd - last).component_div(&(arm.acceleration_max_rad_s2 * DT_S));
            worst = worst.max(change.amax());
            beyond += u32::from(change.amax() > 1.0 + 1e-9);
            ticks += 1;
            last = step.qd;
        }
    }
    // Where the joints cannot follow at any speed they coast, off the tool's line.
    assert!(worst < 1.0 + 1e-9 && beyond == 0, "{worst}, {beyond} of {ticks} ticks");
}

#[test]
fn a_change_of_frame_waits_for_rest_and_nonsense_is_released() {
    let arm = Puma260::reference();
    let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
    for _ in 0..80 {
        law.step(&demand(0, 1.0, JogFrame::Joints), DT_S);
    }
    let other = demand(2, 1.0, JogFrame::Tool);
    let mut ticks = 0;
    while law.frame == JogFrame::Joints {
        law.step(&other, DT_S);
        ticks += 1;
    }
    assert!((40..=42).contains(&ticks), "it ramps down first: {ticks}");
    let mut law = Law::new(&arm, &rates(), &bent_pose(), true);
    for bad in [f64::NAN, f64::INFINITY, -1e300] {
        for frame in JogFrame::ALL {
            let step = law.step(&JogDemand { axes: [bad; 6], frame }, DT_S);
            assert!(step.q.iter().chain(step.qd.iter()).all(|x| x.is_finite()));
            let full = law.full();
            assert!(law.speed.iter().zip(full.iter()).all(|(v, full)| v.abs() <= *full));
        }
    }
}
