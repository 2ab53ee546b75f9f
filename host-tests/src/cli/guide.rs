//! `rins guide`: the chapters of the guide as text for a terminal.

use super::ending::Ending;
use super::output::must_sayln;
use super::prose::{in_columns, rendered, width};
use anyhow::Result;
use clap::Args;
use clap::builder::PossibleValuesParser;
use rins_selfcal::guide::CHAPTERS;

/// Widest text, columns.
const WIDEST: usize = 80;

#[derive(Debug, Args)]
pub struct GuideArguments {
    /// Chapter to print [default: the list of chapters]
    #[arg(value_parser = PossibleValuesParser::new(CHAPTERS.map(|chapter| chapter.name)))]
    chapter: Option<String>,
}

pub fn run(arguments: &GuideArguments) -> Result<Ending> {
    let chosen = |name: &String| CHAPTERS.iter().find(|chapter| chapter.name == name);
    match arguments.chapter.as_ref().and_then(chosen) {
        Some(chapter) => must_sayln!("{}", rendered(chapter.text, width(WIDEST)).trim_end()),
        None => must_sayln!("{}", contents()),
    }
    Ok(Ending::Done)
}

fn contents() -> String {
    let rows: Vec<_> = CHAPTERS.iter().map(|chapter| [chapter.name, chapter.title]).collect();
    format!(
        "Chapters of the guide, each printed by `rins guide CHAPTER`:\n\n{}",
        in_columns(&rows, width(WIDEST)).join("\n")
    )
}
