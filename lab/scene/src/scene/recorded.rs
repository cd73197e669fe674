//! Motions of the table from files: a CSV file beside the scene with `t_s` and one value per line.
//! Every error names the line of the file. A column whose unit is not that of the axis is an error.

use taktil_machine::source::{Located, Mark, Source};
use taktil_sim::scene::{Axis, Motion, POINTS_MAX, WorldConfig};

/// Returns the text of a file that a scene names.
pub type Read<'a> = &'a dyn Fn(&str) -> Result<Source, String>;

/// Reads the file of every motion that names one, and returns the names and files.
pub(super) fn fill(
    world: &mut WorldConfig,
    scene: &Source,
    read: Read<'_>,
) -> Result<Vec<(String, Source)>, Located> {
    let mut files = Vec::new();
    for (i, motion) in world.table.motion.iter_mut().enumerate() {
        let Some(name) = motion.file.clone() else { continue };
        let complain = |key: &str, what: &str, remedy: &str| {
            let place = format!("world.table.motion[{i}].{key}");
            scene.locate(taktil_rtcore::Invalid::new(place, what, remedy))
        };
        if motion.points_deg.is_some() || motion.points_mm.is_some() {
            return Err(complain("file", "stands beside points", "give one of the two"));
        }
        let source = read(&name).map_err(|what| {
            complain("file", &what, "name a CSV file by its path from the scene's folder")
        })?;
        let points = points(&source, motion.axis)?;
        set(motion, points);
        files.push((name, source));
    }
    Ok(files)
}

fn set(motion: &mut Motion, points: Vec<[f64; 2]>) {
    match motion.axis.unit() {
        "deg" => motion.points_deg = Some(points),
        _ => motion.points_mm = Some(points),
    }
}

/// The points of a table; empty lines and lines that begin with `#` are skipped.
fn points(source: &Source, axis: Axis) -> Result<Vec<[f64; 2]>, Located> {
    let complain = |line: usize, what: String, remedy: &str| {
        let text = source.text.lines().nth(line).unwrap_or_default().trim_end().to_owned();
        let width = text.chars().count().max(1);
        let mark = Some(Mark { line: line + 1, column: 1, text, width });
        Located { path: source.path.clone(), mark, what, remedy: remedy.to_owned() }
    };
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut headed = false;
    for (number, line) in source.text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut cells = line.split(',').map(str::trim);
        let (Some(first), Some(second), None) = (cells.next(), cells.next(), cells.next()) else {
            let what = "is not two columns".to_owned();
            return Err(complain(number, what, "write an instant, a comma and a value"));
        };
        if !headed {
            let unit = format!("_{}", axis.unit());
            if first != "t_s" || !second.ends_with(&unit) {
                let what = format!("the columns `{first}`, `{second}` do not fit this axis");
                return Err(complain(number, what, &format!("head them `t_s, NAME{unit}`")));
            }
            headed = true;
            continue;
        }
        let finite = |cell: &str| cell.parse::<f64>().ok().filter(|value| value.is_finite());
        let (Some(t_s), Some(value)) = (finite(first), finite(second)) else {
            let what = format!("`{line}` is not two finite numbers");
            return Err(complain(number, what, "use a point for decimals and no units"));
        };
        if t_s < 0.0 || points.last().is_some_and(|last| t_s <= last[0]) {
            let what = format!("{t_s} s is not after the line before");
            return Err(complain(number, what, "put the lines in order of time, from 0 on"));
        }
        points.push([t_s, value]);
    }
    if !(2..=POINTS_MAX).contains(&points.len()) {
        let what = format!("has {} points", points.len());
        return Err(complain(0, what, &format!("give 2 to {POINTS_MAX} lines under a heading")));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, axis: Axis) -> Result<Vec<[f64; 2]>, (usize, String)> {
        let source = Source { path: "hand.csv".into(), text: text.to_owned() };
        points(&source, axis).map_err(|bad| (bad.mark.unwrap().line, bad.what))
    }

    #[test]
    fn a_table_is_read_with_its_comments() {
        let text = "# by hand\n\nt_s, slide_mm\n0.0, 1\n0.5,2.5\n";
        assert_eq!(read(text, Axis::Slide).unwrap(), [[0.0, 1.0], [0.5, 2.5]]);
    }

    #[test]
    fn errors_name_their_line() {
        for (text, line) in [
            ("", 1),
            ("t_s,slide_mm\n0,1\n", 1),
            ("t_s,pan_deg\n0,1\n1,2\n", 1),
            ("t_ms,slide_mm\n0,1\n1,2\n", 1),
            ("t_s,slide_mm\n0,1\n1,nan\n", 3),
            ("t_s,slide_mm\n0,1\n1,2 mm\n", 3),
            ("t_s,slide_mm\n0,1\n1\n", 3),
            ("t_s,slide_mm\n0,1\n\n1,2\n0.5,2\n", 5),
            ("t_s,slide_mm\n-1,1\n1,2\n", 2),
        ] {
            assert_eq!(read(text, Axis::Slide).unwrap_err().0, line, "{text}");
        }
    }
}
