//! Text for a terminal: Markdown, tables and lists, wrapped to the width of the terminal.

use console::{Term, style};
use std::env;
use std::mem::take;

/// Indentation of code blocks, and of the rows of a list.
const CODE_INDENT: &str = "    ";
const LIST_INDENT: &str = "  ";
/// Space between two columns of a table.
const GUTTER: &str = "  ";
/// Least width of a text, columns, on a terminal of any width.
const NARROWEST: usize = 20;

/// Width of a text, columns: that of the environment variable COLUMNS or, without it, of the terminal, at most `widest`.
pub fn width(widest: usize) -> usize {
    let given = env::var("COLUMNS").ok().and_then(|columns| columns.trim().parse().ok()).filter(|columns| *columns > 0);
    let of_terminal = || Term::stdout().size_checked().map(|(_, columns)| columns.into());
    given.or_else(of_terminal).unwrap_or(widest).max(NARROWEST).min(widest)
}

/// Renders Markdown for a terminal. Paragraphs, lists and the cells of tables are wrapped, links are replaced by their
/// text, and comments are left out. Headings and code lines are not wrapped.
pub fn rendered(markdown: &str, width: usize) -> String {
    let mut page = Page { text: String::new(), paragraph: None, rows: Vec::new(), width };
    let mut in_code = false;
    for line in markdown.lines() {
        if line.starts_with("```") {
            page.end_block();
            in_code = !in_code;
        } else if in_code {
            page.line(&format!("{CODE_INDENT}{line}"));
        } else if line.starts_with('#') {
            page.line(&style(line).bold().to_string());
        } else if line.starts_with('|') {
            page.row(line);
        } else if line.trim().is_empty() {
            page.line("");
        } else if !line.starts_with("<!--") {
            page.prose(&plain(line));
        }
    }
    page.end_block();
    page.text
}

/// The paragraph or list item that is being read.
struct Paragraph {
    /// Indentation of all lines except the first.
    indent: usize,
    lines: Vec<String>,
}

/// The text that has been rendered so far, and the open paragraph or table.
struct Page {
    text: String,
    paragraph: Option<Paragraph>,
    /// Cells of the open table.
    rows: Vec<Vec<String>>,
    width: usize,
}

impl Page {
    /// Adds a line without wrapping. Of several empty lines only the first is kept.
    fn line(&mut self, line: &str) {
        self.end_block();
        if !line.is_empty() || !self.text.ends_with("\n\n") {
            self.text += line.trim_end();
            self.text.push('\n');
        }
    }

    /// Adds a line of a paragraph or a list.
    fn prose(&mut self, line: &str) {
        let indent = line.len() - line.trim_start().len();
        let marker = marker_length(line.trim_start());
        if marker > 0 || !self.rows.is_empty() {
            self.end_block();
        }
        let begin = || Paragraph { indent: indent + marker, lines: vec![" ".repeat(indent)] };
        let paragraph = self.paragraph.get_or_insert_with(begin);
        for word in line.split_whitespace() {
            paragraph.add(word, self.width);
        }
    }

    /// Adds a row of a table. The row between the header and the body is left out.
    fn row(&mut self, line: &str) {
        let cells: Vec<_> = line.trim().trim_matches('|').split('|').map(|cell| plain(cell.trim())).collect();
        if self.paragraph.is_some() {
            self.end_block();
        }
        let is_rule = |cell: &String| cell.chars().all(|letter| matches!(letter, '-' | ':'));
        if !cells.iter().all(is_rule) {
            self.rows.push(cells);
        }
    }

    fn end_block(&mut self) {
        let table = table(&take(&mut self.rows), self.width);
        let paragraph = self.paragraph.take().map(|paragraph| paragraph.lines).unwrap_or_default();
        for line in table.into_iter().chain(paragraph) {
            self.text += &line;
            self.text.push('\n');
        }
    }
}

impl Paragraph {
    /// A text of several words, wrapped. Words longer than a line are broken.
    fn of(text: &str, width: usize) -> Self {
        let mut paragraph = Self { indent: 0, lines: vec![String::new()] };
        for word in text.split_whitespace() {
            let letters: Vec<_> = word.chars().collect();
            letters.chunks(width).for_each(|part| paragraph.add(&String::from_iter(part), width));
        }
        paragraph
    }

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

/// A text without links and bold type.
fn plain(text: &str) -> String {
    without_links(text).replace("**", "")
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

/// A list in two or more columns, indented. All but the last column are as wide as their longest text.
pub fn in_columns<S: AsRef<str>, const COLUMNS: usize>(rows: &[[S; COLUMNS]], width: usize) -> Vec<String> {
    let cells: Vec<_> = rows.iter().map(|row| row.iter().map(|cell| cell.as_ref().to_string()).collect()).collect();
    let rows = aligned(&cells, width - LIST_INDENT.len());
    rows.iter()
        .map(|lines| lines.iter().map(|line| format!("{LIST_INDENT}{line}")).collect::<Vec<_>>().join("\n"))
        .collect()
}

/// The lines of a table with a header. If a row has several lines, empty lines separate the rows.
fn table(rows: &[Vec<String>], width: usize) -> Vec<String> {
    let rows = aligned(rows, width);
    let is_open = rows.iter().any(|lines| lines.len() > 1);
    let rule = "-".repeat(rows.iter().flatten().map(|line| letters(line)).max().unwrap_or_default());
    let mut table = Vec::new();
    for (number, lines) in rows.into_iter().enumerate() {
        match number {
            0 => table.extend(lines.iter().map(|line| style(line).bold().to_string()).chain([rule.clone()])),
            1 => table.extend(lines),
            _ => table.extend(is_open.then(String::new).into_iter().chain(lines)),
        }
    }
    table
}

/// The lines of each row, with aligned columns.
fn aligned(rows: &[Vec<String>], width: usize) -> Vec<Vec<String>> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or_default();
    let longest = |length: fn(&str) -> usize| -> Vec<usize> {
        let of_column =
            |column: usize| rows.iter().filter_map(move |row| row.get(column).map(|cell: &String| length(cell))).max();
        (0..columns).map(|column| of_column(column).unwrap_or_default()).collect()
    };
    let gutters = GUTTER.len() * columns.saturating_sub(1);
    let widths = widths(&longest(letters), longest(longest_word), width.saturating_sub(gutters));
    rows.iter().map(|row| lines(row, &widths)).collect()
}

fn letters(text: &str) -> usize {
    text.chars().count()
}

fn longest_word(text: &str) -> usize {
    text.split_whitespace().map(letters).max().unwrap_or_default()
}

/// Widths of columns whose whole texts and longest words have these lengths, in the `available` width.
fn widths(whole: &[usize], words: Vec<usize>, available: usize) -> Vec<usize> {
    let mut widths = words;
    let mut used: usize = widths.iter().sum();
    while used > available {
        let Some(widest) = widths.iter_mut().max().filter(|widest| **widest > 1) else { break };
        *widest -= 1;
        used -= 1;
    }
    // The column with the most lines gets the next letter.
    let lines = |column: usize, widths: &[usize]| whole[column] as f64 / widths[column] as f64;
    while used < available {
        let short = (0..whole.len()).filter(|column| widths[*column] < whole[*column]);
        let Some(next) = short.max_by(|a, b| lines(*a, &widths).total_cmp(&lines(*b, &widths))) else { break };
        widths[next] += 1;
        used += 1;
    }
    widths
}

/// The lines of one row.
fn lines(row: &[String], widths: &[usize]) -> Vec<String> {
    let cells: Vec<_> = row.iter().zip(widths).map(|(cell, width)| Paragraph::of(cell, *width).lines).collect();
    let height = cells.iter().map(Vec::len).max().unwrap_or_default();
    let line = |number: usize| {
        let parts = cells.iter().zip(widths).map(|(cell, &width)| {
            let part = cell.get(number).map_or("", String::as_str);
            format!("{part:width$}")
        });
        parts.collect::<Vec<_>>().join(GUTTER).trim_end().to_string()
    };
    (0..height).map(line).collect()
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
    fn headings_and_code_stay_as_they_are() {
        let text = "# A heading that is long\n\n```sh\ncode [x](y)  that is long\n\n\n```\n";
        let expected = "# A heading that is long\n\n    code [x](y)  that is long\n\n\n";
        assert_eq!(rendered(text, 10), expected);
    }

    #[test]
    fn the_columns_of_tables_are_aligned_and_wrapped() {
        let text = "before\n| a | column |\n|---|---|\n| one | [text](x) of cells |\n| three | **four** |\nafter\n";
        let wide = "before\na      column\n--------------------\none    text of cells\nthree  four\nafter\n";
        assert_eq!(rendered(text, 20), wide);
        let narrow = "before\na      column\n--------------\none    text of\n       cells\n\nthree  four\nafter\n";
        assert_eq!(rendered(text, 16), narrow);
        let broken = rendered("| a long-word | another-word |\n", 10);
        assert!(broken.lines().all(|line| line.chars().count() <= 10), "{broken}");
    }

    #[test]
    fn a_list_has_columns_and_is_indented() {
        let rows = [["a", "one two"], ["bcd", "three"]];
        assert_eq!(in_columns(&rows, 80), ["  a    one two", "  bcd  three"]);
        assert_eq!(in_columns(&rows, 12), ["  a    one\n       two", "  bcd  three"]);
    }

    #[test]
    fn links_are_named_and_comments_left_out() {
        assert_eq!(without_links("see [`a`](crate::a), [b](https://b.org) or [[1,0],[0,1]]."), {
            "see `a`, b (https://b.org) or [[1,0],[0,1]]."
        });
        assert_eq!(rendered("a\n\n<!-- nobody reads this -->\n\nb\n", 80), "a\n\nb\n");
    }
}
