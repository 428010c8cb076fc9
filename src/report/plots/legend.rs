//! Legends: one entry under the other, beside the data.

use super::axis::INK;
use super::drawing::{text_width, Anchor, Color, Drawing, Point};

const TEXT_SIZE: f64 = 14.0;
const ROW: f64 = 24.0;
const SAMPLE: f64 = 30.0;
const GAP: f64 = 10.0;

/// The sample in front of the text.
#[derive(Clone, Copy, Debug)]
pub enum Sample {
    Line {
        width: f64,
    },
    Dashed,
    /// A line with the marker of series number `0`.
    Marked(usize),
    Disc {
        outline: Option<Color>,
    },
}

/// One line of a legend.
#[derive(Clone, Debug)]
pub struct Entry {
    pub text: String,
    pub color: Color,
    pub sample: Sample,
}

/// Width that the entries need, in pixels.
pub fn width(entries: &[Entry]) -> f64 {
    let widest = entries.iter().map(|entry| text_width(&entry.text, TEXT_SIZE)).fold(0.0, f64::max);
    SAMPLE + GAP + widest
}

/// Height that the entries need, in pixels.
pub fn height(entries: &[Entry]) -> f64 {
    ROW * entries.len() as f64
}

/// Draws the entries downwards from the upper left corner.
pub fn draw(drawing: &mut Drawing, (left, top): Point, entries: &[Entry]) {
    for (index, entry) in entries.iter().enumerate() {
        let y = top + ROW * (index as f64 + 0.5);
        let line = [(left, y), (left + SAMPLE, y)];
        let middle = (left + 0.5 * SAMPLE, y);
        match entry.sample {
            Sample::Line { width } => drawing.line(line.to_vec(), entry.color, width),
            Sample::Dashed => drawing.dashed(&line, entry.color, 1.8, (7.0, 4.5)),
            Sample::Marked(series) => {
                drawing.line(line.to_vec(), entry.color, 2.0);
                marker(drawing, middle, series, entry.color);
            }
            Sample::Disc { outline } => {
                if let Some(outline) = outline {
                    drawing.disc(middle, 8.5, outline);
                }
                drawing.disc(middle, 7.0, entry.color);
            }
        }
        drawing.text(&entry.text, (left + SAMPLE + GAP, y), TEXT_SIZE, Anchor::Left, INK);
    }
}

/// The marker of a series: filled or hollow disc or square, so that more than seven series stay distinct.
pub fn marker(drawing: &mut Drawing, (x, y): Point, series: usize, color: Color) {
    const WHITE: Color = [255; 3];
    let mut square = |half: f64, color| drawing.rectangle((x - half, y - half), 2.0 * half, 2.0 * half, color, 1.0);
    match series % 4 {
        0 => drawing.disc((x, y), 4.0, color),
        1 => square(3.8, color),
        2 => {
            drawing.disc((x, y), 4.5, color);
            drawing.disc((x, y), 2.7, WHITE);
        }
        _ => {
            square(4.2, color);
            square(2.4, WHITE);
        }
    }
}
