//! Reads and writes PSNR in JSON. JSON has no infinity: the PSNR of a mean squared error of 0 is the text `inf`. A PSNR
//! that was not measured is `null`.

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

/// Writes a PSNR; `None`, a mean squared error of 0, is written as `inf`.
///
/// # Errors
/// The serializer's errors.
pub fn serialize<S: Serializer>(psnr_db: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    Decibels(psnr_db.unwrap_or(f64::INFINITY)).serialize(serializer)
}

/// Reads the PSNR that [`serialize`] writes; `None` for `inf`.
///
/// # Errors
/// The value is neither a number nor `inf`.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected decibels, or `inf` for equal pictures")]
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

/// Writes a PSNR; infinity is written as `inf`.
///
/// # Errors
/// The serializer's errors.
pub fn serialize_number<S: Serializer>(psnr_db: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    Decibels(*psnr_db).serialize(serializer)
}

/// Writes a PSNR; infinity is written as `inf`, and `None`, not measured, as `null`.
///
/// # Errors
/// The serializer's errors.
pub fn serialize_measured<S: Serializer>(psnr_db: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    psnr_db.map(Decibels).serialize(serializer)
}

/// Writes a list with the PSNR of each view; infinity is written as `inf`.
///
/// # Errors
/// The serializer's errors.
pub fn serialize_views<S: Serializer>(psnr_db: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(psnr_db.iter().map(|db| Decibels(*db)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::IntoDeserializer;
    use serde::de::value::Error;

    fn read<'de>(value: impl IntoDeserializer<'de, Error>) -> Result<Option<f64>, String> {
        deserialize(value.into_deserializer()).map_err(|error| error.to_string())
    }

    #[test]
    fn decibels_are_a_number_or_inf_and_other_values_are_refused_by_what_is_expected() {
        assert_eq!((read(40.5), read(INFINITE)), (Ok(Some(40.5)), Ok(None)));
        assert_eq!(read("equal"), Err("expected decibels or `inf`, found `equal`".into()));
        let refused = Err("expected decibels, or `inf` for equal pictures".into());
        assert_eq!((read(()), read(true)), (refused.clone(), refused));
    }
}
