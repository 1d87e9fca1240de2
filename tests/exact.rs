//! `render --backend reference`: the exact renderer as a command.

use crate::files::Place;
use serde_json::Value;
use splatgraph::io::image::Image;
use splatgraph::studies::metrics;
use std::fs;

#[test]
fn the_exact_renderer_is_a_backend_of_render_and_close_to_a_graph_with_its_exact_settings() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let exact = [
        "render",
        "scene.ply",
        "-c",
        "cameras.json",
        "--backend",
        "reference",
        "-o",
        "exact",
        "--format",
        "npy",
        "--output",
        "contributors=count.npy",
        "--output",
        "alpha=alpha.exr",
        "--json",
        "stats.json",
    ];
    let (code, errors) = place.code(&exact);
    assert_eq!(code, Some(0), "{errors}");
    let stats: Value =
        serde_json::from_slice(&fs::read(place.at("stats.json")).expect("written")).expect("JSON");
    assert_eq!(stats[1]["camera"], "two");
    assert_eq!(stats[1]["rules"]["extent"], "Tiles");
    assert!(stats[0]["mean_contributors"].as_f64().is_some_and(|mean| mean > 0.1), "{stats}");
    for name in ["count-one.npy", "count-two.npy", "alpha-one.exr", "alpha-two.exr"] {
        assert!(place.at(name).is_file(), "{name}");
    }
    let (code, errors) = place.code(&[
        "render",
        "scene.ply",
        "-c",
        "cameras.json",
        "--pipeline",
        "splat",
        "--set",
        "target=rgba32f",
        "-o",
        "graph",
        "--format",
        "npy",
    ]);
    assert_eq!(code, Some(0), "{errors}");
    for name in ["one", "two"] {
        let load = |folder: &str| Image::load(&place.at(&format!("{folder}/{name}.npy"))).expect("a picture");
        let found = metrics::compare(&load("exact"), &load("graph")).expect("of one size");
        assert!(found.psnr() > 60.0, "{name}: {found:?}");
    }
}

#[test]
fn a_changed_rule_changes_the_picture_and_options_of_graphs_are_refused() {
    let place = Place::new();
    let draw = |more: &[&str]| {
        let (code, errors) = place.code(&[&["render", "scene.ply", "--size", "64x48"], more].concat());
        (code, errors)
    };
    let exact = ["--backend", "reference", "-o"];
    assert_eq!(draw(&[&exact[..], &["a.npy"]].concat()).0, Some(0));
    assert_eq!(
        draw(&[&exact[..], &["b.npy", "--rule", "sh_degree=0", "--rule", "low_pass=none"]].concat()).0,
        Some(0)
    );
    let load = |name: &str| Image::load(&place.at(name)).expect("a picture");
    assert_ne!(load("a.npy"), load("b.npy"));
    for (more, why) in [
        (&["--rule", "stopp=none"][..], "did you mean `stop`"),
        (&["--rule", "stop=never"], "expected a number or `none`, found `never`"),
        (&["--set", "digit_bits=4"], "--set is for graphs"),
        (&["--pipeline", "key16"], "--pipeline is for graphs"),
        (&["--validate"], "--validate is for graphs"),
        (&["--output", "depht=b.npy"], "found `depht`"),
        (&["--output", "contributors=c.png"], "extension .npy"),
        (&["--output", "contributors=a.npy"], "one file"),
        (&["--output", "b.npy"], "expected one --output without a name, found 2"),
    ] {
        let (code, errors) = draw(&[&exact[..], &["a.npy"], more].concat());
        assert_eq!(code, Some(2), "{more:?}: {errors}");
        assert!(errors.contains(why), "{more:?}: {errors}");
    }
    let (code, errors) = draw(&["-o", "c.png", "--rule", "stop=none"]);
    assert!(code == Some(2) && errors.contains("add --backend reference"), "{errors}");
    assert!(!place.at("c.png").exists());
}
