//! The page: one file of HTML that needs nothing else, neither a server nor a network.

use std::fmt::Write;

use anyhow::{Context, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;

/// How the report looks around the viewer, whose own styles come first.
const STYLES: &str = include_str!("page.css");

/// A picture with what it shows.
pub struct Plot {
    /// The name of its file, without the extension.
    pub name: &'static str,
    /// What it shows, in a sentence.
    pub caption: String,
    /// An SVG file.
    pub svg: String,
}

/// Rows of a table: names and values.
pub type Rows = Vec<(String, String)>;

/// What stands in a report.
pub struct Page {
    /// The heading.
    pub title: String,
    /// What is below it.
    pub lead: String,
    /// What the viewer shows, as JSON.
    pub data: Value,
    /// Pictures.
    pub plots: Vec<Plot>,
    /// Tables by their heading.
    pub tables: Vec<(String, Rows)>,
    /// Keyframes whose pictures are shown, with a word on each.
    pub keyframes: Vec<(u64, String)>,
}

impl Page {
    /// The file.
    ///
    /// # Errors
    /// If the viewer is not among what this program carries.
    pub fn html(&self) -> Result<String> {
        let script = server::viewer_file(".js").context("this program carries no viewer")?;
        let styles = server::viewer_file(".css").context("this program carries no viewer")?;
        let title = escaped(&self.title);
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\" />\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\" />\n\
             <meta name=\"color-scheme\" content=\"light dark\" />\n<title>{title}</title>\n\
             <link rel=\"icon\" href=\"data:,\" />\n<style>{styles}</style>\n<style>{STYLES}</style>\n</head>\n\
             <body class=\"report\">\n<a class=\"skip\" href=\"#figures\">Skip the map</a>\n\
             <header><span class=\"brand\">monoslam</span><span id=\"crumbs\">report</span>\
             <button type=\"button\" id=\"theme\" class=\"quiet\"></button></header>\n\
             <section class=\"text\"><h1>{title}</h1><p>{lead}</p></section>\n\
             <main id=\"main\" tabindex=\"-1\"></main>\n<section class=\"text\" id=\"figures\">\n",
            lead = escaped(&self.lead),
        );
        self.push_plots(&mut html);
        self.push_tables(&mut html);
        self.push_keyframes(&mut html);
        let _ = write!(
            html,
            "</section>\n<div id=\"live\" class=\"visually-hidden\" role=\"status\" aria-live=\"polite\"></div>\n\
             <noscript>The map in three dimensions and the keyframes' pictures need JavaScript.</noscript>\n\
             <script type=\"application/json\" id=\"report-data\">{data}</script>\n\
             <script type=\"module\">{script}</script>\n</body>\n</html>\n",
            data = data_text(&self.data),
            script = script_text(script),
        );
        Ok(html)
    }

    fn push_plots(&self, html: &mut String) {
        html.push_str("<div class=\"plots\">\n");
        for Plot { caption, svg, .. } in &self.plots {
            let (address, caption) = (data_address("image/svg+xml", svg.as_bytes()), escaped(caption));
            let _ = writeln!(
                html,
                "<figure><img src=\"{address}\" alt=\"{caption}\" /><figcaption>{caption}</figcaption></figure>"
            );
        }
        html.push_str("</div>\n");
    }

    fn push_tables(&self, html: &mut String) {
        html.push_str("<div class=\"tables\">\n");
        for (heading, rows) in self.tables.iter().filter(|(_, rows)| !rows.is_empty()) {
            let _ = writeln!(html, "<section><h2>{}</h2><dl class=\"figures\">", escaped(heading));
            for (name, value) in rows {
                let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escaped(name), escaped(value));
            }
            html.push_str("</dl></section>\n");
        }
        html.push_str("</div>\n");
    }

    fn push_keyframes(&self, html: &mut String) {
        if self.keyframes.is_empty() {
            return;
        }
        html.push_str("<h2>Keyframes</h2>\n<ul class=\"keyframes\">\n");
        for (id, word) in &self.keyframes {
            let word = escaped(word);
            // The viewer fills in the picture, so that it is in the file once.
            let _ = writeln!(
                html,
                "<li><a href=\"#/s/{session}?keyframe={id}\"><img data-keyframe=\"{id}\" alt=\"\" /><span>{word}</span></a></li>",
                session = self.data["session"]["id"].as_str().unwrap_or_default(),
            );
        }
        html.push_str("</ul>\n");
    }
}

/// Bytes as an address.
pub fn data_address(media_type: &str, bytes: &[u8]) -> String {
    format!("data:{media_type};base64,{}", STANDARD.encode(bytes))
}

/// JSON in an element of a page: nothing in it ends the element.
fn data_text(data: &Value) -> String {
    data.to_string().replace('<', "\\u003c")
}

/// A program in an element of a page, likewise: in its strings and patterns a slash may be escaped.
fn script_text(script: &str) -> String {
    script.replace("</script", "<\\/script").replace("<!--", "<\\!--")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn nothing_in_the_page_ends_its_elements() {
        let page = Page {
            title: "a <b> & \"c\"".to_owned(),
            lead: String::new(),
            data: json!({"session": {"id": "room"}, "text": "</script><script>alert(1)"}),
            plots: vec![Plot { name: "p", caption: "x < y".to_owned(), svg: "<svg/>".to_owned() }],
            tables: vec![("Map".to_owned(), vec![("points".to_owned(), "<3".to_owned())])],
            keyframes: vec![(7, "frame 3".to_owned())],
        };
        let html = page.html().unwrap();
        assert_eq!(html.matches("</script>").count(), 2);
        assert!(html.contains("<h1>a &lt;b&gt; &amp; &quot;c&quot;</h1>") && html.contains("<dd>&lt;3</dd>"));
        assert!(html.contains("href=\"#/s/room?keyframe=7\""));
        // Nothing is fetched from anywhere.
        assert!(!html.contains("src=\"http") && !html.contains("href=\"http") && !html.contains("@import"));
    }
}
