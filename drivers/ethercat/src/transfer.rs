//! A request to the segment that may outlive the call that began it: it is sent in one call, and
//! its answer is collected in the same one or in a later one. There is room for one request at a
//! time, set aside when the segment is opened; a lane does not use the heap.

use core::pin::Pin;
use core::task::{Context, Poll};

use taktil_hal::Nanos;

use crate::master::Master;

/// Room for the future of a request, whose type has no name.
trait Slot<R, A>: Send {
    fn begin(&mut self, request: R);
    fn poll(&mut self, context: &mut Context<'_>) -> Poll<A>;
    fn clear(&mut self);
}

/// What makes a future of a request, and the future that is under way.
struct Room<M, F> {
    make: M,
    future: Pin<Box<Option<F>>>,
}

impl<R, A, M, F> Slot<R, A> for Room<M, F>
where
    M: FnMut(R) -> F + Send,
    F: Future<Output = A> + Send,
{
    fn begin(&mut self, request: R) {
        self.future.set(Some((self.make)(request)));
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<A> {
        match self.future.as_mut().as_pin_mut() {
            Some(future) => future.poll(context),
            None => Poll::Pending,
        }
    }

    fn clear(&mut self) {
        self.future.set(None);
    }
}

/// Requests of one kind, one at a time.
pub(crate) struct Transfer<R, A> {
    slot: Box<dyn Slot<R, A>>,
    is_under_way: bool,
    /// The answer to a request that ended before it was sent.
    early: Option<A>,
}

impl<R: 'static, A: 'static> Transfer<R, A> {
    /// Requests whose futures `make` makes; none is under way.
    pub(crate) fn new<F>(make: impl FnMut(R) -> F + Send + 'static) -> Transfer<R, A>
    where
        F: Future<Output = A> + Send + 'static,
    {
        let slot = Box::new(Room { make, future: Box::pin(None) });
        Transfer { slot, is_under_way: false, early: None }
    }

    /// Whether a request was sent and its answer has neither been collected nor given up.
    pub(crate) fn is_under_way(&self) -> bool {
        self.is_under_way
    }

    /// Sends a request; one that is under way is given up first.
    pub(crate) fn begin(&mut self, master: &mut Master, request: R) {
        self.slot.begin(request);
        self.is_under_way = true;
        self.early = master.start(|context| self.slot.poll(context));
    }

    /// The answer, waited for at most for `wait`; `None` when it has not come, or nothing is under
    /// way.
    pub(crate) fn collect(&mut self, master: &mut Master, wait: Nanos) -> Option<A> {
        if !self.is_under_way {
            return None;
        }
        let early = self.early.take();
        let answer = early.or_else(|| master.wait_for(wait, |context| self.slot.poll(context)));
        if answer.is_some() {
            self.give_up();
        }
        answer
    }

    /// Gives up what is under way: an answer that comes later is nobody's.
    pub(crate) fn give_up(&mut self) {
        self.slot.clear();
        (self.is_under_way, self.early) = (false, None);
    }
}
