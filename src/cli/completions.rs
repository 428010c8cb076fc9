//! `hydrograd completions` and `hydrograd man`: shell completions and manual pages of the command line.

use super::{files, line, machine};
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::roff::{roman, Roff};
use clap_mangen::Man;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Print what a shell needs to complete hydrograd's commands and options.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  source <(hydrograd completions bash)
      for this shell
  hydrograd completions bash > ~/.local/share/bash-completion/completions/hydrograd
      for every bash from now on
  hydrograd completions zsh > ~/.zfunc/_hydrograd
      with `fpath+=~/.zfunc` before `compinit` in ~/.zshrc
  hydrograd completions fish > ~/.config/fish/completions/hydrograd.fish")]
pub struct CompletionsArguments {
    pub shell: Shell,
}

pub fn run(arguments: &CompletionsArguments) -> anyhow::Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut line(), "hydrograd", &mut text);
    machine::answer(&json!({ "shell": arguments.shell.to_string(), "text": String::from_utf8_lossy(&text) }));
    Ok(files::print(&text)?)
}

/// Write man pages: hydrograd.1, and one per command.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd man ~/.local/share/man/man1
      then `man hydrograd-optimize`
  hydrograd man pages && man -l pages/hydrograd.1")]
pub struct ManArguments {
    /// Folder for the pages.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

pub fn man(arguments: &ManArguments) -> anyhow::Result<()> {
    prepare_output_folder(&arguments.folder)?;
    let mut command = without_help(line());
    // Gives every command its full name.
    command.build();
    let count = page(&command, &arguments.folder)?;
    let first = arguments.folder.join("hydrograd.1");
    machine::answer(
        &json!({ "folder": machine::path(&arguments.folder), "pages": count, "first": machine::path(&first) }),
    );
    println!("{count} pages in {}; man -l {}", arguments.folder.display(), first.display());
    Ok(())
}

/// Writes the pages of a command and its subcommands.
fn page(command: &Command, folder: &Path) -> anyhow::Result<usize> {
    let man = Man::new(command.clone()).source(format!("hydrograd {}", files::VERSION)).manual("hydrograd");
    let mut text = Vec::new();
    man.render_title(&mut text)?;
    man.render_name_section(&mut text)?;
    man.render_synopsis_section(&mut text)?;
    man.render_description_section(&mut text)?;
    man.render_options_section(&mut text)?;
    if command.has_subcommands() {
        man.render_subcommands_section(&mut text)?;
    }
    notes(command).to_writer(&mut text)?;
    write_bytes_atomically(&folder.join(man.get_filename()), &text)?;
    let mut count = 1;
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        count += page(below, folder)?;
    }
    Ok(count)
}

/// Removes `hydrograd help`, which needs no page.
fn without_help(line: Command) -> Command {
    let names: Vec<String> = line.get_subcommands().map(|below| below.get_name().to_string()).collect();
    let line = line.disable_help_subcommand(true);
    names.into_iter().fold(line, |line, name| line.mut_subcommand(name, without_help))
}

/// The sections of a command's help after its options, with examples line by line.
fn notes(command: &Command) -> Roff {
    let mut page = Roff::new();
    let text = command.get_after_long_help().or(command.get_after_help()).map(|text| text.to_string());
    let mut is_begun = false;
    for block in text.iter().flat_map(|text| text.split("\n\n")) {
        if let Some(examples) = block.strip_prefix("Examples:\n") {
            page.control("SH", ["EXAMPLES"]).control("nf", []);
            for line in examples.lines() {
                page.text([roman(line)]);
            }
            page.control("fi", []);
            is_begun = false;
        } else if let Some(codes) = block.strip_prefix("Exit codes: ") {
            page.control("SH", ["EXIT STATUS"]).text([roman(codes)]);
            is_begun = false;
        } else {
            page.control(if is_begun { "PP" } else { "SH" }, if is_begun { vec![] } else { vec!["NOTES"] });
            page.text([roman(block)]);
            is_begun = true;
        }
    }
    page
}
