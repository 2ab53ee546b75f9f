//! `rins completions` and `rins man`, both generated from the definition of the command line.

use super::ending::Ending;
use super::output::must_sayln;
use clap::Args;

#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// Shell that will use the script
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Prints the completion script of a shell.
pub fn completions(arguments: &CompletionsArguments, mut command_line: clap::Command) -> anyhow::Result<Ending> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut command_line, "rins", &mut text);
    print(&text)
}

/// Prints one manual page with all commands.
pub fn page(mut root: clap::Command) -> anyhow::Result<Ending> {
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
