//! `rins explain`: the page of a code that the program prints with a reason.

use super::ending::Ending;
use super::output::must_sayln;
use super::prose::{in_columns, rendered, width};
use anyhow::{Result, bail};
use clap::Args;
use rins_selfcal::guide::CHAPTERS;

/// The chapter of the guide that has a page for each code.
const CHAPTER: &str = "reasons";
/// Widest text, columns.
const WIDEST: usize = 100;
/// Number of codes that are proposed for an unknown code.
const PROPOSALS: usize = 3;
/// Fewest letters that find the codes that contain them.
const LEAST_PART: usize = 3;

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
    let wanted = code.trim_matches(|letter: char| letter.is_whitespace() || matches!(letter, '[' | ']')).to_lowercase();
    if wanted.is_empty() {
        bail!("the code is empty; type a code as it is printed in brackets, as in `rins explain noise-level`. {ALL}");
    }
    match pages.iter().find(|page| page.code == wanted) {
        Some(page) => {
            must_sayln!("{} ({})\n\n{}", page.code, page.group, rendered(page.text, width(WIDEST)).trim_end());
            Ok(Ending::Done)
        }
        None => bail!("there is no code `{}`{}. {ALL}", code.trim(), similar(&wanted, &pages)),
    }
}

const ALL: &str = "`rins explain` lists all codes";

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
    let rows: Vec<_> = pages.iter().map(|page| [page.code, page.summary()]).collect();
    let mut text = String::from("`rins explain CODE` shows the page of a code.\n");
    let mut group = "";
    for (page, row) in pages.iter().zip(in_columns(&rows, width(WIDEST))) {
        if page.group != group {
            group = page.group;
            text += &format!("\n{group}\n");
        }
        text += &format!("{row}\n");
    }
    text.trim_end().into()
}

/// Codes in words that are similar to an unknown code, if there are any.
fn similar(wanted: &str, pages: &[Page]) -> String {
    match near(wanted, pages).as_slice() {
        [] => String::new(),
        codes => format!("; similar codes: {}", codes.join(", ")),
    }
}

/// The codes that are most similar to an unknown code: one contains the other, or at most every third letter differs.
fn near<'t>(wanted: &str, pages: &[Page<'t>]) -> Vec<&'t str> {
    let is_part = |code: &str| wanted.len() >= LEAST_PART && (code.contains(wanted) || wanted.contains(code));
    let rank = |code: &'t str| (!is_part(code), distance(wanted, code), code);
    let is_near = |(is_no_part, distance, code): &(bool, usize, &str)| !is_no_part || 3 * distance <= code.len();
    let mut codes: Vec<_> = pages.iter().map(|page| rank(page.code)).filter(is_near).collect();
    codes.sort_unstable();
    codes.into_iter().take(PROPOSALS).map(|(_, _, code)| code).collect()
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
        assert_eq!(near("noise-levle", &pages)[0], "noise-level");
        assert!(near("encoder", &pages).iter().all(|code| code.starts_with("encoder-")));
        assert_eq!(near("encoder", &pages).len(), PROPOSALS);
        assert_eq!(distance("kitten", "sitting"), 3);
    }

    #[test]
    fn codes_that_are_not_similar_are_not_proposed() {
        let pages = pages();
        for wanted in ["xyz", "e", "banana", "temperature", "completely-different"] {
            assert_eq!(similar(wanted, &pages), "", "{wanted}");
        }
        assert_eq!(similar("stal", &pages), "; similar codes: stall, stale-samples");
    }
}
