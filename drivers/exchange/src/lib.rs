//! What drivers have in common whose halves share one exchange a cycle with a board or a bus: how
//! the halves get at it without a lock, how they answer when it fails, when its answers count as
//! untrustworthy, and what is wrong with a board that cannot be opened.
//!
//! A driver implements [`Exchange`] for what it talks to and gives each half a [`Shared`] of it:
//!
//! ```
//! use std::sync::Arc;
//! use taktil_drivers_exchange::{Exchange, Failure, Half, Presence, Shared};
//! use taktil_hal::ErrorKind;
//!
//! struct Card {
//!     code: i32,
//! }
//!
//! impl Exchange for Card {
//!     type Shown = ();
//!
//!     fn publish(&self, (): &(), _collisions: u64) {}
//!
//!     fn safe(&mut self, half: Half) -> Result<(), Failure> {
//!         if half == Half::Motors {
//!             self.code = 0;
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let shared = Arc::new(Shared::new(Card { code: 7 }, ()));
//! let mut presence = Presence::default();
//! let read = |card: &mut Card| if card.code > 5 { Ok(card.code) } else { Err(Failure::LOST) };
//! assert_eq!(presence.answer("card", shared.with(read)), Ok(7));
//! assert_eq!(shared.safe(Half::Motors), Some(Ok(())));
//! let lost = presence.answer("card", shared.with(read)).unwrap_err();
//! assert_eq!(lost.kind, ErrorKind::Lost);
//! ```

mod answer;
mod level;
mod refusal;
mod share;

pub use answer::{Failure, Presence};
pub use level::{ErrorLevel, LEVEL_LIMIT};
pub use refusal::Refusal;
pub use share::{Exchange, Half, Shared};
