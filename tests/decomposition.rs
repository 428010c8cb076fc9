//! A box cut into blocks, and a step of a part of a flow, without MPI.

use hydrograd::config::layers::Setting;
use hydrograd::config::scene::Config;
use hydrograd::numerics::random::{stream, uniform};
use hydrograd::numerics::ranks::Ranks;
use hydrograd::particles::decomposition::Decomposition;
use hydrograd::particles::{Domain, NeighbourList};
use hydrograd::scene::Scene;
use hydrograd::sph::flow::picked;
use hydrograd::sph::part::Part;
use hydrograd::sph::solver::{Snapshot, Solver};
use std::sync::Arc;

fn alone(numbers: &[f64]) -> Vec<f64> {
    numbers.to_vec()
}

/// Blocks of any number of ranks have as many particles each, and every place has one owner, which is near it.
#[test]
fn blocks_share_particles_evenly() {
    let mut rng = stream(1, "decomposition");
    for (dimension, periodic) in [(2, [true, false, false]), (3, [true, true, true]), (3, [false, true, false])] {
        let domain = Domain { dimension, size: [2.0, 1.0, 0.5], periodic };
        let n = 20_000;
        // Crowded towards one end.
        let positions: Vec<f64> =
            (0..dimension * n).map(|at| domain.size[at / n] * uniform(&mut rng) * uniform(&mut rng)).collect();
        let place = |i: usize| [0, 1, 2].map(|d| positions.get(d * n + i).copied().unwrap_or(0.0));
        let bounds = [[0.0, 2.0], [0.0, 1.0], [0.0, 0.5]];
        for ranks in [1, 2, 3, 7, 64] {
            let cut = Decomposition::new(&domain, bounds, ranks, None, &positions, &alone);
            let mut counts = vec![0; ranks];
            for i in 0..n {
                let owner = cut.owner(place(i));
                counts[owner] += 1;
                assert!(cut.is_near(owner, place(i), 1e-9), "{ranks} ranks: {i}");
            }
            let mean = n as f64 / ranks as f64;
            let most = counts.iter().fold(0.0f64, |most, &count| most.max(f64::from(count) / mean));
            assert!(most < 1.05, "{ranks} ranks: {counts:?}");
        }
    }
}

/// Who is near a block is so across periodic edges, and across no others; what lies outside of a box belongs to the block beside it.
#[test]
fn nearness_goes_over_periodic_edges() {
    let domain = Domain { dimension: 2, size: [1.0, 0.4, 1.0], periodic: [true, false, false] };
    let positions: Vec<f64> = (0..100).map(|i| (i as f64 + 0.5) / 100.0).chain((0..100).map(|_| 0.2)).collect();
    let cut = Decomposition::new(&domain, [[0.0; 2], [0.0, 0.4], [0.0; 2]], 2, None, &positions, &alone);
    for (x, owner, near) in
        [(0.25, 0, [true, false]), (0.45, 0, [true, true]), (0.05, 0, [true, true]), (0.95, 1, [true, true])]
    {
        for y in [0.2, -3.0, 5.0] {
            assert_eq!(cut.owner([x, y, 0.0]), owner, "{x} {y}");
            assert_eq!([0, 1].map(|rank| cut.is_near(rank, [x, y, 0.0], 0.1)), near, "{x} {y}");
        }
    }
}

/// Blocks that several ranks find together, each of its own particles, are those of all particles.
#[test]
fn counts_are_summed_over_ranks() {
    let mut rng = stream(2, "decomposition");
    let domain = Domain { dimension: 2, size: [1.0, 1.0, 1.0], periodic: [true, true, false] };
    let n = 1000;
    let positions: Vec<f64> = (0..2 * n).map(|_| uniform(&mut rng)).collect();
    let all = Decomposition::new(&domain, [[0.0; 2]; 3], 2, Some(1), &positions, &alone);
    // As if another rank had as many particles at the same places.
    let half = Decomposition::new(&domain, [[0.0; 2]; 3], 2, Some(1), &positions, &|own: &[f64]| {
        own.iter().map(|count| 2.0 * count).collect()
    });
    for i in 0..n {
        let place = [positions[i], positions[n + i], 0.0];
        assert_eq!(all.owner(place), half.owner(place));
    }
}

/// A scene, its particles near one of four blocks, which of these are in the block, and the model and the state of those that are near.
/// `has_all` says whether those that are not in the block are computed too.
struct Some {
    near: Vec<u32>,
    inside: Vec<bool>,
    solver: Solver<f64>,
}

fn some_of(scene: &Scene<f64>, reaches: f64, has_all: bool) -> Some {
    let (model, start) = (&scene.model, &scene.start);
    let (n, d) = (model.particles(), model.dimension());
    let place = |i: usize| [0, 1, 2].map(|k| if k < d { start.reference[k * n + i] } else { 0.0 });
    let ends = |row: &[f64]| row.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], &x| [a.min(x), b.max(x)]);
    let bounds = [0, 1].map(|k| ends(&start.reference[k * n..(k + 1) * n]));
    let only = model.sharing().unwrap().only;
    let cut = Decomposition::new(&model.domain, [bounds[0], bounds[1], [0.0; 2]], 4, only, &start.reference, &alone);
    let reach = reaches * model.reach().distance();
    let near: Vec<u32> = (0..n as u32).filter(|&i| cut.is_near(1, place(i as usize), reach)).collect();
    assert!(near.len() < n, "{}: a part, {} of {n}", scene.name, near.len());
    let of = |rows: &[f64]| -> Vec<f64> { rows.chunks_exact(n).flat_map(|row| picked(row, &near)).collect() };
    let inside: Vec<bool> = near.iter().map(|&i| cut.owner(place(i as usize)) == 1).collect();
    let is_lent = |i: u32| [0, 2, 3].into_iter().any(|rank| cut.is_near(rank, place(i as usize), reach));
    let part = Part {
        ranks: Ranks::ALONE,
        own: inside.iter().map(|&is| is || has_all).collect(),
        lent: vec![],
        lent_to_any: (0..near.len() as u32).filter(|&k| inside[k as usize] && is_lent(near[k as usize])).collect(),
        copies: vec![],
        has_walls: model.has_walls(),
        traffic: Arc::default(),
    };
    let snapshot = Snapshot { state: of(&start.state), reference: Arc::new(of(&start.reference)), ..start.clone() };
    let solver = Solver::restore(model.of(&near, Arc::new(part)).unwrap(), &snapshot).unwrap();
    Some { near, inside, solver }
}

/// Particles of a block have the neighbours that they have in the whole flow, and copies beside it have no rows.
#[test]
fn own_particles_have_all_neighbours() {
    for scene in scenes() {
        let whole = Solver::new(scene.model.clone(), scene.start.state.clone()).unwrap();
        let some = some_of(&scene, 1.0, false);
        let list = &some.solver.neighbourhood.list;
        for (k, &i) in some.near.iter().enumerate().filter(|(k, _)| scene.model.is_fluid(some.near[*k] as usize)) {
            let row = |list: &NeighbourList, i: usize| list.row(i)[..list.count[i] as usize].to_vec();
            let mut wanted = row(&whole.neighbourhood.list, i as usize);
            let mut found: Vec<u32> = row(list, k).into_iter().map(|j| some.near[j as usize]).collect();
            wanted.sort_unstable();
            found.sort_unstable();
            match some.inside[k] {
                true => assert_eq!(wanted, found, "{}: {i}", scene.name),
                false => assert!(found.is_empty() && list.fluid_copies.contains(&(k as u32))),
            }
        }
        // Rows that others wait for come first, and the rest is computed without copies.
        let (lent, others) = list.fluid_rows.split_at(list.lent_rows);
        assert!(!lent.is_empty() && !others.is_empty(), "{}", scene.name);
        assert!(lent.iter().all(|i| list.lent.contains(i)) && others.iter().all(|i| !list.lent.contains(i)));
        let is_copy = |&j: &u32| !some.inside[j as usize];
        let sees_copy = |i: u32| list.row(i as usize)[..list.count[i as usize] as usize].iter().any(is_copy);
        assert!(!others.iter().any(|&i| sees_copy(i)), "{}", scene.name);
        assert!(lent.iter().any(|&i| sees_copy(i)), "{}", scene.name);
    }
}

/// A step of the particles near a block moves those in it as a step of all particles does. (Without other ranks nothing is exchanged, so the
/// part is larger: as if each operator found everything itself.)
#[test]
fn a_part_moves_its_particles_as_the_whole() {
    for scene in scenes() {
        let (n, d) = (scene.model.particles(), scene.model.dimension());
        let reaches = 4.0 * scene.model.sharing().unwrap().reaches as f64;
        let mut whole = Solver::new(scene.model.clone(), scene.start.state.clone()).unwrap();
        let mut some = some_of(&scene, reaches, true);
        whole.advance().unwrap();
        some.solver.advance().unwrap();
        // The pressure's mean is that of fewer particles.
        for row in 0..2 * d {
            for (k, &i) in some.near.iter().enumerate().filter(|(k, _)| some.inside[*k]) {
                let (wanted, found) = (whole.state[row * n + i as usize], some.solver.state[row * some.near.len() + k]);
                assert!((wanted - found).abs() < 1e-12, "{}, row {row}, particle {i}: {wanted} {found}", scene.name);
            }
        }
    }
}

fn scenes() -> Vec<Scene<f64>> {
    let dx = |dx: f64| Setting::option("--dx", "resolution.dx", dx);
    let standard = || Setting::option("--method", "method.name", "standard");
    let scene = |(name, settings): (&str, Vec<Setting>)| {
        let loaded = Config::load_settings(Some(name), None, &settings).unwrap();
        Scene::<f64>::from_config(&loaded.config).unwrap()
    };
    let scenes = [
        ("taylor-green", vec![dx(0.0125)]),
        ("taylor-green", vec![dx(0.0125), standard()]),
        ("lid-driven-cavity", vec![dx(0.0125)]),
        ("lid-driven-cavity", vec![dx(0.0125), standard()]),
        ("heated-channel", vec![dx(0.01)]),
        ("dam-break", vec![dx(0.02)]),
    ];
    scenes.into_iter().map(scene).collect()
}
