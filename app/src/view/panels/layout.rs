//! Arranges the picture and the tools around it: docked side by side or in tabs, floating, or closed.
//!
//! `egui_tiles` holds the arrangement; the user drags its tabs and borders. Tools keep their size in points when the
//! window is resized, and the picture takes the rest. Docked tools never shrink the picture below [`PICTURE`]: if a
//! window is too small, the most recently opened tools stay docked and the others float.

use egui::{Id, Rect, Ui, Vec2, vec2};
use egui_tiles::{Container, Linear, LinearDir, SimplificationOptions, Tile, TileId, Tiles, Tree};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// Minimum size of the picture beside docked tools, in points.
pub const PICTURE: Vec2 = vec2(320.0, 200.0);

/// Widths of the tools at a side, in points: what must be free to dock them, and the initial width.
const SIDE: (f32, f32) = (240.0, 320.0);

/// Height that must be free to dock the tool below the picture, in points.
const BELOW: f32 = 140.0;

/// Width of the line between tiles, in points.
pub const LINE: f32 = 1.0;

/// Content of a tile: the picture, or a tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Tool {
    /// The picture of the scene.
    Picture,
    /// Parameters of the graph.
    Parameters,
    /// Saved views, the path and the field of view.
    Cameras,
    /// Frame times, times per pass, and memory.
    Times,
    /// Details of the selected item.
    Inspector,
    /// Passes in order of execution, with barriers and memory.
    Timeline,
}

impl Tool {
    /// All tools; the picture is not one of them.
    pub const ALL: [Tool; 5] =
        [Tool::Parameters, Tool::Cameras, Tool::Times, Tool::Inspector, Tool::Timeline];

    /// Returns the title of the tile's tab.
    pub fn title(self) -> &'static str {
        match self {
            Tool::Picture => "Picture",
            Tool::Parameters => "Parameters",
            Tool::Cameras => "Cameras",
            Tool::Times => "Times",
            Tool::Inspector => "Inspector",
            Tool::Timeline => "Timeline",
        }
    }

    fn is_below(self) -> bool {
        self == Tool::Timeline
    }

    /// Returns true for tools that are at the left by default.
    fn is_left(self) -> bool {
        matches!(self, Tool::Parameters | Tool::Cameras)
    }
}

#[derive(Clone, Serialize, Deserialize)]
pub struct Layout {
    /// The tiles; taken out while they are drawn.
    pub tree: Tree<Tool>,
    /// Open tools, in the order of opening.
    open: Vec<Tool>,
    /// Tools that the user undocked.
    floating: Vec<Tool>,
    /// Widths or heights of the tiles beside the picture, in points.
    lengths: Vec<(TileId, f32)>,
}

impl Default for Layout {
    fn default() -> Layout {
        let mut tiles = Tiles::default();
        let mut tabs = |tools: &[Tool]| {
            let panes = tools.iter().map(|tool| tiles.insert_pane(*tool)).collect();
            tiles.insert_tab_tile(panes)
        };
        let left = tabs(&[Tool::Parameters, Tool::Cameras]);
        let picture = tabs(&[Tool::Picture]);
        let right = tabs(&[Tool::Inspector, Tool::Times]);
        let below = tabs(&[Tool::Timeline]);
        let middle = tiles.insert_horizontal_tile(vec![left, picture, right]);
        let root = tiles.insert_vertical_tile(vec![middle, below]);
        let tree = Tree::new(Id::unique("layout"), root, tiles);
        let lengths = vec![(left, SIDE.1), (right, SIDE.1), (below, super::timeline::HEIGHT)];
        Layout { tree, open: vec![Tool::Parameters, Tool::Times], floating: Vec::new(), lengths }
    }
}

impl Layout {
    /// Returns true if the arrangement is valid. The tiles form a tree that contains the picture and each tool exactly
    /// once, and all lengths are finite and not negative.
    pub fn is_sound(&self) -> bool {
        let mut panes: Vec<Tool> = Vec::new();
        let mut seen: HashSet<TileId> = HashSet::new();
        let mut next: Vec<TileId> = self.tree.root().into_iter().collect();
        while let Some(tile) = next.pop() {
            // A file may list a tile twice, or inside itself.
            if !seen.insert(tile) {
                return false;
            }
            match self.tree.tiles.get(tile) {
                Some(Tile::Pane(tool)) => panes.push(*tool),
                Some(Tile::Container(container)) => next.extend(container.children()),
                None => return false,
            }
        }
        panes.sort();
        let mut all = [Tool::ALL.as_slice(), &[Tool::Picture]].concat();
        all.sort();
        panes == all && self.lengths.iter().all(|(_, length)| length.is_finite() && *length >= 0.0)
    }

    pub fn is_open(&self, tool: Tool) -> bool {
        self.open.contains(&tool)
    }

    /// Opens or closes a tool. A closed tool is docked when it is opened again.
    pub fn set_open(&mut self, tool: Tool, open: bool) {
        self.open.retain(|other| *other != tool);
        if open {
            self.open.push(tool);
        } else {
            self.floating.retain(|other| *other != tool);
        }
    }

    /// Opens a tool, and brings it to the front of its tabs.
    pub fn reveal(&mut self, tool: Tool) {
        if !self.is_open(tool) {
            self.set_open(tool, true);
        }
        self.tree.make_active(|_, tile| *tile == Tile::Pane(tool));
    }

    pub fn undock(&mut self, tool: Tool) {
        self.floating.retain(|other| *other != tool);
        self.floating.push(tool);
    }

    /// Lists the open tools that float in a window of this size: undocked tools, and tools that do not fit.
    pub fn floating(&self, size: Vec2) -> Vec<Tool> {
        let mut sides: Vec<bool> = Vec::new();
        let mut floating = self.floating.clone();
        for tool in self.open.iter().rev().filter(|tool| !self.floating.contains(tool)) {
            let fits = if tool.is_below() {
                size.y >= PICTURE.y + BELOW
            } else {
                let known = sides.contains(&tool.is_left());
                let columns = sides.len() + usize::from(!known);
                let fits = size.x >= PICTURE.x + columns as f32 * SIDE.0;
                if fits && !known {
                    sides.push(tool.is_left());
                }
                fits
            };
            if !fits {
                floating.push(*tool);
            }
        }
        floating
    }

    /// Lays out the docked tools in an area; shows only the picture if `hidden`.
    pub fn arrange(&mut self, area: Rect, hidden: bool) {
        let floating = self.floating(area.size());
        let panes: Vec<(TileId, Tool)> = self.tree.tiles.iter().filter_map(pane).collect();
        for (id, tool) in panes {
            let docked = self.open.contains(&tool) && !floating.contains(&tool) && !hidden;
            self.tree.tiles.set_visible(id, tool == Tool::Picture || docked);
        }
        if let Some(root) = self.tree.root() {
            self.set_shares(root, area.size());
        }
    }

    /// Stores the lengths that result from the user's dragging. Must be called after the tree is drawn.
    pub fn remember_lengths(&mut self) {
        let linear: Vec<TileId> = self.tree.tiles.iter().filter_map(linear).collect();
        for id in linear {
            let Some(Tile::Container(Container::Linear(container))) = self.tree.tiles.get(id) else {
                continue;
            };
            let (shown, sum) = self.shares(container);
            let Some(rect) = self.tree.tiles.rect(id) else { continue };
            let whole = along(container.dir, rect.size()) - LINE * shown.len().saturating_sub(1) as f32;
            let lengths: Vec<(TileId, f32)> =
                shown.iter().map(|child| (*child, container.shares[*child] / sum * whole)).collect();
            for (child, length) in lengths {
                self.set_length(child, length);
            }
        }
    }

    fn set_length(&mut self, tile: TileId, length: f32) {
        match self.lengths.iter_mut().find(|(id, _)| *id == tile) {
            Some((_, former)) => *former = length,
            None => self.lengths.push((tile, length)),
        }
    }

    fn shares(&self, container: &Linear) -> (Vec<TileId>, f32) {
        let shown: Vec<TileId> = container
            .children
            .iter()
            .copied()
            .filter(|child| self.tree.tiles.is_visible_in_layout(*child))
            .collect();
        let sum: f32 = shown.iter().map(|child| container.shares[*child]).sum();
        (shown, sum.max(f32::MIN_POSITIVE))
    }

    fn holds_picture(&self, tile: TileId) -> bool {
        match self.tree.tiles.get(tile) {
            Some(Tile::Pane(tool)) => *tool == Tool::Picture,
            Some(Tile::Container(container)) => container.children().any(|child| self.holds_picture(*child)),
            None => false,
        }
    }

    /// Gives tools their stored lengths and the picture the rest, recursively from `tile`. Tools shrink before the
    /// picture would be smaller than [`PICTURE`]. Containers without the picture keep their shares.
    fn set_shares(&mut self, tile: TileId, size: Vec2) {
        let Some(Tile::Container(container)) = self.tree.tiles.get(tile) else { return };
        let Container::Linear(container) = container else {
            let children: Vec<TileId> = container.children().copied().collect();
            for child in children {
                self.set_shares(child, size);
            }
            return;
        };
        let dir = container.dir;
        let (shown, _) = self.shares(container);
        let whole = along(dir, size) - LINE * shown.len().saturating_sub(1) as f32;
        let Some(flexible) = shown.iter().copied().find(|child| self.holds_picture(*child)) else { return };
        let default = if dir == LinearDir::Horizontal { SIDE.1 } else { super::timeline::HEIGHT };
        let of =
            |child: TileId| self.lengths.iter().find(|(id, _)| *id == child).map_or(default, |(_, l)| *l);
        let tools: Vec<(TileId, f32)> =
            shown.iter().filter(|child| **child != flexible).map(|child| (*child, of(*child))).collect();
        let wanted: f32 = tools.iter().map(|(_, length)| length).sum();
        // The picture keeps its minimum size; tools shrink in proportion.
        let most = (whole - along(dir, PICTURE)).max(0.0);
        let scale = if wanted > most { most / wanted.max(1.0) } else { 1.0 };
        let rest = (whole - wanted * scale).max(1.0);
        let sizes: Vec<(TileId, f32)> = tools
            .iter()
            .map(|(child, length)| (*child, length * scale))
            .chain(std::iter::once((flexible, rest)))
            .collect();
        if let Some(Tile::Container(Container::Linear(container))) = self.tree.tiles.get_mut(tile) {
            for (child, length) in &sizes {
                container.shares.set_share(*child, *length);
            }
        }
        for (child, length) in sizes {
            let inner = match dir {
                LinearDir::Horizontal => vec2(length, size.y),
                LinearDir::Vertical => vec2(size.x, length),
            };
            self.set_shares(child, inner);
        }
    }
}

fn along(dir: LinearDir, size: Vec2) -> f32 {
    match dir {
        LinearDir::Horizontal => size.x,
        LinearDir::Vertical => size.y,
    }
}

fn pane((id, tile): (&TileId, &Tile<Tool>)) -> Option<(TileId, Tool)> {
    match tile {
        Tile::Pane(tool) => Some((*id, *tool)),
        Tile::Container(_) => None,
    }
}

fn linear((id, tile): (&TileId, &Tile<Tool>)) -> Option<TileId> {
    matches!(tile, Tile::Container(Container::Linear(_))).then_some(*id)
}

/// Rules for simplifying the tree: every tool keeps a tab.
pub const RULES: SimplificationOptions = SimplificationOptions {
    prune_empty_tabs: true,
    prune_empty_containers: true,
    prune_single_child_tabs: false,
    prune_single_child_containers: true,
    all_panes_must_have_tabs: true,
    join_nested_linear_containers: true,
    flatten_tabs_in_tabs: true,
};

/// Draws the floating window of a tool. Sets `close` to true if the user closes it. Returns what
/// [`egui::Window::show`] returns.
pub fn float(
    ui: &Ui,
    tool: Tool,
    within: Rect,
    close: &mut bool,
    contents: impl FnOnce(&mut Ui),
) -> Option<egui::InnerResponse<Option<()>>> {
    let mut open = true;
    let size =
        vec2(SIDE.1.min(within.width() - 24.0), (0.8 * within.height()).min(560.0)).max(Vec2::splat(80.0));
    let shown = egui::Window::new(tool.title())
        .id(Id::unique(("float", tool.title())))
        .open(&mut open)
        .default_size(size)
        .default_pos(within.min + vec2(12.0, 12.0))
        .constrain_to(within)
        .collapsible(true)
        .show(ui.ctx(), contents);
    *close |= !open;
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Pos2, pos2};

    fn arranged(size: Vec2, tools: &[Tool]) -> Layout {
        let mut layout = Layout::default();
        layout.open.clear();
        for tool in tools {
            layout.set_open(*tool, true);
        }
        layout.arrange(Rect::from_min_size(Pos2::ZERO, size), false);
        layout
    }

    /// Returns the widths of the middle row's visible columns; the picture's is last.
    fn widths(layout: &Layout, whole: f32) -> Vec<f32> {
        let row = layout.tree.tiles.iter().find_map(|(_, tile)| match tile {
            Tile::Container(Container::Linear(row)) if row.dir == LinearDir::Horizontal => Some(row),
            _ => None,
        });
        let row = row.expect("there is a row");
        let (shown, sum) = layout.shares(row);
        let whole = whole - LINE * (shown.len() - 1) as f32;
        let (picture, tools): (Vec<TileId>, Vec<TileId>) =
            shown.iter().partition(|child| layout.holds_picture(**child));
        tools.into_iter().chain(picture).map(|child| row.shares[child] / sum * whole).collect()
    }

    #[test]
    fn the_picture_keeps_its_least_width_beside_two_tools() {
        for width in [800.0, 900.0, 1280.0, 2560.0] {
            let layout = arranged(vec2(width, 800.0), &[Tool::Parameters, Tool::Times]);
            let widths = widths(&layout, width);
            assert_eq!(widths.len(), 3, "at {width}");
            assert!(widths[2] >= PICTURE.x - 0.01, "{widths:?} at {width}");
            assert!(widths[0] >= SIDE.0 - 2.0, "{widths:?} at {width}");
        }
    }

    #[test]
    fn an_arrangement_with_a_tile_inside_itself_is_refused() {
        let layout = Layout::default();
        assert!(layout.is_sound());
        let root = layout.tree.root().expect("there is a root");
        let mut alone = Tiles::default();
        alone.insert(root, Tile::Container(Container::new_tabs(vec![root])));
        let tree = Tree::new(Id::unique("layout"), root, alone);
        assert!(!Layout { tree, ..layout.clone() }.is_sound(), "it is its only child");
        let mut beside = layout;
        let Some(Tile::Container(container)) = beside.tree.tiles.get_mut(root) else { panic!("a container") };
        container.add_child(root);
        assert!(!beside.is_sound(), "it is one of its children");
    }

    #[test]
    fn tools_without_room_float_and_the_one_opened_last_stays_docked() {
        let tools = [Tool::Parameters, Tool::Times];
        assert_eq!(arranged(vec2(700.0, 800.0), &tools).floating(vec2(700.0, 800.0)), [Tool::Parameters]);
        let none = arranged(vec2(500.0, 400.0), &tools).floating(vec2(500.0, 400.0));
        assert_eq!(none.len(), 2, "{none:?}");
        let low = vec2(1600.0, 320.0);
        assert_eq!(arranged(low, &[Tool::Timeline, Tool::Times]).floating(low), [Tool::Timeline]);
    }

    #[test]
    fn a_tool_that_is_closed_or_hidden_gives_its_room_to_the_picture() {
        let size = vec2(1280.0, 800.0);
        let mut layout = arranged(size, &[Tool::Parameters]);
        assert_eq!(widths(&layout, size.x).len(), 2);
        layout.set_open(Tool::Parameters, false);
        layout.arrange(Rect::from_min_max(Pos2::ZERO, pos2(size.x, size.y)), false);
        assert_eq!(widths(&layout, size.x), [size.x]);
        layout.reveal(Tool::Inspector);
        layout.arrange(Rect::from_min_size(Pos2::ZERO, size), true);
        assert_eq!(widths(&layout, size.x), [size.x], "all tools are hidden");
    }
}
