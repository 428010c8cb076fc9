//! Our solver against states computed by JAX-SPH in f64: every group of the file whose configuration we support,
//! every field, after 1, 10 and 100 steps.

use crate::support::jax_sph::{field, number, reference_file, Case};
use candle_core::{Device, Tensor};
use hydrograd::adjoint::RunError;
use hydrograd::particles::tag;
use hydrograd::sph::laws::Flux;
use hydrograd::sph::solver::Solver;
use hydrograd::sph::standard::chain::Step;
use hydrograd::sph::standard::{drift, evolution, Standard};
use std::sync::Arc;

/// Largest difference relative to the field's largest value.
const TOLERANCES: [(usize, f64); 3] = [(1, 1e-10), (10, 1e-10), (100, 1e-8)];

/// JAX-SPH rounds every r_ij to the box (it adds and subtracts half of the box), we do not. Where a field is a sum of
/// large terms that cancel (the transport acceleration of a lattice), that rounding shows: we measure what moving the
/// particles by this much does to each field, and allow ten times that.
const ROUNDING_MARGIN: f64 = 10.0;

/// A pressure is gamma p_ref times the density's distance from its reference, of which two runs that agree to the last bit but
/// one have this much more or less. (The largest pressure of `pf2d_delta_rhoevol` after 10 steps is 2e-10, and its density one bit off is 2e-4 of that.)
fn rounded_pressure(model: &Standard<f64>) -> f64 {
    f64::EPSILON * model.equation_of_state.gamma as f64 * model.equation_of_state.reference_pressure
}

fn standard(solver: &Solver<f64>) -> &Standard<f64> {
    solver.model.of_type().unwrap()
}

/// The walls' normals as JAX-SPH computes them in each step of a case that has a moving wall and reads normals: in a cavity,
/// by `compute_nws_jax_wrapper` (jax_sph/utils.py, lines 197 to 275, of commit 808f874), which jax_sph/integrator.py calls in
/// lines 32 to 34 with the places that the particles have moved to.
///
/// Around the fluid it lays points, five to a spacing and half of their own spacing behind the surface of the walls. The
/// normal of a wall particle is the direction from it to the nearest of these points. The points stay while the particles of
/// a lid move along it, so a lid's normals turn to and fro: as far as 14 degrees in the row next to the fluid, which is 4/10 of
/// a spacing from the points, when it stands midway between two of them.
///
/// The points are numbered after the wall particles, from 0, and line 252 takes those whose number is greater than how many
/// wall particles there are, where it should be "greater or equal". So the first point is never found: that at the lower left
/// corner. The normals of the nine particles behind it point to its neighbours.
///
/// The normals of the first state are computed by another function (`compute_nws_scipy`, lines 169 to 194), which uses every
/// point.
struct TurningNormals {
    /// In JAX-SPH's order, the first one left out; their origin is the fluid's lower left corner.
    points: Vec<[f64; 2]>,
    /// Where that corner is, in both directions.
    corner: f64,
}

impl TurningNormals {
    const POINTS_PER_SPACING: f64 = 5.0;
    /// Of the cavity.
    const LENGTH: f64 = 1.0;

    fn of(case: &Case) -> Self {
        let all = Self::with_every_point(case);
        Self { points: all.points[1..].to_vec(), ..all }
    }

    /// As they would be if JAX-SPH left out no point.
    fn with_every_point(case: &Case) -> Self {
        let between = case.dx / Self::POINTS_PER_SPACING;
        let corner = case.wall_rows() * case.dx;
        let shift = corner / case.wall_rows() / Self::POINTS_PER_SPACING;
        let along = (Self::LENGTH / between).round() as usize;
        let place = |k: usize| (k as f64 + 0.5) * between;
        let far = Self::LENGTH + between;
        // To the last bit as JAX-SPH adds them: three of the particles behind a corner are as far from one point as from another.
        let left = (0..along + 2).map(|k| [place(0), place(k)]);
        let bottom = (0..along).map(|k| [place(k) + between, place(0)]);
        let right = (0..along + 2).map(|k| [place(0) + far, place(k)]);
        let top = (0..along).map(|k| [place(k) + between, place(0) + far]);
        let points = left.chain(bottom).chain(right).chain(top).map(|point| point.map(|x| x - shift)).collect();
        Self { points, corner }
    }

    /// Those of the next step that a solver makes, `[D, N]`.
    fn after_step(&self, case: &Case, solver: &Solver<f64>) -> Vec<f64> {
        let (n, velocity) = (case.n, standard(solver).layout.velocity());
        let mut normals = vec![0.0; 2 * n];
        for i in (0..n).filter(|&i| case.tags[i] != tag::FLUID) {
            let place = |k: usize| solver.row(k)[i] + solver.model.dt * solver.row(velocity + k)[i] - self.corner;
            let place = [place(0), place(1)];
            let mut nearest = ([0.0; 2], f64::INFINITY);
            for point in &self.points {
                let towards: [f64; 2] = std::array::from_fn(|k| {
                    let half = 0.5 * case.size[k];
                    (point[k] - place[k] + half).rem_euclid(case.size[k]) - half
                });
                let distance = (towards[0] * towards[0] + towards[1] * towards[1]).sqrt();
                if distance < nearest.1 {
                    nearest = (towards, distance);
                }
            }
            (0..2).for_each(|k| normals[k * n + i] = nearest.0[k] / (nearest.1 + f64::EPSILON));
        }
        normals
    }
}

/// One step, with other normals of the walls than before where there are any.
fn advance(solver: &mut Solver<f64>, normals: Option<&Vec<f64>>) -> Result<(), RunError> {
    if let Some(normals) = normals {
        let mut model = standard(solver).clone();
        model.laws.normals = Some(normals.clone());
        *solver = Solver::restore(Arc::new(model), &solver.snapshot())?;
    }
    solver.advance()
}

type Fields = Vec<(&'static str, Vec<Vec<f64>>)>;

fn fields(case: &Case, solver: &Solver<f64>, before: &[f64]) -> Fields {
    let (n, d, model) = (case.n, case.dimension, standard(solver));
    let l = model.layout;
    let rows =
        |from: usize, count: usize| -> Vec<Vec<f64>> { (from..from + count).map(|r| solver.row(r).to_vec()).collect() };
    let density = solver.looked.density[..n].to_vec();
    let known = |i: usize| !case.forgets_wall_pressure() || model.is_fluid(i);
    let pressure = |i: usize| if known(i) { model.equation_of_state.pressure(density[i]) } else { 0.0 };
    let pressure = (0..n).map(pressure).collect::<Vec<f64>>();
    let mut fields = vec![
        ("r", rows(0, d)),
        ("u", rows(l.velocity(), d)),
        ("dudt", rows(l.acceleration(), d)),
        ("rho", vec![density]),
        ("p", vec![pressure]),
    ];
    let mut v = rows(l.velocity(), d);
    if l.transport {
        fields.push(("dvdt", rows(l.transport_acceleration(), d)));
        // v = u + w with the transport acceleration of the state before.
        let shift = model.laws.transport * 0.5 * model.dt;
        for (k, v) in v.iter_mut().enumerate() {
            let b = &before[(l.transport_acceleration() + k) * n..][..n];
            v.iter_mut().zip(b).for_each(|(v, b)| *v += shift * b);
        }
    }
    fields.push(("v", v));
    if l.density {
        // The rate that led here, from the state before: a state has none of its own.
        fields.push(("drhodt", vec![density_rate(solver, before)]));
    }
    if l.heat {
        fields.push(("T", vec![solver.row(l.temperature()).iter().map(|t| t + case.reference_temperature).collect()]));
        fields.push(("dTdt", rows(l.temperature_rate(), 1)));
    }
    fields
}

/// Likewise the rate of a density that diffuses, by c delta/h.
fn rounded_rate(model: &Standard<f64>) -> f64 {
    match model.laws.flux {
        Flux::Delta(law) => f64::EPSILON * law.strength * law.sound_speed / law.smoothing_length,
        _ => 0.0,
    }
}

/// drho/dt of the step that began with the state `before`, of fluid and walls.
fn density_rate(solver: &Solver<f64>, before: &[f64]) -> Vec<f64> {
    let (model, n) = (standard(solver), solver.model.particles());
    let state = Tensor::from_slice(before, (model.layout.state_rows(), n), &Device::Cpu).unwrap();
    let moved = drift::composed(model, model.dt, &state).unwrap();
    let step = Step { model: Arc::new(model.clone()), list: solver.neighbourhood.list.clone() };
    let rate = evolution::rate(&step, &step.pairs(&moved).unwrap(), &moved).unwrap();
    rate.flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference of two fields; infinite where one is not a number.
fn largest(case: &Case, name: &str, a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let mut most: f64 = 0.0;
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        for (a, b) in a.iter().zip(b) {
            let mut gap = a - b;
            if name == "r" {
                gap -= case.size[k] * (gap / case.size[k]).round();
            }
            most = if gap.is_nan() { f64::INFINITY } else { most.max(gap.abs()) };
        }
    }
    most
}

fn compare(group: &hdf5::Group, case: &Case, everything: bool, report: &mut String) -> Result<(), String> {
    let model = Arc::new(case.model(everything));
    let l = model.layout;
    let start = case.state(&l, &group.group("0").map_err(|e| e.to_string())?);
    let mut shaken = start.clone();
    for (place, x) in shaken[..case.dimension * case.n].iter_mut().enumerate() {
        let sign = if (place.wrapping_mul(2654435761) >> 7) & 1 == 0 { 1.0 } else { -1.0 };
        *x += sign * f64::EPSILON * case.size[place / case.n];
    }
    let turning = case.turns_normals().then(|| TurningNormals::of(case));
    let mut solver = Solver::new(model.clone(), start).map_err(|e| e.to_string())?;
    let mut twin = Solver::new(model.clone(), shaken).map_err(|e| e.to_string())?;
    let mut compared = 0;
    for (steps, tolerance) in TOLERANCES {
        let Ok(reference) = group.group(&steps.to_string()) else { continue };
        if steps > 10 && everything && !model.is_fused() {
            continue; // Slow, and what is forced on feeds nothing back: the run without it says the same.
        }
        let mut before = [solver.state.clone(), twin.state.clone()];
        while solver.step < steps {
            before = [solver.state.clone(), twin.state.clone()];
            // The twin gets the same ones: which of two places is nearest can be a matter of rounding, and not a small one.
            let normals = turning.as_ref().map(|turning| turning.after_step(case, &solver));
            for solver in [&mut solver, &mut twin] {
                advance(solver, normals.as_ref()).map_err(|e| e.to_string())?;
            }
        }
        compared += 1;
        solver.look().unwrap();
        twin.look().unwrap();
        let mut worst: (f64, &str) = (0.0, "");
        let ours = fields(case, &solver, &before[0]);
        for ((name, values), (_, shaken)) in ours.iter().zip(fields(case, &twin, &before[1])) {
            let mut theirs = field(&reference, name, case.n, values.len())
                .ok_or_else(|| format!("{name} is missing after {steps} steps"))?;
            if *name == "drhodt" && matches!(model.laws.flux, Flux::Delta(..)) {
                // JAX-SPH diffuses density into walls too, and drops it when their pressure gives them another one.
                let rate = theirs[0].iter_mut().zip(&model.tags).zip(&values[0]);
                rate.filter(|((_, tag), _)| **tag != tag::FLUID).for_each(|((theirs, _), ours)| *theirs = *ours);
            }
            let scale = theirs.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
            let difference = largest(case, name, values, &theirs);
            let mut rounding = ROUNDING_MARGIN * largest(case, name, values, &shaken);
            if *name == "p" {
                // Every step rounds an evolved density once more (measured: 17 units in the last place after 100 steps).
                rounding += ROUNDING_MARGIN.max(steps as f64) * rounded_pressure(&model);
            }
            if *name == "drhodt" {
                rounding += ROUNDING_MARGIN.max(steps as f64) * rounded_rate(&model);
            }
            let relative = if difference > 0.0 { difference / scale } else { 0.0 };
            if relative > worst.0 {
                worst = (relative, name);
            }
            if difference.is_nan() || difference > tolerance * scale + rounding {
                return Err(format!(
                    "{name} differs by {relative:.2e} of its largest value after {steps} steps, allowed {tolerance:.0e} (+ rounding {:.1e})",
                    rounding / scale
                ));
            }
        }
        report.push_str(&format!("  after {steps}: {:.1e} ({})", worst.0, worst.1));
    }
    if compared == 0 {
        return Err("has no steps to compare".into());
    }
    Ok(())
}

#[test]
fn states_of_jax_sph() {
    let path = reference_file("HYDROGRAD_JAX_SPH_STATES", "jax-sph-states.h5");
    let file = hdf5::File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (mut compared, mut skipped, mut failures) = (0, Vec::new(), Vec::new());
    for name in file.member_names().unwrap() {
        let group = file.group(&name).unwrap();
        match Case::read(&group) {
            Err(reason) => skipped.push(format!("{name} ({reason})")),
            Ok(case) => {
                compared += 1;
                for everything in [false, true] {
                    let mut report = String::new();
                    match compare(&group, &case, everything, &mut report) {
                        Ok(()) => println!("{name}{}:{report}", if everything { ", everything on" } else { "" }),
                        Err(why) => failures.push(format!("{name}: {why}")),
                    }
                }
            }
        }
    }
    println!("compared {compared} groups, skipped {}: {}", skipped.len(), skipped.join(", "));
    assert!(failures.is_empty(), "{} of {compared} groups differ:\n{}", failures.len(), failures.join("\n"));
    assert!(compared > 0, "nothing was compared in {}", path.display());
}

/// Largest differences of the fluid's acceleration from JAX-SPH's, relative to its largest value.
#[derive(Debug)]
struct Apart {
    /// Of particles that a wall particle acts on which has another normal in JAX-SPH.
    near: f64,
    /// Of all others.
    far: f64,
}

/// The cavity with other normals than JAX-SPH's, from a solver before each of its steps, against JAX-SPH after one step and
/// after ten.
fn apart(group: &hdf5::Group, case: &Case, normals: impl Fn(&Solver<f64>) -> Vec<f64>) -> [Apart; 2] {
    let (n, turning, reach) = (case.n, TurningNormals::of(case), number(group, "cutoff"));
    let model = Arc::new(case.model(false));
    let start = case.state(&model.layout, &group.group("0").unwrap());
    let mut solver = Solver::new(model.clone(), start).unwrap();
    [1, 10].map(|steps| {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        while solver.step < steps {
            (ours, theirs) = (normals(&solver), turning.after_step(case, &solver));
            advance(&mut solver, Some(&ours)).unwrap();
        }
        let differs = |j: &usize| (0..2).any(|k| (theirs[k * n + j] - ours[k * n + j]).abs() > 1e-9);
        let other: Vec<usize> = (0..n).filter(differs).collect();
        let distance = |i: usize, j: usize| {
            let along = |k: usize| solver.row(k)[i] - solver.row(k)[j];
            let along = |k: usize| along(k) - case.size[k] * (along(k) / case.size[k]).round();
            along(0).hypot(along(1))
        };
        let wanted = field(&group.group(&steps.to_string()).unwrap(), "dudt", n, 2).unwrap();
        let scale = wanted.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
        let mut apart = Apart { near: 0.0, far: 0.0 };
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let gap = |k: usize| (solver.row(model.layout.acceleration() + k)[i] - wanted[k][i]).abs();
            let place = if other.iter().any(|&j| distance(i, j) < reach) { &mut apart.near } else { &mut apart.far };
            *place = place.max(gap(0).max(gap(1)) / scale);
        }
        apart
    })
}

/// `states_of_jax_sph` shows that the cavity is JAX-SPH's if its walls' normals are. This shows what each of the three
/// differences between its normals and those of our scenes does: after the first step the acceleration differs only where such
/// a wall acts.
#[test]
fn what_the_normals_of_a_lid_do() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/reference/jax-sph-states.h5");
    let group = hdf5::File::open(path).unwrap().group("ldc2d_rie").unwrap();
    let case = Case::read(&group).unwrap();
    // Those of the first state, which stay: a lid that slides in itself does not turn.
    let stay = case.normals.clone().unwrap();
    // Those of our scenes, see `normals` in src/scene/lattice.rs: they stay, and a lid's are its plane's over its whole length.
    // In JAX-SPH those at its ends, behind the side walls, point to the cavity's corners, so that a lid that slides seems to
    // come nearer.
    let mut plane = stay.clone();
    for i in (0..case.n).filter(|&i| case.tags[i] == tag::MOVING_WALL) {
        plane[i] = 0.0;
        plane[case.n + i] = -1.0;
    }
    // Those of JAX-SPH if it left out no point. The fluid at that corner is at rest in the first step.
    let every_point = TurningNormals::with_every_point(&case);
    let rounding = 1e-13;
    let check = |what: &str, [one, ten]: [Apart; 2], near: [f64; 2], far: [f64; 2]| {
        println!("{what}: {one:?} after a step, {ten:?} after ten");
        for (is, most) in [(one.near, near[0]), (ten.near, near[1]), (one.far, far[0]), (ten.far, far[1])] {
            // Not less than half of it either, where it is more than rounding: the figure says what the difference is.
            assert!(is <= most && (most <= rounding || is > 0.5 * most), "{what}: {is:.2e}, expected {most:.1e}");
        }
    };
    check("no turning", apart(&group, &case, |_| stay.clone()), [1.5e-3, 0.08], [rounding, 6e-4]);
    check("the lid's plane", apart(&group, &case, |_| plane.clone()), [0.08, 0.12], [rounding, 2e-3]);
    let mended = apart(&group, &case, |solver| every_point.after_step(&case, solver));
    check("every point", mended, [rounding, 1.5e-6], [rounding, 3e-9]);
}
