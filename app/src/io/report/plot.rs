//! Draws plots as SVG and as pictures, with the same marks. Pictures use an embedded font.

use super::text;
use crate::io::image::Image;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, RGBColor, register_font};
use std::iter;
use std::ops::Range;
use std::sync::Once;

/// Width and height of a plot, in pixels.
pub const SIZE: (u32, u32) = (960, 560);

/// An error of the plotting library.
#[derive(Debug, thiserror::Error)]
#[error("the plot cannot be drawn: {0}")]
pub struct PlotError(String);

/// An axis with its label and scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// True for a logarithmic scale. Points at or below 0 are then omitted.
    pub logarithmic: bool,
}

impl Axis {
    /// Converts a value to the coordinate on the axis.
    fn on(&self, value: f64) -> f64 {
        if self.logarithmic { value.log10() } else { value }
    }
}

/// The form of a series' marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Points joined by a line.
    Line,
    /// Points without a line.
    Points,
    /// Grey points, drawn behind the other series.
    Muted,
}

/// A point with an optional name.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Horizontal position.
    pub x: f64,
    /// Vertical position.
    pub y: f64,
    /// Label beside the point; empty for none.
    pub name: String,
}

/// Points that share a legend entry and a form.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend; empty for no entry.
    pub name: String,
    /// The form of the marks.
    pub form: Form,
    /// Points of the series. Points that are not finite are omitted.
    pub points: Vec<Point>,
}

/// A horizontal error bar: the range of a point's horizontal position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Ends of the bar: the lowest and the highest horizontal position.
    pub x: (f64, f64),
    /// Vertical position.
    pub y: f64,
}

/// A plot of series over two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Title above the plot.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Series, drawn in this order. Muted ones are drawn first.
    pub series: Vec<Series>,
    /// Error bars, behind the points.
    pub bars: Vec<Bar>,
}

/// Colours that are distinct for any colour vision (Okabe and Ito 2008), without their yellow, which is faint on white.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
];
const GREY: RGBColor = RGBColor(150, 155, 163);
const INK: RGBColor = RGBColor(27, 31, 36);
const RULE: RGBColor = RGBColor(225, 228, 233);

const FONT: &str = "sans-serif";
const TEXT: u32 = 14;
const NAME: u32 = 13;
const TITLE: u32 = 18;
const HEAD: u32 = 66;

/// Position of a dot in pixels, and its name.
type Dot<'a> = ((i32, i32), &'a str);

/// Style of a series. The eighth to the fourteenth series repeat the colours, with open dots; further ones repeat all
/// styles.
#[derive(Clone, Copy)]
struct Mark {
    colour: RGBColor,
    open: bool,
}

impl Mark {
    /// Lists the discs that form a dot, with their radii in pixels, from back to front.
    fn discs(self) -> impl Iterator<Item = (RGBColor, i32)> {
        iter::once((self.colour, 4)).chain(self.open.then_some((WHITE, 2)))
    }
}

impl Series {
    /// Makes a line through points without names.
    pub fn line(name: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Series {
        let point = |(x, y)| Point { x, y, name: String::new() };
        Series { name: name.to_owned(), form: Form::Line, points: points.into_iter().map(point).collect() }
    }
}

impl Plot {
    /// Draws the plot as SVG. A viewer shows the name of the dot at which the mouse points, also if no text has room.
    ///
    /// # Errors
    /// The plotting library fails.
    pub fn svg(&self) -> Result<String, PlotError> {
        let mut text = String::new();
        let dots = self.draw(SVGBackend::with_string(&mut text, SIZE).into_drawing_area())?;
        let title = |((x, y), name): &Dot| {
            let name = text::escaped(name);
            format!(
                "<circle cx=\"{x}\" cy=\"{y}\" r=\"5\" fill=\"none\" pointer-events=\"all\"><title>{name}</title></circle>\n"
            )
        };
        let titles: String = dots.iter().map(title).collect();
        let end = text.rfind("</svg>").unwrap_or(text.len());
        text.insert_str(end, &titles);
        Ok(text)
    }

    /// Draws the plot as a picture.
    ///
    /// # Errors
    /// The plotting library fails.
    pub fn image(&self) -> Result<Image, PlotError> {
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        let mut bytes = vec![0u8; width * height * 3];
        self.draw(BitMapBackend::with_buffer(&mut bytes, SIZE).into_drawing_area())?;
        let channel = |at: usize| f32::from(bytes[at]) / 255.0;
        Ok(Image::from_fn(width, height, |x, y| {
            let first = 3 * (y * width + x);
            [channel(first), channel(first + 1), channel(first + 2)]
        }))
    }

    /// Draws the plot, and returns the dots that have names.
    fn draw<B: DrawingBackend>(&self, area: DrawingArea<B, Shift>) -> Result<Vec<Dot<'_>>, PlotError> {
        register();
        let dots = self.draw_on(&area).and_then(|dots| area.present().map(|()| dots));
        dots.map_err(|error| PlotError(error.to_string()))
    }

    fn draw_on<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
    ) -> Result<Vec<Dot<'_>>, DrawingAreaErrorKind<B::ErrorType>> {
        let shown: Vec<Vec<(f64, f64, &str)>> = self.series.iter().map(|series| self.shown(series)).collect();
        let all = || shown.iter().flatten();
        let bars = self.shown_bars();
        let ends = bars.iter().flat_map(|(low, high, _)| [*low, *high]);
        let heights = bars.iter().map(|bar| bar.2);
        let x = Ticks::new(all().map(|point| point.0).chain(ends), self.x.logarithmic);
        let y = Ticks::new(all().map(|point| point.1).chain(heights), self.y.logarithmic);

        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(area)
            .margin(14)
            .margin_top(HEAD)
            .x_label_area_size(48)
            .y_label_area_size(84)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .label_style((FONT, TEXT).into_font().color(&INK))
            .axis_desc_style((FONT, TEXT).into_font().color(&INK))
            .axis_style(GREY)
            .bold_line_style(RULE)
            .light_line_style(TRANSPARENT)
            .draw()?;

        let filled = COLOURS.map(|colour| Mark { colour, open: false });
        let open = COLOURS.map(|colour| Mark { colour, open: true });
        let mut marks = filled.iter().chain(&open).cycle();
        let muted = |at: &usize| self.series[*at].form == Form::Muted;
        let behind_all = Mark { colour: GREY, open: false };
        let mark_of: Vec<Mark> = (0..self.series.len())
            .map(|at| if muted(&at) { behind_all } else { *marks.next().unwrap_or(&behind_all) })
            .collect();
        // Names of muted series are placed last, where there is room left.
        let (behind, before): (Vec<usize>, Vec<usize>) = (0..self.series.len()).partition(muted);
        self.head(area, &mark_of)?;
        let bar = |(low, high, y): &(f64, f64, f64)| PathElement::new(vec![(*low, *y), (*high, *y)], GREY);
        chart.draw_series(bars.iter().map(bar))?;
        for at in behind.iter().chain(&before) {
            let (series, points, mark) = (&self.series[*at], &shown[*at], mark_of[*at]);
            if series.form == Form::Line {
                let line = points.iter().map(|(x, y, _)| (*x, *y));
                chart.draw_series(LineSeries::new(line, mark.colour.stroke_width(2)))?;
            }
            for (colour, radius) in mark.discs() {
                let dots = points.iter().map(|(x, y, _)| Circle::new((*x, *y), radius, colour.filled()));
                chart.draw_series(dots)?;
            }
        }
        let mut names = Names::default();
        shown.iter().flatten().for_each(|(x, y, _)| names.block(chart.backend_coord(&(*x, *y))));
        let (mut dots, mut left_out) = (Vec::new(), 0);
        for at in before.iter().chain(&behind) {
            let style = (FONT, NAME).into_font().color(&if muted(at) { GREY } else { INK });
            for (x, y, name) in shown[*at].iter().filter(|(.., name)| !name.is_empty()) {
                let (width, height) = area.estimate_text_size(name, &style)?;
                let size = (width as i32, height as i32);
                let at = chart.backend_coord(&(*x, *y));
                dots.push((at, *name));
                match names.place(at, size) {
                    Some((side, place)) => {
                        let style = style.pos(Pos::new(side, VPos::Top));
                        area.draw(&Text::new((*name).to_owned(), place, style))?;
                    }
                    None => left_out += 1,
                }
            }
        }
        if left_out > 0 {
            let style = (FONT, NAME).into_font().color(&INK).pos(Pos::new(HPos::Right, VPos::Bottom));
            let text = if left_out == 1 {
                "1 name does not fit".into()
            } else {
                format!("{left_out} names do not fit")
            };
            area.draw(&Text::new(text, (SIZE.0 as i32 - 14, SIZE.1 as i32 - 4), style))?;
        }
        Ok(dots)
    }

    /// Draws the title, and the legend in a line below it.
    fn head<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        marks: &[Mark],
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let centred = Pos::new(HPos::Center, VPos::Center);
        let title = |size: u32| (FONT, size).into_font().color(&INK).pos(centred);
        let (width, _) = area.estimate_text_size(&self.title, &title(TITLE))?;
        // A title with a scene and many parameters is wide.
        let title = title((TITLE * (SIZE.0 - 16) / width.max(1)).min(TITLE));
        area.draw(&Text::new(self.title.clone(), (SIZE.0 as i32 / 2, 22), title))?;
        let style = (FONT, TEXT).into_font().color(&INK);
        let named = || self.series.iter().zip(marks).filter(|(series, _)| !series.name.is_empty());
        let width =
            |series: &Series| area.estimate_text_size(&series.name, &style).map(|(width, _)| width as i32);
        /// Width of a dot with its margins.
        const DOT: i32 = 36;
        let mut all = 0;
        for (series, _) in named() {
            all += width(series)? + DOT;
        }
        let mut x = (SIZE.0 as i32 - all) / 2 + DOT / 2;
        for (series, mark) in named() {
            for (colour, radius) in mark.discs() {
                area.draw(&Circle::new((x, 46), radius, colour.filled()))?;
            }
            let beside = style.clone().pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.name.clone(), (x + 10, 46), beside))?;
            x += width(series)? + DOT;
        }
        Ok(())
    }

    fn shown_bars(&self) -> Vec<(f64, f64, f64)> {
        let bar = |bar: &Bar| (self.x.on(bar.x.0), self.x.on(bar.x.1), self.y.on(bar.y));
        let is_finite = |(low, high, y): &(f64, f64, f64)| [low, high, y].iter().all(|v| v.is_finite());
        self.bars.iter().map(bar).filter(is_finite).collect()
    }

    /// Lists the points of a series that the scales can show, in axis coordinates.
    fn shown<'a>(&self, series: &'a Series) -> Vec<(f64, f64, &'a str)> {
        let point = |point: &'a Point| (self.x.on(point.x), self.y.on(point.y), point.name.as_str());
        series.points.iter().map(point).filter(|(x, y, _)| x.is_finite() && y.is_finite()).collect()
    }
}

/// Registers the font for pictures, once. An SVG only names a font family.
fn register() {
    static ONCE: Once = Once::new();
    // Fails only for an invalid font.
    ONCE.call_once(|| drop(register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)));
}

/// Range and ticks of an axis. A logarithmic axis stores logarithms.
struct Ticks {
    first: f64,
    last: f64,
    at: Vec<f64>,
    logarithmic: bool,
    digits: usize,
}

impl Ticks {
    /// Chooses the range around the values, with ticks at round numbers.
    fn new(values: impl Iterator<Item = f64>, logarithmic: bool) -> Ticks {
        let range = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        let (low, high) = if range.0 <= range.1 { range } else { (0.0, 1.0) };
        let room = match high - low {
            0.0 => (0.05 * low.abs()).max(0.1),
            span => 0.06 * span,
        };
        let (first, last) = (low - room, high + room);
        let digits = (-step_for(last - first).log10().floor()).max(0.0) as usize;
        let even = |first: f64, last: f64| {
            let step = step_for(last - first);
            ((first / step).ceil() as i64..=(last / step).floor() as i64).map(move |i| i as f64 * step)
        };
        let at = if logarithmic {
            // The coarsest set with at least four ticks in the range.
            let sets: [&[f64]; 4] =
                [&[1.0], &[1.0, 3.0], &[1.0, 2.0, 5.0], &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]];
            let decades = first.floor() as i32..=last.ceil() as i32;
            let ticks = |set: &[f64]| -> Vec<f64> {
                let all = decades.clone().flat_map(|d| set.iter().map(move |m| m.log10() + f64::from(d)));
                all.filter(|v| (first..=last).contains(v)).collect()
            };
            let found = sets.iter().map(|set| ticks(set)).find(|ticks| ticks.len() >= 4);
            // The range can be too narrow for these sets.
            found.unwrap_or_else(|| even(10f64.powf(first), 10f64.powf(last)).map(f64::log10).collect())
        } else {
            even(first, last).collect()
        };
        Ticks { first, last, at, logarithmic, digits }
    }

    fn label(&self, at: f64) -> String {
        if !self.logarithmic {
            return format!("{at:.*}", self.digits);
        }
        let value = 10f64.powf(at);
        let (scale, digits, suffix) = match value {
            1e9.. => (1e9, 3, " G"),
            1e6.. => (1e6, 3, " M"),
            1e4.. => (1e3, 3, " k"),
            // Six decimals distinguish the ticks, and hide the rounding of the logarithm.
            _ => (1.0, 6, ""),
        };
        text::decimals(value / scale, digits) + suffix
    }
}

impl Ranged for Ticks {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (begin, end): (i32, i32)) -> i32 {
        let share = (value - self.first) / (self.last - self.first);
        begin + (share * f64::from(end - begin)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.at.clone()
    }

    fn range(&self) -> Range<f64> {
        self.first..self.last
    }
}

impl ValueFormatter<f64> for Ticks {
    fn format_ext(&self, at: &f64) -> String {
        self.label(*at)
    }
}

/// Chooses a step that divides a span into about 5 parts: 1, 2 or 5 times a power of ten.
fn step_for(span: f64) -> f64 {
    let power = 10f64.powf((span / 5.0).log10().floor());
    let ratio = span / 5.0 / power;
    let round = match ratio {
        ..1.5 => 1.0,
        ..3.5 => 2.0,
        ..7.5 => 5.0,
        _ => 10.0,
    };
    power * round
}

/// Areas that later names avoid.
#[derive(Default)]
struct Names {
    taken: Vec<[i32; 4]>,
}

impl Names {
    fn block(&mut self, (x, y): (i32, i32)) {
        self.taken.push([x - 4, y - 4, x + 4, y + 4]);
    }

    /// Finds a place for a name beside its dot, and the alignment of its text; `None` if there is no room.
    ///
    /// The alignment fixes the side that faces the dot, because the viewer's font may be wider than this program's.
    fn place(&mut self, (x, y): (i32, i32), (width, height): (i32, i32)) -> Option<(HPos, (i32, i32))> {
        let half = height / 2;
        let beside = [
            (HPos::Left, y - half),
            (HPos::Right, y - half),
            (HPos::Center, y - 8 - height),
            (HPos::Center, y + 8),
            (HPos::Left, y - 6 - height),
            (HPos::Left, y + 6),
            (HPos::Right, y - 6 - height),
            (HPos::Right, y + 6),
        ];
        let place = |(side, top): (HPos, i32)| {
            let (at, left) = match side {
                HPos::Left => (x + 8, x + 8),
                HPos::Right => (x - 8, x - 8 - width),
                HPos::Center => (x, x - width / 2),
            };
            (side, (at, top), [left, top, left + width, top + height])
        };
        let apart = |a: &[i32; 4], b: &[i32; 4]| a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
        let free = |(.., room): &(HPos, (i32, i32), [i32; 4])| {
            let within = room[0] >= 66 && room[2] <= SIZE.0 as i32 - 8;
            within && self.taken.iter().all(|other| apart(room, other))
        };
        let (side, at, room) = beside.into_iter().map(place).find(free)?;
        self.taken.push(room);
        Some((side, at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64, name: &str) -> Point {
        Point { x, y, name: name.into() }
    }

    fn plot() -> Plot {
        Plot {
            bars: vec![Bar { x: (1.5, 2.5), y: 30.0 }],
            title: "Time and error".into(),
            x: Axis { label: "GPU ms".into(), logarithmic: true },
            y: Axis { label: "PSNR dB".into(), logarithmic: false },
            series: vec![
                Series {
                    name: "dominated".into(),
                    form: Form::Muted,
                    points: vec![point(2.0, 30.0, "slow")],
                },
                Series {
                    name: "front".into(),
                    form: Form::Line,
                    points: vec![
                        point(1.0, 40.0, "fast"),
                        point(3.0, 80.0, "exact"),
                        point(3.0, f64::INFINITY, "equal"),
                    ],
                },
            ],
        }
    }

    #[test]
    fn a_plot_is_drawn_with_its_names_and_without_what_is_not_finite() {
        let svg = plot().svg().unwrap();
        for text in ["Time and error", "GPU ms", "PSNR dB", "fast", "exact", "slow", "viewBox"] {
            assert!(svg.contains(text), "{text}: {svg}");
        }
        assert!(!svg.contains("equal") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(svg.contains("pointer-events=\"all\"><title>slow</title>"), "{svg}");
        assert!(!svg.contains("fit"), "all names have room: {svg}");
        let mut crowded = plot();
        crowded.series[0].points = (0..20).map(|at| point(2.0, 30.0, &format!("crowd <{at}>"))).collect();
        let crowded = crowded.svg().unwrap();
        let drawn = (0..20).filter(|at| crowded.contains(&format!("\ncrowd &lt;{at}&gt;\n"))).count();
        assert!(drawn > 0 && crowded.contains(&format!("\n{} names do not fit\n", 20 - drawn)), "{crowded}");
        assert_eq!(crowded.matches("<title>crowd &lt;").count(), 20, "{crowded}");
        let above = Plot { bars: vec![Bar { x: (1.5, 2.5), y: 150.0 }], ..plot() }.svg().unwrap();
        assert!(above.contains("\n140\n") && !svg.contains("\n140\n"), "{above}");
        let image = plot().image().unwrap();
        let of = |colour: RGBColor| {
            let wanted = [colour.0, colour.1, colour.2].map(|v| f32::from(v) / 255.0);
            image.rgb.iter().filter(|pixel| **pixel == wanted).count()
        };
        assert!(of(COLOURS[0]) > 100 && of(GREY) > 30, "the line and the dots are there");
        let dark = image.rgb.iter().filter(|pixel| pixel.iter().all(|v| *v < 0.4)).count();
        assert!(dark > 200, "so are the texts: {dark}");
    }

    #[test]
    fn ticks_are_round_numbers_within_the_range() {
        let labels = |values: &[f64], logarithmic: bool| {
            let on = |v: &f64| if logarithmic { v.log10() } else { *v };
            let ticks = Ticks::new(values.iter().map(on), logarithmic);
            ticks.at.iter().map(|at| ticks.label(*at)).collect::<Vec<_>>()
        };
        assert_eq!(labels(&[0.0, 100.0], false), ["0", "20", "40", "60", "80", "100"]);
        assert_eq!(labels(&[1000.0, 1e6], true), ["1000", "10 k", "100 k", "1 M"]);
        assert_eq!(labels(&[1.0, 10.0], true), ["1", "2", "5", "10"]);
        assert_eq!(labels(&[1.0, 1.4], true), ["1", "1.1", "1.2", "1.3", "1.4"]);
        assert!(labels(&[3.0], false).contains(&"3.00".to_owned()), "{:?}", labels(&[3.0], false));
        assert!(!labels(&[], true).is_empty());
    }

    #[test]
    fn names_do_not_lie_over_each_other() {
        let mut names = Names::default();
        let at = (400, 300);
        names.block(at);
        let mut boxes: Vec<[i32; 4]> = Vec::new();
        while let Some((side, (x, y))) = names.place(at, (60, 12)) {
            let left = match side {
                HPos::Left => x,
                HPos::Right => x - 60,
                HPos::Center => x - 30,
            };
            let next = [left, y, left + 60, y + 12];
            assert!(boxes.iter().all(|b| b[2] <= left || next[2] <= b[0] || b[3] <= y || next[3] <= b[1]));
            boxes.push(next);
        }
        assert!(boxes.len() >= 4, "{boxes:?}");
    }
}
