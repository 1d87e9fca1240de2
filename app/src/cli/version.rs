//! Formats the answer to `splatgraph --version`.

use crate::io::program;

/// Returns the version, the features, and the program's hash, which ledgers and shards record. A hash that cannot be
/// computed is `unknown`.
pub fn long() -> String {
    let all = [
        ("av1", cfg!(feature = "av1")),
        ("renderdoc", cfg!(feature = "renderdoc")),
        ("tracy", cfg!(feature = "tracy")),
        ("window", cfg!(feature = "window")),
    ];
    let features: Vec<&str> = all.iter().filter(|(_, is_on)| *is_on).map(|(name, _)| *name).collect();
    let features = if features.is_empty() { "none".to_owned() } else { features.join(", ") };
    let hash = program::hash().unwrap_or_else(|error| format!("unknown ({error})"));
    format!("{}\nfeatures: {features}\nprogram: {hash}", program::VERSION)
}
