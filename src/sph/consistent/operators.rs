//! The operators of a step on candle's graph, and in reused buffers.

use super::blocks::{width, Blocks, Place};
use super::composed::Known;
use super::drive;
use super::geometry::Geometry;
use super::kept::Kept;
use super::kinds::rows;
use super::model::Consistent;
use super::stencil::monomials;
use super::sweeps::Sweeps;
use crate::numerics::candle::{apply1, apply2, apply3, Operator};
use crate::numerics::lanes::Real;
use crate::numerics::sweep::{self, copied, copy, run_each};
use crate::sph::laws::conduction;
use crate::sph::own::Own;
use crate::sph::pace::TimeSteps;
use candle_core::{Result, Shape, Tensor};
use std::sync::{Arc, Mutex, MutexGuard};

/// Data that the operators of one step share: constants, tables and cached results.
#[derive(Debug)]
pub struct Chain<R: Real> {
    pub model: Arc<Consistent<R>>,
    pub blocks: Arc<Blocks>,
    times: TimeSteps,
    kept: Mutex<Kept<R>>,
}

impl<R: Real> Chain<R> {
    pub fn new(model: Arc<Consistent<R>>, blocks: Arc<Blocks>, times: TimeSteps) -> Arc<Self> {
        let kept = Mutex::new(model.kept.take().unwrap_or_default());
        Arc::new(Self { model, blocks, times, kept })
    }

    fn geometry(&self) -> Geometry<'_, R> {
        Geometry { model: &self.model, blocks: &self.blocks, times: self.times }
    }

    fn kept(&self) -> MutexGuard<'_, Kept<R>> {
        self.kept.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn state_rows(&self) -> usize {
        self.model.layout.state_rows()
    }

    /// The shape of the derivatives of `fields` fields.
    fn shape(&self, fields: usize) -> [usize; 3] {
        [self.blocks.fluid.blocks(), rows(self.model.layout.dimension, fields), width::<R>()]
    }
}

impl<R: Real> Drop for Chain<R> {
    fn drop(&mut self) {
        let kept = std::mem::take(self.kept.get_mut().unwrap_or_else(|e| e.into_inner()));
        self.model.kept.give_back(kept);
    }
}

fn zeros<R: Real>(shape: impl IntoIterator<Item = usize>) -> Vec<R> {
    sweep::zeros(shape.into_iter().product())
}

/// Cotangents of an operator's inputs.
type Bars<R, const N: usize> = Result<[Option<Vec<R>>; N]>;

/// state `[F, N]` -> known `[F, N]`: the state with the values of dummy particles filled in.
pub struct WallValues<R: Sweeps>(pub Arc<Chain<R>>);
/// known -> derivatives of all fields.
pub struct Derivatives<R: Sweeps>(pub Arc<Chain<R>>);
/// known, derivatives -> new pressure of the fluid, `[1, N]`.
pub struct Continuity<R: Sweeps>(pub Arc<Chain<R>>);
/// known, new pressure -> new pressure with the values of dummy particles filled in.
pub struct WallPressure<R: Sweeps>(pub Arc<Chain<R>>);
/// known, new pressure -> its derivatives, followed by the pressure itself.
pub struct PressureGradient<R: Sweeps>(pub Arc<Chain<R>>);
/// known, derivatives, pressure gradient -> state.
pub struct Advance<R: Sweeps>(pub Arc<Chain<R>>);
/// derivatives -> mass of fluid particles in sums over a cross-section, rho V times the quadrature weight, `[1, N]`.
pub struct Masses<R: Sweeps>(pub Arc<Chain<R>>);
/// known, derivatives, masses -> [`heating`] up to a given x, `[]`.
pub struct Heating<R: Sweeps>(pub Arc<Chain<R>>, pub f64);
/// state, masses -> state after the kick of the drive.
pub struct Drive<R: Sweeps>(pub Arc<Chain<R>>);
/// state -> the same with the values of copies that the ranks have that own them.
struct Copies<R: Sweeps>(Arc<Chain<R>>);

impl<R: Sweeps> Operator<1> for WallValues<R> {
    type Real = R;
    const NAME: &'static str = "wall values";

    fn forward(&self, [state]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let mut known = copied(state);
        self::known(&self.0.geometry(), &mut self.0.kept(), &mut known);
        refresh_known(&self.0.geometry(), &mut known);
        Ok((known, (self.0.state_rows(), self.0.model.particles()).into()))
    }

    fn adjoint(&self, _: [&[R]; 1], known: &[R], bar: &[R], _: [bool; 1]) -> Bars<R, 1> {
        let mut state_bar = copied(bar);
        known_bar(&self.0.geometry(), &self.0.kept(), known, &mut state_bar);
        Ok([Some(state_bar)])
    }
}

impl<R: Sweeps> Operator<1> for Derivatives<R> {
    type Real = R;
    const NAME: &'static str = "derivatives";

    fn forward(&self, [known]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let mut derivatives = Vec::new();
        R::derivatives(&self.0.geometry(), &mut self.0.kept(), known, &mut derivatives);
        Ok((derivatives, Shape::from(self.0.shape(self.0.model.layout.fields()).to_vec())))
    }

    fn adjoint(&self, [known]: [&[R]; 1], derivatives: &[R], bar: &[R], _: [bool; 1]) -> Bars<R, 1> {
        let (mut bar, mut known_bar) = (copied(bar), zeros([known.len()]));
        R::derivatives_bar(&self.0.geometry(), &mut self.0.kept(), known, derivatives, &mut bar, &mut known_bar);
        Ok([Some(known_bar)])
    }
}

impl<R: Sweeps> Operator<2> for Continuity<R> {
    type Real = R;
    const NAME: &'static str = "continuity";

    fn forward(&self, [known, derivatives]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let n = self.0.model.particles();
        let mut pressure = zeros([n]);
        R::continuity(&self.0.geometry(), known, derivatives, &self.0.kept(), &mut pressure);
        Ok((pressure, (1, n).into()))
    }

    fn adjoint(&self, [known, derivatives]: [&[R]; 2], _: &[R], bar: &[R], _: [bool; 2]) -> Bars<R, 2> {
        let (mut known_bar, mut derivatives_bar) = (zeros([known.len()]), zeros([derivatives.len()]));
        let geometry = self.0.geometry();
        R::continuity_bar(&geometry, known, derivatives, &self.0.kept(), bar, &mut known_bar, &mut derivatives_bar);
        Ok([Some(known_bar), Some(derivatives_bar)])
    }
}

impl<R: Sweeps> Operator<2> for WallPressure<R> {
    type Real = R;
    const NAME: &'static str = "wall pressure";

    fn forward(&self, [known, pressure]: [&[R]; 2], shapes: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let mut filled = copied(pressure);
        R::fill(&self.0.geometry(), known, &mut filled, &mut self.0.kept(), false);
        self.0.model.refresh_walls(&mut filled);
        Ok((filled, shapes[1].clone()))
    }

    fn adjoint(&self, [known, _]: [&[R]; 2], filled: &[R], bar: &[R], _: [bool; 2]) -> Bars<R, 2> {
        let (mut pressure_bar, mut known_bar) = (copied(bar), zeros([known.len()]));
        R::fill_bar(&self.0.geometry(), known, filled, &self.0.kept(), false, &mut pressure_bar, &mut known_bar);
        Ok([Some(known_bar), Some(pressure_bar)])
    }
}

impl<R: Sweeps> Operator<2> for PressureGradient<R> {
    type Real = R;
    const NAME: &'static str = "pressure gradient";

    fn forward(&self, [known, pressure]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let mut gradient = Vec::new();
        R::pressure_gradient(&self.0.geometry(), &mut self.0.kept(), known, pressure, &mut gradient);
        Ok((gradient, Shape::from(self.0.shape(1).to_vec())))
    }

    fn adjoint(&self, [known, pressure]: [&[R]; 2], gradient: &[R], bar: &[R], _: [bool; 2]) -> Bars<R, 2> {
        let (mut known_bar, mut pressure_bar) = (zeros([known.len()]), zeros([pressure.len()]));
        let geometry = self.0.geometry();
        let mut bar = copied(bar);
        R::pressure_gradient_bar(&geometry, &self.0.kept(), gradient, &mut bar, &mut known_bar, &mut pressure_bar);
        Ok([Some(known_bar), Some(pressure_bar)])
    }
}

impl<R: Sweeps> Operator<3> for Advance<R> {
    type Real = R;
    const NAME: &'static str = "advance";

    fn forward(&self, [known, derivatives, gradient]: [&[R]; 3], _: [&Shape; 3]) -> Result<(Vec<R>, Shape)> {
        let mut state = zeros([known.len()]);
        R::advance(&self.0.geometry(), known, derivatives, gradient, &mut state);
        Ok((state, (self.0.state_rows(), self.0.model.particles()).into()))
    }

    fn adjoint(&self, [known, derivatives, gradient]: [&[R]; 3], state: &[R], bar: &[R], _: [bool; 3]) -> Bars<R, 3> {
        let mut bars = [zeros([known.len()]), zeros([derivatives.len()]), zeros([gradient.len()])];
        let [known_bar, derivatives_bar, gradient_bar] = &mut bars;
        let geometry = self.0.geometry();
        R::advance_bar(&geometry, known, derivatives, state, bar, known_bar, derivatives_bar, gradient_bar);
        Ok(bars.map(Some))
    }
}

impl<R: Sweeps> Operator<1> for Masses<R> {
    type Real = R;
    const NAME: &'static str = "masses";

    fn forward(&self, [derivatives]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let geometry = self.0.geometry();
        let n = self.0.model.particles();
        let mut masses = zeros([n]);
        self::masses(&geometry, derivatives, &mut masses);
        Ok((masses, (1, n).into()))
    }

    fn adjoint(&self, [derivatives]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Bars<R, 1> {
        let geometry = self.0.geometry();
        let mut derivatives_bar = zeros([derivatives.len()]);
        each_mass(&geometry, |i, at, factor| derivatives_bar[at] = bar[i] * factor);
        Ok([Some(derivatives_bar)])
    }
}

impl<R: Sweeps> Operator<2> for Drive<R> {
    type Real = R;
    const NAME: &'static str = "drive";

    fn forward(&self, [state, masses]: [&[R]; 2], shapes: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let mut after = copied(state);
        drive::forward(&self.0.geometry(), masses, &mut after);
        Ok((after, shapes[0].clone()))
    }

    fn adjoint(&self, [state, masses]: [&[R]; 2], after: &[R], bar: &[R], _: [bool; 2]) -> Bars<R, 2> {
        let (mut state_bar, mut masses_bar) = (copied(bar), zeros([masses.len()]));
        drive::backward(&self.0.geometry(), masses, state, after, &mut state_bar, &mut masses_bar);
        Ok([Some(state_bar), Some(masses_bar)])
    }
}

/// Calls `each` with the index of each fluid particle, the place of its volume in the derivatives, and the volume's
/// factor.
fn each_mass<R: Real>(geometry: &Geometry<'_, R>, mut each: impl FnMut(usize, usize, R)) {
    let (l, density) = (geometry.model.layout, geometry.model.equation_of_state.reference_density);
    let row = l.fields() * monomials(l.dimension);
    for (place, i) in geometry.blocks.fluid.each() {
        let at = Place::of::<R>(place, rows(l.dimension, l.fields())).row(row);
        each(i, at, R::of(density) * geometry.model.fits.quadrature[i]);
    }
}

/// Masses of the fluid particles in sums over a cross-section, `[N]`; 0 for walls.
pub fn masses<R: Real>(geometry: &Geometry<'_, R>, derivatives: &[R], masses: &mut [R]) {
    each_mass(geometry, |i, at, factor| masses[i] = derivatives[at] * factor);
}

/// Calls `each` for each conducting fluid particle with x < `until`, with its index and the place of its derivatives.
fn each_conducting<R: Real>(geometry: &Geometry<'_, R>, known: &[R], until: f64, mut each: impl FnMut(usize, Place)) {
    let l = geometry.model.layout;
    for (place, i) in geometry.blocks.fluid.each() {
        if conduction::conducts(geometry.model, known[i]) && known[i].f64() < until {
            each(i, Place::of::<R>(place, rows(l.dimension, l.fields())));
        }
    }
}

/// The rate alpha lap T + w.grad T, where `derivative` returns the rows of the derivatives. `slope` is called with each
/// row that the rate depends on, and the derivative with respect to it.
fn conduction_rate<R: Real>(
    geometry: &Geometry<'_, R>,
    derivative: impl Fn(usize) -> f64,
    mut slope: impl FnMut(usize, f64),
) -> f64 {
    let (l, fits) = (geometry.model.layout, &geometry.model.fits);
    let (d, fields) = (l.dimension, l.fields());
    let q = monomials(d);
    let mut rate = 0.0;
    for a in 0..d {
        let spread = (d + 1) * q + super::stencil::quadratic(d, a, a);
        let (shift, along) = (fields * q + 1 + a, (d + 1) * q + a);
        let diffusivity = fits.diffusivity / fits.spacing.powi(2);
        rate += diffusivity * derivative(spread) + derivative(shift) * derivative(along) / fits.spacing;
        slope(spread, diffusivity);
        slope(shift, derivative(along) / fits.spacing);
        slope(along, derivative(shift) / fits.spacing);
    }
    rate
}

impl<R: Sweeps> Operator<1> for Copies<R> {
    type Real = R;
    const NAME: &'static str = "copies";

    fn forward(&self, [state]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let mut state = copied(state);
        self.0.model.refresh(&mut state);
        Ok((state, shape.clone()))
    }

    /// A cotangent is that of own particles only, see [`crate::sph::spread_gradient`].
    fn adjoint(&self, _: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Bars<R, 1> {
        Ok([Some(copied(bar))])
    }
}

/// The heat that conduction brings to the conducting fluid with x < `until`: the sum of mass times the rate
/// alpha lap T + w.grad T over its particles. `masses` are those of [`masses`].
pub fn heating<R: Real>(geometry: &Geometry<'_, R>, known: &[R], derivatives: &[R], masses: &[R], until: f64) -> f64 {
    let mut sum = 0.0;
    each_conducting(geometry, known, until, |i, at| {
        sum += masses[i].f64() * conduction_rate(geometry, |k| derivatives[at.row(k)].f64(), |_, _| ());
    });
    sum
}

impl<R: Sweeps> Operator<3> for Heating<R> {
    type Real = R;
    const NAME: &'static str = "heating";

    fn forward(&self, [known, derivatives, masses]: [&[R]; 3], _: [&Shape; 3]) -> Result<(Vec<R>, Shape)> {
        Ok((vec![R::of(heating(&self.0.geometry(), known, derivatives, masses, self.1))], ().into()))
    }

    fn adjoint(&self, [known, derivatives, masses]: [&[R]; 3], _: &[R], bar: &[R], _: [bool; 3]) -> Bars<R, 3> {
        let geometry = self.0.geometry();
        let (mut derivatives_bar, mut masses_bar) = (zeros([derivatives.len()]), zeros([masses.len()]));
        let bar = bar[0].f64();
        each_conducting(&geometry, known, self.1, |i, at| {
            let mass_bar = bar * masses[i].f64();
            let slope = |k: usize, by: f64| derivatives_bar[at.row(k)] += R::of(mass_bar * by);
            masses_bar[i] = R::of(bar * conduction_rate(&geometry, |k| derivatives[at.row(k)].f64(), slope));
        });
        // An infinitesimal change of positions does not change which particles conduct.
        Ok([Some(zeros([known.len()])), Some(derivatives_bar), Some(masses_bar)])
    }
}

/// The evaluated fields of a state, on the graph.
pub fn look<R: Sweeps>(chain: &Arc<Chain<R>>, state: &Tensor) -> Result<Known> {
    let known = apply1(WallValues(chain.clone()), state)?;
    let derivatives = apply1(Derivatives(chain.clone()), &known)?;
    let masses = apply1(Masses(chain.clone()), &derivatives)?;
    let heating = |until| apply3(Heating(chain.clone(), until), &known, &derivatives, &masses);
    let wall_heat = chain.model.wall_heat_until.map(heating).transpose()?;
    Ok(Known { known, masses, wall_heat })
}

/// Makes one step on the graph.
pub fn advance<R: Sweeps>(chain: &Arc<Chain<R>>, state: &Tensor) -> Result<Tensor> {
    let known = apply1(WallValues(chain.clone()), state)?;
    let derivatives = apply1(Derivatives(chain.clone()), &known)?;
    let pressure = apply2(Continuity(chain.clone()), &known, &derivatives)?;
    let filled = apply2(WallPressure(chain.clone()), &known, &pressure)?;
    let gradient = apply2(PressureGradient(chain.clone()), &known, &filled)?;
    let mut after = apply3(Advance(chain.clone()), &known, &derivatives, &gradient)?;
    if chain.model.drive.is_some() {
        after = apply2(Drive(chain.clone()), &after, &apply1(Masses(chain.clone()), &derivatives)?)?;
    }
    match chain.model.part {
        Some(_) => apply1(Copies(chain.clone()), &after),
        None => Ok(after),
    }
}

/// The buffers of a run without a graph.
#[derive(Debug, Default)]
pub struct Buffers<R> {
    pub known: Vec<R>,
    pub derivatives: Vec<R>,
    gradient: Vec<R>,
    pressure: Vec<R>,
    /// Filled only if a drive needs them.
    masses: Vec<R>,
    kept: Kept<R>,
}

impl<R: Sweeps> Buffers<R> {
    /// Forgets all fields, and keeps their memory.
    pub fn clear(&mut self) {
        let Self { known, derivatives, gradient, pressure, masses, kept } = self;
        [known, derivatives, gradient, pressure, masses].into_iter().for_each(Vec::clear);
        kept.clear();
    }

    /// Computes `known` and the derivatives of a state.
    pub fn look(&mut self, geometry: &Geometry<'_, R>, state: &[R]) {
        self.known.resize(state.len(), R::default());
        copy(state, &mut self.known);
        known(geometry, &mut self.kept, &mut self.known);
        refresh_known(geometry, &mut self.known);
        R::derivatives(geometry, &mut self.kept, &self.known, &mut self.derivatives);
    }

    /// Makes one step in place. Returns the acceleration of the drive, if there is one.
    pub fn advance(&mut self, geometry: &Geometry<'_, R>, state: &mut [R]) -> Option<f64> {
        self.look(geometry, state);
        self.pressure.resize(geometry.model.particles(), R::default());
        R::continuity(geometry, &self.known, &self.derivatives, &self.kept, &mut self.pressure);
        R::fill(geometry, &self.known, &mut self.pressure, &mut self.kept, false);
        geometry.model.refresh_walls(&mut self.pressure);
        R::pressure_gradient(geometry, &mut self.kept, &self.known, &self.pressure, &mut self.gradient);
        R::advance(geometry, &self.known, &self.derivatives, &self.gradient, state);
        geometry.model.drive?;
        self.masses.resize(geometry.model.particles(), R::default());
        masses(geometry, &self.derivatives, &mut self.masses);
        Some(drive::forward(geometry, &self.masses, state))
    }
}

/// Fills in the values of dummy particles in all fields, in place, see [`super::wall_values`].
fn known<R: Sweeps>(geometry: &Geometry<'_, R>, kept: &mut Kept<R>, known: &mut [R]) {
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    // Positions and mirror images are read while values are written.
    let (places, fields) = known[..l.last_rates() * n].split_at_mut(l.pressure() * n);
    R::fill(geometry, places, fields, kept, true);
}

/// What [`known`] has filled in, of dummy particles that other ranks own.
fn refresh_known<R: Sweeps>(geometry: &Geometry<'_, R>, known: &mut [R]) {
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    geometry.model.refresh_walls(&mut known[l.pressure() * n..l.last_rates() * n]);
}

/// The adjoint of [`known`], in place: maps the cotangent of `known` to that of the state.
fn known_bar<R: Sweeps>(geometry: &Geometry<'_, R>, kept: &Kept<R>, known: &[R], bar: &mut [R]) {
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    let (places_bar, fields_bar) = bar[..l.last_rates() * n].split_at_mut(l.pressure() * n);
    let (places, fields) = known[..l.last_rates() * n].split_at(l.pressure() * n);
    R::fill_bar(geometry, places, fields, kept, true, fields_bar, places_bar);
}

/// The derivatives of all fields, see [`super::derivatives`], followed by the shift.
pub fn derivatives<R: Real>(geometry: &Geometry<'_, R>, kept: &mut Kept<R>, known: &[R], derivatives: &mut Vec<R>) {
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    super::derivatives::forward(geometry, known, &known[l.dimension * n..l.last_rates() * n], kept, derivatives);
    super::shift::forward(geometry, known, kept, derivatives);
}

/// The adjoint of [`derivatives`]. It adds to `known_bar` and overwrites `bar`.
pub fn derivatives_bar<R: Real>(
    geometry: &Geometry<'_, R>,
    kept: &mut Kept<R>,
    known: &[R],
    derivatives: &[R],
    bar: &mut [R],
    known_bar: &mut [R],
) {
    super::shift::backward(geometry, known, kept, bar, known_bar);
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    let (position_bar, fields_bar) = known_bar[..l.last_rates() * n].split_at_mut(l.dimension * n);
    super::derivatives::backward(geometry, kept, derivatives, bar, position_bar, fields_bar);
}

/// The derivatives of the new pressure, see [`super::derivatives`], followed by the pressure itself.
pub fn pressure_gradient<R: Real>(
    geometry: &Geometry<'_, R>,
    kept: &mut Kept<R>,
    known: &[R],
    pressure: &[R],
    gradient: &mut Vec<R>,
) {
    super::derivatives::forward(geometry, known, pressure, kept, gradient);
    let d = geometry.model.layout.dimension;
    let (fluid, gradient) = (&geometry.blocks.fluid, Own::new(gradient));
    run_each(fluid.places, |place| {
        gradient.set(Place::of::<R>(place, rows(d, 1)).row(monomials(d)), pressure[fluid.particle(place)]);
    });
}

/// The adjoint of [`pressure_gradient`]. It overwrites `bar`.
pub fn pressure_gradient_bar<R: Real>(
    geometry: &Geometry<'_, R>,
    kept: &Kept<R>,
    gradient: &[R],
    bar: &mut [R],
    known_bar: &mut [R],
    pressure_bar: &mut [R],
) {
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    {
        let (fluid, bar, pressure_bar) = (&geometry.blocks.fluid, Own::new(bar), Own::new(pressure_bar));
        run_each(fluid.places, |place| {
            let at = Place::of::<R>(place, rows(d, 1)).row(monomials(d));
            pressure_bar.add(fluid.particle(place), bar.get(at));
            // The adjoint of the fits takes this row for the volume, which is not used here.
            bar.set(at, R::default());
        });
    }
    super::derivatives::backward(geometry, kept, gradient, bar, &mut known_bar[..d * n], pressure_bar);
}
