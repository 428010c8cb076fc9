//! Checks of the verification flows in a box.

use crate::config::range::{countable, is_whole, spacings, whole_spacings};
use crate::config::scene::{Config, DriveName, Family};
use crate::error::BadInput;

impl Config {
    /// Checks that no key of the heated channel alone is set.
    pub(super) fn check_flow(&self) -> Result<(), BadInput> {
        match self.fluid.drive == DriveName::BodyForce {
            true => Ok(()),
            false => Err(BadInput::at("fluid.drive", "fluid.drive without a heated channel")
                .allowed("body-force, or scene heated-channel")),
        }
    }

    /// Checks the isothermal channel: inlet, warm walls and outlet in this order, in whole spacings.
    pub(super) fn check_warm_walls(&self) -> Result<(), BadInput> {
        if self.scene != Family::IsothermalChannel {
            return Ok(());
        }
        let (channel, dx) = (&self.channel, self.resolution.dx);
        let shortest = 2.0 * (self.support() + self.time.skin) * dx;
        if channel.length < shortest || !is_whole(channel.length / dx) {
            return Err(BadInput::at(
                "channel.length",
                format!("channel.length = {} does not hold whole spacings", channel.length),
            )
            .allowed(format!("multiples of resolution.dx = {dx}, at least {shortest}"))
            .advice(format!("channel.length={}", whole_spacings(channel.length.max(shortest), dx))));
        }
        let (low, high) = (channel.inlet_length, channel.length - channel.outlet_length - dx);
        if channel.hot_from < low || channel.hot_from > high {
            return Err(BadInput::at("channel.hot_from", format!("channel.hot_from = {} is out of place", channel.hot_from))
                .allowed(format!(
                    "channel.inlet_length <= channel.hot_from <= channel.length - channel.outlet_length - dx, here {low} ... \
                     {high}"
                )));
        }
        Ok(())
    }

    /// The size of a verification flow's box that dx divides, its name, the dimension, whether there are walls, and
    /// the number of sizes.
    pub(super) fn box_facts(&self) -> (f64, &'static str, i32, bool, f64) {
        match self.scene {
            Family::TaylorGreen3d => (std::f64::consts::TAU, "2 pi, the side of the box", 3, false, 1.0),
            Family::Poiseuille | Family::Couette => (1.0, "1, the height of the channel", 1, true, 1.0),
            Family::IsothermalChannel => (1.0, "1, the height of the channel", 2, true, self.channel.length),
            Family::ReversePoiseuille => (1.0, "1, the length of the box", 2, false, 2.0),
            Family::ReversePoiseuille3d => (0.5, "0.5, the depth of the box", 3, false, 8.0),
            Family::LidDrivenCavity => (1.0, "1, the side of the cavity", 2, true, 1.0),
            Family::LidDrivenCavity3d => (1.0, "1, the side of the cavity", 3, true, 1.0),
            Family::Slab => (0.5, "0.5, half of the slab", 1, true, 2.0),
            _ => (1.0, "1, the side of the box", 2, false, 1.0),
        }
    }

    /// Checks that dx divides the box of a verification flow, and that the box is large enough.
    pub(super) fn check_box(&self) -> Result<(), BadInput> {
        let dx = self.resolution.dx;
        let (size, text, dimension, walls, parts) = self.box_facts();
        let bad = |problem: String| BadInput::at("resolution.dx", problem);
        let particles = parts * (size / dx).powi(dimension);
        countable(dx, particles)?;
        // With periodic images, a particle must see each neighbour only once. It must not reach two walls.
        let support = self.support();
        let fewest = match (walls, self.scene) {
            // Half of a slab has one wall.
            (true, Family::Slab) => support.max(8.0),
            (true, _) => self.fluid_rows(),
            (false, _) => 2.0 * (support + self.time.skin),
        };
        let count = (size / dx).round();
        if count < fewest {
            let rule = match walls {
                true => spacings(fewest),
                false => format!("2 ({} + time.skin) spacings", (support * 1e6).round() / 1e6),
            };
            return Err(bad(format!("resolution.dx = {dx} is too coarse"))
                .allowed(format!("at least {rule} in {text}"))
                .advice(self.finer(size / fewest)));
        }
        if !is_whole(size / dx) {
            return Err(bad(format!("resolution.dx = {dx} does not divide {text}"))
                .allowed(format!("{size} over a whole number"))
                .advice(self.advised_spacings(dx)));
        }
        Ok(())
    }
}
