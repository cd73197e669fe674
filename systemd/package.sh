#!/usr/bin/env bash
# Builds the Debian package: the programs, their manual pages and completions, then `cargo deb` over the list of files in
# apps/taktil/Cargo.toml. Prints the package's path on the last line.
#
#   systemd/package.sh [--profile release|dist] [--programs built]
#
#   --profile P       how the programs are optimised: release (quick to build), dist (for a robot's computer)
#   --programs built  package the programs that lie there; build nothing
#
# cargo-deb is taken from the path, or installed once into the build folder (some minutes).
# Exit: 0 packaged, 1 something failed, 2 bad option.
set -Eeuo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
profile=release programs=fresh
while (($#)); do
    case $1 in
        --profile) profile=${2:-}; shift ;;
        --programs) programs=${2:-}; shift ;;
        -h | --help) sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p}' "$0"; exit 0 ;;
        *) echo "unknown option $1; see --help" >&2; exit 2 ;;
    esac
    shift || { echo "the last option lacks its value" >&2; exit 2; }
done
[[ $profile =~ ^(release|dist)$ ]] || { echo "--profile $profile: give release or dist" >&2; exit 2; }
[[ $programs =~ ^(fresh|built)$ ]] || { echo "--programs $programs: give built, or leave it out" >&2; exit 2; }
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
export CARGO_TARGET_DIR=$target

PATH=$target/tools/bin:$PATH
if ! command -v cargo-deb >/dev/null; then
    echo "installing cargo-deb into $target/tools" >&2
    CARGO_TARGET_DIR=$target/tools/build cargo install --quiet --locked --debug --root "$target/tools" cargo-deb --version '^3.8'
fi

[[ $programs == built ]] ||
    cargo build --locked --quiet --profile "$profile" -p taktil -p taktild -p taktil-safe -p taktil-dashboard -p taktil-top >&2

built=$target/$profile
made=$built/package
rm -rf "$made"
mkdir -p "$made"
"$built/taktil" manual "$made/man"
gzip -9n "$made"/man/*
# The sources run without groups, the package makes them.
sed '/^socket = /a control_group = "taktil-control"\nview_group = "taktil-view"' systemd/emulated-boards.toml >"$made/emulated-boards.toml"
grep -q '^view_group' "$made/emulated-boards.toml"
for shell in bash zsh fish; do
    "$built/taktil" completions "$shell" >"$made/taktil.$shell"
done
cargo deb --quiet --locked --no-build --no-dbgsym --strip --profile "$profile" -p taktil
