# What the guests are made of, from Debian's packages: QEMU and tools on the host, kernels and a small user land in a cache. Sourced
# by guest.sh. Refuses to install anything when it is not root, and to guess: what cannot be had is said, and the caller skips.
# shellcheck shell=bash
# `out`, `cache` and `codename` are set by guest.sh.
# shellcheck disable=SC2154

# program:package that the host side needs
readonly HOST_TOOLS=(qemu-system-x86_64:qemu-system-x86 cpio:cpio xz:xz-utils zstd:zstd jq:jq)
# The guest's user land; a statically linked shell, what `taktil` and cyclictest link, and the instruments.
readonly GUEST_PACKAGES=(busybox-static libc6 libgcc-s1 libnuma1 rt-tests)

missing_tools() {
    local pair
    for pair in "${HOST_TOOLS[@]}"; do
        command -v "${pair%%:*}" >/dev/null || echo "${pair#*:}"
    done
}

# The mirror this machine uses already, as sources.list lines.
mirror_lines() {
    # The placeholders are apt's.
    # shellcheck disable=SC2016
    apt-get indextargets --format '$(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' |
        sort -u | awk -v c="$codename" '
        ($2 == c || $2 == c "-updates" || $2 == c "-security") && $3 == "main" {
            print "deb", $1, $2, "main"
        }'
}

# apt-get update at most once, and only when it is ours to do.
updated=
update_lists() {
    [[ -z $updated && $(id -u) == 0 ]] || return 1
    updated=yes
    say "apt-get update"
    apt-get update -qq >>"$out/apt.log" 2>&1
}

# Installs what the host lacks. Returns 1 when it may not or cannot.
install_tools() {
    local want=() from=()
    mapfile -t want < <(missing_tools)
    ((${#want[@]})) || return 0
    [[ $(id -u) == 0 ]] || { say "missing, and not root: ${want[*]}"; return 1; }
    say "installing ${want[*]}"
    update_lists || true
    # Where newer QEMU tools of the backports are installed, the release's QEMU would remove them: then
    # take it from the backports of the same mirror too, through lists of our own.
    if apt-get -s install --no-install-recommends "${want[@]}" 2>/dev/null | grep -q '^Remv'; then
        mkdir -p "$cache/apt/lists/partial" "$cache/apt/parts"
        { mirror_lines; mirror_lines | awk -v c="$codename" '$3 == c { print $1, $2, c "-backports main" }'; } \
            >"$cache/apt/sources.list"
        from=(-o "Dir::Etc::sourcelist=$cache/apt/sources.list" -o "Dir::Etc::sourceparts=$cache/apt/parts"
            -o "Dir::State::lists=$cache/apt/lists")
        apt-get "${from[@]}" update -qq >>"$out/apt.log" 2>&1
        from+=(-t "$codename-backports")
    fi
    DEBIAN_FRONTEND=noninteractive apt-get "${from[@]}" install -y -qq --no-install-recommends \
        --no-remove "${want[@]}" >>"$out/apt.log" 2>&1 || { tail -3 "$out/apt.log" >&2; return 1; }
}

# Name of the newest PREEMPT_RT kernel package of this Debian; nothing when there is none.
rt_kernel_package() {
    apt-cache depends linux-image-rt-amd64 2>/dev/null |
        awk '/Depends: linux-image-[0-9]/ { print $2; exit }'
}

# The compressed kernel lies inside the bzImage behind the set-up code; unpacked it boots by PVH, and the
# guest does not spend its counted instructions on decompression.
unpack_kernel() { # BZIMAGE RESULT
    local at
    while IFS=: read -r at _; do
        tail -c "+$((at + 1))" "$1" | xz -dc --single-stream >"$2" 2>/dev/null || true
        is_elf "$2" && return 0
        tail -c "+$((at + 1))" "$1" | zstd -qdc >"$2" 2>/dev/null || true
        is_elf "$2" && return 0
    done < <(LC_ALL=C grep -aobP '\xFD7zXZ\x00|\x28\xB5\x2F\xFD' "$1" | tr -d '\0')
    cp "$1" "$2"
}

is_elf() { [[ $(head -c 4 "$1" | tail -c 3) == ELF ]]; }

archive() { # FOLDER RESULT: an uncompressed initramfs archive owned by root
    (cd "$1" && find . -mindepth 1 | LC_ALL=C sort | cpio -o -H newc -R 0:0 --quiet) >"$2"
}

# Sets `parts` to a cached folder with base.cpio, kernel-rt, kernel-plain and modules/ (and their versions). Returns 1 when Debian's packages
# cannot be reached and nothing is cached.
build_parts() {
    local rt plain uris key work deb
    rt=$(rt_kernel_package)
    [[ -n $rt ]] || { update_lists && rt=$(rt_kernel_package); } || true
    # The same version without PREEMPT_RT, by its name.
    plain=${rt/-rt-/-}
    uris=$([[ -z $rt ]] || apt-get download --print-uris "$rt" "$plain" "${GUEST_PACKAGES[@]}" 2>/dev/null) || uris=
    if [[ -z $uris ]]; then
        parts=$cache/$(cat "$cache/last" 2>/dev/null || echo none)
        [[ -s $parts/base.cpio ]] && say "no package lists: using the cached guest" && return 0
        say "no Debian kernel packages to be had here"
        return 1
    fi
    key=$({ echo "$uris" | cut -d' ' -f2-; declare -f build_parts base_tree guest_modules; } | sha256sum | cut -c1-12)
    parts=$cache/parts-$key
    if [[ ! -s $parts/base.cpio ]]; then
        say "building the guest from $rt and $plain"
        work=$(mktemp -d "$cache/build.XXXXXX")
        temporary+=("$work")
        (cd "$work" && apt-get download -qq "$rt" "$plain" "${GUEST_PACKAGES[@]}" >>"$out/apt.log" 2>&1) || {
            # Names change with each security update; old lists point to files that are gone.
            update_lists && build_parts && return 0
            say "the packages cannot be downloaded"
            return 1
        }
        mkdir -p "$work/parts" "$work/all" "$work/base"/{usr/bin,usr/lib,usr/lib64,dev,proc,sys,run,tmp}
        unpack_kernel_package "$work"/"$rt"_*.deb "$work/parts/kernel-rt"
        unpack_kernel_package "$work"/"$plain"_*.deb "$work/parts/kernel-plain"
        guest_modules "$work"/"$rt"_*.deb "$work/parts/modules"
        for deb in "${GUEST_PACKAGES[@]}"; do
            dpkg-deb -x "$work/$deb"_*.deb "$work/all"
        done
        base_tree "$work/all" "$work/base"
        archive "$work/base" "$work/parts/base.cpio"
        (cd "$work" && printf '%s\n' *.deb) >"$work/parts/packages"
        mv -T "$work/parts" "$parts"
        rm -rf "$work"
    fi
    basename "$parts" >"$cache/last"
}

unpack_kernel_package() { # DEB RESULT
    local folder=$1.d
    mkdir "$folder"
    dpkg-deb --fsys-tarfile "$1" | tar -x -C "$folder" --wildcards './boot/vmlinuz-*'
    unpack_kernel "$folder"/boot/vmlinuz-* "$2"
    rm -rf "$folder"
}

# The modules through which programs make keyboards and read them, those of the kernel's test board of Comedi, of its virtual CAN
# interface and of its virtual cable, and those of a disk in a file, as far as the kernel has them as modules.
guest_modules() { # DEB FOLDER
    mkdir "$2"
    dpkg-deb --fsys-tarfile "$1" | tar -x -C "$2" --wildcards --transform 's,.*/,,' \
        './lib/modules/*/kernel/drivers/input/evdev.ko*' './lib/modules/*/kernel/drivers/input/misc/uinput.ko*' \
        './lib/modules/*/kernel/drivers/comedi/comedi.ko*' './lib/modules/*/kernel/drivers/comedi/drivers/comedi_test.ko*' \
        './lib/modules/*/kernel/net/can/can.ko*' './lib/modules/*/kernel/net/can/can-raw.ko*' './lib/modules/*/kernel/drivers/net/can/vcan.ko*' \
        './lib/modules/*/kernel/drivers/net/can/dev/can-dev.ko*' './lib/modules/*/kernel/drivers/net/veth.ko*' \
        './lib/modules/*/kernel/drivers/block/loop.ko*' './lib/modules/*/kernel/fs/ext4/ext4.ko*' './lib/modules/*/kernel/fs/jbd2/jbd2.ko*' \
        './lib/modules/*/kernel/fs/mbcache.ko*' './lib/modules/*/kernel/lib/crc16.ko*' \
        './lib/modules/*/kernel/crypto/crc32c_generic.ko*' || true
    find "$2" -name '*.xz' -exec xz -d {} +
}

# Of the packages only what the guest runs: programs and shared objects, on a merged /usr.
base_tree() { # UNPACKED TREE
    local name objects=x86_64-linux-gnu
    for name in bin lib lib64; do
        ln -s "usr/$name" "$2/$name"
    done
    mkdir "$2/usr/lib/$objects"
    find "$1" -path "*/$objects/*.so*" -not -path '*/gconv/*' -not -path '*/audit/*' \
        -exec cp -P {} "$2/usr/lib/$objects/" \;
    find "$1" -path '*/lib64/ld-*' -exec cp -P {} "$2/usr/lib64/" \;
    find "$1" -path '*/bin/*' \( -name busybox -o -name cyclictest -o -name hackbench \) \
        -exec cp {} "$2/usr/bin/" \;
    for name in sh mount cat ls stty poweroff uname setsid sleep insmod; do
        ln -s busybox "$2/usr/bin/$name"
    done
}
