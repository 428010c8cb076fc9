//! Lines with their names: how the lines of every picture are told apart, and where their names stand.
//!
//! A series has a colour, a marker and a dash of its own, so that each alone is enough: on a grey print, or for a
//! reader who sees few colours. Its name stands where the line ends.

use super::axis::{PlotArea, INK};
use super::drawing::{text_width, Anchor, Color, Drawing, Point};

/// More lines than this in one frame are not told apart.
pub const MOST: usize = 8;

/// Okabe and Ito (2008), "Color Universal Design", without yellow and with dark grey for black; wine is of Tol's
/// "muted" scheme (2021, SRON/EPS/TN/09-002). Dark and light take turns, for prints in grey.
const COLORS: [Color; MOST] = [
    [0, 114, 178],
    [230, 159, 0],
    [213, 94, 0],
    [86, 180, 233],
    [136, 34, 85],
    [0, 158, 115],
    [90, 90, 90],
    [204, 121, 167],
];
/// Lengths of a dash and of the gap behind it, in pixels; the first line has no gaps.
const DASHES: [Option<(f64, f64)>; 4] = [None, Some((8.0, 4.0)), Some((2.5, 3.5)), Some((15.0, 5.0))];
/// For bounds, references and baselines, which have no marker.
pub const THIN: (f64, f64) = (5.0, 4.0);

/// A line of more points than this has its marker at some of them only.
const MOST_MARKERS: usize = 40;
const TEXT_SIZE: f64 = 15.0;
/// Height of a name.
pub const ROW: f64 = 20.0;
/// Length of the piece of line in front of a name that stands beside the frame.
const SAMPLE: f64 = 34.0;

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    pub color: Color,
    pub width: f64,
    pub dash: Option<(f64, f64)>,
    /// Number of the marker's shape.
    pub marker: Option<usize>,
}

impl Look {
    /// The look of series number `index`; it repeats after [`MOST`].
    pub fn series(index: usize) -> Self {
        let k = index % MOST;
        Self { color: COLORS[k], width: 2.0, dash: DASHES[k % DASHES.len()], marker: Some(k) }
    }

    /// A line without marker.
    pub fn plain(color: Color, width: f64, dash: Option<(f64, f64)>) -> Self {
        Self { color, width, dash, marker: None }
    }
}

/// A line in data coordinates; it is broken where a point cannot be shown, and unnamed if the name is empty.
#[derive(Clone, Debug)]
pub struct Line {
    pub name: String,
    pub points: Vec<Point>,
    pub look: Look,
}

impl Line {
    pub fn new(name: impl Into<String>, points: Vec<Point>, look: Look) -> Self {
        Self { name: name.into(), points, look }
    }
}

/// Draws lines in their order and their names on top. A name that stands beside the frame widens the picture.
pub fn draw(drawing: &mut Drawing, frame: &PlotArea, lines: &[Line]) {
    let placed: Vec<Vec<Vec<Point>>> = lines.iter().map(|line| frame.map_lines(&line.points)).collect();
    for (k, (line, runs)) in lines.iter().zip(&placed).enumerate() {
        // Lines of many points have their markers at different places.
        let every = line.points.len().div_ceil(MOST_MARKERS / 4).max(1);
        let (every, first) = if line.points.len() <= MOST_MARKERS { (1, 0) } else { (every, k % MOST * every / MOST) };
        for run in runs {
            stroke(drawing, run, &line.look);
            // A line alone needs none to be told apart.
            if let Some(shape) = line.look.marker.filter(|_| every == 1 || lines.len() > 1) {
                let first = if run.len() == 1 { 0 } else { first };
                run.iter().skip(first).step_by(every).for_each(|&at| marker(drawing, at, shape, line.look.color));
            }
        }
    }
    for label in labels(frame, lines, &placed) {
        let (line, (x, y)) = (&lines[label.line], label.at);
        if label.is_beside {
            let sample = [(x - SAMPLE - 6.0, y), (x - 6.0, y)];
            drawing.line(vec![label.end, sample[0]], line.look.color, 0.8);
            stroke(drawing, &sample, &line.look);
            if let Some(shape) = line.look.marker {
                marker(drawing, (x - 6.0 - 0.5 * SAMPLE, y), shape, line.look.color);
            }
        }
        drawing.text(line.name.as_str(), (x, y), TEXT_SIZE, Anchor::Left, INK);
    }
}

fn stroke(drawing: &mut Drawing, points: &[Point], look: &Look) {
    match look.dash {
        None => drawing.line(points.to_vec(), look.color, look.width),
        Some(dash) => drawing.dashed(points, look.color, look.width, dash),
    }
}

/// Four shapes, filled and then hollow.
fn marker(drawing: &mut Drawing, (x, y): Point, shape: usize, color: Color) {
    let mut draw = |size: f64, color: Color| match shape % 4 {
        0 => drawing.disc((x, y), size, color),
        1 => drawing.rectangle((x - 0.9 * size, y - 0.9 * size), 1.8 * size, 1.8 * size, color, 1.0),
        2 => drawing.area(
            vec![(x, y - 1.3 * size), (x + 1.2 * size, y + 0.9 * size), (x - 1.2 * size, y + 0.9 * size)],
            color,
            1.0,
        ),
        _ => drawing.area(
            vec![(x, y - 1.4 * size), (x + 1.4 * size, y), (x, y + 1.4 * size), (x - 1.4 * size, y)],
            color,
            1.0,
        ),
    };
    draw(4.6, color);
    if shape % MOST >= 4 {
        draw(2.5, [255; 3]);
    }
}

/// Where the name of a line stands: middle of its left edge.
#[derive(Debug)]
pub struct Label {
    pub line: usize,
    /// The rightmost point of the line.
    pub end: Point,
    pub at: Point,
    /// Right of the frame, in a row with others; else in the frame beside the line's end.
    pub is_beside: bool,
}

/// A name stands beside its line's end where nothing is in the way, else right of the frame at that height; there names
/// move apart as little as they must.
pub fn labels(frame: &PlotArea, lines: &[Line], placed: &[Vec<Vec<Point>>]) -> Vec<Label> {
    let widths: Vec<f64> = lines.iter().map(|line| text_width(&line.name, TEXT_SIZE)).collect();
    let mut is_sent: Vec<bool> = vec![false; lines.len()];
    loop {
        let labels = try_labels(frame, lines, placed, &widths, &is_sent);
        // What leads to a name right of the frame may cross one in the frame: then that one goes there, too.
        let leaders: Vec<[Point; 2]> =
            labels.iter().filter(|l| l.is_beside).map(|l| [l.end, (l.at.0 - SAMPLE - 6.0, l.at.1)]).collect();
        let is_crossed = |label: &&Label| {
            leaders.iter().any(|leader| crosses(leader, |at| is_within(label.at, widths[label.line], at)))
        };
        match labels.iter().filter(|label| !label.is_beside).find(is_crossed) {
            Some(label) => is_sent[label.line] = true,
            None => return labels,
        }
    }
}

/// True if a point is where a text of this width stands, or near.
fn is_within((x, y): Point, width: f64, at: Point) -> bool {
    at.0 > x - 6.0 && at.0 < x + width + 6.0 && (at.1 - y).abs() < 0.6 * ROW
}

/// The same of lines of which some have their names right of the frame in any case.
fn try_labels(
    frame: &PlotArea,
    lines: &[Line],
    placed: &[Vec<Vec<Point>>],
    widths: &[f64],
    is_sent: &[bool],
) -> Vec<Label> {
    let (right, bottom) = (frame.left + frame.width, frame.top + frame.height);
    let mut labels: Vec<Label> = vec![];
    for (line, runs) in placed.iter().enumerate().filter(|(line, _)| !lines[*line].name.is_empty()) {
        let Some(&end) = runs.iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        let width = widths[line];
        let is_free = |&(x, y): &Point| {
            let is_taken = |label: &Label| {
                !label.is_beside
                    && (label.at.1 - y).abs() < ROW
                    && label.at.0 < x + width + 6.0
                    && x < label.at.0 + widths[label.line] + 6.0
            };
            x > frame.left + 4.0
                && x + width < right - 4.0
                && (frame.top + 0.5 * ROW..bottom - 0.5 * ROW).contains(&y)
                && !placed.iter().flatten().any(|run| crosses(run, |at| is_within((x, y), width, at)))
                && !labels.iter().any(is_taken)
        };
        let (before, behind, middle) = (end.0 - 13.0 - width, end.0 + 13.0, end.0 - 0.5 * width);
        let places = [(behind, 0.0), (behind, -14.0), (behind, 14.0), (before, 0.0), (middle, 20.0), (middle, -20.0)];
        let places = places.map(|(x, down)| (x, end.1 + down));
        let place = places.into_iter().find(is_free).filter(|_| !is_sent[line]);
        let at = place.unwrap_or((right + SAMPLE + 24.0, end.1));
        labels.push(Label { line, end, at, is_beside: place.is_none() });
    }
    let mut column: Vec<&mut Label> = labels.iter_mut().filter(|label| label.is_beside).collect();
    column.sort_by(|a, b| a.end.1.total_cmp(&b.end.1));
    let heights = apart(&column.iter().map(|label| label.end.1).collect::<Vec<_>>(), (frame.top, bottom));
    column.iter_mut().zip(heights).for_each(|(label, y)| label.at.1 = y);
    labels
}

/// True if a line comes by a place for which `is_in` holds.
fn crosses(run: &[Point], is_in: impl Fn(Point) -> bool) -> bool {
    const STEP: f64 = 3.0;
    run.first().is_some_and(|&first| is_in(first))
        || run.windows(2).any(|pair| {
            let (from, to) = (pair[0], pair[1]);
            let pieces = ((to.0 - from.0).hypot(to.1 - from.1) / STEP).ceil().max(1.0);
            (1..=pieces as usize)
                .map(|k| k as f64 / pieces)
                .any(|part| is_in((from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1))))
        })
}

/// Ascending heights moved by as little as puts them a row apart (least squares, by pooling neighbours), within limits.
pub fn apart(heights: &[f64], (low, high): (f64, f64)) -> Vec<f64> {
    // Less a row each, heights need only not descend; pools hold a sum and a count.
    let mut pools: Vec<(f64, f64)> = vec![];
    for (k, height) in heights.iter().enumerate() {
        pools.push((height - k as f64 * ROW, 1.0));
        while let [.., before, last] = pools[..] {
            if before.0 / before.1 <= last.0 / last.1 {
                break;
            }
            pools.truncate(pools.len() - 2);
            pools.push((before.0 + last.0, before.1 + last.1));
        }
    }
    let means = pools.iter().flat_map(|&(sum, count)| std::iter::repeat_n(sum / count, count as usize));
    let high = high - (heights.len() as f64 - 1.0) * ROW;
    means.enumerate().map(|(k, mean)| mean.min(high).max(low) + k as f64 * ROW).collect()
}
