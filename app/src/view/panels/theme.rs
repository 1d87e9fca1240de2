//! Defines the look of the window: colours, fonts and spacing, in a dark and a light theme.
//!
//! The colours of a theme are a [`Palette`]. Most are also those of the dump page (`framework/src/dump/page/page.css`),
//! so that both look alike. Text has at least 13 points and a contrast of 4.5 : 1 (WCAG 2.1, 1.4.3).

use egui::{
    Color32, Context, CornerRadius, FontData, FontDefinitions, FontFamily, FontId, Margin, Shadow, Stroke,
    Style, TextStyle, Theme, Ui, Visuals, vec2,
};
use std::sync::Arc;

/// Size of text, in points.
pub const TEXT: f32 = 13.0;
/// Size of headings, in points.
pub const HEADING: f32 = 15.0;
/// Height of a row of controls, in points.
pub const ROW: f32 = 24.0;
/// Unit of spacing, in points.
pub const GRID: f32 = 4.0;

const STRONG: &str = "strong";

/// The colours of a theme.
#[derive(Clone, Copy, Debug)]
pub struct Palette {
    /// Background of the timeline and of text fields.
    pub paper: Color32,
    /// Background of panels.
    pub raised: Color32,
    /// Background of controls and headers.
    pub band: Color32,
    /// Separators between areas.
    pub line: Color32,
    /// Secondary text.
    pub soft: Color32,
    /// Primary text.
    pub ink: Color32,
    /// Selection and clickable items.
    pub accent: Color32,
    /// Text on `accent`.
    pub on_accent: Color32,
    /// Values that cost accuracy, and features that are only partly available.
    pub caution: Color32,
    /// Text of errors.
    pub error: Color32,
    /// Results of passed checks.
    pub good: Color32,
    /// Diamonds of barriers.
    pub barrier: Color32,
    /// Bars of resources in memory.
    pub life: Color32,
}

const fn rgb(value: u32) -> Color32 {
    Color32::from_rgb((value >> 16) as u8, (value >> 8) as u8, value as u8)
}

/// Colours on a dark background.
pub const DARK: Palette = Palette {
    paper: rgb(0x0f1215),
    raised: rgb(0x14171b),
    band: rgb(0x20262d),
    line: rgb(0x343b45),
    soft: rgb(0xa7afba),
    ink: rgb(0xe8ebef),
    accent: rgb(0x6cb2ff),
    on_accent: rgb(0x0b1117),
    caution: rgb(0xe8b04b),
    error: rgb(0xff8a80),
    good: rgb(0x7fd38a),
    barrier: rgb(0xe69f00),
    life: rgb(0x3b4859),
};

/// Colours on a light background.
pub const LIGHT: Palette = Palette {
    paper: rgb(0xffffff),
    raised: rgb(0xf4f5f7),
    band: rgb(0xe6e9ee),
    line: rgb(0xc9ced6),
    soft: rgb(0x525965),
    ink: rgb(0x1b1f24),
    accent: rgb(0x0b5cad),
    on_accent: rgb(0xffffff),
    caution: rgb(0x8a5300),
    error: rgb(0xb3261e),
    good: rgb(0x1b6e2b),
    barrier: rgb(0xa86400),
    life: rgb(0xc3cedd),
};

/// Colours of phases, distinguishable with any colour vision: those of Okabe and Ito, with grey in place of black. More
/// phases repeat them.
/// <https://jfly.uni-koeln.de/color/>
const PHASES: [Color32; 8] = [
    rgb(0x56b4e9),
    rgb(0xe69f00),
    rgb(0x009e73),
    rgb(0xcc79a7),
    rgb(0xf0e442),
    rgb(0x0072b2),
    rgb(0xd55e00),
    rgb(0x9aa0a6),
];

/// Returns the colour of a phase by its index in execution order, as on the dump page. Colours repeat.
pub fn phase(index: usize) -> Color32 {
    PHASES[index % PHASES.len()]
}

/// Mixes a phase's colour with the background, for passes that are not highlighted.
pub fn dimmed(colour: Color32, paper: Color32) -> Color32 {
    paper.blend(colour.gamma_multiply(0.85))
}

/// Returns black for light backgrounds, white for dark ones: a contrast of at least 4.5 : 1 with any colour.
pub fn ink_on(background: Color32) -> Color32 {
    if luminance(background) > 0.18 { Color32::BLACK } else { Color32::WHITE }
}

/// Computes the relative luminance of a colour, as WCAG 2.1 defines it: from 0 to 1.
fn luminance(colour: Color32) -> f32 {
    let channel = |v: u8| {
        let v = f32::from(v) / 255.0;
        if v <= 0.03928 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    };
    0.2126 * channel(colour.r()) + 0.7152 * channel(colour.g()) + 0.0722 * channel(colour.b())
}

impl Palette {
    /// Returns the colours of the theme in use.
    pub fn of(ui: &Ui) -> Palette {
        Palette::in_mode(ui.visuals().dark_mode)
    }

    /// Returns the colours of the dark or the light theme.
    pub fn in_mode(dark: bool) -> Palette {
        if dark { DARK } else { LIGHT }
    }

    fn visuals(&self, dark: bool) -> Visuals {
        let mut visuals = if dark { Visuals::dark() } else { Visuals::light() };
        let corner = CornerRadius::same(4);
        let stroke = |colour| Stroke::new(1.0, colour);
        visuals.panel_fill = self.raised;
        visuals.window_fill = self.raised;
        visuals.window_stroke = stroke(self.line);
        visuals.window_corner_radius = CornerRadius::same(8);
        visuals.menu_corner_radius = CornerRadius::same(8);
        let shadow = Shadow {
            offset: [0, 4],
            blur: 16,
            spread: 0,
            color: Color32::from_black_alpha(if dark { 120 } else { 50 }),
        };
        (visuals.window_shadow, visuals.popup_shadow) = (shadow, shadow);
        visuals.extreme_bg_color = self.paper;
        visuals.faint_bg_color = self.band;
        visuals.code_bg_color = self.band;
        visuals.hyperlink_color = self.accent;
        visuals.warn_fg_color = self.caution;
        visuals.error_fg_color = self.error;
        visuals.weak_text_color = Some(self.soft);
        visuals.selection.bg_fill = self.accent;
        visuals.selection.stroke = stroke(self.on_accent);
        visuals.slider_trailing_fill = true;
        visuals.handle_shape = egui::style::HandleShape::Circle;
        let widgets = &mut visuals.widgets;
        let all = [
            (&mut widgets.noninteractive, self.raised, self.line, self.ink),
            (&mut widgets.inactive, self.band, self.band, self.ink),
            (&mut widgets.hovered, self.line, self.accent, self.ink),
            (&mut widgets.active, self.line, self.accent, self.ink),
            (&mut widgets.open, self.band, self.accent, self.ink),
        ];
        for (widget, fill, border, text) in all {
            (widget.bg_fill, widget.weak_bg_fill) = (fill, fill);
            (widget.bg_stroke, widget.fg_stroke) = (stroke(border), stroke(text));
            (widget.corner_radius, widget.expansion) = (corner, 0.0);
        }
        visuals
    }
}

/// Returns the font family for emphasised text.
pub fn strong() -> FontFamily {
    FontFamily::Name(STRONG.into())
}

/// Installs fonts, colours and spacing for both themes.
pub fn install(ctx: &Context) {
    ctx.set_fonts(fonts());
    for (theme, palette) in [(Theme::Dark, DARK), (Theme::Light, LIGHT)] {
        ctx.style_mut_of(theme, |style| {
            style.visuals = palette.visuals(theme == Theme::Dark);
            arrange(style);
        });
    }
}

fn arrange(style: &mut Style) {
    let text = |size| FontId::new(size, FontFamily::Proportional);
    style.text_styles = [
        (TextStyle::Small, text(TEXT)),
        (TextStyle::Body, text(TEXT)),
        (TextStyle::Button, text(TEXT)),
        (TextStyle::Heading, FontId::new(HEADING, strong())),
        (TextStyle::Monospace, FontId::new(TEXT, FontFamily::Monospace)),
    ]
    .into();
    style.drag_value_text_style = TextStyle::Body;
    let spacing = &mut style.spacing;
    spacing.item_spacing = vec2(2.0 * GRID, GRID);
    spacing.button_padding = vec2(2.0 * GRID, 2.0);
    spacing.interact_size = vec2(10.0 * GRID, ROW);
    spacing.window_margin = Margin::same(12);
    spacing.menu_margin = Margin::same(8);
    spacing.slider_rail_height = GRID;
    spacing.tooltip_width = 360.0;
    spacing.icon_width = 16.0;
    spacing.icon_width_inner = 10.0;
    style.interaction.tooltip_delay = 0.4;
    // An animation would cost frames without showing new information.
    style.animation_time = 0.0;
}

/// Returns the fonts: Inter for text, egui's monospace font for code, and egui's other fonts as fallbacks.
pub fn fonts() -> FontDefinitions {
    let mut fonts = FontDefinitions::default();
    let files: [(&str, &'static [u8]); 2] = [
        ("inter", include_bytes!("fonts/Inter-Regular.otf")),
        ("inter-semibold", include_bytes!("fonts/Inter-SemiBold.otf")),
    ];
    for (name, bytes) in files {
        fonts.font_data.insert(name.to_owned(), Arc::new(FontData::from_static(bytes)));
    }
    let code = fonts.families[&FontFamily::Monospace].first().cloned();
    let others = fonts.families[&FontFamily::Proportional].clone();
    for (family, first) in [(FontFamily::Proportional, "inter"), (strong(), "inter-semibold")] {
        let names = std::iter::once(first.to_owned()).chain(code.clone()).chain(others.clone());
        fonts.families.insert(family, names.collect());
    }
    fonts.families.entry(FontFamily::Monospace).or_default().insert(1, "inter".to_owned());
    fonts
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn contrast(a: Color32, b: Color32) -> f32 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn every_text_has_a_contrast_of_four_and_a_half_to_one() {
        for (name, palette) in [("dark", DARK), ("light", LIGHT)] {
            let Palette { soft, ink, accent, caution, error, good, barrier, .. } = palette;
            for (text, colour) in [
                ("soft", soft),
                ("ink", ink),
                ("accent", accent),
                ("caution", caution),
                ("error", error),
                ("good", good),
            ] {
                for (back, ground) in
                    [("paper", palette.paper), ("raised", palette.raised), ("band", palette.band)]
                {
                    let found = contrast(colour, ground);
                    assert!(found >= 4.5, "{name}: {text} on {back} has {found:.2} : 1");
                }
            }
            assert!(contrast(palette.on_accent, accent) >= 4.5, "{name}: text on the accent colour");
            // Symbols need 3 : 1 (WCAG 2.1, 1.4.11).
            assert!(contrast(barrier, palette.paper) >= 3.0, "{name}: barriers");
        }
        for index in 0..PHASES.len() {
            for colour in [phase(index), dimmed(phase(index), DARK.paper), dimmed(phase(index), LIGHT.paper)]
            {
                assert!(contrast(colour, ink_on(colour)) >= 4.5, "phase {index}: {colour:?}");
            }
        }
    }

    #[test]
    fn no_text_is_smaller_than_thirteen_points() {
        let ctx = Context::default();
        install(&ctx);
        for theme in [Theme::Dark, Theme::Light] {
            for (style, font) in &ctx.style_of(theme).text_styles {
                assert!(font.size >= 13.0, "{style:?} has {} points", font.size);
            }
        }
    }

    /// Reads the source files whose string literals the window shows.
    fn sources() -> Vec<String> {
        let view = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/view");
        let panels = std::fs::read_dir(view.join("panels")).expect("the folder is there");
        let files = panels.map(|entry| entry.expect("an entry").path());
        files
            .filter(|file| file.extension().is_some_and(|extension| extension == "rs"))
            .chain(["events.rs", "history.rs"].map(|name| view.join(name)))
            .map(|file| std::fs::read_to_string(file).expect("a text"))
            .collect()
    }

    #[test]
    fn every_character_of_the_window_has_a_glyph() {
        let ctx = Context::default();
        install(&ctx);
        // egui loads its fonts in a frame.
        ctx.run_ui(Default::default(), |_| {}).textures_delta.clear();
        let mut signs: Vec<char> =
            sources().iter().flat_map(|text| text.chars()).filter(|c| !c.is_control()).collect();
        signs.extend(' '..='~');
        signs.extend('\u{a0}'..='\u{ff}');
        signs.sort_unstable();
        signs.dedup();
        for family in [FontFamily::Proportional, FontFamily::Monospace, strong()] {
            let font = FontId::new(TEXT, family.clone());
            let missing: Vec<char> = ctx
                .fonts_mut(|fonts| signs.iter().copied().filter(|c| !fonts.has_glyph(&font, *c)).collect());
            assert_eq!(missing, Vec::<char>::new(), "in the family {family}");
        }
    }
}
