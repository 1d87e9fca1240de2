//! Names that graphs cannot use, because the framework does.

/// Names the pass at the frame's end that makes the output readable by copies.
pub const EXPORT: &str = "export";

/// Names the host's turn after the frame.
pub const HOST: &str = "host";

/// Binds the generated block of live parameters.
pub const LIVE_BINDING: u32 = 31;

/// Names the generated block of live parameters.
pub const LIVE_BLOCK: &str = "Live";
