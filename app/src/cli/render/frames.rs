//! Draws the frames of one camera, and reads resources back.

use super::args::{Args, InspectRequest};
use super::kept::Kept;
use crate::draw::animation::is_animated;
use crate::draw::inspect::{self, Finding};
use crate::draw::interleaved;
use crate::draw::outputs::{self, Output};
use crate::draw::session::{FrameOptions, Session, SessionError};
use crate::draw::stats::CameraStats;
use crate::io::progress::Progress;
use anyhow::{Context, Result};
use splatgraph_api::{Device, FRAMES_IN_FLIGHT, Inspect, Pixels};
use splatgraph_assets::Camera;
use splatgraph_framework::plan::Plan;
use std::collections::VecDeque;
use std::time::Instant;

pub struct Drawn {
    pub stats: CameraStats,
    /// Picture of the last frame; `None` if it was not read back.
    pub output: Option<Pixels>,
    pub outputs: Vec<Output>,
    /// For each finding in `stats`, the index of its `--inspect` option. A resource of a prologue that did not run has
    /// no finding.
    pub requests: Vec<usize>,
}

/// Draws the frames of one camera with the prepared plan. Reads back the contents for `--inspect` and, of the last
/// frame, the outputs and (with `read_output`) the picture. Warm-up frames come first if several frames are measured
/// and the picture does not depend on their number. `loaded` is true if the plan's prologue has not run yet.
pub fn draw(
    args: &Args,
    read_output: bool,
    session: &mut Session,
    camera: &Camera,
    loaded: bool,
) -> Result<Drawn> {
    let plan = session.plan().context("no plan after `prepare`")?.clone();
    let resolve = |plan: &Plan, inspect_request: &InspectRequest| {
        inspect::resolve(plan, &inspect_request.resource, &inspect_request.pass)
    };
    let targets: Vec<Inspect> =
        args.inspect.iter().map(|request| resolve(&plan, request)).collect::<Result<_, _>>()?;

    let mut kept = Kept::default();
    let mut outputs = Vec::new();
    let mut findings: Vec<Option<Finding>> = vec![None; targets.len()];
    let mut flying: VecDeque<(_, Vec<usize>, bool)> = VecDeque::new();
    let mut growths = session.growths();
    let mut land = |session: &mut Session, (id, asked, counts): (_, Vec<usize>, _)| -> Result<()> {
        let result = session.wait(id)?;
        let plan = session.plan().context("no plan after a frame")?;
        // The plan was rebuilt with larger buffers, and its passes may differ.
        if std::mem::replace(&mut growths, session.growths()) != session.growths() {
            kept = Kept::default();
        }
        for (bytes, &index) in result.inspected.iter().zip(&asked) {
            let target = resolve(plan, &args.inspect[index])?;
            findings[index] = Some(Finding::new(plan, &target, bytes, &result.stats));
        }
        outputs = outputs::read(plan, &result.inspected[asked.len()..]);
        kept.add(result, plan, counts);
        Ok(())
    };
    // If several frames are measured, they follow warm-up frames, because an idle device may run at a lower clock.
    // Their number varies from run to run, so there are none if the picture depends on the number of frames.
    let begun = Instant::now();
    let mut warm = args.repeat == 1 || is_animated(&plan);
    // Timestamps of passes take time, so of several frames only the last few have them, and the first, which runs the
    // prologue. A timeline shows the passes of all frames.
    let may_omit = args.timeline.is_none();
    let profiled = interleaved::PROFILED.min(args.repeat / 2);
    let (mut counted, mut first) = (0, true);
    while counted < args.repeat {
        counted += u32::from(warm);
        let last = counted == args.repeat;
        // Results of the prologue can be read only in the frame that runs it.
        let due = |target: &Inspect| if inspect::in_prologue(&plan, target) { first && loaded } else { last };
        let asked: Vec<usize> = (0..targets.len()).filter(|&i| due(&targets[i])).collect();
        let outputs_of = |last| outputs::inspections(&plan).into_iter().filter(move |_| last);
        let request = FrameOptions {
            background: args.background,
            read_output: read_output && last,
            live: Vec::new(),
            inspect: asked.iter().map(|&i| targets[i]).chain(outputs_of(last)).collect(),
            untimed_passes: may_omit && !first && counted <= args.repeat - profiled,
            warm_up: !warm,
        };
        first = false;
        if flying.len() == FRAMES_IN_FLIGHT
            && let Some(oldest) = flying.pop_front()
        {
            land(session, oldest)?;
        }
        flying.push_back((session.submit(camera, &request)?, asked, warm));
        warm |= begun.elapsed() >= interleaved::WARM_UP;
    }
    for frame in flying {
        land(session, frame)?;
    }

    let plan = session.plan().context("no plan after the frames")?.clone();
    let output = kept.output();
    let scene_count = session.scene().count().into();
    let memory = session.device().memory();
    let info = session.device().info();
    let size = (camera.width, camera.height);
    let mut stats = kept.stats((&camera.img_name, size), &plan, info, scene_count, memory);
    let found = findings
        .into_iter()
        .enumerate()
        .filter_map(|(inspect_request, finding)| Some((inspect_request, finding?)));
    let requests;
    (requests, stats.inspected) = found.unzip();
    Ok(Drawn { stats, output, outputs, requests })
}

/// Builds and loads the plan, and shows the progress. Returns true if a plan was loaded, false if it already was.
pub fn prepare_plan(session: &mut Session, camera: &Camera) -> Result<bool, SessionError> {
    let mut compiling = Progress::new("making pipelines");
    let mut uploading = None;
    session.prepare((camera.width, camera.height), &mut |step| match step {
        splatgraph_api::Progress::Pipeline { done, of, shader } => {
            compiling.set(done as u64, of as u64, shader)
        }
        splatgraph_api::Progress::Upload { done_bytes, of_bytes } => {
            uploading
                .get_or_insert_with(|| Progress::new("uploading the scene"))
                .set(done_bytes, of_bytes, "");
        }
    })
}
