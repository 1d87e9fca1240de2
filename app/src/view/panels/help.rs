//! Lists keys and mouse controls in a separate window.

use super::controls::see;
use super::keyboard::moved;
use super::theme::{self, GRID};
use egui::{Align2, Context, Key, Order, RichText, Ui, vec2};

/// A subject with its keys and their effects.
type Subject = (&'static str, &'static [(&'static str, &'static str)]);

const KEYS: [Subject; 5] = [
    (
        "Camera",
        &[
            ("drag, two fingers, arrows", "orbit about the pivot"),
            ("Shift + drag", "pan"),
            ("wheel, pinch, + −, Ctrl + middle drag", "zoom"),
            ("right drag + W A S D, Q E", "fly; Shift faster, Ctrl slower, wheel sets the speed"),
            ("middle drag", "orbit; with Shift pan, as in Blender"),
            ("F, double click", "fit the scene into the picture"),
            ("Home", "return to the first view"),
            ("[ ]", "previous and next camera"),
            ("K", "add the view to the path"),
            ("P", "play the path"),
        ],
    ),
    ("Picture", &[("click", "pick the splat under the pointer"), ("drag the line", "move the split")]),
    (
        "Splats",
        &[
            ("R, B", "select by a box, by a brush; again to stop"),
            ("drag, Shift + drag, Ctrl + drag", "replace the selection, add to it, remove from it"),
            ("− +", "radius of the brush"),
            ("Ctrl + A, I, Esc", "select all that are not hidden, invert, clear"),
            ("X or Delete, U", "hide the selected splats, show all"),
        ],
    ),
    (
        "Window",
        &[
            ("H", "show or hide all tools"),
            ("1 2 3 4", "parameters, times, timeline, inspector"),
            ("Ctrl + Z, Ctrl + Shift + Z", "undo and redo"),
            ("C", "draw continuously, or only what changed"),
            ("V", "wait for the display"),
            ("T", "dark or light theme"),
            ("Ctrl + =, Ctrl + -, Ctrl + 0", "larger texts, smaller texts, as at first"),
            ("Tab, Esc", "give the keys to a control, and back to the picture"),
            ("Page keys, Home, End", "scroll the tool whose tab or control has the keys"),
            ("F12, Shift + F12", "save the window; the picture alone"),
            ("F11", "full screen"),
            ("F1, Esc", "show or hide this list; arrows and Page keys scroll it"),
        ],
    ),
    (
        "Files",
        &[
            ("Ctrl + O", "open a scene, a graph or cameras"),
            ("drop a file", "open a scene, a graph (.ron) or cameras (.json)"),
        ],
    ),
];

/// Number of subjects in the left column of a wide window.
const LEFT: usize = 3;

/// Minimum width for two columns, in points: a narrower window has one.
const WIDE: f32 = 1100.0;

/// Draws the window. `scrolling` are the keys pressed in this frame that scroll it.
pub fn show(ctx: &Context, open: &mut bool, scrolling: &[Key]) {
    let window = ctx.content_rect();
    let shown = egui::Window::new("Keys and mouse")
        .open(open)
        .resizable(false)
        .collapsible(false)
        // Among the cards over the picture, the one that appeared last is on top.
        .order(Order::Foreground)
        .pivot(Align2::CENTER_CENTER)
        .default_pos(window.center())
        .show(ctx, |ui| {
            let room = (window.size() - vec2(48.0, 96.0)).max(vec2(80.0, 80.0));
            // By default, egui limits the height of a window to 400 points.
            let area = egui::ScrollArea::both().max_width(room.x).max_height(room.y);
            let area = area.min_scrolled_height(room.y).min_scrolled_width(room.x);
            area.show(ui, |ui| {
                scrolling.iter().for_each(|key| ui.scroll_with_delta(moved(*key, room.y)));
                let (left, right) = KEYS.split_at(if window.width() < WIDE { KEYS.len() } else { LEFT });
                ui.horizontal_top(|ui| {
                    column(ui, "keys", left);
                    ui.add_space(8.0 * GRID);
                    column(ui, "more keys", right);
                });
                see(ui.ctx(), "keys:all", ui.min_rect());
            });
        });
    if let Some(shown) = shown {
        see(ctx, "keys", shown.response.rect);
    }
}

fn column(ui: &mut Ui, name: &str, subjects: &[Subject]) {
    egui::Grid::new(name).num_columns(2).spacing([24.0, 4.0]).show(ui, |ui| {
        for (subject, rows) in subjects {
            ui.label(RichText::new(*subject).family(theme::strong()));
            ui.end_row();
            for (keys, what) in *rows {
                ui.label(*keys);
                ui.weak(*what);
                ui.end_row();
            }
        }
    });
}
