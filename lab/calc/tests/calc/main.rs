//! The calc filter: every row of the reference data, and every kind of invalid request.

mod ask;
mod cells;
mod goldens;
mod hostile;
mod hostile_plane;
mod jacobian;
mod layer;
mod meshed;
mod path;
mod plane;
mod refusals;
mod space;
mod touch;
mod wild;
