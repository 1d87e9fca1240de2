//! Parses `meta.json`.
//!
//! Both versions are converted to tables of 256 values, indexed by bytes. Version 2 stores the tables as codebooks,
//! version 1 as ranges.

use crate::activation;
use crate::error::{SceneError, row, wrong};
use crate::ply::origin;
use crate::scene::Filter;
use serde::Deserialize;

/// Number of values of a byte, and of entries in a codebook.
pub(super) const CODES: usize = 256;

/// Maximum number of palette entries, which 16-bit labels can address.
pub(super) const MAX_ENTRIES: u32 = 1 << 16;

#[derive(Debug)]
pub(super) struct Meta {
    pub version: u32,
    pub count: u32,
    pub filter: Filter,
    pub means: Means,
    /// Logarithms of scales, per axis.
    pub scales: Coded,
    pub quats: String,
    /// Band 0, per channel.
    pub colors: Coded,
    /// Opacity for each value of an alpha byte.
    pub opacities: Vec<f32>,
    pub palette: Option<Palette>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Means {
    pub mins: [f64; 3],
    pub maxs: [f64; 3],
    pub files: [String; 2],
}

impl Means {
    /// Number of steps of a coordinate: 16 bits.
    pub const STEPS: f64 = 65_535.0;

    /// Returns a position in the world, from the texels of the low and of the high bytes.
    pub fn position(&self, low: &[u8], high: &[u8]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let part = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / Self::STEPS;
            expanded(self.mins[axis] * (1.0 - part) + self.maxs[axis] * part)
        })
    }

    /// Returns true if f32 rounds positions by more than 1/8 of their steps. The positions must also reach half of
    /// [`origin::STEP`], from which on a scene can have an offset.
    pub fn is_wide(&self) -> bool {
        (0..3).any(|axis| {
            let (min, max) = (self.mins[axis], self.maxs[axis]);
            let far = expanded(min.abs().max(max.abs()));
            let step = (1.0 + far) * (max - min).abs() / Self::STEPS;
            far >= 0.5 * origin::STEP && 0.5 * f64::from(f32::EPSILON) * far > step / 8.0
        })
    }
}

/// Compresses a coordinate logarithmically: its resolution decreases with the distance from 0.
pub(super) fn compressed(value: f64) -> f64 {
    value.signum() * value.abs().ln_1p()
}

/// Inverts [`compressed`].
fn expanded(value: f64) -> f64 {
    value.signum() * value.abs().exp_m1()
}

/// A texture whose bytes are indices into tables, one table per channel.
#[derive(Debug)]
pub(super) struct Coded {
    pub tables: [Vec<f32>; 3],
    pub file: String,
}

#[derive(Debug)]
pub(super) struct Palette {
    /// Number of entries and of bands; `None` in version 1, where the texture's size determines them.
    pub size: Option<(u32, u32)>,
    pub codebook: Vec<f32>,
    /// Names of the textures with the palette and with the labels.
    pub files: [String; 2],
}

#[derive(Deserialize)]
struct Version {
    version: Option<u32>,
}

/// The fields of version 2 that a reader needs; others are ignored.
#[derive(Deserialize)]
struct Meta2 {
    count: u32,
    #[serde(default)]
    antialias: bool,
    model: Option<String>,
    means: Means,
    scales: Coded2,
    quats: Plain,
    sh0: Coded2,
    #[serde(rename = "shN")]
    sh_n: Option<Palette2>,
}

#[derive(Deserialize)]
struct Coded2 {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Palette2 {
    count: u32,
    bands: u32,
    codebook: Vec<f32>,
    files: [String; 2],
}

#[derive(Deserialize)]
struct Meta1 {
    means: Means1,
    scales: Range1<3>,
    quats: Plain,
    sh0: Range1<4>,
    #[serde(rename = "shN")]
    sh_n: Option<Palette1>,
}

#[derive(Deserialize)]
struct Means1 {
    shape: Vec<u64>,
    #[serde(flatten)]
    means: Means,
}

#[derive(Deserialize)]
#[serde(bound = "[f64; N]: Deserialize<'de>")]
struct Range1<const N: usize> {
    mins: [f64; N],
    maxs: [f64; N],
    files: [String; 1],
}

#[derive(Deserialize)]
struct Palette1 {
    mins: f64,
    maxs: f64,
    files: [String; 2],
}

/// Tabulates 256 equidistant values from `min` to `max`.
fn between(min: f64, max: f64) -> Vec<f32> {
    (0..CODES).map(|byte| (min + (max - min) * (byte as f64 / 255.0)) as f32).collect()
}

impl Meta2 {
    fn checked(self) -> Result<Meta, SceneError> {
        let filter = match (self.model.as_deref(), self.antialias) {
            (Some("antialiased"), _) | (None | Some("default"), true) => Filter::Compensated,
            (None | Some("default"), false) => Filter::Dilated,
            (Some("2dgs"), _) => return Err(SceneError::SURFELS),
            (Some(found), _) => return Err(unexpected("model", "default, antialiased or 2dgs", found)),
        };
        let palette = self.sh_n.as_ref();
        let codebooks = [
            ("scales.codebook", Some(&self.scales.codebook)),
            ("sh0.codebook", Some(&self.sh0.codebook)),
            ("shN.codebook", palette.map(|palette| &palette.codebook)),
        ];
        for (name, codebook) in codebooks {
            if let Some(found) = codebook.map(Vec::len).filter(|length| *length != CODES) {
                return Err(unexpected(name, "256 numbers", found));
            }
        }
        if let Some(palette) = palette {
            if !(1..=3).contains(&palette.bands) {
                return Err(unexpected("shN.bands", "1 to 3", palette.bands));
            }
            if !(1..=MAX_ENTRIES).contains(&palette.count) {
                return Err(unexpected("shN.count", "1 to 65536", palette.count));
            }
        }
        let coded = |Coded2 { codebook, files: [file] }: Coded2| Coded {
            tables: [codebook.clone(), codebook.clone(), codebook],
            file,
        };
        let [quats] = self.quats.files;
        Ok(Meta {
            version: 2,
            count: self.count,
            filter,
            means: self.means,
            scales: coded(self.scales),
            quats,
            colors: coded(self.sh0),
            opacities: between(0.0, 1.0),
            palette: self.sh_n.map(|Palette2 { count, bands, codebook, files }| Palette {
                size: Some((count, bands)),
                codebook,
                files,
            }),
        })
    }
}

impl Meta1 {
    fn checked(self) -> Result<Meta, SceneError> {
        let rows = self.means.shape.first().copied().unwrap_or(0);
        let count =
            u32::try_from(rows).map_err(|_| unexpected("means.shape", "at most 4294967295 splats", rows))?;
        fn coded<const N: usize>(range: &Range1<N>) -> Coded {
            let tables = [0, 1, 2].map(|axis| between(range.mins[axis], range.maxs[axis]));
            Coded { tables, file: range.files[0].clone() }
        }
        let logits = between(self.sh0.mins[3], self.sh0.maxs[3]);
        let [quats] = self.quats.files;
        Ok(Meta {
            version: 1,
            count,
            filter: Filter::Dilated,
            means: self.means.means,
            scales: coded(&self.scales),
            quats,
            colors: coded(&self.sh0),
            opacities: logits.into_iter().map(activation::sigmoid).collect(),
            palette: self.sh_n.map(|Palette1 { mins, maxs, files }| Palette {
                size: None,
                codebook: between(mins, maxs),
                files,
            }),
        })
    }
}

impl Meta {
    pub(super) fn parse(text: &[u8]) -> Result<Self, SceneError> {
        let malformed = |error: serde_json::Error| malformed("meta.json", &error);
        let Version { version } = serde_json::from_slice(text).map_err(malformed)?;
        let meta = match version {
            Some(2) => serde_json::from_slice::<Meta2>(text).map_err(malformed)?.checked()?,
            None | Some(1) => serde_json::from_slice::<Meta1>(text).map_err(malformed)?.checked()?,
            Some(found) => return Err(unexpected("version", "1 or 2", found)),
        };
        if meta.count == 0 {
            return Err(unexpected("count", "at least one splat", 0));
        }
        Ok(meta)
    }

    /// Lists the textures with one texel per splat. The last one has the labels; `None` without a palette.
    pub(super) fn textures(&self) -> [Option<&str>; 6] {
        [
            Some(&self.means.files[0]),
            Some(&self.means.files[1]),
            Some(&self.scales.file),
            Some(&self.quats),
            Some(&self.colors.file),
            self.palette.as_ref().map(|palette| &palette.files[1]),
        ]
        .map(|name| name.map(String::as_str))
    }
}

/// Returns the error for text that is not valid JSON, or lacks the structure of the document `name`.
pub(super) fn malformed(name: &str, error: &serde_json::Error) -> SceneError {
    row(error.line() as u64, format!("{name}: {error}"))
}

pub(super) fn unexpected(name: &str, expected: &str, found: impl std::fmt::Display) -> SceneError {
    wrong(format!("meta.json: {name}"), format!("expected {expected}, found {found}"))
}
