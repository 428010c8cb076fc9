//! Axes: ranges, round tick values, readable tick labels, and the frame around the data.

use super::drawing::{text_width, Anchor, Color, Drawing, Point};

pub const INK: Color = [40, 40, 40];
const GRID: Color = [226, 226, 226];
const TICK_SIZE: f64 = 15.0;
/// About as many, where nothing else is asked for.
pub const TICKS: usize = 6;
const LABEL_SIZE: f64 = 16.0;

/// One axis: what is mapped where, and the ticks.
#[derive(Clone, Debug)]
pub struct Axis {
    low: f64,
    high: f64,
    log: bool,
    ticks: Vec<(f64, String)>,
}

impl Axis {
    /// A linear axis around all finite values, with a little room at both ends.
    pub fn around(values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = limits(values.into_iter().filter(|v| v.is_finite()));
        // What differs by rounding only is one value: its ticks would need too many digits.
        let differs = high - low > 1e-7 * low.abs().max(high.abs());
        let room = 0.05 * if differs { high - low } else { low.abs().max(1e-3) };
        Self::linear(low - room, high + room)
    }

    /// A logarithmic axis around all positive values, with a little room at both ends.
    pub fn around_log(values: impl IntoIterator<Item = f64>) -> Self {
        let logs = values.into_iter().filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10);
        let (low, high) = limits(logs);
        // Less than a third of a decade would leave no tick.
        let room = (0.05 * (high - low)).max(0.5 * (0.4 - (high - low))).max(0.03);
        let (low, high) = (low - room, high + room);
        Self { low, high, log: true, ticks: log_ticks(low, high) }
    }

    /// A linear axis over exactly this range.
    pub fn linear(low: f64, high: f64) -> Self {
        Self::linear_with(low, high, TICKS)
    }

    /// A linear axis over exactly this range with about `count` ticks.
    pub fn linear_with(low: f64, high: f64, count: usize) -> Self {
        Self { low, high, log: false, ticks: linear_ticks(low, high, count) }
    }

    /// A linear axis with whole numbers only (epochs).
    pub fn whole_numbers(values: impl IntoIterator<Item = f64>) -> Self {
        let mut axis = Self::around(values);
        axis.ticks.retain(|(value, _)| (value - value.round()).abs() < 1e-9);
        // "1", not "1.0", where the others were halves.
        for (value, label) in axis.ticks.iter_mut().filter(|(value, _)| value.abs() < 1e5) {
            *label = plain(value.round(), 0);
        }
        if axis.ticks.is_empty() {
            let middle = (0.5 * (axis.low + axis.high)).round();
            axis.ticks.push((middle, format!("{middle}")));
        }
        axis
    }

    pub fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.log || value > 0.0)
    }

    pub fn ticks(&self) -> &[(f64, String)] {
        &self.ticks
    }

    /// Pixels needed beside the frame for tick labels and axis label.
    pub fn margin(&self) -> f64 {
        (self.label_width() + 42.0).max(110.0)
    }

    /// Width of the widest tick label in pixels.
    fn label_width(&self) -> f64 {
        let widths = self.ticks.iter().map(|(_, label)| text_width(label, TICK_SIZE));
        widths.fold(0.0, f64::max)
    }

    /// Place on the axis: 0 at the low end, 1 at the high end.
    pub fn part(&self, value: f64) -> f64 {
        let value = if self.log { value.log10() } else { value };
        (value - self.low) / (self.high - self.low)
    }
}

/// Smallest and largest value; 0 and 1 if there is none.
fn limits(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.map(|value| (value, value)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0.0, 1.0))
}

/// Multiples of 1, 2 or 5 times a power of ten, at most `count` + 1 or so of them.
fn linear_ticks(low: f64, high: f64, count: usize) -> Vec<(f64, String)> {
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) {
        return vec![(low, plain(low, 3))];
    }
    let rough = span / count as f64;
    let power = rough.log10().floor();
    let decade = 10_f64.powf(power);
    // The nearest of 1, 2, 5, 10; the last one needs a decimal less.
    let (factor, extra) = match rough / decade {
        r if r <= 1.5 => (1.0, 0),
        r if r <= 3.2 => (2.0, 0),
        r if r <= 6.8 => (5.0, 0),
        _ => (10.0, -1),
    };
    let step = factor * decade;
    let decimals = (-(power as i32) + extra).max(0) as usize;
    let largest = low.abs().max(high.abs());
    // Multiples of the step as integers: no 0.020000000001.
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last)
        .map(|multiple| {
            let value = multiple as f64 * step;
            let label = if multiple == 0 {
                "0".to_owned()
            } else if !(1e-3..1e5).contains(&largest) {
                power_of_ten(value)
            } else {
                plain(value, decimals)
            };
            (value, label)
        })
        .collect()
}

/// Whole decades; within few decades also 2 and 5 times them. `low` and `high` are decadic logarithms.
pub fn log_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    // All labels of an axis in the same way.
    let small = low > -3.1 && high < 4.1;
    let stride = (((high - low) / 8.0).ceil() as i32).max(1);
    let factors: &[f64] = if high - low < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let ticks: Vec<_> = (low.floor() as i32..=high.ceil() as i32)
        .filter(|power| power.rem_euclid(stride) == 0)
        .flat_map(|power| factors.iter().map(move |factor| (factor * 10_f64.powi(power), *factor, power)))
        .filter(|(value, ..)| (low - 1e-9..=high + 1e-9).contains(&value.log10()))
        .map(|(value, factor, power)| {
            let label = match factor {
                _ if small => plain(value, (-power).max(0) as usize),
                1.0 => format!("10{}", superscript(power)),
                _ => power_of_ten(value),
            };
            (value, label)
        })
        .collect();
    match ticks.len() {
        // One tick is no scale.
        0 | 1 => linear_ticks(10_f64.powf(low), 10_f64.powf(high), 5),
        _ => ticks,
    }
}

/// Fixed number of decimals, with a true minus sign.
fn plain(value: f64, decimals: usize) -> String {
    format!("{value:.decimals$}").replace('-', "−")
}

/// Such as 2.5·10⁻⁷.
fn power_of_ten(value: f64) -> String {
    let text = format!("{value:.3e}");
    let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
    let digits = digits.trim_end_matches('0').trim_end_matches('.').replace('-', "−");
    let power = superscript(power.parse().unwrap_or(0));
    match digits.as_str() {
        "1" => format!("10{power}"),
        _ => format!("{digits}·10{power}"),
    }
}

fn superscript(number: i32) -> String {
    let digit = |character: char| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(character.to_digit(10)? as usize);
    number.to_string().chars().map(|character| digit(character).unwrap_or('⁻')).collect()
}

/// The rectangle of the data, in pixels, with its two axes.
#[derive(Clone, Debug)]
pub struct PlotArea {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
    pub x: Axis,
    pub y: Axis,
}

impl PlotArea {
    /// True to scale, with so many pixels to a unit.
    pub fn to_scale((left, top): Point, pixels: f64, x: (f64, f64), y: (f64, f64), x_ticks: usize) -> Self {
        let (width, height) = (pixels * (x.1 - x.0), pixels * (y.1 - y.0));
        // Low frames have room for few labels.
        let y_ticks = ((height / 60.0) as usize).clamp(2, 6);
        let (x, y) = (Axis::linear_with(x.0, x.1, x_ticks), Axis::linear_with(y.0, y.1, y_ticks));
        Self { left, top, width, height, x, y }
    }

    pub fn map(&self, (x, y): Point) -> Point {
        (self.left + self.width * self.x.part(x), self.top + self.height * (1.0 - self.y.part(y)))
    }

    /// Data points as lines of pixels, broken where a point cannot be shown (NaN, or 0 on a logarithmic axis).
    pub fn map_lines(&self, points: &[Point]) -> Vec<Vec<Point>> {
        points
            .split(|&(x, y)| !(self.x.shows(x) && self.y.shows(y)))
            .filter(|run| !run.is_empty())
            .map(|run| run.iter().map(|&point| self.map(point)).collect())
            .collect()
    }

    /// Grid, frame, ticks and labels; the data come on top. An empty label is left out.
    pub fn draw(&self, drawing: &mut Drawing, x_label: &str, y_label: &str, y_color: Color) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        for (value, label) in self.x.ticks() {
            let x = self.left + self.width * self.x.part(*value);
            drawing.line(vec![(x, self.top), (x, bottom)], GRID, 1.0);
            drawing.line(vec![(x, bottom), (x, bottom + 5.0)], INK, 1.0);
            if !x_label.is_empty() {
                drawing.text(label, (x, bottom + 8.0), TICK_SIZE, Anchor::Top, INK);
            }
        }
        for (value, label) in self.y.ticks() {
            let y = bottom - self.height * self.y.part(*value);
            drawing.line(vec![(self.left, y), (right, y)], GRID, 1.0);
            drawing.line(vec![(self.left - 5.0, y), (self.left, y)], INK, 1.0);
            drawing.text(label, (self.left - 9.0, y), TICK_SIZE, Anchor::Right, y_color);
        }
        self.outline(drawing);
        let middle = (self.left + 0.5 * self.width, self.top + 0.5 * self.height);
        if !x_label.is_empty() {
            drawing.text(x_label, (middle.0, bottom + 31.0), LABEL_SIZE, Anchor::Top, INK);
        }
        drawing.text(
            y_label,
            (self.left - 26.0 - self.y.label_width(), middle.1),
            LABEL_SIZE,
            Anchor::Upwards,
            y_color,
        );
    }

    /// A second vertical axis on the right.
    pub fn draw_right(&self, drawing: &mut Drawing, axis: &Axis, label: &str, color: Color) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        for (value, label) in axis.ticks() {
            let y = bottom - self.height * axis.part(*value);
            drawing.line(vec![(right, y), (right + 5.0, y)], INK, 1.0);
            drawing.text(label, (right + 9.0, y), TICK_SIZE, Anchor::Left, color);
        }
        let middle = self.top + 0.5 * self.height;
        drawing.text(label, (right + 28.0 + axis.label_width(), middle), LABEL_SIZE, Anchor::Upwards, color);
    }

    pub fn outline(&self, drawing: &mut Drawing) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        let corners = [(self.left, self.top), (right, self.top), (right, bottom), (self.left, bottom)];
        drawing.line([&corners[..], &corners[..1]].concat(), INK, 1.2);
    }
}
