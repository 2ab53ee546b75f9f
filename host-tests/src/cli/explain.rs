//! `rins explain`: the page of a code that the program prints with a reason.

use super::ending::Ending;
use super::output::must_sayln;
use anyhow::{Result, bail};
use clap::Args;
use rins_selfcal::guide::CHAPTERS;

/// The chapter of the guide that has a page for each code.
const CHAPTER: &str = "reasons";
/// Widest text, columns.
const WIDTH: usize = 100;
/// Number of codes that are proposed for an unknown code.
const PROPOSALS: usize = 3;

#[derive(Debug, Args)]
pub struct ExplainArguments {
    /// Code as it is printed in brackets, such as noise-level [default: the list of all codes]
    code: Option<String>,
}

/// A page of the chapter.
struct Page<'t> {
    /// Title of the group that the page belongs to.
    group: &'t str,
    code: &'t str,
    text: &'t str,
}

impl Page<'_> {
    /// The first sentence of the page.
    fn summary(&self) -> &str {
        self.text.lines().next().unwrap_or_default()
    }
}

pub fn run(arguments: &ExplainArguments) -> Result<Ending> {
    let pages = pages();
    let Some(code) = &arguments.code else {
        must_sayln!("{}", list(&pages));
        return Ok(Ending::Done);
    };
    let wanted = code.trim_matches(['[', ']']).to_lowercase();
    match pages.iter().find(|page| page.code == wanted) {
        Some(page) => must_sayln!("{} ({})\n\n{}", page.code, page.group, wrapped(page.text)),
        None => {
            bail!("there is no code `{code}`; similar codes: {}. `rins explain` lists all codes", near(&wanted, &pages))
        }
    }
    Ok(Ending::Done)
}

fn pages() -> Vec<Page<'static>> {
    let chapter = CHAPTERS.iter().find(|chapter| chapter.name == CHAPTER).map_or("", |chapter| chapter.text);
    let groups = chapter.split("\n## ").skip(1);
    let pages = groups.flat_map(|group| {
        let title = group.lines().next().unwrap_or_default();
        let pages = group.split("\n### ").skip(1).filter_map(|page| page.split_once('\n'));
        pages.map(move |(code, text)| Page { group: title, code, text: text.trim() })
    });
    pages.collect()
}

fn list(pages: &[Page]) -> String {
    let widest = pages.iter().map(|page| page.code.len()).max().unwrap_or_default();
    let mut text = String::from("`rins explain CODE` shows the page of a code.\n");
    let mut group = "";
    for page in pages {
        if page.group != group {
            group = page.group;
            text += &format!("\n{group}\n");
        }
        text += &format!("  {:widest$}  {}\n", page.code, page.summary());
    }
    text.trim_end().into()
}

/// The codes that are most similar to an unknown code.
fn near(wanted: &str, pages: &[Page]) -> String {
    let mut codes: Vec<_> = pages.iter().map(|page| page.code).collect();
    codes.sort_by_key(|code| (!(code.contains(wanted) || wanted.contains(code)), distance(wanted, code)));
    codes.truncate(PROPOSALS);
    codes.join(", ")
}

/// Levenshtein distance: number of letters to insert, remove or replace.
fn distance(from: &str, to: &str) -> usize {
    let mut row: Vec<usize> = (0..=to.chars().count()).collect();
    for (above, letter) in from.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], above + 1);
        for (column, other) in to.chars().enumerate() {
            let replaced = diagonal + usize::from(letter != other);
            diagonal = row[column + 1];
            row[column + 1] = replaced.min(diagonal + 1).min(row[column] + 1);
        }
    }
    row[to.chars().count()]
}

/// Wraps a text to [`WIDTH`] columns; the continued lines of a list are indented.
fn wrapped(text: &str) -> String {
    let mut lines = Vec::new();
    for paragraph in text.lines() {
        let indent = if paragraph.starts_with("- ") { "  " } else { "" };
        let mut line = String::new();
        for word in paragraph.split_whitespace() {
            if !line.trim().is_empty() && line.len() + 1 + word.len() > WIDTH {
                lines.push(std::mem::replace(&mut line, indent.into()));
            }
            if !line.trim().is_empty() {
                line.push(' ');
            }
            line += word;
        }
        lines.push(line);
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::verdict::Reason;

    #[test]
    fn the_page_of_a_code_is_found_and_similar_codes_are_proposed() {
        let pages = pages();
        let code = Reason::NotConverged(24).code();
        let page = pages.iter().find(|page| page.code == code).expect("a page");
        assert_eq!(page.summary(), "The estimate has not converged.");
        assert!(page.text.contains("- What to do: ") && !page.text.contains('#'), "{}", page.text);
        assert!(near("noise-levle", &pages).starts_with("noise-level"));
        assert!(near("encoder", &pages).split(", ").all(|code| code.starts_with("encoder-")));
        assert_eq!(distance("kitten", "sitting"), 3);
        assert!(wrapped(page.text).lines().all(|line| line.len() <= WIDTH));
    }
}
