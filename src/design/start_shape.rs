//! The wall shape that a configuration specifies: an array, a file or a named shape.

use std::f64::consts::TAU;
use std::path::Path;

use rand_chacha::rand_core::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::scene::{Config, Family, ShapeName};
use crate::design::parametrisations::{Parametrisation, SplineSurface};
use crate::design::shape::{default_nodes, read_columns, read_surface, Shape, ROUGH};
use crate::error::BadInput;
use crate::numerics::random::uniform;

/// The random shape has its own stream of the run's generator, which is independent of the jitter and others.
pub const RANDOM_SHAPE_STREAM: u64 = 1;

impl Shape {
    /// The initial shape of a configuration, checked against `design.bound` as well.
    ///
    /// `design.offsets` and `design.file` take precedence over `design.shape`. Named shapes are functions of
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
        // The user wrote the name of the shape, not its offsets.
        shape.map_err(|bad| match is_named && bad.is_about("design.offsets") {
            true => bad.key("design.shape"),
            false => bad,
        })
    }

    /// The [sharpest turn](Self::sharpest_turn) of a configuration's wall where it is so rough that moving particles with the usual
    /// smoothing length diverge over it; none where particles or walls are of other kinds, and of a configuration that the checks refuse.
    pub fn rough_turn(config: &Config) -> Option<f64> {
        let (facts, dx) = (config.method.facts(), config.resolution.dx);
        let channel = &config.channel;
        let is_inside =
            0.0 <= channel.hot_from && channel.hot_from <= channel.hot_to && channel.hot_to <= channel.length;
        let is_resolvable = is_inside && dx > 0.0 && channel.length / dx < 1e5;
        if config.scene != Family::HeatedChannel || !facts.moves || facts.wall_cells || !is_resolvable {
            return None;
        }
        Some(Self::from_config(config).ok()?.sharpest_turn(dx)).filter(|turn| *turn > ROUGH)
    }
}

/// The initial control points of a wall over x and z: those of `design.offsets`, those whose wall is nearest to the
/// heights of `design.file`, or the values of `design.shape` there, times cos(2 pi q z/span) with q =
/// `design.periods_across` except for `random`.
///
/// # Errors
/// Numbers that are too many or too few, not finite or out of bounds; a file that can not be read.
pub fn control_points(config: &Config, surface: &SplineSurface) -> Result<Vec<f64>, BadInput> {
    let (design, span) = (&config.design, config.channel.span);
    let (offsets, key) = match (&design.offsets, &design.file) {
        (Some(offsets), _) => (offsets.clone(), "design.offsets"),
        (None, Some(file)) => {
            let read = read_surface(Path::new(file))?;
            let across = read.across.unwrap_or_default();
            if let Some(k) = read.offsets.iter().position(|height| height.abs() > design.bound * (1.0 + 1e-9)) {
                let place = format!("x = {}, z = {}", read.nodes[k], across[k]);
                return Err(BadInput::new(format!("the height {} at {place} is out of bounds", read.offsets[k]))
                    .place(file)
                    .key("design.file")
                    .allowed(format!("-{0} ... {0} (design.bound)", design.bound))
                    .advice("a larger design.bound"));
            }
            (surface.fitted(&read.nodes, &across, &read.offsets), "design.file")
        }
        (None, None) => {
            let mut named = named(config, surface.positions());
            if design.shape != ShapeName::Random {
                let factor = |z: f64| (TAU * design.periods_across as f64 * z / span).cos();
                named
                    .iter_mut()
                    .zip(surface.across().unwrap_or_default())
                    .for_each(|(offset, z)| *offset *= factor(*z));
            }
            (named, "design.shape")
        }
    };
    if offsets.len() != surface.variables() {
        let (along, across) = (design.control_points, design.control_points_across);
        return Err(BadInput::new(format!("design.offsets has {} numbers", offsets.len()))
            .key("design.offsets")
            .allowed(format!(
                "{}, one for each of design.control_points = {along} times design.control_points_across = {across}",
                surface.variables()
            )));
    }
    surface.check(&offsets).map_err(|bad| bad.key(key))?;
    Ok(offsets)
}

/// The offset of a named shape at s, with a number of periods; 0 for the random one.
pub fn height(shape: ShapeName, amplitude: f64, periods: f64, s: f64) -> f64 {
    let phase = TAU * periods * s;
    match shape {
        ShapeName::Flat | ShapeName::Random => 0.0,
        ShapeName::Uniform => amplitude,
        ShapeName::Sine => amplitude * phase.sin(),
        ShapeName::Cosine => amplitude * phase.cos(),
        ShapeName::Linear => amplitude * (2.0 * s - 1.0),
    }
}

/// The offsets of `design.shape` at the nodes.
fn named(config: &Config, nodes: &[f64]) -> Vec<f64> {
    let (design, channel) = (&config.design, &config.channel);
    let mut random = ChaCha8Rng::seed_from_u64(config.run.seed);
    random.set_stream(RANDOM_SHAPE_STREAM);
    let at = |x: &f64| match design.shape {
        ShapeName::Random => design.amplitude * (2.0 * uniform(&mut random) - 1.0),
        shape => {
            let s = (x - channel.hot_from) / (channel.hot_to - channel.hot_from);
            height(shape, design.amplitude, design.periods, s)
        }
    };
    nodes.iter().map(at).collect()
}
