//! Metrics of predicted frames: LagrangeBench's figures, and cases whose result is known.

use crate::support::data_set::{heated_metadata, metadata};
use hydrograd::dataset::extent::Extent;
use hydrograd::particles::Domain;
use hydrograd::surrogate::evaluation::metrics::*;
use hydrograd::surrogate::evaluation::sinkhorn;
use hydrograd::surrogate::predictor::Frame;
use safetensors::SafeTensors;
use std::path::PathBuf;

/// metrics_lr.safetensors: a prediction over 20 steps, the truth, and what LagrangeBench says of them.
struct Fixture {
    bytes: Vec<u8>,
}

impl Fixture {
    fn read() -> Self {
        let folder = std::env::var_os("HYDROGRAD_GNS_FIXTURES").map(PathBuf::from);
        let path = folder.unwrap_or("data/reference/gns".into()).join("metrics_lr.safetensors");
        Self { bytes: std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())) }
    }

    fn get(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.bytes).unwrap();
        let (words, _) = file.tensor(name).unwrap().data().as_chunks::<8>();
        words.iter().map(|word| f64::from_le_bytes(*word)).collect()
    }

    /// The frames of `pred` or `target`, [400, 2] each.
    fn frames(&self, name: &str) -> Vec<Vec<f64>> {
        self.get(name).chunks(800).map(<[f64]>::to_vec).collect()
    }
}

fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance * expected.abs(), "{found:e} is not {expected:e}");
}

/// The same box, open on all sides.
fn without_images(extent: Extent) -> Extent {
    Extent { domain: Domain { periodic: [false; 3], ..extent.domain }, ..extent }
}

#[test]
fn errors_are_lagrangebenchs() {
    let fixture = Fixture::read();
    let (predicted, truth) = (fixture.frames("pred"), fixture.frames("target"));
    let extent = Extent::of(&metadata(false));
    let pairs = || predicted.iter().zip(&truth);
    let mse: Vec<f64> = pairs().map(|(p, t)| mean_square(&extent, p, t)).collect();
    let mae: Vec<f64> = pairs().map(|(p, t)| mean_absolute(&extent, p, t)).collect();
    for k in 0..20 {
        close(mse[k], fixture.get("mse_per_step")[k], 1e-12);
        close(mae[k], fixture.get("mae_per_step")[k], 1e-12);
    }
    for n in [1, 5, 10, 20] {
        close(first(&mse, n).unwrap(), fixture.get(&format!("mse{n}"))[0], 1e-12);
    }
    assert_eq!(first(&mse, 21), None);
    assert_eq!(first(&mse, 0), None);
    // Without the minimum image, a particle on the other side of the box would be far away.
    let open = without_images(extent);
    let worst = (0..20).map(|k| mean_square(&open, &predicted[k], &truth[k]) / mse[k]).fold(0.0, f64::max);
    assert!(worst > 10.0, "{worst}");
}

#[test]
fn the_kinetic_energy_is_lagrangebenchs() {
    let fixture = Fixture::read();
    let metadata = metadata(false);
    let energies = |name: &str| -> Vec<f64> {
        let frames = fixture.frames(name);
        [0, 5, 10, 15].map(|k| kinetic_energy(&metadata, &frames[k + 1], &frames[k])).to_vec()
    };
    let (predicted, truth) = (energies("pred"), energies("target"));
    for k in 0..4 {
        close(predicted[k], fixture.get("ekin_pred")[k], 1e-12);
        close(truth[k], fixture.get("ekin_target")[k], 1e-12);
    }
    let error = predicted.iter().zip(&truth).map(|(p, t)| (p - t).powi(2)).sum::<f64>() / 4.0;
    close(error, fixture.get("ekin_mse")[0], 1e-12);
}

/// The values are what OTT has when it stops, 1.4e-4 from those of more iterations; ours stops at the same place.
#[test]
fn the_sinkhorn_divergence_is_lagrangebenchs() {
    let fixture = Fixture::read();
    let (predicted, truth) = (fixture.frames("pred"), fixture.frames("target"));
    let extent = Extent::of(&metadata(false));
    let of = |k: usize, threshold| sinkhorn::divergence(&extent, &predicted[5 * k], &truth[5 * k], threshold).unwrap();
    for (k, &expected) in fixture.get("sinkhorn_stride5").iter().enumerate() {
        close(of(k, sinkhorn::THRESHOLD), expected, 1e-9);
    }
    let (stopped, converged) = (of(0, sinkhorn::THRESHOLD), of(0, 1e-10));
    close(converged, 1.0272193833767e-6, 1e-8);
    close(stopped, converged, 2e-4);
}

/// `[N, 2]` of a disordered lattice in the unit box.
fn cloud() -> Vec<f64> {
    (0..64_usize)
        .flat_map(|i| [(i % 8) as f64, (i / 8) as f64].map(|k| (k + 0.5) / 8.0 + 0.03 * (3.0 * k + i as f64).sin()))
        .collect()
}

fn moved(cloud: &[f64], by: [f64; 2]) -> Vec<f64> {
    cloud.iter().enumerate().map(|(k, x)| x + by[k % 2]).collect()
}

#[test]
fn equal_clouds_do_not_differ() {
    let extent = Extent::of(&metadata(false));
    let cloud = cloud();
    assert_eq!(mean_square(&extent, &cloud, &cloud), 0.0);
    assert_eq!(mean_absolute(&extent, &cloud, &cloud), 0.0);
    let distance = |other: &[f64]| sinkhorn::divergence(&extent, &cloud, other, 1e-12).unwrap();
    assert!(distance(&cloud).abs() < 1e-12);
    // Whoever is who: the same cloud in another order.
    let mut reversed: Vec<f64> = cloud.chunks(2).rev().flatten().copied().collect();
    assert!(distance(&reversed).abs() < 1e-12);
    assert!(mean_square(&extent, &cloud, &reversed) > 1e-2);
    // All in one place: no cost at all.
    assert_eq!(sinkhorn::divergence(&extent, &[0.5; 20], &[0.5; 20], 1e-4), Ok(0.0));
    // By whole periods.
    reversed.iter_mut().for_each(|x| *x -= 1.0);
    assert!(distance(&reversed).abs() < 1e-12);
}

#[test]
fn a_translation_costs_its_square() {
    let (periodic, open) = (Extent::of(&metadata(false)), without_images(Extent::of(&metadata(false))));
    let cloud = cloud();
    let by = [0.3, -0.1];
    let there = moved(&cloud, by);
    for extent in [periodic, open] {
        close(mean_square(&extent, &there, &cloud), (0.09 + 0.01) / 2.0, 1e-12);
        close(mean_absolute(&extent, &there, &cloud), 0.2, 1e-12);
    }
    // |x - y - b|^2 = |x - y|^2 - 2 (x - y).b + |b|^2: the middle term is fixed by the means, for any plan.
    close(sinkhorn::divergence(&open, &there, &cloud, 1e-12).unwrap(), 0.1, 1e-9);
    // Nearly the whole box is a short way in a periodic one.
    close(mean_square(&periodic, &moved(&cloud, [0.99, 0.0]), &cloud), 1e-4 / 2.0, 1e-9);
    let distance = |by: f64| sinkhorn::divergence(&periodic, &moved(&cloud, [by, 0.0]), &cloud, 1e-12).unwrap();
    // The images at other distances blur it: less than the square.
    assert!(distance(0.01) > 1e-5 && distance(0.01) < 1e-4, "{}", distance(0.01));
    close(distance(0.99), distance(-0.01), 1e-9);
}

#[test]
fn a_particle_that_is_infinitely_far_away_is_an_error() {
    let extent = without_images(Extent::of(&metadata(false)));
    let mut far = cloud();
    far[0] = f64::INFINITY;
    let error = sinkhorn::divergence(&extent, &far, &cloud(), 1e-4).unwrap_err();
    assert!(error.to_string().contains("64 particles does not converge"), "{error}");
}

#[test]
fn walls_count_only_if_asked_for() {
    let kinds = [0, 1, 2, 3, -1, 0];
    assert_eq!(Counted::Moving.of(&kinds), [0, 3, 5]);
    assert_eq!(Counted::All.of(&kinds), [0, 1, 2, 3, 5]);
    assert_eq!(select(&[0.0, 1.0, 2.0, 3.0], 2, &[1]), [2.0, 3.0]);
}

#[test]
fn energy_of_a_translation() {
    let metadata = metadata(false);
    let cloud = cloud();
    // 0.1 time units per frame: velocity (3, -1), 64 particles of area 0.05^2, through the box's end.
    let energy = kinetic_energy(&metadata, &moved(&cloud, [0.3, 0.9]), &cloud);
    close(energy, 64.0 * 0.0025 * 10.0, 1e-12);
}

#[test]
fn outflow_of_a_uniform_stream() {
    let metadata = heated_metadata();
    let heat = metadata.heat.clone().unwrap();
    // Particles of spacing dx fill the box; velocity 2 and T - T_in = 0.1 everywhere: rho = 6/(0.02 * 300) = 1, height 1.
    // As the solver's Q, without the heat capacity.
    let mut from = Frame::default();
    for i in 0..400 {
        from.position.extend([0.05 * (i % 20) as f64 + 0.01, 0.05 * (i / 20) as f64 + 0.025]);
    }
    from.temperature = Some(vec![1.1; 400]);
    let all: Vec<usize> = (0..400).collect();
    for shift in [0.0, 0.013, 0.04] {
        let start = Frame { position: moved(&from.position, [shift, 0.0]), ..from.clone() };
        let mut to = Frame { position: moved(&start.position, [0.2, 0.0]), ..from.clone() };
        to.position.iter_mut().for_each(|x| *x = x.rem_euclid(1.0));
        // The hat of half width 3 dx sums to 1 over a lattice, wherever it lies.
        close(outflow(&metadata, &heat, &all, &to, &start).unwrap(), 2.0 * 0.1, 1e-9);
        to.temperature = Some(vec![1.0; 400]);
        assert_eq!(outflow(&metadata, &heat, &all, &to, &start), Some(0.0));
        to.temperature = None;
        assert_eq!(outflow(&metadata, &heat, &all, &to, &start), None);
    }
}

#[test]
fn temperature_errors() {
    close(temperature_mean_square(&[1.0, 1.3], &[1.1, 1.1]), (0.01 + 0.04) / 2.0, 1e-12);
}
