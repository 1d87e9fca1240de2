//! Chooses the graphics backend. No other module of the application names one.

pub use splatgraph_metal::dump::add_encoders as add_metal_encoders;
pub use splatgraph_vulkan::{Options, Validation, Vulkan as Backend, compilers_given_up};
