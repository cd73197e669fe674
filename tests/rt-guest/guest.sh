# What every guest needs: a cache that one run at a time uses, QEMU and the packages, and a boot. Sourced by `run` and `keys`, which
# set `here` and `root`. Refuses to guess where something cannot be had: it says so and ends with 77.
# shellcheck shell=bash
# `here` is set by who sources this.
# shellcheck disable=SC2154
cache=${XDG_CACHE_HOME:-$HOME/.cache}/taktil-rt-guest
out=$cache/out
readonly SKIPPED=77

say() { echo "rt-guest: $*" >&2; }
bad() { say "$1"; exit 2; }
skip() { echo "SKIPPED: rt-guest: $*"; exit "$SKIPPED"; }

temporary=() machines=()
# Called by the trap.
# shellcheck disable=SC2317,SC2329
finish() {
    ((${#machines[@]} == 0)) || kill "${machines[@]}" 2>/dev/null || true
    ((${#temporary[@]} == 0)) || rm -rf "${temporary[@]}"
}
trap finish EXIT

# shellcheck source-path=SCRIPTDIR
. "$here/packages.sh"

# Takes the cache for this script, until it shares it, and sees to everything in it.
prepare() {
    mkdir -p "$cache" "$out"
    exec 9>"$cache/lock"
    flock -n 9 || { say "another run uses the cache: waiting for it"; flock 9; }
    : >"$out/apt.log"
    [[ $(uname -m) == x86_64 ]] || skip "made for x86_64"
    for tool in apt-get dpkg-deb flock; do
        command -v "$tool" >/dev/null || skip "needs Debian's package tools: no $tool"
    done
    # Read by packages.sh.
    # shellcheck disable=SC2034
    codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
    install_tools || skip "QEMU and its tools cannot be installed here: $(missing_tools | tr '\n' ' ')"
    build_parts || skip "the guest's packages cannot be had here"
}

# Lets other scripts use the cache beside this one, from when everything is in it: each boots guests of its own names.
share_cache() { flock -u 9; }

# Boots one guest, stopped after so many seconds, and waits for its end; its answers lie in $out/NAME.result afterwards, its first
# process and files came from $out/NAME.overlay. `guest_base`, `guest_memory` (MiB) and `guest_arguments` (of the kernel) say otherwise.
boot() { # NAME KERNEL SECONDS
    local begin=$SECONDS code=0 machine
    cat "${guest_base:-$parts/base.cpio}" "$out/$1.overlay" >"$out/$1.initrd"
    : >"$out/$1.result"
    # -icount: an instruction is 2 ns of the guest's time, or 1 ns where `guest_shift` is 0; idle time is skipped. One CPU: with two, QEMU runs them in turns.
    trap 'kill "$machine" 2>/dev/null; exit 1' TERM
    timeout -k 5 "$3" qemu-system-x86_64 -M q35 -cpu max -m "${guest_memory:-512}" \
        -accel tcg,thread=single -smp 1 -icount "shift=${guest_shift:-1},sleep=off" \
        -display none -nodefaults -no-user-config -no-reboot -monitor none \
        -serial "file:$out/$1.console" -serial "file:$out/$1.result" \
        -kernel "$parts/kernel-$2" -initrd "$out/$1.initrd" \
        -append "console=ttyS0 quiet loglevel=4 oops=panic panic=-1 ${guest_arguments:-}" 2>"$out/$1.qemu" 9>&- &
    machine=$!
    wait "$machine" || code=$?
    rm -f "$out/$1.initrd" "$out/$1.overlay"
    echo "$code $((SECONDS - begin))" >"$out/$1.ended"
}
