//! The page of a dump, opened in a browser.
//!
//! Headless Chromium loads the page that `splatgraph dump digit4 --format html` writes, runs its script and prints the
//! document. The browser is `SPLATGRAPH_CHROMIUM`, or else the first of `chromium`, `chromium-browser` and
//! `google-chrome` that is installed. Without a browser the test says `NOT RUN: ... needs chromium` and passes.

use crate::place::Place;
use serde_json::Value;
use std::process::Command;

/// Returns the browser's command; `None`, with a report, without one. Fails if `SPLATGRAPH_CHROMIUM` names a program
/// that does not run.
fn chromium(test: &str) -> Option<String> {
    let named = std::env::var("SPLATGRAPH_CHROMIUM").ok();
    let usual = ["chromium", "chromium-browser", "google-chrome"].map(String::from);
    let runs = |name: &String| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
    if let Some(name) = named {
        assert!(runs(&name), "SPLATGRAPH_CHROMIUM names what does not run: {name}");
        return Some(name);
    }
    let found = usual.into_iter().find(runs);
    if found.is_none() {
        crate::common::not_run(test, "chromium; install it, or set SPLATGRAPH_CHROMIUM");
    }
    found
}

/// Opens the page at a fragment of its address; returns the document after its script ran.
fn document(browser: &str, place: &Place, hash: &str) -> String {
    let output = Command::new(browser)
        // The sandbox does not work in containers. The page is trusted.
        .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
        .args(["--virtual-time-budget=2000", "--window-size=1600,1000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", place.named("profile")))
        .arg(format!("file://{}{hash}", place.named("page.html")))
        .output()
        .expect("the browser runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("text");
    // Cuts out the scripts, which contain the words that the test searches for.
    let (before, rest) = text.split_once("<script").expect("it has scripts");
    let after = rest.rsplit_once("</script>").expect("they end").1;
    before.to_owned() + after
}

/// Counts the elements whose first class is `class`.
fn count(document: &str, class: &str) -> usize {
    document.matches(&format!("class=\"{class}\"")).count()
        + document.matches(&format!("class=\"{class} ")).count()
}

fn panel(document: &str) -> String {
    let (_, rest) = document.split_once("id=\"panel\"").expect("it has a panel");
    let rest = rest.split_once('>').expect("a tag ends").1;
    let (inside, _) = rest.split_once("</aside>").expect("it ends");
    let mut text = String::new();
    let mut in_tag = false;
    for c in inside.chars() {
        in_tag = (in_tag || c == '<') && c != '>';
        if !in_tag {
            text.push(if c == '>' { ' ' } else { c });
        }
    }
    text.replace("&gt;", ">").replace("&amp;", "&").split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn the_page_draws_every_pass_and_barrier_and_opens_where_its_address_says() {
    let Some(browser) = chromium("the page of a dump") else { return };
    let place = Place::empty();
    place.write("page.html", place.done("dump digit4 --format html"));
    let json = place.told("dump digit4 --format json");
    let passes = json["passes"].as_array().expect("a list");
    let in_passes = passes.iter().flat_map(|p| p["barriers"].as_array().expect("a list"));
    let barriers: Vec<&Value> = in_passes.chain(json["handover"].as_array().expect("a list")).collect();
    let open = |hash: &str| document(&browser, &place, hash);

    // Unfolded, every pass and barrier is drawn. A barrier can be selected by its knob and by its line.
    let all = open("#unfold=*");
    assert_eq!(count(&all, "column"), passes.len(), "columns");
    let knobs = all.matches("class=\"knob\"").count();
    assert_eq!(knobs, barriers.len(), "barriers");
    for barrier in &barriers {
        let select = format!("data-select=\"barrier:{}\"", barrier["id"]);
        assert_eq!(all.matches(&select).count(), 2, "barrier {}", barrier["id"]);
    }
    let scene_planes = json["resources"].as_array().expect("a list").iter();
    let sh = scene_planes.filter(|r| r["from"] == "scene.sh").count();
    let resources = json["resources"].as_array().expect("a list").len();
    assert_eq!(count(&all, "lane"), resources - sh + 1, "lanes, with the planes of an attribute in one");
    assert!(panel(&all).starts_with("Overview"));

    // Folded, eight iterations of three passes are three columns.
    let folded = open("");
    assert_eq!(count(&folded, "column"), passes.len() - 21, "columns");
    assert!(folded.contains("order.sort ×8"));

    let barrier =
        barriers.iter().find(|b| b["before"]["name"] == "order.sort.scatter[0]").expect("there is one");
    let opened = panel(&open(&format!("#barrier={}", barrier["id"])));
    let origin = &barrier["before"]["declared"];
    let origin =
        format!("{}:{}:{}", origin["file"].as_str().expect("text"), origin["line"], origin["column"]);
    for words in [
        &format!("Barrier {}", barrier["id"]),
        "before order.sort.scatter[0]",
        "on all memory",
        "read after write: order.sort.table",
        "COMPUTE · STORAGE_WRITE",
        &origin,
    ] {
        assert!(opened.contains(words), "no {words} in {opened}");
    }

    let opened = open("#unfold=order.sort&pass=order.sort.scan[2]");
    let text = panel(&opened);
    assert!(text.contains("order.sort.scan[2]") && text.contains("sort/scan.comp"), "{text}");
    assert_eq!(count(&opened, "column"), passes.len(), "the repeat is unfolded");
    let text = panel(&open("#resource=order.keys%231"));
    assert!(text.contains("order.keys#1") && text.contains("written by"), "{text}");
    let text = panel(&open("#resource=scene.scale"));
    assert!(text.contains("lifetime freed after the prologue"), "{text}");
    let text = panel(&open("#barrier=9999&pass=%"));
    assert!(text.starts_with("Overview"), "what there is not opens nothing: {text}");
}
