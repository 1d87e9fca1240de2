//! Finds the areas of a window that must be redrawn: its damage.
//!
//! The view is drawn in every frame, because its pictures usually changed. Around it are four strips: above, left of,
//! right of and below it. In each strip, one rectangle is redrawn: the bounds of the meshes that were added, removed or
//! changed. So areas never overlap, and each pixel is blended once.

use super::Composition;
use super::textures::Texture;
use egui::epaint::Mesh;
use egui::{Pos2, Rect, Vec2, pos2};
use std::sync::Arc;

/// Returns true if the bounds of a triangle show that it covers no pixel of an area.
pub fn misses(area: Rect, corners: [Pos2; 3]) -> bool {
    let Rect { min, max } = Rect::from_points(&corners);
    max.x <= area.min.x || min.x >= area.max.x || max.y <= area.min.y || min.y >= area.max.y
}

/// Scales a rectangle about the origin, by a factor for each axis.
pub fn scaled(Rect { min, max }: Rect, scale: Vec2) -> Rect {
    let scaled = |corner: Pos2| (corner.to_vec2() * scale).to_pos2();
    Rect { min: scaled(min), max: scaled(max) }
}

/// A mesh of the interface, and the pixels that it may change.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Rectangle in pixels of the window, its bottom right corner exclusive, like all rectangles here.
    pub bounds: Rect,
    pub texture: Texture,
    pub mesh: Mesh,
    pixels_per_point: Vec2,
}

impl Piece {
    pub fn new(mesh: Mesh, clip: Rect, texture: Texture, pixels_per_point: Vec2) -> Piece {
        let Rect { min, max } = scaled(mesh.calc_bounds(), pixels_per_point);
        // Rounded outwards: a pixel that is partly covered changes, too.
        let bounds = Rect::from_min_max(min.floor(), max.ceil()).intersect(clip);
        Piece { bounds, texture, mesh, pixels_per_point }
    }

    /// Returns the position of each vertex, in pixels of the window.
    pub fn positions(&self) -> Vec<Pos2> {
        let scaled = |pos: Pos2| (pos.to_vec2() * self.pixels_per_point).to_pos2();
        self.mesh.vertices.iter().map(|vertex| scaled(vertex.pos)).collect()
    }
}

impl PartialEq for Piece {
    fn eq(&self, other: &Piece) -> bool {
        let [a, b] = [self, other].map(|piece| bytemuck::cast_slice::<_, u8>(&piece.mesh.vertices));
        (self.bounds, self.texture, self.pixels_per_point)
            == (other.bounds, other.texture, other.pixels_per_point)
            && self.mesh.indices == other.mesh.indices
            && a == b
    }
}

/// State of a user interface over a composition, for comparison with the next frame's.
#[derive(Clone, Debug)]
pub struct Interface {
    window: [u32; 2],
    view: [u32; 4],
    texels: Arc<Vec<u8>>,
    pub pieces: Vec<Piece>,
}

impl Interface {
    pub fn new(under: &Composition, texels: Arc<Vec<u8>>, pieces: Vec<Piece>) -> Interface {
        let Composition { window, view, .. } = *under;
        Interface { window, view, texels, pieces }
    }

    /// Returns true if `other` has the same layout, texels and meshes, and so draws the same pixels.
    pub fn is(&self, other: &Interface) -> bool {
        self.is_placed_as(other) && self.pieces == other.pieces
    }

    fn is_placed_as(&self, other: &Interface) -> bool {
        (other.window, other.view) == (self.window, self.view) && Arc::ptr_eq(&other.texels, &self.texels)
    }

    /// Lists the areas to redraw in a window that shows `former`, and whether each needs its background. Everything is
    /// redrawn if `former` is `None`, or has another layout or other texels.
    pub fn areas(&self, former: Option<&Interface>) -> Vec<(Rect, bool)> {
        let [width, height] = self.window.map(|side| side as f32);
        let [left, top, across, down] = self.view.map(|length| length as f32);
        let (left, top) = (left.min(width), top.min(height));
        let (right, bottom) = ((left + across).min(width), (top + down).min(height));
        let strips = [
            (pos2(0.0, 0.0), pos2(width, top)),
            (pos2(0.0, top), pos2(left, bottom)),
            (pos2(right, top), pos2(width, bottom)),
            (pos2(0.0, bottom), pos2(width, height)),
        ];
        let strips = strips.map(|(min, max)| Rect { min, max });
        // Pieces can only be compared if view and textures are unchanged.
        let known = former.filter(|former| self.is_placed_as(former));
        let damage = strips.map(|strip| match known {
            None => strip,
            Some(former) => {
                let changed =
                    changed(&former.pieces, &self.pieces).map(|piece| piece.bounds.intersect(strip));
                changed.filter(Rect::is_positive).fold(Rect::NOTHING, Rect::union)
            }
        });
        let view = Rect { min: pos2(left, top), max: pos2(right, bottom) };
        let all = damage.into_iter().map(|area| (area, true)).chain([(view, false)]);
        all.filter(|(area, _)| area.is_positive()).collect()
    }
}

/// Iterates over the meshes that differ at the same index of the two lists. If the lengths differ, iterates over all
/// meshes between the common start and the common end.
fn changed<'a>(before: &'a [Piece], now: &'a [Piece]) -> impl Iterator<Item = &'a Piece> {
    let same = |(a, b): &(&Piece, &Piece)| a == b;
    let (mut first, mut last) = (0, 0);
    if before.len() != now.len() {
        first = before.iter().zip(now).take_while(same).count();
        last = before[first..].iter().rev().zip(now[first..].iter().rev()).take_while(same).count();
    }
    let (before, now) = (&before[first..before.len() - last], &now[first..now.len() - last]);
    let paired = before.len() == now.len();
    let differs = move |(index, piece): (usize, &'a Piece), other: &[Piece]| {
        (!paired || other[index] != *piece).then_some(piece)
    };
    let gone = before.iter().enumerate().filter_map(move |piece| differs(piece, now));
    gone.chain(now.iter().enumerate().filter_map(move |piece| differs(piece, before)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::paint::Mode;

    fn piece(rect: [f32; 4], index: u32) -> Piece {
        let [left, top, right, bottom] = rect;
        let texture = Texture { texels: 0, width: 1, height: 1, smoothing: 0 };
        let mesh = Mesh { indices: vec![index], ..Mesh::default() };
        let bounds = Rect { min: pos2(left, top), max: pos2(right, bottom) };
        Piece { bounds, texture, mesh, pixels_per_point: Vec2::splat(1.0) }
    }

    fn interface(view: [u32; 4], texels: &Arc<Vec<u8>>, pieces: &[&Piece]) -> Interface {
        let under = Composition {
            window: [100, 50],
            view,
            a: None,
            b: None,
            mode: Mode::A,
            split: 0.5,
            amplification: 1.0,
        };
        Interface::new(&under, texels.clone(), pieces.iter().copied().cloned().collect())
    }

    fn drawn(now: &Interface, former: Option<&Interface>) -> Vec<([f32; 4], bool)> {
        let numbers = |area: Rect| [area.min.x, area.min.y, area.max.x, area.max.y];
        now.areas(former).into_iter().map(|(area, erased)| (numbers(area), erased)).collect()
    }

    const VIEW: [u32; 4] = [20, 10, 60, 30];
    const VIEW_ALONE: ([f32; 4], bool) = ([20.0, 10.0, 80.0, 40.0], false);

    #[test]
    fn at_first_everything_is_drawn_and_no_pixel_twice() {
        let texels = Arc::default();
        for view in [VIEW, [0, 0, 100, 50], [0, 0, 0, 0], [20, 10, 600, 300], [0, 10, 60, 40]] {
            let areas = drawn(&interface(view, &texels, &[]), None);
            let covers = |x: f32, y: f32| {
                areas.iter().filter(|([l, t, r, b], _)| *l <= x && x < *r && *t <= y && y < *b).count()
            };
            for (x, y) in (0..50).flat_map(|y| (0..100).map(move |x| (x as f32, y as f32))) {
                assert_eq!(covers(x, y), 1, "({x}, {y}) of {view:?}: {areas:?}");
            }
        }
    }

    #[test]
    fn only_the_view_and_what_changed_around_it_are_drawn_again() {
        let texels = Arc::default();
        let left = piece([2.0, 12.0, 18.0, 20.0], 1);
        let right = piece([85.0, 12.0, 99.0, 20.0], 2);
        let over = piece([30.0, 5.0, 40.0, 30.0], 3);
        let shown = interface(VIEW, &texels, &[&left, &right, &over]);
        assert_eq!(drawn(&shown, Some(&shown)), [VIEW_ALONE]);
        let now = interface(VIEW, &texels, &[&left, &piece([85.0, 30.0, 90.0, 45.0], 4), &over]);
        let expected = [
            // From the old to the new position, clipped to the strips right of the view and below it.
            ([85.0, 12.0, 99.0, 40.0], true),
            ([85.0, 40.0, 90.0, 45.0], true),
            VIEW_ALONE,
        ];
        assert_eq!(drawn(&now, Some(&shown)), expected);
        let above = ([30.0, 5.0, 40.0, 10.0], true);
        let gone = interface(VIEW, &texels, &[&left, &right]);
        assert_eq!(drawn(&gone, Some(&shown)), [above, VIEW_ALONE]);
        assert_eq!(drawn(&shown, Some(&gone)), [above, VIEW_ALONE]);
        let other = interface(VIEW, &texels, &[&left, &right, &piece([30.0, 5.0, 40.0, 30.0], 9)]);
        assert_eq!(drawn(&other, Some(&shown)), [above, VIEW_ALONE]);
        let turned = interface(VIEW, &texels, &[&left, &over, &right]);
        assert_eq!(drawn(&turned, Some(&shown)).len(), 3);
    }

    #[test]
    fn after_a_change_of_the_view_or_of_a_texture_everything_is_drawn() {
        let texels: Arc<Vec<u8>> = Arc::default();
        let shown = interface(VIEW, &texels, &[]);
        let whole = drawn(&shown, None);
        assert_eq!(drawn(&interface(VIEW, &Arc::default(), &[]), Some(&shown)), whole);
        let moved = interface([21, 10, 60, 30], &texels, &[]);
        assert_eq!(drawn(&moved, Some(&shown)), drawn(&moved, None));
    }
}
