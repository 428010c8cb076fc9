//! The errors of the figures of a steady flow around shapes, from one solution, by [dual-weighted residuals](crate::sph::cloud::weighted_residual).
//!
//! The error of a figure is a share of its weighted residual, the same for all spacings and shapes.

use super::around_flow::Around;
use super::around_shapes::{no_solution, AroundShapes};
use super::figure_error::{figures, FigureError, Parts, ROUNDING};
use super::record::Record;
use crate::error::Error;
use crate::sph::cloud::equations::Bar;
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::problem::Solution;
use crate::sph::cloud::smoothing::Smoothing;
use crate::sph::cloud::weighted_residual::Weighted;

/// What an error is of a weighted residual: a multiple of the magnitudes of the sums over slopes and over Laplacians, and a share of the
/// sum of all magnitudes.
#[derive(Debug, Clone, Copy)]
struct Share {
    sums: f64,
    magnitudes: f64,
}

/// The shares of each kind of figure.
struct Shares {
    flow: Share,
    /// Of the part of a force that is across the whole of it, where more cancels.
    across: Share,
    torque: Share,
    heat: Share,
}

/// Shares that 19 of 20 true errors do not exceed, and the least of such in the middle. (Of 40 channels with bodies at random, smooth ones and
/// polygons, at two spacings each, and of the ten geometries of data/reference/bodies-in-channel.csv at three.)
const SHARES: Shares = Shares {
    flow: Share { sums: 0.7, magnitudes: 0.07 },
    across: Share { sums: 1.8, magnitudes: 0.01 },
    torque: Share { sums: 0.9, magnitudes: 0.1 },
    heat: Share { sums: 1.2, magnitudes: 0.12 },
};
/// The same of flows with a deferred correction, whose residuals are smaller.
const SHARES_CORRECTED: Shares = Shares {
    flow: Share { sums: 0.3, magnitudes: 0.15 },
    across: Share { sums: 1.8, magnitudes: 0.015 },
    torque: Share { sums: 0.3, magnitudes: 0.15 },
    heat: Share { sums: 0.8, magnitudes: 0.2 },
};

/// Factors of the shares of each kind of figure.
struct Factors {
    flow: f64,
    across: f64,
    torque: f64,
    heat: f64,
}

/// Those where shapes stand on sides or on other shapes, in corners of fluid between both. (Of 22 channels with one to three fins at random, boxes and
/// leaning plates of 2 to 5 spacings at Reynolds numbers to 200, beside finite elements of scripts/fins_fem.py: 167 of 172 figures are as near as their
/// errors, which are 3.2 times the true ones in the middle; of lifts all 43 are, and 4.6 times.)
const STANDING: Factors = Factors { flow: 1.65, across: 0.7, torque: 1.65, heat: 1.35 };

impl Shares {
    fn times(&self, by: &Factors) -> Self {
        let times = |share: Share, by: f64| Share { sums: by * share.sums, magnitudes: by * share.magnitudes };
        Self {
            flow: times(self.flow, by.flow),
            across: times(self.across, by.across),
            torque: times(self.torque, by.torque),
            heat: times(self.heat, by.heat),
        }
    }
}

/// The errors of figures, and where that of the first one comes from.
pub struct SolutionErrors {
    pub figures: Vec<FigureError>,
    /// What each particle has in the error of the first figure per area, `[N]`.
    pub density: Vec<f64>,
}

impl AroundShapes {
    /// The weighted figures whose sum a figure of a record is; none for those that follow from no flow.
    fn terms_of(&self, solution: &Solution, name: &str) -> Option<Vec<(Figure, f64)>> {
        let one = |figure: Figure| Some(vec![(figure, self.unit(figure))]);
        let index = |text: &str| text.strip_suffix(']').and_then(|number| number.parse::<usize>().ok());
        match name {
            "objective" => Some(self.objective(solution).1),
            "flow_rate" => one(Figure::FlowRate),
            "pressure_drop" => one(Figure::PressureDrop),
            "dissipation" => one(Figure::Dissipation),
            "heat_outflow" => one(Figure::HeatOutflow),
            _ => {
                let (shape, figure) = name.strip_prefix("shapes[")?.split_once('.')?;
                let shape = index(shape)?;
                match (figure, figure.strip_prefix("force[").and_then(index)) {
                    ("torque", _) => one(Figure::Torque { shape }),
                    ("heat", _) => one(Figure::Heat { shape }),
                    (_, Some(along)) => one(Figure::Force { shape, along }),
                    _ => None,
                }
            }
        }
    }

    fn shares(&self) -> Shares {
        let bodies = &self.flow.cloud.places.bodies;
        let stands = |shape: usize| self.flow.measures.has_line(shape) && !bodies.contains(&shape);
        let shares = if self.config().is_corrected() { SHARES_CORRECTED } else { SHARES };
        match (0..self.config().shapes.len()).any(stands) {
            true => shares.times(&STANDING),
            false => shares,
        }
    }

    /// What the error of a figure is of its weighted residual.
    fn share(&self, solution: &Solution, figure: Figure) -> Share {
        let shares = self.shares();
        match figure {
            Figure::Heat { .. } | Figure::HeatOutflow => shares.heat,
            Figure::Torque { .. } => shares.torque,
            Figure::Force { shape, along } => {
                let force = [0, 1].map(|along| self.flow.value(solution, Figure::Force { shape, along }));
                let whole = force[0].hypot(force[1]).max(f64::MIN_POSITIVE);
                let between = |of: fn(Share) -> f64| {
                    (of(shares.flow) * force[along] / whole).hypot(of(shares.across) * force[1 - along] / whole)
                };
                Share { sums: between(|share| share.sums), magnitudes: between(|share| share.magnitudes) }
            }
            _ => shares.flow,
        }
    }

    /// The cotangents of a figure of a record, and what its error is of its weighted residual; none for those that follow from no flow.
    fn cotangents(&self, solution: &Solution, name: &str) -> Option<(Bar, Share)> {
        let mut bar = Bar::new(self.flow.cloud.particles(), solution.shaped.area.len());
        if name == "body_force" {
            bar.drive = 1.0;
            return Some((bar, self.shares().flow));
        }
        let mut share = Share { sums: 0.0, magnitudes: 0.0 };
        for (figure, weight) in self.terms_of(solution, name)? {
            self.flow.measures.pull_back(figure, &self.flow.at(solution), weight, &mut bar);
            let own = self.share(solution, figure);
            share.sums = share.sums.max(own.sums);
            share.magnitudes = share.magnitudes.max(own.magnitudes);
        }
        Some((bar, share))
    }

    /// The errors of the figures of a steady flow.
    ///
    /// # Errors
    /// A transposed system that cannot be solved.
    pub fn errors(&mut self, solution: &Solution, record: &Record) -> Result<SolutionErrors, Error> {
        let mut found = SolutionErrors { figures: vec![], density: vec![] };
        let residual = self.flow.residual(solution).map_err(|why| no_solution(self.config(), &why))?;
        for (name, value) in figures(record) {
            let Some((bar, share)) = self.cotangents(solution, &name) else { continue };
            let weighted = self.flow.weighted_residual(solution, &residual, &bar);
            let Weighted { slopes, laplacians, magnitude } =
                weighted.map_err(|why| no_solution(self.config(), &why))?;
            let magnitudes: f64 = magnitude.iter().sum();
            let error = share.sums * (slopes.abs() + laplacians.abs()) + share.magnitudes * magnitudes;
            // A figure that is given has none.
            if error <= ROUNDING * value.abs() {
                continue;
            }
            if found.density.is_empty() {
                found.density = self.density(&magnitude, error / magnitudes);
            }
            let parts = Parts { discretisation: error, ..Parts::default() };
            found.figures.push(FigureError { name, value, error, parts, observed_order: None });
        }
        Ok(found)
    }

    /// An error per area, given what particles have in it but for a factor, in the mean of each one's neighbours.
    fn density(&self, by_particle: &[f64], factor: f64) -> Vec<f64> {
        let cloud = &self.flow.cloud;
        let spacing = &cloud.places.spacing;
        let mut rows: Vec<[f64; 1]> = by_particle.iter().zip(spacing).map(|(x, h)| [factor * x / (h * h)]).collect();
        Smoothing::new(&cloud.fits.all, rows.len()).apply(&mut rows);
        rows.into_iter().map(|[x]| x).collect()
    }
}
