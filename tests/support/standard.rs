//! Operators of the standard method that the library has as sweeps of a whole step only, as nodes of candle's graph of their own.

use candle_core::{Result, Shape};
use hydrograd::numerics::candle::Operator;
use hydrograd::sph::pairs::stride;
use hydrograd::sph::standard::chain::{Chain, Masses, Step};
use hydrograd::sph::standard::pair_cache::PairCache;
use hydrograd::sph::standard::records::{record_fields, record_temperature};
use hydrograd::sph::standard::Sweeps;
use std::sync::Arc;

/// moved `[M, N]`, primitives `[C, N]` -> rates `[A, N]`, zero for walls.
pub struct Rates<R: Sweeps>(pub Arc<Chain<R>>);

/// moved `[M, N]`, rates `[A, N]` -> state `[F, N]`.
pub struct Assemble<R: Sweeps>(pub Arc<Chain<R>>);

/// moved `[M, N]`, primitives `[C, N]`, rates `[A, N]` -> state `[F, N]`, of a density that evolves.
pub struct AssembleEvolved<R: Sweeps>(pub Arc<Chain<R>>);

/// The pairs that the density pass keeps, and the records of particles whose primitives are known.
fn keep<R: Sweeps>(step: &Step<R>, moved: &[R], primitives: &[R], kept: &mut PairCache<R>) {
    let (n, l) = (step.model.particles(), step.model.layout);
    let d = l.dimension;
    R::density(step, moved, kept, &mut vec![R::default(); n]);
    let mass = Masses::new(&step.model, moved);
    let width = stride(record_fields(d, l.transport, l.heat));
    for (i, record) in kept.records.chunks_mut(width).enumerate() {
        let density = primitives[i];
        for k in 0..d {
            record[k] = moved[k * n + i];
            record[d + 2 + k] = primitives[(l.primitive_velocity() + k) * n + i];
            if l.transport {
                record[2 * d + 2 + k] = primitives[(l.primitive_shift() + k) * n + i];
            }
        }
        record[d] = mass.of(i) / density;
        record[d + 1] = density;
        if l.heat {
            let at = record_temperature(d, l.transport);
            record[at] = primitives[l.primitive_temperature() * n + i];
            record[at + 1] = moved[l.moved_old_temperature() * n + i];
        }
    }
}

impl<R: Sweeps> Operator<2> for Rates<R> {
    type Real = R;
    const NAME: &'static str = "rates";

    fn forward(&self, [moved, primitives]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let step = &self.0.step;
        let (rows, n) = (step.model.layout.rate_rows(), step.model.particles());
        let mut rates = vec![R::default(); rows * n];
        let mut kept = self.0.kept();
        keep(step, moved, primitives, &mut kept);
        R::rates(step, moved, &kept, &mut rates);
        Ok((rates, (rows, n).into()))
    }

    fn adjoint(&self, [moved, _]: [&[R]; 2], rates: &[R], bar: &[R], _: [bool; 2]) -> Result<[Option<Vec<R>>; 2]> {
        let step = &self.0.step;
        let mut moved_bar = self.0.moved_bar();
        let mut primitives_bar = vec![R::default(); step.model.layout.primitive_rows() * step.model.particles()];
        R::rates_bar(step, moved, &self.0.kept(), rates, bar, &mut moved_bar, &mut primitives_bar);
        Ok([Some(moved_bar), Some(primitives_bar)])
    }
}

fn assembled<R: Sweeps>(step: &Step<R>, moved: &[R], primitives: &[R], rates: &[R]) -> (Vec<R>, Shape) {
    let (rows, n) = (step.model.layout.state_rows(), step.model.particles());
    let mut state = vec![R::default(); rows * n];
    R::assemble(step, moved, primitives, rates, &mut state);
    (state, (rows, n).into())
}

/// Cotangents of the moved state and of the rates.
fn assembled_bar<R: Sweeps>(chain: &Chain<R>, moved: &[R], bar: &[R]) -> (Vec<R>, Vec<R>) {
    let step = &chain.step;
    let mut moved_bar = chain.moved_bar();
    let mut rates_bar = vec![R::default(); step.model.layout.rate_rows() * step.model.particles()];
    R::assemble_bar(step, moved, bar, &mut moved_bar, &mut rates_bar);
    (moved_bar, rates_bar)
}

impl<R: Sweeps> Operator<2> for Assemble<R> {
    type Real = R;
    const NAME: &'static str = "assemble";

    fn forward(&self, [moved, rates]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        Ok(assembled(&self.0.step, moved, &[], rates))
    }

    fn adjoint(&self, [moved, _]: [&[R]; 2], _: &[R], bar: &[R], _: [bool; 2]) -> Result<[Option<Vec<R>>; 2]> {
        let (moved_bar, rates_bar) = assembled_bar(&self.0, moved, bar);
        Ok([Some(moved_bar), Some(rates_bar)])
    }
}

impl<R: Sweeps> Operator<3> for AssembleEvolved<R> {
    type Real = R;
    const NAME: &'static str = "assemble evolved";

    fn forward(&self, [moved, primitives, rates]: [&[R]; 3], _: [&Shape; 3]) -> Result<(Vec<R>, Shape)> {
        Ok(assembled(&self.0.step, moved, primitives, rates))
    }

    fn adjoint(&self, [moved, ..]: [&[R]; 3], _: &[R], bar: &[R], _: [bool; 3]) -> Result<[Option<Vec<R>>; 3]> {
        let (moved_bar, rates_bar) = assembled_bar(&self.0, moved, bar);
        let (l, n) = (self.0.step.model.layout, self.0.step.model.particles());
        let mut primitives_bar = vec![R::default(); l.primitive_rows() * n];
        primitives_bar[..n].copy_from_slice(&bar[l.state_density() * n..][..n]);
        Ok([Some(moved_bar), Some(primitives_bar), Some(rates_bar)])
    }
}
