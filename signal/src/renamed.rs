//! Ports and payload fields that have another name now. Logs and machine files that were written
//! before are read by these tables; the digest of a run hashes the names of signals, so a digest of
//! that time is found again by the names that [`earlier_port`] gives.

/// Ports, outputs and inputs alike, as `(old name, name now)`.
pub const RENAMED_PORTS: &[(&str, &str)] = &[
    ("operator.typed", "operator.queue"),
    ("tactile_servo.pair", "tactile_servo.fingertip_pair"),
    ("trajectory.typed", "trajectory.queue"),
    ("world.work", "world.statistics"),
];

/// Payload types, as `(port by its name now, old name, name now)`.
pub const RENAMED_PAYLOADS: &[(&str, &str, &str)] = &[
    ("operator.moves", "TypedMove", "OperatorMove"),
    ("tactile_servo.fingertip_pair", "Pair", "FingertipPair"),
    ("trajectory.queue", "Typed", "MoveQueue"),
    ("world.statistics", "WorkTruth", "WorldStatistics"),
];

/// Fields of payloads, as `(port by its name now, old name, name now)`.
pub const RENAMED_FIELDS: &[(&str, &str, &str)] = &[
    ("jog.state", "stands", "stopped"),
    ("jog.state", "why", "obstacle"),
    ("sense.home", "off_counts", "error_counts"),
    ("sense.home", "off_rad", "error_rad"),
    ("trajectory.check", "off_path_m", "path_error_m"),
    ("trajectory.check", "off_path_rad", "path_error_rad"),
    ("trajectory.queue", "judged", "checked"),
    ("trajectory.queue", "taken", "received"),
    ("world.layer", "plain", "spatial_failures"),
    ("world.layer", "solved", "spatial_solutions"),
    ("world.object", "along_m", "arc_length_m"),
    ("world.object", "off_m", "offset_m"),
    ("world.object", "place_m", "centre_of_load_m"),
    ("world.statistics", "contacts", "contact_evaluations"),
    ("world.statistics", "halved", "halved_steps"),
    ("world.statistics", "images", "tactile_images"),
    ("world.statistics", "iterations", "newton_iterations"),
    ("world.statistics", "plain", "spatial_failures"),
    ("world.statistics", "solved", "spatial_solutions"),
    ("world.statistics", "unsettled", "unconverged_steps"),
    ("world.truth", "steadied", "fixture_active"),
];

/// The name that a port (`task.port`) has now.
#[must_use]
pub fn current_port(name: &str) -> &str {
    RENAMED_PORTS.iter().find(|(old, _)| *old == name).map_or(name, |(_, new)| new)
}

/// The name that a port (`task.port`) had at first.
#[must_use]
pub fn earlier_port(name: &str) -> &str {
    RENAMED_PORTS.iter().find(|(_, new)| *new == name).map_or(name, |(old, _)| old)
}

fn on_port<'a>(table: &'static [(&str, &str, &str)], port: &str, name: &'a str) -> &'a str {
    let renamed = table.iter().find(|row| row.0 == port && row.1 == name);
    renamed.map_or(name, |row| row.2)
}

/// The name that a payload type has now; `port` is the name now of the port that carries it.
#[must_use]
pub fn current_payload<'a>(port: &str, name: &'a str) -> &'a str {
    on_port(RENAMED_PAYLOADS, port, name)
}

/// The name that a field has now; `port` is the name now of the port that carries it.
#[must_use]
pub fn current_field<'a>(port: &str, name: &'a str) -> &'a str {
    on_port(RENAMED_FIELDS, port, name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Payload;

    #[test]
    fn an_old_name_leads_to_the_name_now_and_back() {
        for (old, new) in RENAMED_PORTS {
            assert_eq!((current_port(old), current_port(new)), (*new, *new));
            assert_eq!((earlier_port(new), earlier_port(old)), (*old, *old));
        }
        for (port, old, new) in RENAMED_PAYLOADS {
            assert_eq!((current_payload(port, old), current_payload(port, new)), (*new, *new));
            assert_eq!(current_payload("sway.state", old), *old, "the payload of another task");
        }
        for (port, old, new) in RENAMED_FIELDS {
            assert_eq!((current_field(port, old), current_field(port, new)), (*new, *new));
            assert_eq!(current_field("sway.state", old), *old, "the field of another task");
        }
    }

    #[test]
    fn the_payloads_here_have_the_names_that_the_table_says() {
        let here = [
            ("sense.home", <crate::HomeCheck>::FIELDS),
            ("jog.state", crate::JogState::FIELDS),
            ("trajectory.check", crate::MoveCheck::FIELDS),
            ("trajectory.queue", crate::MoveQueue::FIELDS),
        ];
        for (port, old, new) in RENAMED_FIELDS {
            let Some((_, fields)) = here.iter().find(|(name, _)| name == port) else { continue };
            assert!(fields.iter().any(|field| field.name == *new), "{port}.{new}");
            assert!(fields.iter().all(|field| field.name != *old), "{port}.{old}");
        }
    }
}
