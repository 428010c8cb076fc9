//! Verification flows against their exact solutions.

use hydrograd::config::scene::{Config, Family, UpperWall};
use hydrograd::scene::composite_slab::Series;
use hydrograd::scene::developed::{parabola, Developed};
use hydrograd::scene::figures::FlowFigures;
use hydrograd::scene::flows::start_velocity;
use hydrograd::scene::Scene;
use hydrograd::sph::rows::Quantity;
use hydrograd::sph::solver::Solver;
use hydrograd::sph::Sweeps;
use std::f64::consts::PI;

/// Figures after every step up to `end`, the start first.
fn run<R: Sweeps>(flow: &Scene<R>, end: f64) -> Vec<FlowFigures> {
    let steps = (end / flow.model.dt).round() as usize;
    let mut solver = Solver::new(flow.model.clone(), flow.start.state.clone()).unwrap();
    let mut all = vec![flow.figures(&solver.state, 0.0)];
    for _ in 0..steps {
        solver.advance().unwrap();
        all.push(flow.figures(&solver.state, solver.step as f64 * flow.model.dt));
    }
    solver.check().unwrap();
    all
}

/// A built-in scene with settings.
fn scene<R: Sweeps>(name: &str, sets: &[&str]) -> Scene<R> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Scene::from_config(&Config::load(Some(name), None, &sets).unwrap().config).unwrap()
}

/// A built-in scene in the standard formulation with steps of the largest size.
fn standard<R: Sweeps>(name: &str, sets: &[&str]) -> Scene<R> {
    scene(name, &[&[STANDARD, "time.steps=1"], sets].concat())
}

/// Figures of a built-in scene at its end.
fn end(name: &str, sets: &[&str]) -> FlowFigures {
    let flow = scene::<f64>(name, sets);
    *run(&flow, flow.steps as f64 * flow.model.dt).last().unwrap()
}

/// -d ln(velocity)/dt from the first to the last figures.
fn decay_rate(all: &[FlowFigures]) -> f64 {
    let (first, last) = (all[0], all[all.len() - 1]);
    0.5 * (first.kinetic_energy / last.kinetic_energy).ln() / (last.time - first.time)
}

#[test]
fn exact_solutions_solve_the_equations() {
    // Residuals by central differences of the fields themselves, pressure eliminated: the vortices' vorticity omega obeys
    // d omega/dt + u.grad omega = nu laplace omega, the channel du/dt = F + nu d2u/dy2.
    let (nu, h) = (0.01, 1e-3);
    let vortices = scene::<f64>("taylor-green", &[]).exact;
    let u = |x: f64, y: f64, t: f64| vortices.velocity([x, y, 0.0], t).unwrap();
    let omega = |x: f64, y: f64, t: f64| {
        (u(x + h, y, t)[1] - u(x - h, y, t)[1] - u(x, y + h, t)[0] + u(x, y - h, t)[0]) / (2.0 * h)
    };
    for [x, y, t] in [[0.13, 0.41, 0.0], [0.77, 0.2, 0.4], [0.5, 0.9, 1.3]] {
        let by_x = (omega(x + h, y, t) - omega(x - h, y, t)) / (2.0 * h);
        let by_y = (omega(x, y + h, t) - omega(x, y - h, t)) / (2.0 * h);
        let by_t = (omega(x, y, t + h) - omega(x, y, t - h)) / (2.0 * h);
        let around = omega(x + h, y, t) + omega(x - h, y, t) + omega(x, y + h, t) + omega(x, y - h, t);
        let laplace = (around - 4.0 * omega(x, y, t)) / (h * h);
        let [a, b, _] = u(x, y, t);
        // Of terms of size 8 pi^2 nu * 4 pi = 10.
        let residual = by_t + a * by_x + b * by_y - nu * laplace;
        assert!(residual.abs() < 1e-3, "vorticity residual {residual} at {x}, {y}, {t}");
        let divergence = u(x + h, y, t)[0] - u(x - h, y, t)[0] + u(x, y + h, t)[1] - u(x, y - h, t)[1];
        assert!((divergence / (2.0 * h)).abs() < 1e-9);
    }
    // du/dt = nu d2u/dy2 beside a moving wall; at rest at first, in the end a line.
    let sheared = scene::<f64>("couette", &["flow.reynolds=2"]).exact;
    let u = |y: f64, t: f64| sheared.velocity([0.0, y, 0.0], t).unwrap()[0];
    for [y, t] in [[0.1, 0.3], [0.5, 0.1], [0.8, 1.0]] {
        let by_t = (u(y, t + h) - u(y, t - h)) / (2.0 * h);
        let residual = by_t - 0.5 * (u(y + h, t) - 2.0 * u(y, t) + u(y - h, t)) / (h * h);
        assert!(residual.abs() < 1e-4, "momentum residual {residual} at {y}, {t}");
        assert!(u(y, 1e-3).abs() < 1e-9 && u(0.0, t).abs() < 1e-12 && (u(1.0, t) - 1.0).abs() < 1e-12);
        assert!((u(y, 20.0) - y).abs() < 1e-12);
    }
    let channel = scene::<f64>("poiseuille", &["flow.reynolds=2"]).exact;
    let u = |y: f64, t: f64| channel.velocity([0.0, y, 0.0], t).unwrap()[0];
    let nu = 0.5;
    for [y, t] in [[0.1, 0.05], [0.5, 0.1], [0.8, 1.0]] {
        let by_t = (u(y, t + h) - u(y, t - h)) / (2.0 * h);
        let residual = by_t - 8.0 * nu - nu * (u(y + h, t) - 2.0 * u(y, t) + u(y - h, t)) / (h * h);
        assert!(residual.abs() < 1e-3 * 8.0 * nu, "momentum residual {residual} at {y}, {t}");
        // At rest first (the series is cut after 100 terms), no slip, and the steady parabola in the end.
        assert!(u(y, 0.0).abs() < 1e-6 && u(0.0, t).abs() < 1e-12 && u(1.0, t).abs() < 1e-12);
        assert!((u(y, 20.0) - 4.0 * y * (1.0 - y)).abs() < 1e-12);
    }
}

#[test]
fn taylor_green_decays_as_it_should() {
    let all = run(&standard::<f64>("taylor-green", &[]), 0.9);
    let (rate, exact) = (decay_rate(&all), 8.0 * std::f64::consts::PI.powi(2) * 0.01);
    let last = all.last().unwrap();
    let error = last.velocity_error.unwrap();
    println!("50 x 50, t = {:.3}: rate {rate:.4} of {exact:.4}, velocity error {error:.4}", last.time);
    // Measured: 7.6 % too fast and an error of 0.065 (disordered particles dissipate; it falls with the spacing, see
    // below). Without the transport velocity the rate is 34 % too fast, without disorder 80 %.
    assert!((rate / exact - 1.0).abs() < 0.10, "decay rate {rate}, exact {exact}");
    assert!(error < 0.08, "velocity error {error}");
}

#[test]
fn taylor_green_converges() {
    let error = |dx: &str| {
        let flow = standard::<f64>("taylor-green", &[dx]);
        run(&flow, 0.9).last().unwrap().velocity_error.unwrap()
    };
    let (coarse, middle, fine) =
        (error("resolution.dx=0.05"), error("resolution.dx=0.03125"), error("resolution.dx=0.02"));
    let order = (coarse / fine).ln() / 2.5_f64.ln();
    println!("20, 32, 50 a side: {coarse:.4} {middle:.4} {fine:.4}, order {order:.2}");
    assert!(coarse > middle && middle > fine);
    // First order measured (0.96): the error is that of sums over disordered particles.
    assert!(order > 0.8, "order {order}");
}

#[test]
fn taylor_green_in_three_dimensions_begins_to_decay_as_it_should() {
    // Without disorder, whose pressure waves would dissipate energy of their own; with it the lattice holds for a while.
    let all = run(&standard::<f64>("taylor-green-3d", &["time.jitter=0", "time.cfl=0.25"]), 0.6);
    let (rate, exact) = (decay_rate(&all), 3.0 / 50.0);
    println!("3D: rate {rate:.5} of {exact:.5}");
    // Measured: 3.5 % too slow, of which a third is the first step, which has no acceleration yet.
    assert!((rate / exact - 1.0).abs() < 0.05, "decay rate {rate}, exact {exact}");
    assert_eq!(all[0].velocity_error, None);
    // Of u = sin x cos y cos z, v = -cos x sin y cos z: a quarter of the box's volume.
    let energy = std::f64::consts::TAU.powi(3) / 8.0;
    assert!((all[0].kinetic_energy / energy - 1.0).abs() < 1e-12);
}

#[test]
fn poiseuille_converges_with_second_order() {
    // A fifth of the viscous time height^2/nu: the centre line has 86 % of its final velocity.
    let figures = |dx: &str| {
        let all = run(&standard::<f64>("poiseuille", &[dx, "flow.reynolds=1", "time.cfl=0.25"]), 0.2);
        (all[all.len() / 2].velocity_error.unwrap(), all[all.len() - 1].velocity_error.unwrap())
    };
    let found = ["resolution.dx=0.1", "resolution.dx=0.05", THIRTY].map(figures);
    println!("10, 20, 30 rows, error at t = 0.1 and 0.2: {found:?}");
    for (rows, (half, full)) in [10.0, 20.0, 30.0_f64].into_iter().zip(found) {
        // Measured 0.0103 (10/rows)^1.84 at the end, less half way.
        assert!(half < full && full < 0.0115 * (10.0 / rows).powf(1.75), "{rows} rows: {half}, {full}");
    }
}

#[test]
fn single_precision_agrees() {
    let end = 0.05;
    let sets = ["resolution.dx=0.03125", "time.cfl=0.25"];
    let double = run(&standard::<f64>("taylor-green", &sets), end);
    let single = run(&standard::<f32>("taylor-green", &sets), end);
    let (a, b) = (double.last().unwrap(), single.last().unwrap());
    println!("{a:?}\n{b:?}");
    assert!((a.kinetic_energy / b.kinetic_energy - 1.0).abs() < 1e-5);
    assert!((a.velocity_error.unwrap() - b.velocity_error.unwrap()).abs() < 1e-4);
}

#[test]
fn points_of_accuracy_fall_with_the_spacing() {
    let mut shares = vec![];
    let points = hydrograd::scene::accuracy::points(true, &mut |share| shares.push(share)).unwrap();
    assert!(shares.windows(2).all(|pair| pair[0] < pair[1]) && (shares[shares.len() - 1] - 1.0).abs() < 1e-12);
    assert_eq!(shares.len(), points.len());
    for (k, point) in points.iter().enumerate() {
        assert!(point.stable && point.seconds > 0.0, "{point:?}");
        // The next of the same scene and precision is finer.
        let next = points[k + 1..]
            .iter()
            .find(|p| p.scene == point.scene && p.precision == point.precision && p.code == point.code);
        if let Some(next) = next {
            assert!(next.dx < point.dx && next.error < point.error, "{next:?} is no better than {point:?}");
        }
    }
    for scene in ["taylor-green", "poiseuille", "heated-channel"] {
        assert!(points.iter().any(|point| point.scene == scene));
    }
}

#[test]
fn starts_as_jax_sph_does() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/reference/jax-sph-states.h5");
    let file = hdf5::File::open(path).unwrap();
    for (name, dimension) in [("tgv2d_tvf1", 2), ("tgv3d_tvf1", 3)] {
        let rows = |field: &str| file.dataset(&format!("{name}/0/{field}")).unwrap().read_raw::<f64>().unwrap();
        let (position, velocity) = (rows("r"), rows("u"));
        let config = if dimension == 2 { Family::TaylorGreen } else { Family::TaylorGreen3d }.defaults();
        for (r, u) in position.chunks(dimension).zip(velocity.chunks(dimension)) {
            let mut place = [0.0; 3];
            place[..dimension].copy_from_slice(r);
            let ours = start_velocity(&config, place);
            for d in 0..dimension {
                assert!((ours[d] - u[d]).abs() < 1e-14, "{name} at {r:?}: {ours:?}, {u:?}");
            }
        }
    }
}

#[test]
fn opposite_streams_follow_the_exact_solution() {
    let flow = standard::<f64>("reverse-poiseuille", &["resolution.dx=0.05"]);
    let all = run(&flow, 1.0);
    let last = all[all.len() - 1];
    // Measured: 0.5 % of the steady centre line, which is 1.25.
    assert!(last.velocity_error.unwrap() < 0.01, "{last:?}");
    assert!((last.kinetic_energy / last.exact_kinetic_energy.unwrap() - 1.0).abs() < 0.01, "{last:?}");
    let exact = flow.exact;
    for y in [0.2, 0.5, 0.9] {
        let [below, above] = [y, y + 1.0].map(|y| exact.velocity([0.0, y, 0.0], 50.0).unwrap()[0]);
        assert!((below - 4.0 * 1.25 * y * (1.0 - y)).abs() < 1e-9 && (below + above).abs() < 1e-9);
    }
}

#[test]
fn the_cavity_is_that_of_ghia() {
    // Ghia, Ghia and Shin (1982), Re = 100: u at x = 1/2, y = 0.4531; v at y = 1/2, x = 0.2344 and 0.8047.
    let flow = standard::<f64>("lid-driven-cavity", &["resolution.dx=0.04"]);
    let (n, l) = (flow.model.particles(), flow.model.rows);
    assert_eq!(n, 31 * 31);
    let mut solver = Solver::new(flow.model.clone(), flow.start.state.clone()).unwrap();
    while (solver.step as f64) < 10.0 / flow.model.dt {
        solver.advance().unwrap();
    }
    solver.check().unwrap();
    let dx = flow.spacing;
    let near = |x: f64, y: f64, component: usize| {
        let (mut weight, mut sum) = (0.0, 0.0);
        for i in (0..n).filter(|&i| flow.model.is_fluid(i)) {
            let [a, b] = [0, 1].map(|d| solver.state[d * n + i] - 3.0 * dx);
            let w = (-((a - x).powi(2) + (b - y).powi(2)) / (dx * dx)).exp();
            weight += w;
            sum += w * solver.state[(l.velocity() + component) * n + i];
        }
        sum / weight
    };
    // Measured at this spacing: -0.163, 0.163, -0.180; at half of it -0.196, 0.172, -0.229.
    for (x, y, component, ghia, tolerance) in
        [(0.5, 0.4531, 0, -0.21090, 0.06), (0.2344, 0.5, 1, 0.17527, 0.025), (0.8047, 0.5, 1, -0.24533, 0.08)]
    {
        let found = near(x, y, component);
        assert!((found - ghia).abs() < tolerance, "{found} for {ghia}");
    }
}

const STANDARD: &str = "method.name=standard";
const THIRTY: &str = "resolution.dx=0.03333333333333333";

#[test]
fn a_channel_starts_as_it_should() {
    // At a tenth of the viscous time, 30 particles across, over the steady centre line. Measured: 5.8e-5, and 7.5e-4 in the
    // standard formulation.
    let (short, standard) = ("time.end=0.00125", end("poiseuille", &[THIRTY, "time.end=0.00125", STANDARD]));
    let error = end("poiseuille", &[THIRTY, short]).velocity_error.unwrap();
    assert!(error < 1e-4, "{error}");
    assert!(standard.velocity_error.unwrap() < 1e-3 && standard.velocity_error.unwrap() > error);
    // The moving wall: 4.4e-4 at a twentieth, 7.3e-5 at a fifth; 1.0e-3 and 3.2e-4.
    for (time, most, most_standard) in [("time.end=0.05", 6e-4, 1.3e-3), ("time.end=0.2", 1e-4, 4e-4)] {
        let error = end("couette", &[THIRTY, time]).velocity_error.unwrap();
        let standard = end("couette", &[THIRTY, time, STANDARD]).velocity_error.unwrap();
        println!("couette, {time}: {error:.2e}, standard {standard:.2e}");
        assert!(error < most && standard < most_standard && error < standard, "{time}: {error}, {standard}");
    }
}

#[test]
fn heat_goes_through_a_slab_as_it_should() {
    let exact_end = |found: FlowFigures, temperature: f64, flux: f64| {
        let (error, [lower, upper]) = (found.temperature_error.unwrap(), found.wall_flux.unwrap());
        let exact = found.exact_wall_flux.unwrap();
        println!("{error:.2e} {lower} {upper} {exact:?}");
        assert!(error < temperature, "{found:?}");
        assert!((lower / exact[0] - 1.0).abs() < flux && (upper / exact[1] - 1.0).abs() < flux, "{found:?}");
        assert!(found.largest_velocity < 1e-9, "at rest");
    };
    // On its way, and steady, where a line is exact. 25 across.
    let coarse = "resolution.dx=0.04166666666666667";
    exact_end(end("slab", &[coarse]), 5e-4, 5e-3);
    exact_end(end("slab", &[coarse, "time.end=3"]), 1e-9, 1e-8);
    exact_end(end("slab", &[coarse, STANDARD]), 1e-3, 1e-2);
    // Two materials. The ratios alone make it the standard formulation.
    let jump = ["heat.conductivity_ratio=1000", "heat.capacity_ratio=1000"];
    let materials = scene::<f64>("slab", &jump);
    assert!(materials.model.name() == "standard" && materials.model.heat.as_ref().unwrap().materials.is_some());
    // Measured at 50 across: 5.2e-4 and 0.5 % on its way, 5.9e-4 and 0.35 % when steady.
    exact_end(end("slab", &jump), 7e-4, 7e-3);
    exact_end(end("slab", &[jump[0], jump[1], "time.end=0.8"]), 7e-4, 5e-3);
}

#[test]
fn fluxes_of_two_materials_are_the_same_through_every_plane() {
    // When nothing changes any more, what conduction brings to the particles below a plane is what goes through it.
    let sets = ["heat.conductivity_ratio=1000", "heat.capacity_ratio=1000", "resolution.dx=0.05", "time.end=2"];
    let flow = scene::<f64>("slab", &sets);
    let (n, l) = (flow.model.particles(), flow.model.rows);
    let mut solver = Solver::new(flow.model.clone(), flow.start.state.clone()).unwrap();
    while solver.step < flow.steps {
        solver.advance().unwrap();
    }
    let warming = &solver.state[l.row(Quantity::TemperatureRate).unwrap() * n..][..n];
    // Against the flux of 2, per particle of 20 rows: rates of 40 where heat came through one of its sides only.
    let largest = warming.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()));
    assert!(largest < 1e-2, "{largest}");
    // And the temperature falls in the lower half alone.
    let at = |row: usize| solver.state[l.temperature().unwrap() * n + 8 * (3 + row)];
    assert!((at(0) - 1.0 + 0.025 * 2.0).abs() < 0.02 && at(10).abs() < 0.02, "{} {}", at(0), at(10));
}

#[test]
fn warm_walls_have_the_nusselt_number_of_theory() {
    // 12 across; at 20 it is 0.23 % and 0.03 % (src/scene/README.md).
    let coarse = "resolution.dx=0.08333333333333333";
    let both = end("isothermal-channel", &[coarse]);
    let one = end("isothermal-channel", &[coarse, "heat.upper_wall=adiabatic", "channel.length=7", "time.end=25"]);
    for (found, theory) in [(both, 7.5407), (one, 4.8608)] {
        let (nusselt, exact) = (found.nusselt.unwrap(), found.exact_nusselt.unwrap());
        println!("Nusselt number {nusselt:.4}, exact {exact:.4}, without conduction along the channel {theory}");
        assert!((nusselt / exact - 1.0).abs() < 0.01 && (exact / theory - 1.0).abs() < 0.01, "{nusselt} {exact}");
        assert!(found.velocity_error.unwrap() < 1e-6);
    }
}

#[test]
fn opposite_streams_in_three_dimensions_follow_the_exact_solution() {
    let sets = ["resolution.dx=0.0625", "time.end=0.5"];
    let found = end("reverse-poiseuille-3d", &sets);
    println!("{:?}", found);
    assert!(found.velocity_error.unwrap() < 0.01, "{found:?}");
    assert!((found.kinetic_energy / found.exact_kinetic_energy.unwrap() - 1.0).abs() < 0.02, "{found:?}");
}

#[test]
fn one_material_has_the_series_of_a_plate() {
    // T = 1 - y - sum 2/(n pi) sin(n pi y) exp(-n^2 pi^2 t) (Carslaw and Jaeger 1959, section 3.4).
    let series = Series::new(1.0, 1.0);
    for [y, t] in [[0.1, 0.003], [0.3, 0.01], [0.5, 0.05], [0.77, 0.1], [0.9, 1.0]] {
        let term = |n: f64| 2.0 / (n * PI) * (n * PI * y).sin() * (-n * n * PI * PI * t).exp();
        let plate = 1.0 - y - (1..300).map(|n| term(n as f64)).sum::<f64>();
        assert!((series.temperature(y, t) - plate).abs() < 1e-12, "{y}, {t}");
    }
    assert!(series.temperature(0.3, 0.0005).abs() < 1e-12, "the heat has not come yet");
    let flux = series.wall_flux(0.001);
    assert!((flux[0] - 1.0 / (PI * 0.001).sqrt()).abs() < 1e-6 && flux[1].abs() < 1e-9, "{flux:?}");
}

#[test]
fn two_materials_obey_the_equation_and_the_interface() {
    for (k, c) in [(1000.0, 1000.0), (10.0, 1.0), (0.01, 0.5), (3.0, 7.0)] {
        let series = Series::new(k, c);
        let (h, alpha) = (1e-4, [1.0, k / c]);
        let t = 0.07 / alpha[1].max(1.0);
        for y in [0.05, 0.2, 0.41, 0.6, 0.8, 0.95] {
            let at = |y: f64, t: f64| series.temperature(y, t);
            let by_t = (at(y, t * 1.001) - at(y, t * 0.999)) / (0.002 * t);
            let spread = (at(y + h, t) - 2.0 * at(y, t) + at(y - h, t)) / (h * h);
            let residual = by_t - alpha[(y > 0.5) as usize] * spread;
            assert!(residual.abs() < 1e-3 * by_t.abs().max(1.0), "{k}, {c}: {residual} of {by_t} at {y}");
        }
        let near = |y: f64| series.temperature(y, t);
        assert!((near(0.5 - 1e-9) - near(0.5)).abs() < 1e-6);
        let slope = |y: f64| (near(y + 2.0 * h) - near(y)) / (2.0 * h);
        let (below, above) = (-slope(0.5 - 3.0 * h), -k * slope(0.5 + h));
        assert!((below - above).abs() < 0.02 * below.abs().max(0.05), "{k}, {c}: {below}, {above}");
        assert!((near(0.0) - 1.0).abs() < 1e-9 && near(1.0).abs() < 1e-9);
        // The steady flux is that of two resistances in series.
        let [lower, upper] = series.wall_flux(1e4);
        assert!((lower - 1.0 / (0.5 + 0.5 / k)).abs() < 1e-9 && (lower - upper).abs() < 1e-9);
        // The heat that has passed through the walls equals the heat in the slab.
        let held: f64 = (0..4000)
            .map(|j| (j as f64 + 0.5) / 4000.0)
            .map(|y| (if y < 0.5 { 1.0 } else { c }) * near(y) / 4000.0)
            .sum();
        let steps = 20_000;
        let come: f64 = (0..steps)
            .map(|j| {
                // Even in sqrt(t), because the flux begins as 1/sqrt(t).
                let (a, b) = (j as f64 / steps as f64, (j + 1) as f64 / steps as f64);
                let [lower, upper] = series.wall_flux(t * (0.5 * (a + b)).powi(2));
                (lower - upper) * t * (b * b - a * a)
            })
            .sum();
        // (The series of the flux is truncated at the start.)
        assert!((come / held - 1.0).abs() < 0.02, "{k}, {c}: {come} of {held}");
    }
}

#[test]
fn nusselt_numbers_are_those_of_the_literature() {
    let of = |diffusivity, upper_wall| Developed::new(diffusivity, upper_wall, [0.0, 10.0]);
    // Peclet number 4/3 / diffusivity.
    let both = of(1e-4, UpperWall::Isothermal).nusselt;
    assert!((both - 7.5407).abs() < 1e-4, "{both}");
    let one = of(1e-4, UpperWall::Adiabatic).nusselt;
    assert!((one - 4.8608).abs() < 1e-4, "{one}");
    // With conduction only it is 8.1174 (Shah and London 1978, eq. 308).
    let slow = of(1e4, UpperWall::Isothermal).nusselt;
    assert!((slow - 8.1174).abs() < 1e-3, "{slow}");
}

#[test]
fn the_balance_of_an_exact_profile_is_its_nusselt_number() {
    const DIFFUSIVITY: f64 = 1.0 / 60.0;
    for upper_wall in [UpperWall::Isothermal, UpperWall::Adiabatic] {
        let developed = Developed::new(DIFFUSIVITY, upper_wall, [1.0, 20.0]);
        let b = developed.decay(0);
        // The exact profile at the positions of particles.
        let profile = |y: f64| {
            let (steps, mut f, mut slope) = (4000, 0.0, 1.0);
            let h = y / steps as f64;
            for k in 0..steps {
                let middle = (k as f64 + 0.5) * h;
                let half = f + 0.5 * h * slope;
                slope -= h * (b * b + b * parabola(middle) / DIFFUSIVITY) * half;
                f = half + 0.5 * h * slope;
            }
            f
        };
        let rows: Vec<(f64, f64)> = (0..100).map(|k| (k as f64 + 0.5) / 100.0).map(|y| (y, profile(y))).collect();
        let all = (0..2000).flat_map(|c| rows.iter().map(move |&(y, f)| (0.01 * (c as f64 + 0.5), y, f)));
        let particles = all.map(|(x, y, f)| [x, 1e-4 * parabola(y), 1e-4, f * (-b * x).exp()]);
        let (found, exact) = (developed.measured(particles).unwrap(), developed.nusselt);
        assert!((found / exact - 1.0).abs() < 3e-4, "{found} {exact}");
    }
}
