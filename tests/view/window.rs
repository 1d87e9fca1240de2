//! The real window as a user operates it, by pointer and keyboard, judged by the display's contents.

use super::program::{Program, middle};
use super::screen::{Pixels, comes};
use splatgraph::io::image::Image;
use std::thread::sleep;
use std::time::Duration;

/// Keys, by their X11 keysyms.
const ESCAPE: u32 = 0xff1b;
const RETURN: u32 = 0xff0d;
const HOME: u32 = 0xff50;
const F12: u32 = 0xffc9;

#[test]
fn a_person_uses_the_window() {
    let mut program =
        Program::start(3_000, "--pipeline pipelines/splat.ron --size 900x660 --scale 0.25 --show settings");
    let first = program.still();
    assert!(first.rgb.iter().any(|pixel| pixel.iter().any(|v| *v > 50)), "the view is empty");
    parameters(&mut program, &first);
    camera(&mut program, &first);
    mistakes(&mut program, &first);
    screen(&mut program, &first);

    program.close();
}

#[test]
fn a_window_at_rest_draws_nothing_until_something_happens() {
    let line = "--pipeline pipelines/splat.ron --size 900x780 --scale 0.25 --show settings";
    let mut program = Program::launch(2_000, line, |_| {});
    assert!(program.window.appears(), "no window came");
    program.window.focus();
    let control = program.control("param:sort");
    program.until(0, "a picture", |event| event["event"] == "frame" && event["busy"] == false);
    // The frame rate disappears a second after the last picture.
    sleep(Duration::from_secs(2));
    program.rests();
    let is_kept = comes(|| program.place.at("state/splatgraph/window.json").is_file());
    assert!(is_kept, "a signal that ends the program loses the layout of the window");
    let since = program.now();
    sleep(Duration::from_secs(3));
    assert_eq!(program.now(), since, "something is drawn");
    // A control under the pointer is redrawn.
    program.window.point(middle(control));
    program.frame_after(since);
    program.rests();
    // The window is drawn again after a key, after it is restored or resized, and after a file is edited.
    let mut since = program.now();
    program.window.key('h'.into());
    program.frame_after(since);
    program.rests();
    let shown = program.window.pixels([0, 0, 900, 780]);
    assert!(shown.rgb.iter().any(|pixel| pixel.iter().any(|v| *v > 50)), "the window is empty");
    program.window.unmap();
    program.window.map();
    let same = comes(|| program.window.pixels([0, 0, 900, 780]) == shown);
    assert!(same, "the window is not drawn again");
    since = program.now();
    program.window.resize(760, 560);
    program.swapped(since, "a", "another size");
    program.rests();
    since = program.now();
    program.place.edit("shaders/splat.frag", "alpha, alpha);", "alpha, alpha);\n    blended.rg = vec2(0.0);");
    program.swapped(since, "a", "splat.frag");
    let blue = comes(|| {
        let shown = program.window.pixels([0, 0, 760, 560]);
        shown.rgb.iter().all(|[r, g, _]| *r == 0 && *g == 0) && shown.rgb.iter().any(|[_, _, b]| *b > 50)
    });
    assert!(blue, "the edited shader is not shown");
    program.rests();
    // A keyframe that no file has: the first request to close the window says so.
    since = program.now();
    program.window.focus();
    program.window.key('k'.into());
    // Nothing on the screen shows it.
    sleep(Duration::from_secs(1));
    program.window.ask_to_close();
    program.until(since, "a notice", |event| event["name"] == "notice");
    program.close();
}

#[test]
fn a_graph_whose_file_is_deleted_is_replaced_by_the_built_in_one_with_a_message() {
    let mut program = Program::launch(100, "--pipeline pipelines/splat.ron", |_| {});
    assert!(program.window.appears(), "no window came");
    program.until(0, "a picture", |event| event["event"] == "frame" && event["busy"] == false);
    let since = program.now();
    std::fs::remove_file(program.place.at("pipelines/splat.ron")).expect("it is deleted");
    program.until(since, "a message", |event| {
        let text = event["text"].as_str().unwrap_or_default();
        text == "there is no file pipelines/splat.ron: the built-in graph of this name is drawn"
    });
    program.close();
}

#[test]
fn a_window_that_cannot_be_drawn_says_why_and_ends() {
    let program = Program::launch(100, "", |place| place.write("pipelines/view/window.ron", "Graph("));
    let (status, errors) = program.end();
    assert_eq!(status.code(), Some(1), "{errors}");
    assert!(errors.starts_with("error: the window's own graph cannot be drawn\n"), "{errors}");
    assert!(errors.contains("pipelines/view/window.ron:1:6"), "{errors}");
}

/// Tests the parameters' controls: each change triggers a build.
fn parameters(program: &mut Program, first: &Pixels) {
    let passes = |event: &serde_json::Value| event["passes"].as_u64().expect("it has passes");
    let since = program.now();
    let started =
        program.until(0, "the first plan", |event| event["renderer"] == "a" && event["event"] == "swapped");
    // Drags the slider from 8 bits to about 4.
    let rail = program.control("param:digit_bits");
    let ([left, _, right, _], [_, y]) = (rail, middle(rail));
    let at = |share: f32| [left + ((right - left) as f32 * share) as i32, y];
    program.drag(1, &[at(0.7), at(0.5), at(0.3)]);
    program.settle();
    let narrow = program.swapped(since, "a", "digit_bits");
    assert!(passes(&narrow) > passes(&started), "{narrow}");
    // The sorted order does not depend on the digit width.
    program.view_is("the same picture with other digits", first);

    let since = program.now();
    program.click("param:sort");
    program.swapped(since, "a", "sort");
    let unsorted = program.view_is_not("splats in the order of the file", first);
    let since = program.now();
    program.click("param:sort");
    program.swapped(since, "a", "sort");
    program.view_is("the sorted picture again", first);

    assert_eq!(program.find("param:sorter=subgroup"), None, "the choice is not open");
    let since = program.now();
    program.click("param:sorter");
    program.click("param:sorter=subgroup");
    program.swapped(since, "a", "sorter");
    program.view_is("the same order by another sorter", first);

    program.click("reset_all");
    program.settle();
    program.view_is("the same picture with defaults", first);
    assert!(unsorted != *first);
}

/// Clicks the field of the scale, and opens its menu before if necessary.
fn click_scale(program: &mut Program) {
    if program.find("scale").is_none() {
        program.click("menu");
    }
    program.click("scale");
}

/// Tests that the pointer and keys move the camera over the view, but not elsewhere.
fn camera(program: &mut Program, first: &Pixels) {
    let view = program.control("view");
    let [x, y] = middle(view);
    program.drag(1, &[[x, y], [x + 40, y + 10], [x + 80, y + 20]]);
    let orbited = program.view_is_not("the scene from another side", first);

    // A drag that began in the view continues over a panel.
    let panel = middle(program.control("param:sorter"));
    program.point([view[0] + 20, y]);
    program.window.press(1);
    program.act();
    program.point(panel);
    let there = program.view_is_not("what a drag onto a panel shows", &orbited);
    // Moves up: the camera may already look straight down, so that moving down would change nothing.
    program.point([panel[0], panel[1] - 80]);
    program.view_is_not("what a drag over a panel shows", &there);
    program.window.release(1);
    program.act();

    // The wheel zooms over the view, and scrolls over a panel.
    let before = program.still();
    program.point([x, y]);
    program.wheel(true);
    let near = program.view_is_not("the scene from nearer", &before);
    program.point(panel);
    let place = program.control("param:sorter");
    program.wheel(false);
    assert!(program.still() == near, "the wheel over a panel moves the camera");
    let scrolled = program.find("param:sorter");
    assert_ne!(scrolled, Some(place), "the wheel over a panel does not scroll it");
    let since = program.now();
    program.wheel(true);
    program.until(since, "the panel as it was", |event| {
        event["name"] == "param:sorter" && event["top"].as_f64() == Some(place[1].into())
    });

    // Keys move the camera after a control was used, but not while a number is being edited.
    click_scale(program);
    program.keys(&['0', '.', '5', 'f'].map(u32::from));
    // The first Esc leaves the field, the second closes the menu that covers the picture.
    program.keys(&[ESCAPE]);
    program.keys(&[ESCAPE]);
    assert!(program.still() == near, "writing in a field moves the camera");
    let since = program.now();
    click_scale(program);
    program.keys(&['0', '.', '5'].map(u32::from));
    program.keys(&[RETURN]);
    program.swapped(since, "a", "another size");
    let since = program.now();
    click_scale(program);
    program.keys(&['0', '.', '2', '5'].map(u32::from));
    program.keys(&[RETURN]);
    program.swapped(since, "a", "another size");
    program.keys(&[ESCAPE]);
    program.view_is("the scale of before", &near);
    program.keys(&['f'.into()]);
    program.view_is_not("the whole scene", &near);
    program.keys(&[HOME]);
    program.view_is("the first view", first);

    // A press in the view takes the keyboard from a field.
    click_scale(program);
    // The press is beside the menu, and closes it.
    let [x, y] = [view[2] - 80, view[3] - 40];
    program.drag(3, &[[x, y], [x + 30, y]]);
    program.view_is_not("what a turned head sees", first);
    program.keys(&[HOME]);
    program.view_is("the first view", first);
}

fn mistakes(program: &mut Program, first: &Pixels) {
    assert_eq!(program.find("mistakes"), None);
    let since = program.now();
    let shader =
        program.place.edit("shaders/project.comp", "void main() {", "void main() {\n    int i = undeclared;");
    let failed = program.until(since, "the failure", |event| event["event"] == "failed");
    assert!(failed["text"].as_str().is_some_and(|text| text.contains("undeclared")), "{failed}");
    program.frames(3);
    let [left, top, right, bottom] = program.control("mistakes");
    let view = program.control("view");
    let [x, y] = [view[0], view[1]];
    // The message is text on a dark, reddish background.
    let shown = program.view();
    let part: Vec<_> = (top - y + 2..bottom - y - 2)
        .flat_map(|row| (left - x + 2..right - x - 2).map(move |column| (column as usize, row as usize)))
        .map(|(column, row)| shown.at(column, row))
        .collect();
    let reddish = part.iter().filter(|[r, g, b]| *r < 100 && r > g && r > b).count();
    let bright = part.iter().filter(|pixel| pixel.iter().any(|v| *v > 150)).count();
    assert!(2 * reddish > part.len() && bright > 0, "{reddish} and {bright} of {} pixels", part.len());
    // Above the message, the last good picture stays.
    let above = |pixels: &Pixels| pixels.rgb[..(top - y - 8) as usize * pixels.width].to_vec();
    assert!(above(&shown) == above(first), "the picture does not stay");

    let since = program.now();
    program.place.write("shaders/project.comp", shader);
    program.until(since, "the mending", |event| event["event"] == "mended");
    program.until(since, "the end of the message", |event| {
        event["event"] == "control_gone" && event["name"] == "mistakes"
    });
    program.view_is("the picture alone", first);
}

fn screen(program: &mut Program, first: &Pixels) {
    program.window.unmap();
    program.act();
    program.window.map();
    program.window.focus();
    program.view_is("the same after it was away", first);

    // A minimised window draws nothing, and uses no CPU time, even if something asks for a frame.
    program.window.set_minimised(true);
    program.rests();
    let [x, y] = middle(program.control("view"));
    program.window.point([x, y]);
    program.window.point([x + 1, y]);
    program.rests();
    let before = program.main_thread_time();
    sleep(Duration::from_secs(1));
    let busy = program.main_thread_time() - before;
    assert!(busy < Duration::from_millis(100), "the window took {busy:?} in a second");
    program.window.set_minimised(false);
    program.act();

    let since = program.now();
    program.window.resize(760, 560);
    program.until(since, "the new size", |event| {
        event["event"] == "window" && event["width"] == 760 && event["height"] == 560
    });
    program.swapped(since, "a", "another size");
    program.settle();
    let view = program.control("view");
    assert!(view[2] == 760 && view[3] < 560 && view[3] > 480, "{view:?}");
    let shown = program.still();
    assert!(shows_the_same_in_another_size(&shown, first));

    let whole = program.window.pixels([0, 0, 760, 560]);
    let since = program.now();
    program.keys(&[F12]);
    let saved = program.until(since, "the screenshot", |event| event["event"] == "screenshot");
    let path = program.place.at(saved["path"].as_str().expect("a path"));
    let image = Image::load(&path).expect("a picture");
    assert_eq!((image.width, image.height), (760, 560));
    // Skips the bar above the view: it shows the time of a frame, which changes.
    let bar = view[1] as usize * image.width;
    for (index, (saved, shown)) in image.rgb.iter().zip(&whole.rgb).enumerate().skip(bar) {
        let close =
            saved.iter().zip(shown).all(|(saved, shown)| (saved * 255.0 - f32::from(*shown)).abs() <= 1.0);
        assert!(close, "pixel {index} is saved as {saved:?} and shown as {shown:?}");
    }
}

/// Returns true if two pictures of different sizes may show the same scene: their mean colours are similar.
fn shows_the_same_in_another_size(a: &Pixels, b: &Pixels) -> bool {
    let mean = |pixels: &Pixels| {
        let mut sum = [0u64; 3];
        for pixel in &pixels.rgb {
            for (sum, v) in sum.iter_mut().zip(pixel) {
                *sum += u64::from(*v);
            }
        }
        sum.map(|sum| sum as f64 / pixels.rgb.len() as f64)
    };
    mean(a).iter().zip(mean(b)).all(|(a, b)| (a - b).abs() < 25.0)
}
