use super::testing::{ledger, measured, origin, row, within};
use super::*;
use crate::studies::measurement::error::Error;
use splatgraph_assets::Camera;

fn with(change: impl Fn(&mut Provenance)) -> Origin {
    let mut origin = origin();
    change(&mut origin.provenance);
    origin
}

fn marks(rows: Vec<Row>) -> Vec<(String, Mark)> {
    ledger(rows).lines().0.into_iter().map(|line| (line.setting, line.mark)).collect()
}

#[test]
fn views_are_joined_by_their_squared_errors_and_what_is_dominated_is_not_best() {
    let rows = vec![
        row("exact", "a", Ok(measured(4.0, None))),
        row("exact", "b", Ok(measured(4.0, None))),
        row("fast", "a", Ok(measured(1.0, Some(40.0)))),
        row("fast", "b", Ok(measured(3.0, None))),
        row("bad", "a", Ok(measured(3.0, Some(30.0)))),
        row("bad", "b", Ok(measured(3.0, Some(30.0)))),
        row("broken", "a", Err("error: no".into())),
        row("rest", "b", Ok(measured(1.0, Some(90.0)))),
    ];
    let (lines, failed) = ledger(rows).lines();
    let told = [("broken", "error: no"), ("rest", "measured in only 1 of 2 views")];
    assert_eq!(failed, told.map(|(name, why)| (name.to_string(), why.to_string())));
    let found: Vec<Mark> = lines.iter().map(|line| line.mark).collect();
    assert_eq!(found, [Mark::Best, Mark::Best, Mark::Beaten]);
    assert!(lines[0].psnr_db.is_infinite());
    assert!((lines[1].psnr_db - (40.0 + 10.0 * 2f64.log10())).abs() < 1e-9);
    assert_eq!((lines[1].gpu_ms, lines[1].inversions), (Some(2.0), Some(14)));
    assert_eq!(lines[1].phases, [("draw".to_string(), 2.0, Some(0.05))]);
}

#[test]
fn covered_pixels_count_alike_in_all_views_and_a_view_without_any_counts_for_nothing() {
    let view = |name: &str, covered, psnr_db| {
        let measured = measured(4.0, Some(50.0));
        let error = Error { covered, covered_psnr_db: psnr_db, ..measured.error };
        row("exact", name, Ok(Measured { error, ..measured }))
    };
    let joint = |rows: &[Row]| ledger(rows.to_vec()).lines().0[0].covered_psnr_db;
    let views = [view("a", 30, Some(30.0)), view("b", 10, Some(20.0)), view("away", 0, None)];
    // (30 * 0.001 + 10 * 0.01) / 40.
    let expected = -10.0 * 0.00325f64.log10();
    assert!((joint(&views) - expected).abs() < 1e-9 && joint(&views) == joint(&views[..2]));
    assert!(joint(&views[2..]).is_infinite());
}

#[test]
fn a_setting_within_the_noise_of_the_exact_ones_is_not_on_the_front_for_sure() {
    let quiet = row("exact", "a", Ok(measured(4.0, Some(90.0))));
    let noisy = row("exact", "a", Ok(within(4.0 * 0.81, 0.05, Some(90.0))));
    let faster = row("x", "a", Ok(measured(3.4, Some(60.0))));
    let none = row("y", "a", Ok(measured(4.0, Some(60.0))));
    let told = |rows: &[&Row]| marks(rows.iter().map(|row| (*row).clone()).collect()).pop().unwrap().1;
    assert_eq!((told(&[&quiet, &faster]), told(&[&quiet, &none])), (Mark::Best, Mark::Beaten));
    assert_eq!((told(&[&noisy, &faster]), told(&[&noisy, &none])), (Mark::Likely, Mark::Unlikely));
}

#[test]
fn a_setting_that_draws_from_the_frame_before_is_not_judged_by_still_views() {
    let stale = Measured { of_last_frame: true, ..measured(2.0, Some(90.0)) };
    let found = marks(vec![
        row("exact", "a", Ok(measured(4.0, Some(90.0)))),
        row("stale_order", "a", Ok(stale)),
        row("fast", "a", Ok(measured(3.0, Some(80.0)))),
    ]);
    let found: Vec<Mark> = found.into_iter().map(|(_, mark)| mark).collect();
    assert_eq!(found, [Mark::Best, Mark::Hidden, Mark::Best]);
}

#[test]
fn a_ledger_goes_on_where_it_stopped_and_rows_of_other_inputs_are_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ledger.json");
    let plans = [("exact", Some(1)), ("broken", Some(1))];
    let open = |origin: Origin| Book::open(Some(path.clone()), origin, &plans);
    let (mut book, lost) = open(origin()).unwrap();
    assert_eq!(lost, None);
    book.insert(row("exact", "a", Ok(measured(4.0, Some(61.25)))));
    book.insert(row("broken", "a", Err("no".into())));
    book.save().unwrap();
    let error = open(origin()).err().expect("the folder is in use").to_string();
    assert!(error.contains("no other process measures into"), "{error}");
    let measured = std::mem::take(&mut book.ledger.rows);
    drop(book);
    // Another program may have written the numbers in another way: 32 for 32.0.
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace(".0,", ",").replace(".0\n", "\n")).unwrap();
    let mut same = Origin { truth: "elsewhere".into(), ..origin() };
    same.provenance.scene = "./a.ply".into();
    let (again, lost) = open(same).unwrap();
    assert_eq!((&again.ledger.rows, lost), (&measured, None));
    assert!(again.has("exact", "a") && !again.has("exact", "b"));
    assert_eq!((again.exact_ms("a"), again.exact_ms("b")), (Some(4.0), None));
    drop(again);
    let text = String::from("2");
    let before = fs::read(&path).unwrap();
    let refused = |origin: Origin, what: &str| {
        let error = open(origin).err().expect("it is refused").to_string();
        let why = format!("another {what}: keep the new one elsewhere, or delete this one");
        assert!(error.contains("ledger.json: expected") && error.ends_with(&why), "{error}");
    };
    for (other, what) in [
        (with(|other| other.splats = 4), "scene"),
        (Origin { content: text.clone(), ..origin() }, "scene"),
        (Origin { tags: vec![("low_pass".into(), "mip".into())], ..origin() }, "set of tags"),
        (Origin { truth_content: text.clone(), ..origin() }, "truth"),
        (Origin { exact: text.clone(), ..origin() }, "graph"),
        (Origin { opened: text.clone(), ..origin() }, "set of device options"),
        (with(|other| other.cameras.clear()), "set of cameras"),
        (Origin { rounds: 2, ..with(|other| other.splats = 4) }, "scene and another number of rounds"),
        (Origin { frames: Some(2), ..origin() }, "number of frames"),
    ] {
        refused(other, what);
    }
    assert_eq!(fs::read(&path).unwrap(), before);
    // Only the file of one preset was edited.
    let plans = [("exact", Some(1)), ("broken", Some(2))];
    let (found, lost) = Book::open(Some(path.clone()), origin(), &plans).unwrap();
    assert!(found.has("exact", "a") && !found.has("broken", "a"));
    let lost = lost.unwrap_or_default();
    assert!(lost.contains("1 rows of an earlier run are measured again or left out"), "{lost}");
    drop(found);
}

#[test]
fn settings_with_equal_plans_and_views_without_rows_are_listed() {
    let mut found = ledger(vec![
        row("exact", "a", Ok(measured(4.0, None))),
        row("fast", "a", Ok(measured(1.0, Some(40.0)))),
    ]);
    let camera = &found.origin.provenance.cameras[0];
    found.origin.provenance.cameras =
        ["a", "b"].map(|name| Camera { img_name: name.into(), ..camera.clone() }).into();
    for others in [["one", "exact"], ["two", "one"]] {
        let others = others.map(str::to_owned).into();
        found.add_same_plan(SamePlan::from([("fast".into(), others)]));
    }
    let lines = found.lines().0;
    // The exact settings were measured themselves.
    assert_eq!(
        (&lines[0].same_plan[..], &lines[1].same_plan[..]),
        (&[][..], &["one".into(), "two".into()][..])
    );
    // The run was interrupted before `slow`.
    found.add_same_plan(SamePlan::from([("slow".into(), ["unasked".to_owned()].into())]));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ledger.json");
    found.save(&path).unwrap();
    let json: Json = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    assert_eq!((&json["missing"], &json["same_plan"]["fast"][2]), (&serde_json::json!(["b"]), &"two".into()));
    assert_eq!(replaceable(&path).unwrap(), ["exact", "fast", "one", "two"].map(str::to_owned).into());
    let open = |plans: &[_]| Book::open(Some(path.clone()), found.origin.clone(), plans).unwrap().0.ledger;
    let mut with_rows = found.clone();
    with_rows.same_plan.remove("slow");
    assert_eq!(open(&[]), with_rows);
    // A caller with plans finds the equal ones by itself: the file of a preset may have been edited.
    assert!(open(&[("exact", Some(1))]).same_plan.is_empty());
    assert!(
        found
            .origin
            .provenance
            .text(&found.missing())
            .contains("3 splats, 1 of 2 views (missing: `b`), on none")
    );
}

#[test]
fn a_ledger_of_another_program_or_device_is_kept_under_another_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ledger.json");
    let other = Origin { program: "2".into(), ..with(|other| other.device = "another".into()) };
    for (text, what) in [
        (
            serde_json::to_string(&ledger(vec![row("exact", "a", Err("no".into()))])).unwrap(),
            "program and another device",
        ),
        (r#"{"origin": {}, "rows": []}"#.to_owned(), "program"),
    ] {
        fs::write(&path, &text).unwrap();
        fs::write(path.with_extension("svg"), "").unwrap();
        assert!(replaceable(&path).is_ok());
        let (book, lost) = Book::open(Some(path.clone()), other.clone(), &[("exact", Some(1))]).unwrap();
        let lost = lost.expect("a message");
        assert!(book.ledger.rows.is_empty(), "{lost}");
        let (start, kept) = lost.split_once("it is kept as ").expect("the new name");
        assert!(start.ends_with(&format!("measured with another {what}: ")), "{lost}");
        let (kept, after) = kept.split_once(", and all settings are measured again").expect("what follows");
        assert_eq!(after, "; its CSV, page and plots are removed");
        assert!(!path.with_extension("svg").exists() && path.exists());
        assert_eq!(fs::read_to_string(kept).unwrap(), text);
    }
}

#[test]
fn every_command_is_kept_once_also_that_of_an_older_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ledger.json");
    let older = Ledger { command: "one".into(), ..ledger(vec![row("exact", "a", Err("no".into()))]) };
    older.save(&path).unwrap();
    let (mut book, _) = Book::open(Some(path.clone()), origin(), &[]).unwrap();
    ["two", "one", ""].into_iter().for_each(|command| book.ledger.add_command(command));
    assert_eq!(book.ledger.commands, ["one", "two"]);
    book.save().unwrap();
    drop(book);
    assert_eq!(Book::open(Some(path), origin(), &[]).unwrap().0.ledger.commands, ["one", "two"]);
}

#[test]
fn other_set_values_are_not_another_graph() {
    let own = with(|_| ());
    let set = |value: &str| vec![("k".to_owned(), value.to_owned())];
    let changed = Origin { set: set("0"), exact: "other".into(), ..own.clone() };
    assert_eq!(own.changes(&changed), ["set of --set values"]);
    assert_eq!(own.changes(&Origin { exact: "other".into(), ..own.clone() }), ["graph"]);
    assert!(own.changes(&own).is_empty());
}

#[test]
fn a_file_that_is_no_ledger_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    assert!(replaceable(&path).is_ok());
    fs::write(&path, "").unwrap();
    assert!(replaceable(&path).is_ok());
    for contents in ["ply\n", "{}", "[1]", r#"{"rows": []}"#] {
        fs::write(&path, contents).unwrap();
        let error = replaceable(&path).unwrap_err().to_string();
        assert!(error.contains("scene.ply: expected a ledger"), "{error}");
    }
    assert!(replaceable(folder.path()).is_err());
    ledger(Vec::new()).save(&path).unwrap();
    assert!(replaceable(&path).is_ok());
}
