//! Describes the formats of scene files.

use std::path::Path;

/// A format of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneFormat {
    /// PLY in the layout of the reference implementation.
    Ply,
    /// PLY in PlayCanvas's compressed layout.
    CompressedPly,
    /// Niantic's SPZ: versions 1 to 4 are read, 3 and 4 are written.
    Spz,
    /// antimatter15's `.splat`.
    Splat,
    /// PlayCanvas's SOG. Versions 1 and 2 are read, in one file or a folder, and so are levels of a streamed scene.
    /// Version 2 is written, in one file.
    Sog,
    /// Mark Kellogg's `.ksplat`; read, not written.
    Ksplat,
    /// Spark's `.rad` and `.radc`; read, not written.
    Rad,
    /// OpenUSD's `ParticleField3DGaussianSplat`: `.usda`, `.usdc` and `.usdz`; read, not written.
    Usd,
    /// Khronos's glTF with `KHR_gaussian_splatting`: `.glb` and `.gltf` are read, `.glb` is written.
    Gltf,
}

impl SceneFormat {
    /// The formats that [`Scene::write`](crate::Scene::write) writes.
    pub const WRITTEN: [Self; 6] =
        [Self::Ply, Self::CompressedPly, Self::Spz, Self::Splat, Self::Sog, Self::Gltf];

    /// All formats.
    pub const ALL: [Self; 9] = [
        Self::Ply,
        Self::CompressedPly,
        Self::Spz,
        Self::Splat,
        Self::Sog,
        Self::Ksplat,
        Self::Rad,
        Self::Usd,
        Self::Gltf,
    ];

    /// Returns the usual file extension, without the first dot.
    pub fn extension(self) -> &'static str {
        self.extensions()[0]
    }

    /// Lists the file extensions, without the first dot; the usual one comes first.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Ply => &["ply"],
            Self::CompressedPly => &["compressed.ply"],
            Self::Spz => &["spz"],
            Self::Splat => &["splat"],
            Self::Sog => &["sog"],
            Self::Ksplat => &["ksplat"],
            Self::Rad => &["rad", "radc"],
            Self::Usd => &["usd", "usda", "usdc", "usdz"],
            Self::Gltf => &["glb", "gltf"],
        }
    }

    /// Lists the extensions of all formats, each with its dot.
    pub fn endings() -> String {
        let all = Self::ALL.iter().flat_map(|format| format.extensions());
        all.map(|extension| format!(".{extension}")).collect::<Vec<_>>().join(", ")
    }

    /// Lists the usual extensions of `formats`, each with its dot: `.ply, .spz`.
    pub fn list(formats: &[Self]) -> String {
        formats.iter().map(|format| format!(".{}", format.extension())).collect::<Vec<_>>().join(", ")
    }

    /// Describes the format in a few words.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Ply => "the layout of the 3DGS reference implementation, not quantised",
            Self::CompressedPly => "PlayCanvas's compressed PLY, 16 bytes per splat",
            Self::Spz => "Niantic's SPZ, versions 1 to 4, written as 4 or 3",
            Self::Splat => "antimatter15's .splat, 32 bytes per splat, without harmonics above degree 0",
            Self::Sog => {
                "PlayCanvas's SOG, version 2: 20 bytes per splat before packing, and a palette of harmonics"
            }
            Self::Ksplat => "Mark Kellogg's .ksplat, read-only",
            Self::Rad => "Spark's .rad, read-only",
            Self::Usd => "OpenUSD's ParticleField3DGaussianSplat, read-only",
            Self::Gltf => "glTF with KHR_gaussian_splatting, exact, sorted by distance",
        }
    }

    /// Finds the format by the longest matching extension of `path`, ignoring case; `None` if none matches.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let all =
            Self::ALL.into_iter().flat_map(|format| format.extensions().iter().map(move |end| (format, end)));
        let matching = all.filter(|(_, end)| name.ends_with(&format!(".{end}")));
        matching.max_by_key(|(_, end)| end.len()).map(|(format, _)| format)
    }

    /// Lists what a scene with harmonics of `degree` loses in this format, one phrase per kind of value. Empty for
    /// exact formats, and for formats that are not written.
    pub fn losses(self, degree: u32) -> Vec<&'static str> {
        const MORTON: &str = "the order of the splats: they follow a Morton curve, so indices and selections of the original do not fit";
        let mut losses = match self {
            Self::Ply | Self::Ksplat | Self::Rad | Self::Usd | Self::Gltf => vec![],
            Self::Sog => vec![
                "positions: 16 bits per axis, of the range of sign(v) ln(1 + |v|)",
                "rotations: 8 bits per component",
                "scales and colours: 256 values, opacities: 8 bits",
                MORTON,
            ],
            Self::CompressedPly => vec![
                "positions and scales: 10 or 11 bits per axis, of the range in a chunk of 256 splats, scales of e^-20 to e^20",
                "rotations: 10 bits per component",
                "colours and opacities: 8 bits",
                MORTON,
            ],
            Self::Spz => vec![
                "positions: steps of 1/4096, or of more in a scene beyond 2048 units",
                "scales: steps of 1/16 of the logarithm, from e^-10 to e^5.94",
                "rotations: 9 bits and a sign per component",
                "colours and opacities: 8 bits, colours of -0.44 to 1.44",
            ],
            Self::Splat => vec!["rotations, colours and opacities: 8 bits, colours of 0 to 1 only"],
        };
        match self {
            Self::CompressedPly if degree > 0 => losses.push("harmonics: 8 bits of -4 to 4"),
            Self::Sog if degree > 0 => {
                losses.push("harmonics: a palette of at most 65,536 entries, of 256 values")
            }
            Self::Spz if degree > 0 => losses.push("harmonics of -1 to 1: 5 bits in band 1, 4 bits above"),
            Self::Splat if degree > 0 => losses.push("harmonics: cut to degree 0"),
            _ => {}
        }
        losses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_names_the_format_of_its_longest_extension() {
        for format in SceneFormat::ALL {
            for end in format.extensions() {
                let name = format!("folder/A.{}", end.to_uppercase());
                assert_eq!(SceneFormat::of_name(Path::new(&name)), Some(format), "{name}");
            }
        }
        assert_eq!(SceneFormat::of_name(Path::new("ply")), None);
    }
}
