//! Draws pictures together with the order in which their splats were drawn.
//!
//! A wrong picture usually comes from a wrong order, so studies capture both. The order is read from the buffer that a
//! graph binds as `Order`, after the last pass that binds it. The distance between two orders is Kendall's tau
//! distance: the number of pairs of splats that they order differently.

use crate::draw::session::{FrameOptions, PixelsError, Session, SessionError, image_of};
use crate::io::image::Image;
use splatgraph_api::Inspect;
use splatgraph_assets::Camera;
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::Plan;
use splatgraph_reference::inversions;

/// A picture, with the order of its splats.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The picture, not clamped.
    pub image: Image,
    /// Indices of the visible splats in the graph's order buffer: near to far if the graph sorts. `None` if the graph
    /// has no such buffer or no statistic `visible`, or if a later pass uses the buffer.
    pub order: Option<Vec<u32>>,
    /// Statistics of the graph, such as `visible` and `drawn`.
    pub counts: Vec<(String, u32)>,
}

/// Draws a frame of a prepared session, and reads its picture and order back.
///
/// # Errors
/// See [`Session::submit`] and [`Session::wait`]; also, the graph's output has no colours.
pub fn take(session: &mut Session, camera: &Camera) -> Result<Capture, SessionError> {
    let plan = session.plan().ok_or(SessionError::NotPrepared)?;
    let inspect: Vec<Inspect> = order_of(plan).into_iter().collect();
    let options = FrameOptions { read_output: true, inspect, ..FrameOptions::default() };
    let frame = session.submit(camera, &options)?;
    let result = session.wait(frame)?;
    let image = image_of(result.output.as_ref().ok_or(PixelsError::Missing)?)?;
    let visible = result.stats.iter().find(|(name, _)| name == "visible").map(|(_, count)| *count as usize);
    let word = |bytes: &[u8]| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let order = match (result.inspected.first(), visible) {
        (Some(bytes), Some(visible)) => Some(bytes.chunks_exact(4).take(visible).map(word).collect()),
        _ => None,
    };
    Ok(Capture { image, order, counts: result.stats })
}

/// Finds the buffer with the order of the splats, and the last pass that binds it as `Order`.
///
/// `None` if no pass binds it, or if a later pass uses the buffer, and so may overwrite the order before it is read.
fn order_of(plan: &Plan) -> Option<Inspect> {
    let steps = || plan.frame.iter().rev().copied();
    let order = |pass: PassId| plan.pass(pass).bindings.iter().find(|binding| binding.name == "Order");
    let (after, resource) = steps().find_map(|pass| Some((pass, order(pass)?.resource)))?;
    let binds = |pass: &PassId| plan.pass(*pass).bindings.iter().any(|binding| binding.resource == resource);
    (steps().find(binds) == Some(after)).then_some(Inspect { resource, after })
}

/// Counts the pairs of splats in `given` that `truth` orders differently.
///
/// `None` if `truth` lacks a splat of `given`, or if an order contains a splat twice.
pub fn wrong_pairs(truth: &[u32], given: &[u32]) -> Option<u64> {
    inversions(&only(truth, given), given)
}

/// Counts the pairs of splats that change places between two orders. Splats in only one order are ignored.
///
/// `None` if an order contains a splat twice.
pub fn order_changes(before: &[u32], after: &[u32]) -> Option<u64> {
    let kept = only(before, after);
    inversions(&kept, &only(after, &kept))
}

/// Keeps the splats of `order` that `of` contains.
pub fn only(order: &[u32], of: &[u32]) -> Vec<u32> {
    let mut held = vec![false; order.iter().max().map_or(0, |most| *most as usize + 1)];
    for index in of {
        if let Some(held) = held.get_mut(*index as usize) {
            *held = true;
        }
    }
    order.iter().copied().filter(|index| held[*index as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_counted_among_the_splats_that_both_orders_hold() {
        assert_eq!(wrong_pairs(&[4, 3, 2, 1, 0], &[1, 3, 4]), Some(3));
        assert_eq!(wrong_pairs(&[4, 3, 2, 1, 0], &[4, 2]), Some(0));
        assert_eq!(wrong_pairs(&[1, 2], &[1, 9]), None, "9 has no place in the truth");
        assert_eq!(wrong_pairs(&[1, 2], &[1, 1]), None);
        // 7 disappears and 8 appears. Among 1, 2 and 3, one pair changes places.
        assert_eq!(order_changes(&[1, 7, 2, 3], &[2, 1, 8, 3]), Some(1));
        assert_eq!(order_changes(&[1, 2, 3], &[3, 2, 1]), Some(3));
        assert_eq!(order_changes(&[], &[1]), Some(0));
    }
}
