//! The configuration of a training, read from TOML and `key=value`. `data/training.toml` has a comment on every key.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::config::layers::{Layer, Merged, Setting};
use crate::config::range::{
    Number,
    Range::{Above, AtLeast, Below, NotNegative, Positive, Within},
};
use crate::config::schema::{Alternative, Schema};
use crate::config::section::section;
use crate::error::BadInput;

/// The default settings, with a comment on every key.
pub const TRAINING: &str = include_str!("../../data/training.toml");

/// Largest number of frames in a model's input, with which a rollout begins.
pub const MOST_FRAMES: usize = 6;

/// Largest number of unrolled steps for pushforward.
const MOST_UNROLLS: usize = 20;

/// Keys that may change when a training is continued.
pub const FREE: [&str; 6] =
    ["steps", "log_every", "validate_every", "store_every", "validation_windows", "validation_steps"];

section! {
    /// The settings of a training. Defaults follow LagrangeBench where it has them.
    "": Settings {
        steps: u64 = 20_000, AtLeast(1.0);
        batch_size: usize = 1, Within(1.0, 4096.0);
        noise: f64 = 3e-4, NotNegative;
        temperature_noise: f64 = 0.1, NotNegative;
        learning_rate: f64 = 5e-4, Positive;
        learning_rate_factor: f64 = 0.1, Within(0.0, 1.0);
        learning_rate_steps: u64 = 100_000, AtLeast(1.0);
        learning_rate_least: f64 = 1e-6, NotNegative;
        weight_decay: f64 = 1e-8, NotNegative;
        clip: f64 = 0.0, NotNegative;
        ema: f64 = 0.0, Below(0.0, 1.0);
        temperature_weight: f64 = 1.0, NotNegative;
        seed: u64 = 0;
        log_every: u64 = 50, AtLeast(1.0);
        validate_every: u64 = 1000, AtLeast(1.0);
        store_every: u64 = 1000, AtLeast(1.0);
        validation_windows: usize = 8, AtLeast(1.0);
        validation_steps: usize = 20, AtLeast(1.0);
        model: ModelSettings = ModelSettings::default();
        features: Features = Features::default();
        pushforward: Pushforward = Pushforward::default();
        objective: ObjectiveLoss = ObjectiveLoss::default();
    }
}

section! {
    "model.": ModelSettings {
        kind: Kind = Kind::Gns;
        latent: usize = 64, Within(1.0, 4096.0);
        rounds: usize = 5, Within(1.0, 100.0);
        linears: usize = 2, Within(2.0, 8.0);
        #[serde(skip_serializing_if = "Option::is_none")]
        radius: Option<f64> = None, Above(1.0, 10.0);
        embedding: usize = 16, AtLeast(1.0);
        heat: HeatModel = HeatModel::Learned;
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    Gns,
    /// E(n)-equivariant graph network.
    Egnn,
}

/// How temperatures are advanced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeatModel {
    /// The change is a further output of the model.
    Learned,
    /// The solver's heat conduction along the learned motion.
    Conduction,
    /// Temperatures of the data are ignored.
    None,
}

section! {
    #[derive(Copy, Eq)]
    "features.": Features {
        frames: usize = MOST_FRAMES, Within(2.0, MOST_FRAMES as f64);
        speed: bool = false;
        boundary: bool = true;
        unset_walls: bool = false;
        force: bool = false;
    }
}

section! {
    /// Training on the model's own predictions (Brandstetter, Worrall and Welling 2022): after step `after[k]`, with
    /// relative odds `odds[k]`, `unrolls[k]` steps without gradient precede the step that is learned from.
    "pushforward.": Pushforward {
        after: Vec<i64> = vec![-1, 20_000, 300_000, 400_000];
        unrolls: Vec<usize> = vec![0, 1, 2, 3];
        odds: Vec<f64> = vec![18.0, 2.0, 1.0, 1.0];
    }
}

section! {
    /// Training on the objective of a rollout and its change with the wall, see [`crate::surrogate::training::objective`].
    #[derive(Copy)]
    "objective.": ObjectiveLoss {
        weight: f64 = 0.0, NotNegative;
        gradient: f64 = 10.0, NotNegative;
        steps: usize = 20, Within(1.0, 200.0);
        first: usize = 0, Within(0.0, 1e6);
        every: u64 = 1, AtLeast(1.0);
    }
}

impl Pushforward {
    /// The number of unrolled steps at a training step, for a random number in [0, 1).
    pub fn unrolls(&self, step: u64, chance: f64) -> usize {
        let open = self.after.iter().filter(|&&after| step as i64 > after).count();
        let total: f64 = self.odds[..open].iter().sum();
        let mut sum = 0.0;
        for (&unrolls, &odds) in self.unrolls[..open].iter().zip(&self.odds) {
            sum += odds / total;
            if chance < sum {
                return unrolls;
            }
        }
        self.unrolls.first().copied().unwrap_or(0)
    }

    pub fn most(&self) -> usize {
        self.unrolls.iter().copied().max().unwrap_or(0)
    }
}

impl Schema for Settings {
    const ALTERNATIVES: &'static [Alternative] = &[];
    const FORM: &'static str = "KEY=VALUE, for example model.latent=128";
    const HELP: &'static str = "`hydrograd help train` says how every key is printed with its meaning";

    fn texts() -> Vec<&'static str> {
        vec![TRAINING]
    }

    fn complete() -> Vec<Self> {
        let mut settings = Self::default();
        settings.model.radius = Some(1.45);
        vec![settings]
    }

    fn numbers(&self) -> Vec<Number> {
        [Self::numbers(self), self.model.numbers(), self.features.numbers(), self.objective.numbers()].concat()
    }

    fn usual(&self) -> (Self, &'static str) {
        (Self::default(), "the default")
    }

    fn origin(&self) -> String {
        "default of a training".into()
    }

    fn check_together(&self) -> Result<(), BadInput> {
        if self.learning_rate_least > self.learning_rate {
            return Err(BadInput::at(
                "learning_rate_least",
                format!("learning_rate_least = {} is out of range", self.learning_rate_least),
            )
            .allowed(format!("learning_rate_least <= learning_rate, {}", self.learning_rate)));
        }
        self.pushforward.check()
    }
}

impl Pushforward {
    fn check(&self) -> Result<(), BadInput> {
        let Self { after, unrolls, odds } = self;
        if after.len() != unrolls.len() || after.len() != odds.len() || after.first() != Some(&-1) {
            return Err(BadInput::at(
                "pushforward.after",
                "pushforward's after, unrolls and odds do not belong together",
            )
            .allowed("three lists of one length, after beginning with -1 and growing, odds > 0")
            .advice("pushforward.after=[-1] pushforward.unrolls=[0] pushforward.odds=[1]"));
        }
        let wrong = |key: &str, value: String, allowed: String| {
            let bad = BadInput::at(key, format!("{key} = {value} is out of range"));
            Err(bad.allowed(format!("{key} {allowed}")))
        };
        if after.windows(2).any(|pair| pair[1] <= pair[0]) {
            return wrong("pushforward.after", format!("{after:?}"), "must grow".into());
        }
        if odds.iter().any(|&odds| !(odds > 0.0 && odds.is_finite())) {
            return wrong("pushforward.odds", format!("{odds:?}"), "must be > 0".into());
        }
        if self.most() > MOST_UNROLLS {
            return wrong("pushforward.unrolls", format!("{unrolls:?}"), format!("<= {MOST_UNROLLS}"));
        }
        Ok(())
    }
}

impl Settings {
    /// Loads and checks a training. Later layers take precedence: the defaults, the file, each of `sets` (`key=value`).
    /// Without a file, model and features are those of `like`, the training whose parameters are used, if there is one.
    ///
    /// # Errors
    /// Unreadable file; unknown key, wrong type or range, with the place where it was set.
    pub fn load(file: Option<&Path>, like: Option<&Self>, sets: &[String]) -> Result<Self, BadInput> {
        let settings: Vec<Setting> = sets.iter().map(|text| Setting::set(text)).collect();
        Self::load_settings(file, like, &settings)
    }

    /// [`Settings::load`] for settings that carry the names of command-line options for error messages.
    pub fn load_settings(file: Option<&Path>, like: Option<&Self>, settings: &[Setting]) -> Result<Self, BadInput> {
        let mut merged = Merged::new(TRAINING);
        match (file, like) {
            (Some(path), _) => merged.apply::<Self>(&read(path)?),
            (None, Some(like)) => {
                let like = Self { model: like.model.clone(), features: like.features, ..Self::default() };
                merged.apply::<Self>(&Layer::from_value(&like, "the training to begin with"));
            }
            (None, None) => {}
        }
        for setting in settings {
            merged.apply::<Self>(&Layer::from_setting::<Self>(setting)?);
        }
        merged.checked(|_| Ok(()))
    }

    pub fn text(&self) -> String {
        toml::to_string(self as &dyn erased_serde::Serialize).unwrap_or_default()
    }

    /// The settings as TOML with a comment on every key, including absent ones.
    pub fn shown(&self) -> String {
        let mut merged = Merged::new(TRAINING);
        merged.apply::<Self>(&Layer::from_value(self, ""));
        merged.text()
    }
}

fn read(path: &Path) -> Result<Layer, BadInput> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| {
        BadInput::new(format!("cannot read {name}: {error}"))
            .allowed("a TOML file with settings of a training")
            .advice("leave it out for the defaults, or take the config.toml of an earlier training")
    })?;
    Layer::from_text::<Settings>(&name, &text)
}
