//! Draws number fields and sliders.
//!
//! Fields accept a decimal point or, except for integers, a decimal comma, and report text that is no number or out of
//! range. Passing a field with Tab never changes its value.

use super::controls::refuse;
use super::theme::{self, ROW};
use super::widgets::Control as _;
use crate::io::report::text::decimals;
use egui::{DragValue, Key, Response, Slider, SliderClamping, Ui};
use std::cell::Cell;
use std::ops::RangeInclusive;

/// A slider is logarithmic if its range begins above 0 and spans more than this many powers of ten.
const DECADES: f64 = 2.0;

/// Width of a field beside a slider, in points.
const WIDTH: f32 = 80.0;

/// Range of a number.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    pub min: f64,
    /// Maximum; infinite if there is none.
    pub max: f64,
    /// Distance between adjacent values; 0 for a continuous range.
    pub step: f64,
}

impl From<RangeInclusive<f64>> for Scale {
    fn from(range: RangeInclusive<f64>) -> Scale {
        Scale { min: *range.start(), max: *range.end(), step: 0.0 }
    }
}

impl Scale {
    /// Formats a value with four significant digits and without trailing zeros. Integer digits are never rounded off.
    fn text(self, value: f64) -> String {
        if self.step >= 1.0 && value.fract() == 0.0 {
            return format!("{value:.0}");
        }
        if value == 0.0 {
            return "0".to_owned();
        }
        let digits = (3.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
        decimals(value, digits)
    }

    fn limits(self) -> String {
        match self.max.is_finite() {
            true => format!("from {} to {}", self.text(self.min), self.text(self.max)),
            false => format!("above {}", self.text(self.min)),
        }
    }
}

/// A number that the user can edit.
#[derive(Clone, Copy, Debug)]
pub struct NumberField<'a> {
    /// Name of the control, for scripts.
    pub name: &'a str,
    /// Name in messages.
    pub label: &'a str,
    pub scale: Scale,
    /// Change per point of a drag; 0 if the field cannot be dragged.
    pub speed: f64,
    pub prefix: &'a str,
    pub suffix: &'a str,
}

impl<'a> NumberField<'a> {
    pub fn new(name: &'a str, label: &'a str, scale: impl Into<Scale>) -> NumberField<'a> {
        NumberField { name, label, scale: scale.into(), speed: 0.0, prefix: "", suffix: "" }
    }

    /// Draws the field; returns the value if the user changed it.
    pub fn show(self, ui: &mut Ui, value: f64) -> (Response, Option<f64>) {
        let (response, changed) = self.field(ui, value, |ui, field| ui.add(field));
        (response.named(self.name), changed)
    }

    /// Draws a slider and, to its right, the field; returns the value if the user changed it. `width` is in points. The
    /// field's control has the name of the slider's, followed by `#`.
    pub fn show_with_slider(self, ui: &mut Ui, value: f64, width: f32) -> Option<f64> {
        let Scale { min, max, step } = self.scale;
        ui.spacing_mut().slider_width = (width - WIDTH - theme::GRID).max(24.0);
        // egui derives the handle's radius from the height.
        ui.spacing_mut().interact_size.y = 16.0;
        let mut moved = value;
        let mut slider = Slider::new(&mut moved, min..=max)
            .show_value(false)
            .clamping(SliderClamping::Edits)
            .smart_aim(false)
            .logarithmic(min > 0.0 && (max / min).log10() > DECADES);
        if step > 0.0 {
            // Round off the error of the multiplication: 0.3, not 0.30000000000000004.
            let digits = (2.0 - step.log10().floor()).clamp(0.0, 12.0) as usize;
            slider = slider.step_by(step).max_decimals(digits);
        }
        ui.add(slider).named(self.name);
        if moved != value {
            // egui rounds to steps after it clamps, so the last step can be outside the range.
            moved = moved.clamp(min, max);
        }
        let size = [WIDTH, ROW - 4.0];
        let (field, typed) = self.field(ui, moved, |ui, field| ui.add_sized(size, field));
        field.named(&format!("{}#", self.name));
        typed.or_else(|| (moved != value).then_some(moved))
    }

    fn field(
        self,
        ui: &mut Ui,
        value: f64,
        add: impl FnOnce(&mut Ui, DragValue) -> Response,
    ) -> (Response, Option<f64>) {
        let Scale { min, max, step } = self.scale;
        let (mut dragged, typed) = (value, Cell::new(None));
        let parse = |text: &str| {
            let number = self.parse(text);
            typed.set(Some(number));
            number
        };
        let field = DragValue::new(&mut dragged)
            .range(min..=max)
            .clamp_existing_to_range(false)
            .speed(self.speed)
            .update_while_editing(false)
            .prefix(self.prefix)
            .suffix(self.suffix)
            .custom_parser(parse)
            .custom_formatter(|value, _| self.scale.text(value));
        let response = add(ui, field);
        // egui discards the text in the pass of Escape, but applies it in the next one.
        let (id, pass) = (response.id.with("escape"), ui.ctx().cumulative_pass_nr());
        if response.lost_focus() && ui.input(|input| input.key_pressed(Key::Escape)) {
            ui.data_mut(|data| data.insert_temp(id, pass + 1));
        } else if ui.data(|data| data.get_temp(id)) == Some(pass) {
            return (response, None);
        }
        let kind = if step >= 1.0 { "an integer" } else { "a number" };
        let text = |value: f64| self.scale.text(value);
        let changed = match typed.get() {
            None => dragged,
            Some(None) => {
                let message = format!("{}: expected {kind}; it is still {}", self.label, text(value));
                refuse(&response.ctx, message);
                value
            }
            // The field shows fewer digits than the value has; leaving it unedited must not round the value.
            Some(Some(number)) if text(number) == text(value) => value,
            Some(Some(number)) => {
                let limited = number.clamp(min, max);
                if limited != number {
                    let (limits, found, now) = (self.scale.limits(), text(number), text(limited));
                    let message =
                        format!("{}: expected {kind} {limits}, found {found}; it is now {now}", self.label);
                    refuse(&response.ctx, message);
                }
                limited
            }
        };
        (response, (changed != value).then_some(changed))
    }

    /// Parses a typed text, which may contain the prefix and the suffix.
    fn parse(self, text: &str) -> Option<f64> {
        let text = text.trim();
        let text = text.strip_prefix(self.prefix.trim()).unwrap_or(text);
        let text = text.strip_suffix(self.suffix.trim()).unwrap_or(text);
        // In an integer, a comma may also separate thousands.
        parse_number(text).filter(|_| self.scale.step < 1.0 || !text.contains(','))
    }
}

/// Parses a number with a decimal point or a decimal comma. `None` if the text is no number.
fn parse_number(text: &str) -> Option<f64> {
    let sign = |c: char| if c == '−' { '-' } else { c };
    let mut text: String = text.chars().filter(|c| !c.is_whitespace()).map(sign).collect();
    if !text.contains('.') {
        text = text.replacen(',', ".", 1);
    }
    text.parse().ok().filter(|value: &f64| !value.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::tests;
    use egui::{Context, Modifiers, RawInput};

    const FLOOR: Scale = Scale { min: 0.0, max: 0.02, step: 0.001 };

    /// Draws a focused slider once for each list of pressed keys; returns the values.
    fn values(scale: Scale, mut value: f64, keys: &[&[Key]]) -> Vec<f64> {
        let ctx = Context::default();
        let mut step = |keys: &&[Key]| {
            let events = keys.iter().map(|key| tests::key(*key, true, Modifiers::NONE)).collect();
            let input = RawInput { events, ..RawInput::default() };
            let mut output = ctx.run_ui(input, |ui| {
                let field = NumberField::new("number", "number", scale);
                value = field.show_with_slider(ui, value, 200.0).unwrap_or(value);
            });
            output.textures_delta.clear();
            value
        };
        keys.iter().map(&mut step).collect()
    }

    #[test]
    fn a_value_between_two_steps_stays_until_somebody_moves_it() {
        let floor = 1.0 / 255.0;
        assert_eq!(FLOOR.text(floor), "0.003922");
        let keys: [&[Key]; 4] = [&[], &[Key::Tab], &[], &[Key::ArrowRight, Key::ArrowLeft]];
        assert_eq!(values(FLOOR, floor, &keys), [floor; 4]);
        let keys: [&[Key]; 4] = [&[Key::Tab], &[], &[Key::ArrowRight], &[Key::ArrowRight]];
        assert_eq!(values(FLOOR, floor, &keys), [floor, floor, 0.005, 0.006]);
        assert_eq!(values(FLOOR, 0.02, &keys), [0.02; 4], "the end of the range");
        let uneven = Scale { min: 0.0, max: 1.0, step: 0.4 };
        assert_eq!(values(uneven, 0.8, &keys), [0.8, 0.8, 1.0, 1.0], "the third step is 1.2");
    }

    #[test]
    fn tab_leaves_a_value_that_is_outside_the_range_or_has_more_digits_than_are_shown() {
        let tabs: [&[Key]; 6] = [&[], &[Key::Tab], &[], &[Key::Tab], &[], &[Key::Tab]];
        for value in [1.0 / 255.0, 0.5] {
            assert_eq!(values(FLOOR, value, &tabs), [value; 6]);
        }
    }

    #[test]
    fn enter_takes_what_was_typed_and_escape_discards_it() {
        let wide = Scale { min: 1.0, max: 1e6, step: 1.0 };
        for (key, value) in [(Key::Enter, 12.0), (Key::Escape, 123.0)] {
            let typed = [Key::End, Key::Backspace];
            let keys: [&[Key]; 7] = [&[Key::Tab], &[Key::Tab], &[], &typed, &[key], &[], &[]];
            assert_eq!(values(wide, 123.0, &keys).last(), Some(&value), "{key:?}");
        }
    }

    #[test]
    fn an_arrow_key_moves_an_integer_of_a_wide_range_by_one() {
        let wide = Scale { min: 1.0, max: 1e6, step: 1.0 };
        let keys: [&[Key]; 4] = [&[Key::Tab], &[], &[Key::ArrowRight], &[Key::ArrowLeft]];
        assert_eq!(values(wide, 123_456.0, &keys), [123_456.0, 123_456.0, 123_457.0, 123_456.0]);
        assert_eq!(wide.text(500_000.0), "500000");
    }

    #[test]
    fn one_comma_is_a_decimal_point_and_other_texts_are_no_numbers() {
        for (text, value) in
            [("0,5", 0.5), ("0.5", 0.5), (" −1,25e-1 ", -0.125), ("1 000", 1000.0), (",5", 0.5)]
        {
            assert_eq!(parse_number(text), Some(value), "{text}");
        }
        for text in ["", "1,000,000", "1.000,5", "1e-1x", "nan"] {
            assert_eq!(parse_number(text), None, "{text}");
        }
        let field = NumberField { suffix: "°", ..NumberField::new("", "", FLOOR) };
        assert_eq!(field.parse("52,5°"), Some(52.5));
    }
}
