//! Payloads of the tactile side: images, features, contact events and the wrench.

use taktil_rtcore::{array_payload, payload};

/// In [`TactileImage::valid`]: to be believed, and at the converter's full scale.
pub const TACTEL_SATURATED: u8 = 2;

/// In [`Wrench::baseline_ready`]: a gauge stands at an end of its converter's range, so that the
/// load is at least this in some direction and otherwise unknown.
pub const WRENCH_OVER_RANGE: u32 = 2;

/// In [`Wrench::baseline_ready`]: a gauge has stood there for several readings in a row.
pub const WRENCH_SATURATED: u32 = 3;

/// Bits of [`Features::defined`].
pub mod defined {
    /// There is enough load for the features to mean anything.
    pub const CONTACT: u32 = 1;
    /// `x_c` and `y_c` mean something.
    pub const CENTROID: u32 = 2;
    /// `theta_z_rad` means something (the image is not round).
    pub const THETA_Z: u32 = 4;
    /// There may be load although [`CONTACT`] is not set: less than half of the array is to be
    /// believed, its baseline is not known, or the noise hides as much.
    pub const CONTACT_UNCERTAIN: u32 = 8;
}

array_payload! {
    /// One tactile frame after its baseline was taken away, from `tactile_scan`.
    pub struct TactileImage {
        /// When the frame was acquired, ns since the start of the run.
        pub acquired_ns: i64,
        /// Number of the frame; stays while nothing new arrives.
        pub sequence: u32,
        /// Rows in use.
        pub rows: u16,
        /// Columns in use.
        pub cols: u16,
        /// Counts above the baseline, row by row: index row * cols + column. Negative values are
        /// noise and stay.
        pub counts: Box<[f32]>,
        /// 0 where the tactel may not be believed, 1 where it may, [`TACTEL_SATURATED`] where it
        /// may and its reading was at the converter's full scale: there is at least that load.
        pub valid: Box<[u8]>,
        /// Acquisition time of each row relative to `acquired_ns`.
        pub row_offset_ns: Box<[i32]>,
        /// 1 once the baseline is known; before that `counts` are all zero.
        pub baseline_ready: u32,
        /// Standard deviation of a tactel at rest (counts), as measured with the baseline; 0
        /// before, and where the readings stood still.
        pub noise_counts: f32,
    }
    usual [256, 256, 16]
}

impl TactileImage {
    /// An image of an array of these many rows and columns in which nothing may be believed; the
    /// baseline is not known. Allocates.
    #[must_use]
    pub fn new(rows: u16, cols: u16) -> TactileImage {
        let tactels = usize::from(rows) * usize::from(cols);
        TactileImage {
            acquired_ns: 0,
            sequence: 0,
            rows,
            cols,
            counts: vec![0.0; tactels].into(),
            valid: vec![0; tactels].into(),
            row_offset_ns: vec![0; usize::from(rows)].into(),
            baseline_ready: 0,
            noise_counts: 0.0,
        }
    }
}

array_payload! {
    /// The rest level that images are counted from, from `tactile_scan`: written once, when it is
    /// known.
    pub struct TactileBaseline {
        /// When the last of its frames was acquired, ns since the start of the run.
        pub acquired_ns: i64,
        /// Frames that it is the mean of.
        pub frames: u32,
        /// Tactels that may be believed.
        pub trusted: u32,
        /// Standard deviation of a tactel (counts): the root of the mean variance of those that may
        /// be believed.
        pub noise_counts: f64,
        /// Mean of each tactel (counts), row by row.
        pub mean_counts: Box<[f32]>,
        /// 1 where the tactel may be believed.
        pub valid: Box<[u8]>,
    }
    usual [256, 256]
}

impl TactileBaseline {
    /// A baseline of that many tactels of which none may be believed. Allocates.
    #[must_use]
    pub fn new(tactels: usize) -> TactileBaseline {
        TactileBaseline {
            acquired_ns: 0,
            frames: 0,
            trusted: 0,
            noise_counts: 0.0,
            mean_counts: vec![0.0; tactels].into(),
            valid: vec![0; tactels].into(),
        }
    }
}

payload! {
    /// Features of the newest image, from `tactile_servo`.
    pub struct Features {
        /// When the image was acquired, ns since the start of the run.
        pub acquired_ns: i64,
        /// Sum of the counts.
        pub m0: f64,
        /// First moment about the middle line of the rows: sum of (y - 8.5) counts. 0 for a
        /// symmetric load.
        pub m_x: f64,
        /// Centroid along x in column numbers; 0 while undefined.
        pub x_c: f64,
        /// Centroid along y in row numbers; 0 while undefined.
        pub y_c: f64,
        /// Direction of the long axis, 0 along the sensor's y axis, positive from y towards -x; 0
        /// while undefined.
        pub theta_z_rad: f64,
        /// The x_c that the law is heading for.
        pub x_c_desired: f64,
        /// Bits of [`defined`].
        pub defined: u32,
        /// Number of the image.
        pub sequence: u32,
        /// How often the direction of rolling was reversed.
        pub reversals: u32,
        /// 1 while the law drives the arm.
        pub active: u32,
    }
}

payload! {
    /// What two opposed fingertips feel of the pin between them, from `tactile_servo` where it goes
    /// by both: the finger's first, in the units of [`Features`].
    pub struct FingertipPair {
        /// When the finger's image was acquired, ns since the start of the run.
        pub acquired_ns: i64,
        /// Sum of the counts.
        pub m0: [f64; 2],
        /// First moment about the middle line of the rows.
        pub m_x: [f64; 2],
        /// Centroid along x in column numbers.
        pub x_c: [f64; 2],
        /// Direction of the pin's axis, each in its own sensor.
        pub theta_z_rad: [f64; 2],
        /// Direction of the pin's axis in the finger's sensor as the other image and the arm's
        /// joints say it.
        pub theta_z_by_other_rad: f64,
        /// Way (mm) by which the contact went farther over the finger than over the other, along x,
        /// since the pin was first felt by both: 0 while the pin rolls on both without sliding.
        pub mismatch_mm: f64,
    }
}

payload! {
    /// What a hand feels of the object that it grasps, from `grasp`, finger by finger; zero for
    /// fingers that it lacks. While nothing is grasped the loads alone are told.
    pub struct GraspState {
        /// Release of the job, ns since the start of the run.
        pub at_ns: i64,
        /// Normal force by touch.
        pub load_n: [f64; 3],
        /// Middle of the load on the pad, along the sensor's x.
        pub middle_x_m: [f64; 3],
        /// Middle of the load on the pad, along the sensor's y.
        pub middle_y_m: [f64; 3],
        /// Tangential force by the motors' torques.
        pub tangential_n: [f64; 3],
        /// What friction bears at this load less the tangential force; negative beyond the cone.
        pub margin_n: [f64; 3],
        /// The smallest of them.
        pub least_margin_n: f64,
        /// The grip that is wanted.
        pub grip_n: f64,
        /// How far the fingertips are asked to go beyond where they touched.
        pub squeeze_m: f64,
        /// Time since every finger touched.
        pub held_s: f64,
        /// 0 while the law does not drive, 1 while the hand closes, 2 while it holds, 3 while it
        /// opens.
        pub phase: u32,
        /// Bit f is set while finger f is beyond its cone.
        pub beyond: u32,
        /// 1 for each finger that feels something.
        pub felt: [u32; 3],
    }
}

/// What [`Contact::kind`] says.
pub mod contact {
    /// Something is touched: the law drives.
    pub const GAINED: u32 = 1;
    /// Nothing is touched any more: the finger stands still.
    pub const LOST: u32 = 2;
    /// Contact did not come back: the finger seeks again, a short way.
    pub const SOUGHT: u32 = 3;
    /// Nothing was found: the finger draws back.
    pub const RETRACTED: u32 = 4;
    /// The finger rests without contact.
    pub const GIVEN_UP: u32 = 5;
}

payload! {
    /// Contact was gained or lost, or something was done about it, from `tactile_servo`; written
    /// when it happens.
    pub struct Contact {
        /// Release of the job, ns since the start of the run.
        pub at_ns: i64,
        /// Sum of the counts that decided.
        pub m0: f64,
        /// One of [`contact`].
        pub kind: u32,
        /// How often contact was gained in this stay.
        pub gained: u32,
        /// How often it was lost.
        pub lost: u32,
    }
}

/// Bits of [`Slip::seen`].
pub mod slip {
    /// The contact has lasted long enough for the test.
    pub const TEST_READY: u32 = 1;
    /// Sliding along the pad's x would show.
    pub const ALONG_X: u32 = 2;
    /// Sliding along the pad's y would show.
    pub const ALONG_Y: u32 = 4;
}

payload! {
    /// Whether what is touched slides over the pad, for each image, from `tactile_servo` where it
    /// has `[tactile_servo.slip]`.
    pub struct Slip {
        /// When the image was acquired, ns since the start of the run.
        pub acquired_ns: i64,
        /// Velocity of what is touched over the pad along its x and y (mm/s), less what the pad's
        /// own motion makes of it without sliding. An estimate for any image: only with `detected`
        /// it is more than noise.
        pub velocity_mm_s: [f64; 2],
        /// Chi-square statistic of the test for slip.
        pub statistic: f64,
        /// The statistic above which slip begins; 0 while the test is not ready.
        pub threshold: f64,
        /// Mean square of the counts' second differences over that of the noise alone: 1 at rest,
        /// more when the pad vibrates; 0 before three images.
        pub high_pass_energy: f64,
        /// 1 while it slides.
        pub detected: u32,
        /// Bits of [`slip`].
        pub seen: u32,
        /// How often slip began.
        pub onsets: u32,
        /// Number of the image.
        pub sequence: u32,
    }
}

/// What [`PhaseChange::cause`] says.
pub mod phase_cause {
    /// The task began.
    pub const TASK_STARTED: u32 = 1;
    /// The conditions of the phase before were met.
    pub const CONDITIONS_MET: u32 = 2;
    /// The phase before took too long.
    pub const TIME_OUT: u32 = 3;
    /// Contact was lost in the phase before.
    pub const CONTACT_LOST: u32 = 4;
    /// The finger was moved too far in the phase before, or was held up.
    pub const TOO_FAR: u32 = 5;
    /// A phase would have been entered too often.
    pub const TOO_OFTEN: u32 = 6;
}

payload! {
    /// A touch task went on to another phase, from `tactile_servo` with the law `phases`; written
    /// when it happens.
    pub struct PhaseChange {
        /// Release of the job, ns since the start of the run.
        pub at_ns: i64,
        /// Time in the phase before (s).
        pub time_s: f64,
        /// Motion in the phase before, along x, y, z and about them in the sensor's own frame (mm,
        /// mrad), as it was asked of the arm.
        pub moved: [f64; 6],
        /// Sum of the counts at the change.
        pub m0: f64,
        /// Number of the phase in its file, 1 the first; 0 after the end.
        pub phase: u32,
        /// Number of the phase before; 0 at the start.
        pub before: u32,
        /// One of [`phase_cause`].
        pub cause: u32,
        /// How often the phase has been entered.
        pub visits: u32,
    }
}

array_payload! {
    /// What an A/D board reads, channel by channel, from `analog_scan`.
    pub struct AnalogInputs {
        /// When the codes were converted, ns since the start of the run.
        pub acquired_ns: i64,
        /// Codes, signed about zero volts.
        pub codes: Box<[i32]>,
        /// What they stand for, in the unit of each channel.
        pub values: Box<[f64]>,
    }
    usual [8, 8]
}

impl AnalogInputs {
    /// The inputs of a board of that many channels, all zero. Allocates.
    #[must_use]
    pub fn new(channels: usize) -> AnalogInputs {
        AnalogInputs {
            acquired_ns: 0,
            codes: vec![0; channels].into(),
            values: vec![0.0; channels].into(),
        }
    }
}

payload! {
    /// The wrench of what touches the finger, on the tool and about the tool point in tool axes,
    /// from `wrist_scan`. Zero until the baseline is known.
    pub struct Wrench {
        /// When the gauges were read, ns since the start of the run.
        pub acquired_ns: i64,
        /// Force on the tool (N).
        pub force_n: [f64; 3],
        /// Moment about the tool point (N m).
        pub moment_nm: [f64; 3],
        /// 1 once the rest level of the gauges is known; [`WRENCH_OVER_RANGE`] or
        /// [`WRENCH_SATURATED`] where it is known and the wrench is not.
        pub baseline_ready: u32,
    }
}

impl Wrench {
    /// Whether the wrench is what touches the finger: the rest level is known, and every gauge is
    /// within its range.
    #[must_use]
    pub fn is_known(&self) -> bool {
        self.baseline_ready == 1
    }
}
