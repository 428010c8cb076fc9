//! `hydrograd completions` and `hydrograd man`: what shells and `man` want to know of the command line.

use super::{files, machine, Cli};
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use clap::{Args, Command, CommandFactory};
use clap_complete::Shell;
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
    clap_complete::generate(arguments.shell, &mut Cli::command(), "hydrograd", &mut text);
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
    let mut command = Cli::command();
    // Then every command knows its whole name.
    command.build();
    let count = page(&command, &arguments.folder)?;
    let first = arguments.folder.join("hydrograd.1");
    machine::answer(
        &json!({ "folder": machine::path(&arguments.folder), "pages": count, "first": machine::path(&first) }),
    );
    println!("{count} pages in {}; man -l {}", arguments.folder.display(), first.display());
    Ok(())
}

/// The pages of a command and of those below it.
fn page(command: &Command, folder: &Path) -> anyhow::Result<usize> {
    let man = Man::new(command.clone());
    let mut text = Vec::new();
    man.render(&mut text)?;
    write_bytes_atomically(&folder.join(man.get_filename()), &text)?;
    let mut count = 1;
    for below in command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help") {
        count += page(below, folder)?;
    }
    Ok(count)
}
