//! The wall shape that a configuration asks for: an array, a file, or a named shape.

use std::f64::consts::TAU;
use std::path::Path;

use rand_chacha::rand_core::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::scene::{Config, ShapeName};
use crate::design::shape::{default_nodes, read_columns, Shape};
use crate::error::BadInput;
use crate::numerics::random::uniform;

/// The random shape's own stream of the run's generator: the jitter and others do not move it.
pub const RANDOM_SHAPE_STREAM: u64 = 1;

impl Shape {
    /// The start shape of a configuration, checked against `design.bound` as well.
    ///
    /// `design.offsets` or `design.file` win over `design.shape`. Named shapes are functions of
    /// s = (x - hot_from) / (hot_to - hot_from): A, A sin(2 pi k s), A cos(2 pi k s), A (2 s - 1), or for
    /// `random` A times a number uniform in -1 ... 1 at each node, from `run.seed`.
    pub fn from_config(config: &Config) -> Result<Self, BadInput> {
        let (design, channel) = (&config.design, &config.channel);
        let (mut nodes, mut offsets) = (design.nodes.clone(), design.offsets.clone());
        if let Some(file) = &design.file {
            if nodes.is_some() || offsets.is_some() {
                return Err(BadInput::new("design.file is given together with design.nodes or design.offsets")
                    .key("design.file")
                    .allowed("one of them: the file has both columns"));
            }
            let columns = read_columns(Path::new(file))?;
            (nodes, offsets) = (Some(columns.nodes), Some(columns.offsets));
        }
        let nodes = nodes.unwrap_or_else(|| default_nodes(channel.hot_from, channel.hot_to, config.resolution.dx));
        let is_named = offsets.is_none();
        let offsets = offsets.unwrap_or_else(|| named(config, &nodes));
        let shape = Self::new(nodes, offsets, channel.hot_from, channel.hot_to).and_then(|shape| {
            let shape = shape.with_top(design.top_offsets.clone())?;
            shape.check_bound(design.bound)?;
            Ok(shape)
        });
        // The offsets of a named shape were not written by the user: its name was.
        shape.map_err(|bad| match is_named && bad.is_about("design.offsets") {
            true => bad.key("design.shape"),
            false => bad,
        })
    }
}

/// Offsets of `design.shape` at the nodes.
fn named(config: &Config, nodes: &[f64]) -> Vec<f64> {
    let (design, channel) = (&config.design, &config.channel);
    let amplitude = design.amplitude;
    let mut random = ChaCha8Rng::seed_from_u64(config.run.seed);
    random.set_stream(RANDOM_SHAPE_STREAM);
    nodes
        .iter()
        .map(|x| {
            let s = (x - channel.hot_from) / (channel.hot_to - channel.hot_from);
            let phase = TAU * design.periods * s;
            match design.shape {
                ShapeName::Flat => 0.0,
                ShapeName::Uniform => amplitude,
                ShapeName::Sine => amplitude * phase.sin(),
                ShapeName::Cosine => amplitude * phase.cos(),
                ShapeName::Linear => amplitude * (2.0 * s - 1.0),
                ShapeName::Random => amplitude * (2.0 * uniform(&mut random) - 1.0),
            }
        })
        .collect()
}
