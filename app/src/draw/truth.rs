//! Draws the exact picture of a scene on the CPU, as the reference for all comparisons.
//!
//! The renderer is `splatgraph-reference`: f64, and the published rasteriser's rules, each of which can be changed.

use crate::draw::inspect::Words;
use crate::draw::outputs::Output;
use crate::io::image::Image;
use crate::io::progress::Progress;
use serde::Serialize;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::{
    KeyOf, Picture, PictureMemoryError, RULES, RuleError, Rules, check_memory, render,
};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Mutex;
use std::time::Instant;

/// Statistics of an exact picture.
#[derive(Clone, Debug, Serialize)]
pub struct TruthStats {
    /// Name of the camera.
    pub camera: String,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Always `reference`.
    pub backend: &'static str,
    /// Rules with which the picture was drawn.
    pub rules: Rules,
    /// Number of splats of the scene.
    pub loaded: usize,
    /// Number of splats blended at a pixel, averaged over all pixels.
    pub mean_contributors: f64,
    /// Largest number of splats blended at a pixel.
    pub most_contributors: u32,
    /// Fraction of pixels with a transmittance below 1.
    pub covered: f64,
    /// Host time to draw the picture, in milliseconds.
    pub cpu_ms: f64,
    /// Files of the camera, by output; `picture` is the picture. Empty if none was written.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
}

impl fmt::Display for TruthStats {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let TruthStats { covered, mean_contributors, most_contributors, cpu_ms, .. } = self;
        write!(
            f,
            "exact, {:.1} % covered, {mean_contributors:.1} splats per pixel (at most {most_contributors}), {:.1} s on the CPU",
            100.0 * covered,
            cpu_ms / 1000.0
        )
    }
}

/// An exact picture, with its statistics.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Colours and other outputs of each pixel.
    pub picture: Picture,
    /// Statistics of the picture.
    pub stats: TruthStats,
}

impl Truth {
    /// Draws the exact picture of a scene, and shows the progress.
    ///
    /// `camera` is in the scene's coordinates. `background` is display-encoded.
    ///
    /// # Errors
    /// The picture and its visible splats do not fit in memory.
    pub fn draw(
        scene: &Scene,
        camera: &Camera,
        background: [f32; 3],
        rules: &Rules,
    ) -> Result<Truth, PictureMemoryError> {
        check_memory(scene, camera, rules)?;
        let begun = Instant::now();
        let progress = Mutex::new(Progress::new("drawing exactly"));
        let picture = render(scene, camera, background.map(f64::from), rules, &|done, of| {
            // Called on many threads. While one reports, the others skip their report.
            if let Ok(mut progress) = progress.try_lock() {
                progress.set(done as u64, of as u64, &camera.img_name);
            }
        });
        let pixels = picture.color.len().max(1) as f64;
        let sum: f64 = picture.contributors.iter().map(|count| f64::from(*count)).sum();
        let stats = TruthStats {
            camera: camera.img_name.clone(),
            width: picture.width,
            height: picture.height,
            backend: "reference",
            rules: rules.clone(),
            loaded: scene.count() as usize,
            mean_contributors: sum / pixels,
            most_contributors: picture.contributors.iter().copied().max().unwrap_or(0),
            covered: picture.transmittance.iter().filter(|t| **t < 1.0).count() as f64 / pixels,
            cpu_ms: begun.elapsed().as_secs_f64() * 1000.0,
            files: BTreeMap::new(),
        };
        Ok(Truth { picture, stats })
    }

    /// Converts the picture to an image, with colours rounded to f32.
    pub fn image(&self) -> Image {
        image_of(&self.picture)
    }

    /// Returns an output with values rounded to f32; `None` if its name is not in
    /// [`NAMES`](crate::draw::outputs::NAMES).
    pub fn output(&self, name: &str) -> Option<Output> {
        let picture = &self.picture;
        let rounded = |values: &[f64]| Words::Float(values.iter().map(|v| *v as f32).collect());
        let mut shape = vec![u64::from(picture.height), u64::from(picture.width)];
        let words = match name {
            "alpha" => Words::Float(picture.transmittance.iter().map(|t| (1.0 - t) as f32).collect()),
            "depth" => rounded(&picture.depth),
            "expected_depth" => rounded(&picture.expected_depth()),
            "median_depth" => rounded(&picture.median_depth),
            "normal" => {
                shape.push(3);
                rounded(picture.normal.as_flattened())
            }
            "contributors" => Words::Uint(picture.contributors.clone()),
            "index" => Words::Uint(picture.index.clone()),
            _ => return None,
        };
        let by_distance = self.stats.rules.key_of == KeyOf::Distance;
        Some(Output { name: name.to_owned(), shape, words, by_distance })
    }
}

/// Rounds the colours of an exact picture to f32. Values beyond the range of f32 are clamped to it.
pub fn image_of(picture: &Picture) -> Image {
    let limit = f64::from(f32::MAX);
    let rounded = |channel: f64| channel.clamp(-limit, limit) as f32;
    let rgb = picture.color.iter().map(|pixel| pixel.map(rounded)).collect();
    Image { width: picture.width as usize, height: picture.height as usize, rgb }
}

/// Applies changes, as pairs of name and value, to rules such as [`Rules::PUBLISHED`] or those of [`Rules::of_view`].
///
/// # Errors
/// A name is not in [`RULES`], or a value is invalid for its rule.
pub fn rules(mut rules: Rules, changes: &[(String, String)]) -> Result<Rules, RuleError> {
    changes.iter().try_for_each(|(name, value)| rules.set(name, value))?;
    Ok(rules)
}

/// Lists the rules for the help text: names, and values with the published value and its source.
pub fn rule_list() -> Vec<(String, String)> {
    let row = |rule: &splatgraph_reference::RuleInfo| {
        (rule.name.to_string(), format!("{}; published: {} ({})", rule.values, rule.published, rule.source))
    };
    RULES.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::outputs::NAMES;
    use splatgraph_assets::synth;

    #[test]
    fn an_exact_picture_is_as_large_as_its_camera_and_its_outputs_fit_it() {
        let scene = synth::generate("uniform", 40, 0).unwrap();
        let camera = Camera::framing(&scene, 40, 30);
        let truth = Truth::draw(&scene, &camera, [0.0, 0.0, 1.0], &Rules::PUBLISHED).unwrap();
        let image = truth.image();
        assert_eq!((image.width, image.height), (40, 30));
        assert!(truth.stats.covered > 0.0 && truth.stats.most_contributors > 1, "{}", truth.stats);
        let empty =
            truth.picture.transmittance.iter().position(|t| *t == 1.0).expect("a pixel without splats");
        assert_eq!((image.rgb[empty], truth.picture.contributors[empty]), ([0.0, 0.0, 1.0], 0));
        for (name, _) in NAMES {
            let output = truth.output(name).unwrap();
            assert_eq!((output.name.as_str(), &output.shape[..2]), (name, &[30, 40][..]));
            assert_eq!(output.words.len() as u64, output.shape.iter().product::<u64>(), "{name}");
        }
        assert_eq!(truth.output("transmittance"), None);
    }

    #[test]
    fn rules_are_changed_by_name_and_mistakes_are_told() {
        let pairs = |text: &str| vec![text.split_once('=').map(|(n, v)| (n.into(), v.into())).unwrap()];
        assert_eq!(rules(Rules::PUBLISHED, &pairs("stop=none")).unwrap().stop, None);
        assert!(
            rules(Rules::PUBLISHED, &pairs("stopp=none"))
                .unwrap_err()
                .to_string()
                .contains("did you mean `stop`")
        );
        assert_eq!(rule_list().len(), RULES.len());
    }
}
