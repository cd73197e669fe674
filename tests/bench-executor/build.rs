//! What cu29's macros ask of a build script.

fn main() {
    cu29_build::setup();
}
