//! `rins guide`: the chapters of the guide as text for a terminal.

use super::ending::Ending;
use super::output::must_sayln;
use anyhow::Result;
use clap::Args;
use clap::builder::PossibleValuesParser;
use console::{Term, style};
use rins_selfcal::guide::CHAPTERS;

/// Widest text, columns, on a terminal of any width.
const WIDEST: usize = 80;
/// Indentation of code blocks.
const CODE_INDENT: &str = "    ";

#[derive(Debug, Args)]
pub struct GuideArguments {
    /// Chapter to print [default: the list of chapters]
    #[arg(value_parser = PossibleValuesParser::new(CHAPTERS.map(|chapter| chapter.name)))]
    chapter: Option<String>,
}

pub fn run(arguments: &GuideArguments) -> Result<Ending> {
    let chosen = |name: &String| CHAPTERS.iter().find(|chapter| chapter.name == name);
    match arguments.chapter.as_ref().and_then(chosen) {
        Some(chapter) => must_sayln!("{}", rendered(chapter.text, width()).trim_end()),
        None => must_sayln!("{}", contents()),
    }
    Ok(Ending::Done)
}

/// Width of the text, columns: that of the terminal, at most [`WIDEST`].
fn width() -> usize {
    Term::stdout().size_checked().map_or(WIDEST, |(_, columns)| WIDEST.min(columns.into()))
}

fn contents() -> String {
    let longest = CHAPTERS.iter().map(|chapter| chapter.name.len()).max().unwrap_or_default();
    let rows = CHAPTERS.iter().map(|chapter| format!("  {:longest$}  {}\n", chapter.name, chapter.title));
    format!("Chapters of the guide, each printed by `rins guide CHAPTER`:\n\n{}", rows.collect::<String>().trim_end())
}

/// Renders Markdown for a terminal. Paragraphs and lists are wrapped, links are replaced by their text, and comments
/// are left out. Headings, tables and code lines are not wrapped.
fn rendered(markdown: &str, width: usize) -> String {
    let mut page = Page { text: String::new(), paragraph: None, width };
    let mut in_code = false;
    for line in markdown.lines() {
        if line.starts_with("```") {
            page.end_paragraph();
            in_code = !in_code;
        } else if in_code {
            page.line(&format!("{CODE_INDENT}{line}"));
        } else if line.starts_with('#') {
            page.line(&style(line).bold().to_string());
        } else if line.starts_with('|') {
            page.line(&without_links(line));
        } else if line.trim().is_empty() {
            page.line("");
        } else if !line.starts_with("<!--") {
            page.prose(&without_links(line).replace("**", ""));
        }
    }
    page.end_paragraph();
    page.text
}

/// The paragraph or list item that is being read.
struct Paragraph {
    /// Indentation of all lines except the first.
    indent: usize,
    lines: Vec<String>,
}

/// The text that has been rendered so far, and the open paragraph.
struct Page {
    text: String,
    paragraph: Option<Paragraph>,
    width: usize,
}

impl Page {
    /// Adds a line without wrapping. Of several empty lines only the first is kept.
    fn line(&mut self, line: &str) {
        self.end_paragraph();
        if !line.is_empty() || !self.text.ends_with("\n\n") {
            self.text += line.trim_end();
            self.text.push('\n');
        }
    }

    /// Adds a line of a paragraph or a list.
    fn prose(&mut self, line: &str) {
        let indent = line.len() - line.trim_start().len();
        let marker = marker_length(line.trim_start());
        if marker > 0 {
            self.end_paragraph();
        }
        let begin = || Paragraph { indent: indent + marker, lines: vec![" ".repeat(indent)] };
        let paragraph = self.paragraph.get_or_insert_with(begin);
        for word in line.split_whitespace() {
            paragraph.add(word, self.width);
        }
    }

    fn end_paragraph(&mut self) {
        for line in self.paragraph.take().into_iter().flat_map(|paragraph| paragraph.lines) {
            self.text += &line;
            self.text.push('\n');
        }
    }
}

impl Paragraph {
    fn add(&mut self, word: &str, width: usize) {
        let Some(last) = self.lines.last_mut() else { return };
        if last.trim().is_empty() {
            last.push_str(word);
        } else if last.chars().count() + 1 + word.chars().count() <= width {
            last.push(' ');
            last.push_str(word);
        } else {
            self.lines.push(" ".repeat(self.indent) + word);
        }
    }
}

/// Length of the marker of a list item with the space after it; 0 if the line has no marker.
fn marker_length(line: &str) -> usize {
    let digits = line.chars().take_while(char::is_ascii_digit).count();
    match line.get(digits..) {
        Some(rest) if digits > 0 && rest.starts_with(". ") => digits + 2,
        Some(rest) if digits == 0 && rest.starts_with("- ") => 2,
        _ => 0,
    }
}

/// Replaces each link by its text; the address of a web page follows in brackets.
fn without_links(line: &str) -> String {
    let (mut text, mut rest) = (String::new(), line);
    while let Some((before, link)) = rest.split_once('[') {
        text += before;
        match link.split_once("](").and_then(|(name, tail)| Some((name, tail.split_once(')')?))) {
            Some((name, (target, after))) if !name.contains(']') => {
                text += name;
                if target.starts_with("http") {
                    text += &format!(" ({target})");
                }
                rest = after;
            }
            _ => {
                text.push('[');
                rest = link;
            }
        }
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prose_is_wrapped_and_lists_are_indented() {
        let text = "one two three\nfour five\n\n1. first item of a list\n   that goes on\n- **next** item\n";
        assert_eq!(
            rendered(text, 14),
            "one two three\nfour five\n\n1. first item\n   of a list\n   that goes\n   on\n- next item\n"
        );
    }

    #[test]
    fn headings_tables_and_code_stay_as_they_are() {
        let text =
            "# A heading that is long\n\n| a table | that is wide |\n\n```sh\ncode [x](y)  that is long\n\n\n```\n";
        let expected = "# A heading that is long\n\n| a table | that is wide |\n\n    code [x](y)  that is long\n\n\n";
        assert_eq!(rendered(text, 10), expected);
    }

    #[test]
    fn links_are_named_and_comments_left_out() {
        assert_eq!(without_links("see [`a`](crate::a), [b](https://b.org) or [[1,0],[0,1]]."), {
            "see `a`, b (https://b.org) or [[1,0],[0,1]]."
        });
        assert_eq!(rendered("a\n\n<!-- nobody reads this -->\n\nb\n", 80), "a\n\nb\n");
    }
}
