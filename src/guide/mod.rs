//! The guide, in chapters. [`tutorial`] is the first; the others can be read in any order.
//!
//! | chapter | contents |
//! |---|---|
//! | [`tutorial`] | from nothing to a first calibration, a log of your own, reading the result |
//! | [`verdict`] | what accepted, rejected and aborted mean; chi-square, innovations and sigmas |
//! | [`reasons`] | every reason of a rejected or aborted run: what it means and what to look at first |
//! | [`schemes`] | choosing a rotation scheme, planning one, the table of the library |
//! | [`board`] | the core on your board: interrupts, drivers, wiring, store, watchdog, serial line |
//! | [`bring_up`] | the first hour on silicon: what to measure on a new board, in order, with the expected readings |
//! | [`formats`] | every file and record: log, mapping, unit, errors, scheme, result, store, link |
//! | [`theory`] | frames, signs, the error model, both methods, observability |
//! | [`studies`] | Monte Carlo, faults, fuzzing, mutants and the other campaigns, each with its command |
//! | [`faq`] | short answers to frequent questions |
//!
//! `rins guide` prints the same chapters in a terminal.

/// A chapter of the guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Chapter {
    /// Name of the chapter: its module, and the argument of `rins guide`.
    pub name: &'static str,
    /// One line on the contents.
    pub title: &'static str,
    /// The text, Markdown.
    pub text: &'static str,
}

macro_rules! chapters {
    ($($name:ident: $title:literal,)*) => {
        $(
            #[doc = include_str!(concat!(stringify!($name), ".md"))]
            pub mod $name {}
        )*

        /// All chapters, in the order of reading. Only the `rins` program reads them; no firmware image contains them.
        pub const CHAPTERS: [Chapter; [$($title),*].len()] = [$(Chapter {
            name: stringify!($name),
            title: $title,
            text: include_str!(concat!(stringify!($name), ".md")),
        }),*];
    };
}

chapters! {
    tutorial: "from nothing to a first calibration, a log of your own, reading the result",
    verdict: "what accepted, rejected and aborted mean; chi-square, innovations and sigmas",
    reasons: "every reason of a rejected or aborted run: what it means and what to look at first",
    schemes: "choosing a rotation scheme, planning one, the table of the library",
    board: "the core on your board: interrupts, drivers, wiring, store, watchdog, serial line",
    bring_up: "the first hour on silicon: what to measure on a new board, in order, with the expected readings",
    formats: "every file and record: log, mapping, unit, errors, scheme, result, store, link",
    theory: "frames, signs, the error model, both methods, observability",
    studies: "Monte Carlo, faults, fuzzing, mutants and the other campaigns, each with its command",
    faq: "short answers to frequent questions",
}

#[cfg(test)]
mod codes;

#[cfg(test)]
mod tests {
    use super::CHAPTERS;
    use crate::model::effects::EFFECT_INFO;
    use crate::model::error_model::PARAMETER_INFO;
    use std::format;
    use std::vec::Vec;

    const CONTENTS: &str = include_str!("mod.rs");

    fn chapter(name: &str) -> &'static str {
        CHAPTERS.iter().find(|chapter| chapter.name == name).expect("a chapter").text
    }

    #[test]
    fn every_state_is_explained() {
        for info in PARAMETER_INFO.iter().chain(&EFFECT_INFO) {
            let name = format!("`{}`", info.name);
            let rows = chapter("theory").lines().filter(|line| line.starts_with("| `") && line.contains(&name)).count();
            assert_eq!(rows, 1, "{name}");
        }
    }

    #[test]
    fn the_contents_name_every_chapter_with_its_title() {
        let rows: Vec<_> = CONTENTS.lines().filter(|line| line.starts_with("//! | [`")).collect();
        let expected: Vec<_> =
            CHAPTERS.iter().map(|chapter| format!("//! | [`{}`] | {} |", chapter.name, chapter.title)).collect();
        assert_eq!(rows, expected);
    }

    /// rustdoc would compile an untagged block as a test.
    #[test]
    fn every_chapter_begins_with_its_heading_and_tags_its_code_blocks() {
        for chapter in CHAPTERS {
            assert!(chapter.text.starts_with("# "), "{}", chapter.name);
            let fences: Vec<_> = chapter.text.lines().filter(|line| line.starts_with("```")).collect();
            assert_eq!(fences.len() % 2, 0, "{}", chapter.name);
            assert!(fences.iter().step_by(2).all(|fence| fence.len() > 3), "{}", chapter.name);
            assert!(fences.iter().skip(1).step_by(2).all(|fence| *fence == "```"), "{}", chapter.name);
        }
    }
}
