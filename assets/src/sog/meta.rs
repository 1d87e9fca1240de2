//! Parses `meta.json`.

use crate::error::SceneError;
use crate::scene::Filter;
use serde::Deserialize;

/// Number of entries of a codebook.
pub(super) const CODES: usize = 256;

/// Maximum number of palette entries, which 16-bit labels can address.
pub(super) const MOST_ENTRIES: u32 = 1 << 16;

/// The fields that the reader needs; others are ignored.
#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub count: u32,
    #[serde(default)]
    antialias: bool,
    model: Option<String>,
    pub means: Means,
    pub scales: Coded,
    pub quats: Plain,
    pub sh0: Coded,
    #[serde(rename = "shN")]
    pub sh_n: Option<Palette>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Means {
    pub mins: [f64; 3],
    pub maxs: [f64; 3],
    pub files: [String; 2],
}

#[derive(Debug, Deserialize)]
pub(super) struct Coded {
    pub codebook: Vec<f32>,
    pub files: [String; 1],
}

#[derive(Debug, Deserialize)]
pub(super) struct Plain {
    pub files: [String; 1],
}

#[derive(Debug, Deserialize)]
pub(super) struct Palette {
    pub count: u32,
    pub bands: u32,
    pub codebook: Vec<f32>,
    /// Files of the palette and of the labels.
    pub files: [String; 2],
}

/// The version field, which determines the others.
#[derive(Deserialize)]
struct Version {
    version: Option<u32>,
}

impl Meta {
    /// Parses the text.
    pub(super) fn parse(text: &[u8]) -> Result<Self, SceneError> {
        let malformed = |error: serde_json::Error| SceneError::Row {
            line: error.line() as u64,
            message: format!("meta.json: {error}"),
        };
        let Version { version } = serde_json::from_slice(text).map_err(malformed)?;
        match version {
            Some(2) => {}
            None | Some(1) => {
                let (format, advice) =
                    ("a PlayCanvas SOG scene of version 1", "convert it to version 2 with splat-transform");
                return Err(SceneError::Unsupported { format, advice });
            }
            Some(found) => return Err(wrong("version", "2", found)),
        }
        let meta: Self = serde_json::from_slice(text).map_err(malformed)?;
        match meta.model.as_deref() {
            None | Some("default" | "antialiased") => {}
            Some("2dgs") => return Err(SceneError::SURFELS),
            Some(found) => return Err(wrong("model", "default, antialiased or 2dgs", found)),
        }
        if meta.count == 0 {
            return Err(wrong("count", "at least one splat", 0));
        }
        let palette = meta.sh_n.as_ref();
        let codebooks = [
            ("scales.codebook", Some(&meta.scales.codebook)),
            ("sh0.codebook", Some(&meta.sh0.codebook)),
            ("shN.codebook", palette.map(|palette| &palette.codebook)),
        ];
        for (name, codebook) in codebooks {
            if let Some(found) = codebook.map(Vec::len).filter(|length| *length != CODES) {
                return Err(wrong(name, "256 numbers", found));
            }
        }
        if let Some(palette) = palette {
            if !(1..=3).contains(&palette.bands) {
                return Err(wrong("shN.bands", "1 to 3", palette.bands));
            }
            if !(1..=MOST_ENTRIES).contains(&palette.count) {
                return Err(wrong("shN.count", "1 to 65536", palette.count));
            }
        }
        Ok(meta)
    }

    /// Returns the degree of the spherical harmonics.
    pub(super) fn degree(&self) -> u32 {
        self.sh_n.as_ref().map_or(0, |palette| palette.bands)
    }

    /// Returns the low-pass filter of the training, which newer files call the model.
    pub(super) fn filter(&self) -> Filter {
        match self.antialias || self.model.as_deref() == Some("antialiased") {
            true => Filter::Compensated,
            false => Filter::Dilated,
        }
    }
}

/// Returns the error for an invalid value in `meta.json`.
pub(super) fn wrong(name: &str, expected: &str, found: impl std::fmt::Display) -> SceneError {
    SceneError::Part {
        part: format!("meta.json: {name}"),
        message: format!("expected {expected}, found {found}"),
    }
}
