//! Formats a dump as an HTML page without network access: scripts in `page/` draw the timeline from the embedded JSON.

use super::form::Dump;
use super::from_plan::json;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const SCRIPTS: [&str; 4] = [
    include_str!("page/model.js"),
    include_str!("page/timeline.js"),
    include_str!("page/panel.js"),
    include_str!("page/main.js"),
];

/// Returns the text of the HTML file.
///
/// The fragment of the page's URL selects and folds items: `#barrier=3`, `#barriers=3,4`, `#pass=NAME`,
/// `#resource=NAME`, `#unfold=REPEAT`, `#fold=REPEAT` (`*` for all repeats), or several of these joined by `&`.
pub fn html(dump: &Dump) -> String {
    // In a script element, `</script>` and `<!--` are special and character references are not. Escaping every `<`
    // leaves the JSON's meaning unchanged and removes both.
    let data = json(dump).to_string().replace('<', "\\u003c");
    let title = dump.graph.replace('&', "&amp;").replace('<', "&lt;");
    let mut page = String::with_capacity(PAGE.len() + STYLE.len() + data.len() + 64 * 1024);
    // One pass over the template: inserted texts may contain placeholders.
    let mut rest = PAGE;
    while let Some((before, after)) = rest.split_once("{{") {
        page += before;
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        match name {
            "title" => page += &title,
            "style" => page += STYLE,
            "data" => page += &data,
            "script" => SCRIPTS.iter().for_each(|script| page += script),
            _ => {}
        }
        rest = after;
    }
    page + rest
}
