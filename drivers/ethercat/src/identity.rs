//! The devices that a segment has beside those that the configuration lists.

use taktil_drivers_exchange::Refusal;

use crate::config::{Config, DeviceConfig, Kind};

/// What a device says of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct DeviceIdentity {
    /// The name in its information memory.
    pub(crate) name: String,
    /// Vendor.
    pub(crate) vendor: u32,
    /// Product.
    pub(crate) product: u32,
    /// Revision.
    pub(crate) revision: u32,
    /// Station alias; 0 for none.
    pub(crate) alias: u16,
}

/// Vendor of the terminals.
const TERMINAL_VENDOR_ID: u32 = 2;

/// Vendor and product of a kind; `None` for a kind of many makers.
const fn numbers(kind: Kind) -> Option<(u32, u32)> {
    let product = match kind {
        Kind::Ek1100 => 0x044c_2c52,
        Kind::El1008 => 0x03f0_3052,
        Kind::El2008 => 0x07d8_3052,
        Kind::El4134 => 0x1026_3052,
        Kind::El3104 => 0x0c20_3052,
        Kind::El5101 => 0x13ed_3052,
        Kind::El5151 => 0x141f_3052,
        Kind::Drive | Kind::Other => return None,
    };
    Some((TERMINAL_VENDOR_ID, product))
}

/// Compares what was found with what is listed, device by device.
pub(crate) fn compare(config: &Config, found: &[DeviceIdentity]) -> Result<(), Refusal> {
    for (position, (listed, found)) in config.devices.iter().zip(found).enumerate() {
        compare_one(position, listed, found)?;
    }
    if config.devices.len() == found.len() {
        return Ok(());
    }
    let (listed, has) = (config.devices.len(), found.len());
    let what = match found.get(listed) {
        Some(more) => format!("the segment has {has} devices, {listed} are listed: {}", text(more)),
        None => format!("the segment has {has} devices, {listed} are listed: a cable may be open"),
    };
    Err(Refusal::new(
        "devices",
        what,
        "list all devices in the order in which a frame reaches them",
    ))
}

fn compare_one(
    position: usize,
    listed: &DeviceConfig,
    found: &DeviceIdentity,
) -> Result<(), Refusal> {
    let own = numbers(listed.kind);
    let vendor = listed.vendor.or(own.map(|(vendor, _)| vendor));
    let product = listed.product.or(own.map(|(_, product)| product));
    let expected = [
        ("vendor", vendor, found.vendor),
        ("product", product, found.product),
        ("revision", listed.revision, found.revision),
        ("alias", listed.alias.map(u32::from), u32::from(found.alias)),
    ];
    for (name, listed, has) in expected {
        if let Some(listed) = listed.filter(|listed| *listed != has) {
            let all = text(found);
            let what =
                format!("position {position}: {name} {listed:#x} is listed, and there is {all}");
            let remedy = "plug the device in that is listed, or list this one";
            return Err(Refusal::new("devices", what, remedy));
        }
    }
    Ok(())
}

fn text(found: &DeviceIdentity) -> String {
    let DeviceIdentity { name, vendor, product, revision, alias } = found;
    format!(
        "`{name}`, vendor {vendor:#x}, product {product:#x}, revision {revision:#x}, alias {alias}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(alias: u16) -> DeviceIdentity {
        let name = "drive".to_owned();
        DeviceIdentity { name, vendor: 0xffe, product: 0x402, revision: 0x10000, alias }
    }

    #[test]
    fn each_number_that_differs_is_named_with_its_position() {
        let mut listed = DeviceConfig::of(Kind::Drive);
        (listed.vendor, listed.product) = (Some(0xffe), Some(0x402));
        let with = |change: &dyn Fn(&mut DeviceConfig), found: &[DeviceIdentity]| {
            let mut listed = listed.clone();
            change(&mut listed);
            let config = Config { devices: vec![listed], ..Config::default() };
            compare(&config, found).map_err(|refusal| refusal.what)
        };
        assert_eq!(with(&|_| {}, &[drive(7)]), Ok(()));
        assert_eq!(with(&|one| one.alias = Some(7), &[drive(7)]), Ok(()));
        for (change, word) in [
            (
                &(|one: &mut DeviceConfig| one.vendor = Some(2)) as &dyn Fn(&mut DeviceConfig),
                "vendor 0x2",
            ),
            (&|one: &mut DeviceConfig| one.product = Some(3), "product 0x3"),
            (&|one: &mut DeviceConfig| one.revision = Some(4), "revision 0x4"),
            (&|one: &mut DeviceConfig| one.alias = Some(5), "alias 0x5"),
        ] {
            let what = with(change, &[drive(7)]).unwrap_err();
            assert!(what.starts_with(&format!("position 0: {word} is listed")), "{what}");
            assert!(what.contains("product 0x402, revision 0x10000, alias 7"), "{what}");
        }
        assert!(with(&|_| {}, &[]).unwrap_err().contains("0 devices, 1 are listed"));
        let two = with(&|_| {}, &[drive(7), drive(8)]).unwrap_err();
        assert!(two.contains("2 devices, 1 are listed: `drive`"), "{two}");
    }
}
