//! Keys of configuration files that have another name now. A file with an old key is refused with
//! the new one; the texts that stand in a log are brought up to date instead, so that a run that
//! was recorded before can be replayed.

use taktil_signal::renamed::current_port;

/// A key that was renamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenamedKey {
    /// A table that the key stands in, directly or deeper; empty where the old name was used for
    /// one meaning only.
    pub section: &'static str,
    /// What the key was called.
    pub old: &'static str,
    /// What it is called now.
    pub new: &'static str,
}

const fn key(section: &'static str, old: &'static str, new: &'static str) -> RenamedKey {
    RenamedKey { section, old, new }
}

/// Every key that was renamed, of machine files and scenes.
pub const RENAMED_KEYS: &[RenamedKey] = &[
    key("", "again_mm", "search_mm"),
    key("", "arm_every", "arm_refresh_steps"),
    key("", "baseline_most_frames", "baseline_frames_max"),
    key("", "bend_mm", "arc_radius_mm"),
    key("", "carries_n", "pin_weight_n"),
    key("", "course_deg", "trajectory_deg"),
    key("", "dead_man_s", "key_timeout_s"),
    key("", "estop_disagree_s", "estop_discrepancy_s"),
    key("", "failures_allowed", "failures_max"),
    key("", "farthest_rev", "distance_max_rev"),
    key("", "hold_unfelt_per_s", "drift_correction_per_s"),
    key("", "late_scans", "delay_scans"),
    key("", "learned_friction", "adaptive_friction"),
    key("", "learned_turn_rad", "friction_reversal_rad"),
    key("", "off_path_deg", "path_error_max_deg"),
    key("", "off_path_mm", "path_error_max_mm"),
    key("", "overload_share", "overload_ratio"),
    key("", "rest_max_share", "rest_max_ratio"),
    key("", "roll_from_counts", "roll_min_counts"),
    key("", "silent_after_us", "stall_limit_us"),
    key("", "steadied", "fixture"),
    key("", "steady_until_n", "fixture_release_n"),
    key("", "still_deg", "standstill_deg"),
    key("", "still_time_s", "standstill_time_s"),
    key("", "touch_silent_s", "tactile_timeout_s"),
    key("", "yaw_known_deg", "yaw_std_dev_deg"),
    key("", "yield_per_s", "compliance_per_s"),
    key("fault", "share", "fraction"),
    key("lane", "late", "late_policy"),
    key("opposed_scan", "dead", "dead_tactels"),
    key("operator", "say", "command"),
    key("operator", "swings", "half_cycles"),
    key("tactile_scan", "dead", "dead_tactels"),
    key("tactile_servo", "lost", "contact_loss"),
];

/// What the key `old` is called now; `place` is the dotted path that it stands at.
#[must_use]
pub fn renamed_key(place: &str, old: &str) -> Option<&'static str> {
    let within =
        |section: &str| section.is_empty() || place.split(['.', '[']).any(|part| part == section);
    let renamed = RENAMED_KEYS.iter().find(|key| key.old == old && within(key.section));
    renamed.map(|key| key.new)
}

/// The text of a machine file or a scene with the keys and ports of today. A text without old names
/// and one that is no TOML stay as they are; comments are lost where a name is changed.
#[must_use]
pub fn with_current_keys(text: &str) -> String {
    let Ok(mut table) = text.parse::<toml::Table>() else {
        return text.to_owned();
    };
    if !rename_keys(&mut table, "") {
        return text.to_owned();
    }
    toml::to_string(&table).unwrap_or_else(|_| text.to_owned())
}

/// Renames the keys of a table that stands at `place`; whether there was one.
fn rename_keys(table: &mut toml::Table, place: &str) -> bool {
    let mut changed = false;
    for (key, mut value) in std::mem::take(table) {
        let path = if place.is_empty() { key.clone() } else { format!("{place}.{key}") };
        let name = if place.split('.').next_back() == Some("wiring") {
            changed |= rename_port(&mut value);
            current_port(&key).to_owned()
        } else {
            renamed_key(&path, &key).map_or_else(|| key.clone(), str::to_owned)
        };
        changed |= name != key;
        // What stands in the section of a task from outside has names of its own.
        let foreign = path.split('.').any(|part| part == "own");
        changed |= !foreign && rename_in_value(&mut value, &path);
        table.insert(name, value);
    }
    changed
}

fn rename_in_value(value: &mut toml::Value, path: &str) -> bool {
    match value {
        toml::Value::Table(table) => rename_keys(table, path),
        toml::Value::Array(array) => {
            // Every item is renamed, also behind the first one that was.
            array.iter_mut().map(|item| usize::from(rename_in_value(item, path))).sum::<usize>() > 0
        }
        _ => false,
    }
}

/// Brings the signal that an input is wired to up to date; whether it had an old name.
fn rename_port(signal: &mut toml::Value) -> bool {
    let new = signal.as_str().map(|name| (name, current_port(name)));
    let Some(new) = new.filter(|(old, new)| old != new).map(|(_, new)| new.to_owned()) else {
        return false;
    };
    *signal = toml::Value::String(new);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_new_key_is_an_old_one() {
        for key in RENAMED_KEYS {
            let again = RENAMED_KEYS.iter().find(|other| {
                other.old == key.new && (other.section.is_empty() || other.section == key.section)
            });
            assert_eq!(again, None);
            assert_eq!(
                renamed_key(&format!("{}.x.{}", key.section, key.old), key.old),
                Some(key.new)
            );
        }
        assert_eq!(renamed_key("world.tactile.defect[0].dead", "dead"), None);
        assert_eq!(renamed_key("operator[0].say", "say"), Some("command"));
    }

    #[test]
    fn a_text_of_before_reads_as_one_of_today() {
        let before = "[robot.wiring]\n\"operator.typed\" = \"trajectory.typed\"\n\
                      [robot.own.a]\nlate_scans = 1\n[robot.own.b]\nx = 0.1\n\
                      [[operator]]\nsay = \"wait\"\n[robot.tactile_servo.lost]\nagain_mm = 3.0\n";
        let today = "[robot.wiring]\n\"operator.queue\" = \"trajectory.queue\"\n\
                     [robot.own.a]\nlate_scans = 1\n[robot.own.b]\nx = 0.1\n\
                     [[operator]]\ncommand = \"wait\"\n\
                     [robot.tactile_servo.contact_loss]\nsearch_mm = 3.0\n";
        let table = |text: &str| text.parse::<toml::Table>().unwrap();
        assert_eq!(table(&with_current_keys(before)), table(today));
        assert_eq!(with_current_keys(today), today);
        assert_eq!(with_current_keys("title = \n"), "title = \n");
    }
}
