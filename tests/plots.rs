//! The parts of pictures: axes, colours, lines and their names.

use hydrograd::report::plots::axis::{log_ticks, Axis, PlotArea};
use hydrograd::report::plots::colors::heat;
use hydrograd::report::plots::drawing::{averaged, text_width, Color, Drawing, Point, Shape};
use hydrograd::report::plots::lines::{apart, labels, Line, Look, MOST, ROW};
use hydrograd::report::plots::{fields, history, Field, FieldPanel, HistoryPoint};

/// The ticks of an axis over this range.
fn linear(low: f64, high: f64, count: usize) -> Vec<(f64, String)> {
    Axis::linear_with(low, high, count).ticks().to_vec()
}

fn texts(ticks: &[(f64, String)]) -> Vec<&str> {
    ticks.iter().map(|(_, label)| label.as_str()).collect()
}

#[test]
fn tick_labels_are_round() {
    assert_eq!(texts(&linear(-0.021, 0.021, 6)), ["−0.02", "−0.01", "0", "0.01", "0.02"]);
    assert_eq!(texts(&linear(0.0, 1.0, 6)), ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
    assert_eq!(texts(&linear(0.0, 47.0, 6)), ["0", "10", "20", "30", "40"]);
    assert_eq!(texts(&linear(0.0, 4e-7, 4)), ["0", "10⁻⁷", "2·10⁻⁷", "3·10⁻⁷", "4·10⁻⁷"]);
    assert_eq!(texts(&linear(1.0, 1.0, 6)), ["1.000"]);
}

#[test]
fn logarithmic_ticks_are_decades() {
    assert_eq!(texts(&log_ticks(-4.1, 0.1)), ["10⁻⁴", "10⁻³", "10⁻²", "10⁻¹", "10⁰"]);
    assert_eq!(texts(&log_ticks(0.2, 1.1)), ["2", "5", "10"]);
    assert!(texts(&log_ticks(-16.0, 0.0)).len() <= 9);
    assert!(!Axis::around_log([3.0, 3.1]).ticks().is_empty());
    assert!(!Axis::around_log([3.0]).ticks().is_empty());
}

#[test]
fn ranges_of_axes_survive_poor_data() {
    for values in [vec![], vec![f64::NAN], vec![0.0], vec![5.0, 5.0], vec![f64::INFINITY, 2.0], vec![0.3, 0.1 + 0.2]] {
        let axis = Axis::around(values.clone());
        let span = 1.0 / (axis.part(1.0) - axis.part(0.0));
        assert!(span > 0.0 && span.is_finite() && axis.part(0.0).is_finite(), "{values:?}");
        assert!(!axis.ticks().is_empty() && axis.ticks().len() < 20, "{values:?} {axis:?}");
    }
    assert!(!Axis::around_log([]).ticks().is_empty());
    assert!(!Axis::around_log([0.0, -1.0]).ticks().is_empty());
}

#[test]
fn fields_are_drawn_without_what_is_in_walls() {
    let folder = tempfile::tempdir().unwrap();
    let stem = folder.path().join("field");
    // A value in each quarter, and nothing in the last.
    let field = Field { cells: [2, 2], corners: [[0.0, 0.0], [2.0, 1.0]], values: vec![-1.0, 0.0, 3.0, f64::NAN] };
    assert_eq!(field.range(), (-1.0, 3.0));
    let walls = [vec![[1.0, 0.5], [5.0, 0.5], [5.0, 5.0], [1.0, 5.0]]];
    let lines = [vec![[0.1, 0.1], [0.5, 0.2], [1.0, 0.2]]];
    let panel = FieldPanel { title: "one", field: &field, streamlines: &lines, walls: &walls };
    let [png, svg] = fields(&stem, "value", &[panel], (-1.0, 3.0), false).unwrap();
    assert!(png.exists());
    let text = std::fs::read_to_string(&svg).unwrap();
    let color = |part: f64| {
        let [r, g, b] = heat(part);
        format!("#{r:02X}{g:02X}{b:02X}")
    };
    // The middles of the bands.
    for part in [0.5 / 24.0, 6.5 / 24.0, 23.5 / 24.0] {
        assert!(text.contains(&color(part)), "{}", color(part));
    }
    // Walls do not leave the frame, whose right end is at 110 + 900 nominal pixels.
    let numbers = text.split("polygon").flat_map(|part| part.split('"')).filter(|part| part.contains(','));
    let most =
        numbers.flat_map(|part| part.split([' ', ','])).filter_map(|x| x.parse::<f64>().ok()).fold(0.0, f64::max);
    assert!(most < 4.0 * 1200.0, "{most}");
    let short = Field { values: vec![1.0], ..field.clone() };
    for (panels, range) in
        [(vec![], (0.0, 1.0)), (vec![FieldPanel { field: &short, ..panel }], (0.0, 1.0)), (vec![panel], (1.0, 1.0))]
    {
        assert!(fields(&stem, "value", &panels, range, true).is_err());
    }
}

#[test]
fn long_labels_get_a_wide_margin() {
    assert_eq!(Axis::linear(0.0, 1.0).margin(), 110.0);
    assert!(Axis::linear(0.041_200_00, 0.041_200_02).margin() > 115.0);
}

#[test]
fn data_map_to_the_frame() {
    let frame = PlotArea {
        left: 10.0,
        top: 20.0,
        width: 100.0,
        height: 50.0,
        x: Axis::linear(0.0, 2.0),
        y: Axis::linear(0.0, 1.0),
    };
    assert_eq!(frame.map((0.0, 0.0)), (10.0, 70.0));
    assert_eq!(frame.map((2.0, 1.0)), (110.0, 20.0));
    let lines = frame.map_lines(&[(0.0, 0.0), (1.0, f64::NAN), (2.0, 0.0), (2.0, 1.0)]);
    assert_eq!(lines.iter().map(Vec::len).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn heat_gets_lighter_and_stays_in_range() {
    let lightness =
        |[red, green, blue]: Color| 0.2126 * f64::from(red) + 0.7152 * f64::from(green) + 0.0722 * f64::from(blue);
    let shades: Vec<f64> = (0..=20).map(|i| lightness(heat(f64::from(i) / 20.0))).collect();
    assert!(shades.windows(2).all(|pair| pair[1] > pair[0]), "{shades:?}");
    assert_eq!(heat(-3.0), heat(0.0));
    // The brightest but one of plasma's seventeen colours.
    assert_eq!(heat(9.0), [248, 223, 37]);
    assert_ne!(heat(f64::NAN), heat(0.0));
}

#[test]
fn dashes_cover_their_share_of_the_line() {
    let mut drawing = Drawing::new(100.0, 100.0);
    drawing.dashed(&[(0.0, 0.0), (30.0, 0.0), (30.0, 70.0)], [0; 3], 1.0, (6.0, 4.0));
    let length: f64 = drawing
        .shapes
        .iter()
        .map(|shape| match shape {
            Shape::Line { points, .. } => {
                points.windows(2).map(|pair| (pair[1].0 - pair[0].0).hypot(pair[1].1 - pair[0].1)).sum()
            }
            _ => 0.0,
        })
        .sum();
    assert_eq!(drawing.shapes.len(), 10);
    assert!((length - 60.0).abs() < 1e-9, "{length}");
}

#[test]
fn averaging_takes_the_mean_of_squares() {
    // One square: 0, 4 / 8, 8 in red; the other channels are 0.
    let pixels = [0, 0, 0, 4, 0, 0, 8, 0, 0, 8, 0, 0];
    assert_eq!(averaged(&pixels, 2), [5, 0, 0]);
}

#[test]
fn a_dot_in_the_name_of_a_picture_stays() {
    let folder = tempfile::tempdir().unwrap();
    let stem = folder.path().join("dx_0.02");
    let files = Drawing::new(10.0, 10.0).save(&stem).unwrap();
    assert_eq!(files, [".png", ".svg"].map(|ending| folder.path().join(format!("dx_0.02{ending}"))));
    assert!(files.iter().all(|file| file.is_file()));
}

#[test]
fn the_embedded_font_measures() {
    let width = text_width("mmmm", 20.0);
    assert!(text_width("ii", 20.0) < width && width > 40.0 && width < 120.0, "{width}");
}

/// Relative luminance (WCAG 2).
fn luminance(color: Color) -> f64 {
    let linear = color.map(|c| match f64::from(c) / 255.0 {
        c if c <= 0.04045 => c / 12.92,
        c => ((c + 0.055) / 1.055).powf(2.4),
    });
    0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
}

#[test]
fn series_differ_also_in_grey() {
    let color = |k: usize| Look::series(k).color;
    let contrast = |a: f64, b: f64| (a.max(b) + 0.05) / (a.min(b) + 0.05);
    for k in 0..MOST {
        let (own, next) = (luminance(color(k)), luminance(color((k + 1) % MOST)));
        assert!(contrast(own, next) > 1.5, "{k}: {}", contrast(own, next));
        assert!(contrast(own, 1.0) > 2.0, "{k} on white");
        for other in 0..k {
            assert_ne!(Look::series(k).marker, Look::series(other).marker);
            let distance: i32 = (0..3).map(|c| (i32::from(color(k)[c]) - i32::from(color(other)[c])).pow(2)).sum();
            assert!(distance > 60 * 60, "{k} and {other}");
        }
    }
    assert_eq!(Look::series(MOST), Look::series(0));
}

#[test]
fn names_move_apart_as_little_as_they_must() {
    assert_eq!(apart(&[50.0, 100.0], (0.0, 200.0)), [50.0, 100.0]);
    assert_eq!(apart(&[100.0, 100.0, 100.0], (0.0, 200.0)), [80.0, 100.0, 120.0]);
    assert_eq!(apart(&[0.0, 0.0, 199.0, 200.0], (0.0, 200.0)), [0.0, 20.0, 180.0, 200.0]);
    assert_eq!(apart(&[], (0.0, 200.0)), [0.0; 0]);
}

#[test]
fn names_are_where_nothing_else_is() {
    let frame = PlotArea {
        left: 0.0,
        top: 0.0,
        width: 600.0,
        height: 400.0,
        x: Axis::linear(0.0, 6.0),
        y: Axis::linear(0.0, 4.0),
    };
    let line = |name: &str, points: &[Point]| Line::new(name, points.to_vec(), Look::series(0));
    let lines = [
        line("free", &[(0.0, 1.0), (1.0, 1.0)]),
        line("another line is in its way", &[(2.0, 2.0), (3.0, 2.0)]),
        line("to the edge", &[(0.0, 3.0), (6.0, 3.0)]),
        line("to the edge as well", &[(0.0, 2.9), (6.0, 2.99)]),
        line("", &[(3.15, 0.0), (3.15, 4.0)]),
    ];
    let placed: Vec<_> = lines.iter().map(|line| frame.map_lines(&line.points)).collect();
    let labels = labels(&frame, &lines, &placed);
    assert_eq!(labels.iter().map(|label| label.is_beside).collect::<Vec<_>>(), [false, true, true, true]);
    assert_eq!(labels[0].at, (113.0, 300.0));
    // The two that end together are a row apart, in the order of their ends.
    assert!((labels[3].at.1 - labels[2].at.1 - ROW).abs() < 1e-9 && labels[2].at.0 > 600.0, "{labels:?}");
}

#[test]
fn one_epoch_is_a_point() {
    let folder = tempfile::tempdir().unwrap();
    let point = HistoryPoint { epoch: 1, q: 0.02, loss: -0.02, gradient_norm: 0.1, truth: f64::NAN };
    history(&folder.path().join("history"), &[point], ("Q", "Q"), None).unwrap();
    let drawn = std::fs::read_to_string(folder.path().join("history.svg")).unwrap();
    // One in each panel: the objective, the loss and the gradient's norm.
    assert_eq!(drawn.matches("<circle").count(), 3);
}
