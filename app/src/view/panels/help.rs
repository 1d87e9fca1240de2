//! Lists keys and mouse controls in a separate window.

use super::theme;
use egui::{Align2, Context, RichText};

const KEYS: [(&str, &[(&str, &str)]); 5] = [
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
            ("Ctrl + A, I, Esc", "select all, invert, clear"),
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
            ("F12, Shift + F12", "save the window; the picture alone"),
            ("F11", "full screen"),
            ("F1", "this list"),
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

pub fn show(ctx: &Context, open: &mut bool) {
    let middle = ctx.content_rect().center();
    egui::Window::new("Keys and mouse")
        .open(open)
        .resizable(false)
        .collapsible(false)
        .pivot(Align2::CENTER_CENTER)
        .default_pos(middle)
        .show(ctx, |ui| {
            let height = (ctx.content_rect().height() - 120.0).max(80.0);
            egui::ScrollArea::vertical().max_height(height).show(ui, |ui| {
                egui::Grid::new("keys").num_columns(2).spacing([24.0, 4.0]).show(ui, |ui| {
                    for (subject, rows) in KEYS {
                        ui.label(RichText::new(subject).family(theme::strong()));
                        ui.end_row();
                        for (keys, what) in rows {
                            ui.label(*keys);
                            ui.weak(*what);
                            ui.end_row();
                        }
                    }
                });
            });
        });
}
