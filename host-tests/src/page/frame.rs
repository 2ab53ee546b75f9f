//! Common parts of all pages: head, style, contents, sections, figures, and a footer with program, version and time.

use super::canvas::Drawn;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

const STYLE: &str = include_str!("style.css");

/// A part of a page with a heading.
pub struct Section {
    id: &'static str,
    title: &'static str,
    content: Markup,
}

impl Section {
    /// A section; `id` is the name of its anchor.
    pub fn new(id: &'static str, title: &'static str, content: Markup) -> Self {
        Self { id, title, content }
    }
}

/// A whole page. It loads no other file.
pub fn document(title: &str, head: &Markup, sections: &[Section]) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                (head)
                nav { @for section in sections { a href={ "#" (section.id) } { (section.title) } } }
                @for Section { id, title, content } in sections { section id=(id) { h2 { (title) } (content) } }
                footer { "rins-selfcal " (env!("CARGO_PKG_VERSION")) ", " (now()) }
            }
        }
    }
}

/// A figure with its name and an optional caption.
///
/// # Errors
/// The figure could not be drawn.
pub fn shown(drawn: Drawn, name: &str, caption: &str) -> anyhow::Result<Markup> {
    Ok(html! {
        figure id=(name) { (PreEscaped(drawn?)) @if !caption.is_empty() { figcaption { (caption) } } }
    })
}

fn now() -> String {
    OffsetDateTime::now_utc().replace_nanosecond(0).ok().and_then(|now| now.format(&Rfc3339).ok()).unwrap_or_default()
}
