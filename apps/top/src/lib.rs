//! A running machine on a terminal: what is shown, asked of the operator's socket, and how it is
//! drawn on 80 by 24 characters. The program is a loop around these two.

mod screen;
mod view;

pub use screen::draw;
pub use view::MachineView;
