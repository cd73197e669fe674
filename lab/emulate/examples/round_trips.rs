//! Opens the card of `taktil hal emulate mesa` with the production driver and cycles at 400 Hz with
//! the brakes on: how long each sample took, and what the driver counted.
//!
//! `round_trips ADDRESS:PORT [SECONDS]`

#[path = "../tests/common/card.rs"]
mod card;

use taktil_drivers_mesa::Board;
use taktil_hal::{AnalogOut, CHANNELS, Clock, DacCode, DigitalOut, Encoders, LinesOut, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// The cycle of the thesis's servo.
const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().ok_or("give the card's address, as the emulator prints it")?;
    let seconds: f64 = arguments.next().map_or(Ok(10.0), |text| text.parse())?;
    let mut halves = Board::open(&card::card_config(&address))?;
    let (Some(encoders), Some(analog), Some(lines)) =
        (&mut halves.encoders, &mut halves.analog_out, &mut halves.digital_out)
    else {
        return Err("the card lacks a half".into());
    };
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let (mut times, mut failures, mut late) = (Vec::new(), 0, Vec::new());
    let cycles = (seconds * 1e9 / CYCLE_PERIOD.0 as f64) as i64;
    let mut release = clock.now();
    for cycle in 0..cycles {
        // A release that has passed is left out, as a lane leaves out a job.
        release = (release + CYCLE_PERIOD).max(clock.now());
        clock.sleep_until(release);
        let begin = clock.now();
        let sampled = encoders.sample(release).is_ok();
        times.push((clock.now() - begin).as_micros_f64());
        late.push((begin - release).as_micros_f64());
        let feed = LinesOut { watchdog_feed: cycle % 2 == 0, ..LinesOut::SAFE };
        let written = analog.commit(release, &[DacCode(0); CHANNELS]).is_ok()
            & lines.commit(release, &feed).is_ok();
        failures += u64::from(!sampled || !written);
    }
    for (name, values) in [("sample", &mut times), ("release late", &mut late)] {
        values.sort_by(f64::total_cmp);
        let part = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        println!(
            "{name}: median {:.0} us, 99 % {:.0} us, 99.9 % {:.0} us, most {:.0} us",
            part(0.5),
            part(0.99),
            part(0.999),
            part(1.0)
        );
    }
    println!("{failures} of {cycles} cycles failed; {:?}", halves.monitor.diagnostics());
    Ok(())
}
