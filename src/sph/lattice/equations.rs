//! The equations of incompressible flow on a periodic lattice, and their transpose.
//!
//! ```text
//!   du/dt + P(w u) = nu lap u + P(f + b (T - T_0)),   w_ab = d_a u_b - d_b u_a,   (w u)_a = - sum_b w_ab u_b
//!   dT/dt + (div(u T) + u.grad T) / 2 = alpha lap T
//! ```
//!
//! P makes a field free of divergence: (P g)_a = g_a - d_a (sum_b d_b g_b) / (sum_b d_b^2) for each mode. What it takes
//! away is the gradient of p + u^2/2. Rotation (w u) does no work, u.(w u) = 0 at each particle, and its sum over
//! particles vanishes if u is free of divergence; transport of heat, as the mean of its two forms, keeps the sums of T and
//! T^2. So energy and momentum change by viscosity and forces alone, however coarse the lattice is, and products need no
//! filter (Zang 1991, Applied Numerical Mathematics 7, 27).
//!
//! States and rates are spectra: those of the velocity's components, then that of the temperature, if there is one.

use super::symbols::Symbols;
use super::transform::{Spectrum, Transform};
use crate::config::method::fixed::Derivatives;
use crate::sph::laws::buoyancy::Buoyancy;
use num_complex::Complex64;

/// i times a number.
fn turned(factor: f64, z: Complex64) -> Complex64 {
    Complex64::new(-factor * z.im, factor * z.re)
}

/// Spectra of the components of the velocity, and of the temperature.
pub type State = Vec<Spectrum>;

/// What numbers make a flow.
#[derive(Debug, Clone, PartialEq)]
pub struct Materials {
    /// Kinematic viscosity.
    pub viscosity: f64,
    /// Thermal diffusivity; none without heat.
    pub diffusivity: Option<f64>,
    /// Body force per mass, `[D]`.
    pub force: Vec<f64>,
    pub buoyancy: Option<Buoyancy>,
}

/// Flow on one lattice.
#[derive(Debug, Clone)]
pub struct Equations {
    pub transform: Transform,
    pub symbols: Symbols,
    pub materials: Materials,
    /// Spacing.
    pub dx: f64,
}

/// Cotangents of the constant numbers of a flow.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OfMaterials {
    pub viscosity: f64,
    pub diffusivity: f64,
    pub force: Vec<f64>,
}

/// Fields at the particles that the rates are products of.
struct Factors {
    velocity: Vec<Vec<f64>>,
    /// w_ab of the pairs a < b.
    rotation: Vec<Vec<f64>>,
    temperature: Option<Vec<f64>>,
    /// Gradient of the temperature.
    slope: Vec<Vec<f64>>,
}

impl Equations {
    /// Flow on a lattice `shape` in a box of `size`, whose spacing is the same along all axes.
    pub fn new(shape: &[usize], size: &[f64], materials: Materials, derivatives: Derivatives) -> Self {
        let symbols = Symbols::new(shape, size, derivatives);
        Self { transform: Transform::new(shape), symbols, materials, dx: size[0] / shape[0] as f64 }
    }

    pub fn dimension(&self) -> usize {
        self.transform.shape.len()
    }

    /// Number of fields in a state.
    pub fn fields(&self) -> usize {
        self.dimension() + usize::from(self.materials.diffusivity.is_some())
    }

    /// The viscosity or diffusivity of a field.
    pub fn diffusion(&self, field: usize) -> f64 {
        match field < self.dimension() {
            true => self.materials.viscosity,
            false => self.materials.diffusivity.unwrap_or_default(),
        }
    }

    fn pairs(&self) -> Vec<(usize, usize)> {
        let d = self.dimension();
        (0..d).flat_map(|a| (a + 1..d).map(move |b| (a, b))).collect()
    }

    /// The part of a velocity that is free of divergence.
    pub fn project(&self, velocity: &mut [Spectrum]) {
        for k in 0..self.transform.modes() {
            let d = |a: usize| self.symbols.first[a][k];
            let sum: Complex64 = velocity.iter().enumerate().map(|(a, g)| g[k] * d(a)).sum();
            let sum = sum * self.symbols.inverse[k];
            velocity.iter_mut().enumerate().for_each(|(a, g)| g[k] -= sum * d(a));
        }
    }

    /// The state of fields at the particles: velocity `[D][N]` and temperature.
    pub fn state(&self, fields: &[Vec<f64>]) -> State {
        let mut state = self.transform.each(self.fields(), |f| self.transform.forwards(fields[f].clone()));
        self.project(&mut state[..self.dimension()]);
        state
    }

    /// The fields of a state at the particles.
    pub fn at_particles(&self, state: &[Spectrum]) -> Vec<Vec<f64>> {
        self.transform.each(state.len(), |f| self.transform.back(state[f].clone()))
    }

    /// The spectrum of the rotation w_ab.
    fn rotation(&self, state: &[Spectrum], (a, b): (usize, usize)) -> Spectrum {
        let (da, db) = (&self.symbols.first[a], &self.symbols.first[b]);
        let of = |k: usize| turned(1.0, state[b][k] * da[k] - state[a][k] * db[k]);
        (0..self.transform.modes()).map(of).collect()
    }

    fn slope(&self, spectrum: &[Complex64], a: usize) -> Spectrum {
        self.symbols.first[a].iter().zip(spectrum).map(|(d, z)| turned(*d, *z)).collect()
    }

    fn factors(&self, state: &[Spectrum]) -> Factors {
        let (d, pairs, has_heat) = (self.dimension(), self.pairs(), self.materials.diffusivity.is_some());
        let count = d + pairs.len() + if has_heat { 1 + d } else { 0 };
        let mut all = self.transform.each(count, |n| {
            self.transform.back(match n.checked_sub(d) {
                None => state[n].clone(),
                Some(n) if n < pairs.len() => self.rotation(state, pairs[n]),
                Some(n) if n == pairs.len() => state[d].clone(),
                Some(n) => self.slope(&state[d], n - pairs.len() - 1),
            })
        });
        let mut rest = all.split_off(d);
        let mut warm = rest.split_off(pairs.len());
        let slope = if has_heat { warm.split_off(1) } else { vec![] };
        Factors { velocity: all, rotation: rest, temperature: warm.pop(), slope }
    }

    /// du/dt and dT/dt without viscosity and conduction, and the largest sum over directions of the speed at a particle.
    pub fn rates(&self, state: &[Spectrum]) -> (State, f64) {
        let factors = self.factors(state);
        let mut rates = self.forces(state, &factors);
        self.project(&mut rates[..self.dimension()]);
        let speed = |i: usize| factors.velocity.iter().map(|u| u[i].abs()).sum();
        (rates, (0..self.transform.points()).map(speed).fold(0.0, f64::max))
    }

    /// The same before it is made free of divergence.
    fn forces(&self, state: &[Spectrum], factors: &Factors) -> State {
        let (d, points) = (self.dimension(), self.transform.points());
        let Factors { velocity: u, rotation, temperature, slope } = factors;
        let mut products = vec![vec![0.0; points]; d];
        for ((a, b), w) in self.pairs().into_iter().zip(rotation) {
            for i in 0..points {
                products[a][i] += u[b][i] * w[i];
                products[b][i] -= u[a][i] * w[i];
            }
        }
        if let Some(t) = temperature {
            let along = (0..points).map(|i| (0..d).map(|a| u[a][i] * slope[a][i]).sum()).collect();
            products.push(along);
            products.extend((0..d).map(|a| u[a].iter().zip(t).map(|(u, t)| u * t).collect::<Vec<f64>>()));
        }
        let take = |n: usize| self.transform.forwards(products[n].clone());
        let mut rates = self.transform.each(products.len(), take);
        if temperature.is_some() {
            let fluxes = rates.split_off(d + 1);
            for k in 0..self.transform.modes() {
                let divergence: Complex64 = (0..d).map(|a| turned(self.symbols.first[a][k], fluxes[a][k])).sum();
                rates[d][k] = -0.5 * (rates[d][k] + divergence);
            }
        }
        for a in 0..d {
            rates[a][0] += self.materials.force[a] * points as f64;
            if let Some(Buoyancy { by, at }) = &self.materials.buoyancy {
                rates[a][0] -= by[a] * at * points as f64;
                let warmth = state.get(d).into_iter().flatten();
                rates[a].iter_mut().zip(warmth).for_each(|(rate, t)| *rate += by[a] * t);
            }
        }
        rates
    }

    /// Adds what cotangents `bar` of the rates are of the state, and of the materials.
    pub fn rates_back(&self, state: &[Spectrum], bar: &[Spectrum], to: &mut State, of: &mut OfMaterials) {
        let (d, points, modes) = (self.dimension(), self.transform.points(), self.transform.modes());
        let pairs = self.pairs();
        let Factors { velocity: u, rotation, temperature, slope } = self.factors(state);
        let mut bar = bar.to_vec();
        self.project(&mut bar[..d]);
        for a in 0..d {
            of.force[a] += bar[a][0].re;
            if let Some(buoyancy) = &self.materials.buoyancy {
                let by = buoyancy.by[a];
                to.get_mut(d).into_iter().flatten().zip(&bar[a]).for_each(|(t, g)| *t += by * g);
            }
        }
        // Those of the products at the particles: rotation, transport along the slope, and fluxes of heat.
        let has_heat = temperature.is_some();
        let g = self.transform.each(if has_heat { 2 * d + 1 } else { d }, |n| {
            self.transform.back(match n.checked_sub(d) {
                None => bar[n].clone(),
                Some(0) => bar[d].iter().map(|z| -0.5 * z).collect(),
                Some(a) => self.slope(&bar[d], a - 1).into_iter().map(|z| 0.5 * z).collect(),
            })
        });
        // Of the factors: velocity, rotation, temperature and its slope.
        let mut back = vec![vec![0.0; points]; d];
        for (&(a, b), w) in pairs.iter().zip(&rotation) {
            for i in 0..points {
                back[b][i] += g[a][i] * w[i];
                back[a][i] -= g[b][i] * w[i];
            }
            back.push((0..points).map(|i| g[a][i] * u[b][i] - g[b][i] * u[a][i]).collect());
        }
        if let Some(t) = &temperature {
            let (along, flux) = (&g[d], &g[d + 1..]);
            for a in 0..d {
                (0..points).for_each(|i| back[a][i] += along[i] * slope[a][i] + flux[a][i] * t[i]);
            }
            back.push((0..points).map(|i| (0..d).map(|a| flux[a][i] * u[a][i]).sum()).collect());
            back.extend((0..d).map(|a| along.iter().zip(&u[a]).map(|(s, u)| s * u).collect::<Vec<f64>>()));
        }
        let spectra = self.transform.each(back.len(), |n| self.transform.forwards(back[n].clone()));
        let mut add = |field: usize, factor: Option<(usize, f64)>, spectrum: &Spectrum| {
            let to = &mut to[field];
            match factor {
                None => (0..modes).for_each(|k| to[k] += spectrum[k]),
                // The transpose of i d is -i d.
                Some((a, sign)) => {
                    (0..modes).for_each(|k| to[k] -= turned(sign * self.symbols.first[a][k], spectrum[k]));
                }
            }
        };
        (0..d).for_each(|a| add(a, None, &spectra[a]));
        for (n, &(a, b)) in pairs.iter().enumerate() {
            add(b, Some((a, 1.0)), &spectra[d + n]);
            add(a, Some((b, -1.0)), &spectra[d + n]);
        }
        if has_heat {
            let warm = &spectra[d + pairs.len()..];
            add(d, None, &warm[0]);
            (0..d).for_each(|a| add(d, Some((a, 1.0)), &warm[1 + a]));
        }
    }

    /// The pressure per density at the particles; its mean is 0.
    pub fn pressure(&self, state: &[Spectrum]) -> Vec<f64> {
        let d = self.dimension();
        let factors = self.factors(state);
        let forces = self.forces(state, &factors);
        // i d (p + u^2/2) = what the projection takes away: i d_a h = d_a (sum d_b g_b) / d^2.
        let head = |k: usize| {
            let sum: Complex64 = (0..d).map(|a| forces[a][k] * self.symbols.first[a][k]).sum();
            turned(-self.symbols.inverse[k], sum)
        };
        let mut pressure = self.transform.back((0..self.transform.modes()).map(head).collect());
        for u in factors.velocity {
            pressure.iter_mut().zip(u).for_each(|(p, u)| *p -= 0.5 * u * u);
        }
        let mean = pressure.iter().sum::<f64>() / pressure.len() as f64;
        pressure.iter_mut().for_each(|p| *p -= mean);
        pressure
    }

    /// Kinetic energy per mass, mean over the box.
    pub fn energy(&self, state: &[Spectrum]) -> f64 {
        self.mean_square(&state[..self.dimension()], |_| 0.5)
    }

    /// What viscosity takes from the energy, per time.
    pub fn dissipation(&self, state: &[Spectrum]) -> f64 {
        self.mean_square(&state[..self.dimension()], |k| self.materials.viscosity * self.symbols.laplacian[k])
    }

    /// The mean over the box of the sum of squares of some fields.
    pub fn mean_square(&self, fields: &[Spectrum], weight: impl Fn(usize) -> f64) -> f64 {
        fields.iter().map(|u| self.transform.product(u, u, &weight)).sum::<f64>() / self.transform.points() as f64
    }
}
