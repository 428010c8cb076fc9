//! Particles coloured by temperature, true to scale.

use super::axis::{Axis, PlotArea, INK, TICKS};
use super::colors;
use super::drawing::{text_width, Anchor, Color, Drawing, Point, Saved};
use crate::io::FileError;
use std::path::Path;

/// Tags as in JAX-SPH.
const FLUID: u8 = 0;
const MOVING_WALL: u8 = 2;
const HOT_WALL: u8 = 3;
/// Ours: points on the walls' surface, which have no width.
const SURFACE: u8 = 4;
const HOT_SURFACE: u8 = 5;

const WALL_GREY: Color = [188, 188, 188];
const MOVING_GREY: Color = [140, 140, 140];
const HOT_GREY: Color = [214, 214, 214];
const HOT_OUTLINE: Color = [200, 30, 30];
const SURFACE_INK: Color = [70, 70, 70];
/// Of a surface point's radius, in a particle's.
const SURFACE_SIZE: f64 = 0.22;

#[derive(Clone, Copy, Debug)]
pub struct TemperaturePanel<'a> {
    pub title: &'a str,
    /// Component-major `[2, N]`: all x, then all y; scene length units.
    pub position: &'a [f64],
    /// `[N]`; not looked at for walls.
    pub temperature: &'a [f64],
    /// `[N]`: 0 fluid, 1 wall, 2 moving wall, 3 wall of set temperature, 4 and 5 points on the surface of such walls.
    pub tag: &'a [u8],
    /// Of a particle, scene length units.
    pub diameter: f64,
    /// Of each particle instead, `[N]`, where these are of many sizes.
    pub diameters: Option<&'a [f64]>,
}

/// Draws panels under each other: fluid particles coloured from `t_min` to `t_max`, wall particles grey (those of
/// set temperature outlined in red). Both axes have the same scale; particles whose centre lies outside the ranges
/// are left out. `label` names what colours them, and its unit.
///
/// # Errors
/// [`FileError::Input`] if lengths do not fit, a range is empty, or there is no panel.
pub fn colored_particles(
    stem: &Path,
    label: &str,
    panels: &[TemperaturePanel],
    (t_min, t_max): (f64, f64),
    x_range: (f64, f64),
    y_range: (f64, f64),
) -> Saved {
    check(stem, panels, (t_min, t_max), x_range, y_range)?;
    let (x_span, y_span) = (x_range.1 - x_range.0, y_range.1 - y_range.0);
    // Wide scenes fill the width; tall ones are limited by height.
    let pixels = f64::min(900.0 / x_span, if panels.len() > 1 { 460.0 } else { 700.0 } / y_span);
    let (width, height) = (pixels * x_span, pixels * y_span);
    let (left, first_top, gap) = (110.0, 48.0, 62.0);
    let bottom = first_top + panels.len() as f64 * (height + gap) - gap;
    let bar_left = left + width + 30.0;
    let mut drawing = Drawing::new(bar_left + 125.0, bottom + 110.0);

    for (index, panel) in panels.iter().enumerate() {
        let top = first_top + index as f64 * (height + gap);
        let frame = PlotArea::to_scale((left, top), pixels, x_range, y_range, TICKS);
        let last = index + 1 == panels.len();
        let x_label = if last { "x (scene units)" } else { "" };
        drawing.text(panel.title, (left, frame.top - 20.0), 18.0, Anchor::Left, INK);
        frame.draw(&mut drawing, x_label, "y (scene units)", INK);
        draw_particles(&mut drawing, &frame, panel, (t_min, t_max), pixels);
        frame.outline(&mut drawing);
    }
    color_bar(&mut drawing, (bar_left, first_top), bottom - first_top, (t_min, t_max), label);
    legend(&mut drawing, (left, bottom + 80.0), panels);
    drawing.save(stem)
}

pub(super) fn draw_particles(
    drawing: &mut Drawing,
    frame: &PlotArea,
    panel: &TemperaturePanel,
    (t_min, t_max): (f64, f64),
    pixels: f64,
) {
    let count = panel.tag.len();
    let inside = |part: f64| (-1e-9..=1.0 + 1e-9).contains(&part);
    for particle in 0..count {
        let (x, y) = (panel.position[particle], panel.position[count + particle]);
        if !(inside(frame.x.part(x)) && inside(frame.y.part(y))) {
            continue;
        }
        let centre = frame.map((x, y));
        let radius = 0.5 * panel.diameters.map_or(panel.diameter, |each| each[particle]) * pixels;
        let color = match panel.tag[particle] {
            FLUID => colors::heat((panel.temperature[particle] - t_min) / (t_max - t_min)),
            HOT_WALL => {
                drawing.disc(centre, radius, HOT_OUTLINE);
                drawing.disc(centre, radius - (0.22 * radius).min(1.5), HOT_GREY);
                continue;
            }
            SURFACE | HOT_SURFACE => {
                let ink = if panel.tag[particle] == SURFACE { SURFACE_INK } else { HOT_OUTLINE };
                drawing.disc(centre, SURFACE_SIZE * radius, ink);
                continue;
            }
            MOVING_WALL => MOVING_GREY,
            _ => WALL_GREY,
        };
        drawing.disc(centre, radius, color);
    }
}

/// A row that says what the kinds of wall that occur look like, its middle line at `y`.
fn legend(drawing: &mut Drawing, (mut x, y): Point, panels: &[TemperaturePanel]) {
    let kinds = [
        (1, "wall", WALL_GREY, None),
        (MOVING_WALL, "moving wall", MOVING_GREY, None),
        (HOT_WALL, "wall of set temperature", HOT_GREY, Some(HOT_OUTLINE)),
        (SURFACE, "the wall's surface", SURFACE_INK, None),
        (HOT_SURFACE, "that of set temperature", HOT_OUTLINE, None),
    ];
    for (_, text, color, outline) in kinds.into_iter().filter(|(tag, ..)| panels.iter().any(|p| p.tag.contains(tag))) {
        if let Some(outline) = outline {
            drawing.disc((x + 10.0, y), 8.5, outline);
        }
        drawing.disc((x + 10.0, y), 7.0, color);
        drawing.text(text, (x + 26.0, y), 15.0, Anchor::Left, INK);
        x += text_width(text, 15.0) + 54.0;
    }
}

pub(super) fn color_bar(drawing: &mut Drawing, corner: Point, height: f64, range: (f64, f64), label: &str) {
    color_bar_of(colors::heat, drawing, corner, height, range, label);
}

/// A bar of other colours, which a function gives for parts from 0 to 1.
pub(super) fn color_bar_of(
    color: impl Fn(f64) -> Color,
    drawing: &mut Drawing,
    (left, top): Point,
    height: f64,
    (low, high): (f64, f64),
    label: &str,
) {
    const STRIPES: usize = 200;
    const WIDTH: f64 = 22.0;
    let stripe = height / STRIPES as f64;
    for index in 0..STRIPES {
        let part = 1.0 - (index as f64 + 0.5) / STRIPES as f64;
        drawing.rectangle((left, top + stripe * index as f64), WIDTH, stripe, color(part), 1.0);
    }
    let frame = PlotArea { left, top, width: WIDTH, height, x: Axis::linear(0.0, 1.0), y: Axis::linear(low, high) };
    frame.outline(drawing);
    frame.draw_right(drawing, &frame.y, label, INK);
}

pub(super) fn check(
    path: &Path,
    panels: &[TemperaturePanel],
    t_range: (f64, f64),
    x_range: (f64, f64),
    y_range: (f64, f64),
) -> Result<(), FileError> {
    let bad = |problem: String, allowed: &str| Err(FileError::input(path, problem, allowed));
    if panels.is_empty() {
        return bad("there is no panel".into(), "at least one");
    }
    check_ranges(path, [("temperature", t_range), ("x", x_range), ("y", y_range)])?;
    for TemperaturePanel { title, position, temperature, tag, diameter, .. } in panels {
        let (count, warm, places) = (tag.len(), temperature.len(), position.len());
        if places != 2 * count || warm != count {
            return bad(
                format!("panel `{title}` has {count} tags, {warm} temperatures, {places} coordinates"),
                "one temperature and two coordinates for each tag",
            );
        }
        if !(*diameter > 0.0 && diameter.is_finite()) {
            return bad(format!("the particle diameter is {diameter}"), "a positive length");
        }
    }
    Ok(())
}

pub(super) fn check_ranges(path: &Path, ranges: [(&str, (f64, f64)); 3]) -> Result<(), FileError> {
    for (name, (low, high)) in ranges {
        if !(low < high && low.is_finite() && high.is_finite()) {
            let problem = format!("the {name} range is {low} to {high}");
            return Err(FileError::input(path, problem, "finite limits, the first below the second"));
        }
    }
    Ok(())
}
