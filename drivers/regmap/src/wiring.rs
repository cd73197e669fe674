//! Builds the halves of a board from its description and the channels that are wired.

use std::sync::Arc;

use taktil_hal::{CHANNELS, DacCode, FORCE_TORQUE_CHANNELS, Invalid, Nanos};

use crate::acquisition::{Acquisition, Strobe};
use crate::block::{NumberedReadings, Numbers, Presence};
use crate::bus::{Bank, Bus, Field, State};
use crate::config::Config;
use crate::description::{Description, InputBank, StartBy, StrobeKind};
use crate::encoders::{Counters, ENCODERS_NAME, IndexLatch, RegisterEncoders};
use crate::inputs::{
    ANALOG_IN_NAME, Converters, DIGITAL_IN_NAME, FORCE_TORQUE_NAME, InputMasks, RegisterAnalogIn,
    RegisterDigitalIn, RegisterForceTorque,
};
use crate::outputs::{OutputChannels, OutputMasks, RegisterAnalogOut, RegisterDigitalOut};
use crate::tactile::{FrameRegisters, RegisterTactile};

/// Which channels of the board stand at which places of the halves.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wiring {
    pub(crate) encoders: Vec<usize>,
    pub(crate) analog_out: Vec<usize>,
    pub(crate) analog_in: Vec<usize>,
    pub(crate) gauges: Vec<usize>,
}

impl Wiring {
    /// The wired channels, checked against those that the board has.
    ///
    /// # Errors
    /// A channel that the board does not have, more channels than a half carries, or outputs of
    /// which nobody says when they are switched off after the last sign of life.
    pub(crate) fn find(config: &Config, description: &Description) -> Result<Wiring, Invalid> {
        let banks = [
            description.encoders.as_ref().map_or(0, |bank| bank.channels),
            description.analog_out.as_ref().map_or(0, |bank| bank.channels),
            description.analog_in.as_ref().map_or(0, |bank| bank.channels),
        ];
        if !config.is_described() {
            let first = |count: usize| (0..count).collect();
            return Ok(Wiring {
                encoders: first(config.joints),
                analog_out: first(config.dac_channels),
                analog_in: first(config.adc_channels),
                gauges: chosen("gauge_channels", &config.gauge_channels, banks[2])?,
            });
        }
        let [encoders, outputs, inputs, _] = config.selections();
        let outputs_wired = all_or_chosen(outputs.0, outputs.1, banks[1])?;
        let has_outputs = description.digital_out.is_some() || !outputs_wired.is_empty();
        if has_outputs && description.watchdog.is_none() && config.relay_ms.is_none() {
            let what = "is missing for a board whose outputs have no watchdog";
            let remedy = "state after how long a relay or the amplifiers switch the drives off";
            return Err(Invalid::new("relay_ms", what, remedy));
        }
        Ok(Wiring {
            encoders: all_or_chosen(encoders.0, encoders.1, banks[0])?,
            analog_out: outputs_wired,
            analog_in: all_or_chosen(inputs.0, inputs.1, banks[2])?,
            gauges: chosen("gauge_channels", &config.gauge_channels, banks[2])?,
        })
    }
}

/// The channels that are listed; all when none is.
fn all_or_chosen(key: &str, listed: &[usize], channels: usize) -> Result<Vec<usize>, Invalid> {
    if !listed.is_empty() {
        return chosen(key, listed, channels);
    }
    if channels > CHANNELS {
        let what = format!("is empty for {channels} channels, and a half carries {CHANNELS}");
        return Err(Invalid::new(key, what, "list those that are wired"));
    }
    Ok((0..channels).collect())
}

fn chosen(key: &str, listed: &[usize], channels: usize) -> Result<Vec<usize>, Invalid> {
    for (at, channel) in listed.iter().enumerate() {
        if *channel >= channels {
            let what = format!("the board has no channel {channel}");
            let remedy = match channels {
                0 => "leave it out: the description has no such bank".to_owned(),
                _ => format!("give 0 to {}", channels - 1),
            };
            return Err(Invalid::new(format!("{key}[{at}]"), what, remedy));
        }
        if at >= CHANNELS {
            let what = format!("is more than the {CHANNELS} channels of a half");
            return Err(Invalid::new(format!("{key}[{at}]"), what, "take another device section"));
        }
    }
    Ok(listed.to_vec())
}

/// What is needed to build the halves of one board.
pub(crate) struct HalfMaker<'a> {
    bus: Bus,
    config: &'a Config,
    description: &'a Description,
    wiring: Wiring,
    presence: Option<State>,
    latch: Option<Arc<Acquisition>>,
    conversion: Option<Arc<Acquisition>>,
}

impl<'a> HalfMaker<'a> {
    pub(crate) fn new(
        bus: Bus,
        config: &'a Config,
        description: &'a Description,
        wiring: Wiring,
    ) -> HalfMaker<'a> {
        let latch = description.encoders.as_ref().map(|part| {
            let strobe = part
                .latch_offset
                .map(|offset| Strobe::new(&bus, offset, part.latch, part.latch_value));
            let busy = busy(description, part.busy_offset, part.busy_mask, part.busy_value);
            let latch = Acquisition::new(bus.clone(), strobe, busy, part.polls);
            Arc::new(latch.with_read_time(read_time(description)))
        });
        let conversion =
            description.analog_in.as_ref().map(|part| conversion(&bus, description, part));
        let presence = description.presence.as_ref().map(|part| State::expected(description, part));
        HalfMaker { bus, config, description, wiring, presence, latch, conversion }
    }

    /// What can be started early in a job.
    pub(crate) fn acquisitions(&self) -> Vec<Arc<Acquisition>> {
        self.conversion.iter().chain(&self.latch).cloned().collect()
    }

    fn presence(&self) -> Presence {
        Presence::new(self.presence)
    }

    fn readings<T: Copy>(&self, device: &'static str) -> NumberedReadings<T> {
        let stale_after = Nanos::from_millis(i64::from(self.config.stale_ms));
        NumberedReadings::new(device, stale_after, self.presence())
    }

    /// After how long without a sign of life the outputs are off.
    fn longest_silence(&self) -> Nanos {
        let relay_ms = match self.description.watchdog {
            Some(_) => self.config.watchdog_ms,
            None => self.config.relay_ms.unwrap_or(self.config.watchdog_ms),
        };
        Nanos::from_millis(i64::from(relay_ms))
    }

    /// Channels whose values take as many registers as their bits need.
    fn bank(
        &self,
        offset: usize,
        channel_stride_bytes: Option<usize>,
        bits: u32,
        shift: u32,
    ) -> Bank<'a> {
        let description = self.description;
        let words = description.words(bits, shift);
        Bank { description, offset, channel_stride_bytes, words, bits, shift }
    }

    pub(crate) fn encoders(&self) -> Option<RegisterEncoders> {
        let part = self.description.encoders.as_ref()?;
        let words = self.description.count_words(part);
        let bank = |offset: usize, channel_stride_bytes: Option<usize>| Bank {
            words,
            ..self.bank(offset, channel_stride_bytes, part.bits, part.shift)
        };
        let wired = &self.wiring.encoders;
        let counters = Counters {
            fields: bank(part.offset, part.channel_stride_bytes).fields(wired),
            bits: part.bits,
            inverted: if part.inverted { u32::MAX >> (32 - part.bits) } else { 0 },
            numbers: Numbers::new(part.begin_offset, part.end_offset),
            hold: part.hold,
            step_max_counts: part.step_max_counts,
        };
        let index = self.description.index.as_ref().and_then(|index| {
            let feature = index.feature_offset.map(|offset| {
                let mask = Some(index.feature_mask);
                State::new(self.description, offset, mask, mask)
            });
            feature.is_none_or(|feature| feature.holds(&self.bus)).then(|| {
                let fields = bank(index.offset, index.channel_stride_bytes).fields(wired);
                let numbers = Numbers::new(index.begin_offset, index.end_offset);
                IndexLatch::new(fields, index.seen_offset, wired.as_slice().into(), numbers)
            })
        });
        let early = self.description.analog_in.as_ref();
        let early = early.is_some_and(|part| part.start_by == StartBy::Encoders);
        Some(RegisterEncoders::new(
            self.bus.clone(),
            counters,
            self.latch.clone()?,
            if early { self.conversion.clone() } else { None },
            index,
            self.readings(ENCODERS_NAME),
        ))
    }

    fn converters(
        &self,
        part: &InputBank,
        conversion: Arc<Acquisition>,
        channels: &[usize],
    ) -> (Box<[Field]>, Converters) {
        let bank = self.bank(part.offset, part.channel_stride_bytes, part.bits, part.shift);
        let are_shared = !self.wiring.gauges.is_empty() && !self.wiring.analog_in.is_empty();
        let converters = Converters {
            conversion,
            is_started_elsewhere: part.start_by == StartBy::Encoders || are_shared,
            numbers: Numbers::new(part.begin_offset, part.end_offset),
            codec: part.codec(),
            unused_zero: part.unused_zero,
        };
        (bank.fields(channels), converters)
    }

    pub(crate) fn analog_in(&self) -> Option<RegisterAnalogIn> {
        let part = self.description.analog_in.as_ref()?;
        let conversion = self.conversion.clone()?;
        let (fields, converters) = self.converters(part, conversion, &self.wiring.analog_in);
        let readings = self.readings(ANALOG_IN_NAME);
        Some(RegisterAnalogIn::new(self.bus.clone(), fields, converters, readings))
    }

    /// The gauges: chosen A/D channels, else registers of their own.
    pub(crate) fn force_torque(&self) -> Option<RegisterForceTorque> {
        let (part, conversion, channels) = match (&self.description.analog_in, &self.conversion) {
            (Some(part), Some(conversion)) if !self.wiring.gauges.is_empty() => {
                (part, conversion.clone(), self.wiring.gauges.clone())
            }
            _ => {
                let part = self.description.force_torque.as_ref()?;
                let conversion = conversion(&self.bus, self.description, part);
                (part, conversion, (0..FORCE_TORQUE_CHANNELS).collect())
            }
        };
        let (fields, converters) = self.converters(part, conversion, &channels);
        let readings = self.readings(FORCE_TORQUE_NAME);
        Some(RegisterForceTorque::new(self.bus.clone(), fields, converters, readings))
    }

    pub(crate) fn tactile(&self) -> Option<RegisterTactile> {
        let part = self.description.tactile.as_ref()?;
        let words = self.description.words(part.bits, 0);
        let stride = self.description.channel_stride(None, words);
        // Bits above a tactel's width are kept, so that a count that is too large is noticed.
        let bits = 8 * (words * self.description.bus_bytes()) as u32;
        let field = |tactel: usize| {
            Field::new(self.description, part.offset + tactel * stride, words, bits, 0)
        };
        let registers = FrameRegisters {
            fields: (0..part.rows * part.cols).map(field).collect(),
            rows: part.rows,
            cols: part.cols,
            bits: part.bits,
            numbers: Numbers { begin: part.begin_offset, end: part.end_offset },
            number_mask: self.description.bus_mask(),
            scan_time: Nanos(i64::from(part.scan_us) * 1_000),
        };
        Some(RegisterTactile::new(self.bus.clone(), registers, self.presence()))
    }

    pub(crate) fn digital_in(&self) -> Option<RegisterDigitalIn> {
        let part = self.description.digital_in.as_ref()?;
        let masks = InputMasks {
            offset: part.offset,
            drive_power: 1 << part.drive_power_bit,
            estop_a: 1 << part.estop_a_bit,
            estop_b: 1 << part.estop_b_bit,
            inverted: part.inverted_mask,
            zero: part.zero_mask,
            beat: part.beat_shift.map(|shift| (shift, u32::MAX >> (32 - part.beat_bits))),
        };
        Some(RegisterDigitalIn::new(self.bus.clone(), masks, self.readings(DIGITAL_IN_NAME)))
    }

    /// The D/A half; making it writes the safe values.
    pub(crate) fn analog_out(&self) -> Option<RegisterAnalogOut> {
        let part = self.description.analog_out.as_ref()?;
        let bank = self.bank(part.offset, part.channel_stride_bytes, part.bits, part.shift);
        let kick = self.description.watchdog.as_ref().and_then(|watchdog| {
            let offset = watchdog.kick_offset?;
            Some(Strobe::new(&self.bus, offset, StrobeKind::Value, watchdog.kick_value))
        });
        let all: Vec<usize> = (0..part.channels).collect();
        let strobe = part
            .strobe_offset
            .map(|offset| Strobe::new(&self.bus, offset, part.strobe, part.strobe_value));
        let channels = OutputChannels {
            all: bank.fields(&all),
            wired: bank.fields(&self.wiring.analog_out),
            codec: part.codec(),
            safe_code: DacCode(part.safe_code),
            strobe,
            kick,
            reads_back: part.read_back,
        };
        let (bus, silence) = (self.bus.clone(), self.longest_silence());
        Some(RegisterAnalogOut::new(bus, channels, silence, self.presence()))
    }

    /// The half of the lines to the cell; making it writes the safe word.
    pub(crate) fn digital_out(&self) -> Option<RegisterDigitalOut> {
        let part = self.description.digital_out.as_ref()?;
        let masks = OutputMasks {
            offset: part.offset,
            enable: 1 << part.enable_bit,
            brake_release: 1 << part.brake_release_bit,
            watchdog_feed: 1 << part.watchdog_feed_bit,
            inverted: part.inverted_mask,
        };
        let (bus, silence) = (self.bus.clone(), self.longest_silence());
        Some(RegisterDigitalOut::new(bus, masks, silence, self.presence()))
    }

    /// What one code of each channel is worth (V): D/A, A/D and gauges.
    pub(crate) fn volts_per_code(&self) -> [Vec<f64>; 3] {
        let step = |low_v: f64, high_v: f64, bits: u32| (high_v - low_v) / f64::from(1u32 << bits);
        let output = self.description.analog_out.as_ref();
        let output = output.map(|part| step(part.low_v, part.high_v, part.bits));
        let of = |part: &InputBank| step(part.low_v, part.high_v, part.bits);
        let input = self.description.analog_in.as_ref().map(of);
        let gauges = if self.wiring.gauges.is_empty() {
            self.description.force_torque.as_ref().map(of)
        } else {
            input
        };
        let all =
            |step: Option<f64>, channels: usize| step.map_or(Vec::new(), |v| vec![v; channels]);
        [
            all(output, self.wiring.analog_out.len()),
            all(input, self.wiring.analog_in.len()),
            all(gauges, FORCE_TORQUE_CHANNELS),
        ]
    }
}

/// What shows that the board is at work, if a register does.
fn busy(
    description: &Description,
    offset: Option<usize>,
    mask: Option<u32>,
    value: Option<u32>,
) -> Option<State> {
    offset.map(|offset| State::new(description, offset, mask, value))
}

/// What starts a conversion of these converters, and shows its end.
fn conversion(bus: &Bus, description: &Description, part: &InputBank) -> Arc<Acquisition> {
    let strobe = part
        .start_offset
        .map(|offset| Strobe::new(bus, offset, StrobeKind::Value, part.start_value));
    let busy = busy(description, part.busy_offset, part.busy_mask, part.busy_value);
    let conversion = Acquisition::new(bus.clone(), strobe, busy, part.polls);
    Arc::new(conversion.with_read_time(read_time(description)))
}

fn read_time(description: &Description) -> Nanos {
    Nanos(i64::from(description.read_ns))
}
