//! `render --backend reference`: the exact renderer as a command.

use crate::images::psnr;
use crate::place::Place;

#[test]
fn the_exact_renderer_is_a_backend_of_render_and_close_to_a_graph_with_its_exact_settings() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    place.done(
        "render scene.ply -c cameras.json --backend reference -o exact --format npy --output contributors=count.npy \
         --output alpha=alpha.exr --json=stats.json",
    );
    let stats = place.json("stats.json");
    assert_eq!(stats[1]["camera"], "two");
    assert_eq!(stats[1]["rules"]["extent"], "Tiles");
    assert!(stats[0]["mean_contributors"].as_f64().is_some_and(|mean| mean > 0.1), "{stats}");
    for name in ["count-one.npy", "count-two.npy", "alpha-one.exr", "alpha-two.exr"] {
        assert!(place.at(name).is_file(), "{name}");
    }
    place
        .done("render scene.ply -c cameras.json --pipeline splat --set target=rgba32f -o graph --format npy");
    for name in ["one", "two"] {
        let load = |folder: &str| place.image(&format!("{folder}/{name}.npy"));
        let db = psnr(&load("exact"), &load("graph"));
        assert!(db > 60.0, "{name}: {db:.1} dB");
    }
}

#[test]
fn a_changed_rule_changes_the_picture_and_options_of_graphs_are_refused() {
    let place = Place::new();
    let draw = "render scene.ply --size 64x48";
    let exact = format!("{draw} --backend reference -o");
    place.done(&format!("{exact} a.npy"));
    place.done(&format!("{exact} b.npy --rule sh_degree=0 --rule low_pass=none"));
    assert_ne!(place.image("a.npy"), place.image("b.npy"));
    let begin = format!("{exact} a.npy");
    let refused = [
        ("--rule stopp=none", "did you mean `stop`"),
        ("--rule stop=never", "expected a number or `none`, found `never`"),
        ("--set digit_bits=4", "--set is for graphs"),
        ("--pipeline key16", "--pipeline is for graphs"),
        ("--validate", "--validate is for graphs"),
        ("--output depht=b.npy", "found `depht`"),
        ("--output contributors=c.png", "extension .npy"),
        ("--output contributors=a.npy", "one file"),
        ("--output b.npy", "expected one --output without a name, found 2"),
    ];
    place.refuses(&begin, &refused.map(|(more, why)| (more, 2, why)));
    place.refuses(draw, &[("-o c.png --rule stop=none", 2, "add --backend reference")]);
}
