//! Decides which keys reach the viewer, and which belong to a control, a list or the list of keys. Keeps the keyboard
//! focus when its control is disabled or removed.

use super::theme::ROW;
use egui::{Context, Event, Id, Key, Modifiers, Popup, Vec2, WidgetRect, vec2};
use std::collections::HashMap;

/// A key press that reached the viewer.
#[derive(Clone, Copy, Debug)]
pub struct Press {
    pub key: Key,
    pub modifiers: Modifiers,
    /// True if the key is held and the system repeats it.
    pub repeat: bool,
}

/// The keys that reach the viewer.
///
/// F1, F11 and F12 always do. Keys with Ctrl, or Cmd on macOS, do unless a text field has the focus. All others do only
/// while no control has the focus and no list or menu is open. An Escape that takes the focus from a control does not.
#[derive(Default)]
pub struct Keyboard {
    /// Names of the keys that are down, by physical key: those of their presses.
    names: HashMap<Key, Key>,
    /// Presses in this frame, in order.
    pressed: Vec<Press>,
    /// Held keys, with the modifiers of their presses. Empty while a control or a list takes the keys.
    held: Vec<(Key, Modifiers)>,
    /// Presses in this frame that scroll the list of keys.
    scrolling: Vec<Key>,
    /// Control that had the focus when this frame began.
    before: Option<Id>,
    /// True if a control had the focus when the last frame ended.
    had_focus: bool,
    /// True if the user last moved the focus with Tab, not with the pointer.
    tabs: bool,
    /// Control that gets the focus when the next frame begins.
    next: Option<Id>,
}

impl Keyboard {
    /// Renames keys so that the repeats and the release of a key have the name of its press. Must be called with all
    /// input, before egui gets it.
    ///
    /// The window system names a key by the modifiers that are held: a `+` whose Shift is released first is released as
    /// `=`, and egui would take `+` for held from then on.
    pub fn rename(&mut self, events: &mut [Event]) {
        for event in events {
            match event {
                Event::Key { key, physical_key: Some(physical), pressed: true, .. } => {
                    *key = *self.names.entry(*physical).or_insert(*key);
                }
                Event::Key { key, physical_key: Some(physical), .. } => {
                    *key = self.names.remove(physical).unwrap_or(*key);
                }
                Event::WindowFocused(false) => self.names.clear(),
                _ => {}
            }
        }
    }

    /// Reads the keys of this frame, before any control. While the list of keys is shown (`help`), keys that scroll
    /// belong to it.
    pub fn read(&mut self, ctx: &Context, help: bool) {
        let escapes = ctx.input_mut(|input| {
            // egui clicks the focused control with every press, also if the system repeats a held key.
            input.events.retain(|event| {
                !matches!(event, Event::Key { key: Key::Enter | Key::Space, repeat: true, .. })
            });
            self.tabs = (self.tabs || input.key_pressed(Key::Tab)) && !input.pointer.any_pressed();
            input.key_pressed(Key::Escape)
        });
        if let Some(id) = self.next.take().filter(|_| !escapes) {
            ctx.memory_mut(|memory| memory.request_focus(id));
        }
        self.before = ctx.memory(|memory| memory.focused());
        // Escape has already taken the focus from its control.
        let (types, taken) =
            (ctx.text_edit_focused(), ctx.egui_wants_keyboard_input() || Popup::is_any_open(ctx));
        self.pressed.clear();
        self.scrolling.clear();
        for event in ctx.input(|input| input.events.clone()) {
            let Event::Key { key, pressed, repeat, modifiers, .. } = event else { continue };
            if !pressed {
                self.held.retain(|(held, _)| *held != key);
            } else if help && !taken && scrolls(key) {
                self.scrolling.push(key);
            } else if reaches(key, modifiers, types, taken || key == Key::Escape && self.had_focus) {
                self.pressed.push(Press { key, modifiers, repeat });
                if !repeat {
                    self.held.push((key, modifiers));
                }
            }
        }
        // Keys are also released when the window loses the focus.
        self.held.retain(|(key, _)| !taken && ctx.input(|input| input.key_down(*key)));
    }

    /// Keeps the keyboard focus at its place. Without a focus, the next key would reach the viewer, and Tab would begin
    /// at the first control of the window. Must be called after all controls.
    ///
    /// - A control that was disabled, for example by its own click, keeps the focus. Tab goes on to the next control.
    /// - A text field that was reached with Tab gets the focus back after Enter.
    /// - Instead of a control that is gone, the one before it gets the focus.
    pub fn keep_focus(&mut self, ctx: &Context) {
        let now = ctx.memory(|memory| memory.focused());
        let [leaves, enters] = ctx.input(|input| {
            let pressed = |key| input.key_pressed(key);
            [input.pointer.any_pressed() || pressed(Key::Tab), pressed(Key::Enter)]
        });
        if let Some(id) = self.before.filter(|id| !leaves && now.is_none_or(|now| now == *id)) {
            match ctx.viewport(|viewport| viewport.this_pass.widgets.get(id).copied()) {
                None => self.next = control_before(ctx, id),
                Some(_) if now.is_some() => {}
                Some(control) if !control.enabled => ctx.memory_mut(|memory| memory.request_focus(id)),
                // Not in this frame: as a field that has just got the focus, it shows its new value, selected.
                Some(_) if enters && self.tabs => self.next = Some(id),
                Some(_) => {}
            }
        }
        if self.next.is_some() {
            ctx.request_repaint();
        }
        self.had_focus = self.next.is_some() || ctx.memory(|memory| memory.focused().is_some());
    }

    pub fn presses(&self) -> &[Press] {
        &self.pressed
    }

    /// Returns true if a key reached the viewer without Ctrl or Alt in this frame.
    pub fn pressed(&self, key: Key) -> bool {
        self.pressed.iter().any(|press| press.key == key && is_plain(press.modifiers))
    }

    /// Returns true while a key that reached the viewer is held.
    pub fn held(&self, key: Key) -> bool {
        self.held.iter().any(|(held, _)| *held == key)
    }

    /// Returns true while a key is held that reached the viewer without Ctrl or Alt.
    pub fn held_plainly(&self, key: Key) -> bool {
        self.held.iter().any(|(held, modifiers)| *held == key && is_plain(*modifiers))
    }

    /// Returns the presses in this frame that scroll the list of keys.
    pub fn scrolling(&self) -> &[Key] {
        &self.scrolling
    }
}

fn reaches(key: Key, modifiers: Modifiers, types: bool, taken: bool) -> bool {
    matches!(key, Key::F1 | Key::F11 | Key::F12) || modifiers.command && !types || !taken
}

/// Returns the control before one that was drawn in the last frame, but not in this one. `None` if there is none at the
/// same place in both frames.
fn control_before(ctx: &Context, gone: Id) -> Option<Id> {
    ctx.viewport(|viewport| {
        let (former, now) = (&viewport.prev_pass.widgets, &viewport.this_pass.widgets);
        let (layer, _) = former.order(gone)?;
        // If a row is removed, the next row may get its ids.
        let stays = |control: &&WidgetRect| {
            let here = |now: &WidgetRect| now.enabled && now.rect == control.rect;
            control.sense.is_focusable() && now.get(control.id).is_some_and(here)
        };
        let before = former.get_layer(layer).take_while(|control| control.id != gone);
        before.filter(stays).last().map(|control| control.id)
    })
}

fn scrolls(key: Key) -> bool {
    use Key::{ArrowDown, ArrowLeft, ArrowRight, ArrowUp, End, Home, PageDown, PageUp};
    matches!(key, ArrowUp | ArrowDown | ArrowLeft | ArrowRight | PageUp | PageDown | Home | End)
}

/// Returns by how much a key scrolls, in points. `page` is the height of the visible part.
pub fn moved(key: Key, page: f32) -> Vec2 {
    match key {
        Key::ArrowDown => vec2(0.0, -2.0 * ROW),
        Key::ArrowUp => vec2(0.0, 2.0 * ROW),
        Key::ArrowRight => vec2(-2.0 * ROW, 0.0),
        Key::ArrowLeft => vec2(2.0 * ROW, 0.0),
        Key::PageDown => vec2(0.0, ROW - page),
        Key::PageUp => vec2(0.0, page - ROW),
        Key::Home => vec2(0.0, f32::from(u16::MAX)),
        Key::End => vec2(0.0, -f32::from(u16::MAX)),
        _ => Vec2::ZERO,
    }
}

/// Returns true if no modifier but Shift is held. Shortcuts of a single key require this, because other programs use
/// the same key with Ctrl or Alt for something else.
pub fn is_plain(modifiers: Modifiers) -> bool {
    !(modifiers.alt || modifiers.ctrl || modifiers.command)
}
