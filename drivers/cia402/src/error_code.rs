//! Texts for the error codes of object 603F and of emergency messages, after the lists of CiA 301
//! and CiA 402.

/// The text for an error code: that of the code itself, of its subgroup (the code with its last
/// one or two digits 0) or of its class (the first digit). Makers may use FF00 to FFFF freely.
#[must_use]
pub fn error_text(code: u16) -> &'static str {
    if code >= MAKER_CODE_MIN {
        return "defined by the drive's maker";
    }
    for mask in [0xffff, 0xfff0, 0xff00, 0xf000] {
        let place = ERROR_TEXTS.binary_search_by_key(&(code & mask), |(code, _)| *code);
        // A code below 1000 that is not 0 has no class.
        if let Some((found, text)) = place.ok().and_then(|place| ERROR_TEXTS.get(place))
            && (*found != 0 || code == 0)
        {
            return text;
        }
    }
    "unknown to the standard"
}

/// The first of the codes that belong to makers.
const MAKER_CODE_MIN: u16 = 0xff00;

/// Codes in ascending order with their texts.
const ERROR_TEXTS: &[(u16, &str)] = &[
    (0x0000, "no error"),
    (0x1000, "generic error"),
    (0x2000, "current"),
    (0x2100, "current at the drive's input"),
    (0x2110, "short circuit or earth leakage at the input"),
    (0x2120, "earth leakage at the input"),
    (0x2121, "earth leakage in phase L1"),
    (0x2122, "earth leakage in phase L2"),
    (0x2123, "earth leakage in phase L3"),
    (0x2130, "short circuit at the input"),
    (0x2131, "short circuit between phases L1 and L2"),
    (0x2132, "short circuit between phases L2 and L3"),
    (0x2133, "short circuit between phases L3 and L1"),
    (0x2200, "current inside the drive"),
    (0x2211, "internal current 1"),
    (0x2212, "internal current 2"),
    (0x2213, "overcurrent in the ramp"),
    (0x2214, "overcurrent in the sequence"),
    (0x2220, "continuous overcurrent inside the drive"),
    (0x2221, "continuous overcurrent 1"),
    (0x2222, "continuous overcurrent 2"),
    (0x2230, "short circuit or earth leakage inside the drive"),
    (0x2240, "earth leakage inside the drive"),
    (0x2250, "short circuit inside the drive"),
    (0x2300, "current at the drive's output"),
    (0x2310, "continuous overcurrent of the motor"),
    (0x2311, "continuous overcurrent 1 of the motor"),
    (0x2312, "continuous overcurrent 2 of the motor"),
    (0x2320, "short circuit or earth leakage of the motor"),
    (0x2330, "earth leakage of the motor"),
    (0x2331, "earth leakage in phase U"),
    (0x2332, "earth leakage in phase V"),
    (0x2333, "earth leakage in phase W"),
    (0x2340, "short circuit of the motor"),
    (0x2341, "short circuit between phases U and V"),
    (0x2342, "short circuit between phases V and W"),
    (0x2343, "short circuit between phases W and U"),
    (0x2350, "overload (I2t, thermal state)"),
    (0x2351, "warning of overload (I2t, thermal state)"),
    (0x3000, "voltage"),
    (0x3100, "mains voltage"),
    (0x3110, "mains voltage too high"),
    (0x3111, "mains voltage too high in phase L1"),
    (0x3112, "mains voltage too high in phase L2"),
    (0x3113, "mains voltage too high in phase L3"),
    (0x3120, "mains voltage too low"),
    (0x3121, "mains voltage too low in phase L1"),
    (0x3122, "mains voltage too low in phase L2"),
    (0x3123, "mains voltage too low in phase L3"),
    (0x3130, "a phase is missing"),
    (0x3131, "phase L1 is missing"),
    (0x3132, "phase L2 is missing"),
    (0x3133, "phase L3 is missing"),
    (0x3134, "order of the phases"),
    (0x3140, "mains frequency"),
    (0x3141, "mains frequency too high"),
    (0x3142, "mains frequency too low"),
    (0x3200, "voltage of the DC link"),
    (0x3210, "voltage of the DC link too high"),
    (0x3211, "overvoltage 1 of the DC link"),
    (0x3212, "overvoltage 2 of the DC link"),
    (0x3220, "voltage of the DC link too low"),
    (0x3221, "undervoltage 1 of the DC link"),
    (0x3222, "undervoltage 2 of the DC link"),
    (0x3230, "load error"),
    (0x3300, "voltage at the output"),
    (0x3310, "voltage at the output too high"),
    (0x3320, "armature circuit"),
    (0x3321, "armature circuit interrupted"),
    (0x3330, "field circuit"),
    (0x3331, "field circuit interrupted"),
    (0x4000, "temperature"),
    (0x4100, "ambient temperature"),
    (0x4110, "ambient temperature too high"),
    (0x4120, "ambient temperature too low"),
    (0x4130, "temperature of the supply air"),
    (0x4140, "temperature of the air outlet"),
    (0x4200, "temperature of the device"),
    (0x4210, "temperature of the device too high"),
    (0x4220, "temperature of the device too low"),
    (0x4300, "temperature of the drive"),
    (0x4310, "temperature of the drive too high"),
    (0x4320, "temperature of the drive too low"),
    (0x4400, "temperature of the supply"),
    (0x4410, "temperature of the supply too high"),
    (0x4420, "temperature of the supply too low"),
    (0x5000, "hardware of the device"),
    (0x5100, "internal supply"),
    (0x5110, "internal supply voltage too low"),
    (0x5111, "internal supply of 15 V"),
    (0x5112, "internal supply of 24 V"),
    (0x5113, "internal supply of 5 V"),
    (0x5120, "supply of the intermediate circuit"),
    (0x5200, "control hardware"),
    (0x5210, "measuring circuit"),
    (0x5220, "computing circuit"),
    (0x5300, "operating unit"),
    (0x5400, "power section"),
    (0x5410, "output stages"),
    (0x5420, "chopper"),
    (0x5430, "input stages"),
    (0x5440, "contacts"),
    (0x5450, "fuses"),
    (0x5500, "memory"),
    (0x5510, "working memory"),
    (0x5520, "program memory"),
    (0x5530, "memory of parameters"),
    (0x6000, "software of the device"),
    (0x6010, "software reset by the watchdog"),
    (0x6100, "internal software"),
    (0x6200, "user software"),
    (0x6300, "data record"),
    (0x6310, "loss of parameters"),
    (0x6320, "error in the parameters"),
    (0x7000, "additional modules"),
    (0x7100, "power of an additional module"),
    (0x7110, "brake chopper"),
    (0x7111, "failure of the brake chopper"),
    (0x7112, "overcurrent of the brake chopper"),
    (0x7113, "protective circuit of the brake chopper"),
    (0x7120, "motor"),
    (0x7121, "motor blocked"),
    (0x7122, "motor error or wrong commutation"),
    (0x7123, "motor tilted"),
    (0x7200, "measuring circuit of an additional module"),
    (0x7300, "sensor"),
    (0x7301, "tachometer"),
    (0x7302, "wrong polarity of the tachometer"),
    (0x7303, "resolver 1"),
    (0x7304, "resolver 2"),
    (0x7305, "incremental encoder 1"),
    (0x7306, "incremental encoder 2"),
    (0x7307, "incremental encoder 3"),
    (0x7310, "speed"),
    (0x7320, "position"),
    (0x7400, "computing circuit of an additional module"),
    (0x7500, "communication of an additional module"),
    (0x7510, "serial interface 1"),
    (0x7520, "serial interface 2"),
    (0x7600, "external memory"),
    (0x8000, "supervision"),
    (0x8100, "communication"),
    (0x8110, "CAN: frames lost by overrun"),
    (0x8120, "CAN: error passive"),
    (0x8130, "heartbeat or life guarding: the master is silent"),
    (0x8140, "CAN: back from bus-off"),
    (0x8150, "CAN: an identifier is used twice"),
    (0x8200, "protocol"),
    (0x8210, "PDO too short"),
    (0x8220, "PDO too long"),
    (0x8300, "torque control"),
    (0x8311, "excess torque"),
    (0x8312, "difficult start"),
    (0x8313, "torque at standstill"),
    (0x8321, "insufficient torque"),
    (0x8331, "torque fault"),
    (0x8400, "speed control"),
    (0x8500, "position control"),
    (0x8600, "positioning"),
    (0x8611, "following error"),
    (0x8612, "reference limit"),
    (0x8700, "synchronisation"),
    (0x8800, "winding control"),
    (0x8900, "supervision of process data"),
    (0x8a00, "supervision of control"),
    (0x9000, "external error"),
    (0xf000, "additional functions"),
    (0xf001, "deceleration"),
    (0xf002, "subsynchronous run"),
    (0xf003, "stroke operation"),
    (0xf004, "control of an additional function"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_ascend_and_each_finds_its_own_text() {
        assert!(ERROR_TEXTS.is_sorted_by(|(a, _), (b, _)| a < b));
        for (code, text) in ERROR_TEXTS {
            assert_eq!(error_text(*code), *text, "{code:04x}");
        }
    }

    #[test]
    fn an_unlisted_code_has_the_text_of_its_subgroup_or_class() {
        for (code, text) in [
            (0x8130, "heartbeat or life guarding: the master is silent"),
            (0x7305, "incremental encoder 1"),
            (0x3219, "voltage of the DC link too high"),
            (0x23ff, "current at the drive's output"),
            (0x2fff, "current"),
            (0x0001, "unknown to the standard"),
            (0xb000, "unknown to the standard"),
            (0xff42, "defined by the drive's maker"),
        ] {
            assert_eq!(error_text(code), text, "{code:04x}");
        }
    }

    #[test]
    fn every_code_has_a_text() {
        assert!((0..=u16::MAX).all(|code| !error_text(code).is_empty()));
    }
}
