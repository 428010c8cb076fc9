//! Disordered states of the consistent formulation for which every term of every operator counts.

use candle_core::{Device, Tensor, Var};
use hydrograd::config::device::Compute;
use hydrograd::config::scene::Config;
use hydrograd::design::Problem;
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::particles::{tag, Domain};
use hydrograd::scene::Scene;
use hydrograd::sph::consistent::arrangement::{Isotropic, Shift};
use hydrograd::sph::consistent::layout::Layout;
use hydrograd::sph::consistent::{Consistent, Fits};
use hydrograd::sph::flow::{Flow, Heat};
use hydrograd::sph::kernels::{Kernel, KernelName};
use hydrograd::sph::laws::buoyancy::Buoyancy;
use hydrograd::sph::laws::equation_of_state::EquationOfState;
use hydrograd::sph::solver::{Snapshot, Solver, TensorSolver};
use hydrograd::sph::Sweeps;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Particle spacing of the boxes.
pub const DX: f64 = 0.05;
/// Strength and limit of their shift: at this disorder the limit holds back some particles and not others.
const SHIFT: (f64, f64) = (0.4, 0.05);

/// A model and a state of it in f64, whatever the model's precision.
pub struct Case<R> {
    pub name: String,
    pub model: Arc<Consistent<R>>,
    pub state: Vec<f64>,
}

impl<R: Sweeps> Case<R> {
    pub fn snapshot(&self, state: &[f64]) -> Snapshot<R> {
        let first = Snapshot::first(&self.model, state.iter().map(|&x| R::of(x)).collect());
        // The first step of all has no rates behind it.
        Snapshot { step: self.model.layout.rates as usize, ..first }
    }

    /// The state so many plain steps behind another.
    pub fn run(&self, state: &[f64], steps: usize) -> Vec<f64> {
        let mut solver = Solver::restore(self.model.clone(), &self.snapshot(state)).unwrap();
        (0..steps).for_each(|_| solver.advance().unwrap());
        solver.state.iter().map(|x| x.f64()).collect()
    }

    /// The state so many taped steps behind the case's, and the derivative of its product with `bar`.
    pub fn taped(&self, compute: impl Into<Compute>, steps: usize, bar: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let snapshot = self.snapshot(&self.state);
        let shape = (self.model.layout.state_rows(), self.model.particles());
        let mut tape = TensorSolver::restore(self.model.clone(), &snapshot, compute).unwrap();
        let first = Var::from_tensor(&Tensor::from_slice(&snapshot.state, shape, &Device::Cpu).unwrap()).unwrap();
        let mut state = first.as_tensor().clone();
        for _ in 0..steps {
            state = tape.advance(&state).unwrap();
        }
        let bar: Vec<R> = bar.iter().map(|&x| R::of(x)).collect();
        let bar = Tensor::from_vec(bar, shape, &Device::Cpu).unwrap();
        let gradients = state.mul(&bar).unwrap().sum_all().unwrap().backward().unwrap();
        (numbers::<R>(&state), numbers::<R>(gradients.get(&first).unwrap()))
    }

    /// Random numbers, row by row in units that fit what stands there: a spacing for places, 1 for everything else.
    pub fn random(&self, name: &str) -> Vec<f64> {
        let (n, l) = (self.model.particles(), self.model.layout);
        let spacing = self.model.fits.spacing;
        let mut normal = Normal::new(stream(9, name));
        let mut random = Vec::with_capacity(self.state.len());
        for row in 0..l.state_rows() {
            for i in 0..n {
                // Mirror images and normals stand where the fluid has its velocity.
                let place = row < l.pressure() && (row < l.dimension || !self.model.is_fluid(i));
                random.push(normal.next() * if place { spacing } else { 1.0 });
            }
        }
        random
    }
}

pub fn numbers<R: Sweeps>(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1::<R>().unwrap().iter().map(|x| x.f64()).collect()
}

/// The wall-free model of a box with so many particles along each side.
pub fn box_model<R: Sweeps>(dimension: usize, per_side: usize, heat: bool, shift: Shift) -> Arc<Consistent<R>> {
    let n = per_side.pow(dimension as u32);
    let one = R::of(1.0);
    let (density, velocity, viscosity, diffusivity) = (1.2, 1.0, 0.02, 0.03);
    let sound_speed = 10.0 * velocity;
    let domain = Domain { dimension, size: [per_side as f64 * DX; 3], periodic: [true; 3] };
    let equation_of_state = EquationOfState {
        reference_density: density,
        reference_pressure: density * sound_speed * sound_speed,
        background_pressure: 0.0,
        gamma: 1,
    };
    let dt = 0.5 * DX / (sound_speed + velocity);
    let flow = Flow {
        kernel: Kernel::new(KernelName::QuinticSpline, dimension, 0.8 * DX),
        viscosity: viscosity * density,
        heat: heat.then(|| Heat {
            conductivity: diffusivity * density,
            capacity: 1.0,
            reference: 1.0,
            inlet_below: f64::NEG_INFINITY,
            outlet_above: f64::INFINITY,
            wall_constant: vec![R::default(); n],
            wall_factor: vec![R::default(); n],
            materials: None,
        }),
        ..Flow::new(domain, vec![tag::FLUID; n], DX, equation_of_state, dt)
    };
    let fits = Fits {
        spacing: DX,
        sound_speed,
        velocity,
        viscosity,
        diffusivity: if heat { diffusivity } else { 0.0 },
        delta: 0.1,
        shift,
        weights: [one, one, one, R::default()].repeat(n),
        surface: vec![],
        dummies: vec![],
        quadrature: vec![one; n],
    };
    Arc::new(Consistent::new(flow, Layout { dimension, heat, rates: false }, fits))
}

pub fn isotropic() -> Shift {
    Shift::Isotropic(Isotropic { strength: SHIFT.0, limit: SHIFT.1, normals: Default::default() })
}

/// Vortices in a periodic box, with disorder and noise in every field.
pub fn vortices<R: Sweeps>(dimension: usize, heat: bool, shift: Shift) -> Case<R> {
    let per_side = if dimension == 2 { 12 } else { 8 };
    let name = format!("{dimension}D box, heat {heat}, {shift:?}");
    let model = box_model::<R>(dimension, per_side, heat, shift);
    let (n, l) = (model.particles(), model.layout);
    let mut normal = Normal::new(stream(dimension as u64, "vortices"));
    let mut state = vec![0.0; l.state_rows() * n];
    let length = per_side as f64 * DX;
    for i in 0..n {
        let cell = [i % per_side, i / per_side % per_side, i / (per_side * per_side)];
        let mut phase = [0.0; 3];
        for k in 0..dimension {
            let x = ((cell[k] as f64 + 0.5 + 0.1 * normal.next()) * DX).rem_euclid(length);
            state[k * n + i] = x;
            phase[k] = TAU * x / length;
        }
        let [x, y, z] = phase;
        let velocity = [x.sin() * y.cos() * z.cos(), -x.cos() * y.sin() * z.cos(), 0.0];
        for k in 0..dimension {
            state[(l.velocity() + k) * n + i] = velocity[k] + 0.05 * normal.next();
        }
        state[l.pressure() * n + i] = 0.25 * ((2.0 * x).cos() + (2.0 * y).cos()) + 0.05 * normal.next();
        if heat {
            state[l.temperature() * n + i] = 0.3 * x.cos() + 0.02 * normal.next();
        }
    }
    Case { name, model, state }
}

/// A box whose step is velocity Verlet's.
pub fn verlet<R: Sweeps>(dimension: usize, heat: bool) -> Case<R> {
    let case = vortices::<R>(dimension, heat, isotropic());
    let Consistent { flow, layout, fits, .. } = Arc::into_inner(case.model).unwrap();
    let model = Consistent::new(flow, Layout { rates: true, ..layout }, fits);
    let mut state = case.state;
    let mut normal = Normal::new(stream(dimension as u64, "rates"));
    state.resize_with(model.layout.state_rows() * model.particles(), || normal.next());
    Case { name: format!("{}, verlet", case.name), model: Arc::new(model), state }
}

/// The same with buoyancy.
pub fn buoyant<R: Sweeps>(case: Case<R>) -> Case<R> {
    let Consistent { flow, layout, fits, .. } = Arc::into_inner(case.model).unwrap();
    let buoyancy = Buoyancy::new(1.7, &[0.7, -2.3, 1.1], 0.04);
    let model = Consistent::new(Flow { buoyancy, ..flow }, layout, fits);
    Case { name: format!("{}, buoyancy", case.name), model: Arc::new(model), ..case }
}

/// The heated channel of the defaults over a curved wall, with settings.
pub fn channel<R: Sweeps>(sets: &[&str]) -> (Config, Problem<R>) {
    let curved = ["design.shape=sine", "design.amplitude=0.015"];
    let sets: Vec<String> = curved.iter().chain(sets).map(|set| set.to_string()).collect();
    let config = Config::load(None, None, &sets).unwrap_or_else(|e| panic!("{e}")).config;
    let problem = Scene::<R>::from_config(&config).unwrap().design.unwrap();
    (config, problem)
}

/// That channel with disorder and noise in every field of the fluid.
pub fn noisy_channel<R: Sweeps>(sets: &[&str]) -> Case<R> {
    let (config, problem) = channel::<R>(sets);
    let heights = problem.parametrisation.column_heights(&problem.first);
    let mut state = problem.deformation.state::<f64>(&heights);
    let model = problem.model.of_type::<Consistent<R>>().unwrap().clone();
    let (n, l) = (model.particles(), model.layout);
    let mut normal = Normal::new(stream(3, "channel"));
    for i in (0..n).filter(|&i| problem.model.is_fluid(i)) {
        for k in 0..2 {
            state[k * n + i] += 0.06 * config.resolution.dx * normal.next();
            state[(l.velocity() + k) * n + i] += 0.05 * normal.next();
        }
        state[i] = state[i].rem_euclid(config.channel.length);
        state[l.pressure() * n + i] = 0.3 * normal.next();
        state[l.temperature() * n + i] = 0.1 * normal.next();
        (l.last_rates()..l.state_rows()).for_each(|row| state[row * n + i] = normal.next());
    }
    Case { name: format!("channel {sets:?}"), model: Arc::new(model), state }
}
