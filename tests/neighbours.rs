//! The neighbour list against brute force.

use hydrograd::numerics::lanes::Real;
use hydrograd::numerics::random::{stream, uniform};
use hydrograd::particles::neighbour_list::NeighbourError;
use hydrograd::particles::neighbourhood::Copied;
use hydrograd::particles::{tag, Domain, NeighbourList, Neighbourhood, Reach};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const REACH: f64 = 0.1;

/// Random positions `[D, N]` in the box and tags, a third of them walls.
fn scatter<R: Real>(rng: &mut ChaCha8Rng, domain: &Domain, n: usize) -> (Vec<R>, Vec<u8>) {
    let mut position = vec![R::default(); domain.dimension * n];
    for d in 0..domain.dimension {
        for i in 0..n {
            position[d * n + i] = R::of(uniform(rng) * domain.size[d]);
        }
        // Exactly on both edges of the box, where cells and images are chosen by rounding.
        position[d * n] = R::default();
        position[d * n + 1] = R::of(domain.size[d]);
    }
    let tags =
        (0..n).map(|i| [tag::FLUID, tag::FLUID, tag::WALL, tag::FLUID, tag::HOT_WALL, tag::FLUID][i % 6]).collect();
    (position, tags)
}

/// Squared distance by minimum image.
fn squared_distance<R: Real>(position: &[R], n: usize, domain: &Domain, i: usize, j: usize) -> f64 {
    (0..domain.dimension)
        .map(|d| {
            let mut dr = (position[d * n + i] - position[d * n + j]).f64();
            if domain.periodic[d] {
                dr -= domain.size[d] * (dr / domain.size[d]).round();
            }
            dr * dr
        })
        .sum()
}

fn check<R: Real>(list: &NeighbourList, position: &[R], tags: &[u8], domain: &Domain, edge: f64, what: &str) {
    let n = tags.len();
    let is_fluid = |i: usize| tags[i] == tag::FLUID;
    assert_eq!((list.particles, list.index.len()), (n, n * list.capacity), "{what}");
    assert_eq!(list.capacity % 16, 0, "{what}: rows must be multiples of every lane count");
    for i in 0..n {
        let (count, fluids) = (list.count[i] as usize, list.fluid_count[i] as usize);
        let row = &list.row(i)[..count];
        assert!(row[..fluids].iter().all(|&j| is_fluid(j as usize)), "{what}: row {i} begins with fluid");
        assert!(row[fluids..].iter().all(|&j| !is_fluid(j as usize)), "{what}: row {i} ends with walls");
        assert!(list.row(i)[count..].iter().all(|&j| j as usize == i), "{what}: padding of row {i}");
        let mut found = vec![false; n];
        for &j in row {
            assert!(!found[j as usize], "{what}: {j} is twice in row {i}");
            found[j as usize] = true;
            let back = &list.row(j as usize)[..list.count[j as usize] as usize];
            assert!(back.contains(&(i as u32)), "{what}: {j} is in row {i}, but {i} not in row {j}");
        }
        for (j, &found) in found.iter().enumerate() {
            let distance = squared_distance(position, n, domain, i, j).sqrt();
            if (distance / REACH - 1.0).abs() < edge {
                continue; // either answer is right
            }
            let expected = j != i && distance < REACH && (is_fluid(i) || is_fluid(j));
            assert_eq!(found, expected, "{what}: pair {i}, {j} at distance {distance}");
        }
    }
    let fluids: Vec<u32> = (0..n as u32).filter(|&i| is_fluid(i as usize)).collect();
    let walls: Vec<u32> = (0..n as u32).filter(|&i| !is_fluid(i as usize) && list.count[i as usize] > 0).collect();
    assert_eq!((&list.fluid_rows, &list.wall_rows), (&fluids, &walls), "{what}");
    assert_eq!(list.pairs(), list.count.iter().sum::<u32>() as usize);
}

#[test]
fn finds_what_brute_force_finds() {
    let mut rng = stream(1, "list");
    let mut cases = 0;
    for dimension in [2, 3] {
        // In two dimensions the third flag must not matter.
        for periodic in 0..8 {
            // Box lengths in reaches: 1, 2, 3 and more cells. A periodic box of exactly two reaches has one cell.
            for lengths in [[2.0, 2.0, 2.0], [2.5, 3.3, 2.0], [3.0, 2.1, 4.2], [5.7, 2.0, 3.01], [0.5, 1.0, 6.3]] {
                let mut domain = Domain { dimension, size: [1.0; 3], periodic: [false, false, periodic >> 2 & 1 == 1] };
                for (d, length) in lengths.into_iter().enumerate().take(dimension) {
                    let length: f64 = length;
                    domain.periodic[d] = periodic >> d & 1 == 1;
                    domain.size[d] = REACH * if domain.periodic[d] { length.max(2.0) } else { length };
                }
                let n = 150;
                let what = format!("{domain:?}");
                let (position, tags) = scatter::<f64>(&mut rng, &domain, n);
                let list = NeighbourList::build(&position, &tags, &domain, REACH, 0).unwrap();
                check(&list, &position, &tags, &domain, 1e-12, &what);
                let (position, tags) = scatter::<f32>(&mut rng, &domain, n);
                let list = NeighbourList::build(&position, &tags, &domain, REACH, 0).unwrap();
                check(&list, &position, &tags, &domain, 1e-5, &format!("f32, {what}"));
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 80);
}

/// A square of side `size` with all directions periodic.
fn square(size: f64) -> Domain {
    Domain { dimension: 2, size: [size, size, 1.0], periodic: [true, true, false] }
}

#[test]
fn fluid_only_and_walls_only() {
    let domain = square(0.5);
    let (position, _) = scatter::<f64>(&mut stream(2, "list"), &domain, 200);
    let fluid = vec![tag::FLUID; 200];
    let list = NeighbourList::build(&position, &fluid, &domain, REACH, 0).unwrap();
    check(&list, &position, &fluid, &domain, 1e-12, "fluid only");
    assert!(list.wall_rows.is_empty() && list.fluid_count == list.count);
    let walls = vec![tag::WALL; 200];
    let list = NeighbourList::build(&position, &walls, &domain, REACH, 0).unwrap();
    assert_eq!((list.pairs(), list.fluid_rows.len(), list.wall_rows.len()), (0, 0, 0));
    let list = NeighbourList::build::<f64>(&[], &[], &domain, REACH, 0).unwrap();
    assert_eq!(list.pairs(), 0);
}

/// Particles of other kinds, as many as before, more and fewer: in the memory of a list, nothing of its particles is left.
#[test]
fn the_memory_of_a_list_serves_other_particles() {
    let domain = square(1.0);
    let mut rng = stream(4, "list");
    let of = |tags: &[u8], own: &[bool], position: &[f64], old: Option<Neighbourhood<f64>>| {
        let reach =
            Reach { tags, own, lent: &[], domain: &domain, cutoff: 0.8 * REACH, skin: 0.2 * REACH, ranks: None };
        let mut list = old.unwrap_or_else(Neighbourhood::empty);
        list.take_others(Copied { at: Arc::new(position.to_vec()), serves: REACH });
        list.update(&reach, position).unwrap();
        list
    };
    let (position, tags) = scatter::<f64>(&mut rng, &domain, 200);
    let mut list = of(&tags, &[], &position, None);
    for (n, has_copies) in [(200, false), (230, true), (230, false), (120, true), (200, false)] {
        let (position, tags) = scatter::<f64>(&mut rng, &domain, n);
        let own: Vec<bool> = if has_copies { (0..n).map(|i| i % 3 > 0).collect() } else { vec![] };
        let fresh = of(&tags, &own, &position, None);
        list = of(&tags, &own, &position, Some(list));
        let (old, new) = (&*list.list, &*fresh.list);
        assert_eq!((&old.count, &old.fluid_count, &old.own), (&new.count, &new.fluid_count, &new.own));
        assert_eq!((&old.fluid_rows, &old.fluid_copies), (&new.fluid_rows, &new.fluid_copies));
        assert_eq!(old.wall_rows, new.wall_rows);
        for i in 0..n {
            let count = new.count[i] as usize;
            assert_eq!(old.row(i)[..count], new.row(i)[..count]);
        }
    }
}

#[test]
fn capacity_grows_with_the_crowd_and_keeps_a_hint() {
    let domain = square(1.0);
    let mut rng = stream(3, "list");
    for crowd in [3, 16, 17, 18, 33, 100, 500] {
        // A crowd within one reach, besides a lone particle.
        let n = crowd + 1;
        let mut position: Vec<f64> = (0..2 * n).map(|_| 0.3 + 0.05 * uniform(&mut rng)).collect();
        position[n - 1] = 0.8;
        position[2 * n - 1] = 0.8;
        let tags = vec![tag::FLUID; n];
        let list = NeighbourList::build(&position, &tags, &domain, REACH, 0).unwrap();
        check(&list, &position, &tags, &domain, 1e-12, &format!("crowd of {crowd}"));
        assert!(list.capacity >= crowd - 1);
        assert_eq!(list.count[n - 1], 0, "the lone particle");
        let hinted = NeighbourList::build(&position, &tags, &domain, REACH, 600).unwrap();
        assert_eq!(hinted.capacity, 608);
        check(&hinted, &position, &tags, &domain, 1e-12, "hinted");
        for i in 0..n {
            let count = list.count[i] as usize;
            assert_eq!(list.row(i)[..count], hinted.row(i)[..count], "the order depends on the positions only");
        }
    }
}

#[test]
fn clumped_particles_are_an_error() {
    let n = 1100;
    let position = vec![0.5; 2 * n];
    match NeighbourList::build(&position, &vec![tag::FLUID; n], &square(1.0), REACH, 0) {
        Err(NeighbourError::Clumped { count, .. }) => assert_eq!(count, n - 1),
        other => panic!("{other:?}"),
    }
}

#[test]
fn lost_particles_are_an_error() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30, -1e6] {
        for periodic in [true, false] {
            let mut domain = square(1.0);
            domain.periodic = [periodic; 3];
            let (mut position, tags) = scatter::<f64>(&mut stream(4, "list"), &domain, 50);
            position[50 + 17] = bad;
            match NeighbourList::build(&position, &tags, &domain, REACH, 0) {
                Err(NeighbourError::LostParticle { particle: 17, component: 1, value }) => {
                    assert_eq!(value.to_bits(), bad.to_bits());
                }
                other => panic!("{bad}: {other:?}"),
            }
        }
    }
}

#[test]
fn a_periodic_box_needs_two_reaches() {
    let (position, tags) = (vec![0.05; 2], vec![tag::FLUID]);
    let mut domain = square(1.0);
    domain.size[1] = 1.99 * REACH;
    match NeighbourList::build::<f64>(&position, &tags, &domain, REACH, 0) {
        Err(NeighbourError::BoxTooSmall { direction: 1, .. }) => (),
        other => panic!("{other:?}"),
    }
    domain.periodic[1] = false;
    NeighbourList::build::<f64>(&position, &tags, &domain, REACH, 0).unwrap();
}
