//! `pnet-nat completions` and `pnet-nat man`: shell completions and manual pages, generated from the
//! command line's own definition. Packages install them.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;

use super::Cli;
use super::output::out;

/// Print the completion script of a shell.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:  pnet-nat completions bash > ~/.local/share/bash-completion/completions/pnet-nat\n\
    Packages install it in /usr/share: bash-completion/completions/pnet-nat,\n\
    zsh/vendor-completions/_pnet-nat, fish/vendor_completions.d/pnet-nat.fish."
)]
pub(super) struct Completions {
    #[arg(value_enum)]
    shell: Shell,
}

/// Write a manual page for each command into a folder.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:  pnet-nat man ~/.local/share/man/man1\n\
    Packages install the pages in /usr/share/man/man1.")]
pub(super) struct Man {
    /// The folder; it is made if it does not exist.
    folder: PathBuf,
}

/// Prints the completions of a shell.
pub(super) fn completions(args: &Completions) -> anyhow::Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "pnet-nat", &mut script);
    out().write_all(&script)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the manual pages: `pnet-nat.1`, `pnet-nat-run.1` and so on.
pub(super) fn man(args: &Man) -> anyhow::Result<ExitCode> {
    let command = Cli::command().mut_subcommands(|command| {
        let text = command.get_after_help().map(|help| in_paragraphs(&help.to_string()));
        command.after_help(text.unwrap_or_default())
    });
    let written = fs::create_dir_all(&args.folder)
        .and_then(|()| clap_mangen::generate_to(command, &args.folder));
    written.with_context(|| args.folder.display().to_string())?;
    Ok(ExitCode::SUCCESS)
}

/// Whether a line of a help text is an example.
fn is_example(line: &str) -> bool {
    line.starts_with("Example:") || line.contains("  pnet-nat ")
}

/// A manual page joins lines. So each example becomes a paragraph of its own, in one line.
fn in_paragraphs(help: &str) -> String {
    let mut text = String::new();
    for line in help.replace("\\\n", "").lines() {
        text.extend(line.split_whitespace().flat_map(|word| [word, " "]));
        text.push_str(if is_example(line) { "\n\n" } else { "\n" });
    }
    text
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use clap::error::ErrorKind;

    use super::*;

    #[test]
    fn every_command_has_an_example_that_is_a_command_line() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands() {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let help = help.replace("\\\n", " ");
            let examples: Vec<_> = help.lines().filter(|line| is_example(line)).collect();
            assert!(!examples.is_empty(), "{} has no example", command.get_name());
            let named = help.matches("pnet-nat ").count();
            assert_eq!(examples.len(), named, "of {}, some are not looked at", command.get_name());
            for example in examples {
                let words = &example[example.find("pnet-nat ").expect(example)..];
                let words = words.split(['|', '>']).next().unwrap().split_whitespace();
                match Cli::try_parse_from(words) {
                    Ok(_) => {}
                    // Its files are not here.
                    Err(error) if error.to_string().contains("--password-file") => {
                        assert_eq!(error.kind(), ErrorKind::ValueValidation, "{error}");
                    }
                    Err(error) => panic!("{example}: {error}"),
                }
            }
        }
    }
}
