//! Defines the plain types shared by the compiler's steps, the backends and the application. They are the parts of a
//! [`Request`] and of a [`Plan`](crate::plan::Plan).
//!
//! The rest of this crate imports this module; it imports nothing from the crate.

mod access;
mod device;
mod features;
mod format;
mod id;
mod location;
mod param;
mod pass;
mod reason;
mod request;
mod resource;
mod shader;
mod value;

pub use access::{Accesses, Hazard, Layout, Masks, Stages};
pub use device::{DeviceFacts, FEATURE_FACTS};
pub use features::Features;
pub use format::{Blend, DepthAccess, Format, Load, Topology};
pub use id::{BlockId, PassId, ResourceId, ShaderId};
pub use location::{FileId, Origin, Span};
pub use param::{Domain, Effect, LIVE_BINDING, LIVE_BLOCK, Param, ParamBinding, ParamSet};
pub use pass::{
    Binding, Culled, DepthTarget, DescriptorKind, DrawCall, EXPORT, Groups, HOST, Output, Pass, Run, Stat,
    Target, Use, Work,
};
pub use reason::{Fallback, Reason, Unmet};
pub use request::{Attribute, Catalog, Facts, Family, HostBuffer, OUTPUTS, Request};
pub use resource::{Shape, Source, Usage, bytes};
pub use shader::{
    Member, MemberKind, Msl, MslArgument, PushBlock, ReflectedBinding, ReflectedKind, Reflection, Shader,
    ShaderStage, Varying,
};
pub use value::{Value, to_f32};
