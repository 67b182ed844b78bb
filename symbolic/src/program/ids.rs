//! Index newtypes.

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub struct $name(pub u32);
        impl $name {
            /// The id as an index.
            pub fn index(self) -> usize { self.0 as usize }
        }
    };
}
pub(crate) use id;

id!(/// The result of one instruction.
    Value);
id!(/// A sum over the pixels of a row, later of the pass.
    AccumulatorId);
id!(/// A sum over rows, in f64.
    TotalId);
id!(/// A position in [`LoopNest::inputs`](crate::program::LoopNest::inputs).
    InputId);
id!(/// A parameter of the model, in document order.
    ParameterId);
id!(/// A constant of the model, in document order.
    ConstantId);
id!(/// A coordinate; 0 is the inner loop.
    CoordinateId);
id!(/// A raw image plane.
    ChannelId);
