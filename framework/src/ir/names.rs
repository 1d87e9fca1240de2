//! Names that are reserved for the framework.

/// The pass at the end of a frame that makes the output readable by copies.
pub const EXPORT: &str = "export";

/// The start of the names of the facts that say which outputs are asked for besides the picture: `outputs.depth`. One without a value is
/// false.
pub const OUTPUTS: &str = "outputs.";

/// The step after the frame in which the host reads the statistics.
pub const HOST: &str = "host";

/// Binding number of the generated block of live parameters.
pub const LIVE_BINDING: u32 = 31;

/// The generated block of live parameters.
pub const LIVE_BLOCK: &str = "Live";
