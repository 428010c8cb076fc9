//! The settings of a training: defaults, layers, messages.

use hydrograd::config::schema::{described, known_keys};
use hydrograd::config::training::{Kind, Settings, TRAINING};
use hydrograd::error::BadInput;

fn load(sets: &[&str]) -> Result<Settings, BadInput> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Settings::load(None, None, &sets)
}

fn refused(sets: &[&str], parts: &[&str]) {
    let message = load(sets).unwrap_err().to_string();
    for part in parts {
        assert!(message.contains(part), "no `{part}` in: {message}");
    }
}

#[test]
fn the_commented_text_is_the_default_and_describes_every_key() {
    assert_eq!(toml::from_str::<Settings>(TRAINING).unwrap(), Settings::default());
    assert_eq!(Settings::default().shown(), TRAINING);
    let described = described::<Settings>(TRAINING);
    let keys: Vec<&String> = described.iter().map(|(key, _)| key).collect();
    assert_eq!(keys.len(), known_keys::<Settings>().len());
    for key in known_keys::<Settings>() {
        assert!(keys.contains(&&key), "{key}");
    }
    for (key, comment) in &described {
        assert!(comment.ends_with('.') && comment.len() > 20, "{key}: {comment}");
    }
}

#[test]
fn what_is_shown_reads_back() {
    let sets = ["noise=1e-3", "model.radius=2.5", "model.kind=egnn", "pushforward.after=[-1, 2, 3, 4]", "steps = 7"];
    let settings = load(&sets).unwrap();
    assert_eq!((settings.noise, settings.model.radius, settings.model.kind), (1e-3, Some(2.5), Kind::Egnn));
    assert_eq!((settings.steps, settings.pushforward.after[1]), (7, 2));
    for text in [settings.shown(), settings.text()] {
        assert_eq!(toml::from_str::<Settings>(&text).unwrap(), settings, "{text}");
    }
    assert_eq!(settings.shown().matches("\n# ").count(), TRAINING.matches("\n# ").count(), "comments stay");
}

#[test]
fn later_layers_win() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("train.toml");
    std::fs::write(&file, "noise = 1e-3\n[model]\nlatent = 16\nrounds = 3\n").unwrap();
    let mut like = Settings { noise: 0.5, ..Settings::default() };
    (like.model.latent, like.features.speed) = (8, true);
    let sets = ["model.rounds=4".to_string()];
    let with_file = Settings::load(Some(&file), Some(&like), &sets).unwrap();
    assert_eq!((with_file.noise, with_file.model.latent, with_file.model.rounds), (1e-3, 16, 4));
    assert!(!with_file.features.speed);
    // Without a file, the other training's model is used, but not its other settings.
    let without = Settings::load(None, Some(&like), &sets).unwrap();
    assert_eq!((without.noise, without.model.latent, without.model.rounds), (3e-4, 8, 4));
    assert!(without.features.speed);
}

#[test]
fn messages_have_place_allowed_values_and_advice() {
    refused(&["model.latentt=8"], &["model.latentt=8: unknown field `latentt`", "rounds", "try: `latent`"]);
    refused(&["latent=8"], &["unknown field `latent`", "try: `model.latent`"]);
    refused(&["model.kind=gn"], &["`gn`", "gns, egnn", "try: `gns`"]);
    refused(&["noise=much"], &["noise=much", "a number", "allowed: noise: Standard deviation", ">= 0"]);
    refused(&["ema=1"], &["ema=1: ema = 1", "0 <= ema < 1", "ema=0 (the default)"]);
    refused(&["learning_rate_least=1"], &["learning_rate_least=1: ", "<= learning_rate, 0.0005"]);
    refused(
        &["learning_rate=1e-7"],
        &["learning_rate=1e-7: learning_rate_least = 0.000001", "learning_rate_least <= learning_rate"],
    );
    refused(&["noise"], &["there is no `=`", "model.latent=128"]);
    refused(&["pushforward.after=[-1, 5, 4, 6]"], &["pushforward.after = [-1, 5, 4, 6]", "must grow"]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("train.toml");
    let of_file = |text: &str, parts: &[&str]| {
        std::fs::write(&file, text).unwrap();
        let message = Settings::load(Some(&file), None, &[]).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "no `{part}` in: {message}");
        }
    };
    of_file(
        "steps = 5\n[model]\nlatent = 0\n",
        &["train.toml, line 3", "1 <= model.latent <= 4096", "model.latent=64 (the default)"],
    );
    of_file("steps = 5\nnoise = \"a lot\"\n", &["line 2", "noise = \"a lot\"", "a number", "Length, >= 0"]);
    of_file("[optimizer]\n", &["line 1", "unknown field `optimizer`"]);
    let missing = Settings::load(Some(&folder.path().join("none.toml")), None, &[]).unwrap_err().to_string();
    assert!(missing.contains("cannot read") && missing.contains("none.toml"), "{missing}");
}
