# A guest that is a Debian: systemd as its first process, apt, udev and the kernel's modules, in the cache of guest.sh. Sourced by
# `service`. Refuses to guess where something cannot be had: the caller skips.
# shellcheck shell=bash
# `out`, `cache`, `codename`, `parts`, `here` and `temporary` are set by guest.sh and packages.sh.
# shellcheck disable=SC2154

# What the guest holds beside the essential packages. usr-is-merged keeps usrmerge, and with it all of perl, away.
readonly SYSTEM_PACKAGES=(usr-is-merged apt systemd systemd-sysv udev kmod sudo passwd iproute2 libnuma1 libgcc-s1)
# Modules of the PREEMPT_RT kernel, with what they depend on.
readonly SYSTEM_MODULES=(autofs4 uinput evdev comedi_test)
# What only people read, and the tables of hardware.
readonly SYSTEM_LEFT_OUT=(/usr/share/man /usr/share/doc /usr/share/locale /usr/share/info /usr/share/zoneinfo
    /usr/share/bash-completion /usr/share/zsh /lib/udev/hwdb.d /usr/lib/udev/hwdb.d /usr/lib/x86_64-linux-gnu/gconv)

# The tools that build it, installed when they are missing and this is root.
system_tools() {
    local pair want=()
    PATH=$PATH:/usr/sbin:/sbin
    for pair in mmdebstrap:mmdebstrap bsdtar:libarchive-tools depmod:kmod; do
        command -v "${pair%%:*}" >/dev/null || want+=("${pair#*:}")
    done
    ((${#want[@]})) || return 0
    [[ $(id -u) == 0 ]] || { say "missing, and not root: ${want[*]}"; return 1; }
    say "installing ${want[*]}"
    update_lists || true
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends --no-remove "${want[@]}" >>"$out/apt.log" 2>&1
}

# Sets `guest_base` to a cached archive of the whole system with the kernel's modules.
build_system() {
    local key work
    key=$({ cat "$parts/packages"; declare -f build_system system_tree system_modules; echo "${SYSTEM_PACKAGES[@]}" \
        "${SYSTEM_MODULES[@]}" "${SYSTEM_LEFT_OUT[@]}"; } | sha256sum | cut -c1-12)
    guest_base=$cache/system-$key.cpio
    [[ ! -s $guest_base ]] || return 0
    say "building the guest's system"
    work=$(mktemp -d "$cache/system.XXXXXX")
    temporary+=("$work")
    system_tree "$work" || { tail -n 5 "$out/system.log" >&2; return 1; }
    system_modules "$work" || return 1
    cat "$work/system.cpio" "$work/modules.cpio" >"$guest_base.new"
    mv "$guest_base.new" "$guest_base"
    rm -rf "$work"
    find "$cache" -maxdepth 1 -name 'system-*.cpio' ! -path "$guest_base" -delete
}

system_tree() { # FOLDER
    local folder options=()
    for folder in "${SYSTEM_LEFT_OUT[@]}"; do
        options+=("--dpkgopt=path-exclude=$folder/*")
    done
    # The folder of the tree is mmdebstrap's first argument to a hook.
    # shellcheck disable=SC2016
    mirror_lines | mmdebstrap --quiet --variant=essential --format=tar \
        --include="$(IFS=,; echo "${SYSTEM_PACKAGES[*]}")" "${options[@]}" \
        --hook-dir=/usr/share/mmdebstrap/hooks/merged-usr \
        --setup-hook='mkdir -p "$1/etc/apt/preferences.d"; printf "Package: usrmerge\nPin: version *\nPin-Priority: -1\n" >"$1/etc/apt/preferences.d/taktil"' \
        --customize-hook='rm -rf "$1"/usr/lib/udev/hwdb.bin "$1"/var/cache/* "$1"/var/lib/apt/lists/* "$1"/var/log/* "$1"/etc/resolv.conf' \
        --customize-hook=': >"$1/etc/machine-id"; : >"$1/etc/apt/sources.list"; echo robot >"$1/etc/hostname"; echo "127.0.0.1 localhost robot" >"$1/etc/hosts"' \
        --customize-hook='chroot "$1" useradd --create-home --shell /bin/bash lab; chroot "$1" useradd --create-home viewer; chroot "$1" useradd --create-home outsider' \
        --customize-hook='echo "lab ALL=(ALL) NOPASSWD: ALL" >"$1/etc/sudoers.d/lab"' \
        "$codename" "$1/system.tar" - >"$out/system.log" 2>&1 || return 1
    # Owners and device nodes stay what they are, without being root.
    bsdtar --format=newc -cf "$1/system.cpio" "@$1/system.tar" && rm "$1/system.tar"
}

system_modules() { # FOLDER
    local rt version file
    rt=$(grep -- '-rt-.*\.deb$' "$parts/packages" | sed 's/_.*//')
    version=${rt#linux-image-}
    (cd "$1" && apt-get download -qq "$rt" >>"$out/apt.log" 2>&1) || return 1
    mkdir -p "$1/kernel" "$1/modules/usr/lib/modules/$version"
    dpkg-deb --fsys-tarfile "$1/$rt"_*.deb | tar -x -C "$1/kernel" ./lib/modules
    depmod -b "$1/kernel" "$version" || return 1
    cp "$1/kernel/lib/modules/$version"/modules.{order,builtin,builtin.modinfo} "$1/modules/usr/lib/modules/$version/"
    for file in "${SYSTEM_MODULES[@]}"; do
        # Built-in ones print no file.
        (cd "$1/kernel" && modprobe -d . -S "$version" --show-depends "$file" 2>/dev/null || true) | awk '/^insmod/ { print $2 }'
    done | sed "s,^$1/kernel/,,; s,^\./*,," | sort -u | while read -r file; do
        mkdir -p "$1/modules/usr/${file%/*}"
        cp "$1/kernel/$file" "$1/modules/usr/$file"
    done
    find "$1/modules" -name '*.ko.xz' -exec xz -d {} +
    ln -s usr/lib "$1/modules/lib"
    depmod -b "$1/modules" "$version"
    rm "$1/modules/lib"
    archive "$1/modules" "$1/modules.cpio"
}
