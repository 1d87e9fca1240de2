//! `advise` as a command: a scene's needs, and the cheapest setting within a budget.

use crate::common;
use crate::images::psnr;
use crate::place::Place;
use serde_json::Value;
use splatgraph::draw::keys::{Keys, Mapping};
use splatgraph::draw::session::Session;
use splatgraph::{draw::camera, draw::capture};
use splatgraph_assets::{Camera, Scene, Splat};
use splatgraph_reference::Rules;
use std::collections::HashMap;

fn ahead() -> Camera {
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
    Camera { img_name: "ahead".into(), ..camera }
}

/// Generates splats on the camera's axis at these ascending depths, the farthest first in the file. `sh` returns the
/// harmonic with an index, equal for all splats.
fn on_the_axis(depths: &[f32], sh: impl Fn(usize) -> f32 + Sync) -> Scene {
    Scene::generate(depths.len() as u32, 3, |at| Splat {
        position: [0.0, 0.0, depths[depths.len() - 1 - at]],
        scale: [0.2; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.5,
        sh: std::array::from_fn(&sh),
    })
}

fn advice(scene: &Scene) -> (String, Value) {
    let place = Place::new();
    scene.write_ply(place.at("own.ply")).expect("the scene is written");
    Camera::save(&[ahead()], place.at("ahead.json")).expect("the camera is written");
    (place.done("advise own.ply -c ahead.json --json=advice.json"), place.json("advice.json"))
}

fn bits(advice: &Value, map: &str) -> Option<u64> {
    let keys = advice["keys"].as_array().expect("keys");
    keys.iter().find(|need| need["map"] == map).expect("the mapping")["bits"].as_u64()
}

#[test]
fn an_outlier_at_2e7_takes_the_bits_of_linear_keys_alone() {
    // 64 depths from 1 to 2, and an outlier at 2e7. A step of 1/64 is 2^-30.3 of the linear range, which takes 31 bits.
    // As float bits it is 2^17 of the 24.2 * 2^23 values between 1 and 2e7, which takes 11 bits.
    let mut depths: Vec<f32> = (0..64u8).map(|i| 1.0 + f32::from(i) / 64.0).collect();
    depths.push(2e7);
    let (text, advice) = advice(&on_the_axis(&depths, |_| 0.1));
    assert_eq!((bits(&advice, "linear"), bits(&advice, "float_bits")), (Some(31), Some(11)), "{text}");
    let equalised = bits(&advice, "equalised").expect("32 bits are enough");
    let narrowest = if equalised < 11 { ("equalised", equalised) } else { ("float_bits", 11) };
    let said = format!("narrowest: key_map={} key_bits={}", narrowest.0, narrowest.1);
    assert!(equalised < 14 && text.contains("linear 31") && text.contains(&said), "{text}");
    assert_eq!(advice["report"]["place"]["outliers"], 1, "{text}");
}

#[test]
fn a_scene_without_view_dependence_is_told_to_leave_the_bands_out() {
    let depths: Vec<f32> = (0..20u8).map(|i| 2.0 + f32::from(i)).collect();
    let (text, flat) = advice(&on_the_axis(&depths, |at| if at < 3 { 0.4 } else { 0.0 }));
    assert!(text.contains("none: sh_degree=0 draws the same picture"), "{text}");
    assert!(flat["bands"].as_array().expect("bands")[1..].iter().all(|band| band["rms"] == 0.0), "{flat}");
    let (text, glossy) = advice(&on_the_axis(&depths, |at| if at < 12 { 0.4 } else { 0.0 }));
    assert!(!text.contains("sh_degree=0"), "{text}");
    assert_eq!(glossy["bands"][1]["share"], 1.0, "{glossy}");
}

#[test]
fn splats_below_the_alpha_floor_count_neither_for_keys_nor_for_harmonics() {
    // Pairs of splats at neighbouring float depths. The nearer splat of a pair comes later in the file; it is hidden,
    // and it alone has harmonics.
    let scene = |opacity: f32| {
        Scene::generate(40, 3, |at| {
            let hidden = at % 2 == 1;
            let pair = 20 - (at / 2) as u32;
            let near = f32::from_bits((1.0 + 0.5 * pair as f32).to_bits() - u32::from(hidden));
            Splat {
                position: [0.0, 0.0, near],
                scale: [0.2; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity: if hidden { opacity } else { 0.5 },
                sh: std::array::from_fn(|i| if i < 3 || hidden { 0.4 } else { 0.0 }),
            }
        })
    };
    let (text, hidden) = advice(&scene(0.0039));
    assert_eq!(bits(&hidden, "float_bits"), Some(8), "{text}");
    assert!(text.contains("none: sh_degree=0 draws the same picture"), "{text}");
    assert!(
        text.contains(
            "degree 3 stored, 0 in use, the bands above are zero in every splat that can be visible"
        ),
        "{text}"
    );
    assert_eq!(
        (&hidden["report"]["effective_sh_degree"], &hidden["report"]["shown_sh_degree"]),
        (&3.into(), &0.into())
    );
    // Slightly above the floor they are visible.
    let (text, shown) = advice(&scene(0.004));
    assert!(bits(&shown, "float_bits") > Some(20), "{text}");
    assert!(text.contains("degree 3 stored, 3 in use") && !text.contains("sh_degree=0"), "{text}");
    assert_eq!(shown["report"]["shown_sh_degree"], 3, "{text}");
}

#[test]
fn keys_are_predicted_as_the_shader_makes_them() {
    let scene = crate::place::scene();
    let camera = splatgraph_assets::synth::demo_cameras().swap_remove(0).resized(96, 54);
    let range = camera::depth_range(&camera, &scene.bounds()).map(|z| z as f32);
    let (visible, _) = splatgraph_reference::visible(&scene, &camera, &Rules::PUBLISHED);
    let depth: HashMap<u32, f32> = visible.iter().map(|splat| (splat.index, splat.depth as f32)).collect();
    let mut everywhere = Rules::PUBLISHED;
    everywhere.set("extent", "unbounded").expect("a rule");
    // Equalised keys depend on everything that the graph draws, which may extend slightly beyond the published squares.
    let (all, _) = splatgraph_reference::visible(&scene, &camera, &everywhere);
    let all: HashMap<u32, f32> = all.iter().map(|splat| (splat.index, splat.depth as f32)).collect();
    let mut session = Session::new(common::device(), scene, "splat", &[]);
    for map in Mapping::ALL {
        for bits in [8, 11, 16, 24, 32] {
            let set = [("key_bits", bits.to_string()), ("key_map", map.name().to_owned())];
            session.set_graph("splat", &set.map(|(name, value)| (name.to_owned(), value)));
            session.prepare((camera.width, camera.height), &mut |_| {}).expect("it is prepared");
            let order = capture::take(&mut session, &camera).expect("a picture").order.expect("an order");
            let drawn = order.iter().map(|index| all[index]);
            let of = Keys::new(map, (range[0], range[1]), bits, drawn);
            let key = |index: &u32| Some((of.of(*depth.get(index)?), *index));
            let keys: Vec<(u32, u32)> = order.iter().filter_map(key).collect();
            assert!(keys.len() > 50, "{} of {}", keys.len(), order.len());
            assert!(keys.is_sorted(), "{map:?}, {bits} bits: {keys:?}");
            let ties = keys.windows(2).filter(|pair| pair[0].0 == pair[1].0).count();
            assert!(bits > 8 || ties > 3, "narrow keys have ties: {ties}");
        }
    }
    common::assert_silent(session.device(), "keys");
}

#[test]
fn the_advised_command_draws_the_promised_psnr() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let text =
        place.done("advise scene.ply -c cameras.json --psnr 40 --rounds 1 --frames 1 --json=advice.json");
    let json = place.json("advice.json");
    let promised: Vec<f64> =
        json["advised"]["psnr_db"].as_array().expect("a list").iter().filter_map(Value::as_f64).collect();
    assert!(promised.len() == 2 && promised.iter().all(|db| *db >= 40.0), "{text}");
    let tried = json["tried"].as_array().expect("a list").iter().map(|tried| &tried["setting"]["name"]);
    let names: Vec<&str> = tried.filter_map(Value::as_str).collect();
    let of = |parameter: &str| names.iter().any(|name| name.starts_with(parameter));
    assert!(of("key_bits = "), "{names:?}");

    // Runs the printed command as it is, then again with float pictures (.npy), which are not rounded to 8 bits.
    let command = text.lines().find_map(|line| line.strip_prefix("splatgraph ")).expect("a command");
    place.done(command);
    assert!(["one", "two"].iter().all(|name| place.at(format!("advised/{name}.png")).is_file()), "{command}");
    let (drawing, _) = command.rsplit_once(' ').expect("words");
    place.done(&format!("{drawing} drawn --format npy"));
    place.done("render scene.ply -c cameras.json --backend reference -o exact --format npy");
    for (name, promised) in ["one", "two"].iter().zip(promised) {
        let load = |folder: &str| place.image(&format!("{folder}/{name}.npy"));
        let found = psnr(&load("drawn"), &load("exact"));
        assert!((found - promised).abs() < 1e-6, "{name}: {found}, promised {promised}");
    }

    // The advised command has the user's own settings.
    let text = place.done("advise scene.ply --set sh_degree=0 --psnr 5 --size 64x48 --rounds 1 --frames 1");
    let command = text.lines().find(|line| line.starts_with("splatgraph ")).expect("a command");
    assert!(command.contains("sh_degree=0"), "{command}");

    // A value that is the default beside the exact settings stays if the changed parameter changes that default.
    let graph = r#"Graph(version: 1, summary: "a default that depends on another parameter",
        params: {
            "bits": Const(Int(default: 32, exact: 32, range: (8, 32))),
            "degree": Const(Int(default: "bits == 32 ? 1 : 0", exact: 1, range: (0, 1))) },
        passes: [Include(graph: "splat", name: "scene", set: { "key_bits": "bits", "sh_degree": "degree" },
            expose: Only(["cutoff", "budget", "alpha_floor", "alpha_cap", "jacobian_limit"]))],
        output: "scene.picture")"#;
    place.write("own.ron", graph);
    place.done("advise scene.ply -p own.ron --psnr 5 --size 64x48 --rounds 1 --frames 1 --json=own.json");
    let json = place.json("own.json");
    let has_degree = |name: &str| {
        let mut tried = json["tried"].as_array().expect("a list").iter().map(|tried| &tried["setting"]);
        let setting = tried.find(|setting| setting["name"] == name);
        setting.map(|setting| setting["set"].to_string().contains(r#"["degree","1"]"#))
    };
    assert_eq!(["exact", "bits = 8"].map(has_degree), [Some(false), Some(true)], "{json}");

    // Other projections are compared with exact pictures of the same projection.
    place.done("advise scene.ply -p fisheye --psnr 45 --size 64x48 --rounds 1 --frames 1");
    place.refuses("", &[("advise scene.ply --psnr 0", 2, "expected a number above 0")]);
}
