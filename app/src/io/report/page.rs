//! Writes HTML pages that load nothing from the network: pictures are embedded, or linked as files next to the page.

use super::plot::{Plot, PlotError};
use super::text::escaped;
use crate::io::image::{Image, ImageError};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use pulldown_latex::config::{DisplayMode, RenderConfig};
use pulldown_latex::{Parser, Storage, push_mathml};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// A page that is written from top to bottom.
pub struct Page {
    title: String,
    body: String,
    /// True if a table is sortable, which needs the script.
    has_script: bool,
}

/// A row of a sortable table.
pub struct Row {
    /// Texts of the cells. The first one is the name of the row.
    pub cells: Vec<String>,
    /// Pictures that a click on the name shows.
    pub pictures: Vec<Linked>,
}

/// A picture in a file next to the page, with a caption.
#[derive(Debug, PartialEq, Eq)]
pub struct Linked {
    /// Text under the picture.
    pub caption: String,
    /// Path relative to the page, percent-encoded.
    pub link: String,
}

/// A picture with a caption.
pub struct Figure<'a> {
    /// Text under the picture.
    pub caption: String,
    /// The picture; its values are clamped to 0..1.
    pub image: &'a Image,
}

impl Page {
    /// Begins a page with its title as the first heading.
    pub fn new(title: &str) -> Page {
        Page { title: title.to_owned(), body: format!("<h1>{}</h1>\n", escaped(title)), has_script: false }
    }

    /// Adds a heading.
    pub fn heading(&mut self, text: &str) {
        self.body += &format!("<h2>{}</h2>\n", escaped(text));
    }

    /// Adds a paragraph. Text between backquotes is set as code.
    pub fn text(&mut self, text: &str) {
        self.body += &format!("<p>{}</p>\n", inline(text));
    }

    /// Adds a formula in LaTeX, as MathML. An error in it becomes an `merror` element.
    pub fn formula(&mut self, latex: &str) {
        let storage = Storage::new();
        let config = RenderConfig { display_mode: DisplayMode::Block, ..RenderConfig::default() };
        let mut math = String::new();
        let _ = push_mathml(&mut math, Parser::new(latex, &storage), config);
        // The crate does not escape this operator.
        self.body += &math.replace("<mo><</mo>", "<mo>&lt;</mo>");
        self.body.push('\n');
    }

    /// Adds preformatted lines, such as a command.
    pub fn block(&mut self, text: &str) {
        self.body += &format!("<pre>{}</pre>\n", escaped(text));
    }

    /// Adds a table. The first column is text, the others are numbers.
    pub fn table(&mut self, header: &[&str], rows: &[Vec<String>]) {
        let line = |tag: &str, cells: &mut dyn Iterator<Item = String>| {
            cells.fold(String::from("<tr>"), |text, cell| text + &format!("<{tag}>{cell}</{tag}>"))
                + "</tr>\n"
        };
        self.body += "<div class=\"wide\"><table>\n";
        self.body += &line("th", &mut header.iter().map(|cell| inline(cell)));
        for row in rows {
            self.body += &line("td", &mut row.iter().map(|cell| inline(cell)));
        }
        self.body += "</table></div>\n";
    }

    /// Adds a table that a reader can filter, and sort by each column. `columns` are names and tooltips; the tooltips
    /// are shown without their backquotes.
    ///
    /// The name of a row with pictures links to the first; a click shows all of them below the row.
    pub fn sortable(&mut self, columns: &[(&str, &str)], rows: &[Row]) {
        self.has_script = true;
        self.body += "<div class=\"wide sortable\"><input type=\"search\" placeholder=\"filter\" aria-label=\"filter\"><table>\n<thead><tr>";
        for (name, about) in columns {
            let about = escaped(&about.replace('`', ""));
            self.body += &format!("<th title=\"{about}\"><button>{}</button></th>", inline(name));
        }
        self.body += "</tr></thead>\n<tbody>\n";
        for Row { cells, pictures } in rows {
            let mut cells: Vec<String> = cells.iter().map(|cell| inline(cell)).collect();
            if let (Some(name), Some(first)) = (cells.first_mut(), pictures.first()) {
                *name = format!("<a href=\"{}\">{name}</a>", first.link);
            }
            let cells: String = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
            self.body += &format!("<tr>{cells}");
            if !pictures.is_empty() {
                self.body += "<template><div class=\"pictures\">";
                for Linked { caption, link } in pictures {
                    let (alt, caption) = (escaped(caption), inline(caption));
                    self.body += &format!(
                        "<figure><img alt=\"{alt}\" src=\"{link}\"><figcaption>{caption}</figcaption></figure>"
                    );
                }
                self.body += "</div></template>";
            }
            self.body += "</tr>\n";
        }
        self.body += "</tbody></table></div>\n";
    }

    /// Adds pictures side by side.
    ///
    /// # Errors
    /// A picture cannot be encoded.
    pub fn pictures(&mut self, figures: &[Figure]) -> Result<(), ImageError> {
        self.figures("", figures)
    }

    /// Adds pictures as a grid of `columns` columns, whatever the width of the page.
    ///
    /// # Errors
    /// A picture cannot be encoded.
    pub fn rows(&mut self, columns: usize, figures: &[Figure]) -> Result<(), ImageError> {
        let columns = format!("grid-template-columns: repeat({columns}, minmax(0, 1fr))");
        self.figures(&format!(" style=\"{columns}\""), figures)
    }

    fn figures(&mut self, style: &str, figures: &[Figure]) -> Result<(), ImageError> {
        self.body += &format!("<div class=\"pictures\"{style}>\n");
        for figure in figures {
            let data = STANDARD.encode(figure.image.png()?);
            let caption = inline(&figure.caption);
            let alt = escaped(&figure.caption);
            let Image { width, height, .. } = figure.image;
            let _ = writeln!(
                self.body,
                "<figure><img width=\"{width}\" height=\"{height}\" alt=\"{alt}\" src=\"data:image/png;base64,{data}\">\
                 <figcaption>{caption}</figcaption></figure>"
            );
        }
        self.body += "</div>\n";
        Ok(())
    }

    /// Adds a plot with a caption.
    ///
    /// # Errors
    /// The plot cannot be drawn.
    pub fn plot(&mut self, plot: &Plot, caption: &str) -> Result<(), PlotError> {
        let svg = plot.svg()?;
        self.body +=
            &format!("<figure class=\"plot\">{svg}<figcaption>{}</figcaption></figure>\n", inline(caption));
        Ok(())
    }

    /// Returns the whole page as HTML.
    pub fn html(&self) -> String {
        let Page { title, body, .. } = self;
        let script = if self.has_script { format!("<script>\n{SCRIPT}</script>\n") } else { String::new() };
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\"><title>{}</title>\n<style>\n{STYLE}</style></head>\n\
             <body><main>\n{body}</main>\n{script}</body></html>\n",
            escaped(title)
        )
    }
}

/// Escapes text, and sets words between backquotes as code.
fn inline(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts.fold(String::new(), |line, (at, part)| match at % 2 {
        0 => line + &escaped(part),
        _ => line + "<code>" + &escaped(part) + "</code>",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sortable_table_explains_its_columns_and_escapes_its_texts() {
        let mut page = Page::new("ledger");
        let pictures = vec![Linked { caption: "`b` & c".into(), link: "pictures/b%20c.png".into() }];
        let rows = [
            Row { cells: vec!["<b>".into()], pictures: Vec::new() },
            Row { cells: vec!["c".into()], pictures },
        ];
        page.sortable(&[("ms", "milliseconds < \"1\"")], &rows);
        let html = page.html();
        assert!(
            html.contains("<th title=\"milliseconds &lt; &quot;1&quot;\"><button>ms</button></th>"),
            "{html}"
        );
        assert!(html.contains("<td>&lt;b&gt;</td>") && html.matches("<script>").count() == 1, "{html}");
        assert!(html.contains("<td><a href=\"pictures/b%20c.png\">c</a></td><template>"), "{html}");
        assert!(html.contains("src=\"pictures/b%20c.png\"><figcaption><code>b</code> &amp; c<"), "{html}");
        assert!(!html.contains("http"), "nothing is fetched");
    }

    #[test]
    fn a_formula_is_mathml_and_a_mistake_in_it_is_shown() {
        let of = |latex: &str| {
            let mut page = Page::new("formula");
            page.formula(latex);
            page.html()
        };
        let html = of(r"\sum_{j < i} a_j");
        assert!(html.contains("<math display=\"block\">") && html.contains(">∑</mo>"), "{html}");
        assert!(html.contains("<mo>&lt;</mo>") && !html.contains("merror"), "{html}");
        assert!(of(r"\sum_{j").contains("merror"));
    }

    #[test]
    fn a_page_holds_its_pictures_and_cannot_be_changed_by_its_texts() {
        let mut page = Page::new("<script>");
        page.text("a `b < c` d");
        page.table(&["name", "ms"], &[vec!["\"x\" & y".into(), "1.5".into()]]);
        let image = Image::from_fn(2, 1, |x, _| [x as f32; 3]);
        page.pictures(&[Figure { caption: "two pixels".into(), image: &image }]).unwrap();
        page.rows(4, &[Figure { caption: "again".into(), image: &image }]).unwrap();
        let html = page.html();
        assert!(!html.contains("<script>"), "{html}");
        assert!(html.contains("<code>b &lt; c</code>") && html.contains("&quot;x&quot; &amp; y"), "{html}");
        let data = html.split("base64,").nth(1).and_then(|rest| rest.split('"').next()).expect("a picture");
        assert!(STANDARD.decode(data).expect("base64").starts_with(b"\x89PNG"));
        assert_eq!(html.matches("<figure>").count(), 2);
        assert!(!html.contains("http"), "nothing is fetched");
    }
}
