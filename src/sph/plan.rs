//! The plan of a scene: what a step computes, on which fields and particles, and what is left out and why.
//!
//! It is derived from the [`Model`] and the first neighbour list, which the operators use as well.

use super::inventory::{dropped, Dropped, Field, Operator};
use super::method::Model;
use crate::adjoint::schedule::{Costs, Counts, Schedule};
use crate::numerics::lanes::InstructionSet;
use crate::numerics::thread_pool::ThreadPool;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::Neighbourhood;
use crate::report::table::Table;
use crate::report::text::bytes;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;
use serde::Serialize;
use std::fmt;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    pub precision: &'static str,
    pub instruction_set: String,
    pub threads: usize,
    pub dimension: usize,
    pub particles: Particles,
    pub list: List,
    pub time_step: TimeStep,
    /// In the order in which a step runs them.
    pub operators: Vec<Operator>,
    pub fields: Vec<Field>,
    pub dropped: Vec<Dropped>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient: Option<GradientPlan>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Particles {
    pub total: usize,
    /// Fluid particles: rows of density and rates.
    pub fluid: usize,
    /// Wall particles with fluid in reach: rows of the extrapolation to walls.
    pub walls: usize,
    /// Wall particles that no fluid can reach before the list is rebuilt.
    pub walls_without_row: usize,
}

/// The first neighbour list.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct List {
    /// Number of directed pairs: (i, j) and (j, i) count as two.
    pub directed_pairs: usize,
    /// Mean number of neighbours over the rows that have any.
    pub neighbours: f64,
    /// Length of a row, including padding.
    pub capacity: usize,
    pub bytes: usize,
    /// Cut-off plus skin.
    pub reach: f64,
    pub skin: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimeStep {
    pub dt: f64,
    /// dt (c + c/10) / h: the sound speed is chosen as ten times the fastest flow.
    pub acoustic_number: f64,
    /// dt max(nu, alpha) / h^2.
    pub diffusion_number: f64,
    /// What limits the time step, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limited_by: Option<String>,
}

/// How the gradient of a run is computed, and the predicted memory.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GradientPlan {
    pub schedule: String,
    pub steps: usize,
    /// The first step that is differentiated.
    pub first: usize,
    #[serde(flatten)]
    pub counts: Counts,
    pub state_bytes: usize,
    pub taped_step_bytes: usize,
    /// Peak of kept states and tape, in bytes.
    pub storage_bytes: usize,
    /// Peak including the buffers of the run, in bytes.
    pub memory_bytes: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_bytes: Option<usize>,
    /// What is not differentiated.
    pub dropped: Vec<Dropped>,
}

impl Plan {
    /// The plan of a scene for a state, whose positions make the neighbour list. `limited_by` says what the time step
    /// was limited by, which a model does not know.
    pub fn of<R: Sweeps>(model: &Model<R>, state: &[R], limited_by: Option<String>) -> Result<Self, NeighbourError> {
        let list = Neighbourhood::build(&model.reach(), state)?.list;
        let fluid = list.fluid_rows.len();
        let walls = list.wall_rows.len();
        let particles =
            Particles { total: model.particles(), fluid, walls, walls_without_row: model.particles() - fluid - walls };
        let h = model.kernel.smoothing_length;
        let kinematic = model.viscosity / model.equation_of_state.reference_density;
        let thermal = model
            .heat
            .as_ref()
            .map_or(0.0, |heat| heat.largest_diffusivity() / model.equation_of_state.reference_density);
        let with_neighbours = list.count.iter().filter(|&&c| c > 0).count();
        Ok(Self {
            precision: if std::mem::size_of::<R>() == 4 { "f32" } else { "f64" },
            instruction_set: InstructionSet::best().name().into(),
            threads: ThreadPool::global().threads(),
            dimension: model.dimension(),
            particles,
            list: List {
                directed_pairs: list.pairs(),
                neighbours: list.pairs() as f64 / with_neighbours.max(1) as f64,
                capacity: list.capacity,
                bytes: list.bytes(),
                reach: model.reach().distance(),
                skin: model.skin,
            },
            time_step: TimeStep {
                dt: model.dt,
                acoustic_number: model.dt * 1.1 * model.sound_speed() / h,
                diffusion_number: model.dt * kinematic.max(thermal) / (h * h),
                limited_by,
            },
            operators: model.operators(&list),
            fields: model.fields(),
            dropped: left_out(model, &particles),
            gradient: None,
        })
    }

    /// Adds how the gradient is computed.
    pub fn with_gradient<R: Sweeps>(
        mut self,
        model: &Model<R>,
        schedule: &Schedule,
        costs: Costs,
        budget: Option<usize>,
    ) -> Self {
        let state = if schedule.is_rounded() { costs.rounded_state } else { costs.state };
        self.gradient = Some(GradientPlan {
            schedule: schedule.to_string(),
            steps: schedule.steps,
            first: schedule.first,
            counts: schedule.counts(),
            state_bytes: state,
            taped_step_bytes: costs.tape_step,
            storage_bytes: schedule.storage(costs),
            memory_bytes: schedule.memory(costs),
            budget_bytes: budget,
            dropped: without_adjoint(model, schedule),
        });
        self
    }

    /// Bytes that a step reads and writes.
    pub fn bytes_per_step(&self) -> (usize, usize) {
        let sum = |f: fn(&Operator) -> usize| self.operators.iter().map(f).sum();
        (sum(|o| o.bytes_read), sum(|o| o.bytes_written))
    }
}

/// What any method leaves out for this scene, and what `model` leaves out besides.
fn left_out<R: Sweeps>(model: &Model<R>, particles: &Particles) -> Vec<Dropped> {
    let mut all = Vec::new();
    if model.heat.is_none() {
        all.push(dropped("temperature, its rate, conduction", "the scene has no heat"));
    }
    all.extend(model.dropped());
    all.push(dropped("a viscosity of each particle", format!("constant: {}", model.viscosity)));
    if let Some(heat) = model.heat.as_ref().filter(|heat| heat.materials.is_none()) {
        let constants = format!("constant: {} and {}", heat.conductivity, heat.capacity);
        all.push(dropped("a conductivity and a heat capacity of each particle", constants));
    }
    if model.body_force == BodyForce::None {
        all.push(dropped("body force", "the scene has none"));
    }
    if model.heat.is_some() && model.buoyancy.is_none() {
        all.push(dropped("buoyancy", "fluid.expansion is 0, or there is no gravity"));
    }
    if !model.has_walls() {
        all.push(dropped("the walls' extrapolation", "the scene has no walls"));
    } else if model.steady().is_some() {
        all.push(dropped("a neighbour list", "particles do not move: their weights are constants"));
    } else {
        all.push(dropped("pairs of two wall particles", "nothing sums over them"));
    }
    if particles.walls_without_row > 0 {
        all.push(dropped(
            format!("rows of {} wall particles", particles.walls_without_row),
            "no fluid can reach them before the next list",
        ));
    }
    if !model.is_fused() {
        let why = "density_gradient = jax-sph, and Riemann problems with materials, are composed of candle's operators";
        all.push(dropped("fused kernels", why));
    }
    all.push(dropped("self pairs", "their share of the density is a constant, and of all else zero"));
    all
}

fn without_adjoint<R: Sweeps>(model: &Model<R>, schedule: &Schedule) -> Vec<Dropped> {
    let mut all = vec![
        dropped("neighbour list", "a sum does not change when a pair outside of the kernel's support comes or goes"),
        dropped("viscosity, masses' constant part, time step, equation of state", "the design does not change them"),
    ];
    if model.body_force != BodyForce::None {
        all.push(dropped("body force", "piecewise constant: its derivative by the position is zero"));
    }
    if model.heat.is_some() {
        all.push(dropped("temperature upstream of the inlet", "the inlet sets it anew"));
    }
    if schedule.clip > 0.0 {
        let what = format!("what is longer than {} times what the objective made it", schedule.clip);
        all.push(dropped(what, "optimise.clip; the gradient is not exact"));
    }
    if schedule.first > 0 {
        let steps = format!("steps 0 ... {}", schedule.first - 1);
        all.push(dropped(steps, "truncated: optimise.horizon; the gradient is not exact"));
    }
    all
}

/// A count with its noun, as in `1 step` and `2 steps`.
fn plural(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

fn lines(out: &mut fmt::Formatter<'_>, title: &str, all: &[Dropped]) -> fmt::Result {
    writeln!(out, "\n{title}")?;
    all.iter().try_for_each(|d| writeln!(out, "  {}: {}", d.what, d.why))
}

impl fmt::Display for Plan {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (p, list, time) = (&self.particles, &self.list, &self.time_step);
        writeln!(
            out,
            "{} particles in {} dimensions: {} fluid, {} wall particles with rows, {} without",
            p.total, self.dimension, p.fluid, p.walls, p.walls_without_row
        )?;
        writeln!(
            out,
            "{} directed pairs in the first list ({:.1} per row, padded to {}), {}; reach {:.4}, of it skin {:.4}",
            list.directed_pairs,
            list.neighbours,
            list.capacity,
            bytes(list.bytes),
            list.reach,
            list.skin
        )?;
        writeln!(out, "{}, {}, {} threads", self.precision, self.instruction_set, self.threads)?;
        writeln!(
            out,
            "dt {:.4e}: acoustic number {:.3}, diffusion number {:.3}{}",
            time.dt,
            time.acoustic_number,
            time.diffusion_number,
            time.limited_by.as_ref().map_or(String::new(), |by| format!("; limited by {by}"))
        )?;
        writeln!(out, "\none step:")?;
        let mut table = Table::new(["operator", "rows", "pairs", "reads", "writes", "gathers", "does"]);
        for o in &self.operators {
            let numbers = [o.bytes_read, o.bytes_written, o.bytes_gathered].map(bytes);
            let [read, written, gathered] = numbers;
            table.row([
                o.name.into(),
                o.rows.to_string(),
                o.pairs.to_string(),
                read,
                written,
                gathered,
                o.does.join(", "),
            ]);
        }
        write!(out, "{table}")?;
        let (read, written) = self.bytes_per_step();
        let each = |total: usize| total as f64 / p.total.max(1) as f64;
        writeln!(out, "{:.0} bytes read and {:.0} written per particle and step", each(read), each(written))?;
        writeln!(out, "\nfields:")?;
        let mut table = Table::new(["field", "rows", "bytes", "names"]);
        for f in &self.fields {
            table.row([f.name.into(), f.rows.len().to_string(), bytes(f.bytes), f.rows.join(", ")]);
        }
        write!(out, "{table}")?;
        lines(out, "left out:", &self.dropped)?;
        let Some(g) = &self.gradient else { return Ok(()) };
        let c = &g.counts;
        writeln!(out, "\ngradient of {} steps: {}", g.steps - g.first, g.schedule)?;
        writeln!(
            out,
            "  at the peak {} kept, of {} each; {} on the tape, of {} each and a list",
            plural(c.stored_states, "state"),
            bytes(g.state_bytes),
            plural(c.taped_steps, "step"),
            bytes(g.taped_step_bytes)
        )?;
        writeln!(
            out,
            "  {} steps without graph ({} of them again), {} on it",
            c.plain_steps, c.recomputed_steps, c.differentiated_steps
        )?;
        let budget = g.budget_bytes.map_or(String::new(), |b| format!(" of the {} given", bytes(b)));
        writeln!(
            out,
            "  predicted storage {}; with the run's buffers {}{budget}",
            bytes(g.storage_bytes),
            bytes(g.memory_bytes)
        )?;
        lines(out, "without adjoint:", &g.dropped)
    }
}
