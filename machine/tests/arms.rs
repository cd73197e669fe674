//! Arms from URDF files: the file of the PUMA equals the built-in PUMA, two other arms move, and a
//! file that describes no chain is an error with its line.

use std::path::PathBuf;

use taktil_machine::source::Source;
use taktil_machine::urdf::{Lacks, Selection, load, locate, read};
use taktil_mechanics::Joints;
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::spatial::JointVector;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../sim/arms").join(name)
}

fn draws(seed: u64) -> impl FnMut(f64, f64) -> f64 {
    let mut state = seed;
    move |low, high| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (state >> 11) as f64 / 9_007_199_254_740_992.0;
        low + (high - low) * unit
    }
}

fn inside<const N: usize>(
    arm: &Chain<N>,
    draw: &mut impl FnMut(f64, f64) -> f64,
) -> JointVector<N> {
    let limits = arm.limits();
    JointVector::from_fn(|i, _| draw(limits.q_min[i].max(-7.0), limits.q_max[i].min(7.0)))
}

#[test]
fn the_puma_s_file_is_the_built_in_puma() {
    let chain: Chain<6> =
        load(&file("puma260.urdf"), &Selection::to(None)).unwrap().chain().unwrap();
    let (arm, dynamics) = (Puma260::reference(), Dynamics::reference());
    let wrist = chain.spherical_wrist().expect("solved in closed form");
    assert!((chain.limits().q_min - arm.q_min_rad).amax() < 1e-11);
    assert!((chain.limits().speed_max - arm.speed_max_rad_s).amax() < 1e-11);
    assert!((chain.limits().acceleration_max - arm.acceleration_max_rad_s2).amax() < 1e-10);
    let mut draw = draws(1);
    for _ in 0..200 {
        let q = inside(&chain, &mut draw);
        let (got, want) = (chain.tool_pose(&q), arm.tool_pose(&q));
        assert!((got.translation - want.translation).length() < 1e-15);
        assert!(got.rotation.abs_diff_eq(want.rotation, 2e-15));
        let (qd, qdd) = (Joints::from_fn(|_, _| draw(-2.0, 2.0)), Joints::repeat(3.0));
        let off = chain.inverse_dynamics(&q, &qd, &qdd) - dynamics.inverse_dynamics(&q, &qd, &qdd);
        assert!(off.amax() < 1e-13, "{off}");
        let own = arm.inverse_kinematics(&arm.tool_to_wrist(&want), Some(&q));
        for (a, b) in own.iter().zip(&wrist.inverse_kinematics(&want, Some(&q))) {
            let d = arm.singularity_distance(&q).smallest();
            let apart = (a.q - b.q).map(taktil_mechanics::spatial::wrap_angle).amax();
            assert!(apart < 1e-14 / (d * d), "{apart:e}");
        }
    }
}

/// A joint move, then straight lines through damped steps at each tick, as a trajectory requests
/// them: on the path up to rounding, within the speed limits, and the same bits when repeated.
fn moves<const N: usize>(arm: &Chain<N>, home: &JointVector<N>) {
    let limits = arm.limits();
    assert!(arm.within_limits(home) && arm.singular_values(home)[5] > 0.1);
    let start = arm.tool_pose(home);
    let run = || {
        let mut q = *home;
        let mut fastest: f64 = 0.0;
        // The lines go 120 mm along the tool's x, out and back in 2 s at 400 Hz, with a smooth
        // profile.
        for tick in 1..=800_u32 {
            let x = f64::from(tick) / 800.0;
            let share = 4.0 * x * (1.0 - x);
            let mut goal = start;
            goal.translation += 0.12 * share * start.rotation.x_axis;
            let found = arm.inverse_kinematics(&goal, &q, &SearchBudget::TICK).unwrap();
            assert!(
                found.position_error_m <= 1e-10
                    && found.orientation_error_rad <= 1e-10
                    && found.steps <= 6
            );
            let speed = ((found.q - q) / 0.0025).component_div(&limits.speed_max).amax();
            fastest = fastest.max(speed);
            q = found.q;
        }
        (q, fastest)
    };
    let (end, fastest) = run();
    assert!(fastest < 1.0, "at {fastest} of its speed");
    let off = arm.tool_pose(&end);
    assert!((off.translation - start.translation).length() < 1e-9);
    assert_eq!(run(), (end, fastest));
}

#[test]
fn accelerations_are_read_in_files_of_any_version() {
    let text = std::fs::read_to_string(file("ur5e-like.urdf")).unwrap();
    let chain: Chain<6> = read(&text, &Selection::to(None)).unwrap().chain().unwrap();
    assert_eq!(chain.limits().acceleration_max, JointVector::<6>::repeat(13.0));
    let old = text.replacen(" version=\"1.2\"", "", 1);
    let older: Chain<6> = read(&old, &Selection::to(None)).unwrap().chain().unwrap();
    assert_eq!(older.limits().acceleration_max, JointVector::<6>::repeat(13.0));
    // Without an acceleration limit a joint reaches its speed in 0.2 s.
    let plain: Chain<6> = read(&old.replace(" acceleration=\"13\"", ""), &Selection::to(None))
        .unwrap()
        .chain()
        .unwrap();
    let limits = plain.limits();
    assert!((limits.acceleration_max - limits.speed_max * 5.0).amax() < 1e-12);
}

#[test]
fn two_other_arms_follow_a_line() {
    let six = load(&file("ur5e-like.urdf"), &Selection::to(None)).unwrap();
    assert_eq!((six.name.as_str(), six.tip.as_str(), six.names.len()), ("ur5e_like", "tool", 6));
    let arm: Chain<6> = six.chain().unwrap();
    assert!(arm.spherical_wrist().is_none());
    let home = JointVector::<6>::new(0.2, -1.3, 1.6, -1.9, -1.5, 0.4);
    moves(&arm, &home);
    // Paul's joint motion accepts the six joints unchanged.
    let goal = home + JointVector::<6>::new(0.5, 0.2, -0.3, 0.4, 0.1, -0.6);
    let path = JointPath::new(&[home, goal], &[1.0], 0.1).unwrap();
    assert!(path.peak_speed().component_div(&arm.limits().speed_max).amax() < 1.0);
    let torque = arm.inverse_dynamics(&home, &JointVector::zeros(), &JointVector::zeros());
    assert!(torque.component_div(&arm.limits().effort_max).amax() < 1.0, "{torque}");

    let seven: Chain<7> =
        load(&file("seven-joints.urdf"), &Selection::to(None)).unwrap().chain().unwrap();
    moves(&seven, &JointVector::from([0.1, -0.4, 0.2, -2.0, 0.1, 1.7, 0.5]));
    let cut = load(&file("seven-joints.urdf"), &Selection::to(Some("link6"))).unwrap_err();
    assert!(cut.to_string().contains("`joint7`: moves beside or behind"), "{cut}");
}

/// The error of a small description with something changed.
fn refused(change: &[(&str, &str)]) -> String {
    let mut text = std::fs::read_to_string(file("puma260.urdf")).unwrap();
    for (from, to) in change {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let source = Source { path: PathBuf::from("arm.urdf"), text };
    let got = read(&source.text, &Selection::to(None)).and_then(|described| described.chain::<6>());
    locate(&source, got.unwrap_err()).to_string()
}

#[test]
fn a_file_without_a_chain_is_rejected_at_its_line() {
    let second = "<joint name=\"joint2\" type=\"revolute\">";
    let text = refused(&[(second, "<joint name=\"joint2\" type=\"floating\">")]);
    assert!(text.contains("arm.urdf:20:10") && text.contains("neither revolute"), "{text}");
    let text = refused(&[("velocity=\"2.181661564993\"", "velocity=\"NaN\"")]);
    assert!(text.contains("`joint2`"), "{text}");
    let text = refused(&[("<mass value=\"3.853\"/>", "<mass value=\"NaN\"/>")]);
    assert!(text.contains("`link2`: a mass of NaN kg"), "{text}");
    let text = refused(&[("lower=\"-1.326450231516\"", "lower=\"5\"")]);
    assert!(text.contains("below the upper"), "{text}");
    let text = refused(&[("upper=\"4.468042885105\"", "upper=\"1e9\"")]);
    assert!(text.contains("`joint2`") && text.contains("call it continuous"), "{text}");
    for bad in [[-0.012, 0.0, 0.0], [0.012, 0.02, 0.0], [0.0, 0.0, 0.012]] {
        let [xx, xy, xz] = bad;
        let bad = format!("ixx=\"{xx}\" ixy=\"{xy}\" ixz=\"{xz}\"");
        let text = refused(&[("ixx=\"0.012\" ixy=\"0\" ixz=\"0\"", &bad)]);
        assert!(text.contains("`link1`: its inertia is no body's"), "{bad}: {text}");
    }
    let text = refused(&[("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>")]);
    assert!(text.contains("`joint1`") && text.contains("direction"), "{text}");
    let text = refused(&[(second, "<joint name=\"joint2\" type=\"fixed\">")]);
    assert!(text.contains("5 moving joints"), "{text}");
    let text = refused(&[("<child link=\"link2\"/>", "<child link=\"link1\"/>")]);
    assert!(text.contains("`link1`: two joints hold this link"), "{text}");
    let text = refused(&[("<parent link=\"base\"/>", "<parent link=\"tool\"/>")]);
    assert!(text.contains("`link1`: its joints form a loop"), "{text}");
    let text = refused(&[("upper=\"4.468042885105\"", "upper=\"256\"")]);
    assert!(text.contains("`joint2`") && text.contains("not degrees"), "{text}");
    for text in ["", "<robot", "<robot name=\"x\"/>", "{\"a\": 1}", "<robot name=\"x\"><link/>"] {
        assert!(read(text, &Selection::to(None)).is_err(), "{text}");
    }
    let missing = load(&file("no-such.urdf"), &Selection::to(None)).unwrap_err().to_string();
    assert!(missing.contains("there is no file"), "{missing}");
    let lost = load(&file("puma260.urdf"), &Selection::to(Some("hand"))).unwrap_err().to_string();
    assert!(lost.contains("no link `hand`") && lost.contains("tool"), "{lost}");
}

#[test]
fn names_that_are_doubled_or_missing_and_loose_links_are_refused() {
    // Otherwise the masses behind a joint would be those of another one, or be lost.
    let text = refused(&[("<joint name=\"joint2\"", "<joint name=\"joint1\"")]);
    assert!(text.contains("`joint1`: two joints have this name"), "{text}");
    let text = refused(&[("</robot>", "<link name=\"link3\"/></robot>")]);
    assert!(text.contains("`link3`: two links have this name"), "{text}");
    for (from, to) in [
        ("<parent link=\"base\"/>", "<parent link=\"bsae\"/>"),
        ("<child link=\"link6\"/>", "<child link=\"lnk6\"/>"),
    ] {
        let text = refused(&[(from, to)]);
        assert!(text.contains("that is not there") && text.contains("link3"), "{text}");
    }
    let mut text = std::fs::read_to_string(file("ur5e-like.urdf")).unwrap();
    text = text.replacen("</robot>", "<link name=\"gripper\"/></robot>", 1);
    for tip in [None, Some("tool")] {
        let bad = read(&text, &Selection::to(tip)).unwrap_err();
        assert_eq!(bad.place, "gripper", "{bad:?}");
        assert!(bad.what.contains("hangs from nothing"), "{bad:?}");
    }
}

#[test]
fn limits_and_moments_that_cannot_be_meant_are_refused() {
    let text = std::fs::read_to_string(file("ur5e-like.urdf")).unwrap();
    let complaint = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        read(&text.replacen(from, to, 1), &Selection::to(None))
            .and_then(|arm| arm.chain::<6>())
            .unwrap_err()
    };
    let bad = complaint("acceleration=\"13\"", "acceleration=\"0\"");
    assert!(bad.place == "joint1" && bad.what.contains("acceleration of 0"), "{bad:?}");
    // One principal moment is larger than the sum of the two others.
    let bad = complaint("ixx=\"0.01\"", "ixx=\"0.03\"");
    assert!(bad.place == "link1" && bad.what.contains("sum of the two others"), "{bad:?}");
    // For a plate it equals the sum, up to the rounding of the file.
    let plate = text.replacen(
        "ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.0067\"",
        "ixx=\"0.0168\" ixy=\"0\" ixz=\"0\" iyy=\"0.0067\"",
        1,
    );
    assert!(plate != text && read(&plate, &Selection::to(None)).unwrap().unsound.is_empty());
}

#[test]
fn what_is_no_urdf_is_refused_at_its_line() {
    let turning = "<joint name=\"joint2\" type=\"revolute\">";
    for (change, place, says) in [
        ((turning, "<joint name=\"joint2\" type=\"turning\">"), ":20:24", "no type of joint"),
        ((turning, "<joint name=\"joint2\">"), ":20:3", "<joint> has no `type`"),
        (("0.0028235 0.10706\"", "0.1\""), ":29:15", "`xyz` is \"0.032 0.1\""),
        (("0.10706\"", "1mm\""), ":29:15", "`xyz` is \"0.032 0.0028235 1mm\""),
        (("<mass value=\"3.853\"/>", "<mass/>"), ":30:7", "`link2`: <mass> has no `value`"),
        (("ixx=\"0.012\"", "ixx=\"0,012\""), "", "`ixx` is \"0,012\""),
        (("<robot", "<robot xmlns:xacro=\"http://ros.org/wiki/xacro\""), "", ""),
        (("<parent link=\"base\"/>", "<parent link=\"base\">"), "", "is no URDF"),
    ] {
        let (from, to) = change;
        // Only the declaration of the macros' name space changes nothing: a macro does.
        if says.is_empty() {
            let macros = ("</robot>", "<xacro:property name=\"a\" value=\"1\"/></robot>");
            let text = refused(&[change, macros]);
            assert!(text.contains("`xacro:property` is a macro of xacro"), "{text}");
            continue;
        }
        let text = refused(&[(from, to)]);
        assert!(text.contains(says) && text.contains(&format!("arm.urdf{place}")), "{text}");
    }
    // Without a file the complaint says the line itself.
    let text = "<robot>\n<link name=\"a\">\n<inertial><mass/></inertial></link></robot>";
    let bad = read(text, &Selection::to(None)).unwrap_err();
    assert!(bad.place == "a" && bad.what == "line 3: <mass> has no `value`", "{bad:?}");
    let bad = read("<sdf/>", &Selection::to(None)).unwrap_err();
    assert!(bad.what.contains("begins with <sdf>"), "{bad:?}");
}

#[test]
fn what_a_file_leaves_out_is_filled_in_as_the_format_says() {
    let joint = |inside: &str| {
        let text = format!(
            "<!-- Names in any quotes. --><robot name='r' version='1.2'><link name='a'/>
            <link name='b'/><joint name='j' type='revolute'><parent link='a'/><child link='b'/>
            {inside}</joint></robot>"
        );
        read(&text, &Selection::to(None))
    };
    let limit = "<limit lower='-1' upper='1' effort='5' velocity='2'/>";
    let arm = joint(limit).unwrap();
    let [only] = arm.joints.as_slice() else { panic!("{} joints", arm.joints.len()) };
    assert_eq!(only.axis, glam::DVec3::X);
    assert_eq!(only.origin, taktil_mechanics::Pose::IDENTITY);
    assert_eq!(only.body.mass_kg, 0.0);
    assert_eq!(only.acceleration_max, 10.0);
    assert_eq!(arm.lacks, [Lacks::default()]);
    assert_eq!(joint("").unwrap().lacks, [Lacks { range: true, speed: true, effort: true }]);
    let zeros = joint(&limit.replace("'5'", "'0'").replace("'2'", "'0.0'")).unwrap();
    assert_eq!(zeros.lacks, [Lacks { speed: true, effort: true, ..Lacks::default() }]);
    assert!(joint(&format!("{limit}<mimic joint='k'/>")).unwrap_err().what.contains("mimics"));
    for bad in ["acceleration='NaN'", "jerk='-1'", "acceleration='-1'"] {
        let bad = joint(&limit.replace("/>", &format!(" {bad}/>"))).unwrap_err();
        assert!(bad.place == "j" && bad.what.starts_with("line 3: `"), "{bad:?}");
    }
    let open = joint("<limit effort='5' velocity='2'/>").unwrap();
    assert_eq!(open.lacks, [Lacks { range: true, ..Lacks::default() }]);
    // An orientation as a quaternion is that of its three angles.
    let turned = |origin: &str| joint(&format!("{limit}{origin}")).unwrap().joints[0].origin;
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let quaternion = turned(&format!("<origin quat_xyzw='0 0 {half} {half}'/>"));
    let angles = turned("<origin rpy='0 0 1.5707963267948966'/>");
    assert!(quaternion.rotation.abs_diff_eq(angles.rotation, 1e-15));
    let both = joint(&format!("{limit}<origin rpy='0 0 0' quat_xyzw='0 0 0 1'/>")).unwrap_err();
    assert!(both.what.contains("as `rpy` and as `quat_xyzw`"), "{both:?}");
    for none in ["0 0 0 0", "nan 0 0 1", "inf 0 0 1"] {
        let none = joint(&format!("{limit}<origin quat_xyzw='{none}'/>")).unwrap_err();
        assert!(none.place == "j" && none.what.contains("is no orientation"), "{none:?}");
    }
    // The format ignores quaternions in older files, in which the arm would silently be another.
    let old = "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'>
        <parent link='a'/><child link='b'/><origin quat_xyzw='0 0 1 0'/></joint></robot>";
    let old = read(old, &Selection::to(None)).unwrap_err();
    assert!(old.place == "j" && old.what.contains("from version 1.1 on"), "{old:?}");
}
