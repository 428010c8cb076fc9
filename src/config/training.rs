//! What a training is: every number of it, as read from TOML or `--set`.

use crate::error::BadInput;
use crate::surrogate::features::Features;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A training's settings. Defaults follow LagrangeBench where it has them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Updates of the parameters.
    pub steps: u64,
    /// Windows per update; their gradients are averaged.
    pub batch_size: usize,
    /// Standard deviation of the position noise at the last input frame, in units of length.
    pub noise: f64,
    /// The same for temperatures, in standard deviations of the temperature's change per frame.
    pub temperature_noise: f64,
    /// max(learning_rate * learning_rate_factor^(step/learning_rate_steps), learning_rate_least).
    pub learning_rate: f64,
    pub learning_rate_factor: f64,
    pub learning_rate_steps: u64,
    pub learning_rate_least: f64,
    pub weight_decay: f64,
    /// Largest norm of the gradient of all parameters; 0 does not clip.
    pub clip: f64,
    /// Decay of a moving average of the parameters that is validated and stored beside them; 0 keeps none.
    pub ema: f64,
    /// Weight of the temperature's part of the loss.
    pub temperature_weight: f64,
    pub seed: u64,
    /// Steps between rows of history.csv, between validations, and between checkpoints.
    pub log_every: u64,
    pub validate_every: u64,
    pub store_every: u64,
    /// Windows of the validation split that are rolled out, and frames of each.
    pub validation_windows: usize,
    pub validation_steps: usize,
    pub model: ModelSettings,
    pub features: Features,
    pub pushforward: Pushforward,
}

/// The model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelSettings {
    pub kind: Kind,
    /// Width of everything.
    pub latent: usize,
    /// Rounds of messages.
    pub rounds: usize,
    /// Linear layers of each perceptron.
    pub linears: usize,
    /// Connectivity radius in spacings; without one the data set's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// Columns of the embedding of the particle type.
    pub embedding: usize,
    pub heat: HeatModel,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Graph network simulator.
    Gns,
    /// E(n)-equivariant graph network.
    Egnn,
}

/// How temperatures advance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeatModel {
    /// The change is another output of the model.
    Learned,
    /// The solver's conduction along the learned motion.
    Conduction,
    /// Temperatures of the data are not looked at.
    None,
}

/// Training on the model's own predictions (Brandstetter, Worrall and Welling 2022): from step `after[k]` on, `unrolls[k]`
/// steps without gradient before the one that is learned from come up with odds `odds[k]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pushforward {
    pub after: Vec<i64>,
    pub unrolls: Vec<usize>,
    pub odds: Vec<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            steps: 20_000,
            batch_size: 1,
            noise: 3e-4,
            temperature_noise: 0.1,
            learning_rate: 5e-4,
            learning_rate_factor: 0.1,
            learning_rate_steps: 100_000,
            learning_rate_least: 1e-6,
            weight_decay: 1e-8,
            clip: 0.0,
            ema: 0.0,
            temperature_weight: 1.0,
            seed: 0,
            log_every: 50,
            validate_every: 1000,
            store_every: 1000,
            validation_windows: 8,
            validation_steps: 20,
            model: ModelSettings::default(),
            features: Features::default(),
            pushforward: Pushforward::default(),
        }
    }
}

impl Default for ModelSettings {
    fn default() -> Self {
        let (kind, heat) = (Kind::Gns, HeatModel::Learned);
        Self { kind, latent: 64, rounds: 5, linears: 2, radius: None, embedding: 16, heat }
    }
}

impl Default for Pushforward {
    fn default() -> Self {
        let after = vec![-1, 20_000, 300_000, 400_000];
        Self { after, unrolls: vec![0, 1, 2, 3], odds: vec![18.0, 2.0, 1.0, 1.0] }
    }
}

impl Pushforward {
    /// Unrolled steps at a step, from a number in [0, 1).
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

    /// The most unrolled steps that can come up.
    pub fn most(&self) -> usize {
        self.unrolls.iter().copied().max().unwrap_or(0)
    }
}

impl Settings {
    /// The defaults, or a file, and `key=value` over them. Without a file the model is that of `like`, if there is one:
    /// the training whose parameters are taken over.
    ///
    /// # Errors
    /// Unreadable file, unknown key, wrong type or range.
    pub fn load(file: Option<&Path>, like: Option<&Self>, sets: &[String]) -> Result<Self, BadInput> {
        let like = like.map(|like| Self { model: like.model.clone(), features: like.features, ..Self::default() });
        let (mut text, mut place) = (like.map_or(String::new(), |like| like.text()), "--set".to_owned());
        if let Some(path) = file {
            place = path.display().to_string();
            text = std::fs::read_to_string(path).map_err(|error| {
                BadInput::new(format!("cannot read {place}: {error}"))
                    .place(format!("--config {place}"))
                    .allowed("a TOML file with settings of a training")
                    .advice("leave it out for the defaults, or take the config.toml of an earlier training")
            })?;
        }
        let mut settings = Self::parse(&text, &place)?;
        for set in sets {
            let place = format!("--set {set}");
            let (key, value) = set.split_once('=').ok_or_else(|| {
                BadInput::new("there is no `=` in it")
                    .place(&place)
                    .allowed("KEY=VALUE")
                    .advice("--set model.latent=128")
            })?;
            let mut document = settings.document();
            let value = value.trim();
            // What is no TOML value is meant as a text, so that `--set model.kind=egnn` needs no quotes.
            let value = value.parse().unwrap_or_else(|_| toml_edit::Value::from(value));
            let mut item = document.as_item_mut();
            for part in key.trim().split('.') {
                item = &mut item[part];
            }
            *item = toml_edit::value(value);
            settings = Self::parse(&document.to_string(), &place)?;
        }
        settings.check()?;
        Ok(settings)
    }

    fn parse(text: &str, place: &str) -> Result<Self, BadInput> {
        toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| text[..span.start.min(text.len())].lines().count().max(1));
            let line = line.and_then(|line| text.lines().nth(line - 1)).unwrap_or_default().trim();
            let problem = match (place.starts_with("--set"), line) {
                (true, _) | (_, "") => error.message().to_owned(),
                (false, line) => format!("{} (at `{line}`)", error.message()),
            };
            BadInput::new(problem)
                .place(place.to_owned())
                .allowed("the keys and types that `hydrograd train --print-config` shows")
        })
    }

    fn document(&self) -> toml_edit::DocumentMut {
        self.text().parse().unwrap_or_default()
    }

    /// As TOML.
    pub fn text(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// The same with the keys that are absent by default as comments.
    pub fn shown(&self) -> String {
        match self.model.radius {
            Some(_) => self.text(),
            None => self
                .text()
                .replace("[model]\n", "[model]\n# Spacings; without it the data set's own.\n# radius = 1.45\n"),
        }
    }

    fn check(&self) -> Result<(), BadInput> {
        let wrong = |key: &str, value: &dyn std::fmt::Display, allowed: &str| {
            Err(BadInput::new(format!("{key} = {value} is out of range")).allowed(format!("{key} {allowed}")))
        };
        let at_least = [
            ("steps", self.steps as usize, 1),
            ("batch_size", self.batch_size, 1),
            ("log_every", self.log_every as usize, 1),
            ("validate_every", self.validate_every as usize, 1),
            ("store_every", self.store_every as usize, 1),
            ("validation_windows", self.validation_windows, 1),
            ("validation_steps", self.validation_steps, 1),
            ("model.latent", self.model.latent, 1),
            ("model.rounds", self.model.rounds, 1),
            ("model.linears", self.model.linears, 2),
            ("model.embedding", self.model.embedding, 1),
            ("features.frames", self.features.frames, 2),
            ("learning_rate_steps", self.learning_rate_steps as usize, 1),
        ];
        for (key, value, least) in at_least {
            if value < least {
                return wrong(key, &value, &format!(">= {least}"));
            }
        }
        let most = [
            ("model.latent", self.model.latent, 4096),
            ("model.rounds", self.model.rounds, 100),
            ("model.linears", self.model.linears, 8),
            // The rollout's driver shows a model no more.
            ("features.frames", self.features.frames, crate::surrogate::evaluation::rollout::HISTORY),
            ("batch_size", self.batch_size, 4096),
        ];
        for (key, value, most) in most {
            if value > most {
                return wrong(key, &value, &format!("<= {most}"));
            }
        }
        let not_negative = [
            ("noise", self.noise),
            ("temperature_noise", self.temperature_noise),
            ("learning_rate_factor", self.learning_rate_factor),
            ("learning_rate_least", self.learning_rate_least),
            ("weight_decay", self.weight_decay),
            ("clip", self.clip),
            ("temperature_weight", self.temperature_weight),
        ];
        for (key, value) in not_negative {
            if !(value >= 0.0 && value.is_finite()) {
                return wrong(key, &value, ">= 0");
            }
        }
        if !(self.learning_rate > 0.0 && self.learning_rate.is_finite()) {
            return wrong("learning_rate", &self.learning_rate, "> 0");
        }
        if self.learning_rate_factor > 1.0 {
            return wrong("learning_rate_factor", &self.learning_rate_factor, "<= 1: the rate decays");
        }
        if self.learning_rate_least > self.learning_rate {
            let allowed = format!("<= learning_rate, {}", self.learning_rate);
            return wrong("learning_rate_least", &self.learning_rate_least, &allowed);
        }
        if !(0.0..1.0).contains(&self.ema) {
            return wrong("ema", &self.ema, ">= 0 and < 1, such as 0.999");
        }
        if let Some(radius) = self.model.radius {
            if !(radius > 1.0 && radius <= 10.0) {
                return wrong("model.radius", &radius, "> 1 and <= 10 spacings");
            }
        }
        let p = &self.pushforward;
        if p.after.len() != p.unrolls.len() || p.after.len() != p.odds.len() || p.after.first() != Some(&-1) {
            return Err(BadInput::new("pushforward's after, unrolls and odds do not belong together")
                .allowed("three lists of one length, after beginning with -1 and growing, odds > 0")
                .advice("--set pushforward.after=[-1] --set pushforward.unrolls=[0] --set pushforward.odds=[1]"));
        }
        if p.after.windows(2).any(|w| w[1] <= w[0]) {
            return wrong("pushforward.after", &format!("{:?}", p.after), "must grow");
        }
        if p.odds.iter().any(|&odds| !(odds > 0.0 && odds.is_finite())) {
            return wrong("pushforward.odds", &format!("{:?}", p.odds), "must be > 0");
        }
        if p.most() > 20 {
            return wrong("pushforward.unrolls", &format!("{:?}", p.unrolls), "<= 20");
        }
        Ok(())
    }
}
