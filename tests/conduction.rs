//! Conduction along a given motion: the exact decay of a wave, heat that stays, walls.

use candle_core::{Device, Tensor, Var};
use hydrograd::dataset::{kind, Metadata};
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::surrogate::conduction::Conduction;
use hydrograd::surrogate::predictor::{Frame, Scenery};
use std::f64::consts::TAU;

const DIFFUSIVITY: f64 = 0.02;

/// A box of 1 x `height`, periodic in x, and in y if told; `frame` is the time between frames. The inlet and outlet have no
/// length, so all fluid conducts.
fn metadata(height: f64, periodic: bool, frame: f64) -> Metadata {
    serde_json::from_value(serde_json::json!({
        "dim": 2, "dx": 0.02, "dt": frame, "write_every": 1, "num_particles_max": 2500,
        "periodic_boundary_conditions": [true, periodic], "bounds": [[0.0, 1.0], [0.0, height]],
        "default_connectivity_radius": 0.029, "vel_mean": [0, 0], "vel_std": [1, 1], "acc_mean": [0, 0], "acc_std": [1, 1],
        "heat": {
            "temperature_mean": 1.0, "temperature_std": 1.0, "change_mean": 0.0, "change_std": 1.0,
            "inlet_length": 0.0, "inlet_temperature": 1.0, "target_x": 0.9, "diffusivity": DIFFUSIVITY,
            "conductivity": DIFFUSIVITY, "heat_capacity": 1.0, "outlet_length": 0.0
        }
    }))
    .unwrap()
}

/// Rows of particles at (k + 1/2) dx, moved by `shift` in x.
fn lattice(rows: usize, shift: f64) -> Vec<f64> {
    (0..50 * rows)
        .flat_map(|k| [((k % 50) as f64 * 0.02 + 0.01 + shift).rem_euclid(1.0), (k / 50) as f64 * 0.02 + 0.01])
        .collect()
}

#[test]
fn a_wave_decays_as_it_should_and_heat_stays() {
    let metadata = metadata(1.0, true, 0.1);
    let kinds = vec![kind::FLUID; 2500];
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: None };
    for shift in [0.0, 0.13] {
        let position = lattice(50, 0.0);
        let temperature: Vec<f64> = (0..2500).map(|i| 1.0 + 0.2 * (TAU * position[2 * i]).cos()).collect();
        let from = Frame { position, temperature: Some(temperature.clone()) };
        // Carried along as a whole, each particle's temperature decays the same.
        let after = Conduction::new(&scenery).unwrap().advance(&from, &lattice(50, shift)).unwrap();
        let decay = (-DIFFUSIVITY * TAU * TAU * 0.1f64).exp();
        for (after, before) in after.iter().zip(&temperature) {
            // SPH's second derivative at h = dx, 50 spacings a wave: 1 % of the change.
            let (change, wanted) = (after - before, (before - 1.0) * (decay - 1.0));
            assert!((change - wanted).abs() < 0.01 * 0.2 * (1.0 - decay), "{change} {wanted}");
        }
        let sum = |t: &[f64]| t.iter().sum::<f64>();
        assert!((sum(&after) - sum(&temperature)).abs() < 1e-9);
    }
}

#[test]
fn walls_without_a_temperature_let_no_heat_through_and_hot_ones_heat() {
    // Four rows of wall, ten of fluid, four of wall.
    let metadata = metadata(0.36, false, 2.0);
    let rows = |row: usize| if (4..14).contains(&row) { kind::FLUID } else { kind::SOLID_WALL };
    let kinds: Vec<i32> = (0..18 * 50).map(|k| rows(k / 50)).collect();
    let position = lattice(18, 0.0);
    let fluid = |i: &usize| kinds[*i] == kind::FLUID;
    let temperature: Vec<f64> = (0..900).map(|i| if fluid(&i) { 1.0 + position[2 * i + 1] } else { 1.0 }).collect();
    let from = Frame { position: position.clone(), temperature: Some(temperature.clone()) };
    let mean = |t: &[f64]| (0..900).filter(fluid).map(|i| t[i]).sum::<f64>() / 500.0;
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: None };
    let after = Conduction::new(&scenery).unwrap().advance(&from, &position).unwrap();
    // Adami's walls take a mean of what is near: no flow in the mean, a little along a gradient that ends at a wall.
    assert!((mean(&after) - mean(&temperature)).abs() < 3e-3, "{} {}", mean(&after), mean(&temperature));
    // Hot below: the profile of a plate, T = 2 - erf(y/sqrt(4 alpha t)), before the other wall is felt much.
    let hot: Vec<f32> = (0..900).map(|k| if k / 50 < 4 { 2.0 } else { f32::NAN }).collect();
    let metadata = self::metadata(0.36, false, 0.2);
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: Some(&hot) };
    let from = Frame { position: position.clone(), temperature: Some(vec![1.0; 900]) };
    let after = Conduction::new(&scenery).unwrap().advance(&from, &position).unwrap();
    for i in (0..900).filter(fluid) {
        let y = position[2 * i + 1] - 0.08;
        let wanted = 1.0 + erfc(y / (4.0 * DIFFUSIVITY * 0.2f64).sqrt());
        assert!((after[i] - wanted).abs() < 0.03, "y {y}: {} {wanted}", after[i]);
    }
}

/// Abramowitz and Stegun 7.1.26, 1.5e-7.
fn erfc(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.3275911 * x);
    let series = [0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429];
    series.iter().rev().fold(0.0, |sum, a| (sum + a) * t) * (-x * x).exp()
}

/// On candle's graph: the same temperatures, and their derivatives by where particles are, by where they go and by how warm
/// they are.
#[test]
fn conduction_on_the_graph_is_the_plain_one_and_has_its_gradient() {
    let mut metadata = metadata(0.36, false, 0.05);
    if let Some(heat) = &mut metadata.heat {
        (heat.inlet_length, heat.outlet_length) = (0.1, 0.1);
    }
    let kinds: Vec<i32> =
        (0..900).map(|k| if (4..14).contains(&(k / 50)) { kind::FLUID } else { kind::SOLID_WALL }).collect();
    let hot: Vec<f32> = (0..900).map(|k| if k / 50 < 4 && k % 50 > 20 { 2.0 } else { f32::NAN }).collect();
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: Some(&hot) };
    let conduction = Conduction::new(&scenery).unwrap();
    let mut random = Normal::new(stream(7, "conduction"));
    let mut disordered = |shift: f64, size: f64| -> Vec<f64> {
        let fluid = |k: usize| (4..14).contains(&(k / 2 / 50));
        let moved = |(k, x): (usize, f64)| if fluid(k) { x + size * 0.02 * random.next() } else { x };
        let all: Vec<f64> = lattice(18, 0.0).into_iter().enumerate().map(moved).collect();
        let along = |(k, x): (usize, f64)| if fluid(k) && k % 2 == 0 { (x + shift).rem_euclid(1.0) } else { x };
        all.into_iter().enumerate().map(along).collect()
    };
    let (from, next) = (disordered(0.0, 0.1), disordered(0.03, 0.1));
    let temperature: Vec<f64> = (0..900).map(|_| 1.0 + 0.1 * random.next()).collect();
    let weights: Vec<f64> = (0..900).map(|_| random.next()).collect();
    let plainly = |from: &[f64], temperature: &[f64], next: &[f64]| {
        let frame = Frame { position: from.to_vec(), temperature: Some(temperature.to_vec()) };
        conduction.advance(&frame, next).unwrap()
    };
    let wanted = plainly(&from, &temperature, &next);
    assert!(wanted.iter().zip(&temperature).any(|(a, b)| (a - b).abs() > 0.05));
    let variable = |values: &[f64], columns: usize| {
        let tensor = Tensor::from_slice(values, (values.len() / columns, columns), &Device::Cpu).unwrap();
        Var::from_tensor(&if columns == 1 { tensor.squeeze(1).unwrap() } else { tensor }).unwrap()
    };
    let variables = [variable(&from, 2), variable(&temperature, 1), variable(&next, 2)];
    let found = conduction.advance_on_graph(&variables[0], &variables[1], &variables[2]).unwrap();
    let numbers = |tensor: &Tensor| tensor.flatten_all().unwrap().to_vec1::<f64>().unwrap();
    let apart = numbers(&found).iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-12, "{apart:e}");
    let weighed = (found * Tensor::from_slice(&weights, 900, &Device::Cpu).unwrap()).unwrap().sum_all().unwrap();
    let gradients = weighed.backward().unwrap();
    let inputs = [from, temperature, next];
    for (k, name) in ["places", "temperatures", "places to go to"].into_iter().enumerate() {
        let gradient = numbers(gradients.get(&variables[k]).unwrap());
        let direction: Vec<f64> = gradient.iter().map(|_| random.next()).collect();
        let exact: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let at = |h: f64| -> f64 {
            let mut moved = inputs.clone();
            moved[k].iter_mut().zip(&direction).for_each(|(x, d)| *x += h * d);
            let [from, temperature, next] = moved;
            plainly(&from, &temperature, &next).iter().zip(&weights).map(|(t, w)| t * w).sum()
        };
        let gaps = [1e-6, 1e-7, 1e-8].map(|h| ((at(h) - at(-h)) / (2.0 * h) / exact - 1.0).abs());
        assert!(gaps.iter().any(|gap| *gap < 1e-6), "{name}: {gaps:?} of {exact:e}");
    }
}

#[test]
fn data_without_temperature_are_told() {
    let mut metadata = metadata(1.0, true, 0.1);
    metadata.heat = None;
    let scenery = Scenery { metadata: &metadata, kind: &[0], wall_temperature: None };
    assert!(Conduction::new(&scenery).err().unwrap().to_string().contains("no heat"));
}
