//! Fixed particles: what a step keeps, its adjoint, and the heated channel against finite elements.

use crate::support::noise::noise;
use candle_core::{Device, Tensor, Var};
use hydrograd::config::scene::{Config, KernelName};
use hydrograd::design::parametrisations::{Nodes, Polygon};
use hydrograd::design::shape::{default_nodes, HotSection};
use hydrograd::design::Parametrisation;
use hydrograd::numerics::lanes::{Lanes, Real};
use hydrograd::sph::fixed::channel::EDGE;
use hydrograd::sph::fixed::ghosts::{temperature, Ghosts, ON_WALL};
use hydrograd::sph::fixed::grid::{Fields, Grid};
use hydrograd::sph::fixed::steady::SteadyOptions;
use hydrograd::sph::fixed::stencil::{derivative, stencil, Weight};
use hydrograd::sph::fixed::{row, Channel, Fixed};
use hydrograd::sph::kernels::Kernel;
use hydrograd::sph::laws::drive::Drive;
use hydrograd::validation::reference::heated_channel_outflow;

/// The heated channel of length 1 and height 0.2.
fn channel(dx: f64) -> Channel {
    let columns = (1.0 / dx).round() as usize;
    Channel {
        columns,
        rows: (0.2 / dx).round() as usize,
        spacing: dx,
        first_column_x: if dx == 0.02 { 0.0 } else { 0.5 * dx },
        kernel: Kernel::new(KernelName::QuinticSpline, 2, dx),
        density: 1.0,
        sound_speed: 10.0,
        viscosity: 0.01,
        diffusivity: 7.313 / 305.27,
        body_force: 2.3,
        drive: None,
        delta: 0.1,
        dt: 1.2 * dx / 11.0,
        hot: [0.25, 0.75],
        hot_excess: 0.23,
        inlet_below: 0.06,
        outlet_above: 0.94,
        conormal: 1.0,
    }
}

/// Other numbers than a channel's, so that nothing is 1 or 0 by chance: edges that cut columns, a density.
fn odd_channel() -> Channel {
    Channel {
        columns: 19,
        rows: 6,
        spacing: 0.05,
        first_column_x: 0.013,
        kernel: Kernel::new(KernelName::QuinticSpline, 2, 0.05),
        density: 1.7,
        dt: 0.002,
        hot: [0.31, 0.62],
        inlet_below: 0.1,
        outlet_above: 0.8,
        ..channel(0.02)
    }
}

/// What drives the flow: the body force, or something that is held.
fn drives(channel: &Channel) -> [Channel; 3] {
    let held = |drive| Channel { body_force: 0.0, drive: Some(drive), ..channel.clone() };
    [channel.clone(), held(Drive::Momentum(0.21)), held(Drive::Power(0.43))]
}

/// A state of noise between walls of noise.
fn noisy<R: Real>(fixed: &Fixed<R>, seed: u64) -> Vec<R> {
    let mut next = noise(seed);
    let c = &fixed.channel;
    let mut wall = || (0..c.columns).map(|_| 0.2 * c.spacing * next()).collect::<Vec<_>>();
    let (bottom, top) = (wall(), wall());
    let mut state = fixed.state(&bottom, &top, &|_| 0.0);
    let n = fixed.particles();
    for (row, size) in [(row::U, 1.0), (row::V, 0.5), (row::P, 2.0), (row::T, 0.2)] {
        for i in 0..fixed.fluid_particles() {
            state[row * n + i] = R::of(size * next());
        }
    }
    state
}

fn step<R: Real>(fixed: &Fixed<R>, state: &[R]) -> Vec<R> {
    let mut next = vec![R::of(f64::NAN); state.len()];
    fixed.forward(state, &mut next, &mut fixed.work());
    next
}

fn pull<R: Real>(fixed: &Fixed<R>, state: &[R], bar: &[R]) -> Vec<R> {
    let mut state_bar = vec![R::of(f64::NAN); state.len()];
    fixed.backward(state, bar, &mut state_bar, &mut fixed.work());
    state_bar
}

/// Largest difference over largest number.
fn difference<R: Real, S: Real>(a: &[R], b: &[S]) -> f64 {
    let most = b.iter().fold(0.0, |most: f64, x| most.max(x.f64().abs()));
    let apart = a.iter().zip(b).fold(0.0, |most: f64, (x, y)| {
        let apart = (x.f64() - y.f64()).abs();
        if apart.is_nan() {
            f64::INFINITY
        } else {
            most.max(apart)
        }
    });
    if most > 0.0 {
        apart / most
    } else {
        apart
    }
}

/// Rows of a state apart, because their sizes differ.
fn by_rows<R: Real, S: Real>(a: &[R], b: &[S]) -> f64 {
    let n = a.len() / row::COUNT;
    a.chunks(n).zip(b.chunks(n)).fold(0.0, |most, (a, b)| most.max(difference(a, b)))
}

#[test]
fn a_step_and_its_adjoint_are_those_of_the_composed_twin() {
    let channels = [drives(&odd_channel()), drives(&channel(0.02))].concat();
    for (number, channel) in channels.into_iter().enumerate() {
        let fixed = Fixed::<f64>::new(channel).unwrap();
        let state = noisy(&fixed, 1 + number as u64);
        let shape = (row::COUNT, fixed.particles());
        let variable = Var::from_tensor(&Tensor::from_vec(state.clone(), shape, &Device::Cpu).unwrap()).unwrap();
        let next = fixed.composed(&variable).unwrap();
        let expected: Vec<f64> = next.flatten_all().unwrap().to_vec1().unwrap();
        let found = by_rows(&step(&fixed, &state), &expected);
        assert!(found < 1e-12, "step {number}: {found:e}");
        let mut random = noise(77);
        let bar: Vec<f64> = expected.iter().map(|_| random()).collect();
        let value = (next * Tensor::from_vec(bar.clone(), shape, &Device::Cpu).unwrap()).unwrap().sum_all().unwrap();
        let gradients = value.backward().unwrap();
        let expected: Vec<f64> = gradients.get(&variable).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        let pulled = pull(&fixed, &state, &bar);
        let n = fixed.particles();
        for r in 0..row::COUNT {
            let found = difference(&pulled[r * n..(r + 1) * n], &expected[r * n..(r + 1) * n]);
            assert!(found < 1e-10, "adjoint {number}, row {r}: {found:e}");
        }
        let mut flow = vec![0.0; bar.len()];
        fixed.backward_of_flow(&state, &bar, &mut flow, &mut fixed.work());
        assert_eq!(flow[2 * n..], pulled[2 * n..]);
        assert_eq!(flow[..2 * n], bar[..2 * n]);
    }
}

#[test]
fn the_adjoint_is_the_slope_of_ten_steps() {
    drives(&odd_channel()).into_iter().for_each(the_adjoint_is_the_slope);
}

fn the_adjoint_is_the_slope(channel: Channel) {
    let fixed = Fixed::<f64>::new(channel).unwrap();
    let state = noisy(&fixed, 5);
    let mut random = noise(6);
    let weights: Vec<f64> = state.iter().map(|_| random()).collect();
    let run = |state: &[f64]| {
        let mut states = vec![state.to_vec()];
        for _ in 0..10 {
            states.push(step(&fixed, states.last().unwrap()));
        }
        states
    };
    let value = |state: &[f64]| -> f64 { run(state)[10].iter().zip(&weights).map(|(a, b)| a * b).sum() };
    let mut bar = weights.clone();
    for state in run(&state)[..10].iter().rev() {
        bar = pull(&fixed, state, &bar);
    }
    let n = fixed.particles();
    let walls = row::Y * n + fixed.fluid_particles()..(row::Y + 1) * n;
    for (name, range) in [("walls", walls), ("flow", row::U * n..row::COUNT * n)] {
        let fluid = |k: usize| k < 2 * n || k % n < fixed.fluid_particles();
        let direction: Vec<f64> =
            (0..state.len()).map(|k| if range.contains(&k) && fluid(k) { random() } else { 0.0 }).collect();
        let at = |h: f64| value(&state.iter().zip(&direction).map(|(x, d)| x + h * d).collect::<Vec<_>>());
        let h = 1e-5 * if name == "walls" { 0.1 } else { 1.0 };
        // Fourth order.
        let slope = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
        let exact: f64 = bar.iter().zip(&direction).map(|(a, b)| a * b).sum();
        assert!((slope / exact - 1.0).abs() < 1e-6, "{name}: {slope} {exact}, {:?}", fixed.channel.drive);
    }
}

/// A short and viscous channel, which settles soon.
fn viscous_channel() -> Channel {
    Channel {
        columns: 15,
        spacing: 0.025,
        kernel: Kernel::new(KernelName::QuinticSpline, 2, 0.025),
        viscosity: 0.1,
        diffusivity: 0.1,
        body_force: 20.0,
        dt: 0.0012,
        hot: [0.1, 0.21],
        inlet_below: 0.05,
        outlet_above: 0.35,
        ..odd_channel()
    }
}

/// The flow at a given flow rate, or power, is the one under the body force that has it; and each step keeps what is given.
#[test]
fn a_drive_finds_the_body_force() {
    let under_force = Fixed::<f64>::new(viscous_channel()).unwrap();
    let mut random = noise(22);
    let walls: Vec<f64> = (0..30).map(|_| 0.002 * random()).collect();
    let at_rest = |fixed: &Fixed<f64>| fixed.state(&walls[..15], &walls[15..], &|_| 0.0);
    let momentum = |fixed: &Fixed<f64>, state: &[f64]| -> f64 {
        let (n, weights, volumes) = (fixed.particles(), fixed.section_weights(), fixed.volumes(state));
        let mass = |i: usize| weights[i] * volumes[i] * fixed.density(state[row::P * n + i]);
        (0..fixed.fluid_particles()).map(|i| mass(i) * state[row::U * n + i]).sum()
    };
    let mut expected = at_rest(&under_force);
    under_force.settle(&mut expected, 20, 20, 1e-11, 100_000);
    let (force, moved) = (under_force.channel.body_force, momentum(&under_force, &expected));
    for drive in [Drive::Momentum(moved), Drive::Power(force * moved)] {
        let channel = Channel { body_force: 0.0, drive: Some(drive), ..viscous_channel() };
        let fixed = Fixed::<f64>::new(channel).unwrap();
        let mut state = at_rest(&fixed);
        fixed.settle(&mut state, 20, 20, 1e-11, 100_000);
        let found = by_rows(&state, &expected);
        assert!(found < 1e-7, "{drive:?}: {found:e}");
        let mut next = state.clone();
        let force_found = fixed.forward(&state, &mut next, &mut fixed.work());
        assert!((force_found / force - 1.0).abs() < 1e-7, "{drive:?}: {force_found}");
        // What is held does not wait for the steady state. The density is that before the step.
        let start = noisy(&fixed, 3);
        let force = fixed.forward(&start, &mut next, &mut fixed.work());
        let n = fixed.particles();
        next[row::P * n..row::T * n].copy_from_slice(&start[row::P * n..row::T * n]);
        let held = momentum(&fixed, &next);
        match drive {
            Drive::Momentum(wanted) => assert!((held / wanted - 1.0).abs() < 1e-12, "{held} {wanted}"),
            Drive::Power(wanted) => assert!((force * held / wanted - 1.0).abs() < 1e-12, "{force} {held} {wanted}"),
        }
    }
}

#[test]
fn a_step_keeps_mass() {
    for channel in [odd_channel(), channel(0.02)] {
        let fixed = Fixed::<f64>::new(channel).unwrap();
        let mut state = noisy(&fixed, 9);
        let c = fixed.channel.clone();
        let mass = |state: &[f64]| -> f64 {
            let p = &state[row::P * fixed.particles()..];
            let stiffness = c.density * c.sound_speed * c.sound_speed;
            fixed.volumes(state).iter().zip(p).map(|(v, p)| v * (1.0 + p / stiffness)).sum()
        };
        let before = mass(&state);
        for _ in 0..20 {
            state = step(&fixed, &state);
        }
        assert!((mass(&state) / before - 1.0).abs() < 1e-14, "{:e}", mass(&state) / before - 1.0);
    }
}

#[test]
fn a_uniform_pressure_exerts_no_force() {
    let fixed = Fixed::<f64>::new(Channel { body_force: 0.0, ..channel(0.02) }).unwrap();
    let mut state = noisy(&fixed, 3);
    let n = fixed.particles();
    state[2 * n..].fill(0.0);
    state[row::P * n..][..fixed.fluid_particles()].fill(10.0);
    let next = step(&fixed, &state);
    let force = next[row::U * n..row::P * n].iter().fold(0.0, |most: f64, u| most.max(u.abs())) / fixed.channel.dt;
    assert!(force < 1e-10, "an acceleration of {force:e} where p / dx is 500");
    // Nor does the fluid move at all.
    assert!(difference(&next[row::P * n..row::T * n], &state[row::P * n..row::T * n]) < 1e-13);
}

#[test]
fn single_precision_is_close() {
    let (double, single) = (Fixed::<f64>::new(channel(0.02)).unwrap(), Fixed::<f32>::new(channel(0.02)).unwrap());
    let state = single.state(&[0.0; 50], &[0.0; 50], &|y| 115.0 * y * (0.2 - y));
    let mut state: Vec<f32> = state;
    let n = single.particles();
    let mut random = noise(4);
    for k in row::P * n..row::P * n + single.fluid_particles() {
        state[k] = 0.1 * random() as f32;
    }
    for i in 0..50 {
        state[row::Y * n + single.fluid_particles() + i] = 0.003 * random() as f32;
    }
    let wide: Vec<f64> = state.iter().map(|&x| x as f64).collect();
    let found = by_rows(&step(&single, &state), &step(&double, &wide));
    assert!(found < 1e-5, "{found:e}");
    let bar: Vec<f64> = wide.iter().map(|_| random()).collect();
    let narrow: Vec<f32> = bar.iter().map(|&x| x as f32).collect();
    let found = by_rows(&pull(&single, &state, &narrow), &pull(&double, &wide, &bar));
    assert!(found < 2e-5, "{found:e}");
}

/// All bits of a step and of its adjoint, mixed.
fn bits<R: Real>() -> u64 {
    let fixed = Fixed::<R>::new(odd_channel()).unwrap();
    let state = noisy(&fixed, 8);
    let next = step(&fixed, &step(&fixed, &state));
    let bar = pull(&fixed, &state, &next);
    next.iter()
        .chain(&bar)
        .fold(0, |hash: u64, x| (hash ^ x.f64().to_bits()).wrapping_mul(0x100_0000_01B3).rotate_left(7))
}

#[test]
#[ignore = "run by a_step_has_the_same_bits_for_any_number_of_threads"]
fn print_bits() {
    println!("bits {:x} {:x}", bits::<f64>(), bits::<f32>());
}

#[test]
fn a_step_has_the_same_bits_for_any_number_of_threads() {
    let run = |threads: &str| {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "fixed_particles::print_bits", "--nocapture"])
            .env("RAYON_NUM_THREADS", threads)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let line = text.lines().find_map(|line| line.split_once("bits ")).map(|(_, bits)| bits.to_string());
        line.unwrap_or_else(|| panic!("no bits in {text}"))
    };
    let one = run("1");
    for threads in ["2", "3", "5"] {
        assert_eq!(run(threads), one, "{threads} threads");
    }
    assert_eq!(format!("{:x} {:x}", bits::<f64>(), bits::<f32>()), one);
}

#[test]
fn the_gradient_of_a_steady_state_is_its_slope() {
    drives(&viscous_channel()).into_iter().for_each(the_steady_gradient_is_the_slope);
}

fn the_steady_gradient_is_the_slope(channel: Channel) {
    let fixed = Fixed::<f64>::new(channel).unwrap();
    let n = fixed.particles();
    let mut random = noise(21);
    let walls: Vec<f64> = (0..30).map(|_| 0.002 * random()).collect();
    let direction: Vec<f64> = (0..30).map(|_| random()).collect();
    let mut weights: Vec<f64> = (0..6 * n).map(|_| random()).collect();
    weights[..2 * n].fill(0.0);
    let settle = |walls: &[f64]| {
        let mut state = fixed.state(&walls[..15], &walls[15..], &|_| 0.0);
        for steps in 0.. {
            let next = step(&fixed, &state);
            let rest = fixed.residual(&state, &next);
            state = next;
            if rest < 1e-10 {
                break;
            }
            assert!(steps < 20_000, "still changing by {rest:e}");
        }
        state
    };
    let at = |h: f64| -> f64 {
        let walls: Vec<f64> = walls.iter().zip(&direction).map(|(w, d)| w + h * d).collect();
        settle(&walls).iter().zip(&weights).map(|(x, w)| x * w).sum()
    };
    let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
    let options = SteadyOptions { tolerance: 1e-10, ..SteadyOptions::default() };
    let found = fixed.steady_gradient(&settle(&walls), &weights, &options);
    let exact: f64 = found.walls.iter().zip(&direction).map(|(g, d)| g * d).sum();
    assert!((slope / exact - 1.0).abs() < 1e-5, "{slope} {exact}, {} steps, {:e}", found.steps, found.residual);
}

/// Over a wall that is far from flat, in few steps: the same state, with the same mass.
#[test]
fn newtons_method_finds_what_steps_find() {
    drives(&channel(0.02)).into_iter().for_each(newton_finds_what_steps_find);
}

fn newton_finds_what_steps_find(channel: Channel) {
    let fixed = Fixed::<f64>::new(channel).expect("a channel");
    let ridges: Vec<f64> = (0..25).map(|k| 0.02 * (0.8 * f64::from(k)).cos()).collect();
    let flat = vec![0.0; fixed.channel.columns];
    let mut by_steps = fixed.state(&wall(&fixed, &ridges), &flat, &|_| 0.0);
    let mut by_newton = by_steps.clone();
    let (many, _) = fixed.settle(&mut by_steps, 20, 20, 1e-9, 100_000);
    let (few, residual) = fixed.settle_by_newton(&mut by_newton, 1e-9).expect("a steady state");
    println!("{many} steps or {few}");
    assert!(residual <= 1e-9 && few < 100 && many > 10 * few, "{few} of {many} steps, {residual:e}");
    let c = &fixed.channel;
    for (k, (one, other)) in by_steps.iter().zip(&by_newton).enumerate() {
        let size = if k / fixed.particles() == row::P { c.density * c.sound_speed } else { 1.0 };
        assert!((one - other).abs() < 1e-7 * size, "{k}: {one} {other}");
    }
}

/// The wall of 25 nodes at x = 0.26, 0.28 .. 0.74, linear between them and 0 from 0.24 and 0.76 on, at each column.
fn wall(fixed: &Fixed<f64>, nodes: &[f64]) -> Vec<f64> {
    let c = &fixed.channel;
    (0..c.columns)
        .map(|i| {
            let hat = |k: usize| (1.0 - (c.x(i) - 0.26 - 0.02 * k as f64).abs() / 0.02).max(0.0);
            (0..25).map(|k| hat(k) * nodes[k]).sum()
        })
        .collect()
}

/// Q through x = 0.9 in rho u T units, and its derivative by the state.
fn heat_outflow(fixed: &Fixed<f64>, state: &[f64]) -> (f64, Vec<f64>) {
    let state = Var::from_slice(state, (row::COUNT, fixed.particles()), &Device::Cpu).expect("a tensor");
    let heat = fixed.carried(&state, 0.9).expect("heat");
    let bars = heat.backward().expect("a gradient");
    let bar = bars.get(&state).expect("a gradient").flatten_all().expect("one row").to_vec1().expect("numbers");
    (heat.to_scalar().expect("a number"), bar)
}

/// In a steady flow the heat that pairs carry through any section is that of the walls, but for what is conducted along x.
#[test]
fn the_heat_of_the_walls_flows_out() {
    let fixed = Fixed::<f64>::new(channel(0.02)).expect("a channel");
    let bump: Vec<f64> = (0..25).map(|k| 0.01 * (0.4 * f64::from(k)).sin()).collect();
    let flat = vec![0.0; fixed.channel.columns];
    let mut state = fixed.state(&wall(&fixed, &bump), &flat, &|y| 115.0 * y * (0.2 - y));
    fixed.settle(&mut state, 20, 20, 1e-7, 40_000);
    let tensor = Tensor::from_slice(&state, (row::COUNT, fixed.particles()), &Device::Cpu).expect("a tensor");
    let at = |x: f64| {
        let number = |heat: candle_core::Result<Tensor>| heat.expect("heat").to_scalar::<f64>().expect("a number");
        (number(fixed.carried(&tensor, x)), number(fixed.heating(&tensor, x)))
    };
    let conducted = |x: f64| at(x).1 / at(x).0 - 1.0;
    // Far behind the hot wall nothing is conducted along x; at its end much is.
    assert!(conducted(0.9).abs() < 1e-3, "{}", conducted(0.9));
    assert!(conducted(0.7).abs() > 2e-3, "{}", conducted(0.7));
    // Above a curved wall columns have different heights, and the section may lie anywhere between columns.
    let (one, other) = (at(0.85).0, at(0.913).0);
    // A thousandth more is conducted through the nearer one.
    assert!((one / other - 1.0).abs() < 1.5e-3, "{one} {other}");
}

/// Sound that runs with a fast flow grows in steps that sound in a fluid at rest allows, and not in those of the configuration.
#[test]
fn steps_are_so_short_that_sound_does_not_grow_in_the_flow() {
    let sets =
        ["channel.height=0.3", "fluid.viscosity=0.0174", "fluid.body_force=3.18", "fluid.reference_velocity=2.056"];
    let sets: Vec<String> = ["method.name=fixed"].iter().chain(&sets).map(|set| set.to_string()).collect();
    let config = Config::load(Some("heated-channel"), None, &sets).unwrap().config;
    let limits = config.time_step_limits();
    assert_eq!(limits.acoustic, limits.growth);
    assert!(config.time_step() <= limits.growth);
    let usual = config.time.cfl * config.resolution.dx / (config.sound_speed() + config.fluid.reference_velocity);
    assert!((0.8..0.99).contains(&(limits.growth / usual)), "{}", limits.growth / usual);
    let still_finite = |dt: f64| {
        let own = Channel { rows: 15, sound_speed: 20.56, viscosity: 0.0174, body_force: 3.18, dt, ..channel(0.02) };
        let fixed = Fixed::<f64>::new(own).unwrap();
        let wall: Vec<f64> = (0..50).map(|k| 0.005 * (6.0 * std::f64::consts::PI * k as f64 * 0.02).sin()).collect();
        let mut state = fixed.state(&wall, &[0.0; 50], &|y| 3.18 / (2.0 * 0.0174) * y * (0.3 - y));
        (0..4000).for_each(|_| state = step(&fixed, &state));
        state.iter().all(|x| x.is_finite())
    };
    assert!(still_finite(config.time_step()));
    assert!(!still_finite(1.08 * usual));
}

/// Rows of nodes and Q of finite elements.
fn reference_shapes() -> Vec<(String, f64, Vec<f64>)> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/reference/fem-shapes-H0.2.csv");
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let nodes = cells[13..38].iter().map(|x| x.parse().unwrap()).collect();
        (format!("{} {}", cells[0], cells[1]), cells[3].parse().unwrap(), nodes)
    };
    text.lines().skip(1).map(row).collect()
}

/// Over walls that slope by 1 where the hot section begins and ends, with kinks a spacing beside, gains are those of finite elements. (With conormal
/// derivatives from the first row instead of the wall and a polygon that cuts kinks off they were 0.12 and 0.15 % of Q too large.)
#[test]
fn slopes_at_the_ends_of_the_hot_section() {
    let fixed = Fixed::<f64>::new(channel(0.01)).expect("a channel");
    let c = &fixed.channel;
    let section = HotSection { from: 0.25, to: 0.75, dx: c.spacing, length: 1.0 };
    let polygon = Polygon { x: (0..c.columns).map(|i| c.x(i)).collect(), keeps_area: Some(c.spacing) };
    let nodes = Nodes::new(default_nodes(0.25, 0.75, 0.02), section, 0.02).expect("nodes").as_polygon(Some(&polygon));
    let q = |offsets: &[f64]| {
        let wall = nodes.column_heights(offsets);
        let mut state = fixed.state(&wall, &vec![0.0; c.columns], &|y| 115.0 * y * (0.2 - y));
        fixed.settle_by_newton(&mut state, 1e-8).expect("a steady state");
        heat_outflow(&fixed, &state).0
    };
    let exact = |name: &str, amplitude: f64| heated_channel_outflow(name, amplitude).expect("a reference");
    let (flat, exact_at_flat) = (q(&[0.0; 25]), exact("flat", 0.0));
    let shapes = reference_shapes();
    for name in ["endsup", "cos3"] {
        let (.., offsets) = shapes.iter().find(|shape| shape.0 == format!("{name} 0.02")).expect("a shape");
        let off = (q(offsets) / flat) / (exact(name, 0.02) / exact_at_flat) - 1.0;
        println!("{name}: {:+.3} %", 100.0 * off);
        assert!(off.abs() < 8e-4, "{name}: {off}");
    }
}

const EXACT_AT_FLAT: [f64; 25] = [
    8.2, 2.1, 0.1, -0.6, -1.0, -1.2, -1.3, -1.4, -1.5, -1.5, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.5,
    -1.3, -1.1, -0.6, 0.2, 2.3, 8.5,
];

/// Milliseconds of the fastest of many batches: other programs make them slower, nothing makes them faster.
fn milliseconds(mut f: impl FnMut()) -> f64 {
    let mut batch = || {
        let start = std::time::Instant::now();
        (0..20).for_each(|_| f());
        start.elapsed().as_secs_f64() / 20.0 * 1e3
    };
    (0..100).fold(f64::INFINITY, |best, _| batch().min(best))
}

/// Of the first two nodes, those between, and the last two: the kernel shifts between the two at an edge of the hot wall.
fn pairs(nodes: &[f64]) -> Vec<f64> {
    let between = nodes[2..23].iter().copied();
    std::iter::once(nodes[0] + nodes[1]).chain(between).chain([nodes[23] + nodes[24]]).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

/// FIXED_DX="0.02 0.01": spacings; FIXED_SHAPES: the file of finite elements' shapes.
#[test]
#[ignore = "half a minute: prints figures"]
fn the_heated_channel_against_finite_elements() {
    let spacings = std::env::var("FIXED_DX").unwrap_or("0.02 0.01".into());
    for dx in spacings.split_whitespace().map(|x| x.parse::<f64>().unwrap()) {
        let fixed = Fixed::<f64>::new(channel(dx)).unwrap();
        let c = &fixed.channel;
        let flat = vec![0.0; c.columns];
        let poiseuille = |y: f64| c.body_force / (2.0 * c.viscosity) * y * (0.2 - y);
        println!("dx {dx}, {} particles, dt {:.2e}", fixed.fluid_particles(), c.dt);

        let state = fixed.state(&flat, &flat, &poiseuille);
        let (mut next, mut bar, mut work) = (state.clone(), state.clone(), fixed.work());
        let forward = milliseconds(|| _ = fixed.forward(&state, &mut next, &mut work));
        let backward = milliseconds(|| fixed.backward(&state, &next, &mut bar, &mut work));
        let flow = milliseconds(|| fixed.backward_of_flow(&state, &next, &mut bar, &mut work));
        println!("  a step {forward:.4} ms, its adjoint {backward:.4} ms, of the flow alone {flow:.4} ms");

        let settle = |nodes: &[f64], depth: usize, tolerance: f64| {
            let mut state = fixed.state(&wall(&fixed, nodes), &flat, &poiseuille);
            let (steps, _) = fixed.settle(&mut state, 20, depth, tolerance, 40_000);
            (state, steps)
        };
        let shapes = reference_shapes();
        let up = &shapes[2].2;
        for tolerance in [1e-2, 1e-4, 1e-6] {
            let [plain, accelerated] = [0, 20].map(|depth| settle(up, depth, tolerance).1);
            println!("  steady to {tolerance:e} over the wall up 0.02: {accelerated} steps, plain {plain}");
        }

        let (mut of_flat, mut errors, mut ratios) = (0.0, Vec::new(), Vec::new());
        for (_, exact, nodes) in &shapes {
            let q = heat_outflow(&fixed, &settle(nodes, 20, 1e-6).0).0 / exact;
            of_flat = if errors.is_empty() { q } else { of_flat };
            errors.push(100.0 * (q - 1.0).abs());
            ratios.push((q / of_flat - 1.0).abs());
        }
        let worst = |of: &[f64]| of.iter().fold(0.0, |m: f64, x| m.max(*x));
        println!(
            "  Q / Q_fem: flat {of_flat:.4}, error mean {:.2} %, worst {:.2} %, worst of Q_shape / Q_flat {:.4}",
            errors.iter().sum::<f64>() / errors.len() as f64,
            worst(&errors),
            worst(&ratios)
        );

        let (state, _) = settle(&[0.0; 25], 20, 1e-9);
        let bar = heat_outflow(&fixed, &state).1;
        let gradient = |tolerance: f64| {
            let start = std::time::Instant::now();
            let found = fixed.steady_gradient(&state, &bar, &SteadyOptions { tolerance, ..SteadyOptions::default() });
            let unit = |k: usize| (0..25).map(|i| (i == k) as u8 as f64).collect::<Vec<_>>();
            let nodes: Vec<f64> = (0..25).map(|k| dot(&wall(&fixed, &unit(k)), &found.walls)).collect();
            (nodes, found.steps, 1e3 * start.elapsed().as_secs_f64())
        };
        let (exact, ..) = gradient(1e-11);
        println!(
            "  gradient (1e-3) {:.1?}, cosine {:.4}, of summed end pairs {:.4}",
            exact.iter().map(|g| 1e3 * g).collect::<Vec<_>>(),
            cosine(&exact, &EXACT_AT_FLAT),
            cosine(&pairs(&exact), &pairs(&EXACT_AT_FLAT))
        );
        for tolerance in [1e-3, 1e-4, 1e-5, 1e-6] {
            let (nodes, steps, time) = gradient(tolerance);
            let apart: Vec<f64> = nodes.iter().zip(&exact).map(|(a, b)| a - b).collect();
            let error = (dot(&apart, &apart) / dot(&exact, &exact)).sqrt();
            println!(
                "  gradient to a residual of {tolerance:e}: {steps} adjoint steps, error {error:.1e}, {time:.0} ms"
            );
        }
        assert!(worst(&errors) < 1.2);
    }
}

#[test]
fn a_row_of_the_grid_and_its_copies() {
    let grid = Grid::new(11, 4);
    let mut numbers = vec![0.0f64; 2 * grid.field()];
    let fields = Fields::new(grid, 2, 0, &mut numbers);
    for column in (0..11).step_by(4) {
        fields.put(1, -2, column, <f64 as Real>::Portable::ramp() + Lanes::splat(column as f64));
    }
    let row: Vec<f64> = (-2..13).map(|c| numbers[grid.field() + grid.place(-2, c)]).collect();
    let mut expected: Vec<f64> = (-2..13).map(|c: isize| c.rem_euclid(11) as f64).collect();
    assert_eq!(row, expected);
    let mut line = vec![0.0; grid.stride];
    (0..11).for_each(|c| line[grid.column(c)] = c as f64);
    grid.wrap(&mut line);
    assert_eq!((-2..13).map(|c| line[grid.column(c)]).collect::<Vec<_>>(), expected);
    expected.clear();
    assert!(grid.reach_of(-2).eq(0..1) && grid.reach_of(0).eq(-2..3) && grid.reach_of(4).eq(2..4));
}

#[test]
fn derivatives_of_quadratics_are_exact() {
    for shape in [KernelName::QuinticSpline, KernelName::WendlandC2] {
        let dx = 0.02;
        let s = stencil::<f64>(&Kernel::new(shape, 2, 1.2 * dx), dx);
        let sum = |field: &dyn Fn(f64, f64) -> f64, weight: &dyn Fn(&Weight<f64>) -> f64| -> f64 {
            (0..25)
                .map(|k| (k % 5, k / 5))
                .map(|(i, j)| weight(&s[j][i]) * field((i as f64 - 2.0) * dx, (j as f64 - 2.0) * dx))
                .sum()
        };
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        let f = |x: f64, y: f64| 1.0 + 2.0 * x - 3.0 * y + 4.0 * x * x + 5.0 * x * y - 6.0 * y * y;
        close(sum(&f, &|w| w.gx), 2.0);
        close(sum(&f, &|w| w.gy), -3.0);
        let still = |x: f64, y: f64| f(x, y) - 1.0;
        close(sum(&still, &|w| 2.0 * w.lxx), 8.0);
        close(sum(&still, &|w| 2.0 * w.lyy), -12.0);
        close(sum(&still, &|w| w.lxy), 5.0);
        let line = derivative(&s);
        close((0..5).map(|i| line[i] * (i as f64 - 2.0) * dx).sum(), 1.0);
    }
}

/// Solves a dense system in place by elimination without exchange of rows, which a diagonally dominant one needs no more.
fn solved(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let (above, below) = a.split_at_mut(k + 1);
        let pivot = &above[k];
        for (i, row) in below.iter_mut().enumerate() {
            let factor = row[k] / pivot[k];
            if factor != 0.0 {
                (k..n).for_each(|j| row[j] -= factor * pivot[j]);
                b[k + 1 + i] -= factor * b[k];
            }
        }
    }
    for k in (0..n).rev() {
        let rest: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - rest) / a[k][k];
    }
    b
}

/// Ghosts of a quadratic temperature without flux through a wall that slopes are its values beyond the wall.
#[test]
fn ghosts_beyond_a_sloping_wall_are_exact_for_quadratics() {
    let channel = channel(0.01);
    let grid = Grid::new(channel.columns, channel.rows);
    let ghosts = Ghosts::<f64>::new(&channel, &grid);
    // f_eta = lean f_xi on the wall, eta = 0, at every xi.
    let (lean, dx) = (0.37, channel.spacing);
    let f = |xi: f64, eta: f64| 0.3 * xi + 1.1 * xi * xi + lean * (0.3 + 2.2 * xi) * eta - 0.7 * eta * eta;
    // Below the part that is not hot, and on the other wall, where eta grows into the channel too.
    for (wall, column) in [(0, 10), (1, 10), (1, 50)] {
        let row = |column: usize, k: usize| f(channel.x(column), (k as f64 + 0.5) * dx);
        let on_wall = |column: usize| ON_WALL[0] * row(column, 0) + ON_WALL[1] * row(column, 1);
        let weights = &ghosts.along[wall];
        let along: f64 = (0..3).map(|k| weights[k][grid.column(column as isize)] * on_wall(column + k - 1)).sum();
        type One = <f64 as Real>::Portable;
        let [cold, conormal] = [0.0, lean * along].map(One::splat);
        let found = temperature::<One>([0, 1].map(|k| One::splat(row(column, k))), cold, One::zero(), conormal);
        for (k, ghost) in found.into_iter().enumerate() {
            let (ghost, exact) = (ghost.sum() / One::COUNT as f64, f(channel.x(column), -(k as f64 + 0.5) * dx));
            assert!((ghost - exact).abs() < 1e-14, "{wall} {column} {k}: {ghost}, {exact}");
        }
    }
}

/// How much further towards the hot side than `acts` an edge acts whose cell, the one around x = 0, has a hot share of `share`.
fn further(share: f64, acts: f64) -> f64 {
    const RADIUS: isize = 16;
    let exact = |x: f64, y: f64| (x * x + y * y).sqrt().sqrt() * (0.5 * y.atan2(x)).sin();
    let stencil = stencil::<f64>(&Kernel::new(KernelName::QuinticSpline, 2, 1.0), 1.0);
    let inside = |i: isize, j: isize| (i as f64).hypot(j as f64 + 0.5) < RADIUS as f64;
    let cells: Vec<(isize, isize)> =
        (0..RADIUS).flat_map(|j| (-RADIUS..=RADIUS).map(move |i| (i, j))).filter(|&(i, j)| inside(i, j)).collect();
    let number: std::collections::BTreeMap<(isize, isize), usize> = cells.iter().copied().zip(0..).collect();
    let place = |i: isize, j: isize| (i as f64 - acts, j as f64 + 0.5);
    // Near and far ghost of a column from its first two rows; the hot wall has the temperature 0.
    type One = <f64 as Real>::Portable;
    let ghosts = |i: isize, rows: [f64; 2]| {
        let hot = if i == 0 { share } else { f64::from(u8::from(i > 0)) };
        let ghosts = temperature::<One>(rows.map(One::splat), One::splat(hot), One::zero(), One::zero());
        ghosts.map(|ghost| ghost.sum() / One::COUNT as f64)
    };
    let mut matrix = vec![vec![0.0; cells.len()]; cells.len()];
    let mut right = vec![0.0; cells.len()];
    for (row, &(i, j)) in cells.iter().enumerate() {
        for dj in -2..=2_isize {
            for di in -2..=2_isize {
                let weight = &stencil[(dj + 2) as usize][(di + 2) as usize];
                let weight = 2.0 * (weight.lxx + weight.lyy);
                let (column, other) = (i + di, j + dj);
                let mut add = |j: isize, factor: f64| match number.get(&(column, j)) {
                    Some(&at) => matrix[row][at] += weight * factor,
                    None => {
                        let (x, y) = place(column, j);
                        right[row] -= weight * factor * exact(x, y);
                    }
                };
                match usize::try_from(-1 - other) {
                    Ok(ghost) => {
                        add(0, ghosts(column, [1.0, 0.0])[ghost]);
                        add(1, ghosts(column, [0.0, 1.0])[ghost]);
                    }
                    Err(_) => add(other, 1.0),
                }
                matrix[row][row] -= weight;
            }
        }
    }
    let found = solved(matrix, right);
    // The shift that fits best between a third and two thirds of the radius.
    let (mut product, mut square) = (0.0, 0.0);
    for (&(i, j), found) in cells.iter().zip(found) {
        let (x, y) = place(i, j);
        if (0.33..0.66).contains(&(x.hypot(y) / RADIUS as f64)) {
            let slope = (exact(x - 1e-4, y) - exact(x + 1e-4, y)) / 2e-4;
            product += slope * (found - exact(x, y));
            square += slope * slope;
        }
    }
    product / square
}

/// The table is that of Laplace's equation on the lattice of a half disc; a share that is the covered part of the cell is not.
#[test]
fn the_edge_of_the_hot_wall_acts_where_it_is() {
    for (k, acts) in EDGE.into_iter().enumerate() {
        let further = further(k as f64 / 16.0, acts);
        assert!(further.abs() < 2e-3, "share {k}/16: {further}");
    }
    // With a share of 0 for an edge between two cells it acts 0.18 spacings further.
    let covered = further(0.0, 0.5);
    assert!(covered > 0.08, "{covered}");
}

/// A hot wall has its length, wherever its edges are in their cells.
#[test]
fn the_shares_of_a_hot_wall() {
    for shift in 0..10 {
        let hot = [0.25 + 0.001 * f64::from(shift), 0.75];
        let channel = Channel { hot, ..channel(0.01) };
        let share = channel.hot_share();
        let first = share.iter().position(|&share| share > 0.0).expect("a hot wall");
        // The first column that is not cold, and how far from its middle the edge acts.
        let at = (share[first] * 16.0).floor() as usize;
        let within = share[first] * 16.0 - at as f64;
        let acts = EDGE[at] + within * (EDGE[(at + 1).min(16)] - EDGE[at]);
        assert!((channel.x(first) + 0.01 * acts - hot[0]).abs() < 1e-6, "{share:?}");
        assert!(share[first + 1] == 1.0 || share[first] == 1.0, "{share:?}");
    }
}
