//! Runs `splatgraph evaluate`: scores a scene against the photographs of its dataset.

mod drawer;
mod shared;
mod work;

pub use shared::{COMMAND, Views, merge};
pub use work::{Args, prepare};

use crate::cli::job::{self, Manifest};
use crate::cli::options;
use crate::cli::outcome::{Outcome, validated};
use crate::draw::blind;
use crate::io::output::names;
use crate::io::output::{one_line, say};
use crate::io::progress::Progress;
use crate::studies::evaluation::{Evaluation, Score};
use anyhow::Result;
use drawer::{Drawer, ORIGIN, as_json, origin, request, save};
use work::{FOLDERS, Work, picture};

pub fn run(args: &Args) -> Result<Outcome> {
    // Errors of the command line and of the dataset are reported before a large scene is loaded.
    let mut work = prepare(args)?;
    let mut others = Vec::new();
    if let Some(output) = &args.output {
        Manifest::refuse(output)?;
        let of = |folder: &str| {
            let own = work.stems.iter().map(|stem| picture(output, folder, stem)).collect();
            names::others(&output.join(folder), "png", &own)
        };
        others.extend(FOLDERS.into_iter().filter_map(of));
    }
    let mut drawer = Drawer::open(args, &mut work, None)?;
    work.tell_training(args, drawer.scene());
    drawer.note().iter().for_each(say);
    let Work { views, stems, downscale, downscaled, split, .. } = work;
    let mut progress = Progress::new("scoring");
    let (mut scores, mut missing, mut blind) = (Vec::with_capacity(views.len()), Vec::new(), Vec::new());
    for (index, (view, stem)) in views.iter().zip(&stems).enumerate() {
        progress.set(index as u64, views.len() as u64, &view.name);
        // Errors of the device and the disk end the run: they would repeat for each view.
        let score = match view.load(downscale, args.background) {
            Ok((camera, photograph, mask)) => {
                let drawn = drawer.draw(&camera, args.background)?;
                let scene = drawer.scene();
                // A view whose exact picture does not fit in memory counts as one that sees splats.
                let in_scene = camera.relative_to(scene.offset());
                if blind::sees(scene, &in_scene) == Ok(false) {
                    blind.push(in_scene);
                }
                save(args, stem, &drawn, &photograph, mask.as_deref())?;
                let score = view.score(&drawn, &photograph, mask.as_deref());
                score.map(|score| Score { too_near: drawer.too_near(&camera), ..score })
            }
            Err(error) => Err(error),
        };
        match score {
            Ok(score) => scores.push(score),
            Err(error) => {
                let text = format!("{}: {}", one_line(&view.name), job::reason(&error).trim());
                progress.suspend(|| say(text));
                missing.push(view.name.clone());
            }
        }
    }
    if let Drawer::Device(session, _) = &mut drawer {
        let note = session.background_note(args.background);
        progress.suspend(|| session.settings_without_effect().iter().chain(&note).for_each(say));
    }
    drop(progress);
    blind::told(drawer.scene(), &blind, views.len()).iter().for_each(say);
    others.iter().for_each(say);
    let found = Evaluation::new(scores, missing);
    found.grey_note().iter().for_each(say);
    // If no camera sees a splat, the reason was given above.
    found.near_note().iter().filter(|_| blind.len() < found.views.len()).for_each(say);
    // The table comes last, because standard output may be full or closed.
    if let Some(path) = &args.json {
        let mut request = request(args);
        request[ORIGIN] = origin(&mut drawer, downscaled.as_deref(), split)?;
        options::write_text(Some(path), &(as_json(request, &found) + "\n"))?;
    }
    options::print_beside(args.json.as_deref(), &found.table())?;
    let outcome = match drawer {
        Drawer::Device(session, _) => validated(args.device.validate, &session.into_device().close()),
        Drawer::Reference(_) => Outcome::Done,
    };
    Ok(if found.missing.is_empty() { outcome } else { Outcome::Failed })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;

    #[test]
    fn names_that_are_not_utf_8_are_text_in_the_json() {
        let name = || OsString::from_vec(b"p\xff".to_vec());
        let option = |name: &str| OsString::from(name);
        let words = [option("evaluate"), name(), option("-c"), name(), option("--photographs"), name()];
        let request = request(&parsed(words).expect("a command line"));
        for field in ["scene", "dataset", "photographs"] {
            assert_eq!(request[field], "p\u{fffd}", "{field}");
        }
    }
}
