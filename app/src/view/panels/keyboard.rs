//! Decides which keys reach the viewer, and which belong to a control, a list or the list of keys.

use egui::{Context, Event, Key, Modifiers, Popup};

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
/// while no control has the focus and no list or menu is open.
#[derive(Default)]
pub struct Keyboard {
    /// Presses in this frame, in order.
    pressed: Vec<Press>,
    /// Held keys, with the modifiers of their presses. Empty while a control or a list takes the keys.
    held: Vec<(Key, Modifiers)>,
    /// Presses in this frame that scroll the list of keys.
    scrolling: Vec<Key>,
}

impl Keyboard {
    /// Reads the keys of this frame. While the list of keys is shown (`help`), keys that scroll belong to it.
    pub fn read(&mut self, ctx: &Context, help: bool) {
        // egui clicks the focused control with every press, also if the system repeats a held key.
        ctx.input_mut(|input| {
            input.events.retain(|event| {
                !matches!(event, Event::Key { key: Key::Enter | Key::Space, repeat: true, .. })
            });
        });
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
            } else if reaches(key, modifiers, types, taken) {
                self.pressed.push(Press { key, modifiers, repeat });
                if !repeat {
                    self.held.push((key, modifiers));
                }
            }
        }
        // Keys are also released when the window loses the focus.
        self.held.retain(|(key, _)| !taken && ctx.input(|input| input.key_down(*key)));
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

fn scrolls(key: Key) -> bool {
    use Key::{ArrowDown, ArrowLeft, ArrowRight, ArrowUp, End, Home, PageDown, PageUp};
    matches!(key, ArrowUp | ArrowDown | ArrowLeft | ArrowRight | PageUp | PageDown | Home | End)
}

/// Returns true if no modifier but Shift is held. Shortcuts of a single key require this, because other programs use
/// the same key with Ctrl or Alt for something else.
pub fn is_plain(modifiers: Modifiers) -> bool {
    !(modifiers.alt || modifiers.ctrl || modifiers.command)
}
