//! The files of one recorder in their folder: the newest at the path that was given, older ones
//! beside it, named after the instant at which they were written last. Files of other names are
//! neither counted nor touched.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use nix::errno::Errno;
use nix::fcntl::{AT_FDCWD, RenameFlags, renameat2};
use taktil_rtcore::Invalid;

use crate::file::{lock, open_regular};

/// Crashes whose recordings are kept whatever the budget says: the unfinished file, and the
/// finished one before it.
pub(super) const CRASHES_KEPT: usize = 4;
/// Names tried for one instant.
const NAMES_MAX: u32 = 1000;
/// Characters of a stamp such as `20261127T084500Z`.
const STAMP_CHARACTERS: usize = 16;

/// A recording that was set aside.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct OldSegment {
    /// When it was written last, as its name says, and its number within that second.
    stamp: (String, u32),
    pub(super) path: PathBuf,
    pub(super) bytes: u64,
    /// It has its summary: nobody died while writing it.
    pub(super) finished: bool,
}

/// Refuses a path that is no place for a log.
///
/// # Errors
/// A folder that is not there, a file that is none; the place is `path`.
pub(super) fn check_place(path: &Path) -> Result<(), Invalid> {
    let bad = |what: String, remedy: &str| Err(Invalid::new("path", what, remedy));
    let shown = path.display();
    let Some(_) = path.file_name() else {
        return bad(format!("{shown} names no file"), "name a file such as run.mcap");
    };
    let folder = folder_of(path);
    if !folder.is_dir() {
        return bad(format!("there is no folder {}", folder.display()), "make it first");
    }
    let Ok(about) = std::fs::metadata(path) else { return Ok(()) };
    if about.is_dir() {
        return bad(format!("{shown} is a directory"), "name a file in it");
    }
    if !about.is_file() {
        return bad(format!("{shown} is a pipe, a socket or a device"), "name a file");
    }
    Ok(())
}

/// The folder of a path, also of a bare name.
pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Stem and extension, with the dot, of a path.
fn name_parts(path: &Path) -> (String, String) {
    let extension = path.extension().map(|part| format!(".{}", part.to_string_lossy()));
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    (stem.into_owned(), extension.unwrap_or_default())
}

/// Renames what is at `path` after the instant at which it was written last; `None` where there is
/// nothing, or an empty file. Nothing is overwritten.
///
/// # Errors
/// A file that another process is writing, or that cannot be renamed.
pub(super) fn set_aside(path: &Path) -> anyhow::Result<Option<PathBuf>> {
    match std::fs::symlink_metadata(path) {
        Ok(_) => {}
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => bail!("{}: {error}", path.display()),
    }
    let shown = path.display();
    let file = open_regular(path).with_context(|| format!("cannot keep {shown}"))?;
    lock(&file).with_context(|| format!("cannot keep {shown}"))?;
    let about = file.metadata()?;
    if about.len() == 0 {
        return Ok(None);
    }
    let (stem, extension) = name_parts(path);
    let stamp = utc_stamp(about.mtime());
    for number in 1..=NAMES_MAX {
        let suffix = if number == 1 { String::new() } else { format!("-{number}") };
        let target = folder_of(path).join(format!("{stem}-{stamp}{suffix}{extension}"));
        match rename_to_new(path, &target) {
            Ok(()) => return Ok(Some(target)),
            Err(Errno::EEXIST) => {}
            Err(error) => bail!("cannot keep {shown} as {}: {error}", target.display()),
        }
    }
    bail!("cannot keep {shown}: {NAMES_MAX} names of that instant are taken")
}

/// Renames a file unless the new name is taken.
fn rename_to_new(from: &Path, to: &Path) -> Result<(), Errno> {
    match renameat2(AT_FDCWD, from, AT_FDCWD, to, RenameFlags::RENAME_NOREPLACE) {
        // A file system that cannot promise it; this process alone uses these names.
        Err(Errno::EINVAL | Errno::ENOSYS) if to.symlink_metadata().is_ok() => Err(Errno::EEXIST),
        Err(Errno::EINVAL | Errno::ENOSYS) => std::fs::rename(from, to)
            .map_err(|error| error.raw_os_error().map_or(Errno::EIO, Errno::from_raw)),
        renamed => renamed,
    }
}

/// The recordings of `path` that were set aside, oldest first.
pub(super) fn old_segments(path: &Path) -> Vec<OldSegment> {
    let (stem, extension) = name_parts(path);
    let Ok(entries) = std::fs::read_dir(folder_of(path)) else { return Vec::new() };
    let segment = |entry: std::fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let inner = name.strip_prefix(&stem)?.strip_prefix('-')?.strip_suffix(&extension)?;
        let stamp = parse_stamp(inner)?;
        let about = entry.metadata().ok().filter(std::fs::Metadata::is_file)?;
        let path = entry.path();
        let finished = is_finished(&path);
        Some(OldSegment { stamp, path, bytes: about.len(), finished })
    };
    let mut segments: Vec<OldSegment> = entries.flatten().filter_map(segment).collect();
    segments.sort();
    segments
}

/// Stamp and number of the middle of a name.
fn parse_stamp(inner: &str) -> Option<(String, u32)> {
    let (stamp, rest) = inner.split_at_checked(STAMP_CHARACTERS)?;
    let shape = stamp.bytes().enumerate().all(|(at, byte)| match at {
        8 => byte == b'T',
        15 => byte == b'Z',
        _ => byte.is_ascii_digit(),
    });
    let number = if rest.is_empty() { Some(1) } else { rest.strip_prefix('-')?.parse().ok() };
    shape.then_some(())?;
    Some((stamp.to_owned(), number?))
}

/// Whether a log ends as a closed one does.
fn is_finished(path: &Path) -> bool {
    let end = || {
        let mut file = File::open(path).ok()?;
        let mut end = [0; 8];
        file.seek(SeekFrom::End(-8)).ok()?;
        file.read_exact(&mut end).ok()?;
        Some(end)
    };
    end().is_some_and(|end| end == *mcap::MAGIC)
}

/// The recordings that have to go so that the rest takes at most `allowed` bytes: the oldest first,
/// without those that show a crash.
pub(super) fn surplus(segments: &[OldSegment], allowed: u64) -> Vec<&OldSegment> {
    let mut evidence = vec![false; segments.len()];
    let crashes = segments.iter().enumerate().rev().filter(|(_, segment)| !segment.finished);
    for (index, _) in crashes.take(CRASHES_KEPT) {
        evidence[index] = true;
        if let Some(before) = index.checked_sub(1) {
            evidence[before] = true;
        }
    }
    let mut total: u64 = segments.iter().map(|segment| segment.bytes).sum();
    let mut out = Vec::new();
    for (segment, _) in segments.iter().zip(evidence).filter(|(_, evidence)| !evidence) {
        if total <= allowed {
            break;
        }
        total -= segment.bytes;
        out.push(segment);
    }
    out
}

/// An instant in UTC as it stands in names: `20261127T084500Z`. The civil date follows from the
/// number of days by the calendar of 400 years, which begins in March.
fn utc_stamp(unix_s: i64) -> String {
    let (days, second) = (unix_s.div_euclid(86_400), unix_s.rem_euclid(86_400));
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_those_of_the_calendar() {
        // `date -u -d @N +%Y%m%dT%H%M%SZ` of GNU coreutils.
        for (unix_s, stamp) in [
            (0, "19700101T000000Z"),
            (951_782_399, "20000228T235959Z"),
            (951_782_400, "20000229T000000Z"),
            (1_795_769_100, "20261127T084500Z"),
            (4_107_542_400, "21000301T000000Z"),
            (-1, "19691231T235959Z"),
        ] {
            assert_eq!(utc_stamp(unix_s), stamp);
            assert_eq!(parse_stamp(stamp), Some((stamp.to_owned(), 1)));
        }
        assert_eq!(parse_stamp("20261127T084500Z-12").unwrap().1, 12);
        for other in ["20261127T084500", "20261127T084500Z2", "2026112 T084500Z", "\u{e9}", ""] {
            assert_eq!(parse_stamp(other), None, "{other}");
        }
    }

    fn segment(number: u32, finished: bool) -> OldSegment {
        let stamp = ("20260101T000000Z".to_owned(), number);
        OldSegment { stamp, path: PathBuf::from(number.to_string()), bytes: 10, finished }
    }

    fn gone(segments: &[OldSegment], allowed: u64) -> Vec<u32> {
        surplus(segments, allowed).iter().map(|segment| segment.stamp.1).collect()
    }

    #[test]
    fn the_oldest_go_first_and_crashes_with_the_file_before_them_stay() {
        let all: Vec<OldSegment> = (1..=6).map(|number| segment(number, number != 3)).collect();
        assert_eq!(gone(&all, 60), [0; 0]);
        assert_eq!(gone(&all, 45), [1, 4]);
        assert_eq!(gone(&all, 0), [1, 4, 5, 6], "2 and 3 are evidence whatever the budget");
    }

    #[test]
    fn crashes_that_are_older_than_the_newest_four_go_as_others_do() {
        let all: Vec<OldSegment> = (1..=6).map(|number| segment(number, false)).collect();
        assert_eq!(gone(&all, 0), [1], "2 stands before the fourth newest crash");
    }
}
