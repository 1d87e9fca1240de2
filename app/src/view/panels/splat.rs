//! Shows the picked splat: its properties, the list of the pixel's splats, and its outline on the picture.

use super::theme::{self, Palette};
use super::widgets::{self, Control as _, fact, heading};
use crate::draw::pick::{self, PickedSplat};
use crate::view::viewer::Viewer;
use egui::{Color32, Rect, RichText, Stroke, Ui, pos2, vec2};
use splatgraph_assets::{Projection, grouped};

const POINTS: usize = 64;
const LIST: usize = 200;

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    if viewer.is_picking() {
        ui.spinner();
    }
    let distance = viewer.picked_distance();
    let Some(picked) = &mut viewer.picked else {
        ui.weak("Click the picture to pick a splat.");
        return;
    };
    let [x, y] = picked.pixel;
    let count = picked.splats.len();
    let Some(PickedSplat { fragment, gaussian: splat }) = picked.splat().copied() else {
        ui.label(RichText::new(format!("Pixel {x}, {y}")).family(theme::strong()).size(theme::HEADING));
        ui.weak("No splat is blended here: this is the background.");
        return;
    };
    let title = format!("Splat {}", grouped(fragment.index.into()));
    ui.label(RichText::new(title).family(theme::strong()).size(theme::HEADING));
    ui.horizontal(|ui| {
        let near = ui.button("Nearer").named("splat:nearer");
        let far = ui.button("Farther").named("splat:farther");
        if near.clicked() {
            picked.step(-1);
        } else if far.clicked() {
            picked.step(1);
        }
        let place = picked.selected.map_or(0, |index| index + 1);
        ui.weak(format!("{place} of {count} at pixel {x}, {y}"));
    });
    let percent = |share: f64| format!("{} %", widgets::three_digits(100.0 * share));
    let three = |values: [f64; 3]| values.map(|v| format!("{v:.4}")).join("  ");
    let length = widgets::length;
    fact(ui, "Share of the pixel", percent(fragment.weight()));
    fact(ui, "Alpha here", format!("{:.4}", fragment.alpha));
    fact(ui, "Transmittance before", format!("{:.4}", fragment.transmittance));
    fact(ui, "Depth", length(fragment.depth));
    fact(ui, "Opacity", format!("{:.4}", splat.opacity));
    let soft = Palette::of(ui).soft;
    widgets::row(
        ui,
        |ui| ui.label(RichText::new("Position").color(soft)),
        |ui| {
            let copy = ui.small_button("Copy").named("splat:copy");
            if copy.hint("In world coordinates, as --eye and --target take them").clicked() {
                ui.copy_text(splat.position.map(|v| v.to_string()).join(","));
            }
        },
    );
    for (name, value) in ["    x", "    y", "    z"].into_iter().zip(splat.position) {
        fact(ui, name, length(value));
    }
    if let Some(distance) = distance {
        fact(ui, "Distance to the last pick", length(distance));
    }
    fact(ui, "Scale", splat.scale.map(length).join("  "));
    fact(ui, "Rotation w x y z", splat.rotation.map(|v| format!("{v:.3}")).join("  "));
    ui.horizontal(|ui| {
        ui.label(RichText::new("Colour from here").color(soft));
        let [r, g, b] = fragment.color.map(|v| (255.0 * v).round().clamp(0.0, 255.0) as u8);
        let (rect, _) = ui.allocate_exact_size(vec2(24.0, 14.0), egui::Sense::hover());
        ui.painter().rect_filled(rect, 2.0, Color32::from_rgb(r, g, b));
        ui.label(three(fragment.color));
    });
    heading(ui, "The pixel");
    fact(ui, "Splats blended", grouped(count as u64));
    fact(ui, "Background's share", percent(picked.transmittance));
    if let Some(depth) = picked.depth {
        fact(ui, "Mean depth", length(depth));
    }
    ui.weak("By the published rules in double precision, whatever the graph does.");
    for (index, other) in picked.splats.iter().enumerate().take(LIST) {
        let text = format!("{}   {}", grouped(other.fragment.index.into()), percent(other.fragment.weight()));
        if ui.selectable_label(picked.selected == Some(index), text).clicked() {
            picked.selected = Some(index);
        }
    }
    if count > LIST {
        ui.weak(format!("and {} more", count - LIST));
    }
}

/// Draws the outline of the picked splat, if there is one, as the current camera sees it.
pub fn draw_outline(ui: &Ui, viewer: &Viewer, view: Rect) {
    let Some(splat) = viewer.picked.as_ref().and_then(|picked| picked.splat()) else { return };
    let id = viewer.picked_in();
    let camera = viewer.picture_camera_of(id);
    let Some(outline) = pick::outline(viewer.loaded(id), &camera, splat.fragment.index) else { return };
    let scale = vec2(view.width() / camera.width.max(1) as f32, view.height() / camera.height.max(1) as f32);
    let painter = ui.painter().with_clip_rect(view);
    // A splat that crosses an edge of a panorama continues at the other.
    let rounds = if camera.projection == Projection::Equirectangular { -1..=1 } else { 0..=0 };
    for left in rounds.map(|round: i16| view.left() + f32::from(round) * view.width()) {
        let point = |index: usize| {
            let [x, y] = outline.point(index as f64 * std::f64::consts::TAU / POINTS as f64);
            pos2(left + x as f32 * scale.x, view.top() + y as f32 * scale.y)
        };
        let points: Vec<_> = (0..POINTS).map(point).collect();
        // A light line on a dark one contrasts with any picture.
        painter
            .add(egui::Shape::closed_line(points.clone(), Stroke::new(3.0, Color32::from_black_alpha(200))));
        painter.add(egui::Shape::closed_line(points, Stroke::new(1.5, theme::DARK.caution)));
    }
}
