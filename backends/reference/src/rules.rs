//! Defines the rules of the exact renderer. Each can be changed by name.
//!
//! [`Rules::PUBLISHED`] is the behaviour of the rasteriser (graphdeco-inria/diff-gaussian-rasterization, commit
//! 59f5f77). The table [`RULES`] lists names, published values and sources; [`Rules::set`] changes a rule by its name.

use serde::Serialize;
use splatgraph_assets::{Camera, Filter, Scene, SortKey};
use std::str::FromStr;

/// The rules of the exact renderer. Lengths on the image are in pixels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rules {
    /// Near plane, in world units: splats and mesh at this view depth or nearer are not drawn. Cameras that see behind
    /// themselves cull splats by the distance from the camera instead, if it is the sort key.
    pub near: f64,
    /// Offset added to the pixel position of every centre, in x and y. Pixels are sampled at integer positions.
    pub pixel_offset: f64,
    /// Limit of x / z and y / z in the Jacobian of a pinhole: their distance from the picture's middle, as a multiple
    /// of tan(fov / 2). `None` for no limit.
    pub jacobian_clamp: Option<f64>,
    /// The filter that widens the 2D covariance.
    pub low_pass: LowPass,
    /// The pixels at which a splat is evaluated.
    pub extent: Extent,
    /// Highest band of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// The direction in which colours are evaluated.
    pub sh_direction: ShDirection,
    /// Minimum of each channel of a splat's colour; `None` for no minimum.
    pub color_floor: Option<f64>,
    /// Maximum of each channel of a splat's colour; `None` for no maximum.
    pub color_ceiling: Option<f64>,
    /// Sort key of the splats: view depth or distance.
    pub key_of: KeyOf,
    /// The precision of depths and distances for culling and sorting.
    pub depth: Depth,
    /// The order of splats with equal depths.
    pub ties: Ties,
    /// The place at which depths are compared: the splats' centres, or each pixel.
    pub order: Order,
    /// Minimum alpha of a fragment; fragments below it are skipped.
    pub alpha_floor: f64,
    /// Maximum alpha of a fragment.
    pub alpha_cap: f64,
    /// Minimum transmittance: blending stops before the splat that would bring it below; `None` never stops.
    pub stop: Option<f64>,
}

impl Rules {
    /// The rules of the published rasteriser.
    ///
    /// Its f32 constants are widened, not rounded: 0.99, for instance, is 0.9900000095, so that two splats at the cap
    /// bring the transmittance below the stop, as in the rasteriser.
    pub const PUBLISHED: Rules = Rules {
        near: 0.2f32 as f64,
        pixel_offset: 0.0,
        jacobian_clamp: Some(1.3f32 as f64),
        low_pass: LowPass::Dilate(0.3f32 as f64),
        extent: Extent::Tiles,
        sh_degree: 3,
        sh_direction: ShDirection::FromCamera,
        color_floor: Some(0.0),
        color_ceiling: None,
        key_of: KeyOf::Depth,
        depth: Depth::F32,
        ties: Ties::Ascending,
        order: Order::Centre,
        alpha_floor: (1.0f32 / 255.0) as f64,
        alpha_cap: 0.99f32 as f64,
        stop: Some(1e-4f32 as f64),
    };

    /// Returns the published rules, adapted to the scene's tags `low_pass` and `key_of`.
    pub fn of(scene: &Scene) -> Rules {
        let notes = scene.notes();
        Rules { low_pass: notes.low_pass.into(), key_of: notes.key_of.into(), ..Rules::PUBLISHED }
    }

    /// Returns the published rules, adapted to the scene ([`Rules::of`]) and to the camera. Splats are sorted by
    /// distance if it [sees behind itself](splatgraph_assets::Projection::sees_behind), and by view depth if it is
    /// orthographic.
    pub fn of_view(scene: &Scene, camera: &Camera) -> Rules {
        let key_of = camera.projection.sort_key(scene.notes().key_of).into();
        Rules { key_of, ..Rules::of(scene) }
    }

    /// Changes the rule of this name (see [`RULES`]). Numbers are rounded to f32, the rasteriser's type.
    ///
    /// # Errors
    /// Returns an error if the name is unknown or the value invalid.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), RuleError> {
        let info = RULES.iter().find(|rule| rule.name == name).ok_or_else(|| RuleError::unknown(name))?;
        self.assign(name, value).ok_or_else(|| RuleError::Value {
            name: info.name,
            expected: info.values,
            found: value.to_owned(),
        })
    }

    fn assign(&mut self, name: &str, value: &str) -> Option<()> {
        match name {
            "near" => self.near = number(value)?,
            "pixel_offset" => self.pixel_offset = number(value)?,
            "jacobian_clamp" => self.jacobian_clamp = optional(value)?,
            "low_pass" => self.low_pass = value.parse().ok()?,
            "extent" => self.extent = value.parse().ok()?,
            "sh_degree" => self.sh_degree = value.parse().ok().filter(|degree| *degree <= 3)?,
            "sh_direction" => {
                self.sh_direction = choice(
                    value,
                    &[("from_camera", ShDirection::FromCamera), ("to_camera", ShDirection::ToCamera)],
                )?;
            }
            "color_floor" => self.color_floor = optional(value)?,
            "color_ceiling" => self.color_ceiling = optional(value)?,
            "key_of" => {
                self.key_of = choice(value, &[("depth", KeyOf::Depth), ("distance", KeyOf::Distance)])?;
            }
            "depth" => self.depth = choice(value, &[("f32", Depth::F32), ("f64", Depth::F64)])?,
            "ties" => {
                self.ties =
                    choice(value, &[("ascending", Ties::Ascending), ("descending", Ties::Descending)])?;
            }
            "order" => {
                self.order = choice(value, &[("centre", Order::Centre), ("pixel", Order::Pixel)])?;
            }
            "alpha_floor" => self.alpha_floor = number(value)?,
            "alpha_cap" => self.alpha_cap = number(value)?,
            "stop" => self.stop = optional(value)?,
            _ => return None,
        }
        Some(())
    }
}

/// The anti-aliasing filter. It widens every splat, for the sake of those smaller than a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum LowPass {
    /// No filter.
    None,
    /// Adds this variance, in square pixels, to the diagonal of the 2D covariance.
    Dilate(f64),
    /// Dilates as `Dilate` does, and multiplies the opacity by sqrt(det / det'), the determinants of the 2D covariance
    /// before and after, to conserve the splat's energy. Source: the 2D Mip filter of Mip-Splatting, Yu et al., CVPR
    /// 2024.
    Compensated(f64),
}

impl From<Filter> for LowPass {
    fn from(filter: Filter) -> LowPass {
        match filter {
            Filter::Dilated => Rules::PUBLISHED.low_pass,
            Filter::Compensated => LowPass::Compensated(Rules::PUBLISHED.low_pass.variance()),
            Filter::Mip => LowPass::Compensated(0.1f32.into()),
        }
    }
}

impl FromStr for LowPass {
    type Err = ();

    fn from_str(text: &str) -> Result<LowPass, ()> {
        let parsed = match text.split_once('*') {
            None if text == "none" => Some(LowPass::None),
            None => number(text).map(LowPass::Dilate),
            Some((variance, "compensated")) => number(variance).map(LowPass::Compensated),
            Some(_) => None,
        };
        parsed.filter(|filter| filter.variance() >= 0.0).ok_or(())
    }
}

impl LowPass {
    /// Returns the variance that the filter adds to the diagonal, in square pixels.
    pub fn variance(self) -> f64 {
        match self {
            LowPass::None => 0.0,
            LowPass::Dilate(variance) | LowPass::Compensated(variance) => variance,
        }
    }
}

/// The pixels at which a splat is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Extent {
    /// Every pixel of the 16 x 16 tiles that a square around the centre touches. Half its side is `ceil(3 sqrt(l))`,
    /// with `l` the larger eigenvalue of the 2D covariance, computed with a discriminant of at least 0.1.
    Tiles,
    /// Every pixel within this many standard deviations of the centre.
    Sigma(f64),
    /// Every pixel of the image.
    Unbounded,
}

impl FromStr for Extent {
    type Err = ();

    fn from_str(text: &str) -> Result<Extent, ()> {
        match text {
            "tiles" => Ok(Extent::Tiles),
            "unbounded" => Ok(Extent::Unbounded),
            _ => number(text).filter(|sigma| *sigma > 0.0).map(Extent::Sigma).ok_or(()),
        }
    }
}

/// The direction in which spherical harmonics are evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ShDirection {
    /// From the camera to the splat.
    FromCamera,
    /// From the splat to the camera.
    ToCamera,
}

/// The sort key of the splats; also the content of depth outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum KeyOf {
    /// The view depth.
    Depth,
    /// The distance from the camera.
    Distance,
}

impl From<SortKey> for KeyOf {
    fn from(key: SortKey) -> KeyOf {
        match key {
            SortKey::Depth => KeyOf::Depth,
            SortKey::Distance => KeyOf::Distance,
        }
    }
}

/// The precision of sort keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Depth {
    /// View depths are computed in f32, in the rasteriser's order of operations. Distances, and view depths of
    /// positions for which f32 is too coarse, are computed in f64 and then rounded to f32.
    F32,
    /// Computed in f64, for scenes with depths that f32 cannot distinguish.
    F64,
}

/// The order of splats of equal depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Ties {
    /// The splat with the lower index counts as nearer.
    Ascending,
    /// The splat with the higher index counts as nearer.
    Descending,
}

/// The place at which the depths of splats are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Order {
    /// The splats' centres, so that the whole picture has one order. It changes suddenly when the camera moves.
    Centre,
    /// Each pixel: a splat's depth is that of its largest density along the pixel's ray, in the affine approximation
    /// that also gives its ellipse. Source: StopThePop, Radl et al., SIGGRAPH 2024, section 4, which uses the exact ray.
    Pixel,
}

/// A rule's name, published value and source.
#[derive(Clone, Copy, Debug)]
pub struct RuleInfo {
    /// The name for [`Rules::set`].
    pub name: &'static str,
    /// The accepted values, described in words.
    pub values: &'static str,
    /// The value in [`Rules::PUBLISHED`].
    pub published: &'static str,
    /// The file and the function of the rasteriser that define the rule.
    pub source: &'static str,
}

/// Every rule that can be changed.
pub const RULES: [RuleInfo; 16] = [
    rule("near", "a number", "0.2", "auxiliary.h, in_frustum"),
    rule("pixel_offset", "a number", "0", "auxiliary.h, ndc2Pix"),
    rule("jacobian_clamp", "a number or `none`", "1.3", "forward.cu, computeCov2D"),
    rule(
        "low_pass",
        "`none`, a variance, or a variance and `*compensated`",
        "0.3",
        "forward.cu, computeCov2D",
    ),
    rule(
        "extent",
        "`tiles`, `unbounded`, or a number of standard deviations",
        "tiles",
        "auxiliary.h, getRect",
    ),
    rule("sh_degree", "an integer from 0 to 3", "3", "forward.cu, computeColorFromSH"),
    rule("sh_direction", "`from_camera` or `to_camera`", "from_camera", "forward.cu, computeColorFromSH"),
    rule("color_floor", "a number or `none`", "0", "forward.cu, computeColorFromSH"),
    rule("color_ceiling", "a number or `none`", "none", "forward.cu, computeColorFromSH"),
    rule("key_of", "`depth` or `distance`", "depth", "auxiliary.h, in_frustum"),
    rule("depth", "`f32` or `f64`", "f32", "auxiliary.h, transformPoint4x3"),
    rule("ties", "`ascending` or `descending`", "ascending", "rasterizer_impl.cu, duplicateWithKeys"),
    rule("order", "`centre` or `pixel`", "centre", "rasterizer_impl.cu, duplicateWithKeys"),
    rule("alpha_floor", "a number", "0.00392156862745098", "forward.cu, renderCUDA"),
    rule("alpha_cap", "a number", "0.99", "forward.cu, renderCUDA"),
    rule("stop", "a number or `none`", "0.0001", "forward.cu, renderCUDA"),
];

const fn rule(
    name: &'static str,
    values: &'static str,
    published: &'static str,
    source: &'static str,
) -> RuleInfo {
    RuleInfo { name, values, published, source }
}

/// The error of an invalid change of a rule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RuleError {
    /// No rule has this name.
    #[error("there is no rule `{name}`; did you mean `{nearest}`?")]
    Unknown {
        /// The name given.
        name: String,
        /// The rule with the most similar name.
        nearest: &'static str,
    },
    /// The rule does not accept this value.
    #[error("rule `{name}`: expected {expected}, found `{found}`")]
    Value {
        /// Name of the rule.
        name: &'static str,
        /// The accepted values.
        expected: &'static str,
        /// The value given.
        found: String,
    },
}

impl RuleError {
    fn unknown(name: &str) -> RuleError {
        let likeness = |rule: &&RuleInfo| (strsim::jaro_winkler(name, rule.name) * 1e6) as u64;
        let nearest = RULES.iter().max_by_key(likeness).map_or("", |rule| rule.name);
        RuleError::Unknown { name: name.to_owned(), nearest }
    }
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|v: &f32| v.is_finite()).map(f64::from)
}

fn optional(text: &str) -> Option<Option<f64>> {
    if text == "none" { Some(None) } else { number(text).map(Some) }
}

fn choice<T: Copy>(text: &str, of: &[(&str, T)]) -> Option<T> {
    of.iter().find(|(name, _)| *name == text).map(|(_, value)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_value_of_every_rule_is_what_the_table_says() {
        for rule in RULES {
            let mut rules = Rules::PUBLISHED;
            rules.set(rule.name, rule.published).unwrap();
            assert_eq!(rules, Rules::PUBLISHED, "{}", rule.name);
        }
    }

    #[test]
    fn a_changed_rule_changes_its_field() {
        let mut rules = Rules::PUBLISHED;
        for (name, value) in
            [("low_pass", "0.3*compensated"), ("extent", "3"), ("stop", "none"), ("ties", "descending")]
        {
            rules.set(name, value).unwrap();
        }
        assert_eq!(rules.low_pass, LowPass::Compensated(f64::from(0.3f32)));
        assert_eq!((rules.extent, rules.stop, rules.ties), (Extent::Sigma(3.0), None, Ties::Descending));
    }

    #[test]
    fn errors_offer_the_nearest_name_and_say_which_values_are_expected() {
        let said =
            |name: &str, value: &str| Rules::PUBLISHED.clone().set(name, value).unwrap_err().to_string();
        assert_eq!(said("lowpass", "1"), "there is no rule `lowpass`; did you mean `low_pass`?");
        assert_eq!(said("depth", "f16"), "rule `depth`: expected `f32` or `f64`, found `f16`");
        for (name, value) in
            [("near", "NaN"), ("low_pass", "-1"), ("extent", "0"), ("sh_degree", "4"), ("stop", "")]
        {
            assert!(said(name, value).contains("expected"), "{name}={value}");
        }
    }
}
