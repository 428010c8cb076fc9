//! Particles over time for a page: few bytes for each, because a browser has to read them as text.
//!
//! A place is two numbers of 16 bits, a share of the picture's width and height; a value is one of 8 bits, a share of its
//! range, which is as many colours as the picture has.

use base64::Engine;
use serde::Serialize;

/// What a page has of all particles, at most, before it is made text (which takes a third more).
const MOST_BYTES: usize = 2_400_000;
/// Frames of each panel, at most.
const MOST_FRAMES: usize = 21;
/// Particles of a frame, at most: beyond these some are left out.
const MOST_PARTICLES: usize = 40_000;

/// Tags of walls whose temperature is set, as the page's script knows them.
const HOT: [u8; 2] = [3, 5];

/// Particles at one time, as they are in files.
#[derive(Debug, Clone, Default)]
pub struct RawFrame {
    pub time: f64,
    pub position: Vec<[f64; 2]>,
    /// 0: fluid, which is coloured by its values.
    pub tag: Vec<u8>,
    /// Of each quantity.
    pub values: Vec<Vec<f64>>,
}

#[derive(Debug, Clone, Default)]
pub struct RawPanel {
    pub title: String,
    pub frames: Vec<RawFrame>,
}

/// What particles are coloured by.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Quantity {
    pub name: String,
    pub unit: String,
    /// The ends of the colours.
    pub low: f64,
    pub high: f64,
}

/// Panels of particles side by side, for one slider over time.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Fields {
    pub quantities: Vec<Quantity>,
    pub panels: Vec<Panel>,
    pub x: (f64, f64),
    pub y: (f64, f64),
    pub diameter: f64,
    pub has_walls: bool,
    /// Whether the temperature of some of them is set.
    pub has_hot: bool,
    pub note: String,
}

/// Frames of one run, encoded.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Panel {
    pub title: String,
    pub frames: Vec<Frame>,
}

/// One of them: base64 of little-endian numbers.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Frame {
    pub time: f64,
    /// x and y of each particle, 16 bits each.
    pub position: String,
    /// Empty: as in the frame before.
    pub tag: String,
    pub values: Vec<String>,
}

impl Fields {
    /// Which of `count` frames of `particles` each a page shows, if it has as many panels: the first and the last among them.
    pub fn chosen(count: usize, particles: usize, panels: usize, quantities: usize) -> Vec<usize> {
        Self::chosen_within(MOST_BYTES, count, particles, panels, quantities)
    }

    /// The same of a page that has so many bytes of them, before they are made text.
    pub fn chosen_within(
        most_bytes: usize,
        count: usize,
        particles: usize,
        panels: usize,
        quantities: usize,
    ) -> Vec<usize> {
        let bytes = particles.clamp(1, MOST_PARTICLES) * (4 + quantities) * panels.max(1);
        let most = (most_bytes / bytes).clamp(2, MOST_FRAMES).min(count);
        match most {
            0 => vec![],
            1 => vec![count - 1],
            _ => (0..most).map(|k| (k * (count - 1)).div_ceil(most - 1)).collect(),
        }
    }

    /// Encodes frames; `quantities` are names and units. None if there is no particle.
    pub fn new(panels: Vec<RawPanel>, quantities: &[(&str, &str)], diameter: f64, mut note: String) -> Option<Self> {
        let frames = || panels.iter().flat_map(|panel| &panel.frames);
        let along = |d: usize| {
            let (low, high) = range(frames().flat_map(|frame| frame.position.iter().map(move |place| place[d])))?;
            Some((low - 0.5 * diameter, high + 0.5 * diameter))
        };
        let (x, y) = (along(0)?, along(1)?);
        let mut quantities: Vec<(usize, Quantity)> = quantities
            .iter()
            .enumerate()
            .map(|(k, (name, unit))| {
                let fluid = frames().flat_map(|frame| {
                    let of_fluid = frame.tag.iter().zip(&frame.values[k]).filter(|(tag, _)| **tag == 0);
                    of_fluid.map(|(_, value)| *value)
                });
                let (low, high) = range(fluid).unwrap_or((0.0, 1.0));
                (k, Quantity { name: name.to_string(), unit: unit.to_string(), low, high })
            })
            .collect();
        // What is the same everywhere has no colours; something has to be shown.
        let is_same = |of: &Quantity| of.high - of.low <= 1e-9 * of.high.abs().max(of.low.abs());
        if quantities.iter().any(|(_, of)| !is_same(of)) {
            quantities.retain(|(_, of)| !is_same(of));
        } else {
            quantities.truncate(1);
        }
        let has = |is_in: fn(&u8) -> bool| frames().any(|frame| frame.tag.iter().any(is_in));
        let (has_walls, has_hot) = (has(|tag| *tag != 0), has(|tag| HOT.contains(tag)));
        let most = frames().map(|frame| frame.tag.len()).max().unwrap_or(0);
        let every = most.div_ceil(MOST_PARTICLES).max(1);
        if every > 1 {
            note.push_str(&format!(" One particle of {every} is shown."));
        }
        let encoded = |panel: &RawPanel| {
            let mut before: &[u8] = &[];
            let mut frames = Vec::new();
            for frame in &panel.frames {
                let kept = || (0..frame.tag.len()).step_by(every);
                let tag = match frame.tag == before {
                    true => String::new(),
                    false => text(kept().map(|i| frame.tag[i]).collect()),
                };
                before = &frame.tag;
                let places = kept().flat_map(|i| {
                    let [at_x, at_y] = frame.position[i];
                    [share(at_x, x, 65535.0) as u16, share(at_y, y, 65535.0) as u16]
                });
                let value = |(k, quantity): &(usize, Quantity)| {
                    let ends = (quantity.low, quantity.high);
                    text(kept().map(|i| share(frame.values[*k][i], ends, 255.0) as u8).collect())
                };
                frames.push(Frame {
                    time: frame.time,
                    position: text(places.flat_map(u16::to_le_bytes).collect()),
                    tag,
                    values: quantities.iter().map(value).collect(),
                });
            }
            Panel { title: panel.title.clone(), frames }
        };
        let panels = panels.iter().map(encoded).collect();
        let quantities = quantities.into_iter().map(|(_, of)| of).collect();
        Some(Self { quantities, panels, x, y, diameter, has_walls, has_hot, note })
    }
}

/// The least and the largest of finite numbers.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |ends: Option<(f64, f64)>, value| {
        Some(ends.map_or((value, value), |(low, high)| (low.min(value), high.max(value))))
    })
}

/// Where a number is between two, from 0 to `most`; what is no number is at the lower end.
fn share(value: f64, (low, high): (f64, f64), most: f64) -> f64 {
    let width = if high > low { high - low } else { 1.0 };
    (most * ((value - low) / width).clamp(0.0, 1.0)).round()
}

fn text(bytes: Vec<u8>) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}
