//! Checks of the heated channels: spacing, sections along the channel, drive, and bounds of the wall.

use crate::config::range::{countable, is_whole, spacings};
use crate::config::scene::{BodyForceRegion, Config, DesignWalls, DriveName, Family, ObjectiveKind};
use crate::config::suggest;
use crate::error::BadInput;

/// Largest speed of a weakly compressible flow relative to the speed of sound.
const FASTEST: f64 = 0.5;

impl Config {
    /// Checks that dx divides length and height, and the number of particles.
    pub(super) fn check_spacing(&self) -> Result<(), BadInput> {
        let (dx, channel) = (self.resolution.dx, &self.channel);
        let span = (self.dimension() == 3).then_some(("channel.span", channel.span));
        let layers = span.map_or(1.0, |(_, span)| span / dx);
        let particles = channel.length / dx * (channel.height / dx + 2.0 * channel.wall_rows as f64) * layers;
        countable(dx, particles)?;
        let across = [Some(("channel.height", channel.height)), span].into_iter().flatten();
        let across: Vec<(&str, f64)> = across.collect();
        for &(key, extent) in [("channel.length", channel.length)].iter().chain(&across) {
            if !is_whole(extent / dx) {
                let problem = format!("resolution.dx = {dx} does not divide {key} = {extent}");
                let bad = BadInput::at("resolution.dx", problem).allowed(match span {
                    None => "whole numbers of spacings in channel.length and channel.height",
                    Some(_) => "whole numbers of spacings in channel.length, channel.height and channel.span",
                });
                let near = self.advised_spacings(dx);
                return Err(match near.is_empty() {
                    true => bad.advice("another channel.height: a simple fraction of channel.length"),
                    false => bad.advice(near),
                });
            }
        }
        // With periodic images, a particle must see each neighbour only once.
        let support = self.support();
        let shortest = 2.0 * (support + self.time.skin) * dx;
        for (key, extent) in [("channel.length", channel.length)].into_iter().chain(span) {
            if extent < shortest {
                return Err(BadInput::at(key, format!("{key} = {extent} is too short"))
                    .allowed(format!("at least 2 ({support} + time.skin) dx = {shortest}"))
                    .advice(self.finer(extent / shortest * dx)));
            }
        }
        Ok(())
    }

    /// A finer spacing for comparison: half; in three dimensions the largest up to four fifths that divides all
    /// extents.
    pub fn finer_spacing(&self) -> f64 {
        let dx = self.resolution.dx;
        if self.dimension() == 2 {
            return 0.5 * dx;
        }
        self.spacing_up_to(0.8 * dx).unwrap_or(0.5 * dx)
    }

    /// The keys of another spacing with their values: where one is given on the surfaces of bodies, it goes with that of all.
    pub fn spacings_at(&self, dx: f64) -> impl Iterator<Item = (&'static str, f64)> {
        let surface = self.resolution.surface.map(|surface| surface * dx / self.resolution.dx);
        std::iter::once(("resolution.dx", dx)).chain(surface.map(|surface| ("resolution.surface", surface)))
    }

    /// The lengths that the spacing must divide.
    fn extents(&self) -> Vec<f64> {
        let (channel, tank, water) = (&self.channel, &self.tank, &self.water);
        let deep = self.dimension() == 3;
        let mut all = match self.scene {
            Family::Custom => self.region.size.clone(),
            scene if scene.has_design() => {
                vec![channel.length, channel.height, if deep { channel.span } else { 0.0 }]
            }
            scene if scene.has_surface() => {
                let block = if scene == Family::FallingBlock { [water.x, water.y] } else { [0.0; 2] };
                let length = if scene == Family::HydrostaticTank { 0.0 } else { water.length };
                let depth = if deep { tank.depth } else { 0.0 };
                vec![tank.length, tank.height, depth, length, water.height, block[0], block[1]]
            }
            Family::IsothermalChannel => vec![self.box_facts().0, channel.length],
            _ => vec![self.box_facts().0],
        };
        all.retain(|extent| *extent > 0.0);
        all
    }

    /// The largest spacing up to `most` that divides what it must divide, if there is one near.
    pub fn spacing_up_to(&self, most: f64) -> Option<f64> {
        // Starts a millionth above, because the search excludes the given spacing.
        let near = nearest_spacings(most * (1.0 + 1e-6), &self.extents());
        let near = near.into_iter().find(|&finer| finer <= most * (1.0 + 1e-6))?;
        Some(suggest::shortest(near, |short| (0.999 * near..=most).contains(&short) && divides(short, &self.extents())))
    }

    /// Advice to take a spacing of at most this.
    pub fn finer(&self, most: f64) -> String {
        let finer = self.spacing_up_to(most).map(|dx| format!("resolution.dx={dx}"));
        finer.unwrap_or("a smaller resolution.dx".into())
    }

    /// Advice to take one of the spacings near `dx` that divide what they must divide; empty if there is none.
    pub(super) fn advised_spacings(&self, dx: f64) -> String {
        let near = nearest_spacings(dx, &self.extents());
        near.iter().map(|dx| format!("resolution.dx={dx}")).collect::<Vec<_>>().join(" or ")
    }

    /// Checks that inlet, hot section, target and outlet are in this order.
    pub(super) fn check_channel(&self) -> Result<(), BadInput> {
        let channel = &self.channel;
        let outlet = channel.length - channel.outlet_length;
        let target = self.objective.target_x;
        let dx = self.resolution.dx;
        // Sums such as hot_from + dx are rounded; a billionth of a spacing is no difference.
        let slack = 1e-9 * dx;
        let order = [
            (
                "channel.hot_from",
                channel.hot_from,
                channel.inlet_length,
                channel.hot_to - dx,
                "channel.inlet_length <= channel.hot_from <= channel.hot_to - dx",
            ),
            (
                "channel.hot_to",
                channel.hot_to,
                channel.hot_from + dx,
                outlet,
                "channel.hot_from + dx <= channel.hot_to <= channel.length - channel.outlet_length",
            ),
            (
                "objective.target_x",
                target,
                channel.hot_to,
                outlet,
                "channel.hot_to <= objective.target_x <= channel.length - channel.outlet_length",
            ),
        ];
        for (key, value, low, high, rule) in order {
            if value < low - slack || value > high + slack {
                return Err(BadInput::at(key, format!("{key} = {value} is out of place"))
                    .allowed(format!("{rule}, here {low} ... {high}")));
            }
        }
        Ok(())
    }

    /// Checks that the flow is slow enough for the speed of sound.
    pub(super) fn check_speed(&self) -> Result<(), BadInput> {
        let (fastest, sound) = (self.plane_speed(), self.sound_speed());
        if fastest <= FASTEST * sound {
            return Ok(());
        }
        Err(BadInput::at(
            "fluid.reference_velocity",
            format!("the plane channel's flow would be as fast as {fastest:.3}, with a sound speed of {sound:.3}"),
        )
        .allowed(format!("flows up to {FASTEST} of the sound speed, reference_velocity * sound_speed_factor"))
        .advice(format!(
            "fluid.reference_velocity={} (smaller steps), or a smaller fluid.body_force",
            suggest::at_least(fastest, fastest)
        )))
    }

    /// Checks that nothing is asked for that fixed particles over a wall of x and z lack.
    pub(super) fn check_over_relief(&self) -> Result<(), BadInput> {
        if !self.is_over_relief() || self.objective.kind != ObjectiveKind::WallHeat {
            return Ok(());
        }
        Err(BadInput::at("objective.kind", "objective.kind = wall-heat with method.name = fixed in three dimensions")
            .allowed("heat-outflow, outlet-temperature, flow-rate; wall-heat with method.name = consistent")
            .advice("objective.kind=heat-outflow"))
    }

    /// Checks the flow rate or the power that is held.
    pub(super) fn check_drive(&self) -> Result<(), BadInput> {
        let fluid = &self.fluid;
        let given = [
            ("fluid.flow_rate", fluid.flow_rate, DriveName::FlowRate, "flow-rate"),
            ("fluid.pumping_power", fluid.pumping_power, DriveName::PumpingPower, "pumping-power"),
        ];
        for (key, value, drive, name) in given {
            if value.is_some() && fluid.drive != drive {
                return Err(BadInput::at(key, format!("{key} without what holds it"))
                    .allowed(format!("fluid.drive = {name} with it"))
                    .advice(format!("fluid.drive={name}")));
            }
        }
        if fluid.drive == DriveName::BodyForce {
            return Ok(());
        }
        if fluid.body_force_region != BodyForceRegion::Fluid {
            return Err(BadInput::at(
                "fluid.body_force_region",
                "fluid.body_force_region = original-channel with a force that is found",
            )
            .allowed("fluid, or fluid.drive = body-force"));
        }
        if self.plane_force() == 0.0 {
            return Err(BadInput::at("fluid.drive", "fluid.drive without a flow rate or a power to hold")
                .allowed("a body force above 0, or fluid.flow_rate or fluid.pumping_power"));
        }
        Ok(())
    }

    /// Checks that a shape of the top wall is given only if that wall is shaped.
    pub(super) fn check_walls(&self) -> Result<(), BadInput> {
        match self.design.walls == DesignWalls::Bottom && self.design.top_offsets.is_some() {
            false => Ok(()),
            true => Err(BadInput::at("design.top_offsets", "design.top_offsets with a top wall that is not shaped")
                .allowed("design.walls = both with them")
                .advice("design.walls=both")),
        }
    }

    /// Checks how far the wall may move.
    pub(super) fn check_bound(&self) -> Result<(), BadInput> {
        let (bound, dx, channel) = (self.design.bound, self.resolution.dx, &self.channel);
        let fail = |limit: f64, why: &str, advice: String| {
            Err(BadInput::at("design.bound", format!("design.bound = {bound} is too large: {why}"))
                .allowed(format!("0 ... {limit:.6}"))
                .advice(advice))
        };
        let whole = 1.0 + 1e-9;
        // The number of rows is constant, so the fluid between a raised wall and the top is squeezed. The walls' sums
        // depend on its height.
        let fewest = self.fluid_rows();
        let walls = if self.design.walls == DesignWalls::Both { 2.0 } else { 1.0 };
        let limit = (channel.height - fewest * dx) / walls;
        if limit < -1e-9 * dx {
            let (lowest, finer) = (fewest * dx, self.finer(channel.height / fewest));
            return Err(BadInput::at("channel.height", format!("channel.height = {} is too low", channel.height))
                .allowed(format!("at least {}, {lowest:.6}", spacings(fewest)))
                .advice(finer));
        }
        if bound > limit.max(0.0) * whole {
            let finer = self.finer((channel.height - walls * bound) / fewest);
            let advice = format!("design.bound={}, or {finer}", shorter(limit.max(0.0)));
            let why = format!("the channel keeps {} of fluid", spacings(fewest));
            return fail(limit.max(0.0), &why, advice);
        }
        // Dummy particles move with the surface of their column. At the ends of the hot section the surface steps to y
        // = 0. The face of the step consists of the rows of the higher column; rows that end above the foot of the step
        // would leave a hole. (Within the section the slope limit prevents this.)
        let limit = channel.wall_rows as f64 * dx;
        // (Walls of points on their surface have no steps.)
        if bound > limit * whole && self.method.facts().wall_cells {
            let rows = (bound / dx - 1e-9).ceil();
            let why = format!("the {} wall rows must cover it", channel.wall_rows);
            return fail(limit, &why, format!("channel.wall_rows={rows}, or design.bound={}", shorter(limit)));
        }
        // Adjacent control points of a wall over x and z may differ by twice the bound, for a slope of at most 2.
        if self.dimension() == 3 {
            let limit = self.control_distances().into_iter().fold(f64::INFINITY, f64::min);
            if bound > limit * whole {
                let advice = format!(
                    "design.bound={}, or fewer design.control_points or design.control_points_across",
                    shorter(limit)
                );
                return fail(limit, "no more than the control points' distance, for a slope of 2 at most", advice);
            }
        }
        // In a dip the rows are stretched to (1 + bound / height) dx; beyond 1.5 dx fewer than two rows are within the
        // usual support of 3 dx.
        let limit = 0.5 * channel.height / walls;
        if bound > limit * whole {
            return fail(limit, "half the channel's height at most", format!("design.bound={}", shorter(limit)));
        }
        Ok(())
    }
}

/// A number of few digits that is not above a limit.
fn shorter(limit: f64) -> f64 {
    suggest::shortest(limit, |short| (0.98 * limit..=limit).contains(&short))
}

fn divides(dx: f64, extents: &[f64]) -> bool {
    extents.iter().all(|extent| is_whole(extent / dx))
}

/// The next larger and the next smaller spacing that divide all extents, if they exist, the nearer one first.
pub fn nearest_spacings(dx: f64, extents: &[f64]) -> Vec<f64> {
    let Some(&length) = extents.first().filter(|_| dx > 0.0) else { return vec![] };
    let fits = |count: &usize| *count > 0 && divides(length / *count as f64, extents);
    let is_near = |exact: f64, count: usize| exact.round() as usize == count;
    let start = (length / dx).floor() as usize;
    let larger = (start.saturating_sub(10_000)..=start).rev().find(fits);
    let smaller = (start + 1..start + 10_000).find(fits);
    let spacing = |count: usize| {
        suggest::shortest(length / count as f64, |short| is_near(length / short, count) && divides(short, extents))
    };
    let mut found: Vec<f64> = larger.into_iter().chain(smaller).map(spacing).collect();
    found.sort_by(|a, b| (a - dx).abs().total_cmp(&(b - dx).abs()));
    found
}
