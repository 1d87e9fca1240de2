//! Selects splats by a condition on their properties.

use crate::io::losses::splats;
use anyhow::{Result, bail};
use rayon::prelude::*;
use splatgraph_assets::{SH_C0, Scene};
use splatgraph_framework::expr::{Expr, ExprError, Scope};
use splatgraph_framework::ir::Value;
use std::fmt;
use std::str::FromStr;

/// An expression that is true for the splats to keep, such as `opacity > 0.05`: see `splatgraph convert --help`.
#[derive(Clone, Debug)]
pub struct Condition {
    text: String,
    expr: Expr,
}

/// Names in a [`Condition`]: centre in the world, opacity of 0 to 1, standard deviations, band 0, and the index. The
/// names of the scene's further properties are added to them.
const NAMES: [&str; 10] =
    ["x", "y", "z", "opacity", "scale_min", "scale_max", "red", "green", "blue", "index"];

/// Values of the names for one splat.
struct Properties<'a> {
    scene: &'a Scene,
    at: usize,
    /// Value of the name `index`.
    index: u32,
}

impl Scope for Properties<'_> {
    fn get(&self, name: &str) -> Option<Value> {
        let (scene, at) = (self.scene, self.at);
        let axis = |axis: usize| scene.world_position(at)[axis];
        let scale = || scene.scales()[at].map(f64::from);
        let color = |channel: usize| 0.5 + SH_C0 * f64::from(scene.splat(at).sh[channel]);
        Some(Value::Float(match name {
            "x" => axis(0),
            "y" => axis(1),
            "z" => axis(2),
            "opacity" => scene.opacities()[at].into(),
            "scale_min" => scale().into_iter().fold(f64::INFINITY, f64::min),
            "scale_max" => scale().into_iter().fold(0.0, f64::max),
            "red" => color(0),
            "green" => color(1),
            "blue" => color(2),
            "index" => return Some(Value::Int(self.index.into())),
            _ => {
                let property = scene.property_names().iter().position(|own| own == name)?;
                scene.property(at, property).into()
            }
        }))
    }

    fn names(&self) -> Vec<String> {
        NAMES.map(str::to_owned).into_iter().chain(self.scene.property_names().iter().cloned()).collect()
    }
}

/// Formats an error in an expression: the column in `text`, and a suggestion.
fn place(text: &str, error: &ExprError) -> String {
    let column = text.get(..error.start).map_or(1, |before| before.chars().count() + 1);
    let help = error.help.as_ref().map(|help| format!("; {help}")).unwrap_or_default();
    format!("column {column} of `{text}`: {error}{help}")
}

/// A condition that cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ConditionError(String);

impl FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Condition, String> {
        let expr = Expr::parse(text).map_err(|error| place(text, &error))?;
        Ok(Condition { text: text.to_owned(), expr: expr.dividing_as_floats() })
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Condition {
    /// Returns true if a splat satisfies the condition, in which the name `index` has the given value.
    ///
    /// # Errors
    /// The condition has an unknown name or a wrong type, or divides a whole number by zero.
    pub fn holds(&self, scene: &Scene, at: usize, index: u32) -> Result<bool, ConditionError> {
        match self.expr.eval(&Properties { scene, at, index }) {
            Ok(Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(ConditionError(format!(
                "--where: expected a condition, found `{}`, which is {other}",
                self.text
            ))),
            Err(error) => Err(ConditionError(format!("--where: {}", place(&self.text, &error)))),
        }
    }

    /// Copies the splats of a scene that satisfy the condition, in their order. Copies nothing if all do.
    ///
    /// # Errors
    /// The condition cannot be evaluated, no splat satisfies it, or the copy does not fit in memory.
    pub fn kept(&self, scene: Scene) -> Result<Scene> {
        let kept = keep(&scene, "--where", |index| self.holds(&scene, index as usize, index))?;
        Ok(kept.map_or(Ok(None), |kept| scene.selected(&kept).map(Some))?.unwrap_or(scene))
    }
}

/// Lists the splats of a scene for which `keeps` is true; `None` if it is true for all. `options` are those of the
/// command line that select splats, for the error.
///
/// # Errors
/// No splat is left of some, or the error of `keeps`.
pub fn keep(
    scene: &Scene,
    options: &str,
    keeps: impl Fn(u32) -> Result<bool, ConditionError> + Sync,
) -> Result<Option<Vec<u32>>> {
    let indices = (0..scene.count()).into_par_iter();
    let kept: Result<Vec<Option<u32>>, ConditionError> =
        indices.map(|index| Ok(keeps(index)?.then_some(index))).collect();
    let kept: Vec<u32> = kept?.into_iter().flatten().collect();
    if kept.is_empty() && scene.count() > 0 {
        let (count, bounds) = (splats(scene.count().into()), scene.bounds().in_world(scene.offset()));
        bail!(
            "expected {options} to keep a splat, found none kept of {count}, which are in the box {bounds}"
        );
    }
    Ok((kept.len() < scene.count() as usize).then_some(kept))
}
