//! Reads and writes the tags in the comments of a PLY header.
//!
//! | comment | meaning | written by |
//! |---|---|---|
//! | `SplatRenderMode: default`, `mip` or `2dgs` | the training's filter, or 2D Gaussians | Brush, splat-transform |
//! | `antialiased 0` or `1` | gsplat's filter, off or on | Postshot |
//! | `vertical axis: X Y Z` | the direction up | Brush |
//! | `vertical axis: y` or `x` | up is -y or +x, as Brush reads it | Brush |
//! | `vertical axis: z` | up is +z, to which nerfstudio turns captures; Brush reads -z | nerfstudio |
//! | `vertical axis: -z`, or another axis with its sign | the direction up | people |
//!
//! Case is ignored. If several comments set the same tag, the last one counts.

use crate::error::SceneError;
use crate::scene::{FileNotes, Filter, Scene};
use glam::DVec3;

/// Reads the direction up from the words of its tag; `None` if they name no direction.
fn up(words: &[&str]) -> Option<[f64; 3]> {
    match words {
        ["x" | "+x"] => Some([1.0, 0.0, 0.0]),
        ["-x"] => Some([-1.0, 0.0, 0.0]),
        ["y" | "-y"] => Some([0.0, -1.0, 0.0]),
        ["+y"] => Some([0.0, 1.0, 0.0]),
        ["z" | "+z"] => Some([0.0, 0.0, 1.0]),
        ["-z"] => Some([0.0, 0.0, -1.0]),
        [x, y, z] => {
            let [x, y, z] = [x, y, z].map(|word| word.parse().unwrap_or(f64::NAN));
            DVec3::new(x, y, z).try_normalize().map(DVec3::into)
        }
        _ => None,
    }
}

/// Reads the words of a comment. Returns false if it is no tag; fails if the splats are 2D Gaussians.
pub(super) fn read(comment: &[&str], notes: &mut FileNotes) -> Result<bool, SceneError> {
    let words: Vec<String> = comment.iter().map(|word| word.to_ascii_lowercase()).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["splatrendermode:", "default"] | ["antialiased", "0"] => notes.low_pass = Filter::Dilated,
        ["splatrendermode:", "mip"] => notes.low_pass = Filter::Mip,
        ["splatrendermode:", "2dgs"] => return Err(SceneError::SURFELS),
        ["antialiased", "1"] => notes.low_pass = Filter::Compensated,
        ["vertical", "axis:", axis @ ..] => match up(axis) {
            Some(up) => notes.up = Some(up),
            None => return Ok(false),
        },
        _ => return Ok(false),
    }
    Ok(true)
}

/// Formats a scene's tags as comments, followed by the scene's other comments. PLY can store the filter and the up
/// direction.
pub(super) fn comments(scene: &Scene) -> String {
    let notes = scene.notes();
    let filter = match notes.low_pass {
        Filter::Dilated => "",
        Filter::Compensated => "comment antialiased 1\n",
        Filter::Mip => "comment SplatRenderMode: mip\n",
    };
    let up = notes.up.map(|[x, y, z]| format!("comment vertical axis: {x} {y} {z}\n")).unwrap_or_default();
    let others: String = scene.header_comments().iter().map(|line| format!("{line}\n")).collect();
    format!("{filter}{up}{others}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{says, splat, written};
    use crate::{QUIET, SceneFormat};

    fn notes(comments: &[&str]) -> Result<FileNotes, SceneError> {
        let mut notes = FileNotes::default();
        comments.iter().try_for_each(|text| {
            read(&text.split_ascii_whitespace().collect::<Vec<_>>(), &mut notes).map(drop)
        })?;
        Ok(notes)
    }

    #[test]
    fn the_last_comment_of_a_kind_counts_and_other_comments_say_nothing() {
        let filter = |comments: &[&str]| notes(comments).unwrap().low_pass;
        assert_eq!(filter(&["splatrendermode: MIP", "made by hand"]), Filter::Mip);
        assert_eq!(filter(&["SplatRenderMode: mip", "antialiased 1"]), Filter::Compensated);
        assert_eq!(filter(&["antialiased 1", "SplatRenderMode: default"]), Filter::Dilated);
        let down = [0.0, 0.0, -1.0];
        for (words, up) in [("y", [0.0, -1.0, 0.0]), ("Z", [0.0, 0.0, 1.0]), ("0 0 -2", down), ("-Z", down)] {
            let tag = format!("Vertical Axis: {words}");
            assert_eq!(notes(&[&tag, "vertical axis: q", "vertical axis: 0 0 0"]).unwrap().up, Some(up));
        }
        let is_tag = |words: &[&str]| read(words, &mut FileNotes::default()).unwrap();
        assert!(is_tag(&["vertical", "axis:", "+y"]) && !is_tag(&["vertical", "axis:", "z", "up"]));
        says(notes(&["SplatRenderMode: 2dgs"]).unwrap_err(), "2D Gaussians (2DGS)");
    }

    #[test]
    fn a_file_without_the_third_scale_is_named_as_2d() {
        let bytes = written(&Scene::generate(3, 0, splat), SceneFormat::Ply);
        let text = String::from_utf8_lossy(&bytes).replace("scale_2", "other_2");
        says(Scene::parse(text.as_bytes(), QUIET).unwrap_err(), "2D Gaussians (2DGS)");
    }
}
