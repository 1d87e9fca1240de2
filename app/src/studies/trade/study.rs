//! Measures every setting of a graph in every view, and keeps the rows in a file.

use super::ledger::{Book, Ledger, Origin};
use super::measure::measure;
use super::pictures::Album;
use crate::draw::interleaved::Frames;
use crate::draw::session::Session;
use crate::io::image::Image;
use crate::studies::measurement::plans::to_measure;
use crate::studies::measurement::settings;
use crate::studies::measurement::time::Baseline;
use crate::studies::measurement::view::View;
use crate::studies::study::{Listener, Setting, Steps, StudyError, Subject};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::path::PathBuf;

/// The request of the study.
pub struct Wanted {
    /// The graph whose parameters are changed.
    pub pipeline: String,
    /// Parameters that have a value in every setting.
    pub set: Vec<(String, String)>,
    /// Beginnings of the names of the settings to measure; empty for all.
    pub only: Vec<String>,
    /// The numbers of frames.
    pub frames: Frames,
    /// True pictures, one for each camera, with a name of them all; `None` for the exact renderer's.
    pub truths: Option<(String, Vec<Image>)>,
    /// Description of the opened device: a ledger keeps no rows of one that was opened otherwise.
    pub opened: String,
    /// The file of the ledger, from which an interrupted study resumes. Pictures of the settings go into a folder beside it.
    pub file: PathBuf,
}

/// Measures settings, and returns the ledger with the rows of all that were wanted.
///
/// # Errors
/// The graph has errors, no setting has a name of [`Wanted::only`], the device fails, a file cannot be written, or the listener cancels.
pub fn study<D: Device>(
    subject: &Subject<D>,
    wanted: &Wanted,
    listener: &mut dyn Listener,
) -> Result<Ledger, StudyError> {
    let Subject { scene, cameras, .. } = subject;
    let camera = subject.first()?;
    let mut session = subject.session(&wanted.pipeline, &wanted.set)?;
    let settings = chosen(wanted, &mut session, camera)?;
    let mut exact = subject.session(&settings[0].pipeline, &settings[0].set)?;
    // The files of the graph and its shaders are known once they are built.
    exact.prepare((camera.width, camera.height), &mut |_| {})?;
    let is_wanted = |setting: &Setting| setting.name == settings::EXACT || only(wanted, &setting.name);
    let settings = to_measure(settings, &mut exact, cameras, &is_wanted, listener)?;
    let plans: Vec<_> = settings.iter().map(|(setting, plan)| (setting.name.as_str(), *plan)).collect();
    let (mut book, lost) = Book::open(wanted.file.clone(), origin(subject, wanted, plans[0].1)?, &plans);
    lost.iter().for_each(|line| listener.say(line));
    if !book.ledger.rows.is_empty() {
        let (file, rows) = (book.path().display(), book.ledger.rows.len());
        listener.say(&format!("{file}: {rows} rows of an earlier run are kept"));
    }

    let album = Album::beside(&wanted.file);
    let mut steps = Steps::new(listener, "measuring", settings.len() * cameras.len());
    for (index, camera) in cameras.iter().enumerate() {
        let name = &camera.img_name;
        if settings.iter().all(|(setting, _)| book.has(&setting.name, name)) {
            steps.skip(settings.len());
            continue;
        }
        exact.prepare((camera.width, camera.height), &mut |_| {})?;
        let effort = wanted.frames.choose(&mut exact, camera, 4)?;
        let picture = wanted.truths.as_ref().and_then(|(_, pictures)| pictures.get(index));
        let view = view(scene, camera, picture);
        for (setting, plan) in &settings {
            if book.has(&setting.name, name) {
                steps.skip(1);
                continue;
            }
            steps.next(&format!("{name}, {}", setting.name))?;
            let baseline = Baseline { session: &mut exact, ms: book.exact_ms(name) };
            let (row, picture) = measure(&mut session, baseline, (setting, *plan), &view, effort)?;
            if let Some(picture) = picture {
                album.keep(&book.ledger, &row, &picture, &view.picture)?;
            }
            book.add(row)?;
        }
    }
    let mut ledger = book.ledger;
    ledger.rows.retain(|row| settings.iter().any(|(setting, _)| setting.name == row.setting));
    Ok(ledger)
}

/// Returns true if a setting of this name is wanted.
fn only(wanted: &Wanted, setting: &str) -> bool {
    wanted.only.is_empty() || wanted.only.iter().any(|name| setting.starts_with(name.as_str()))
}

/// Lists the settings, the exact ones first; an error if `only` names none of them.
fn chosen<D: Device>(
    wanted: &Wanted,
    session: &mut Session<D>,
    camera: &Camera,
) -> Result<Vec<Setting>, StudyError> {
    let controls = session.controls((camera.width, camera.height))?;
    let all = settings::measured(&wanted.pipeline, &wanted.set, &controls);
    for name in &wanted.only {
        if !all.iter().any(|setting| setting.name.starts_with(name.as_str())) {
            let known = all.into_iter().map(|setting| setting.name).collect();
            return Err(StudyError::UnknownSetting { name: name.clone(), known });
        }
    }
    Ok(all)
}

/// Describes everything that the rows depend on; `exact` is the hash of the exact settings' plans.
fn origin<D: Device>(
    subject: &Subject<D>,
    wanted: &Wanted,
    exact: Option<u64>,
) -> Result<Origin, StudyError> {
    let info = subject.device.info();
    let (truth, truth_content) = match &wanted.truths {
        Some((name, pictures)) => (name.clone(), content(pictures)),
        None => ("reference".to_owned(), String::new()),
    };
    let own = |error: &dyn std::fmt::Display| StudyError::Input(format!("the ledger's origin: {error}"));
    Ok(Origin {
        version: env!("CARGO_PKG_VERSION").into(),
        program: program().map_err(|error| own(&error))?,
        scene: subject.name.clone(),
        splats: subject.scene.count(),
        content: format!("{:016x}", subject.scene.identity()),
        cameras: serde_json::to_value(&subject.cameras).map_err(|error| own(&error))?,
        pipeline: wanted.pipeline.clone(),
        set: wanted.set.clone(),
        exact: exact.map_or_else(String::new, |plan| format!("{plan:016x}")),
        truth,
        truth_content,
        device: subject.device_name(),
        opened: format!("{:?}, bounds {:?}, {}", info.facts, info.robustness, wanted.opened),
        rounds: wanted.frames.rounds,
        frames: wanted.frames.frames,
    })
}

/// Hashes the program's file.
fn program() -> std::io::Result<String> {
    // On Linux, the link leads to the running program, even if its file was replaced.
    let link = File::open("/proc/self/exe");
    let mut file = link.or_else(|_| File::open(std::env::current_exe()?))?;
    let (mut hash, mut bytes) = (DefaultHasher::new(), vec![0; 1 << 20]);
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(format!("{:016x}", hash.finish())),
            count => hash.write(&bytes[..count]),
        }
    }
}

/// Hashes the pixels of pictures, bit by bit.
fn content(pictures: &[Image]) -> String {
    let mut hash = DefaultHasher::new();
    for picture in pictures {
        (picture.width, picture.height).hash(&mut hash);
        picture.rgb.as_flattened().iter().for_each(|value| value.to_bits().hash(&mut hash));
    }
    format!("{:016x}", hash.finish())
}

/// The truth of a view: the exact renderer's, with the given picture instead of its own if there is one.
fn view(scene: &Scene, camera: &Camera, picture: Option<&Image>) -> View {
    let mut view = View::exact(scene, camera).with_order(scene);
    if let Some(picture) = picture {
        view.picture = picture.clone();
    }
    view
}
