//! What a device does with its process data: the objects of each model and what stands behind them.

use taktil_hal::Nanos;

use crate::description::{ANALOG_CHANNELS, Model};
use crate::drive::Drive;
use crate::plant::Shaft;

/// Volts of one code of an analog terminal.
const VOLTS_PER_CODE: f64 = 10.0 / 32_768.0;

/// The application of one device.
#[derive(Clone, Debug)]
pub(crate) struct Application {
    model: Model,
    pub(crate) drive: Option<Drive>,
    codes: [i16; ANALOG_CHANNELS as usize],
    pub(crate) lines: u8,
    count: i64,
}

impl Application {
    pub(crate) fn new(model: Model) -> Application {
        let drive = (model == Model::Drive).then(Drive::new);
        Application { model, drive, codes: [0; ANALOG_CHANNELS as usize], lines: 0, count: 0 }
    }

    /// As after power-up.
    pub(crate) fn reset(&mut self) {
        self.stop();
        if let Some(drive) = &mut self.drive {
            drive.reset();
        }
    }

    /// The host is silent, or its outputs must not act any more.
    pub(crate) fn stop(&mut self) {
        match self.model {
            Model::AnalogOutput => self.codes = [0; ANALOG_CHANNELS as usize],
            Model::DigitalOutput => self.lines = 0,
            _ => {}
        }
        if let Some(drive) = &mut self.drive {
            drive.lose_host();
        }
    }

    /// Volts that an analog output puts out.
    pub(crate) fn volts(&self) -> impl Iterator<Item = f64> {
        self.codes.iter().map(|code| f64::from(*code) * VOLTS_PER_CODE)
    }

    pub(crate) fn set_volts(&mut self, volts: &[f64]) {
        for (code, volts) in self.codes.iter_mut().zip(volts) {
            // The cast saturates, as the converter does.
            *code = (volts / VOLTS_PER_CODE).round() as i16;
        }
    }

    pub(crate) fn set_count(&mut self, count: i64) {
        self.count = count;
    }

    pub(crate) fn follow(&mut self, now: Nanos, shaft: Shaft, has_supply: bool) {
        if let Some(drive) = &mut self.drive {
            drive.follow(now, shaft, has_supply);
        }
    }

    /// Takes an object that the host writes.
    pub(crate) fn write(&mut self, index: u16, subindex: u8, value: i64) {
        let place = usize::from(index.wrapping_sub(0x7000) >> 4);
        match (self.model, subindex) {
            (Model::AnalogOutput, 0x11) if place < self.codes.len() => {
                self.codes[place] = value as i16;
            }
            (Model::DigitalOutput, 1) if place < 8 => {
                self.lines = self.lines & !(1 << place) | u8::from(value & 1 == 1) << place;
            }
            _ => {
                if let Some(drive) = &mut self.drive {
                    drive.write(index, value);
                }
            }
        }
    }

    /// An object as it stands; `None` for one that is not the application's.
    pub(crate) fn read(&self, index: u16, subindex: u8) -> Option<i64> {
        let place = usize::from(index.wrapping_sub(0x6000) >> 4);
        match (self.model, index, subindex) {
            (Model::DigitalInput, _, 1) if place < 8 => Some(i64::from(self.lines >> place & 1)),
            (Model::AnalogInput, _, 0x11) => self.codes.get(place).copied().map(i64::from),
            (Model::Encoder16, 0x6000, 2) | (Model::Encoder32, 0x6000, 0x11) => Some(self.count),
            _ => self.drive.as_ref().and_then(|drive| drive.read(index)),
        }
    }
}
