//! Blends a scene's splats in four ways, and with depth keys of several widths.
//!
//! A splat's contribution to a pixel is multiplied by the transmittances of the splats in front of it. Each wrong way
//! of blending changes the index set of this product. [`measure`] draws all ways, and measures the errors of the
//! picture and of the order; [`page`] presents them.

use super::exact::{self, GAIN, decibels, draw};
use super::two::{self, Two};
use super::ways::WAYS;
use crate::draw::capture;
use crate::draw::session::Session;
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::io::report::page::{Figure, Page};
use crate::io::report::plot::{Axis, Form, Plot, Point, Series};
use crate::studies::study::{Listener, Steps, StudyError};
use splatgraph_assets::Camera;
use splatgraph_reference::metrics::{self, Comparison};
use splatgraph_reference::{Rules, depth_order};

const KEY_BITS: [u32; 9] = [8, 10, 12, 14, 16, 20, 24, 28, 32];

/// A picture, and its error against the exact one.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Name of the picture on the page.
    pub name: String,
    /// The picture, as drawn by the device.
    pub image: Image,
    /// Error against the exact picture.
    pub error: Comparison,
    /// Number of pairs of splats in the wrong order in the order buffer. `None` if it cannot be read, repeats a splat,
    /// or has one that the true order lacks.
    pub inversions: Option<u64>,
    /// Number of pairs of splats that are blended in the wrong order; `None` if `inversions` is `None`.
    pub wrong: Option<u64>,
    /// Total number of pairs of splats in the order buffer; 0 if it cannot be read.
    pub pairs: u64,
}

/// The measurements of the experiment.
pub struct Order {
    /// The scene and the view, in words.
    pub view: String,
    /// The exact picture.
    pub truth: Image,
    /// The pictures of all [`WAYS`] of blending.
    pub ways: Vec<Drawn>,
    /// The picture for each width of the depth keys, with the width in bits.
    pub keys: Vec<(u32, Drawn)>,
    /// Worked example of two splats.
    pub two: Two,
}

/// Draws and measures every way of blending and every key width. Changes the session's graph.
///
/// # Errors
/// The graph has errors, a picture cannot be compared, the device fails, the exact picture does not fit in memory, or
/// the listener cancels.
pub fn measure(
    session: &mut Session,
    camera: &Camera,
    view: String,
    listener: &mut dyn Listener,
) -> Result<Order, StudyError> {
    let mut steps = Steps::new(listener, "experiment order", 2 + WAYS.len() + KEY_BITS.len());
    steps.next("the exact picture")?;
    let rules = Rules::of(session.scene());
    let truth = Truth::draw(session.scene(), camera, [0.0; 3], &rules)?.image();
    let order = depth_order(session.scene(), camera, &rules);
    let exact = exact::values(session, (camera.width, camera.height))?;

    let mut drawn = |name: &str, set: &[(&str, &str)], reversed: bool| -> Result<Drawn, StudyError> {
        let capture = draw(session, &exact, set, camera)?;
        let error = metrics::compare((&capture.image).into(), (&truth).into())?;
        let count = capture.order.as_ref().map_or(0, |order| order.len() as u64);
        let pairs = count * count.saturating_sub(1) / 2;
        let inversions = capture.order.and_then(|given| capture::wrong_pairs(&order, &given));
        let wrong = inversions.map(|found| if reversed { pairs - found } else { found });
        Ok(Drawn { name: name.to_owned(), image: capture.image, error, inversions, wrong, pairs })
    };
    let mut ways = Vec::new();
    for way in &WAYS {
        steps.next(way.name)?;
        // The order is reversed if `over` blends the nearest first, or `under` the farthest.
        ways.push(drawn(way.name, way.set, way.nearest_first != way.under)?);
    }
    let mut keys = Vec::new();
    for bits in KEY_BITS {
        steps.next(&format!("keys of {bits} bits"))?;
        let value = bits.to_string();
        keys.push((bits, drawn(&format!("{bits} bits"), &[("key_bits", &value)], false)?));
    }
    steps.next("two splats")?;
    Ok(Order { view, truth, ways, keys, two: two::work_out(session)? })
}

/// Makes the page of the experiment.
///
/// # Errors
/// A picture or a plot cannot be encoded.
pub fn page(found: &Order) -> Result<Page, StudyError> {
    let mut page = Page::new("The order of splats");
    page.text(&found.view);
    page.text(
        "Splats are translucent, so the picture depends on the order in which they are blended. With the splats of a pixel \
         numbered from near to far, with alphas a_i and colours c_i, the pixel's colour is",
    );
    page.formula(r"C = \sum_i c_i a_i \prod_{j < i} (1 - a_j)");
    page.text(
        "Each splat is dimmed by those in front of it. The pictures below have the same splats, the same a_i and the same c_i; \
         only the index set of the product differs, and with it the picture.",
    );
    four_ways(&mut page, found)?;
    worked_example(&mut page, &found.two)?;
    keys(&mut page, found)?;
    page.heading("Sources");
    page.text(
        "The operators `over` and `under`: T. Porter, T. Duff, Compositing Digital Images, SIGGRAPH 1984. The exact pictures \
         were drawn by `splatgraph render --backend reference`, in 64-bit floats; the others by the graph `splat`, with every \
         parameter at its exact value except for those named.",
    );
    Ok(page)
}

fn four_ways(page: &mut Page, found: &Order) -> Result<(), StudyError> {
    page.heading("Four ways of blending");
    let pictures: Vec<Figure> = found
        .ways
        .iter()
        .map(|way| Figure {
            caption: format!("{}: {} dB", way.name, decibels(way.error.psnr_db)),
            image: &way.image,
        })
        .collect();
    page.rows(2, &pictures)?;
    let count = |count: Option<u64>| count.map_or("-".into(), |count| count.to_string());
    let rows: Vec<Vec<String>> = found
        .ways
        .iter()
        .map(|way| {
            vec![
                way.name.clone(),
                decibels(way.error.psnr_db),
                format!("{:.4}", way.error.worst.difference),
                count(way.inversions),
                count(way.wrong),
                way.pairs.to_string(),
            ]
        })
        .collect();
    page.table(
        &["way", "PSNR dB", "worst pixel", "wrong in the list", "wrong as blended", "pairs of splats"],
        &rows,
    );
    page.text("`worst pixel` is the largest difference of a channel. Values are not clamped, unlike those of `PSNR dB`.");
    let share = |way: &Drawn| match way.wrong {
        Some(wrong) => format!("{:.0} % of them", 100.0 * wrong as f64 / way.pairs.max(1) as f64),
        None => "some of them".into(),
    };
    page.text(&format!(
        "`wrong in the list` counts the pairs of visible splats in the order buffer that are not in depth order. `wrong as \
         blended` counts those in which the farther splat dims the nearer: a sorted list that is blended from the wrong end \
         has all of its pairs wrong, and the order of the file has {}. A pair matters only where its splats overlap, so the \
         errors do not follow from these numbers alone. Where a sorted list has wrong pairs, their depths are equal or differ \
         in the last bits of 32, which a device that rounds `fma` twice may compute differently.",
        share(&found.ways[0])
    ));
    page.text(&format!("Differences from the exact picture, {GAIN} times as large:"));
    let differences: Vec<Image> =
        found.ways.iter().map(|way| Image::difference(&way.image, &found.truth, GAIN)).collect();
    let pictures: Vec<Figure> = found
        .ways
        .iter()
        .zip(&differences)
        .map(|(way, image)| Figure {
            caption: format!("{}, difference: at most {:.4}", way.name, way.error.worst.difference),
            image,
        })
        .collect();
    page.rows(2, &pictures)?;
    for way in &WAYS {
        page.text(&format!("`{}`", way.name));
        page.formula(way.sum);
        page.text(way.why);
    }
    Ok(())
}

fn worked_example(page: &mut Page, two: &Two) -> Result<(), StudyError> {
    let triple = |color: [f64; 3]| format!("({:.3}, {:.3}, {:.3})", color[0], color[1], color[2]);
    page.heading("Two splats, step by step");
    let [near, far] = two.layers;
    page.text(&format!(
        "An orange splat covers part of a blue one. At the pixel in the middle of the picture, the near one has a_1 = {:.4} and \
         c_1 = {}, the far one a_2 = {:.4} and c_2 = {}; both were read from exact pictures of each splat alone. The file has the \
         blue one first.",
        near.alpha,
        triple(near.color),
        far.alpha,
        triple(far.color),
    ));
    let mut pictures: Vec<Figure> =
        two.ways.iter().map(|way| Figure { caption: way.way.name.to_owned(), image: &way.image }).collect();
    pictures.push(Figure { caption: "the exact renderer".into(), image: &two.image });
    page.rows(5, &pictures)?;
    let off = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max);
    let rows: Vec<Vec<String>> = two
        .ways
        .iter()
        .map(|blended| {
            let steps: Vec<String> = blended.steps[1..]
                .iter()
                .map(|(sum, left)| {
                    triple(*sum) + &left.map_or(String::new(), |left| format!(", T {left:.3}"))
                })
                .collect();
            vec![
                blended.way.name.to_owned(),
                steps.join(" → "),
                triple(blended.drawn),
                format!("{:.1e}", off(blended.computed(), blended.drawn)),
                format!("{:.4}", off(blended.drawn, two.exact)),
            ]
        })
        .collect();
    page.table(
        &[
            "way",
            "C after each step, by the formula",
            "C as drawn",
            "difference from the formula",
            "difference from the exact renderer",
        ],
        &rows,
    );
    page.text(&format!(
        "The exact renderer computes {}. Both correct ways reach it by different steps: `over` dims the sum so far by the \
         splat that it adds, `under` dims the splat that it adds by the transmittance T of the sum so far. Two splats have one \
         wrong order, so both wrong ways agree here; n splats have n! orders, and the naive way uses the reversed one.",
        triple(two.exact)
    ));
    Ok(())
}

fn keys(page: &mut Page, found: &Order) -> Result<(), StudyError> {
    page.heading("How much of the order is wrong");
    page.text(
        "Splats are sorted by a key computed from their depth. A key with fewer bits takes less time to sort, and maps close \
         depths to equal keys, which keep the order of the file. The error grows with the number of pairs swapped by this, but \
         the splats of each pair are close in depth, so it takes many pairs to matter.",
    );
    let on = |drawn: &Drawn, name: &str| {
        let (wrong, db) = (drawn.wrong?, drawn.error.psnr_db?);
        Some(Point { x: wrong as f64, y: db, name: name.to_owned() })
    };
    let line = found.keys.iter().filter_map(|(_, drawn)| on(drawn, &drawn.name)).collect();
    let others = [&found.ways[0], &found.ways[2]].into_iter().filter_map(|way| on(way, &way.name)).collect();
    let plot = Plot {
        bars: Vec::new(),
        title: "Wrong pairs and error, for keys of 8 to 32 bits and the two wrong ways".into(),
        x: Axis { label: "pairs of splats blended in the wrong order".into(), logarithmic: true },
        y: Axis { label: "PSNR against the exact picture, dB".into(), logarithmic: false },
        series: vec![
            Series { name: String::new(), form: Form::Line, points: line },
            Series { name: String::new(), form: Form::Points, points: others },
        ],
    };
    let right = found.keys.iter().filter(|(_, drawn)| drawn.wrong == Some(0));
    let right: Vec<String> = right.map(|(bits, _)| bits.to_string()).collect();
    let note = match right.as_slice() {
        [] => String::new(),
        widths => format!(
            " Keys of {} bits have no wrong pairs and cannot be shown on a logarithmic axis; their error is that of the quads.",
            widths.join(", ")
        ),
    };
    page.plot(&plot, &format!("Each point is a picture of the view above.{note}"))?;
    let rows: Vec<Vec<String>> = found
        .keys
        .iter()
        .map(|(bits, drawn)| {
            vec![
                format!("`key_bits = {bits}`"),
                drawn.wrong.map_or("-".into(), |count| count.to_string()),
                drawn.wrong.map_or("-".into(), |count| {
                    format!("{:.4} %", 100.0 * count as f64 / drawn.pairs.max(1) as f64)
                }),
                decibels(drawn.error.psnr_db),
                format!("{:.4}", drawn.error.worst.difference),
            ]
        })
        .collect();
    page.table(&["key", "wrong pairs", "of all pairs", "PSNR dB", "worst pixel"], &rows);
    Ok(())
}
