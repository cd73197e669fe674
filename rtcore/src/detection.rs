//! The signs of a real-time kernel and of a virtual machine, in what kernel and firmware say of
//! themselves: one list for whoever asks, so that the attestation of a run and the doctor agree. No
//! file is opened here: the caller reads, from the running host or from a recorded tree.

/// Vendors and products of virtual machines in the firmware's tables.
const VIRTUAL_MACHINE_NAMES: [&str; 8] =
    ["QEMU", "KVM", "VMware", "VirtualBox", "Xen", "Virtual Machine", "Firecracker", "Bochs"];
/// The device tree of a guest without firmware's tables, as emulators make it.
const GUEST_DEVICE_TREE: &str = "linux,dummy-virt";

/// The sign that the kernel is built with PREEMPT_RT, in words; `None` when there is none. `read`
/// gives the text of a file by its path without the leading slash.
///
/// `/sys/kernel/realtime` alone is not enough: some real-time kernels lack it.
#[must_use]
pub fn preempt_rt_sign(read: &dyn Fn(&str) -> Option<String>) -> Option<String> {
    let says = |text: &String| text.contains("PREEMPT_RT") || text.contains("PREEMPT RT");
    let version = read("proc/sys/kernel/version").or_else(|| read("proc/version"));
    if let Some(version) = version.filter(says) {
        return Some(version);
    }
    let there = read("sys/kernel/realtime").is_some_and(|text| text.trim() == "1");
    there.then(|| "/sys/kernel/realtime is 1".to_owned())
}

/// The sign that a hypervisor decides when this process runs, in words; `None` when there is none.
/// As in [`preempt_rt_sign`], `read` gives texts. The processor tells on x86 only; elsewhere the
/// firmware's tables or the device tree do.
#[must_use]
pub fn virtual_machine_sign(read: &dyn Fn(&str) -> Option<String>) -> Option<String> {
    let processor = read("proc/cpuinfo").unwrap_or_default();
    let mut flags = processor.lines().filter(|line| line.starts_with("flags"));
    let flag = |line: &str| line.split_whitespace().any(|flag| flag == "hypervisor");
    if flags.next().is_some_and(flag) {
        return Some("the CPU flag `hypervisor` is set".to_owned());
    }
    if let Some(kind) = read("sys/hypervisor/type").filter(|kind| !kind.trim().is_empty()) {
        return Some(format!("/sys/hypervisor/type is {kind}"));
    }
    for file in ["sys_vendor", "product_name"] {
        let text = read(&format!("sys/class/dmi/id/{file}")).unwrap_or_default();
        if VIRTUAL_MACHINE_NAMES.iter().any(|name| text.contains(name)) {
            return Some(format!("{file} is {text}"));
        }
    }
    if read("proc/device-tree/hypervisor/compatible").is_some() {
        return Some("the device tree names a hypervisor".to_owned());
    }
    let tree = read("proc/device-tree/compatible").unwrap_or_default();
    tree.contains(GUEST_DEVICE_TREE).then(|| format!("the device tree is {GUEST_DEVICE_TREE}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A host with these files and no others.
    fn host<'a>(files: &'a [(&'a str, &'a str)]) -> impl Fn(&str) -> Option<String> + 'a {
        move |path| {
            let found = files.iter().find(|(name, _)| *name == path);
            found.map(|(_, text)| (*text).to_owned())
        }
    }

    #[test]
    fn each_sign_alone_identifies_a_real_time_kernel() {
        let version = "proc/sys/kernel/version";
        for (file, text) in [
            (version, "#1 SMP PREEMPT_RT Debian 6.12.48-1"),
            (version, "#1 SMP PREEMPT RT Fri Mar 12"),
            ("proc/version", "Linux version 6.1.0 #1 SMP PREEMPT_RT"),
            ("sys/kernel/realtime", "1"),
        ] {
            assert!(preempt_rt_sign(&host(&[(file, text)])).is_some(), "{file}: {text}");
        }
        let both = [(version, "#1 SMP PREEMPT_DYNAMIC"), ("sys/kernel/realtime", "1")];
        assert!(preempt_rt_sign(&host(&both)).is_some());
        for files in [&both[..1], &[("sys/kernel/realtime", "0")], &[]] {
            assert_eq!(preempt_rt_sign(&host(files)), None, "{files:?}");
        }
    }

    #[test]
    fn a_virtual_machine_is_recognised_without_the_processor_flag() {
        let arm = ("proc/cpuinfo", "processor : 0\nFeatures : fp asimd evtstrm\n");
        assert_eq!(virtual_machine_sign(&host(&[arm])), None);
        assert_eq!(virtual_machine_sign(&host(&[])), None);
        for (file, text) in [
            ("proc/cpuinfo", "processor : 0\nflags : fpu hypervisor lahf_lm\n"),
            ("sys/hypervisor/type", "xen"),
            ("sys/class/dmi/id/sys_vendor", "QEMU"),
            ("sys/class/dmi/id/product_name", "KVM Virtual Machine"),
            ("proc/device-tree/hypervisor/compatible", "linux,kvm\0"),
            ("proc/device-tree/compatible", "linux,dummy-virt\0"),
        ] {
            let files: Vec<_> = [(file, text), arm].into_iter().collect();
            assert!(virtual_machine_sign(&host(&files)).is_some(), "{file}: {text}");
        }
        let board = ("proc/device-tree/compatible", "raspberrypi,5-model-b\0brcm,bcm2712\0");
        assert_eq!(virtual_machine_sign(&host(&[arm, board])), None);
    }
}
