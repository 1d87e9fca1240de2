//! Computes the transforms of prims from their attributes `xformOp:...`.

use super::layer::{Layer, Value};
use crate::error::SceneError;
use glam::{DMat4, DQuat, DVec3};

/// Entry of `xformOpOrder` that discards the transforms of the ancestors.
const RESET: &str = "!resetXformStack!";

/// Prefix of an entry whose operation is inverted.
const INVERSE: &str = "!invert!";

/// Computes the transform of each prim to the world. A prim's operations are applied from the last to the first. Fails
/// for an unknown operation, or one without numbers.
pub(super) fn world(layer: &Layer) -> Result<Vec<DMat4>, SceneError> {
    let mut worlds = Vec::with_capacity(layer.prims.len());
    for (index, prim) in layer.prims.iter().enumerate() {
        let mut world: DMat4 = prim.parent.map_or(DMat4::IDENTITY, |parent| worlds[parent]);
        let order = match layer.value(index, "xformOpOrder")? {
            Some(Value::Words(order)) => order.as_slice(),
            _ => &[],
        };
        for name in order {
            if name == RESET {
                world = DMat4::IDENTITY;
                continue;
            }
            let plain = name.strip_prefix(INVERSE).unwrap_or(name);
            let operation = operation(layer, index, plain)?;
            world *= if plain == name { operation } else { operation.inverse() };
        }
        worlds.push(world);
    }
    Ok(worlds)
}

/// Reads an operation as a matrix for column vectors.
fn operation(layer: &Layer, prim: usize, name: &str) -> Result<DMat4, SceneError> {
    let Some(Value::Numbers(numbers)) = layer.value(prim, name)? else {
        return Err(layer.wrong(prim, name, "expected numbers, which xformOpOrder names, found none".into()));
    };
    let kind = name.split(':').nth(1).unwrap_or_default();
    let angle = |axis: DVec3, degrees: f64| DMat4::from_axis_angle(axis, degrees.to_radians());
    let axis = |letter: char| match letter {
        'X' => Some(0),
        'Y' => Some(1),
        'Z' => Some(2),
        _ => None,
    };
    let axes = kind.strip_prefix("rotate").map(|axes| axes.chars().map(axis).collect::<Option<Vec<_>>>());
    Ok(match (kind, numbers.as_slice(), axes.flatten().as_deref()) {
        ("translate", [x, y, z], _) => DMat4::from_translation(DVec3::new(*x, *y, *z)),
        ("scale", [x, y, z], _) => DMat4::from_scale(DVec3::new(*x, *y, *z)),
        ("orient", [w, x, y, z], _) if [w, x, y, z].iter().any(|value| **value != 0.0) => {
            DMat4::from_quat(DQuat::from_xyzw(*x, *y, *z, *w).normalize())
        }
        // USD stores rows for row vectors, which are columns for column vectors.
        ("transform", matrix, _) if matrix.len() == 16 => DMat4::from_cols_slice(matrix),
        (_, [degrees], Some([axis])) => angle(DVec3::AXES[*axis], *degrees),
        // The letters are in the order of the rotations. The angles are always in the order x, y, z.
        (_, [_, _, _], Some(axes @ [_, _, _])) => {
            axes.iter().fold(DMat4::IDENTITY, |matrix, at| angle(DVec3::AXES[*at], numbers[*at]) * matrix)
        }
        _ => {
            let text = format!("expected a transform of a known kind, found {} numbers", numbers.len());
            return Err(layer.wrong(prim, name, text));
        }
    })
}
