//! Defines typed indices into the lists of a plan.

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u32);
        impl $name {
            /// Returns the index as a `usize`, for use with the list.
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}

id!(/// An index into [`Plan::resources`](crate::plan::Plan::resources).
    ResourceId);
id!(/// An index into [`Plan::passes`](crate::plan::Plan::passes).
    PassId);
id!(/// An index into [`Plan::shaders`](crate::plan::Plan::shaders).
    ShaderId);
id!(/// An index into [`Plan::blocks`](crate::plan::Plan::blocks).
    BlockId);
