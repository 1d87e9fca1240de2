//! Presents a sweep: the table, the plots, and a page with the pictures.

use super::approach::{Closer, Fit, blending, fit};
use super::choice::Choice;
use super::measure::Step;
use crate::io::image::Image;
use crate::io::report::page::{Figure, Page};
use crate::io::report::plot::{Axis, Form, Plot, Point, Series};
use crate::io::report::text;
use crate::studies::measurement::error::{Error, joint_psnr, mean};
use crate::studies::measurement::time::{Time, phases};
use crate::studies::measurement::view::of_last_frame;
use crate::studies::provenance::Provenance;
use crate::studies::study::StudyError;
use indexmap::IndexSet;
use serde::{Deserialize, Serialize};
use splatgraph_assets::grouped;
use std::collections::BTreeSet;

/// File names of the plots, without extension.
pub const PLOTS: [&str; 5] = ["quality", "times", "trade", "shares", "approach"];

/// The inputs of a sweep.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Origin {
    /// The program, the device, the scene and the views.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Name or path of the graph.
    pub pipeline: String,
    /// Names and values of the graph's parameters.
    pub set: Vec<(String, String)>,
    /// Maximum number of rounds.
    pub rounds: u32,
    /// Frames per round; `None` if chosen from the time of a frame.
    pub frames: Option<u32>,
}

/// The results of a sweep.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SweepResult {
    /// The command that made the files. If it was `merge`, the line before has the command of a shard.
    pub command: String,
    /// The inputs on which the numbers depend.
    pub origin: Origin,
    /// Names of the views without steps.
    pub missing: Vec<String>,
    /// The steps of every view, first with all splats, then with fewer.
    pub steps: Vec<Step>,
    /// Steps of the first camera's approach; see [`super::approach`].
    pub closer: Vec<Closer>,
    /// The line fitted to the approach's times; `None` if [`fit()`] finds none.
    pub fit: Option<Fit>,
}

/// A picture of the first view, for the page.
pub struct Shown {
    /// The criterion by which the splats are chosen; `None` for all splats.
    pub choice: Option<Choice>,
    /// The number of splats that are kept.
    pub count: u32,
    /// Picture that the device drew.
    pub picture: Image,
}

/// The measurements of a choice with one number of splats, averaged over the views.
struct Mean {
    count: u32,
    psnr_db: f64,
    gpu_ms: Option<f64>,
    /// Phases, as [`phases`] lists them.
    phases: Vec<(String, f64, Option<f64>)>,
}

impl SweepResult {
    /// Adds measurements to a sweep without any, and derives the missing views and the fitted line from them.
    pub fn with(self, steps: Vec<Step>, closer: Vec<Closer>) -> SweepResult {
        let is_measured = |name: &str| steps.iter().any(|step| step.camera == name);
        let missing = self.origin.provenance.missing(is_measured);
        SweepResult { fit: fit(&closer), steps, closer, missing, ..self }
    }

    /// Returns a choice's measurements, from the fewest splats to all; empty if it was not measured.
    fn means(&self, choice: Choice) -> Vec<Mean> {
        let of = |step: &&Step| self.has(choice, step.choice);
        let counts: BTreeSet<u32> = self.steps.iter().filter(of).map(|step| step.count).collect();
        // The shared step with all splats does not show that this choice was measured.
        if !self.steps.iter().any(|step| step.choice == Some(choice)) {
            return Vec::new();
        }
        let of_count = |count: u32| {
            let steps: Vec<&Step> = self.steps.iter().filter(of).filter(|step| step.count == count).collect();
            let times: Option<Vec<_>> = steps.iter().map(|step| step.time.as_ref()).collect();
            Mean {
                count,
                psnr_db: joint_psnr(steps.iter().map(|step| step.error.psnr_db)),
                phases: phases(times.as_deref().unwrap_or_default()),
                gpu_ms: times.map(|times| mean(times.iter().map(|time| time.gpu_ms))),
            }
        };
        counts.into_iter().map(of_count).collect()
    }

    /// Returns true if a step of `other` belongs to a choice. The step with all splats belongs to every choice that has
    /// no own one.
    fn has(&self, choice: Choice, other: Option<Choice>) -> bool {
        let all = self.origin.provenance.splats;
        let has_own = || self.steps.iter().any(|step| step.choice == Some(choice) && step.count == all);
        other.map_or_else(|| !has_own(), |other| other == choice)
    }

    fn plot(&self, title: &str, x: Axis, y: Axis, point: impl Fn(&Mean) -> Option<(f64, f64)>) -> Plot {
        let series =
            |choice: Choice| Series::line(choice.name(), self.means(choice).iter().filter_map(&point));
        let series = Choice::ALL.map(series).into_iter().filter(|series| !series.points.is_empty());
        Plot { bars: Vec::new(), title: title.to_owned(), x, y, series: series.collect() }
    }

    /// Plots PSNR against the number of splats, without the step that draws all: the budget does not cause its error.
    pub fn quality(&self) -> Plot {
        let all = self.origin.provenance.splats;
        let point = |mean: &Mean| (mean.count < all).then_some((f64::from(mean.count), mean.psnr_db));
        self.plot("Quality of a budget of splats", splats(), psnr(), point)
    }

    /// Plots time against the number of splats.
    pub fn times(&self) -> Plot {
        let point = |mean: &Mean| Some((f64::from(mean.count), mean.gpu_ms?));
        self.plot("Time of a budget of splats", splats(), milliseconds(), point)
    }

    /// Plots PSNR against time, without the step that draws all splats.
    pub fn trade(&self) -> Plot {
        let all = self.origin.provenance.splats;
        let point = |mean: &Mean| (mean.count < all).then_some((mean.gpu_ms?, mean.psnr_db));
        self.plot("What a millisecond buys", milliseconds(), psnr(), point)
    }

    /// Plots each phase's share of the phases' time against the number of splats, for [`Choice::FileOrder`].
    pub fn shares(&self) -> Plot {
        let means = self.means(Choice::FileOrder);
        let names: IndexSet<&String> =
            means.iter().flat_map(|mean| mean.phases.iter().map(|(name, ..)| name)).collect();
        let series = |name: &String| {
            let share = |mean: &Mean| {
                let of = mean.phases.iter().map(|(_, ms, _)| ms).sum::<f64>();
                let (_, ms, _) = mean.phases.iter().find(|(own, ..)| own == name)?;
                Some((f64::from(mean.count), 100.0 * ms / of))
            };
            Series::line(name, means.iter().filter_map(share))
        };
        Plot {
            bars: Vec::new(),
            title: "Phases of a frame as the number of splats doubles (file order)".into(),
            x: splats(),
            y: Axis { label: "share of the phases' time, %".into(), logarithmic: false },
            series: names.into_iter().map(series).collect(),
        }
    }

    /// Plots the time of the blending against the fragments of the approach, with the fitted line if there is one.
    pub fn approach(&self) -> Plot {
        let drawn = |step: &Closer| {
            let (x, y) = (step.fragments as f64 / 1e6, blending(step.time.as_ref()?)?);
            let (width, height) = step.size;
            Some(Point { x, y, name: format!("{} of the distance, {width} x {height}", step.distance) })
        };
        let points: Vec<Point> = self.closer.iter().filter_map(drawn).collect();
        let mut series = vec![Series { name: "measured".into(), form: Form::Points, points }];
        if let Some(fit) = self.fit {
            let fragments = self.closer.iter().map(|step| step.fragments as f64);
            let (least, most) =
                fragments.fold((f64::INFINITY, 0.0), |(a, b), f| (f64::min(a, f), f64::max(b, f)));
            let on = |f: f64| (f / 1e6, fit.fixed_ms + fit.ns_per_fragment * f / 1e6);
            series.push(Series::line("fixed cost + cost per fragment", [on(least), on(most)]));
        }
        Plot {
            bars: Vec::new(),
            title: "Camera approach: cost against covered pixels x overlap".into(),
            x: Axis { label: "fragments blended, millions".into(), logarithmic: false },
            y: Axis { label: "GPU time of the blending, ms".into(), logarithmic: false },
            series,
        }
    }

    /// Says what the pictures of a graph that reads the previous frame do not show; `None` for other graphs.
    pub fn note(&self) -> Option<String> {
        let reads = self.steps.iter().any(|step| step.of_last_frame);
        reads.then(|| format!("`{}` reads the previous frame. {}", self.origin.pipeline, of_last_frame()))
    }

    fn title(&self) -> String {
        let Origin { provenance, pipeline, set, .. } = &self.origin;
        provenance.title(pipeline, set, self.missing.len())
    }

    /// Lists the plots with their file names and captions. Leaves out plots without points, such as times without
    /// timestamps.
    pub fn plots(&self) -> Vec<(&'static str, Plot, &'static str)> {
        let all = [
            (
                self.quality(),
                "Each step has half the splats of the one to its right, the first half of all. The truth is the exact picture of all splats.",
            ),
            (
                self.times(),
                match self.steps.iter().any(|step| step.choice == Some(Choice::Nearest)) {
                    true => {
                        "Choosing splats before keys are made saves time in every phase; cutting them after the sort saves time only in later phases."
                    }
                    false => "Splats are chosen before the passes that process them.",
                },
            ),
            (self.trade(), "Up and left is better."),
            (
                self.shares(),
                "Times of phases that process splats depend on their number, those of the blending on the pixels that they cover.",
            ),
            (
                self.approach(),
                "Closer, fewer splats cover more pixels each; in a smaller picture, the same splats cover fewer. Times bound by fragments lie on one line.",
            ),
        ];
        let title = self.title();
        let named = PLOTS.into_iter().zip(all).map(|(name, (plot, caption))| {
            (name, Plot { title: format!("{title}: {}", plot.title), ..plot }, caption)
        });
        named.filter(|(_, plot, _)| plot.series.iter().any(|series| !series.points.is_empty())).collect()
    }

    /// Formats the table for a terminal, with a row per step, averaged over the views. On a CPU, a warning about the
    /// times of phases follows.
    pub fn table(&self) -> String {
        let note = self.origin.provenance.note().map_or(String::new(), |note| format!("{note}\n"));
        text::table(self.header(), self.rows()) + &note
    }

    fn header(&self) -> Vec<String> {
        let fixed = ["choice", "splats", "PSNR dB", "GPU ms"].map(String::from);
        fixed.into_iter().chain(self.phases().into_iter().cloned()).collect()
    }

    /// Lists the phases of all steps, in order of execution.
    fn phases(&self) -> IndexSet<&String> {
        self.steps.iter().flat_map(|step| &step.time).flat_map(|time| time.phases.keys()).collect()
    }

    fn rows(&self) -> Vec<Vec<String>> {
        let mut rows = Vec::new();
        for choice in Choice::ALL {
            for mean in self.means(choice).iter().rev() {
                let phase =
                    |name: &str| mean.phases.iter().find(|(own, ..)| own == name).map(|(_, ms, _)| *ms);
                let mut row = vec![
                    choice.name().to_owned(),
                    grouped(mean.count.into()),
                    format!("{:.1}", mean.psnr_db),
                    text::number(mean.gpu_ms, 3),
                ];
                row.extend(self.phases().into_iter().map(|name| text::number(phase(name), 3)));
                rows.push(row);
            }
        }
        rows
    }

    /// Formats every step of every view as CSV (RFC 4180); missing values are empty, and an infinite PSNR is `inf`.
    pub fn csv(&self) -> String {
        let phases = self.phases();
        let mut header = String::from(
            "choice,camera,splats,visible,drawn,psnr_db,ssim,flip,worst,gpu_bytes,gpu_ms,spread_ms,of_all,of_all_low,of_all_high",
        );
        phases.iter().for_each(|phase| header += &format!(",{phase}_ms"));
        let line = |step: &Step| {
            let Error { psnr_db, ssim, flip, worst, .. } = &step.error;
            let time = step.time.as_ref();
            let mut cells = vec![
                text::quoted(step.choice.map_or("all", Choice::stem)),
                text::quoted(&step.camera),
                step.count.to_string(),
                text::optional(step.visible),
                text::optional(step.drawn),
                psnr_db.unwrap_or(f64::INFINITY).to_string(),
                text::optional(*ssim),
                flip.to_string(),
                worst.to_string(),
                step.gpu_bytes.to_string(),
                text::optional(time.map(|t| t.gpu_ms)),
                text::optional(time.and_then(|t| t.spread_ms)),
                text::optional(time.map(|t| t.share.median)),
                text::optional(time.and_then(|t| Some(t.share.range?.0))),
                text::optional(time.and_then(|t| Some(t.share.range?.1))),
            ];
            let phase = |name: &&String| text::optional(time.and_then(|t| t.phases.get(*name)));
            cells.extend(phases.iter().map(phase));
            cells.join(",")
        };
        let Origin { provenance, pipeline, set, .. } = &self.origin;
        let graph = [("pipeline", text::quoted(pipeline)), ("set", text::quoted(&text::parameters(set)))];
        provenance.csv(&header, self.steps.iter().map(line), &graph)
    }

    /// Makes the page as HTML, with pictures of the first view.
    ///
    /// # Errors
    /// A picture or a plot cannot be encoded.
    pub fn page(&self, shown: &[Shown]) -> Result<String, StudyError> {
        let Origin { provenance, pipeline, .. } = &self.origin;
        let mut page = Page::new(&format!("{}: what fewer splats cost and save", self.title()));
        page.text(&provenance.text(&self.missing));
        page.text("This command made the page:");
        page.block(&self.command);
        page.text(&format!(
            "Drawn by `{pipeline}`. Every step has half the splats of the one before, chosen in {} ways; the truth is \
             the exact renderer's picture of all splats. Times are medians, interleaved with frames of all splats.",
            self.series(),
        ));
        page.text(
            "`file order` keeps the first splats of the file, regardless of their importance. `opacity x world size` and \
             `opacity x screen size` are the usual heuristics for levels of detail: the product of opacity and of the two longest \
             semi-axes, in the world or on the screen of each view; both are applied before keys are made.",
        );
        if self.steps.iter().any(|step| step.choice == Some(Choice::Nearest)) {
            page.text(
                "`nearest, after the sort` draws the nearest of the visible splats, the same share of them as the others draw \
                 of all: fewer where some are outside of the view. It saves no work before the sort, which here sorts splats \
                 rather than pairs of a splat and a bin, also with all splats.",
            );
        }
        self.note().iter().for_each(|note| page.text(&format!("{note}.")));
        for text in self.findings() {
            page.text(&text);
        }
        for (_, plot, caption) in self.plots() {
            page.plot(&plot, caption)?;
        }
        page.heading("The approach");
        page.text("A camera moves towards the centre of the first view (an orthographic view is enlarged instead), then its picture shrinks. `fragments` is covered pixels times overlap.");
        if let Some(Fit { fixed_ms, ns_per_fragment, r_squared }) = self.fit {
            page.text(&format!(
                "Blending = {fixed_ms:.3} ms + {ns_per_fragment:.3} ns x fragments explains {:.1} % of the variance.",
                100.0 * r_squared
            ));
        }
        let row = |step: &Closer| {
            let time = |of: fn(&Time) -> Option<f64>| text::number(step.time.as_ref().and_then(of), 3);
            vec![
                step.distance.to_string(),
                format!("{} x {}", step.size.0, step.size.1),
                grouped(step.covered),
                format!("{:.1}", step.overlap),
                grouped(step.fragments),
                time(|time| Some(time.gpu_ms)),
                time(|time| time.phases.get("sort").copied()),
                time(blending),
            ]
        };
        let rows: Vec<_> = self.closer.iter().map(row).collect();
        page.table(
            &["distance", "picture", "covered pixels", "overlap", "fragments", "GPU ms", "sort", "blending"],
            &rows,
        );
        page.heading("All steps");
        let header = self.header();
        page.table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &self.rows());
        page.text("The phases are measured in other frames than `GPU ms`: timestamps at passes take time.");
        if let Some(note) = provenance.note() {
            page.text(note);
        }
        page.heading("Pictures of the first view");
        for choice in Choice::ALL {
            let own = |shown: &&Shown| self.has(choice, shown.choice);
            if !shown.iter().any(|shown| shown.choice == Some(choice)) {
                continue;
            }
            let small: Vec<(String, Image)> = shown
                .iter()
                .filter(own)
                .map(|s| {
                    (format!("{}: {} splats", choice.name(), grouped(s.count.into())), s.picture.reduced(480))
                })
                .collect();
            let figures: Vec<Figure> =
                small.iter().map(|(caption, image)| Figure { caption: caption.clone(), image }).collect();
            page.pictures(&figures)?;
        }
        Ok(page.html())
    }

    fn series(&self) -> usize {
        Choice::ALL.iter().filter(|choice| !self.means(**choice).is_empty()).count()
    }

    /// Describes the PSNR of every choice at a quarter of the splats, the best first; empty if no step has a quarter.
    fn findings(&self) -> Vec<String> {
        let quarter = self.origin.provenance.splats / 4;
        let at = |choice: Choice| {
            self.means(choice).into_iter().find(|mean| mean.count == quarter).map(|mean| (choice, mean))
        };
        let mut all: Vec<(Choice, Mean)> = Choice::ALL.into_iter().filter_map(at).collect();
        all.sort_by(|(_, a), (_, b)| b.psnr_db.total_cmp(&a.psnr_db));
        let Some((best, mean)) = all.first() else { return Vec::new() };
        let mut text = format!(
            "With a quarter of the splats, `{}` is the closest to the truth: {:.1} dB.",
            best.name(),
            mean.psnr_db
        );
        for (choice, other) in &all[1..] {
            text += &format!(" `{}`: {:.1} dB.", choice.name(), other.psnr_db);
        }
        vec![text]
    }
}

fn splats() -> Axis {
    Axis { label: "splats".into(), logarithmic: true }
}

fn psnr() -> Axis {
    Axis { label: "PSNR against the truth, dB".into(), logarithmic: false }
}

fn milliseconds() -> Axis {
    Axis { label: "GPU time of a frame, ms".into(), logarithmic: true }
}
