//! The modules of the FPGA that the driver uses, one file each: what their registers mean.

pub(crate) mod encoder;
pub(crate) mod gpio;
pub(crate) mod pwm;
pub(crate) mod sserial;
pub(crate) mod watchdog;

use taktil_hal::CHANNELS;

use crate::hostmot2::Module;
use crate::lbp16::{Packet, Place, Space};

/// Adds the reading of one register of the first `instances` of a module. Where instances stand
/// side by side one command reads them all.
pub(crate) fn read_instances(
    packet: &mut Packet,
    module: &Module,
    register: u32,
    instances: usize,
) -> [Place; CHANNELS] {
    let mut places = [Place::default(); CHANNELS];
    let first = module.address(register, 0);
    let next = |i: usize| first.wrapping_add(4 * i as u16);
    let close = (1..instances).all(|i| module.address(register, i) == next(i));
    if close && instances > 0 {
        let place = packet.read(Space::Registers, first, instances);
        for (i, slot) in places.iter_mut().enumerate().take(instances) {
            *slot = place.word(i);
        }
    } else {
        for (i, slot) in places.iter_mut().enumerate().take(instances) {
            *slot = packet.read(Space::Registers, module.address(register, i), 1);
        }
    }
    places
}
