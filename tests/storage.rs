//! The memory of a scene on the device: buffers freed after the first frame, and packed splats' size and error.

use crate::common::{self, settings};
use crate::golden::Golden;
use crate::images::{self, bytes, draw_scene, psnr};
use crate::place::Place;
use splatgraph::draw::session::Session;
use splatgraph::io::image::Image;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, synth};
use std::sync::Arc;

fn session(scene: &Arc<Scene>, set: &[(&str, &str)]) -> Session {
    images::session(scene.clone(), "tiled_cpu", set)
}

fn draw(session: &mut Session, camera: &Camera) -> Image {
    images::picture(session, camera, [0.0; 3])
}

/// Returns the bytes of the session's whole memory, and of the scene in it.
fn memory(session: &mut Session) -> (u64, u64) {
    let listed = session.device().memory();
    let scene = listed.iter().filter(|(name, _)| name.starts_with("splats.scene."));
    (listed.iter().map(|(_, bytes)| bytes).sum(), scene.map(|(_, bytes)| bytes).sum())
}

/// Checks the listed bytes against the device's own count, which includes the gaps between its allocator's
/// suballocations.
fn assert_all_is_listed(session: &mut Session, what: &str) {
    let (listed, used) = (memory(session).0, session.device().device_memory().used);
    assert!((listed..listed + 4096).contains(&used), "{what}: {listed} bytes are listed, {used} are used");
}

#[test]
fn attributes_that_are_packed_are_freed_and_a_reload_draws_the_same_bytes() {
    let scene = Arc::new(synth::generate("uniform", 4096, 0).expect("a scene"));
    let camera = Camera::framing(&scene, 96, 54);
    let mut session = session(&scene, &[("sh_storage", "f16"), ("covariance", "six")]);
    session.prepare((96, 54), &mut |_| {}).expect("prepared");
    let n = u64::from(scene.count());
    let loading = memory(&mut session).1;
    assert_all_is_listed(&mut session, "while loading");
    assert!(loading >= (12 + 4 + 12 + 16 + 192 + 24 + 96) * n, "{loading}");
    let first = draw(&mut session, &camera);
    let resident = memory(&mut session).1;
    assert_all_is_listed(&mut session, "after the first frame");
    assert!(resident >= (12 + 4 + 24 + 96) * n && resident < (12 + 4 + 24 + 96 + 1) * n, "{resident}");
    // Changing a constant loads the freed attributes again, and so does changing it back.
    for covariance in ["half", "six"] {
        session.set_graph("tiled_cpu", &settings(&[("sh_storage", "f16"), ("covariance", covariance)]));
        let again = draw(&mut session, &camera);
        assert_eq!(bytes(&again) == bytes(&first), covariance == "six", "{covariance}");
        assert_all_is_listed(&mut session, covariance);
    }
    images::close(session, "a reload");
}

/// Values of `storage`: maximum bytes per splat, and minimum PSNR on captures.
const PACKED: [(&str, u64, f64); 3] = [("b64", 64, 60.0), ("b32", 32, 45.0), ("b24", 24, 40.0)];

#[test]
fn packed_splats_take_no_more_than_their_bytes_at_any_degree() {
    for degree in ["3", "2", "1", "0"] {
        // 5000 splats: the last block is not full.
        let scene = Arc::new(synth::generate("uniform", 5000, 0).expect("a scene"));
        let camera = Camera::framing(&scene, 96, 54);
        let exact = draw(&mut session(&scene, &[("sh_degree", degree)]), &camera);
        for (storage, most, _) in PACKED {
            let mut session = session(&scene, &[("sh_degree", degree), ("storage", storage)]);
            let found = psnr(&draw(&mut session, &camera), &exact);
            let resident = memory(&mut session).1;
            println!("{storage}, degree {degree}: {} bytes, {found:.1} dB", resident as f64 / 5000.0);
            assert!(resident <= most * 5000, "{storage}, degree {degree}: {resident}");
            assert_all_is_listed(&mut session, storage);
            assert!(found > 25.0, "{storage}, degree {degree}: {found:.1} dB");
            common::assert_silent(session.device(), storage);
        }
    }
}

#[test]
fn packed_captures_keep_their_decibels() {
    let Some(data) = common::data("packed_captures_keep_their_decibels") else { return };
    for name in ["playbot-31k", "biker"] {
        let golden = Golden::whole(&data, name);
        let scene = golden.scene();
        let cameras: Vec<Camera> = golden.cameras().iter().take(2).map(|c| c.resized(480, 270)).collect();
        let images = |set: &[(&str, &str)]| draw_scene(scene.clone(), &cameras, "tiled_cpu", [0.0; 3], set);
        let exact = images(&[]);
        for (storage, _, least) in PACKED {
            let found = images(&[("storage", storage)]);
            let worst = found.iter().zip(&exact).map(|(a, b)| psnr(a, b)).fold(f64::INFINITY, f64::min);
            println!("{name}, {storage}: {worst:.1} dB");
            assert!(worst >= least, "{name}, {storage}: {worst:.1} dB");
        }
    }
}

#[test]
fn a_limit_of_memory_chooses_the_storage_of_the_splats() {
    let place = Place::empty();
    place.done("synth demo --count 4000 -o scene.ply");
    let render = "render scene.ply -p tiled_cpu --size 96x54";
    let (code, error) = place.code(&format!("{render} -o a.png --memory 1000"));
    assert!(code == Some(1) && error.contains("expected a plan of at most 1000 bytes"), "{error}");
    assert!(!place.at("a.png").exists());
    // The report says what would fit.
    let report = place.done("info scene.ply -p tiled_cpu --size 96x54 --device=llvmpipe --memory 1000");
    assert!(
        report.contains(" splats do not fit:\n    all resources: expected at most 1000 bytes"),
        "{report}"
    );
    let (_, needed) = error.split_once("(storage=b24) needs ").expect("the smallest storage");
    let needed: u64 =
        needed.split_once(" bytes\n").and_then(|(bytes, _)| bytes.parse().ok()).expect("a number");
    let (_, error) = place.code(&format!("{render} -o a.png --memory {}", needed - 4096));
    assert!(error.contains(" splats would fit\n  `--where"), "{error}");

    for (memory, setting, chosen) in [
        (needed.to_string(), "--set storage=b24", "storage=b24"),
        ("8GiB".to_owned(), "", "the graph's own storage"),
    ] {
        let said = place.said(&format!("{render} -o limited.png --json=limited.json --memory {memory}")).1;
        assert!(said.contains(&format!("storage: {chosen} needs ")), "{said}");
        place.done(&format!("{render} -o set.png --json=set.json {setting}"));
        assert!(place.bytes("limited.png") == place.bytes("set.png"), "{chosen}");
        let [limited, set] = ["limited.json", "set.json"].map(|name| place.json(name));
        assert_eq!(limited[0]["parameters"], set[0]["parameters"]);
        place.done(&format!(
            "info scene.ply -p tiled_cpu --size 96x54 --device=llvmpipe --memory {memory} --json=info.json"
        ));
        let info = place.json("info.json");
        let tried = info["storage"]["tried"].as_array().expect("settings");
        assert_eq!(tried.last().expect("one")["setting"], chosen);
        let resident: u64 = info["buffers"]
            .as_array()
            .expect("buffers")
            .iter()
            .filter(|b| b["freed"] == false)
            .map(|b| b["bytes"].as_u64().expect("bytes"))
            .sum();
        assert!(tried.last().expect("one")["bytes"].as_u64().expect("bytes") <= resident, "{info}");
    }
    place.refuses(
        "",
        &[
            ("render scene.ply --backend reference -o a.png --memory 1GiB", 2, "--memory is for graphs"),
            ("render scene.ply -o a.png --memory much", 2, "expected bytes, such as 8GiB"),
        ],
    );
}
