//! Tests frames in a window: swapchains that are out of date, and windows that show nothing.

use crate::common::*;
use crate::testing::plan;
use splatgraph_api::{BackendError, Device};
use splatgraph_null::{Call, Config, Fault, Journal, Null, Point};

fn window(faults: &[Fault]) -> (Null, Journal) {
    let config = Config { window: Some((64, 32)), faults: faults.to_vec(), ..Config::default() };
    let (mut null, journal) = opened(&config);
    load(&mut null, plan());
    journal.take();
    (null, journal)
}

fn shown(calls: &[Call]) -> usize {
    calls.iter().filter(|call| matches!(call, Call::Present { .. })).count()
}

fn made(calls: &[Call]) -> Vec<((u32, u32), bool)> {
    let swapchain = |call: &Call| match call {
        Call::CreateSwapchain { size, vsync } => Some((*size, *vsync)),
        _ => None,
    };
    calls.iter().filter_map(swapchain).collect()
}

#[test]
fn a_frame_is_blitted_behind_its_commands_and_presented() {
    let (mut null, journal) = window(&[]);
    frame(&mut null, &presented());
    let calls = journal.take();
    let order: Vec<&Call> = calls.iter().skip_while(|call| **call != Call::End).take(5).collect();
    let expected = [
        Call::End,
        Call::Acquire { slot: 0 },
        Call::RecordBlit { output: "color".to_string(), image: 1 },
        Call::Submit { encoder: "frame".to_string(), show: Some(1) },
        Call::Present { image: 1 },
    ];
    assert_eq!(order, expected.iter().collect::<Vec<_>>());
    frame(&mut null, &inputs());
    assert_eq!(shown(&journal.take()), 0);
    finish(null, &journal);
}

#[test]
fn a_swapchain_is_replaced_when_the_size_or_the_pace_changes_and_not_otherwise() {
    let (mut null, journal) = window(&[]);
    null.resize_window(64, 32);
    null.set_vsync(true);
    frame(&mut null, &presented());
    assert_eq!(made(&journal.take()), []);
    null.resize_window(80, 40);
    null.set_vsync(false);
    frame(&mut null, &presented());
    assert_eq!(made(&journal.take()), [((80, 40), false)]);
    frame(&mut null, &presented());
    assert_eq!(made(&journal.take()), []);
    finish(null, &journal);
}

#[test]
fn a_window_without_pixels_shows_nothing_and_frames_are_drawn() {
    let (mut null, journal) = window(&[]);
    null.resize_window(0, 32);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((made(&calls), shown(&calls)), (vec![], 0));
    null.resize_window(64, 32);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((made(&calls).len(), shown(&calls)), (1, 1));
    finish(null, &journal);
}

#[test]
fn an_out_of_date_swapchain_is_replaced_and_the_same_frame_is_shown() {
    let (mut null, journal) = window(&[Fault { point: Point::AcquireOutOfDate, after: 0 }]);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((made(&calls).len(), shown(&calls)), (1, 1));
    finish(null, &journal);
    // If the window changes twice in a row, the next frame catches up.
    let twice = [0, 1].map(|after| Fault { point: Point::AcquireOutOfDate, after });
    let (mut null, journal) = window(&twice);
    frame(&mut null, &presented());
    assert_eq!(shown(&journal.take()), 0);
    frame(&mut null, &presented());
    assert_eq!(shown(&journal.take()), 1);
    finish(null, &journal);
    let (mut null, journal) = window(&[Fault { point: Point::PresentOutOfDate, after: 0 }]);
    frame(&mut null, &presented());
    assert_eq!(made(&journal.take()), []);
    frame(&mut null, &presented());
    assert_eq!(made(&journal.take()).len(), 1);
    finish(null, &journal);
}

#[test]
fn a_window_that_gives_no_image_in_time_skips_the_frame() {
    let (mut null, journal) = window(&[Fault { point: Point::AcquireTimeout, after: 0 }]);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((made(&calls), shown(&calls)), (vec![], 0));
    frame(&mut null, &presented());
    assert_eq!(shown(&journal.take()), 1);
    finish(null, &journal);
}

fn always(point: Point, count: u64) -> Vec<Fault> {
    (0..count).map(|after| Fault { point, after }).collect()
}

fn renewed(calls: &[Call]) -> usize {
    calls.iter().filter(|call| matches!(call, Call::RenewSurface)).count()
}

#[test]
fn a_lost_surface_is_made_anew_and_the_same_frame_is_shown() {
    let (mut null, journal) = window(&always(Point::AcquireLost, 1));
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((renewed(&calls), made(&calls).len(), shown(&calls)), (1, 1, 1));
    finish(null, &journal);
    // A loss found at presentation affects the next frame, which gets a new surface.
    let (mut null, journal) = window(&always(Point::PresentLost, 1));
    frame(&mut null, &presented());
    assert_eq!(renewed(&journal.take()), 0);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((renewed(&calls), made(&calls).len(), shown(&calls)), (1, 1, 1));
    finish(null, &journal);
    // A minimised window keeps its new surface until it has pixels again.
    let (mut null, journal) = window(&always(Point::PresentLost, 1));
    frame(&mut null, &presented());
    journal.take();
    null.resize_window(0, 0);
    (0..3).for_each(|_| drop(frame(&mut null, &presented())));
    let calls = journal.take();
    assert_eq!((renewed(&calls), made(&calls).len(), shown(&calls)), (1, 0, 0));
    null.resize_window(80, 40);
    frame(&mut null, &presented());
    let calls = journal.take();
    assert_eq!((renewed(&calls), made(&calls).len(), shown(&calls)), (0, 1, 1));
    finish(null, &journal);
}

#[test]
fn a_window_that_is_gone_is_an_error_and_frames_are_drawn_without_it() {
    // The first two queries belong to opening the device.
    let gone: Vec<Fault> = (2..40).map(|after| Fault { point: Point::Surface, after }).collect();
    let (mut null, journal) = window(&gone);
    null.resize_window(80, 40);
    let error = error_of(null.submit(&presented()));
    assert!(matches!(error, BackendError::SurfaceLost { .. }), "{error}");
    frame(&mut null, &inputs());
    finish(null, &journal);
}

#[test]
fn a_window_for_which_no_swapchain_is_the_best_gets_one_more_and_keeps_it() {
    for point in [Point::AcquireSuboptimal, Point::PresentSuboptimal] {
        let (mut null, journal) = window(&always(point, 100));
        let mut swapchains = 0;
        for _ in 0..20 {
            frame(&mut null, &presented());
            let calls = journal.take();
            assert_eq!(shown(&calls), 1);
            swapchains += made(&calls).len();
        }
        assert_eq!(swapchains, 1, "{point:?}");
        null.resize_window(80, 40);
        frame(&mut null, &presented());
        assert_eq!(made(&journal.take()), [((80, 40), true)]);
        finish(null, &journal);
    }
}

#[test]
fn an_output_that_is_no_picture_is_refused_and_the_next_frame_is_drawn() {
    use splatgraph_framework::ir::{Format, Shape};
    let (mut null, journal) = window(&[]);
    let mut integers = plan();
    let format = Format::R32Uint;
    integers.resources[crate::testing::COLOR.index()].shape = Shape::Image { format, width: 64, height: 32 };
    load(&mut null, integers);
    assert!(error_of(null.submit(&presented())).to_string().contains("r32ui"));
    frame(&mut null, &inputs());
    finish(null, &journal);
}
