//! Takes the suggestions that errors make.

use clap::Parser;
use hydrograd::cli::arguments::OPTIONS;
use hydrograd::cli::{Cli, Command};
use hydrograd::config::scene::Config;
use hydrograd::config::suggest::{alternatives, assignments};
use hydrograd::error::Error;
use std::path::Path;

/// The alternatives in the advice of a message.
pub fn suggestions(message: &str) -> Vec<&str> {
    let advice = message.lines().filter_map(|line| line.strip_prefix("  try: "));
    advice.flat_map(alternatives).collect()
}

/// Loads the scene of a command line; none for commands without one.
fn load(arguments: &[String]) -> Option<Result<(), Error>> {
    let words = std::iter::once("hydrograd".to_string()).chain(arguments.iter().cloned());
    let cli = Cli::try_parse_from(words).unwrap_or_else(|error| panic!("{arguments:?}: {error}"));
    let loaded = match cli.command {
        Command::Simulate(arguments) => arguments.load(),
        Command::Optimize(arguments) => arguments.load(),
        Command::CheckGradient(arguments) => arguments.load(),
        _ => return None,
    };
    Some(loaded.map(drop))
}

/// Follows each suggestion that the refusal of a command line makes: the command takes it, and another or no error follows.
#[track_caller]
pub fn are_followed(folder: &Path, arguments: &[&str], message: &str) {
    if !["simulate", "optimize", "check-gradient"].contains(&arguments[0])
        || arguments.iter().any(|word| word.starts_with("design.file") || *word == "--resume")
    {
        return;
    }
    for suggestion in suggestions(message) {
        let words: Vec<&str> = suggestion.split(' ').map(|word| word.trim_matches(['(', ')', ',', ';', '`'])).collect();
        let pairs = words.windows(2).map(|pair| (pair[0], pair[1]));
        let given = pairs.filter_map(|(option, value)| match option {
            "--set" => Some((option, value, value.split('=').next()?)),
            _ => OPTIONS.iter().find(|(known, _)| *known == option).map(|(_, key)| (option, value, *key)),
        });
        let given: Vec<(&str, &str, &str)> = given.collect();
        let mut all: Vec<String> = Vec::new();
        let mut before = "";
        for &word in arguments {
            let is_replaced = |word: &str| word != "--set" && given.iter().any(|(option, ..)| *option == word);
            if !is_replaced(word) && !is_replaced(before) {
                let path = folder.join(word);
                all.push(if path.is_file() { path.display().to_string() } else { word.to_string() });
            }
            before = word;
        }
        given.iter().for_each(|(option, value, _)| all.extend([option.to_string(), value.to_string()]));
        if let (false, Some(Err(Error::Input(bad)))) = (given.is_empty(), load(&all)) {
            let is_about = given.iter().any(|(_, _, key)| bad.is_about(key));
            assert!(!is_about && !message.contains(&bad.to_string()), "{arguments:?}: {message}\n{suggestion}: {bad}");
        }
    }
}

/// Follows each suggestion of an error about these settings of a scene; how many there were.
#[track_caller]
pub fn are_possible(scene: &str, sets: &[String], message: &str) -> usize {
    let mut taken = 0;
    for suggestion in suggestions(message) {
        let more: Vec<String> = assignments(suggestion).into_iter().map(String::from).collect();
        let keys: Vec<&str> = more.iter().filter_map(|one| one.split('=').next()).collect();
        taken += usize::from(!more.is_empty());
        assert!(more.iter().all(|one| !sets.contains(one)), "{scene} {sets:?}: {message}: it is so already");
        if let (false, Err(Error::Input(bad))) =
            (more.is_empty(), Config::load(Some(scene), None, &[sets, &more].concat()))
        {
            assert!(!keys.iter().any(|key| bad.is_about(key)), "{scene} {sets:?}: {message}\n{suggestion}: {bad}");
        }
    }
    taken
}
