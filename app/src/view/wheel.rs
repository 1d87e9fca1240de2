//! Distinguishes a mouse wheel from a two-finger scroll on a touchpad.
//!
//! Window systems send both as scrolling: a wheel in lines, a touchpad in points. (A touchpad that sends lines counts
//! as a wheel.) A wheel zooms. Two fingers drag, as the left button does; a pinch, or two fingers with Ctrl, zooms.

use super::navigation::ZOOM_PER_NOTCH;
use egui::{Event, InputState, MouseWheelUnit, Vec2};

/// Scrolling during a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scrolled {
    /// Notches of a wheel, or the equivalent of a pinch or of scrolling with Ctrl; positive zooms in.
    pub notches: f64,
    /// Two-finger motion, in points, in the direction in which the content moves: positive is right and down.
    pub swiped: [f64; 2],
}

/// The device that scrolled last: a wheel or a touchpad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wheel {
    is_touchpad: bool,
}

impl Wheel {
    /// Reads the scrolling since the last frame. `line` is egui's `line_scroll_speed`, in points.
    pub fn read(&mut self, input: &InputState, line: f32) -> Scrolled {
        let mut swiped = Vec2::ZERO;
        for event in &input.events {
            let Event::MouseWheel { unit, delta, modifiers, .. } = event else { continue };
            self.is_touchpad = *unit == MouseWheelUnit::Point;
            // With Ctrl (Cmd on macOS), egui reports a zoom instead.
            if self.is_touchpad && !modifiers.command {
                swiped += *delta;
            }
        }
        // Factor of a pinch, or of scrolling with Ctrl.
        let zoomed = f64::from(input.zoom_delta()).ln() / ZOOM_PER_NOTCH;
        let smooth = input.smooth_scroll_delta();
        // egui spreads a notch over several frames. With Shift, it scrolls horizontally.
        let points = if input.modifiers.shift { smooth.x + smooth.y } else { smooth.y };
        let turned = if self.is_touchpad { 0.0 } else { f64::from(points / line) };
        Scrolled { notches: turned + zoomed, swiped: [swiped.x.into(), swiped.y.into()] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{Context, Modifiers, MouseWheelSource, RawInput, TouchPhase, vec2};

    /// Runs frames with these events, and sums their scrolling.
    fn sum(wheel: &mut Wheel, events: &[Event], modifiers: Modifiers) -> Scrolled {
        let ctx = Context::default();
        let mut sum = Scrolled::default();
        for frame in 0..60 {
            let events = [Event::ModifiersChanged(modifiers)].into_iter().chain(events.get(frame).cloned());
            let (events, time) = (events.collect(), Some(frame as f64 / 60.0));
            let input = RawInput { events, time, ..RawInput::default() };
            let mut output = ctx.run_ui(input, |ui| {
                let line = ui.ctx().options(|options| options.input_options.line_scroll_speed);
                let now = ui.input(|input| wheel.read(input, line));
                sum.notches += now.notches;
                (0..2).for_each(|axis| sum.swiped[axis] += now.swiped[axis]);
            });
            output.textures_delta.clear();
        }
        sum
    }

    fn scroll(unit: MouseWheelUnit, delta: Vec2, modifiers: Modifiers) -> Event {
        let (phase, source) = (TouchPhase::Move, MouseWheelSource::Unknown);
        Event::MouseWheel { unit, delta, phase, source, modifiers }
    }

    #[test]
    fn a_notch_of_the_wheel_is_a_notch_with_shift_too() {
        for modifiers in [Modifiers::NONE, Modifiers::SHIFT] {
            let event = scroll(MouseWheelUnit::Line, vec2(0.0, -2.0), modifiers);
            let Scrolled { notches, swiped } = sum(&mut Wheel::default(), &[event], modifiers);
            assert!((notches + 2.0).abs() < 1e-3, "{modifiers:?}: {notches}");
            assert_eq!(swiped, [0.0; 2]);
        }
    }

    #[test]
    fn two_fingers_swipe_on_both_axes_with_shift_too_and_zoom_nothing() {
        for modifiers in [Modifiers::NONE, Modifiers::SHIFT] {
            let step = |x, y| scroll(MouseWheelUnit::Point, vec2(x, y), modifiers);
            let events = [step(3.0, -4.0), step(30.0, 50.0)];
            let found = sum(&mut Wheel::default(), &events, modifiers);
            assert_eq!(found, Scrolled { notches: 0.0, swiped: [33.0, 46.0] }, "{modifiers:?}");
        }
    }

    #[test]
    fn pinching_and_scrolling_with_ctrl_zoom_and_swipe_nothing() {
        let pinch = Event::Zoom(1.5);
        let found = sum(&mut Wheel::default(), &[pinch], Modifiers::NONE);
        assert!((found.notches * ZOOM_PER_NOTCH - 1.5f64.ln()).abs() < 1e-6, "{found:?}");
        let ctrl = Modifiers { ctrl: true, command: true, ..Modifiers::NONE };
        for unit in [MouseWheelUnit::Point, MouseWheelUnit::Line] {
            let event = scroll(unit, vec2(0.0, 5.0), ctrl);
            let found = sum(&mut Wheel::default(), &[event], ctrl);
            assert!(found.notches > 0.1 && found.swiped == [0.0; 2], "{found:?}");
        }
    }

    #[test]
    fn the_wheel_turns_again_after_a_touchpad_was_used() {
        let mut wheel = Wheel::default();
        sum(&mut wheel, &[scroll(MouseWheelUnit::Point, vec2(9.0, 9.0), Modifiers::NONE)], Modifiers::NONE);
        let event = scroll(MouseWheelUnit::Line, vec2(0.0, 1.0), Modifiers::NONE);
        let Scrolled { notches, swiped } = sum(&mut wheel, &[event], Modifiers::NONE);
        assert!((notches - 1.0).abs() < 1e-3 && swiped == [0.0; 2], "{notches}, {swiped:?}");
    }
}
