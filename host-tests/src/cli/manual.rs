//! `rins completions` and `rins man`: made of the command line itself.

use super::Ending;
use super::arguments::{Arguments, CompletionsArguments};
use super::output::must_sayln;
use clap::CommandFactory;

pub fn completions(arguments: &CompletionsArguments) -> anyhow::Result<Ending> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "rins", &mut text);
    print(&text)
}

/// All commands on one page.
pub fn page() -> anyhow::Result<Ending> {
    let mut root = Arguments::command();
    root.build();
    let mut text = Vec::new();
    clap_mangen::Man::new(root.clone()).render(&mut text)?;
    for command in root.get_subcommands().filter(|command| command.get_name() != "help") {
        let name = format!("rins {}", command.get_name());
        let man = clap_mangen::Man::new(command.clone().display_name(name));
        man.render_name_section(&mut text)?;
        man.render_synopsis_section(&mut text)?;
        man.render_options_section(&mut text)?;
        man.render_extra_section(&mut text)?;
    }
    print(&text)
}

fn print(text: &[u8]) -> anyhow::Result<Ending> {
    must_sayln!("{}", std::str::from_utf8(text)?.trim_end());
    Ok(Ending::Done)
}
