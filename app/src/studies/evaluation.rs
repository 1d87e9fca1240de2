//! Scores pictures of a scene against photographs of the same views: PSNR, SSIM and FLIP, with their means.

use crate::draw::blind;
use crate::io::image::Image;
use crate::io::output::one_line;
use crate::io::report::text;
use crate::studies::measurement::error::joint_psnr;
use serde::{Deserialize, Serialize};
use splatgraph_reference::Rules;
use splatgraph_reference::metrics::flip::Seen;
use splatgraph_reference::metrics::{self, MetricError, decibels};

/// The scores of a view's picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Name of the photograph, or of the camera.
    pub view: String,
    /// Width of both pictures, in pixels.
    pub width: usize,
    /// Height of both pictures, in pixels.
    pub height: usize,
    /// Peak signal-to-noise ratio in decibels; `None` if the pictures are equal. See [`metrics::Comparison`].
    #[serde(with = "decibels")]
    pub psnr_db: Option<f64>,
    /// Structural similarity, 1 for equal pictures; `None` if the window fits around no pixel that counts.
    pub ssim: Option<f64>,
    /// Mean FLIP of the pictures in 8 bits, 0 for equal pictures.
    pub flip: f64,
    /// Share of the pixels that count; `None` without a mask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counted: Option<f64>,
    /// True if the photograph is grey and the picture is not, so its colours count as errors.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_grey: bool,
    /// Number of splats that the near plane cuts off, if they are a noticeable part of the view.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub too_near: Option<u64>,
}

/// Means of the scores over all views. A mean is `None` if a view lacks the score or is missing, or without views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mean {
    /// Mean of the views' decibels (as in papers), not PSNR of the mean error. Infinite if a view's pictures are equal.
    #[serde(serialize_with = "decibels::serialize_measured")]
    pub psnr_db: Option<f64>,
    /// PSNR of the mean squared error, each view with the same weight. Infinite only if all pictures are equal.
    #[serde(serialize_with = "decibels::serialize_measured")]
    pub pooled_psnr_db: Option<f64>,
    /// Mean of [`Score::ssim`].
    pub ssim: Option<f64>,
    /// Mean of [`Score::flip`].
    pub flip: Option<f64>,
}

/// The scores of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// The scores of each view, in the caller's order.
    pub views: Vec<Score>,
    /// Names of the views that have no scores.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<String>,
    /// The means over the views.
    pub mean: Mean,
}

/// Scores a picture against its photograph. With a mask, only the pixels that are true count.
///
/// A mask has a value per pixel of the photograph, and at least one is true.
///
/// Elsewhere, the picture takes the photograph's pixels, so that all errors come from the pixels that count. PSNR, SSIM
/// (whose map has no border) and FLIP are means over the pixels that count.
///
/// # Errors
/// The sizes differ, or a value is not finite.
pub fn score(
    view: &str,
    picture: &Image,
    photograph: &Image,
    mask: Option<&[bool]>,
) -> Result<Score, MetricError> {
    let masked = mask.map(|mask| {
        assert_eq!(mask.len(), photograph.rgb.len(), "a value per pixel of the photograph");
        let pixels = picture.rgb.iter().zip(&photograph.rgb).zip(mask);
        Image {
            rgb: pixels.map(|((own, other), counts)| if *counts { *own } else { *other }).collect(),
            ..*picture
        }
    });
    let picture = masked.as_ref().unwrap_or(picture);
    metrics::comparable(picture.into(), photograph.into())?;
    let counts = |at: usize| mask.is_none_or(|mask| mask[at]);
    let share = |mask: &[bool]| mask.iter().filter(|counts| **counts).count() as f64 / mask.len() as f64;
    Ok(Score {
        view: view.to_owned(),
        width: picture.width,
        height: picture.height,
        psnr_db: metrics::psnr_over(picture.into(), photograph.into(), &counts),
        ssim: metrics::ssim(picture.into(), photograph.into(), mask),
        flip: Seen::of_8_bits(photograph.into()).flip(&Seen::of_8_bits(picture.into()), mask),
        counted: mask.map(share),
        is_grey: is_grey(photograph) && !is_grey(picture),
        too_near: None,
    })
}

/// Returns true if no pixel has a colour, except for rounding to 8 bits.
fn is_grey(image: &Image) -> bool {
    const ROUNDING: f32 = 1.5 / 255.0;
    image.rgb.iter().all(|[r, g, b]| r.max(*g).max(*b) - r.min(*g).min(*b) <= ROUNDING)
}

/// Returns the mean of values; `None` if a value is missing, or without values.
pub fn mean(values: impl ExactSizeIterator<Item = Option<f64>>) -> Option<f64> {
    let count = values.len();
    values.sum::<Option<f64>>().filter(|_| count > 0).map(|sum| sum / count as f64)
}

/// Computes the PSNR of the mean squared error of views; `None` without views.
pub fn pooled(of_views: impl ExactSizeIterator<Item = Option<f64>>) -> Option<f64> {
    (of_views.len() > 0).then(|| joint_psnr(of_views))
}

impl Mean {
    /// Returns true if the mean of the decibels is infinite although a view has an error.
    pub fn needs_pooled(&self) -> bool {
        self.psnr_db == Some(f64::INFINITY) && self.pooled_psnr_db.is_some_and(f64::is_finite)
    }

    /// Formats the row of a table for [`Mean::pooled_psnr_db`], which has `columns` columns. `None` unless the mean of
    /// the decibels hides the errors.
    pub fn pooled_row(&self, columns: usize) -> Option<Vec<String>> {
        let mut row = vec!["pooled".into(), text::number(self.pooled_psnr_db, 2)];
        row.resize(columns - 1, String::new());
        row.push("PSNR of the mean squared error".into());
        self.needs_pooled().then_some(row)
    }
}

impl Score {
    /// Returns PSNR in decibels, infinite if the pictures are equal.
    fn psnr(&self) -> f64 {
        self.psnr_db.unwrap_or(f64::INFINITY)
    }
}

impl Evaluation {
    /// Computes the means of the scores. A mean is `None` without views, or if a view or its score is missing, because
    /// a partial mean could mislead.
    pub fn new(views: Vec<Score>, missing: Vec<String>) -> Evaluation {
        let mean =
            |of: &dyn Fn(&Score) -> Option<f64>| mean(views.iter().map(of)).filter(|_| missing.is_empty());
        let mean = Mean {
            psnr_db: mean(&|score| Some(score.psnr())),
            pooled_psnr_db: pooled(views.iter().map(|score| score.psnr_db)).filter(|_| missing.is_empty()),
            ssim: mean(&|score| score.ssim),
            flip: mean(&|score| Some(score.flip)),
        };
        Evaluation { views, missing, mean }
    }

    /// Reports that colours of pictures are compared with grey photographs. `None` without such views.
    pub fn grey_note(&self) -> Option<String> {
        let count = self.views.iter().filter(|view| view.is_grey).count();
        let photographs = if count == 1 { "photograph is" } else { "photographs are" };
        (count > 0)
            .then(|| format!("{count} {photographs} grey: the colours of the pictures count as errors"))
    }

    /// Reports views of which the near plane cuts off a noticeable part. `None` without such views.
    pub fn near_note(&self) -> Option<String> {
        let cuts: Vec<_> = self.views.iter().map(|view| view.too_near).collect();
        // No parameter of a graph changes the near plane.
        blind::cut_note(&cuts, &Rules::PUBLISHED)
    }

    /// Formats the scores as a table with a row per view and the mean below.
    pub fn table(&self) -> String {
        let row = |name: &str, psnr: Option<f64>, ssim: Option<f64>, flip: Option<f64>, size: String| {
            let [psnr, ssim, flip] =
                [(psnr, 2), (ssim, 4), (flip, 4)].map(|(value, digits)| text::number(value, digits));
            vec![one_line(name).into_owned(), psnr, ssim, flip, size]
        };
        let rows = self.views.iter().map(|score| {
            let counted = score.counted.map(|share| format!(", {:.1} % counted", 100.0 * share));
            let size = format!("{} x {}{}", score.width, score.height, counted.unwrap_or_default());
            row(&score.view, Some(score.psnr()), score.ssim, Some(score.flip), size)
        });
        let Mean { psnr_db, ssim, flip, .. } = self.mean;
        let views = match (self.views.len(), self.missing.len()) {
            (1, 0) => "1 view".into(),
            (views, 0) => format!("{views} views"),
            (views, missing) => format!("{views} of {} views", views + missing),
        };
        let mean = row("mean", psnr_db, ssim, flip, views);
        let head = ["view", "PSNR dB", "SSIM", "FLIP", "size"];
        text::table(head, rows.chain([mean]).chain(self.mean.pooled_row(head.len())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(value: f32) -> Image {
        Image { width: 12, height: 12, rgb: vec![[value; 3]; 144] }
    }

    #[test]
    fn the_mean_is_of_decibels_and_a_view_without_a_number_leaves_none() {
        let scores = [
            score("a.jpg", &grey(0.5), &grey(0.6), None).unwrap(),
            score("b.jpg", &grey(0.5), &grey(0.51), None).unwrap(),
        ];
        let all = Evaluation::new(scores.to_vec(), Vec::new());
        assert!((all.mean.psnr_db.unwrap() - 30.0).abs() < 1e-4, "{all:?}");
        let text = all.table();
        assert!(!text.contains("pooled"), "no view is equal: {text}");
        assert!(
            text.contains("a.jpg    20.00") && text.contains("mean     30.00") && text.ends_with("2 views\n"),
            "{text}"
        );
        let equal = score("c.jpg", &grey(0.5), &grey(0.5), None).unwrap();
        let all = Evaluation::new(vec![scores[0].clone(), equal], Vec::new());
        assert_eq!((all.mean.psnr_db, all.views[1].flip), (Some(f64::INFINITY), 0.0));
        let pooled = 20.0 + 10.0 * 2f64.log10();
        assert!(all.mean.pooled_psnr_db.is_some_and(|db| (db - pooled).abs() < 1e-4), "{all:?}");
        let text = all.table();
        assert!(
            text.contains("c.jpg       inf  1.0000  0.0000") && text.contains("mean        inf"),
            "{text}"
        );
        assert!(text.contains("pooled    23.01                  PSNR of the mean squared error"), "{text}");
        let json = serde_json::to_value(&all).unwrap();
        assert_eq!((&json["views"][1]["psnr_db"], &json["mean"]["psnr_db"]), (&"inf".into(), &"inf".into()));
        let part = Evaluation::new(scores.to_vec(), vec!["d.jpg".into()]);
        assert_eq!(part.mean, Mean { psnr_db: None, pooled_psnr_db: None, ssim: None, flip: None });
        assert!(part.table().contains("mean         -       -       -  2 of 3 views"), "{}", part.table());
    }

    #[test]
    fn scores_of_a_mask_are_those_of_the_pixels_that_count() {
        // Equal errors in all pixels: the mask changes nothing but the share, whatever is drawn elsewhere.
        let (mut drawn, photograph) = (grey(0.6), grey(0.5));
        let mask: Vec<bool> = (0..144).map(|at| at % 12 < 9).collect();
        let whole = score("a", &drawn, &photograph, None).unwrap();
        drawn
            .rgb
            .iter_mut()
            .zip(&mask)
            .filter(|(_, counts)| !**counts)
            .for_each(|(pixel, _)| *pixel = [f32::NAN; 3]);
        let part = score("a", &drawn, &photograph, Some(&mask)).unwrap();
        assert!((part.psnr_db.unwrap() - whole.psnr_db.unwrap()).abs() < 1e-9, "{part:?}");
        assert_eq!(part.counted, Some(0.75));
        let same = score("a", &photograph, &photograph, Some(&mask)).unwrap();
        assert_eq!((same.psnr_db, same.ssim, same.flip), (None, Some(1.0), 0.0));
        let border: Vec<bool> = (0..144).map(|at| at < 9).collect();
        let of_border = score("a", &drawn, &photograph, Some(&border)).unwrap();
        assert_eq!(of_border.ssim, None, "no window has its centre there");
    }

    #[test]
    fn scores_of_a_thin_mask_stay_within_their_ranges() {
        let (drawn, photograph) = (grey(1.0), grey(0.0));
        let dot: Vec<bool> = (0..144).map(|at| at == 6 * 12 + 6).collect();
        let found = score("a", &drawn, &photograph, Some(&dot)).unwrap();
        assert!(found.psnr_db == Some(0.0) && (0.1..1.0).contains(&found.flip), "{found:?}");
        assert!(found.ssim.is_some_and(|ssim| (0.0..0.1).contains(&ssim)), "{found:?}");
    }
}
