//! The plan of a scene, made visible: what one step does, on which fields and particles, and what was left out and why.
//!
//! It is read off the same [`Model`], [`super::model::Layout`] and first neighbour list that the operators run on.

use super::consistent::stencil::monomials;
use super::consistent::Shift;
use super::model::Model;
use crate::adjoint::schedule::{Costs, Counts, Schedule};
use crate::numerics::sweep::InstructionSet;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::Neighbourhood;
use crate::report::table::Table;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::laws::{with_laws, Flux, PairLaw};
use crate::sph::operators::pairs::stride;
use crate::sph::operators::rates::record_fields;
use crate::sph::Sweeps;
use serde::Serialize;
use std::fmt;

/// c = sqrt(gamma p_ref / rho_ref).
pub fn sound_speed(state: &EquationOfState) -> f64 {
    (state.gamma as f64 * state.reference_pressure / state.reference_density).sqrt()
}

/// What a step of a scene is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    pub precision: &'static str,
    pub instruction_set: String,
    pub threads: usize,
    pub dimension: usize,
    pub particles: Particles,
    pub list: List,
    pub time_step: TimeStep,
    /// In the order of one step.
    pub operators: Vec<Operator>,
    pub fields: Vec<Field>,
    pub dropped: Vec<Dropped>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient: Option<GradientPlan>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Particles {
    pub total: usize,
    /// Rows of density and rates.
    pub fluid: usize,
    /// Wall particles with fluid in reach: rows of the walls' extrapolation.
    pub walls: usize,
    /// Wall particles that no fluid can reach before the list is built anew.
    pub walls_without_row: usize,
}

/// The first neighbour list.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct List {
    /// i in row j and j in row i are two.
    pub directed_pairs: usize,
    /// Mean over the rows that have any.
    pub neighbours: f64,
    /// Places in a row, padding included.
    pub capacity: usize,
    pub bytes: usize,
    /// Cut-off and skin.
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
    /// What keeps it from being longer, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limited_by: Option<String>,
}

/// An operator of a step. Bytes are an estimate: each input and output row and each list entry once from memory;
/// `gathered` is what pairs fetch from their neighbours' records, mostly from the cache.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Operator {
    pub name: &'static str,
    pub does: Vec<String>,
    /// Rows of particles that it computes.
    pub rows: usize,
    /// Directed pairs that it sums over.
    pub pairs: usize,
    pub bytes_read: usize,
    pub bytes_written: usize,
    pub bytes_gathered: usize,
}

/// A packed tensor `[rows, N]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Field {
    pub name: &'static str,
    pub rows: Vec<String>,
    pub bytes: usize,
}

/// Something that the scene does not need.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    pub what: String,
    pub why: String,
}

fn dropped(what: impl Into<String>, why: impl Into<String>) -> Dropped {
    Dropped { what: what.into(), why: why.into() }
}

/// How a run's gradient is computed and what that is predicted to take.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GradientPlan {
    pub schedule: String,
    pub steps: usize,
    /// The first of them that is differentiated.
    pub first: usize,
    #[serde(flatten)]
    pub counts: Counts,
    pub state_bytes: usize,
    pub taped_step_bytes: usize,
    /// Peak of kept states and tape.
    pub storage_bytes: usize,
    /// The same with the buffers of the run.
    pub memory_bytes: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_bytes: Option<usize>,
    /// What carries no adjoint.
    pub dropped: Vec<Dropped>,
}

impl Plan {
    /// The plan of a scene in a state (its positions make the list). `limited_by` says what the time step was chosen
    /// by; a model does not know that.
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
            instruction_set: format!("{:?}", InstructionSet::detect()).to_lowercase(),
            threads: candle_core::utils::barrier_pool().n_workers() + 1,
            dimension: model.layout.dimension,
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
                acoustic_number: model.dt * 1.1 * sound_speed(&model.equation_of_state) / h,
                diffusion_number: model.dt * kinematic.max(thermal) / (h * h),
                limited_by,
            },
            operators: match (model.layout.consistent, &model.fixed) {
                (_, Some(_)) => fixed_operators(model),
                (true, None) => consistent_operators(model, &list),
                _ => operators(model, &list),
            },
            fields: fields(model),
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

/// Names of vector components.
fn components(name: &str, dimension: usize) -> Vec<String> {
    ["x", "y", "z"][..dimension].iter().map(|c| format!("{name} {c}")).collect()
}

fn fields<R: Sweeps>(model: &Model<R>) -> Vec<Field> {
    let l = model.layout;
    let vector = |name: &str| components(name, l.dimension);
    let optional = |wanted: bool, names: Vec<String>| if wanted { names } else { vec![] };
    let one = |name: &str| vec![name.to_string()];
    if l.consistent {
        let rows = [
            vector("position"),
            vector("velocity"),
            one("pressure"),
            optional(l.heat, one("temperature")),
            optional(l.rates, vector("acceleration")),
            optional(l.rates && l.heat, one("temperature rate")),
        ]
        .concat();
        return vec![Field { name: "state", bytes: rows.len() * model.particles() * std::mem::size_of::<R>(), rows }];
    }
    let state = [
        vector("position"),
        vector("velocity"),
        vector("acceleration"),
        optional(l.transport, vector("transport acceleration")),
        optional(l.heat, ["temperature", "temperature rate"].map(String::from).to_vec()),
        optional(l.mass, one("mass")),
        optional(l.density, one("density")),
    ];
    let moved = [
        vector("position"),
        vector("velocity"),
        optional(l.transport, vector("transport shift")),
        optional(l.heat, ["temperature before", "temperature"].map(String::from).to_vec()),
        optional(l.mass, one("mass")),
        optional(l.density, one("density before")),
        vec![],
    ];
    let primitives = [
        one("density"),
        vector("velocity"),
        optional(l.transport, vector("transport shift")),
        optional(l.heat, one("temperature")),
        vec![],
        vec![],
        vec![],
    ];
    let rates = [
        vector("acceleration"),
        optional(l.transport, vector("transport acceleration")),
        optional(l.heat, one("temperature rate")),
        vec![],
        vec![],
        vec![],
        vec![],
    ];
    let density = [one("density"), vec![], vec![], vec![], vec![], vec![], vec![]];
    [("state", state), ("moved", moved), ("density", density), ("primitives", primitives), ("rates", rates)]
        .into_iter()
        .map(|(name, rows)| {
            let rows = rows.concat();
            Field { name, bytes: rows.len() * model.particles() * std::mem::size_of::<R>(), rows }
        })
        .collect()
}

/// The operators of [`crate::sph::consistent`].
fn consistent_operators<R: Sweeps>(model: &Model<R>, list: &crate::particles::NeighbourList) -> Vec<Operator> {
    let (l, n, number) = (model.layout, model.particles(), std::mem::size_of::<R>());
    let (d, fits) = (l.dimension, monomials(l.dimension));
    let row = |rows: usize| rows * n * number;
    let (fluid, walls) = (list.fluid_rows.len(), list.wall_rows.len());
    let fluid_pairs: usize = list.fluid_rows.iter().map(|&i| list.count[i as usize] as usize).sum();
    let Some(consistent) = &model.consistent else { return vec![] };
    let has_dummies = !consistent.dummies.is_empty();
    let of_points: usize = consistent.surface.iter().map(|&i| list.count[i as usize] as usize).sum();
    let derivatives = |fields: usize| (fields * fits + 1 + d) * fluid * number;
    let record = |fields: usize| stride(fields) * number;
    let operator = |name, does: Vec<String>, rows, pairs, bytes_read, bytes_written, gathered| Operator {
        name,
        does,
        rows,
        pairs,
        bytes_read,
        bytes_written,
        bytes_gathered: gathered * pairs,
    };
    let text = |texts: &[&str]| texts.iter().map(|text| text.to_string()).collect::<Vec<String>>();
    let shift = match &consistent.shift {
        Shift::None => "no shift",
        Shift::Chain(_) => "shift along rows",
        Shift::Isotropic(_) => "shift away from crowds",
    };
    let moves = text(&["largest move since the list was built; a new list at half the skin"]);
    let mut all = vec![operator("neighbours", moves, n, 0, 2 * row(d), 0, 0)];
    if has_dummies {
        let does = text(&["dummy particles: the fluid's values at their mirror images"]);
        let points = consistent.surface.len();
        all.push(operator("wall values", does, points, of_points, row(l.state_rows()), row(1), record(d + 2)));
    }
    let mut fitted = text(&["second-order fits of velocity, pressure", "volumes", shift]);
    if l.heat {
        fitted[0].push_str(", temperature");
    }
    let (known, gathered) = (row(l.state_rows()), record(d + l.fields()));
    all.push(operator("derivatives", fitted, fluid, fluid_pairs, known, derivatives(l.fields()), gathered));
    let does = text(&["pressure from the divergence of the velocity", "delta diffusion", "its mean subtracted"]);
    let read = known + derivatives(l.fields());
    all.push(operator("continuity", does, fluid, fluid_pairs, read, row(1), record(2 * d + 3)));
    if has_dummies {
        let does = text(&["dummy particles: the new pressure"]);
        let points = consistent.surface.len();
        all.push(operator("wall pressure", does, points, of_points, row(d + 1), row(1), record(d + 1)));
    }
    let does = text(&["fits of the new pressure, with the matrices that there are"]);
    all.push(operator("pressure gradient", does, fluid, fluid_pairs, row(d + 1), derivatives(1), record(d + 1)));
    let mut does = text(&["kick", "move", "periodic wrap"]);
    if l.heat {
        does.extend(text(&["conduction", "inlet temperature"]));
    }
    if model.body_force != BodyForce::None {
        does.extend(text(&["body force"]));
    }
    let read = known + derivatives(l.fields()) + derivatives(1);
    all.push(operator("advance", does, fluid + walls, 0, read, known, 0));
    all
}

/// The sweeps of [`crate::sph::fixed`].
fn fixed_operators<R: Sweeps>(model: &Model<R>) -> Vec<Operator> {
    let fluid = model.tags.iter().filter(|&&tag| tag == crate::particles::tag::FLUID).count();
    let bytes = model.layout.state_rows() * model.particles() * std::mem::size_of::<R>();
    let operator = |name, does: &str| Operator {
        name,
        does: vec![does.to_string()],
        rows: fluid,
        // A stencil of five by five without its corners and middle.
        pairs: 20 * fluid,
        bytes_read: bytes,
        bytes_written: bytes,
        bytes_gathered: 0,
    };
    vec![
        operator("flux", "mass flux of every pair, with diffusion"),
        operator("kick", "velocity: pressure, viscosity, what the flux carries, body force"),
        operator("flux again", "of the new velocity"),
        operator("advance", "density and temperature by the same flux; inlet and outlet"),
    ]
}

fn operators<R: Sweeps>(model: &Model<R>, list: &crate::particles::NeighbourList) -> Vec<Operator> {
    let (l, n, number) = (model.layout, model.particles(), std::mem::size_of::<R>());
    let d = l.dimension;
    let row = |rows: usize| rows * n * number;
    let fluid_pairs: usize = list.fluid_rows.iter().map(|&i| list.count[i as usize] as usize).sum();
    let wall_pairs = list.pairs() - fluid_pairs;
    let words = |parts: &[(bool, &str)]| -> Vec<String> {
        parts.iter().filter(|(wanted, _)| *wanted).map(|(_, text)| text.to_string()).collect()
    };
    // Velocity and volume besides the position.
    let evolved = if l.density { d + 1 } else { 0 };
    let mut all = vec![
        Operator {
            name: "drift",
            does: words(&[
                (true, "kick with the old acceleration"),
                (l.transport, "transport velocity"),
                (true, "move"),
                (model.domain.periodic[..d].contains(&true), "periodic wrap"),
                (l.heat, "heat with the old rate"),
            ]),
            rows: n,
            pairs: 0,
            bytes_read: row(l.state_rows()),
            bytes_written: row(l.moved_rows()),
            bytes_gathered: 0,
        },
        Operator {
            name: "neighbours",
            does: vec!["largest move since the list was built; a new list at half the skin".into()],
            rows: n,
            pairs: 0,
            bytes_read: 2 * row(d),
            bytes_written: 0,
            bytes_gathered: 0,
        },
        Operator {
            name: "density",
            does: density(model),
            rows: list.fluid_rows.len(),
            pairs: fluid_pairs,
            bytes_read: row(evolved + d + l.mass as usize) + 4 * fluid_pairs,
            bytes_written: row(1),
            bytes_gathered: (evolved + d) * number * fluid_pairs,
        },
    ];
    // Averaged over the fluid: velocity, [shift], pressure, [temperature].
    let averaged = d * (1 + l.transport as usize) + 1 + l.heat as usize;
    let extrapolates = !list.wall_rows.is_empty();
    all.push(Operator {
        name: "wall condition",
        does: words(&[
            (true, "copy of the fluid's fields"),
            (extrapolates, "walls: pressure, density and velocity from the fluid (Adami 2012)"),
            (extrapolates && matches!(model.body_force, BodyForce::Gravity(_)), "walls: pressure of the depth"),
            (extrapolates && l.transport, "walls: transport shift"),
            (extrapolates && l.heat, "walls: temperature"),
        ]),
        rows: list.wall_rows.len(),
        pairs: if extrapolates { wall_pairs } else { 0 },
        bytes_read: row(l.moved_rows() + 1) + if extrapolates { 4 * wall_pairs } else { 0 },
        bytes_written: row(l.primitive_rows()),
        bytes_gathered: if extrapolates { (d + averaged) * number * wall_pairs } else { 0 },
    });
    let record = stride(record_fields(d, l.transport, l.heat));
    all.push(Operator {
        name: "rates",
        does: laws(model),
        rows: list.fluid_rows.len(),
        pairs: fluid_pairs,
        bytes_read: row(d + l.primitive_rows() + l.mass as usize) + 4 * fluid_pairs,
        bytes_written: row(l.rate_rows()),
        bytes_gathered: record * number * fluid_pairs,
    });
    all.push(Operator {
        name: "assemble",
        does: words(&[(true, "the new state from its parts"), (l.heat, "inlet temperature")]),
        rows: n,
        pairs: 0,
        bytes_read: row(l.moved_rows() + l.rate_rows()),
        bytes_written: row(l.state_rows()),
        bytes_gathered: 0,
    });
    all
}

/// Where the density comes from.
fn density<R: Sweeps>(model: &Model<R>) -> Vec<String> {
    if !model.layout.density {
        return vec!["summation".into()];
    }
    let mut does = vec![match model.standard.flux {
        Flux::Riemann(_) => "evolution by Riemann problems",
        _ => "evolution by continuity",
    }];
    if matches!(model.standard.flux, Flux::Delta(..)) {
        does.push("diffusion of density");
    }
    if model.standard.renormalises {
        does.push("renormalisation");
    }
    does.into_iter().map(String::from).collect()
}

/// The laws of the pair pass, and what acts on each particle alone.
fn laws<R: Sweeps>(model: &Model<R>) -> Vec<String> {
    let mut names = Vec::new();
    match model.standard.flux {
        Flux::Riemann(_) => names.extend(["pressure and viscosity by Riemann problems"]),
        _ => with_laws!(model, |laws, _D| laws.name(&mut names)),
    }
    if matches!(model.standard.flux, Flux::Delta(..)) {
        names.push("diffusion of velocity");
    }
    if model.body_force != BodyForce::None {
        names.push("body force");
    }
    names.into_iter().map(String::from).collect()
}

fn left_out<R: Sweeps>(model: &Model<R>, particles: &Particles) -> Vec<Dropped> {
    let l = model.layout;
    let mut all = Vec::new();
    if !l.heat {
        all.push(dropped("temperature, its rate, conduction", "the scene has no heat"));
    }
    if !l.transport {
        let why = if l.consistent { "the formulation has a shift" } else { "its strength is 0" };
        all.push(dropped("transport velocity and its acceleration", why));
    }
    if l.consistent {
        all.push(dropped("density summation, mass, background pressure", "the pressure is a field of its own"));
    } else if !l.mass {
        all.push(dropped("a mass of each particle", format!("every particle has the mass {:.4e}", model.mass)));
    }
    all.push(dropped("a viscosity of each particle", format!("constant: {}", model.viscosity)));
    if let Some(heat) = model.heat.as_ref().filter(|heat| heat.materials.is_none()) {
        let constants = format!("constant: {} and {}", heat.conductivity, heat.capacity);
        all.push(dropped("a conductivity and a heat capacity of each particle", constants));
    }
    if model.body_force == BodyForce::None {
        all.push(dropped("body force", "the scene has none"));
    }
    if !model.has_walls() {
        all.push(dropped("the walls' extrapolation", "the scene has no walls"));
    } else if model.fixed.is_some() {
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
        let why = "delta-SPH, Riemann problems, free slip and renormalisation are composed of candle's operators";
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

/// `12.3 MB`.
fn bytes(count: usize) -> String {
    match count as f64 {
        b if b < 1e4 => format!("{b} B"),
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b if b < 1e10 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}

/// `1 step`, `2 steps`.
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
