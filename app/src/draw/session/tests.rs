//! Tests of incomplete frames, on a device that executes nothing and returns one word for every statistic.

use super::*;
use crate::draw::inspect;
use splatgraph_api::FrameResult;
use splatgraph_assets::synth;
use splatgraph_framework::ir::Value;
use splatgraph_null::{Call, Config, Journal, open};

const GRAPH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/growing/graph.ron");

const SIZE: (u32, u32) = (32, 16);

/// Makes a session on a device on which every frame needs this many entries.
fn session(needed: u32, config: Config) -> (Session, Journal, Camera) {
    let (null, journal) = open(&Config { read: needed, ..config });
    let scene = synth::generate("demo", 10, 0).expect("a scene");
    let camera = Camera::framing(&scene, SIZE.0, SIZE.1);
    let mut session = Session::new(Backend::Null(null.expect("it opens")), scene, GRAPH, &[]);
    session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    journal.take();
    (session, journal, camera)
}

fn entries(session: &Session) -> Value {
    session.plan().expect("a plan").params[0].value.clone()
}

fn submitted(journal: &Journal) -> usize {
    journal.take().iter().filter(|call| matches!(call, Call::BindPass { pass, .. } if pass == "list")).count()
}

fn draw(session: &mut Session, camera: &Camera) -> Result<FrameResult, SessionError> {
    let frame = session.submit(camera, &FrameOptions::default())?;
    session.wait(frame)
}

#[test]
fn a_frame_in_part_is_drawn_again_with_room_for_a_quarter_more() {
    let (mut session, journal, camera) = session(300, Config::default());
    assert_eq!(entries(&session), Value::Int(100));
    let result = draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(result.stats, [("entries_needed".to_owned(), 300)]);
    assert_eq!((entries(&session), session.growths()), (Value::Int(375), 1));
    assert_eq!(submitted(&journal), 2);
    draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
    assert!(session.prepare((64, 32), &mut |_| {}).unwrap_or_else(|error| panic!("{error}")));
    draw(&mut session, &camera.resized(64, 32)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((entries(&session), session.growths(), submitted(&journal)), (Value::Int(375), 1, 2));
    // A change of the graph resets the capacity.
    session.set_graph(GRAPH, &[("entries".into(), "200".into())]);
    session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(entries(&session), Value::Int(200));
    draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(entries(&session), Value::Int(375));
}

#[test]
fn a_plan_that_was_built_before_is_taken_until_a_list_grows_or_the_graph_changes() {
    let (mut session, _, camera) = session(300, Config::default());
    // The plan of other settings shows where a plan comes from.
    let other = session.plan_of(GRAPH, &[("entries".into(), "250".into())], SIZE);
    let built = Built::new(vec![(SIZE, other.unwrap_or_else(|errors| panic!("{errors}")))]);
    let prepared = |session: &mut Session, size| {
        session.prepare(size, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        entries(session)
    };
    session.set_planned(GRAPH, &[], &built);
    assert_eq!(prepared(&mut session, (64, 32)), Value::Int(100), "another size");
    assert_eq!(prepared(&mut session, SIZE), Value::Int(250));
    draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(entries(&session), Value::Int(375));
    session.set_planned(GRAPH, &[], &built);
    assert_eq!(prepared(&mut session, SIZE), Value::Int(250));
    session.set_graph(GRAPH, &[]);
    assert_eq!(prepared(&mut session, SIZE), Value::Int(100));
}

#[test]
fn a_plan_built_before_the_device_is_the_first_of_its_size_and_only_until_something_changes() {
    let early = || {
        let scene = synth::generate("demo", 10, 0).expect("a scene");
        let (null, _) = open(&Config { read: 300, ..Config::default() });
        let device = Backend::Null(null.expect("it opens"));
        // The plan of other settings shows where a plan comes from.
        let graph = (GRAPH, &[("entries".to_owned(), "250".to_owned())][..]);
        let early = EarlyPlan::new(graph, Vec::new(), &scene, &device.info().facts, SIZE);
        Session::new(device, scene, GRAPH, &[]).with_plan(early.unwrap_or_else(|errors| panic!("{errors}")))
    };
    let prepared = |mut session: Session, size| {
        session.prepare(size, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        entries(&session)
    };
    assert_eq!(prepared(early(), SIZE), Value::Int(250));
    assert_eq!(prepared(early(), (64, 32)), Value::Int(100), "another size");
    let mut session = early();
    session.set_graph(GRAPH, &[]);
    assert_eq!(prepared(session, SIZE), Value::Int(100));
    let mut session = early();
    session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    session.keep_contents();
    assert!(session.plan().is_none(), "a plan whose resources share memory");
    assert_eq!(prepared(session, SIZE), Value::Int(100));
}

#[test]
fn a_camera_of_another_size_is_an_error_that_names_both() {
    let (mut session, _, camera) = session(1, Config::default());
    let error = draw(&mut session, &camera.resized(80, 45)).map(drop).expect_err("another size");
    assert_eq!(
        error.to_string(),
        "expected a camera of 32 x 16 pixels, the prepared size, found one of 80 x 45"
    );
    draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn frames_in_flight_behind_one_in_part_are_drawn_again_with_the_same_plan() {
    let (mut session, journal, camera) = session(300, Config::default());
    let plan = session.plan().expect("a plan");
    let inspect = vec![inspect::resolve(plan, "list", "list").expect("it is there")];
    let asked = FrameOptions { read_output: true, inspect, ..FrameOptions::default() };
    let frames = [&asked, &asked].map(|asked| session.submit(&camera, asked).expect("submitted"));
    for frame in frames {
        let result = session.wait(frame).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(result.inspected[0].len(), 4 * 375, "of the plan with room");
        assert!(result.output.is_some());
        assert_eq!(session.growths(), 1);
    }
    assert_eq!(submitted(&journal), 4);
}

#[test]
fn a_need_beyond_the_range_is_an_error_that_names_both() {
    let (mut session, _, camera) = session(5000, Config::default());
    let error = draw(&mut session, &camera).map(drop).expect_err("there is no such room").to_string();
    assert_eq!(
        error,
        "expected a frame that needs at most 4096 entries, the end of the parameter's range, found one that needs 5000"
    );
    assert_eq!(entries(&session), Value::Int(100), "the plan stays");
}

/// A device whose largest buffer has this many bytes.
fn with_buffers_of(max_storage_bytes: u64) -> Config {
    let mut config = Config::default();
    config.limits.facts.max_storage_bytes = max_storage_bytes;
    config
}

#[test]
fn a_device_without_room_for_a_quarter_more_gets_the_need_alone() {
    let (mut session, _, camera) = session(2000, with_buffers_of(8000));
    draw(&mut session, &camera).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((entries(&session), session.growths()), (Value::Int(2000), 1));
}

#[test]
fn a_device_without_room_is_an_error_that_says_why() {
    let (mut session, _, camera) = session(2000, with_buffers_of(7996));
    let error = draw(&mut session, &camera).map(drop).expect_err("there is no such room").to_string();
    let begin = "expected a device with room for the 2000 entries that a frame needs, found none:\n";
    assert!(error.starts_with(begin) && error.contains("`list` has"), "{error}");
    assert_eq!(entries(&session), Value::Int(100), "the plan stays");
}

#[test]
fn a_scene_whose_buffers_fit_and_whose_plan_does_not_is_packed() {
    const COUNT: u32 = 20_000;
    let splats = synth::generate("uniform", COUNT, 0).expect("splats");
    let opened = |budget: Option<u64>| {
        let null = open(&Config { budget, ..Config::default() }).0.expect("it opens");
        let scene = Scene::generate(COUNT, 3, |at| {
            let mut splat = splats.splat(at);
            splat.sh[47] = 0.5;
            splat
        });
        Session::new(Backend::Null(null), scene, "tiled_cpu", &[])
    };
    let chosen = |budget| {
        let mut session = opened(Some(budget));
        let choice = session.choose_storage(None, SIZE).unwrap_or_else(|error| panic!("{error}"));
        (choice.and_then(|choice| choice.set), session)
    };
    let plan = opened(None).plan_of("tiled_cpu", &[], SIZE).unwrap_or_else(|error| panic!("{error}"));
    let needed = fit::resident_bytes(&plan);
    assert!(needed > 96 * u64::from(COUNT), "{needed}");
    let (own, _) = chosen(needed);
    assert_eq!(own, None);
    let (packed, mut session) = chosen(needed - 1);
    assert_eq!(packed, Some(("sh_storage".to_owned(), "q8".to_owned())));
    session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn errors_of_a_graph_spare_the_device_also_without_splats() {
    let (null, _) = open(&Config::default());
    let mut session = Session::new(
        Backend::Null(null.expect("it opens")),
        Scene::generate(0, 0, |_| unreachable!("no splat")),
        GRAPH,
        &[("nothing".into(), "1".into())],
    );
    let error = session.prepare(SIZE, &mut |_| {}).unwrap_err();
    assert!(matches!(error, SessionError::NoSplats { .. }) && error.spares_device(), "{error}");
}

#[test]
fn a_frame_that_is_polled_is_repeated_like_one_that_is_waited_for() {
    let (mut session, _, camera) = session(300, Config::default());
    let frame = session.submit(&camera, &FrameOptions::default()).expect("submitted");
    let result = loop {
        if let Some(result) = session.try_wait(frame).unwrap_or_else(|error| panic!("{error}")) {
            break result;
        }
    };
    assert_eq!(result.stats, [("entries_needed".to_owned(), 300)]);
    assert_eq!((entries(&session), session.growths()), (Value::Int(375), 1));
    assert!(session.try_wait(frame).is_err(), "the result was taken");
}

#[test]
fn a_cancelled_session_builds_and_loads_nothing() {
    let (mut session, _, _) = session(1, Config::default());
    session.set_cancel(Cancel::new(|| true));
    assert!(session.prepare((64, 32), &mut |_| {}).is_err());
    session.set_cancel(Cancel::default());
    session.prepare((64, 32), &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn unusable_cameras_and_values_that_do_not_fit_are_errors() {
    let (mut session, _, camera) = session(1, Config::default());
    let error = |session: &mut Session, camera: &Camera, live: &[(&str, &str)]| {
        let live = live.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        let submitted = session.submit(camera, &FrameOptions { live, ..FrameOptions::default() });
        submitted.map(drop).map_err(|error| error.to_string())
    };
    let flat = Camera { fx: 0.0, ..camera.clone() };
    assert_eq!(error(&mut session, &flat, &[]), Err("expected a positive fx, found 0".into()));
    let not_live = format!("expected a live parameter of `{GRAPH}`, found `entries`");
    assert_eq!(error(&mut session, &camera, &[("entries", "200")]), Err(not_live));
    session.set_graph("splat", &[]);
    session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(error(&mut session, &camera, &[("alpha_cap", "0.5")]), Ok(()));
    assert_eq!(
        error(&mut session, &camera, &[("alpha_cap", "2")]),
        Err("`alpha_cap` = `2`: 2.0 is not in 0.5 to 1.0".into())
    );
}

#[test]
fn an_edited_graph_is_read_again_by_a_change_of_graph_and_on_request() {
    let folder = tempfile::tempdir().expect("a folder");
    let from = std::path::Path::new(GRAPH).parent().expect("a folder");
    for entry in std::fs::read_dir(from).expect("a folder") {
        let path = entry.expect("an entry").path();
        std::fs::copy(&path, folder.path().join(path.file_name().expect("a name"))).expect("copied");
    }
    let path = folder.path().join("graph.ron");
    let graph = path.to_string_lossy().into_owned();
    let (mut session, _, _) = session(1, Config::default());
    let edit = |from: &str, to: &str| {
        let text = std::fs::read_to_string(&path).expect("a graph");
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replace(from, to)).expect("written");
    };
    let mut prepared = |change: &dyn Fn(&mut Session)| {
        change(&mut session);
        session.prepare(SIZE, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        entries(&session)
    };
    assert_eq!(prepared(&|session| session.set_graph(&graph, &[])), Value::Int(100));
    edit("default: 100", "default: 150");
    assert_eq!(prepared(&|session| session.set_graph(&graph, &[])), Value::Int(100));
    assert_eq!(prepared(&Session::forget_files), Value::Int(150));
    edit("default: 150", "default: 250");
    let change = |session: &mut Session| session.change_graph(&graph, &[], SIZE).expect("a sound graph");
    assert_eq!(prepared(&change), Value::Int(250));
}
