//! Measures candidates on a scene, for several numbers of splats and picture sizes.

use super::measure::Bench;
use super::report::{Report, Row, SceneOrigin, size_text};
use crate::draw::blind;
use crate::studies::study::{Listener, Setting, Steps, StudyError, Subject};
use splatgraph_assets::{Camera, Scene, grouped, synth};
use std::sync::Arc;

/// The candidates to measure on a scene, and the numbers of splats and sizes.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Graphs with values for some of their parameters.
    pub candidates: Vec<Setting>,
    /// Numbers of splats to which the scene is enlarged or cut; empty for its own number.
    pub splats: Vec<u32>,
    /// Sizes of the pictures. `None` stands for the size of each camera; an empty list counts as one `None`.
    pub sizes: Vec<Option<(u32, u32)>>,
}

/// Measures candidates on a scene, and adds them to a report. Calls `kept` before the first size, so that
/// no earlier file is taken for this run's, and after each. The caller sets [`Report::complete`].
///
/// # Errors
/// The subject has no camera, an exact picture does not fit in memory, the device fails, `kept` fails, or the listener
/// cancels. A candidate that cannot be drawn gives a row with the reason, as does every candidate if the scene cannot
/// be enlarged.
pub fn study<E: From<StudyError>>(
    subject: &Subject,
    wanted: &Wanted,
    report: &mut Report,
    kept: &mut dyn FnMut(&Report) -> Result<(), E>,
    listener: &mut dyn Listener,
) -> Result<(), E> {
    subject.first()?;
    let Subject { name, scene: base, cameras, .. } = subject;
    // Drawing an empty view takes hardly any time.
    blind::told(base, &subject.blind()?, cameras.len()).iter().for_each(|note| listener.say(note));
    report.scenes.push(SceneOrigin { scene: name.clone(), splats: base.count(), cameras: cameras.clone() });
    let counts = if wanted.splats.is_empty() { vec![base.count()] } else { wanted.splats.clone() };
    let sizes: &[Option<(u32, u32)>] = if wanted.sizes.is_empty() { &[None] } else { &wanted.sizes };
    let of = counts.len() * sizes.len() * cameras.len();
    let mut steps = Steps::new(listener, format!("measuring {}", report.name_of(name)), of);
    kept(report)?;
    for splats in counts {
        let row = |size, candidate: &Setting, found| {
            let (scene, pipeline) = (name.clone(), candidate.pipeline.clone());
            Row { scene, splats, size, pipeline, found }
        };
        let enlarged = match enlarged(base, splats) {
            Ok(scene) => scene,
            Err(error) => {
                for size in sizes {
                    let failed = |candidate| row(*size, candidate, Err(error.to_string()));
                    report.rows.extend(wanted.candidates.iter().map(failed));
                }
                steps.skip(sizes.len() * cameras.len());
                kept(report)?;
                continue;
            }
        };
        for size in sizes {
            let resized =
                |camera: &Camera| size.map_or_else(|| camera.clone(), |(w, h)| camera.resized(w, h));
            let cameras: Vec<Camera> = cameras.iter().map(resized).collect();
            let bench = Bench {
                device: &subject.device,
                scene: enlarged.clone(),
                frames: report.origin.effort,
                copy: report.origin.copy.as_ref().map(|copy| copy.gb_per_s),
            };
            let place = format!("{} splats, {}", grouped(splats.into()), size_text(*size));
            let outcomes = bench.measure(&wanted.candidates, &cameras, &mut steps, &place)?;
            let rows = wanted.candidates.iter().zip(outcomes).map(|(own, found)| row(*size, own, found));
            report.rows.extend(rows);
            kept(report)?;
        }
    }
    Ok(())
}

fn enlarged(base: &Arc<Scene>, splats: u32) -> Result<Arc<Scene>, synth::SynthError> {
    Ok(if base.count() == splats { base.clone() } else { Arc::new(synth::enlarge(base, splats)?) })
}

#[cfg(test)]
mod tests {
    use super::super::report::Origin;
    use super::*;
    use crate::draw::backend::Backend;
    use crate::draw::interleaved::Frames;
    use splatgraph_api::Device;

    #[test]
    fn rows_are_kept_as_they_come_with_the_cameras_own_sizes_by_default() {
        let null = splatgraph_null::open(&splatgraph_null::Config::default()).0.expect("no fault is set");
        let device = Backend::Null(null);
        let scene: Arc<Scene> = synth::generate("demo", 50, 0).expect("a small scene").into();
        let wanted =
            Wanted { candidates: vec![Setting::of_graph("unsorted", &[])], splats: vec![], sizes: vec![] };
        let study = |splats: &[u32], cameras: &[Camera]| {
            let frames = Frames { rounds: 1, frames: Some(1) };
            let origin = Origin::new(device.info(), None, frames, &[]);
            let mut report = Report { complete: false, origin, scenes: vec![], rows: vec![] };
            let (name, scene, cameras) = ("demo".to_owned(), scene.clone(), cameras.to_vec());
            let device = device.new_context()?;
            let subject = Subject { device, name, scene, cameras };
            let wanted = Wanted { splats: splats.to_vec(), ..wanted.clone() };
            let mut kept = Vec::new();
            let mut keep = |report: &Report| {
                kept.push(report.rows.len());
                Ok::<(), StudyError>(())
            };
            study(&subject, &wanted, &mut report, &mut keep, &mut ())?;
            let rows: Vec<_> = report.rows.into_iter().map(|row| (row.size, row.found.is_ok())).collect();
            Ok::<_, StudyError>((kept, rows))
        };
        let camera = Camera::framing(&scene, 32, 24);
        let found = study(&[], std::slice::from_ref(&camera)).expect("it is measured");
        assert_eq!(found, (vec![0, 1], vec![(None, true)]));
        if cfg!(target_os = "linux") {
            // A terabyte of splats.
            let found = study(&[u32::MAX], &[camera]).expect("rows with the reason");
            assert_eq!(found, (vec![0, 1], vec![(None, false)]));
        }
        assert!(matches!(study(&[], &[]), Err(StudyError::NoCameras)));
    }
}
