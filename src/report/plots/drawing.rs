//! A picture as a list of shapes in pixels, and its way into PNG and SVG through plotters.

use crate::io::atomic::{write_bytes_atomically, write_path_atomically};
use crate::io::FileError;
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Polygon, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, FontTransform, IntoFont, RGBAColor, ShapeStyle, TextStyle};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Red, green, blue.
pub type Color = [u8; 3];
/// Pixels to the right and down from the upper left corner.
pub type Point = (f64, f64);

/// The paths of a picture's PNG and SVG.
pub type Saved = Result<[PathBuf; 2], FileError>;

/// Pixels of the PNG per nominal pixel.
const PNG_SCALE: usize = 2;
/// The PNG is drawn this much larger and averaged: plotters does not smooth the edges of areas and thick lines.
const SMOOTHING: usize = 2;
/// plotters has whole pixels only: both formats are drawn on this finer grid.
const FINE: usize = PNG_SCALE * SMOOTHING;

/// plotters' bitmaps centre texts too high by this part of their size (its SVGs do not).
const PNG_TEXT_DROP: f64 = 0.13;

/// Where a text stands relative to its point.
#[derive(Clone, Copy, Debug)]
pub enum Anchor {
    /// The point is in the middle of the left edge.
    Left,
    /// The point is in the middle of the right edge.
    Right,
    /// The point is in the middle of the upper edge.
    Top,
    /// The point is the middle; the text reads upwards.
    Upwards,
}

/// What a picture is made of.
#[derive(Clone, Debug)]
pub enum Shape {
    Line { points: Vec<Point>, color: Color, width: f64 },
    Area { points: Vec<Point>, color: Color, opacity: f64 },
    Disc { centre: Point, radius: f64, color: Color },
    Label { text: String, at: Point, size: f64, anchor: Anchor, color: Color },
}

/// Shapes in the order in which they are drawn, on a white ground.
#[derive(Clone, Debug)]
pub struct Drawing {
    width: f64,
    height: f64,
    pub shapes: Vec<Shape>,
}

impl Drawing {
    /// An empty picture of this many nominal pixels.
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    pub fn line(&mut self, points: Vec<Point>, color: Color, width: f64) {
        self.shapes.push(Shape::Line { points, color, width });
    }

    /// A line of dashes with gaps, given as lengths in pixels.
    pub fn dashed(&mut self, points: &[Point], color: Color, width: f64, (dash, gap): (f64, f64)) {
        let mut drawn = true;
        let mut left = dash;
        let mut piece = Vec::new();
        for pair in points.windows(2) {
            let (start, end) = (pair[0], pair[1]);
            let length = (end.0 - start.0).hypot(end.1 - start.1);
            let at = |s: f64| {
                let part = if length > 0.0 { s / length } else { 0.0 };
                (start.0 + part * (end.0 - start.0), start.1 + part * (end.1 - start.1))
            };
            let mut position = 0.0;
            while position < length {
                if drawn {
                    piece.push(at(position));
                }
                let step = left.min(length - position);
                position += step;
                left -= step;
                if drawn {
                    piece.push(at(position));
                }
                if left <= 0.0 {
                    if drawn {
                        self.line(std::mem::take(&mut piece), color, width);
                    }
                    drawn = !drawn;
                    left = if drawn { dash } else { gap };
                }
            }
        }
        if piece.len() > 1 {
            self.line(piece, color, width);
        }
    }

    pub fn rectangle(&mut self, (left, top): Point, width: f64, height: f64, color: Color, opacity: f64) {
        let (right, bottom) = (left + width, top + height);
        self.area(vec![(left, top), (right, top), (right, bottom), (left, bottom)], color, opacity);
    }

    pub fn area(&mut self, points: Vec<Point>, color: Color, opacity: f64) {
        self.shapes.push(Shape::Area { points, color, opacity });
    }

    pub fn disc(&mut self, centre: Point, radius: f64, color: Color) {
        self.shapes.push(Shape::Disc { centre, radius, color });
    }

    /// A text; one that begins at its point and would end beyond the right edge widens the picture.
    pub fn text(&mut self, text: impl Into<String>, at: Point, size: f64, anchor: Anchor, color: Color) {
        let text = text.into();
        if matches!(anchor, Anchor::Left) {
            self.width = self.width.max(at.0 + text_width(&text, size) + 20.0);
        }
        self.shapes.push(Shape::Label { text, at, size, anchor, color });
    }

    /// Writes `<stem>.png` and `<stem>.svg` (both atomically) and returns their paths.
    pub fn save(&self, stem: &Path) -> Saved {
        register_font();
        let png = with_ending(stem, ".png");
        let svg = with_ending(stem, ".svg");
        write_path_atomically(&png, |temporary| self.write_png(&png, temporary))?;
        write_bytes_atomically(&svg, self.to_svg(&svg)?.as_bytes())?;
        Ok([png, svg])
    }

    /// Width and height on the fine grid.
    fn fine_size(&self) -> (u32, u32) {
        let fine = |length: f64| (length.round() as u32).max(1) * FINE as u32;
        (fine(self.width), fine(self.height))
    }

    fn write_png(&self, path: &Path, temporary: &Path) -> Result<(), FileError> {
        let (width, height) = self.fine_size();
        let mut pixels = vec![255_u8; 3 * width as usize * height as usize];
        {
            let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
            self.draw(&area, PNG_TEXT_DROP).map_err(|error| plot_error(path, error))?;
        }
        let smooth = averaged(&pixels, width as usize);
        let size = (width / SMOOTHING as u32, height / SMOOTHING as u32);
        let mut encoder = BitMapBackend::new(temporary, size);
        encoder
            .blit_bitmap((0, 0), size, &smooth)
            .and_then(|()| encoder.present())
            .map_err(|error| plot_error(path, error))
    }

    fn to_svg(&self, path: &Path) -> Result<String, FileError> {
        let (width, height) = self.fine_size();
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
            self.draw(&area, 0.0).map_err(|error| plot_error(path, error))?;
        }
        // Keep the fine grid inside, show it at nominal size.
        let fine = format!("width=\"{width}\" height=\"{height}\" viewBox");
        let fine_count = FINE as u32;
        let nominal = format!("width=\"{}\" height=\"{}\" viewBox", width / fine_count, height / fine_count);
        Ok(text.replacen(&fine, &nominal, 1))
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, text_drop: f64) -> Drawn<B> {
        area.fill(&plotters::style::WHITE)?;
        self.shapes.iter().try_for_each(|shape| draw_shape(area, shape, text_drop))?;
        area.present()
    }
}

/// Width of a text in pixels.
pub fn text_width(text: &str, size: f64) -> f64 {
    register_font();
    // Measured large, because the result is in whole pixels. Should the font fail, guess: drawing will tell.
    match ("sans-serif", 100.0).into_font().box_size(text) {
        Ok((width, _)) => f64::from(width) * size / 100.0,
        Err(_) => 0.6 * size * text.chars().count() as f64,
    }
}

/// The font travels with the program: no system font is needed, and pictures are the same everywhere.
fn register_font() {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        let bytes = include_bytes!("../../../data/fonts/DejaVuSans.ttf");
        // Fails only for a damaged font; drawing then reports that the font is missing.
        let _ = plotters::style::register_font("sans-serif", FontStyle::Normal, bytes);
    });
}

fn plot_error(path: &Path, error: impl std::fmt::Display) -> FileError {
    FileError::Plot {
        path: path.to_owned(),
        what: error.to_string(),
        hint: "check the disk; the data themselves are in the CSV and state files",
    }
}

/// `stem` with an ending added; a dot inside the stem (`run_0.02`) is kept.
fn with_ending(stem: &Path, ending: &str) -> PathBuf {
    let mut name = stem.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// Mean over squares of SMOOTHING x SMOOTHING pixels.
pub fn averaged(pixels: &[u8], width: usize) -> Vec<u8> {
    let row = 3 * width;
    let mut smooth = Vec::with_capacity(pixels.len() / (SMOOTHING * SMOOTHING));
    let mut columns = vec![0_u16; row];
    for rows in pixels.chunks_exact(row * SMOOTHING) {
        columns.fill(0);
        for one in rows.chunks_exact(row) {
            columns.iter_mut().zip(one).for_each(|(sum, &value)| *sum += u16::from(value));
        }
        for square in columns.chunks_exact(3 * SMOOTHING) {
            for channel in 0..3 {
                let sum: u16 = (0..SMOOTHING).map(|dx| square[3 * dx + channel]).sum();
                smooth.push((sum / (SMOOTHING * SMOOTHING) as u16) as u8);
            }
        }
    }
    smooth
}

/// Nearest point of the fine grid. Coordinates far outside are cut: pixels are i32.
fn fine_point((x, y): Point) -> (i32, i32) {
    let fine = |v: f64| (v * FINE as f64).round().clamp(-1e6, 1e6) as i32;
    (fine(x), fine(y))
}

type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

fn draw_shape<B: DrawingBackend>(area: &DrawingArea<B, Shift>, shape: &Shape, text_drop: f64) -> Drawn<B> {
    let scale = FINE as f64;
    let paint = |[red, green, blue]: Color, opacity: f64| RGBAColor(red, green, blue, opacity);
    match shape {
        Shape::Line { points, color, width } => {
            let style = ShapeStyle {
                color: paint(*color, 1.0),
                filled: false,
                stroke_width: (width * scale).round().max(1.0) as u32,
            };
            let mut points: Vec<(i32, i32)> = points.iter().copied().map(fine_point).collect();
            // plotters' joints fail on segments of zero length.
            points.dedup();
            if points.len() < 2 {
                return Ok(());
            }
            area.draw(&PathElement::new(points, style))
        }
        Shape::Area { points, color, opacity } => {
            let points: Vec<(i32, i32)> = points.iter().copied().map(fine_point).collect();
            area.draw(&Polygon::new(points, ShapeStyle::from(paint(*color, *opacity)).filled()))
        }
        Shape::Disc { centre, radius, color } => {
            let radius = (radius * scale).round().max(1.0) as i32;
            let style = ShapeStyle::from(paint(*color, 1.0)).filled();
            area.draw(&Circle::new(fine_point(*centre), radius, style))
        }
        Shape::Label { text, at, size, anchor, color } => {
            let drop = text_drop * size;
            let (horizontal, vertical, at) = match anchor {
                Anchor::Left => (HPos::Left, VPos::Center, (at.0, at.1 + drop)),
                Anchor::Right => (HPos::Right, VPos::Center, (at.0, at.1 + drop)),
                Anchor::Upwards => (HPos::Center, VPos::Center, (at.0 + drop, at.1)),
                Anchor::Top => (HPos::Center, VPos::Top, *at),
            };
            let mut font = ("sans-serif", size * scale).into_font();
            if matches!(anchor, Anchor::Upwards) {
                font = font.transform(FontTransform::Rotate270);
            }
            let color = paint(*color, 1.0);
            let style = TextStyle::from(font).color(&color).pos(Pos::new(horizontal, vertical));
            area.draw(&Text::new(text.as_str(), fine_point(at), style))
        }
    }
}
