//! Checks of scenes with water in a tank.

use crate::config::range::{countable, spacings, whole_spacings, WHOLE};
use crate::config::scene::{Config, Family};
use crate::error::BadInput;

impl Config {
    /// Checks that the walls of the tank and the water are on the lattice.
    pub(super) fn check_tank(&self) -> Result<(), BadInput> {
        let (dx, tank, water) = (self.resolution.dx, &self.tank, &self.water);
        let (deep, block) = (self.dimension() == 3, self.scene == Family::FallingBlock);
        let still = self.scene == Family::HydrostaticTank;
        let particles = tank.length / dx * tank.height / dx * if deep { tank.depth / dx } else { 1.0 };
        countable(dx, particles)?;
        let extents = [
            ("tank.length", tank.length, true),
            ("tank.height", tank.height, true),
            ("tank.depth", tank.depth, deep),
            ("water.length", water.length, !still),
            ("water.height", water.height, true),
            ("water.x", water.x, block),
            ("water.y", water.y, block),
        ];
        for (key, extent, _) in extents.into_iter().filter(|(_, _, has)| *has) {
            let count = (extent / dx).round();
            if (extent / dx - count).abs() > WHOLE {
                return Err(BadInput::at(key, format!("resolution.dx = {dx} does not divide {key} = {extent}"))
                    .allowed("whole numbers of spacings")
                    .advice(format!("{key}={}", whole_spacings(extent, dx))));
            }
        }
        let (support, rows) = (self.support(), self.fluid_rows());
        for (key, extent) in [("tank.length", tank.length), ("tank.height", tank.height)] {
            if extent < rows * dx * (1.0 - WHOLE) {
                return Err(BadInput::at(key, format!("{key} = {extent} is too small"))
                    .allowed(format!("at least {}: no particle sees two walls", spacings(rows)))
                    .advice(format!("{}, or a larger {key}", self.finer(extent / rows))));
            }
        }
        let shortest = 2.0 * (support + self.time.skin) * dx;
        if deep && tank.depth < shortest {
            return Err(BadInput::at("tank.depth", format!("tank.depth = {} is too short", tank.depth))
                .allowed(format!("at least 2 ({support} + time.skin) dx = {shortest}"))
                .advice(format!("{}, or a larger tank.depth", self.finer(tank.depth / shortest * dx))));
        }
        let (length, x, y) = (
            if still { tank.length } else { water.length },
            if block { water.x } else { 0.0 },
            if block { water.y } else { 0.0 },
        );
        let slack = WHOLE * dx;
        for (key, from, extent, key_of_tank, most) in [
            ("water.length", x, length, "tank.length", tank.length),
            ("water.height", y, water.height, "tank.height", tank.height),
        ] {
            if from + extent > most + slack {
                return Err(BadInput::at(key, format!("{key} = {extent} reaches out of the tank"))
                    .allowed(format!("up to {}, {key_of_tank} less where the water begins", most - from))
                    .advice(format!("{key_of_tank}={}", whole_spacings(from + extent, dx))));
            }
        }
        let gravity = self.fluid.gravity;
        let flat = !deep && gravity[2] != 0.0;
        if flat || gravity.iter().any(|g| !g.is_finite()) || (still && (gravity[0] != 0.0 || gravity[1] >= 0.0)) {
            return Err(BadInput::at(
                "fluid.gravity",
                format!("fluid.gravity = {gravity:?} is no acceleration of this tank"),
            )
            .allowed(match still {
                true => "downwards: [0, less than 0, 0]",
                false if deep => "three finite numbers",
                false => "three finite numbers, the last one 0",
            })
            .advice("fluid.gravity=[0.0,-1.0,0.0]"));
        }
        Ok(())
    }
}
