//! Reads the reference images and the parameters of their cases.

/// One reference image.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) shape: String,
    /// Mean over the tactel (by six by six points), or the value under its centre.
    pub(crate) area: bool,
    pub(crate) nu: f64,
    pub(crate) t: f64,
    pub(crate) radius: f64,
    pub(crate) force: f64,
    pub(crate) half_width: f64,
    pub(crate) delta: f64,
    pub(crate) place: [f64; 2],
    pub(crate) rot: f64,
    pub(crate) tilt: f64,
    pub(crate) length: f64,
    /// Row by row, x along a row.
    pub(crate) image: Vec<f64>,
    /// Columns from M0 on.
    pub(crate) features: Vec<f64>,
}

const FEATURES: &str = include_str!("../../../tests/fixtures/contact/tactile3d_features.csv");
const AREAS: &str = include_str!("../../../tests/fixtures/contact/tactile3d_images.csv");
const CENTRES: &str = include_str!("../fixtures/contact/tactile3d_centres.csv");

/// All reference images of a shape.
pub(crate) fn cases(shape: &str) -> Vec<Case> {
    let mut all = Vec::new();
    for line in FEATURES.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        if cells[2] != shape {
            continue;
        }
        let number = |i: usize| cells[i].trim().parse::<f64>().expect("a number in the table");
        let area = cells[1] == "average";
        all.push(Case {
            name: format!("{} {}", cells[0], cells[1]),
            shape: shape.to_owned(),
            area,
            nu: number(3),
            t: number(4),
            radius: number(5),
            force: number(6),
            half_width: number(7),
            delta: number(8),
            place: [number(9), number(10)],
            rot: number(11).to_radians(),
            tilt: number(12),
            length: number(13),
            image: image(cells[0], if area { AREAS } else { CENTRES }),
            features: (14..32).map(number).collect(),
        });
    }
    assert!(!all.is_empty(), "{shape}: an empty table checks nothing");
    all
}

fn image(case: &str, text: &str) -> Vec<f64> {
    let start = format!("{case},");
    let line = text.lines().find(|line| line.starts_with(&start)).expect("the case's image");
    let values: Vec<f64> =
        line.split(',').filter_map(|cell| cell.trim().parse::<f64>().ok()).collect();
    assert_eq!(values.len(), 256, "{case}");
    // The file runs along y first.
    (0..256).map(|n| values[n % 16 * 16 + n / 16]).collect()
}
