//! PSNR in JSON. JSON has no infinity: the PSNR of equal pictures is the text `inf`, and `null` is one that was not
//! measured.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

const INFINITE: &str = "inf";

struct Decibels(f64);

impl Serialize for Decibels {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            f64::INFINITY => serializer.serialize_str(INFINITE),
            db => serializer.serialize_f64(db),
        }
    }
}

/// Writes a PSNR; `None`, identical pictures, is infinite.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer>(psnr_db: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    Decibels(psnr_db.unwrap_or(f64::INFINITY)).serialize(serializer)
}

/// Reads what [`serialize`] writes.
///
/// # Errors
/// The value is neither a number nor `inf`.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Found {
        Number(f64),
        Text(String),
    }
    match Found::deserialize(deserializer)? {
        Found::Number(db) => Ok(Some(db)),
        Found::Text(text) if text == INFINITE => Ok(None),
        Found::Text(text) => {
            Err(D::Error::custom(format!("expected decibels or `{INFINITE}`, found `{text}`")))
        }
    }
}

/// Writes a PSNR that may be infinite.
///
/// # Errors
/// Those of the serializer.
pub fn serialize_number<S: Serializer>(psnr_db: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    Decibels(*psnr_db).serialize(serializer)
}

/// Writes a PSNR that may be infinite; `None`, not measured, is `null`.
///
/// # Errors
/// Those of the serializer.
pub fn serialize_measured<S: Serializer>(psnr_db: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    psnr_db.map(Decibels).serialize(serializer)
}

/// Writes the PSNR of several views, which may be infinite.
///
/// # Errors
/// Those of the serializer.
pub fn serialize_views<S: Serializer>(psnr_db: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(psnr_db.iter().map(|db| Decibels(*db)))
}
