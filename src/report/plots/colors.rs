//! Colours for numbers: a perceptually even map for temperature, shades for lines in an order.

use super::drawing::Color;

/// Seventeen samples of matplotlib's "plasma" (CC0, by Nathaniel Smith and Stéfan van der Walt). Its bright end is
/// left out: pale yellow vanishes on white.
const PLASMA: [Color; 17] = [
    [13, 8, 135],
    [49, 5, 151],
    [76, 2, 161],
    [102, 0, 167],
    [126, 3, 168],
    [149, 17, 161],
    [170, 35, 149],
    [188, 53, 135],
    [204, 71, 120],
    [218, 90, 106],
    [230, 108, 92],
    [240, 128, 78],
    [248, 149, 64],
    [253, 172, 51],
    [253, 197, 39],
    [248, 223, 37],
    [240, 249, 33],
];

/// Colour of a value between 0 (cold) and 1 (hot); values outside are cut, NaN is green to be seen.
pub fn heat(part: f64) -> Color {
    match part.is_nan() {
        true => [0, 200, 0],
        false => between(&PLASMA[..16], part),
    }
}

/// Colour of a value between -1 (blue), 0 (white) and 1 (red).
pub fn signed(value: f64) -> Color {
    match value.is_nan() {
        true => [0, 200, 0],
        false => between(
            &[
                [5, 48, 97],
                [67, 147, 195],
                [209, 229, 240],
                [250, 250, 250],
                [253, 219, 199],
                [214, 96, 77],
                [103, 0, 31],
            ],
            0.5 * (value + 1.0),
        ),
    }
}

/// From light (0) to dark (1) blue, for lines in an order.
pub fn shade(part: f64) -> Color {
    between(&[[196, 218, 238], [120, 174, 214], [42, 110, 180], [8, 38, 96]], part)
}

fn between(stops: &[Color], part: f64) -> Color {
    let place = part.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let index = (place as usize).min(stops.len() - 2);
    let (from, to, part) = (stops[index], stops[index + 1], place - index as f64);
    std::array::from_fn(|channel| {
        let (from, to) = (f64::from(from[channel]), f64::from(to[channel]));
        (from + part * (to - from)).round() as u8
    })
}
