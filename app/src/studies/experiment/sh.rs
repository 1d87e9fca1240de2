//! Measures the error of leaving out bands of the harmonics, where colours depend most on the viewing direction.
//!
//! A splat's colour is a function of the direction, stored as the first coefficients of its expansion in real spherical
//! harmonics. The basis is orthonormal, so the mean square error over all directions is the sum of the omitted squared
//! coefficients over 4 pi. [`measure`] draws the glossiest part of a picture ([`gloss`]) from several directions with
//! bands up to each degree; [`page`] compares the errors with that sum.

use super::exact::{self, GAIN, decibels, draw};
use super::gloss::{self, Part};
use crate::draw::orbit;
use crate::draw::session::Session;
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::io::report::page::{Figure, Page};
use crate::studies::advise::harmonics::{Energy, energy};
use crate::studies::study::{Listener, Steps, StudyError};
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::metrics::{self, squared_error};
use splatgraph_reference::{Rules, Splats, check_memory};
use std::f64::consts::PI;

/// Angles by which a single camera is turned around the part, in degrees: positive to the camera's left.
pub const DEGREES: [f64; 3] = [-30.0, 0.0, 30.0];

/// A picture drawn with bands up to some degree, and its PSNR against two pictures with all bands.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Picture that the device drew.
    pub image: Image,
    /// PSNR against the device's picture with all bands, in decibels; `None` if they are equal.
    pub to_all: Option<f64>,
    /// PSNR against the exact renderer's picture with all bands, in decibels; `None` if they are equal.
    pub to_exact: Option<f64>,
}

/// The pictures from one direction.
#[derive(Clone, Debug)]
pub struct Direction {
    /// The direction, in words.
    pub name: String,
    /// The exact renderer's picture with all bands.
    pub exact: Image,
    /// The pictures with bands up to 0, 1, and so on.
    pub degrees: Vec<Drawn>,
}

/// The glossiest part of a picture, drawn from several directions.
#[derive(Clone, Debug)]
pub struct Glossy {
    /// Position and energy of the part in the first camera's picture.
    pub part: Part,
    /// The first camera's whole picture.
    pub overview: Image,
    /// The pictures of the part.
    pub directions: Vec<Direction>,
}

/// The measurements of the experiment.
pub struct Sh {
    /// The scene and the view, in words.
    pub view: String,
    /// The degree that the file stores, and the highest band with a nonzero coefficient.
    pub degree: [u32; 2],
    /// The mean energy of each band over all splats.
    pub all: Energy,
    /// The glossy part; `None` without cameras, or if no colour in the picture depends on the direction.
    pub glossy: Option<Glossy>,
}

/// Draws the glossiest part with bands up to each degree, and measures the errors. Changes the session's graph.
///
/// Several cameras are used as the directions. A single camera is turned around the part by each of [`DEGREES`].
/// Without cameras, or if nothing in the first picture depends on the direction, [`Sh::glossy`] is `None`.
///
/// # Errors
/// The graph has errors, a picture cannot be compared, the device fails, an exact picture does not fit in memory, or
/// the listener cancels.
pub fn measure(
    session: &mut Session,
    cameras: &[Camera],
    view: String,
    listener: &mut dyn Listener,
) -> Result<Sh, StudyError> {
    let scene = session.scene();
    let degree = [scene.stored_degree(), scene.effective_degree()];
    let all = mean_energy(scene);
    let of = 2 + DEGREES.len().max(cameras.len()) + degree[1] as usize;
    let mut steps = Steps::new(listener, "experiment sh", of);
    steps.next("the glossiest part")?;
    let found = cameras.first().filter(|_| degree[1] > 0);
    found.map_or(Ok(()), |first| check_memory(session.scene(), first, &Rules::PUBLISHED))?;
    let found = found.and_then(|first| Some((first, gloss::find(session.scene(), first)?)));
    let Some((first, part)) = found else { return Ok(Sh { view, degree, all, glossy: None }) };

    let views = views(cameras, first, &part);
    let exact = exact::values(session, (first.width, first.height))?;
    let overview = draw(session, &exact, &[], first)?.image;
    let mut directions = Vec::new();
    for (name, camera) in &views {
        steps.next(&format!("the exact picture, {name}"))?;
        let exact = Truth::draw(session.scene(), camera, [0.0; 3], &Rules::of(session.scene()))?.image();
        directions.push(Direction { name: name.clone(), exact, degrees: Vec::new() });
    }
    // Degrees are the outer loop, because each needs its own plan.
    let mut pictures: Vec<Vec<Image>> = vec![Vec::new(); views.len()];
    for highest in 0..=degree[1] {
        steps.next(&format!("bands up to {highest}"))?;
        for ((_, camera), pictures) in views.iter().zip(&mut pictures) {
            let value = highest.to_string();
            pictures.push(draw(session, &exact, &[("sh_degree", &value)], camera)?.image);
        }
    }
    for (direction, pictures) in directions.iter_mut().zip(pictures) {
        let Some(with_all) = pictures.last().cloned() else { continue };
        for image in pictures {
            let to_all = metrics::compare((&image).into(), (&with_all).into())?.psnr_db;
            let to_exact = metrics::compare((&image).into(), (&direction.exact).into())?.psnr_db;
            direction.degrees.push(Drawn { image, to_all, to_exact });
        }
    }
    Ok(Sh { view, degree, all, glossy: Some(Glossy { part, overview, directions }) })
}

fn mean_energy(scene: &Scene) -> Energy {
    let count = Splats::count(scene);
    let sums = (0..count).fold([0.0; 4], |sums: Energy, index| {
        let energy = energy(&Splats::get(scene, index).sh);
        std::array::from_fn(|band| sums[band] + energy[band])
    });
    sums.map(|sum| sum / count.max(1) as f64)
}

/// Lists named cameras that show only the part, at half the first picture's size.
fn views(cameras: &[Camera], first: &Camera, part: &Part) -> Vec<(String, Camera)> {
    let size = (first.width.div_ceil(2), first.height.div_ceil(2));
    let close = |camera: &Camera| orbit::facing(camera, part.point, f64::from(gloss::SHARE), size);
    if cameras.len() > 1 {
        return cameras.iter().map(|camera| (camera.img_name.clone(), close(camera))).collect();
    }
    let name = |degrees: f64| if degrees == 0.0 { "0°".into() } else { format!("{degrees:+.0}°") };
    DEGREES.map(|degrees| (name(degrees), close(&orbit::turned(first, part.point, degrees)))).into()
}

/// Formats a range of bands, such as `bands 1 to 3`.
fn bands(first: u32, last: u32) -> String {
    if first == last { format!("band {first}") } else { format!("bands {first} to {last}") }
}

/// Makes the page of the experiment.
///
/// # Errors
/// A picture cannot be encoded.
pub fn page(found: &Sh) -> Result<Page, StudyError> {
    let mut page = Page::new("Bands of spherical harmonics");
    page.text(&found.view);
    page.text(
        "A splat's colour depends on the viewing direction v. Each channel is a sum of real spherical harmonics; band \
         l has 2 l + 1 of them, and a scene of degree D stores the bands up to D:",
    );
    page.formula(
        r"\text{colour}(v) = \max\left(0, \frac{1}{2} + \sum_{l=0}^{D} \sum_{m=-l}^{l} c_{lm} Y_{lm}(v)\right)",
    );
    page.text(
        "Band 0 is one colour for all directions, band 1 adds a slope, and the higher bands add finer and finer lobes. Leaving \
         out bands reduces file size and work. The functions Y_lm are orthonormal over the sphere, so all products of two \
         different ones average to 0, and the error is known in advance:",
    );
    page.formula(
        r"\frac{1}{4 \pi} \int \left(\sum_{l > d} \sum_m c_{lm} Y_{lm}(v)\right)^2 dv = \frac{1}{4 \pi} \sum_{l > d} \sum_m c_{lm}^2",
    );
    let [stored, highest] = found.degree;
    page.text(&format!("The scene stores degree {stored}; its highest band that is not zero is {highest}."));
    match &found.glossy {
        None if highest == 0 => {
            page.text("The scene has degree 0 only: every colour is the same from all directions, and there is nothing to leave out.")
        }
        None => page.text("No splat in this picture has a colour that depends on the direction: another camera may see one."),
        Some(glossy) => pictures(&mut page, glossy, highest)?,
    }
    energies(&mut page, found);
    page.heading("Sources");
    page.text(
        "The energy of a function in bands, and how few of them a smooth one needs: R. Ramamoorthi, P. Hanrahan, An Efficient \
         Representation for Irradiance Environment Maps, SIGGRAPH 2001. The basis: P.-P. Sloan, Efficient Spherical Harmonic \
         Evaluation, JCGT 2(2), 2013. The exact pictures were drawn by `splatgraph render --backend reference`; the others by \
         the graph `splat`, with every parameter except `sh_degree` at its exact value.",
    );
    Ok(page)
}

fn pictures(page: &mut Page, glossy: &Glossy, highest: u32) -> Result<(), StudyError> {
    let Glossy { part, overview, directions } = glossy;
    page.heading("The glossiest part");
    page.text(&format!(
        "The frame marks the window, a third of the picture in each direction, in which bands 1 to 3 have the most energy: \
         columns {} to {}, rows {} to {}. Each splat is weighted by its opacity, by its area in pixels and by the splats in \
         front of it, because the exact renderer drew the energies in place of the colours.",
        part.corner[0],
        part.corner[0] + part.size[0] - 1,
        part.corner[1],
        part.corner[1] + part.size[1] - 1,
    ));
    page.pictures(&[Figure {
        caption: "The whole picture, with all bands".into(),
        image: &framed(overview, part),
    }])?;

    page.heading("What each band adds");
    page.text(&format!(
        "Rows: viewing directions of the part. Columns: the highest band drawn; below each picture, its difference from the \
         one with all bands, {GAIN} times as large. With band 0 alone, surface colours do not change as the camera moves, as \
         if they were painted on."
    ));
    for Direction { name, exact, degrees } in directions {
        let columns = degrees.len();
        let mut figures: Vec<Figure> = degrees
            .iter()
            .zip(0..)
            .map(|(drawn, degree)| Figure {
                caption: format!("{name}, {}: {} dB", bands(0, degree), decibels(drawn.to_exact)),
                image: &drawn.image,
            })
            .collect();
        let Some(all) = degrees.last() else { continue };
        let differences: Vec<Image> =
            degrees.iter().map(|drawn| Image::difference(&drawn.image, &all.image, GAIN)).collect();
        figures.extend(differences.iter().take(columns - 1).zip(1..).map(|(image, first)| Figure {
            caption: format!("what is missing without {}", bands(first, highest)),
            image,
        }));
        figures.push(Figure { caption: format!("{name}, the exact renderer"), image: exact });
        page.rows(columns, &figures)?;
    }
    errors(page, glossy, highest);
    Ok(())
}

/// Adds the table of errors: measured, and predicted from the sum of squares.
fn errors(page: &mut Page, glossy: &Glossy, highest: u32) {
    let Glossy { part, directions, .. } = glossy;
    page.heading("The error, measured and from the sum");
    let mut header = vec!["highest band".to_owned(), "coefficients".into(), "left out, from the sum".into()];
    header.extend(["left out, measured".to_owned(), "as PSNR dB".into()]);
    header.extend(directions.iter().map(|direction| format!("{}, dB to exact", direction.name)));
    let rows: Vec<Vec<String>> = (0..=highest as usize)
        .map(|degree| {
            // `sum` of an empty iterator is -0.0.
            let predicted = part.within[degree..].iter().fold(0.0, |sum, energy| sum + energy);
            let errors = directions.iter().map(|direction| squared_error(direction.degrees[degree].to_all));
            let measured = errors.sum::<f64>() / directions.len() as f64;
            let psnr = (measured > 0.0).then(|| -10.0 * measured.log10());
            let mut row = vec![degree.to_string(), (degree + 1).pow(2).to_string()];
            row.extend([format!("{predicted:.2e}"), format!("{measured:.2e}"), decibels(psnr)]);
            row.extend(directions.iter().map(|direction| decibels(direction.degrees[degree].to_exact)));
            row
        })
        .collect();
    page.table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows);
    page.text(
        "`left out, from the sum` is the mean square of the higher bands over all directions, for the splats visible in the \
         window; `left out, measured` is the mean squared difference of the pictures above from those with all bands, over \
         these directions only. With the weights that splats have in this view, the mean error over all directions cannot \
         exceed the sum: a pixel is a weighted sum of splats, with a total weight of at most 1, so its square is at most the \
         weighted sum of the squares (Jensen), and clamping at 0 and at the limits of the display only brings values closer. \
         The error is smaller where the lobes of neighbours differ and cancel. Over a few directions it can be larger: a \
         highlight may fill the picture or be absent.",
    );
}

fn energies(page: &mut Page, found: &Sh) {
    page.heading("The energy of each band");
    let part = found.glossy.as_ref().map(|glossy| &glossy.part);
    let total: f64 = found.all[1..].iter().sum();
    let share =
        |value: f64, of: f64| if of > 0.0 { format!("{:.1} %", 100.0 * value / of) } else { "-".into() };
    let rows: Vec<Vec<String>> = (0..4)
        .map(|band| {
            let energy = found.all[band];
            let mut row = vec![band.to_string(), (2 * band + 1).to_string(), format!("{energy:.3e}")];
            let above = band.checked_sub(1);
            row.push(above.map_or("-".into(), |_| share(energy, total)));
            for of in [part.map(|part| part.whole), part.map(|part| part.within)] {
                let value = above.zip(of).map(|(at, of)| format!("{:.3e}", of[at]));
                row.push(value.unwrap_or_else(|| "-".into()));
            }
            let within = above.zip(part).map(|(at, part)| share(part.within[at], part.within.iter().sum()));
            row.push(within.unwrap_or_else(|| "-".into()));
            row
        })
        .collect();
    let header = [
        "band",
        "functions",
        "all splats",
        "of bands 1 to 3",
        "in the picture",
        "in the window",
        "of bands 1 to 3 there",
    ];
    page.table(&header, &rows);
    page.text(&format!(
        "The energy of a band is its mean square over the sphere, 1 / (4 pi) = {:.5} times the sum of its squared coefficients, \
         averaged over the three channels. `all splats` is the mean over the file. In the picture and in the window, each \
         splat is weighted by its visible part.",
        1.0 / (4.0 * PI)
    ));
}

/// Draws a red border just inside the part's edges, two pixels wide.
fn framed(image: &Image, part: &Part) -> Image {
    let distance = |at: usize, axis: usize| {
        let (first, last) = (part.corner[axis] as i64, (part.corner[axis] + part.size[axis]) as i64 - 1);
        let at = at as i64;
        // Distance from the nearer edge, in pixels; negative outside the part.
        (at - first).min(last - at)
    };
    Image::from_fn(image.width, image.height, |x, y| match distance(x, 0).min(distance(y, 1)) {
        0 | 1 => [1.0, 0.2, 0.2],
        _ => image.at(x, y),
    })
}
