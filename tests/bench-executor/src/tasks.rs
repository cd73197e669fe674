//! The chain of tasks for cu29: a source, hops that pass a value on, a sink. They do exactly what
//! ours do.

use core::hint::black_box;

use bincode::{Decode, Encode};
use cu29::prelude::*;
use serde::{Deserialize, Serialize};

/// Six numbers, as a joint servo passes them on.
#[derive(Clone, Copy, Debug, Default, Encode, Decode, Serialize, Deserialize, Reflect)]
pub struct Joints {
    /// Angles, rad.
    pub q_rad: [f64; 6],
}

macro_rules! tasks {
    ($payload:ty, $source:ident, $hop:ident, $sink:ident, |$count:ident| $value:expr) => {
        #[derive(Reflect)]
        pub struct $source {
            count: i32,
        }

        impl Freezable for $source {}

        impl CuSrcTask for $source {
            type Resources<'r> = ();
            type Output<'m> = output_msg!($payload);

            fn new(_: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
                Ok(Self { count: 0 })
            }

            fn process(&mut self, _: &CuContext, output: &mut Self::Output<'_>) -> CuResult<()> {
                self.count += 1;
                let $count = self.count;
                output.set_payload($value);
                Ok(())
            }
        }

        #[derive(Reflect)]
        pub struct $hop;

        impl Freezable for $hop {}

        impl CuTask for $hop {
            type Resources<'r> = ();
            type Input<'m> = input_msg!($payload);
            type Output<'m> = output_msg!($payload);

            fn new(_: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
                Ok(Self)
            }

            fn process(
                &mut self,
                _: &CuContext,
                input: &Self::Input<'_>,
                output: &mut Self::Output<'_>,
            ) -> CuResult<()> {
                if let Some(value) = input.payload() {
                    output.set_payload(*value);
                }
                Ok(())
            }
        }

        #[derive(Reflect)]
        pub struct $sink;

        impl Freezable for $sink {}

        impl CuSinkTask for $sink {
            type Resources<'r> = ();
            type Input<'m> = input_msg!($payload);

            fn new(_: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
                Ok(Self)
            }

            fn process(&mut self, _: &CuContext, input: &Self::Input<'_>) -> CuResult<()> {
                black_box(input.payload());
                Ok(())
            }
        }
    };
}

tasks!(i32, SourceSmall, HopSmall, SinkSmall, |count| count);
tasks!(Joints, SourceJoints, HopJoints, SinkJoints, |count| Joints {
    q_rad: [f64::from(count); 6]
});
