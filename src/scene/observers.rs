//! Observers that write the files of a simulation: its history, ParaView frames and checkpoints.

use super::particle_fields::ParticleFields;
use super::{checkpoint, Scene};
use crate::adjoint::run::{Observer, CHECK_EVERY};
use crate::io::csv::{read_columns, write_rows};
use crate::io::vtk::{ParticleFrame, VtkSeries};
use crate::io::FileError;
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::spread::Pieces;
use crate::sph::Sweeps;
use std::path::{Path, PathBuf};

/// About `count` evenly spaced steps of a run, and the last one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EvenSteps {
    every: usize,
    last: usize,
}

impl EvenSteps {
    /// The selection for a run of `steps` steps; empty if `count` is 0.
    pub fn new(steps: usize, count: usize) -> Self {
        Self { every: if count == 0 { 0 } else { steps.div_ceil(count) }, last: steps }
    }

    pub fn contains(&self, step: usize) -> bool {
        self.every > 0 && (step.is_multiple_of(self.every) || step == self.last)
    }
}

pub struct Frames {
    series: VtkSeries,
    steps: EvenSteps,
}

impl Frames {
    /// Frames in a folder; none if `count` is 0.
    pub fn new(folder: &Path, steps: usize, count: usize) -> Result<Option<Self>, FileError> {
        let new = || Ok(Self { series: VtkSeries::new(folder, "particles")?, steps: EvenSteps::new(steps, count) });
        (count > 0).then(new).transpose()
    }

    /// Discards the frames from `time` on.
    pub fn go_back(&mut self, time: f64) {
        self.series.go_back(time);
    }
}

impl<R: Sweeps> Observer<Sph<R>> for Frames {
    fn wants(&self, step: usize) -> bool {
        self.steps.contains(step)
    }
    fn see(&mut self, _: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if self.steps.contains(solver.step) {
            ParticleFields::of(solver)?.with_frame(|frame| self.series.write(frame))?;
        }
        Ok(())
    }
}

impl<R: Sweeps> Pieces<R> for Frames {
    fn wants(&self, step: usize) -> bool {
        self.steps.contains(step)
    }
    fn write(&mut self, solver: &mut Solver<R>, own: &[usize], numbers: Vec<u32>, ranks: &Ranks) -> anyhow::Result<()> {
        ParticleFields::of(solver)?.some(own).with_frame(|frame| {
            let piece = &ParticleFrame { number: &numbers, ..*frame };
            self.series.write_piece(piece, ranks.rank())?;
            ranks.wait();
            self.series.join(piece, ranks.size(), ranks.rank() == 0)
        })?;
        Ok(())
    }
}

/// Collects rows of a scene's figures, and updates `history.csv`.
pub struct History<'a, R> {
    scene: &'a Scene<R>,
    path: PathBuf,
    steps: EvenSteps,
    tell: &'a mut dyn FnMut(usize, &[f64]),
    pub rows: Vec<Vec<f64>>,
}

impl<'a, R: Sweeps> History<'a, R> {
    /// About `count` rows, written to a folder. `tell` is called with the step and the row.
    pub fn new(scene: &'a Scene<R>, folder: &Path, count: usize, tell: &'a mut dyn FnMut(usize, &[f64])) -> Self {
        let steps = EvenSteps::new(scene.steps, count);
        Self { scene, path: folder.join("history.csv"), steps, tell, rows: Vec::new() }
    }

    /// Starts with the rows of an interrupted run in its folder up to `step`, if they are readable.
    pub fn continued(mut self, from: &Path, step: usize) -> Self {
        let columns = read_columns(&from.join("history.csv"), &self.scene.history_columns()).unwrap_or_default();
        let count = columns.first().map_or(0, Vec::len);
        self.rows = (0..count).map(|k| columns.iter().map(|column| column[k]).collect()).collect();
        self.go_back(step);
        self
    }

    /// Discards the rows from `step` on.
    pub fn go_back(&mut self, step: usize) {
        let time = step as f64 * self.scene.model.dt;
        self.rows.retain(|row| row[0] < time);
    }
}

impl<R: Sweeps> Observer<Sph<R>> for History<'_, R> {
    fn wants(&self, step: usize) -> bool {
        self.steps.contains(step)
    }
    fn see(&mut self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if self.steps.contains(solver.step) {
            let row = self.scene.history_row(dynamics, solver)?;
            (self.tell)(solver.step, &row);
            self.rows.push(row);
            write_rows(&self.path, &self.scene.history_columns(), &self.rows)?;
        }
        Ok(())
    }
}

/// Keeps the last good state of a run, which is a checked state from which the run reached another checked state. Until
/// then it is the initial state.
pub struct LastGood<R> {
    state: Snapshot<R>,
    /// The newest checked state, whose further course is unknown.
    newest: Snapshot<R>,
}

impl<R: Sweeps> LastGood<R> {
    pub fn new(start: &Snapshot<R>) -> Self {
        Self { state: start.clone(), newest: start.clone() }
    }

    pub fn state(&self) -> &Snapshot<R> {
        &self.state
    }
}

impl<R: Sweeps> Observer<Sph<R>> for LastGood<R> {
    fn wants(&self, step: usize) -> bool {
        step.is_multiple_of(CHECK_EVERY)
    }
    fn see(&mut self, _: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if solver.step.is_multiple_of(CHECK_EVERY) && solver.step > self.newest.step {
            self.state = std::mem::replace(&mut self.newest, solver.snapshot());
        }
        Ok(())
    }
}

/// Writes [`checkpoint`]s, except at the end, and one when a stop is requested.
pub struct Checkpoints<'a> {
    pub path: PathBuf,
    pub configuration: &'a str,
    pub steps: EvenSteps,
    /// The step at which the run began, which needs no checkpoint.
    pub began: usize,
    /// Number of steps at the end without checkpoints, because their averages are not part of a checkpoint.
    pub window: usize,
}

impl<R: Sweeps> Observer<Sph<R>> for Checkpoints<'_> {
    fn wants(&self, step: usize) -> bool {
        self.steps.contains(step) || interrupt::asked().is_some()
    }
    fn see(&mut self, _: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        let (step, last) = (solver.step, self.steps.last);
        let is_averaged = step + self.window > last;
        let is_due = self.steps.contains(step) || interrupt::asked().is_some();
        if step > self.began && step < last && is_due && !is_averaged {
            checkpoint::write(&self.path, &solver.model, &solver.snapshot(), self.configuration)?;
        }
        Ok(())
    }
}
