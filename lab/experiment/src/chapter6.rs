//! The experiments of chapter 6 of the thesis: what the thesis reports of each, and which figures
//! of a run are compared with it. Only numbers that the thesis prints are stated.

use super::evaluation::Evaluation;

/// One experiment of the thesis.
#[derive(Clone, Copy, Debug)]
pub struct Experiment {
    /// E1 to E9, the first word of the scenes' titles.
    pub id: &'static str,
    /// The figures of the thesis.
    pub figures: &'static str,
    /// A description of the experiment.
    pub about: &'static str,
    /// The thesis's result in a sentence.
    pub reported: &'static str,
    /// The panels of the figure.
    pub panels: &'static [PanelSpec],
}

/// A panel of a figure.
#[derive(Clone, Copy, Debug)]
pub struct PanelSpec {
    /// Column of a trace.
    pub column: &'static str,
    /// Heading.
    pub title: &'static str,
    /// The range or the level that the thesis prints.
    pub stated: Option<(f64, f64)>,
}

const fn panel(column: &'static str, title: &'static str) -> PanelSpec {
    PanelSpec { column, title, stated: None }
}

const fn panel_with_range(
    column: &'static str,
    title: &'static str,
    low: f64,
    high: f64,
) -> PanelSpec {
    PanelSpec { column, title, stated: Some((low, high)) }
}

const FORCE_PANEL: PanelSpec = panel("force", "true normal force (N)");
const YAW_PANEL: PanelSpec = panel("yaw", "true yaw of the pin on the sensor (deg)");
const TILT_PANEL: PanelSpec = panel("tilt", "true tilt of the finger on the pin (deg)");
const HEIGHT_PANEL: PanelSpec = panel("height", "height error (mm)");

/// All nine experiments.
pub const EXPERIMENTS: [Experiment; 9] = [
    Experiment {
        id: "E1",
        figures: "6.9 to 6.12",
        about: "table aligned with the base frame",
        reported: "three reversals in 10 s; x_c 3 to 14 while p_x 308 to 342 mm; p_z -148.2 to \
                   -149.6 mm; M0 near 15000 with large spikes; theta_z noise about +-5 deg",
        panels: &[
            panel_with_range("x_c", "x_c (column)", 3.0, 14.0),
            panel_with_range("p_x", "p_x (mm)", 308.0, 342.0),
            panel_with_range("m0", "M0 (counts)", 15_000.0, 15_000.0),
            panel_with_range("p_z", "p_z (mm)", -149.6, -148.2),
            panel_with_range("theta_z", "theta_z as read (deg)", -5.0, 5.0),
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E2",
        figures: "6.13",
        about: "table tilted about y0",
        reported: "p_x 285 to 318 mm; p_z -156.5 to -152 mm (4.5 mm, about 8 deg); M0 raised while \
                   climbing, lowered while descending",
        panels: &[
            panel_with_range("p_x", "p_x (mm)", 285.0, 318.0),
            panel_with_range("p_z", "p_z (mm)", -156.5, -152.0),
            panel_with_range("m0", "M0 (counts)", 15_000.0, 15_000.0),
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E3",
        figures: "6.15",
        about: "table tilted about x0",
        reported: "theta_zz 185 to 185.5 deg (printed as -175 to -174.5): 14 deg from E1",
        panels: &[
            panel_with_range("theta_zz", "theta_zz (deg)", 185.0, 185.5),
            TILT_PANEL,
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E4",
        figures: "6.16",
        about: "table panned about z0",
        reported: "theta_xx 198.5 to 200 deg (printed as -161.5 to -160): 22 deg from E1",
        panels: &[
            panel_with_range("theta_xx", "theta_xx (deg)", 198.5, 200.0),
            YAW_PANEL,
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E5",
        figures: "6.17 to 6.20",
        about: "table rotated about all three axes",
        reported: "p_x 286 to 318 mm; p_z -116.5 to -111.5 mm; theta_zz 171.6 to 172 deg; theta_xx \
                   197.3 to 197.8 deg (printed as -162.7 to -162.2)",
        panels: &[
            panel_with_range("p_x", "p_x (mm)", 286.0, 318.0),
            panel_with_range("p_z", "p_z (mm)", -116.5, -111.5),
            panel_with_range("theta_zz", "theta_zz (deg)", 171.6, 172.0),
            panel_with_range("theta_xx", "theta_xx (deg)", 197.3, 197.8),
        ],
    },
    Experiment {
        id: "E6",
        figures: "6.21, 6.22",
        about: "table turning about y0 while the pin is rolled",
        reported: "p_z -149.5 to -134.5 mm in 6.75 s; the stroke uphill longer, downhill shorter",
        panels: &[
            panel_with_range("p_z", "p_z (mm)", -149.5, -134.5),
            panel("p_x", "p_x (mm)"),
            HEIGHT_PANEL,
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E7",
        figures: "6.23",
        about: "table turning about x0",
        reported: "theta_zz 170 to 185 deg, then steady",
        panels: &[
            panel_with_range("theta_zz", "theta_zz (deg)", 170.0, 185.0),
            TILT_PANEL,
            panel("m_x", "M_x (counts x rows)"),
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E8",
        figures: "6.24 to 6.26",
        about: "table panning about z0 at about 5 deg/s",
        reported: "the finger follows at 1.2 deg/s only: the theta_z loop is the weak point",
        panels: &[
            panel("pan", "turn of the table (deg)"),
            panel("theta_xx", "theta_xx (deg)"),
            YAW_PANEL,
            FORCE_PANEL,
        ],
    },
    Experiment {
        id: "E9",
        figures: "6.27",
        about: "table slid along x0",
        reported: "p_x 356 to 320 mm in 4 s, then 320 to 400 mm: 44 mm more than the stroke; x_c \
                   hardly changes",
        panels: &[
            panel_with_range("p_x", "p_x (mm)", 320.0, 400.0),
            panel("x_c", "x_c (column)"),
            FORCE_PANEL,
        ],
    },
];

/// One row of the tables.
#[derive(Clone, Copy)]
pub struct Measure {
    /// The measured quantity with its unit.
    pub what: &'static str,
    /// Returns the quantity of a run.
    pub of: fn(&Evaluation) -> Option<f64>,
}

const fn measure(what: &'static str, of: fn(&Evaluation) -> Option<f64>) -> Measure {
    Measure { what, of }
}

/// The rows of every table.
pub const MEASURES: [Measure; 24] = [
    measure("reversals", |v| Some(f64::from(v.figures.strokes))),
    measure("contact losses", |v| Some(f64::from(v.figures.contact_lost))),
    measure("faults", |v| Some(f64::from(v.figures.faults.0.count_ones()))),
    measure("force error rms (N)", |v| v.force_n.rms()),
    measure("force error peak (N)", |v| v.force_n.peak()),
    measure("force error mean (N)", |v| v.force_n.mean()),
    measure("height error rms (mm)", |v| v.height_mm.rms()),
    measure("height error peak (mm)", |v| v.height_mm.peak()),
    measure("tilt error rms (deg)", |v| v.tilt_deg.rms()),
    measure("tilt error peak (deg)", |v| v.tilt_deg.peak()),
    measure("yaw error rms (deg)", |v| v.yaw_deg.rms()),
    measure("yaw error peak (deg)", |v| v.yaw_deg.peak()),
    measure("yaw lag at the end (deg)", |v| v.yaw_deg.steady().map(f64::abs)),
    measure("turn of finger over table", |v| v.pan_rate_share),
    measure("theta_z as read rms (deg)", |v| v.theta_z_deg.rms()),
    measure("theta_z noise rms (deg)", |v| v.theta_z_noise_deg.rms()),
    measure("contact place error rms (mm)", |v| v.place_mm.rms()),
    measure("M0 error rms (counts)", |v| v.figures.m0_error.rms()),
    measure("M_x error rms (counts x rows)", |v| v.figures.m_x_error.rms()),
    measure("settling from first touch (s)", |v| v.settling_s),
    measure("finger over contact travel", |v| {
        let contact = v.figures.x_c.width()? * v.figures.pitch_x_mm;
        (contact > 1.0).then_some(v.figures.p_x_mm.width()? / contact)
    }),
    measure("fastest slip (mm/s)", |v| v.figures.slip_mm_s),
    measure("torque rms (N m)", |v| v.torque_nm.rms()),
    measure("torque change rms (N m a job)", |v| v.torque_change_nm.rms()),
];
