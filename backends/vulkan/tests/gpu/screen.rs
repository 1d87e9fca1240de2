//! Frames in windows, on an X server started by the tests. The window's contents, as the server reports them, are
//! compared with the frame.

use crate::build::*;
use crate::x11::{Screen, Window};
use splatgraph_api::{BackendError, Device, FrameInputs};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::sync::Arc;

const SIZE: (u32, u32) = (48, 32);

/// Starts a screen and opens a window of [`SIZE`] on it.
fn window() -> (Screen, Arc<Window>) {
    let screen = Screen::start(640, 480);
    let window = screen.window(SIZE.0 as u16, SIZE.1 as u16);
    (screen, window)
}

fn opened() -> (Screen, Arc<Window>, Vulkan) {
    let (screen, window) = window();
    let vulkan = open_in(&window, SIZE);
    (screen, window, vulkan)
}

/// Opens lavapipe in a window. Other devices may be unable to present on a server without a display.
fn open_in(window: &Arc<Window>, size: (u32, u32)) -> Vulkan {
    let options = Options {
        device: Some("llvmpipe".to_string()),
        validation: Validation::Synchronization,
        ..Options::default()
    };
    Vulkan::open_in_window(&options, window.clone(), size)
        .expect("these tests need lavapipe and the Khronos validation layer")
}

/// Returns a plan that outputs a picture of `SIZE` whose pixels all differ. Red grows to the right, green grows
/// downwards, and blue is a frame input.
fn gradients(format: Format) -> Plan {
    let (width, height) = SIZE;
    let mut build = Build::new();
    let image = build.image("picture", format, width, height, Usage::STORAGE);
    let live = build.uniform(Source::Live, 16);
    let shader = build.shader(
        "gradients.comp",
        &format!(
            "layout(set = 0, binding = 0, {}) writeonly uniform image2D picture;
layout(set = 0, binding = 31, std140) uniform Live {{ uint blue; }};
void main() {{
    ivec2 at = ivec2(gl_WorkGroupID.x % {width}, gl_WorkGroupID.x / {width});
    imageStore(picture, at, vec4(vec3(at * 4, blue) / 255, 1));
}}",
            format.name()
        ),
    );
    let binds = [(image, 0, WRITE), (live, 31, UNIFORM)];
    build.dispatch(Run::Frame, "gradients", shader, width * height, &binds);
    build.export(image)
}

fn drawn(blue: u8, (width, height): (u32, u32)) -> Vec<[u8; 3]> {
    // Interpolated between pixel centres, and clamped at the outermost.
    let along = |at: u32, of: u32, pixels: u32| {
        let place = (at as f64 + 0.5) * pixels as f64 / of as f64 - 0.5;
        (4.0 * place.clamp(0.0, pixels as f64 - 1.0)).round() as u8
    };
    let row = |y| (0..width).map(move |x| [along(x, width, SIZE.0), along(y, height, SIZE.1), blue]);
    (0..height).flat_map(row).collect()
}

fn inputs(blue: u8, present: bool) -> FrameInputs {
    let live = (blue as u32).to_le_bytes().to_vec();
    FrameInputs { live, present, ..with_output() }
}

fn show(vulkan: &mut Vulkan, blue: u8) {
    let result = frame(vulkan, &inputs(blue, true));
    let output = result.output.expect("the output was asked for");
    assert_eq!((output.width, output.height), SIZE);
    if output.format == Format::Rgba8Unorm {
        assert!(output.bytes.chunks_exact(4).zip(drawn(blue, SIZE)).all(|(pixel, want)| pixel[..3] == want));
    }
}

#[test]
fn frames_are_shown_to_the_pixel_one_after_another() {
    let (_screen, window, mut vulkan) = opened();
    for format in [Format::Rgba8Unorm, Format::Rgba16Float, Format::Rgba32Float] {
        load(&mut vulkan, gradients(format));
        for blue in [10, 200, 30] {
            show(&mut vulkan, blue);
            window.expect(&drawn(blue, SIZE), 0);
        }
    }
    // More frames than the window has images, without waiting for any.
    let frames: Vec<_> = (100..120).map(|blue| vulkan.submit(&inputs(blue, true)).unwrap()).collect();
    window.expect(&drawn(119, SIZE), 0);
    assert!(vulkan.wait(*frames.last().unwrap()).is_ok());
    finish(vulkan);
    again_comparing_submissions("screen::frames_are_shown_to_the_pixel_one_after_another");
}

#[test]
fn frames_that_are_not_presented_leave_the_window_as_it_is() {
    let (_screen, window, mut vulkan) = opened();
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    show(&mut vulkan, 50);
    window.expect(&drawn(50, SIZE), 0);
    for blue in 60..64 {
        let output = frame(&mut vulkan, &inputs(blue, false)).output.unwrap();
        assert_eq!(output.bytes[2], blue);
    }
    assert_eq!(window.pixels(), drawn(50, SIZE));
    show(&mut vulkan, 70);
    window.expect(&drawn(70, SIZE), 0);
    finish(vulkan);
}

#[test]
fn what_is_shown_has_the_windows_size_also_after_that_changes() {
    let (_screen, window, mut vulkan) = opened();
    load(&mut vulkan, gradients(Format::Rgba16Float));
    show(&mut vulkan, 1);
    window.expect(&drawn(1, SIZE), 0);
    for (index, size) in [(96, 64), (97, 31), (640, 480), (5, 3), SIZE].into_iter().enumerate() {
        window.resize(size.0, size.1);
        // Frames are in flight while the window changes; the first may be presented in its old size.
        vulkan.submit(&inputs(0, true)).unwrap();
        vulkan.resize_window(size.0, size.1);
        let blue = 10 * index as u8 + 9;
        show(&mut vulkan, blue);
        if (size.0 >= SIZE.0 / 2) && (size.1 >= SIZE.1 / 2) {
            window.expect(&drawn(blue, size), 1);
        }
    }
    window.expect(&drawn(49, SIZE), 0);
    finish(vulkan);
}

#[test]
fn a_window_that_changes_by_itself_is_followed_by_what_the_window_system_says() {
    let (_screen, window, mut vulkan) = opened();
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    show(&mut vulkan, 1);
    // The device is not told about the resize.
    window.resize(96, 64);
    for _ in 0..3 {
        show(&mut vulkan, 2);
    }
    window.expect(&drawn(2, (96, 64)), 1);
    finish(vulkan);
}

#[test]
fn vsync_can_be_switched_off_and_on_while_frames_are_shown() {
    let (_screen, window, mut vulkan) = opened();
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    for (index, vsync) in [false, false, true, false].into_iter().enumerate() {
        vulkan.set_vsync(vsync);
        let blue = 20 * index as u8;
        for blue in blue + 10..blue + 15 {
            vulkan.submit(&inputs(blue, true)).unwrap();
        }
        window.expect(&drawn(blue + 14, SIZE), 0);
    }
    finish(vulkan);
}

#[test]
fn a_window_without_pixels_shows_nothing_and_frames_are_drawn_all_the_same() {
    let (_screen, window) = window();
    // The window is hidden at first, and again later.
    let mut vulkan = open_in(&window, (0, 0));
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    show(&mut vulkan, 11);
    vulkan.resize_window(SIZE.0, SIZE.1);
    show(&mut vulkan, 12);
    window.expect(&drawn(12, SIZE), 0);
    for size in [(0, 0), (0, SIZE.1), (SIZE.0, 0)] {
        vulkan.resize_window(size.0, size.1);
        for blue in 13..16 {
            show(&mut vulkan, blue);
        }
    }
    assert_eq!(window.pixels(), drawn(12, SIZE));
    vulkan.resize_window(SIZE.0, SIZE.1);
    show(&mut vulkan, 16);
    window.expect(&drawn(16, SIZE), 0);
    finish(vulkan);
}

#[test]
fn a_plan_may_be_replaced_while_its_frames_are_on_their_way_to_the_window() {
    let (_screen, window, mut vulkan) = opened();
    for index in 0..6 {
        let format = [Format::Rgba8Unorm, Format::Rgba16Float][index % 2];
        load(&mut vulkan, gradients(format));
        vulkan.submit(&inputs(index as u8, true)).unwrap();
    }
    window.expect(&drawn(5, SIZE), 0);
    vulkan.submit(&inputs(6, true)).unwrap();
    // The device is closed with frames in flight.
    finish(vulkan);
}

#[test]
fn the_window_is_kept_for_as_long_as_the_device_is_open() {
    let (_screen, window, mut vulkan) = opened();
    let kept = Arc::downgrade(&window);
    drop(window);
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    show(&mut vulkan, 3);
    kept.upgrade().expect("the device keeps it").expect(&drawn(3, SIZE), 0);
    finish(vulkan);
    assert!(kept.upgrade().is_none());
}

#[test]
fn a_window_that_is_gone_is_an_error_in_words_and_frames_are_drawn_without_it() {
    let (_screen, window, mut vulkan) = opened();
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    show(&mut vulkan, 3);
    window.suspend(true);
    window.close();
    // Every frame tries again: the window may have a handle by then.
    let errors = (0..6).filter_map(|blue| vulkan.submit(&inputs(blue, true)).err()).take(2);
    let errors: Vec<String> = errors.map(|error| error.to_string()).collect();
    assert!(errors.iter().all(|error| error.contains("the window cannot be drawn in now")), "{errors:?}");
    assert_eq!(errors.len(), 2);
    window.suspend(false);
    let error = (0..4).find_map(|blue| vulkan.submit(&inputs(blue, true)).err());
    assert!(matches!(&error, Some(BackendError::SurfaceLost { .. })), "{error:?}");
    assert_eq!(frame(&mut vulkan, &inputs(9, false)).output.unwrap().bytes[2], 9);
    finish(vulkan);
}

#[test]
fn a_device_without_a_window_shows_nothing_and_draws() {
    let mut vulkan = open_with(gradients(Format::Rgba8Unorm));
    vulkan.resize_window(3, 4);
    vulkan.set_vsync(false);
    show(&mut vulkan, 77);
    finish(vulkan);
}

#[test]
fn the_window_is_the_executors_that_was_opened_in_it_and_others_draw_on_without() {
    let (_screen, window, mut vulkan) = opened();
    let mut other = vulkan.new_context().expect("another executor");
    load(&mut vulkan, gradients(Format::Rgba8Unorm));
    load(&mut other, gradients(Format::Rgba16Float));
    for blue in 20..26 {
        vulkan.submit(&inputs(blue, true)).unwrap();
        other.submit(&FrameInputs { show: true, ..inputs(99, true) }).unwrap();
    }
    window.expect(&drawn(25, SIZE), 0);
    // The device keeps the window after the window's executor is closed, and draws without presenting.
    assert_eq!(vulkan.close(), Vec::<String>::new());
    show(&mut other, 7);
    assert_eq!(window.pixels(), drawn(25, SIZE));
    finish(other);
    assert_eq!(Arc::strong_count(&window), 1);
    again_comparing_submissions(
        "screen::the_window_is_the_executors_that_was_opened_in_it_and_others_draw_on_without",
    );
}
