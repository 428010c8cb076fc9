//! Closed surfaces of triangles: files, distances, points on them, and the flow around such bodies.

use hydrograd::config::custom::Part;
use hydrograd::config::scene::Config;
use hydrograd::io::stl::{self, Triangles};
use hydrograd::scene::around_bodies::AroundBodies;
use hydrograd::scene::around_flow::Around;
use hydrograd::sph::cloud::equations::Warmth;
use hydrograd::sph::cloud::figures::{Figure, MeasureSettings};
use hydrograd::sph::cloud::nearest::Region;
use hydrograd::sph::cloud::outline::Dual;
use hydrograd::sph::cloud::particles::{Balanced, Fluid};
use hydrograd::sph::cloud::space::equations::Motion;
use hydrograd::sph::cloud::space::facets::Facets;
use hydrograd::sph::cloud::space::particles::{Cloud, Surroundings};
use hydrograd::sph::cloud::space::placing::{BoundaryPoint, Ground};
use hydrograd::sph::cloud::space::problem::SteadyFlow;
use hydrograd::sph::cloud::space::surface::{Form, Spot, Standing, Surface};
use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

/// A ball of radius 1 around a place: an icosahedron whose triangles are divided `rounds` times.
fn ball(rounds: usize, centre: [f64; 3]) -> Triangles {
    let phi = 0.5 * (1.0 + 5f64.sqrt());
    let unit = |p: [f64; 3]| {
        let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
        p.map(|x| x / length)
    };
    let mut vertices: Vec<[f64; 3]> = vec![];
    for (a, b) in [(1.0, phi), (-1.0, phi), (1.0, -phi), (-1.0, -phi)] {
        vertices.extend([[a, b, 0.0], [0.0, a, b], [b, 0.0, a]].map(unit));
    }
    let near = |a: [f64; 3], b: [f64; 3]| (0..3).map(|d| (a[d] - b[d]).powi(2)).sum::<f64>() < 1.2;
    let mut triangles = vec![];
    for i in 0..12u32 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let [a, b, c] = [i, j, k].map(|v| vertices[v as usize]);
                if near(a, b) && near(b, c) && near(a, c) {
                    let cross = stl::cross(stl::minus(b, a), stl::minus(c, a));
                    triangles.push(if stl::dot(cross, a) > 0.0 { [i, j, k] } else { [i, k, j] });
                }
            }
        }
    }
    for _ in 0..rounds {
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (p, q) = (vertices[a as usize], vertices[b as usize]);
                vertices.push(unit(std::array::from_fn(|d| p[d] + q[d])));
                vertices.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    vertices.iter_mut().for_each(|v| (0..3).for_each(|d| v[d] += centre[d]));
    Triangles { vertices, triangles }
}

/// The box between 0 and `size`.
fn cuboid(size: [f64; 3]) -> Triangles {
    let vertices = (0..8).map(|k| std::array::from_fn(|d| if k >> d & 1 == 1 { size[d] } else { 0.0 })).collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Triangles { vertices, triangles }
}

/// An STL file in text.
fn text(triangles: &Triangles) -> String {
    let mut text = "solid body\n".to_string();
    for k in 0..triangles.triangles.len() {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in triangles.corners(k) {
            text += &format!("vertex {} {} {}\n", x as f32, y as f32, z as f32);
        }
        text += "endloop\nendfacet\n";
    }
    text + "endsolid body\n"
}

#[test]
fn a_file_is_read_and_turned_outwards() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("box.stl");
    let mut inwards = cuboid([1.0, 2.0, 3.0]);
    std::fs::write(&path, text(&inwards)).unwrap();
    assert!((stl::read(&path).unwrap().volume().0 - 6.0).abs() < 1e-6);
    inwards.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    std::fs::write(&path, text(&inwards)).unwrap();
    let (volume, centre) = stl::read(&path).unwrap().volume();
    assert!((volume - 6.0).abs() < 1e-6, "{volume}");
    assert!((0..3).all(|d| (centre[d] - [0.5, 1.0, 1.5][d]).abs() < 1e-6), "{centre:?}");
    // The example's file, which is binary.
    let egg = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scenes/shapes/egg.stl");
    let egg = stl::read(&egg).unwrap();
    assert_eq!(egg.triangles.len(), 720);
    assert!((egg.volume().0 / (4.0 / 3.0 * PI * 30.0 * 22.0 * 22.0) - 1.0).abs() < 0.02);
}

/// What is no closed surface is refused, and the message names file and place.
#[test]
fn surfaces_that_are_not_closed_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.stl");
    let whole = cuboid([1.0, 2.0, 3.0]);
    let with = |change: &dyn Fn(&mut Triangles)| {
        let mut changed = whole.clone();
        change(&mut changed);
        text(&changed)
    };
    let cases = [
        (with(&|t| t.triangles.truncate(11)), "has a hole there"),
        (with(&|t| t.triangles[3].swap(0, 1)), "turned round"),
        (with(&|t| t.triangles.push(t.triangles[0])), "that of 3 triangles"),
        (with(&|t| t.vertices[7] = [1.0, f64::NAN, 0.0]), "NaN"),
        (with(&|t| t.triangles.push([0, 1, 1])), "without an area"),
        (with(&|t| t.triangles.truncate(2)), "2 in number"),
        ("this is no surface".to_string(), "not a readable STL file"),
    ];
    for (content, problem) in cases {
        std::fs::write(&path, content).unwrap();
        let error = stl::read(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(problem) && error.contains("bad.stl"), "{problem}: {error}");
    }
}

/// Of a box by its formula, outside and inside, near faces, edges and corners; of a ball between its facets and the sphere.
#[test]
fn distances_are_those_of_formulas() {
    let size = [1.0, 0.6, 0.4];
    let facets = Facets::new(cuboid(size));
    for k in 0..4000 {
        let at = |d: usize, count: usize| ((k * [7, 13, 29][d] % count) as f64 / count as f64 - 0.5) * 2.0;
        let p: [f64; 3] = [at(0, 101), at(1, 103), at(2, 107)];
        let out: [f64; 3] = std::array::from_fn(|d| p[d].abs() - 0.5 * size[d]);
        let outside = out.iter().map(|x| x.max(0.0).powi(2)).sum::<f64>().sqrt();
        let known = outside + out.iter().fold(f64::MIN, |most, x| most.max(*x)).min(0.0);
        let found = facets.distance(p);
        assert!((found - known).abs() < 1e-12, "{p:?}: {found}, known {known}");
    }
    let facets = Facets::new(ball(3, [3.0, 1.0, -2.0]));
    assert!((facets.centre[0] - 3.0).abs() < 1e-12, "{:?}", facets.centre);
    for k in 0..1000 {
        let at = |d: usize, count: usize| ((k * [7, 13, 29][d] % count) as f64 / count as f64 - 0.5) * 4.0;
        let p: [f64; 3] = [at(0, 101), at(1, 103), at(2, 107)];
        let known = p.iter().map(|x| x * x).sum::<f64>().sqrt() - 1.0;
        let found = facets.distance(p);
        // Edges are up to 0.17 long, so that facets are up to 0.17^2 / 6 inside.
        assert!(found > known - 1e-9 && found < known + 5e-3, "{p:?}: {found}, known {known}");
    }
}

/// Points are about a spacing from each other, and their areas are those of the surface; none straddles a sharp edge.
#[test]
fn points_are_even_and_count_the_whole_surface() {
    let (size, spacing) = ([1.0, 0.6, 0.4], 0.08);
    for (mesh, area, volume, is_box) in
        [(cuboid(size), 2.0 * (0.6 + 0.24 + 0.4), 0.24, true), (ball(3, [0.0; 3]), 4.0 * PI, 4.0 / 3.0 * PI, false)]
    {
        let facets = Facets::new(mesh);
        let points = facets.spread(spacing, 0.0, &[]);
        let length = |a: [f64; 3]| stl::dot(a, a).sqrt();
        let total: f64 = points.iter().map(|point| length(point.area)).sum();
        let around: [f64; 3] = std::array::from_fn(|d| points.iter().map(|point| point.area[d]).sum());
        let inside: f64 = points.iter().map(|point| stl::dot(point.place, point.area) / 3.0).sum();
        assert!((total / area - 1.0).abs() < 0.01, "{total}, known {area}");
        assert!((inside / volume - 1.0).abs() < 0.01, "{inside}, known {volume}");
        assert!(length(around) < 1e-9, "{around:?}");
        let wanted = area / (0.9 * spacing * spacing);
        assert!((points.len() as f64 / wanted - 1.0).abs() < 0.25, "{} points, wanted {wanted}", points.len());
        for (k, one) in points.iter().enumerate() {
            assert!(facets.distance(one.place).abs() < 1e-9);
            let nearest = points.iter().enumerate().filter(|(other, _)| *other != k);
            let nearest = nearest.map(|(_, other)| length(stl::minus(one.place, other.place))).fold(f64::MAX, f64::min);
            assert!((0.45..1.4).contains(&(nearest / spacing)), "{:?}: {nearest}", one.place);
            let normal = one.area.map(|x| x / length(one.area));
            let along = normal.iter().filter(|x| x.abs() > 0.999).count();
            assert!(!is_box || along == 1, "{normal:?} at {:?}", one.place);
        }
    }
}

/// A surface's places and areas by its numbers, beside differences.
#[test]
fn places_depend_on_numbers_as_differences_say() {
    let parts = vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Scale, Part::Angle];
    let numbers = vec![0.5, 0.4, 0.3, 0.7, 25.0];
    let form = Form::Facets(Box::new(Facets::new(cuboid([0.5, 0.3, 0.2]))), Standing::default());
    let surface = Surface { form, parts, numbers: numbers.clone(), geometry: 5 };
    let region = Region { size: [1.0; 3], periodic: [true; 3] };
    let spots = surface.spread(&region, 0.1, 0.0);
    assert!(spots.iter().all(|spot| surface.distance(&region, surface.at(spot, &numbers).place).abs() < 1e-9));
    depend_on_numbers(&surface, &spots, 1e-4, 1e-8);
}

/// Places and areas of spots by the numbers of their surface beside central differences.
pub(crate) fn depend_on_numbers(surface: &Surface, spots: &[Spot], step: f64, allowed: f64) {
    let count = surface.geometry;
    for spot in spots {
        for n in 0..count {
            let seed = |k: usize| Dual::new(surface.numbers[k], if k == n { 1.0 } else { 0.0 });
            let exact = surface.at(spot, &(0..count).map(seed).collect::<Vec<Dual>>());
            let moved = |step: f64| {
                let mut numbers = surface.numbers.clone();
                numbers[n] += step;
                surface.at(spot, &numbers)
            };
            let (up, down) = (moved(step), moved(-step));
            for d in 0..3 {
                let place = (up.place[d] - down.place[d]) / (2.0 * step);
                let area = (up.area[d] - down.area[d]) / (2.0 * step);
                assert!((place - exact.place[d].slope).abs() < allowed, "place by {n}");
                assert!((area - exact.area[d].slope).abs() < allowed, "area by {n}");
            }
        }
    }
}

/// Walls at rest; shapes have the temperature 1, sides 0.
#[derive(Debug)]
struct AtRest;

impl Surroundings for AtRest {
    fn condition(&self, point: &BoundaryPoint, _: [f64; 3], _: f64, _: &[Vec<f64>]) -> (Motion, Warmth) {
        (Motion::Given([0.0; 3]), Warmth::Given(if point.on.is_some() { 1.0 } else { 0.0 }))
    }
    fn varies(&self, _: usize) -> bool {
        false
    }
}

fn flow(ground: Ground, viscosity: f64, diffusivity: Option<f64>, velocity: f64) -> SteadyFlow {
    let fluid = Fluid { viscosity, diffusivity, force: [1.0, 0.0, 0.0], buoyancy: None, velocity };
    let cloud = Cloud::new(ground, fluid, Arc::new(AtRest), 2).expect("a cloud");
    SteadyFlow::new(cloud, None, MeasureSettings { probes: &[], target: 0.0, balanced: Balanced::Steady }, 2)
        .expect("a flow")
}

/// The drag of a cubic array of spheres, whose surface is that of triangles: Zick and Homsy's, as with the surface by formula.
#[test]
fn a_ball_of_triangles_has_the_drag_of_a_ball() {
    let (part, known, dx, viscosity) = (0.125f64, 4.292, 1.0 / 12.0, 100.0);
    let radius = (3.0 * part / (4.0 * PI)).cbrt();
    let region = Region { size: [1.0; 3], periodic: [true; 3] };
    let balls = [
        Surface {
            form: Form::Ball(Standing::default()),
            parts: vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Radius],
            numbers: vec![0.5, 0.5, 0.5, radius],
            geometry: 4,
        },
        Surface {
            form: Form::Facets(Box::new(Facets::new(ball(3, [7.0, 8.0, 9.0]))), Standing::default()),
            parts: vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Scale, Part::Angle],
            numbers: vec![0.5, 0.5, 0.5, radius, 0.0],
            geometry: 5,
        },
    ];
    let drags = balls.map(|surface| {
        let ground = Ground { region, dx, surface: 0.5 * dx, surfaces: vec![surface] };
        let mut flow = flow(ground, viscosity, None, 1e-3);
        let solution = flow.solve(&flow.cloud.numbers()).expect("a solution");
        let at = flow.at(&solution);
        let rate = flow.measures.value(Figure::FlowRate, &at);
        let own = flow.measures.surface_force(&at, 0, 0);
        println!(
            "{} particles, {} on the surface, volume {}, force of the surface {own}",
            flow.cloud.particles(),
            flow.cloud.places.boundary.len(),
            solution.shaped.volume
        );
        1.0 / (6.0 * PI * viscosity * radius * rate)
    });
    println!("{drags:?}, known {known}");
    assert!(drags.iter().all(|drag| (drag / known - 1.0).abs() < 0.02), "{drags:?}");
    assert!((drags[1] / drags[0] - 1.0).abs() < 0.02, "{drags:?}");
}

/// Exact derivatives by place, scale and angle of a box of triangles between walls, of flow rate, forces and heat together.
#[test]
fn gradient_agrees_with_differences() {
    let region = Region { size: [0.6, 0.4, 0.4], periodic: [true, false, false] };
    let dx = 0.05;
    let surface = Surface {
        form: Form::Facets(Box::new(Facets::new(ball(1, [0.0; 3]))), Standing::default()),
        parts: vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Scale, Part::Angle],
        numbers: vec![0.3, 0.22, 0.2, 0.1, 10.0],
        geometry: 5,
    };
    let ground = Ground { region, dx, surface: 0.6 * dx, surfaces: vec![surface] };
    let mut flow = flow(ground, 0.02, Some(0.02), 1.0);
    let terms = [
        (Figure::FlowRate, 3.0),
        (Figure::Force { shape: 0, along: 0 }, 1.0),
        (Figure::Force { shape: 0, along: 1 }, 2.0),
        (Figure::Heat { shape: 0 }, 1.5),
        (Figure::HeatOutflow, 2.5),
    ];
    let numbers = flow.cloud.numbers();
    let solution = flow.solve(&numbers).expect("a solution");
    let wanted = [(0, 1), (0, 3), (0, 4)];
    let gradient = flow.gradient(&solution, &terms, &wanted).expect("a gradient").by_numbers;
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    for (k, &(shape, number)) in wanted.iter().enumerate() {
        let step = if number == 4 { 1.0 } else { 2e-3 };
        let mut central = |step: f64| {
            let mut at = |sign: f64| {
                let mut moved = numbers.clone();
                moved[shape][number] += sign * step;
                let solution = flow.solve(&moved).expect("a solution");
                terms.iter().map(|(figure, w)| w * flow.measures.value(*figure, &flow.at(&solution))).sum::<f64>()
            };
            (at(1.0) - at(-1.0)) / (2.0 * step)
        };
        let (wide, narrow) = (central(step), central(0.5 * step));
        let difference = (4.0 * narrow - wide) / 3.0;
        let off = (gradient[k] - difference).abs() / norm;
        println!("{number}: {} {difference} {off:.1e}", gradient[k]);
        assert!(off < 1e-6, "number {number}: {} by differences {difference}", gradient[k]);
    }
}

/// What of a body is behind a side is cut off at the side: a cube that begins there, or behind it, has the faces, volume and distances of the
/// box by its numbers; a ball in an edge of the region a quarter of its surface and volume.
#[test]
fn triangles_end_at_the_sides_on_which_they_stand() {
    let region = Region { size: [2.0, 1.0, 1.0], periodic: [false; 3] };
    let parts = vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Scale, Part::Angle];
    let body = |mesh: Triangles, numbers: [f64; 5]| {
        let facets = Facets::new(mesh);
        let standing = Standing::of_facets(&region, &facets, &numbers);
        let form = Form::Facets(Box::new(facets), standing);
        Surface { form, parts: parts.clone(), numbers: numbers.to_vec(), geometry: 5 }
    };
    let on = |surface: &Surface, spacing: f64| -> Vec<([f64; 3], [f64; 3], f64)> {
        let spots = surface.spread(&region, spacing, 0.0);
        let at = spots.iter().map(|spot| surface.at(spot, &surface.numbers));
        at.map(|on| (on.place, on.area, surface.volume(&on, [0.8, 0.5, 0.2]))).collect()
    };
    let sum = |all: &[([f64; 3], [f64; 3], f64)]| -> ([f64; 3], f64, f64) {
        let size = |a: [f64; 3]| stl::dot(a, a).sqrt();
        let area = std::array::from_fn(|d| all.iter().map(|one| one.1[d]).sum());
        (area, all.iter().map(|one| size(one.1)).sum(), all.iter().map(|one| one.2).sum())
    };
    let exact = [0.6, 0.3, -0.1, 1.0, 0.7, 0.4];
    let corners = [0, 1, 2].map(Part::Lower).into_iter().chain([0, 1, 2].map(Part::Upper)).collect();
    let of_box = Standing::of_box(&region, &exact);
    let exact = Surface { form: Form::Box(of_box), parts: corners, numbers: exact.to_vec(), geometry: 6 };
    // The cube is turned by a right angle, its lower face in the side, as near as single precision has it, or 0.1 behind.
    for (height, middle) in [(0.4, 0.2 - 3e-8), (0.5, 0.15)] {
        let cube = body(cuboid([0.4, 0.4, height]), [0.8, 0.5, middle, 1.0, 90.0]);
        assert_eq!((0..6).filter(|&side| cube.stands_on(side)).collect::<Vec<_>>(), [4]);
        let all = on(&cube, 0.05);
        let (area, surface, volume) = sum(&all);
        assert!((volume - 0.064).abs() < 1e-6 && (surface - 0.8).abs() < 1e-5, "{volume} {surface}");
        assert!(area[0].abs() < 1e-9 && area[1].abs() < 1e-9 && (area[2] - 0.16).abs() < 1e-6, "{area:?}");
        // None is nearer to the side than a third of the spacing, as those of the box are half of it away.
        let least = all.iter().map(|one| one.0[2]).fold(f64::INFINITY, f64::min);
        assert!(least >= 0.35 * 0.05, "{least}");
        for p in
            [[0.8, 0.5, 0.0], [0.61, 0.31, 0.0], [0.59, 0.5, 0.0], [0.8, 0.5, 0.45], [1.1, 0.8, 0.0], [0.9, 0.5, 0.3]]
        {
            let (found, box_) = (cube.distance(&region, p), exact.distance(&region, p));
            // (What is in the box is as far from its lower face, too, which is behind the side.)
            assert!((found - box_).abs() < 1e-5 || found < 0.0 && box_ < 0.0, "{p:?}: {found} {box_}");
        }
        // Layers begin a spacing from the side.
        for spot in cube.spread(&region, 0.05, 0.05) {
            let on = cube.at(&spot, &cube.numbers);
            assert!(on.place[2] > 0.03, "{on:?}");
        }
        // It may slide along the side, and not rise from it.
        let mut moved = cube.numbers.clone();
        moved[0] += 0.1;
        assert!(!cube.stands_elsewhere(&region, &moved));
        moved[2] += 0.2;
        assert!(cube.stands_elsewhere(&region, &moved));
    }
    let quarter = body(ball(4, [0.0; 3]), [0.8, 1.0, 0.0, 0.3, 0.0]);
    assert_eq!((0..6).filter(|&side| quarter.stands_on(side)).collect::<Vec<_>>(), [3, 4]);
    let (area, surface, volume) = sum(&on(&quarter, 0.05));
    assert!((volume / (PI * 0.027 / 3.0) - 1.0).abs() < 0.01, "{volume}");
    assert!((surface / (PI * 0.09) - 1.0).abs() < 0.01, "{surface}");
    let half_circle = 0.5 * PI * 0.09;
    assert!(area[0].abs() < 1e-3, "{area:?}");
    assert!((area[1] / half_circle + 1.0).abs() < 0.01 && (area[2] / half_circle - 1.0).abs() < 0.01, "{area:?}");
}

/// A cylinder of triangles whose lower end is behind the floor of a duct has the drag and heat of finite elements, as that by its numbers has
/// ([`crate::space`]: 0.4586 and 0.1662).
#[test]
fn a_cylinder_of_triangles_on_the_floor_has_the_drag_and_heat_of_finite_elements() {
    let folder = tempfile::tempdir().unwrap();
    let sides = 48u32;
    let rim = |k: u32, z: f64| {
        let angle = 2.0 * PI * f64::from(k % sides) / f64::from(sides);
        [0.8 + 0.2 * angle.cos(), 0.5 + 0.2 * angle.sin(), z]
    };
    let (low, high) = (-0.1, 0.4);
    let mut vertices = vec![[0.8, 0.5, low], [0.8, 0.5, high]];
    vertices.extend((0..sides).flat_map(|k| [rim(k, low), rim(k, high)]));
    let at = |k: u32, end: u32| 2 + 2 * (k % sides) + end;
    let triangles = (0..sides)
        .flat_map(|k| {
            let [a, b, c, d] = [at(k, 0), at(k + 1, 0), at(k + 1, 1), at(k, 1)];
            [[a, b, c], [a, c, d], [0, b, a], [1, d, c]]
        })
        .collect();
    std::fs::write(folder.path().join("pin.stl"), text(&Triangles { vertices, triangles })).unwrap();
    let scene = "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.1\nregion.size = [2.0, 1.0, 1.0]\n\
         region.periodic = [false, false, false]\nfluid.viscosity = 0.05\nfluid.conductivity = 0.05\n\
         fluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
         region.sides.left = { kind = \"inflow\", velocity = [\"16*y*(1-y)*z*(1-z)\", 0, 0], temperature = 0.0 }\n\
         region.sides.right = { kind = \"outflow\" }\nobjective.kind = \"shape-heat\"\n\
         [[shapes]]\nkind = \"file\"\nfile = \"pin.stl\"\ntemperature = 1.0\n";
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, scene).unwrap();
    let config =
        Config::load(Some(file.to_str().unwrap()), None, &[]).map_err(|error| error.to_string()).unwrap().config;
    let mut around = AroundBodies::new(&config).unwrap();
    let numbers = around.flow.cloud.numbers();
    let solution = around.flow.solve(&numbers).expect("a flow");
    let value = |figure| around.value(&solution, figure);
    let (drag, heat) = (value(Figure::Force { shape: 0, along: 0 }), value(Figure::Heat { shape: 0 }));
    println!("drag {drag}, heat {heat}");
    assert!((drag / 0.4586 - 1.0).abs() < 0.01 && (heat / 0.1662 - 1.0).abs() < 0.03, "{drag} {heat}");
    // That of 48 triangles around. (What a point stands for goes over several of them, whose middle is inside of the surface: 0.2 % of the cylinder.)
    let volume = 2.0 - 0.4 * 24.0 * 0.04 * (2.0 * PI / 48.0).sin();
    assert!((solution.shaped.volume - volume).abs() < 1e-4, "{}", solution.shaped.volume);
}

/// A scene with a file beside it: its numbers are those of the file until others are given.
#[test]
fn a_scene_has_its_file_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("body.STL"), text(&ball(2, [5.0, 2.0, 2.0]))).unwrap();
    let file = folder.path().join("scene.toml");
    let scene = |size: &str, periodic: &str, method: &str, more: &str| {
        let push = if size.matches(',').count() == 2 { "[1.0, 0.0, 0.0]" } else { "[1.0, 0.0]" };
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"{method}\"\nregion.size = {size}\nregion.periodic = {periodic}\n\
             region.acceleration = {push}\nresolution.dx = 0.5\nfluid.viscosity = 1.0\nobjective.kind = \"flow-rate\"\n\
             [[shapes]]\nkind = \"file\"\nfile = \"body.STL\"\n{more}"
        );
        std::fs::write(&file, text).unwrap();
        Config::load(Some(file.to_str().unwrap()), None, &[]).map_err(|error| error.to_string())
    };
    const BOX: (&str, &str) = ("[10.0, 4.0, 4.0]", "[true, false, false]");
    let variable = "[[variables]]\nnumber = \"shapes[0].scale\"\nlower = 0.8\nupper = 1.2\n";
    let loaded = scene(BOX.0, BOX.1, "fixed", variable).unwrap();
    let shape = &loaded.config.shapes[0];
    let centre = shape.centre.clone().unwrap();
    assert!((centre[0] - 5.0).abs() < 1e-5 && (centre[1] - 2.0).abs() < 1e-5, "{centre:?}");
    assert_eq!((shape.scale, shape.angle), (Some(1.0), Some(0.0)));
    let around = AroundBodies::new(&loaded.config).unwrap();
    assert_eq!(around.first(), [1.0]);
    // The configuration of a run is read from its own folder.
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::write(run.join("config.toml"), &loaded.text).unwrap();
    let again = Config::load(run.join("config.toml").to_str(), None, &[]).unwrap();
    assert_eq!(again.config.shapes, loaded.config.shapes);
    for (size, periodic, method, more, problem) in [
        ("[10.0, 4.0]", "[true, false]", "fixed", "centre = [5.0, 2.0]\n", "triangles in two dimensions"),
        (BOX.0, BOX.1, "consistent", "", "triangles with particles that move"),
        (BOX.0, BOX.1, "fixed", "scale = -1.0\n", "shapes[0].scale"),
        (BOX.0, BOX.1, "fixed", "radius = 1.0\n", "shapes[0].radius: has no meaning here"),
    ] {
        let error = scene(size, periodic, method, more).map(|_| ()).unwrap_err();
        assert!(error.contains(problem), "{problem}: {error}");
    }
    // Half in the wall it stands there, and only what leaves its part of the fluid as it is may vary.
    let half = |more: &str| {
        let loaded = scene(BOX.0, BOX.1, "fixed", &format!("centre = [5.0, 4.0, 2.0]\n{more}")).unwrap();
        AroundBodies::new(&loaded.config)
    };
    let around = half("").unwrap();
    let volume = around.flow.cloud.volume_of(0, &around.flow.cloud.numbers()[0], None).value;
    // That of 320 triangles is 3.5 % less than a half ball's.
    assert!((volume / (2.0 * PI / 3.0) - 0.965).abs() < 0.01, "{volume}");
    let vary = |number: &str, low: f64, high: f64| {
        half(&format!("[[variables]]\nnumber = \"shapes[0].{number}\"\nlower = {low}\nupper = {high}\n"))
    };
    assert_eq!(vary("centre[0]", 4.0, 6.0).unwrap().first(), [5.0]);
    for (number, low, high) in [("centre[1]", 3.5, 4.5), ("scale", 0.8, 1.2), ("angle", 0.0, 90.0)] {
        let error = vary(number, low, high).err().unwrap().to_string();
        assert!(error.contains(&format!("\"shapes[0].{number}\" moves what of the shape is behind")), "{error}");
    }
    // Behind the wall, or in other units: the surface of the last would have 10^10 points.
    const ALL: &str = "[true, true, true]";
    for (more, periodic) in [
        ("centre = [5.0, 5.5, 2.0]\n", BOX.1),
        ("scale = 20.0\n", BOX.1),
        ("scale = 20.0\n", ALL),
        ("scale = 1e5\n", BOX.1),
        ("scale = 1e5\n", ALL),
    ] {
        let loaded = scene(BOX.0, periodic, "fixed", more).unwrap();
        let error = AroundBodies::new(&loaded.config).err().unwrap().to_string();
        assert!(error.contains("shapes[0] cuts") && error.contains("shapes[0].scale=0.001"), "{more}: {error}");
    }
}
