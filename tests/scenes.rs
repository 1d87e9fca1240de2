//! Several scenes in one picture: a composition file, names on the command line and `convert` must agree bit by bit.

use crate::place::Place;
use splatgraph::draw::fit::{Fit, Target};
use splatgraph::io::load::LoadOptions;

fn scenes() -> Place {
    let place = Place::empty();
    place.done("synth demo --count 3000 -o a.ply --cameras cameras.json");
    place.done("synth demo --count 2000 --seed 5 -o b.ply");
    place
}

fn picture(place: &Place, scenes: &str) -> Vec<u8> {
    place.done(&format!("render {scenes} -c cameras.json#0 --size 96x54 -p splat -o out.npy"));
    place.bytes("out.npy")
}

fn converted(place: &Place, line: &str) -> Vec<u8> {
    place.done(&format!("convert {line} converted.ply"));
    place.bytes("converted.ply")
}

const PLACE: &str = "scale: 0.5, rotate: (axis: (0, 1, 0.5), degrees: 30), translate: (1, -0.5, 2)";

#[test]
fn scenes_of_a_file_are_those_that_convert_moves_and_merges_bit_by_bit() {
    let place = scenes();
    place.write("moved.ron", format!("Scenes([Scene(file: \"b.ply\", {PLACE})])"));
    let steps = "--transform=scale:0.5 --transform=rotate:0,1,0.5,30 --transform=move:1,-0.5,2";
    let moved = converted(&place, &format!("b.ply {steps}"));
    assert!(moved == converted(&place, "moved.ron"), "moved");
    place.write("plain.ron", "// Two scenes.\nScenes([Scene(file: \"a.ply\"), Scene(file: \"b.ply\")])");
    assert!(converted(&place, "a.ply --merge=b.ply") == converted(&place, "plain.ron"), "merged");
    assert!(place.done("info plain.ron").contains("5,000"));
    place.write("twice.ron", "Scenes([Scene(file: \"b.ply\"), Scene(file: \"a.ply\"), Scene(file: \"b.ply\", translate: (1, 0, 0))])");
    let found = place.told("info twice.ron --json");
    let number = |entry: usize, field: &str| found["scenes"][entry][field].as_u64().expect("a number");
    let counts = [0, 1, 2].map(|entry| number(entry, "count"));
    assert_eq!([0, 1, 2].map(|entry| number(entry, "first")), [0, counts[0], counts[0] + counts[1]]);
    assert_eq!((counts[0], Some(counts.iter().sum())), (counts[2], found["report"]["splats"].as_u64()));
}

#[test]
fn scenes_on_the_command_line_are_drawn_in_one_sort_with_their_places() {
    let place = scenes();
    let text = "Scenes([Scene(file: \"a.ply\"), Scene(file: \"b.ply\", translate: (0.5, -0.25, 1))])";
    place.write("both.ron", text);
    let both = picture(&place, "both.ron");
    assert!(both == picture(&place, "a.ply b.ply --at=0.5,-0.25,1"));
    assert!(both != picture(&place, "a.ply b.ply"), "the second scene is in the picture");
    // The folder gets one picture of both scenes, not a picture of each. It also has a file of an earlier run.
    place.write("both/old.png", "");
    let (_, errors) = place.said("render a.ply b.ply -c cameras.json#0 --size 16x9 -p splat -o both/");
    for line in ["2 scenes are in each picture; ", "both/: old.png is not of this run\n"] {
        assert!(errors.contains(line), "{line}: {errors}");
    }
    place.write("one/depth.npy", "");
    let one = "-o one/ --format npy -o depth=one/depth.npy";
    let (_, errors) = place.said(&format!("render a.ply -c cameras.json#0 --size 16x9 -p splat {one}"));
    assert!(!errors.contains("in each picture") && !errors.contains("of this run"), "{errors}");
}

#[test]
fn splats_that_a_condition_leaves_out_are_drawn_by_no_command() {
    let place = scenes();
    let some = "--where=opacity>0.5&&x<0.5";
    converted(&place, &format!("b.ply {some}"));
    place.done("convert converted.ply b2.ply");
    converted(&place, &format!("a.ply {some}"));
    let few = picture(&place, "converted.ply");
    assert!(few == picture(&place, &format!("a.ply {some}")) && few != picture(&place, "a.ply"));
    // Each scene has its own coordinates.
    let moved = "--at=0.5,-0.25,1";
    let both = picture(&place, &format!("a.ply b.ply {some} {moved}"));
    assert!(both == picture(&place, &format!("converted.ply b2.ply {moved}")));
    let (report, said) = place.said(&format!("info a.ply --json {some}"));
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let count = report["report"]["splats"].as_u64().expect("a number");
    assert!(said.contains(&format!("a.ply: --where leaves out {} of 3,000 splats", 3000 - count)), "{said}");
    // What is known of the file stays.
    let bytes = |line: &str| place.told(line)["size_breakdown"].clone();
    assert_eq!(bytes(&format!("info a.ply --json {some}")), bytes("info a.ply --json"));
    let (_, said) = place.said("render -o demo.npy --size 16x9 -p splat --where=index<10");
    assert!(said.contains("--where leaves out 199,990 of 200,000 splats"), "{said}");
    place.refuses(
        "render a.ply -o no.png",
        &[
            ("--where=opacity>2", 1, "expected --where to keep a splat, found none kept of 3,000 splats"),
            ("--where=opacty>0", 2, "column 1 of `opacty>0`"),
            ("--where=opacity", 2, "expected a condition, found `opacity`, which is "),
            ("--where=opacity>", 2, "column "),
        ],
    );
}

#[test]
fn a_level_is_that_of_the_scenes_with_levels_beside_scenes_and_lists_without() {
    let place = scenes();
    place.done("convert a.ply packed.sog");
    let mut archive =
        zip::ZipArchive::new(std::fs::File::open(place.at("packed.sog")).expect("a file")).expect("a ZIP");
    archive.extract(place.at("lod/0")).expect("unpacked");
    place.write(
        "lod/lod-meta.json",
        r#"{"version": 1, "lodLevels": 2, "filenames": ["0/meta.json"], "tree": {"lods": {
            "0": {"file": 0, "offset": 0, "count": 9}, "1": {"file": 0, "offset": 0, "count": 4}}}}"#,
    );
    place.write("list.ron", r#"Scenes([Scene(file: "a.ply"), Scene(file: "b.ply")])"#);
    let alone = place.told("render list.ron -o a.png --json --size 32x18")[0]["counts"]["loaded"].as_u64();
    for scenes in ["list.ron lod/lod-meta.json", "lod list.ron"] {
        let both = &place.told(&format!("render {scenes} -o a.png --json --size 32x18 --level 1"))[0];
        assert_eq!(both["counts"]["loaded"].as_u64(), alone.map(|count| count + 4), "{scenes}");
    }
    place.refuses("render list.ron -o a.png --level 1", &[("", 1, "expected a scene with levels")]);
    // A device with room for some of the splats has room for a coarser level.
    let fit = |most| Fit {
        device: Target::nominal(),
        fits: false,
        splats: 9,
        needed_bytes: 0,
        loading_bytes: 0,
        largest: None,
        too_large: Vec::new(),
        most_splats: Some(most),
    };
    let advice = |most| fit(most).advice(&place.at("lod/lod-meta.json"), &LoadOptions::default());
    assert_eq!(advice(4), "  `--level 1` has 4\n");
    assert!(advice(3).contains("`--where 'index % 3 == 0'` keeps 3"), "{}", advice(3));
}

#[test]
fn tags_in_which_scenes_differ_are_reported_by_every_command_that_merges() {
    let place = scenes();
    let mut tagged = place.bytes("b.ply");
    tagged.splice(4..4, b"comment vertical axis: z\n".iter().copied());
    place.write("tagged.ply", tagged);
    place.write("both.ron", "Scenes([Scene(file: \"a.ply\"), Scene(file: \"tagged.ply\")])");
    let told = "tags that are ignored, because the scenes differ in them: up";
    let all = "; for instance `render --up y`, or `convert --tag up=y`, gives all scenes one up direction\n";
    let tag = "`--up 0,0,1` turns all scenes upright if they share this direction; otherwise, `convert";
    let render = "render -c cameras.json#0 --size 16x9 -p splat -o out.png";
    for (scenes, name, advice) in [("both.ron", "both.ron", all), ("a.ply tagged.ply", "all scenes", tag)] {
        let (_, errors) = place.said(&format!("{render} {scenes}"));
        assert!(errors.contains(&format!("{name}: {told}")) && errors.contains(advice), "{errors}");
        let (_, errors) = place.said(&format!("{render} {scenes} --ignore-tags"));
        assert!(!errors.contains("tags"), "{errors}");
    }
    assert!(place.done("info both.ron").contains("tags left out         up: the merged scenes differ"));
    let lost = "lost: tags in which the merged scenes differ: up; for instance `--tag up=y` gives all one up direction\n";
    for scenes in ["both.ron", "a.ply --merge=tagged.ply"] {
        assert!(place.done(&format!("convert {scenes} out.ply")).contains(lost), "{scenes}");
    }
}

#[test]
fn mistakes_in_places_are_told() {
    let place = scenes();
    for (text, why) in [
        ("Scenes([\n  Scene(file: \"a.ply\", scal: 2),\n])", "bad.ron: line 2, column"),
        ("Scenes([Scene(file: \"none.ply\")])", "bad.ron: line 1, column 15: none.ply: cannot be read"),
        (
            "Scenes([Scene(file: \"bad.ron\")])",
            "bad.ron: line 1, column 15: bad.ron: expected one scene, found several",
        ),
    ] {
        place.write("bad.ron", text);
        place.refuses("info", &[("bad.ron", 1, why)]);
    }
    let too_many = "expected at most one --at for each scene after the first, found 2 for 1";
    place.refuses(
        "render a.ply b.ply",
        &[
            ("--at=1,2,3 --at=4,5,6 -o out.png", 2, too_many),
            ("--at=1,2 -o out.png", 2, "expected three numbers"),
            ("-o b.ply", 2, "expected the extension"),
        ],
    );
}

/// Adds the property `label` to a binary PLY: the index of a splat, modulo 3.
fn labelled(ply: &[u8]) -> Vec<u8> {
    let end = b"end_header\n";
    let at = ply.windows(end.len()).position(|window| window == end).expect("a header");
    let (header, rows) = (&ply[..at], &ply[at + end.len()..]);
    let properties = String::from_utf8_lossy(header).matches("\nproperty float ").count();
    let label = |index: usize| ((index % 3) as f32).to_le_bytes();
    let rows = rows.chunks_exact(4 * properties).enumerate();
    let rows = rows.flat_map(|(index, row)| row.iter().copied().chain(label(index)));
    [header, b"property float label\n", end].concat().into_iter().chain(rows).collect()
}

#[test]
fn a_graph_reads_properties_of_its_own_from_a_ply() {
    let place = Place::demo(2000);
    place.write("scene.ply", labelled(&place.bytes("scene.ply")));
    let tutorial = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/tutorial");
    for end in ["ron", "comp", "clear.comp", "vert", "frag"] {
        let name = format!("renderer.{end}");
        place.write(&name, std::fs::read(tutorial.join(&name)).expect("a file of the tutorial"));
    }
    place.edit(
        "renderer.ron",
        "imports: {",
        "imports: {\n\"label\": Import(from: \"scene.property.label\"),",
    );
    place.edit("renderer.ron", "\"Sh\":", "\"Labels\": \"label\", \"Sh\":");
    let read =
        "layout(set = 0, binding = 20, std430) readonly buffer Labels { float labels[]; };\n\n// Writes";
    place.edit("renderer.comp", "// Writes", read);
    let colour = "vec4(labels[i] == 0.0, labels[i] == 1.0, labels[i] == 2.0, 0.0)";
    place.edit("renderer.comp", "vec4(colour, 0.0)", colour);

    // Without a scene, any property may be imported; with one, only those that it was loaded with.
    assert!(place.done("check renderer.ron").contains(": OK\n"));
    let line = "render scene.ply -c cameras.json#0 --size 64x36 -p renderer.ron -o out.npy";
    let errors = place.fails(line, 1);
    for part in [
        "nothing is called `scene.property.label`",
        "--> renderer.ron:11",
        "--property NAME loads a property of a PLY file",
    ] {
        assert!(errors.contains(part), "{part}: {errors}");
    }
    let lit = |more: &str| {
        place.done(&format!("{line} {more}"));
        let image = place.image("out.npy");
        [0, 1, 2].map(|channel| image.rgb.iter().filter(|rgb| rgb[channel] > 0.05).count())
    };
    assert!(lit("--property label").iter().all(|pixels| *pixels > 100));
    let [red, green, blue] = lit("--property label --where=label==1");
    assert!(red == 0 && green > 100 && blue == 0, "{red} {green} {blue}");

    // Copies of the scene keep the property.
    place.done("convert scene.ply one.ply --property label --where=label==2");
    assert!(place.done("info one.ply").contains("label"));
    place.done("render one.ply -c cameras.json#0 --size 64x36 -p renderer.ron --property label -o out.npy");
    assert!(place.image("out.npy").rgb.iter().all(|rgb| rgb[0] == 0.0 && rgb[1] == 0.0));
    let said = place.done("convert one.ply one.spz --property label");
    assert!(said.contains("properties that only PLY files have: label"), "{said}");
    let errors = place.fails("info one.ply --property labels", 1);
    assert!(
        errors.contains("one.ply: expected a property `labels`, found none; did you mean `label`?"),
        "{errors}"
    );
}
