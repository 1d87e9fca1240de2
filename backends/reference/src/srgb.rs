//! Converts between linear light and display encoding (IEC 61966-2-1), both 0 to 1.

/// Decodes a display-encoded value to linear light.
pub(crate) fn decode(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Encodes a linear-light value for display.
pub(crate) fn encode(v: f64) -> f64 {
    if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
