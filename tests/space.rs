//! Fixed particles around shapes in space.

use crate::cloud::loaded;
use crate::facets::depend_on_numbers;
use hydrograd::config::custom::{Kind, Part, ShapeEntry};
use hydrograd::config::scene::Config;
use hydrograd::scene::around_bodies::AroundBodies;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::sph::cloud::equations::Warmth;
use hydrograd::sph::cloud::figures::{Figure, MeasureSettings};
use hydrograd::sph::cloud::fit::Stencils;
use hydrograd::sph::cloud::fit_adjoint::PairCotangents;
use hydrograd::sph::cloud::fits::Fits;
use hydrograd::sph::cloud::nearest::{Nearest, Region};
use hydrograd::sph::cloud::outline::Outline;
use hydrograd::sph::cloud::particles::{Balanced, Fluid, Unusable};
use hydrograd::sph::cloud::space::equations::Motion;
use hydrograd::sph::cloud::space::fits::{fits, seen, Where};
use hydrograd::sph::cloud::space::particles::{Cloud, Surroundings};
use hydrograd::sph::cloud::space::placing::{BoundaryPoint, Ground};
use hydrograd::sph::cloud::space::problem::{Solution, SteadyFlow};
use hydrograd::sph::cloud::space::surface::{Form, Standing, Surface};
use std::f64::consts::PI;
use std::sync::Arc;

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

fn ball(centre: [f64; 3], radius: f64) -> Surface {
    let parts = vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Radius];
    Surface {
        form: Form::Ball(Standing::default()),
        parts,
        numbers: vec![centre[0], centre[1], centre[2], radius],
        geometry: 4,
    }
}

fn flow(ground: Ground, viscosity: f64, diffusivity: Option<f64>, velocity: f64) -> SteadyFlow {
    let fluid = Fluid { viscosity, diffusivity, force: [1.0, 0.0, 0.0], buoyancy: None, velocity };
    let cloud = Cloud::new(ground, fluid, Arc::new(AtRest), 2).expect("a cloud");
    SteadyFlow::new(cloud, None, MeasureSettings { probes: &[], target: 0.0, balanced: Balanced::Steady }, 2)
        .expect("a flow")
}

/// The steady flow of a scene.
fn solved(text: &str) -> (AroundBodies, Solution) {
    let mut around = AroundBodies::new(&loaded(text)).unwrap();
    let numbers = around.flow.cloud.numbers();
    let solution = around.flow.solve(&numbers).expect("a flow");
    (around, solution)
}

/// A cloud of points without order: every third of the first half near a shape, every seventh on a boundary.
fn scattered() -> (Fits<3>, [Vec<f64>; 3], Vec<Where>) {
    let region = Region { size: [1.0; 3], periodic: [false; 3] };
    let kind = |i: usize| match (i % 3, i % 7) {
        (0, _) if i < 100 => Where::NearShape,
        (_, 0) => Where::Boundary,
        _ => Where::Far,
    };
    // Weyl's sequence.
    let place = |i: usize| [0.8191725134, 0.6710436067, 0.5497004779].map(|a| (a * (i + 1) as f64).fract());
    let places: Vec<[f64; 3]> = (0..200).map(place).collect();
    let kinds: Vec<Where> = (0..200).map(kind).collect();
    let nearest = Nearest::new(region, 0.2, &places);
    let near: Vec<Vec<(f64, u32)>> = (0..200).map(|i| nearest.of(places[i], kinds[i].needs(), |j, _| j != i)).collect();
    let fits = fits(region, &places, &kinds, |i| &near[i][..]).expect("fits");
    (fits, std::array::from_fn(|d| places.iter().map(|p| p[d]).collect()), kinds)
}

/// Slopes and S of a quadratic field, and near shapes the second derivatives of a cubic one, by their formulas.
#[test]
fn fits_are_exact_to_their_order() {
    let (fits, position, kinds) = scattered();
    let place = |i: usize| [position[0][i], position[1][i], position[2][i]];
    let operators = fits.coefficients(&position);
    let field = |f: fn([f64; 3]) -> f64| -> Vec<f64> { (0..kinds.len()).map(|i| f(place(i))).collect() };
    let quadratic = field(|[x, y, z]| 1.0 + x - 2.0 * y + x * x - y * z);
    let cubic = field(|[x, y, z]| x * x * x - 2.0 * x * y * z + y * y * z + z * z);
    for i in 0..kinds.len() {
        let [x, y, z] = place(i);
        let d = operators.derivatives(&fits.all, i, &quadratic);
        let known = [1.0 + 2.0 * x, -2.0 - z, -y, 2.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0];
        let scale = fits.all.scale(i).powi(-2);
        for (found, known) in d.iter().zip(known) {
            assert!((found - known).abs() < 1e-11 * scale, "{i}: {d:?}, {known:?}");
        }
        if kinds[i] == Where::NearShape {
            let d = operators.derivatives(&fits.all, i, &cubic);
            let known = [6.0 * x, -2.0 * z, -2.0 * y, 2.0 * z, -2.0 * x + 2.0 * y, 2.0];
            for (found, known) in d[3..9].iter().zip(known) {
                assert!((found - known).abs() < 1e-9 * scale, "{i}: {d:?}, {known:?}");
            }
        }
    }
}

/// What S sees of a particle's own value is the sum of its coefficients; it is 0 where all neighbours lie on a sphere through whose centre
/// the particle is not, and particles have more neighbours until it is large enough.
#[test]
fn fits_have_as_many_neighbours_as_see_the_particle() {
    let region = Region { size: [1.0; 3], periodic: [false; 3] };
    // All but the first on a sphere around (0.5, 0.5, 0.5), by Weyl's sequence.
    let on_sphere = |i: usize| {
        let [a, b] = [0.7548776662, 0.5698402910].map(|a| (a * i as f64).fract());
        let (z, angle) = (2.0 * a - 1.0, 2.0 * PI * b);
        let r = (1.0 - z * z).sqrt();
        [0.5 + 0.3 * r * angle.cos(), 0.5 + 0.3 * r * angle.sin(), 0.5 + 0.3 * z]
    };
    let places: Vec<[f64; 3]> = std::iter::once([0.55, 0.48, 0.51]).chain((1..100).map(on_sphere)).collect();
    let near = Nearest::new(region, 0.2, &places).of(places[0], 41, |j, _| j != 0);
    assert!(seen(region, &places, 0, &near).abs() < 1e-12);

    let (_, position, kinds) = scattered();
    let places: Vec<[f64; 3]> = (0..kinds.len()).map(|i| [position[0][i], position[1][i], position[2][i]]).collect();
    let nearest = Nearest::new(region, 0.2, &places);
    let near: Vec<Vec<(f64, u32)>> = (0..200).map(|i| nearest.of(places[i], 61, |j, _| j != i)).collect();
    let by = |count: usize| {
        let all = Stencils::new(region, &places, |_| count, |_| false, |i| &near[i][..]).expect("stencils");
        let operators = all.coefficients(&position);
        (0..places.len())
            .map(|i| {
                let by_sum: f64 = (0..count).map(|k| operators.of(i, k)[9]).sum::<f64>() * all.scale(i).powi(2);
                let found = seen(region, &places, i, &near[i][..=count]);
                assert!((found - by_sum).abs() < 1e-10 * (1.0 + by_sum), "{i}: {found}, {by_sum}");
                found
            })
            .collect::<Vec<f64>>()
    };
    let counts = [32, 36, 40, 46, 52, 60];
    let of_count = counts.map(by);
    let far = vec![Where::Far; places.len()];
    let fits = fits(region, &places, &far, |i| &near[i][..]).expect("fits");
    let mut more = 0;
    for i in 0..places.len() {
        let own = (0..fits.all.count(i)).filter(|&k| fits.all.pair(i, k).1 > 0.0).count();
        let place = counts.iter().position(|&count| count == own).expect("one of the numbers");
        let all: Vec<f64> = of_count.iter().map(|seen| seen[i]).collect();
        assert!(all[..place].iter().all(|&seen| seen < 0.35), "{i}: {own} neighbours, {all:?}");
        assert!(all[place] >= 0.35 || all.iter().all(|&seen| seen <= all[place]), "{i}: {own} neighbours, {all:?}");
        more += usize::from(place > 0);
    }
    assert!(more > 10, "{more} particles have more than 32");
}

/// Cotangents of positions against central differences of a weighted sum of all derivatives of two fields.
#[test]
fn positions_of_fits_have_exact_derivatives() {
    let (fits, position, kinds) = scattered();
    let n = kinds.len();
    let number = |k: usize| (12.9898 * (k + 1) as f64).sin();
    let fields: Vec<Vec<f64>> = (0..2).map(|f| (0..n).map(|i| number(7 * i + f)).collect()).collect();
    let fields: Vec<&[f64]> = fields.iter().map(Vec::as_slice).collect();
    let weight = |f: usize, i: usize, c: usize| number(31 * i + 3 * c + f);
    let bar: Vec<Vec<[f64; 10]>> =
        (0..2).map(|f| (0..n).map(|i| std::array::from_fn(|c| weight(f, i, c))).collect()).collect();
    let sum = |position: &[Vec<f64>; 3]| -> f64 {
        let operators = fits.coefficients(position);
        let of = |f: usize, i: usize| -> f64 {
            let d = operators.derivatives(&fits.all, i, fields[f]);
            d.iter().zip(&bar[f][i]).map(|(d, bar)| d * bar).sum()
        };
        (0..2).map(|f| (0..n).map(|i| of(f, i)).sum::<f64>()).sum()
    };
    let mut found: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; n]);
    fits.pull_back(&position, &fields, &bar, &mut found);
    let along: [Vec<f64>; 3] = std::array::from_fn(|d| (0..n).map(|i| number(5 * i + d)).collect());
    let exact: f64 = (0..3).map(|d| found[d].iter().zip(&along[d]).map(|(a, b)| a * b).sum::<f64>()).sum();
    let at = |step: f64| {
        sum(&std::array::from_fn(|d| position[d].iter().zip(&along[d]).map(|(x, a)| x + step * a).collect()))
    };
    let central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
    let difference = (4.0 * central(5e-6) - central(1e-5)) / 3.0;
    assert!((exact / difference - 1.0).abs() < 1e-6, "{exact}, by differences {difference}");
    // The same by the cotangents of all pairs' coefficients, those of each fit apart.
    let mut pairs = PairCotangents::zeros(&fits.all);
    pairs.add(&fits.all, &fields, &bar);
    let mut summed: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; n]);
    fits.pull_back_pairs(&position, pairs, &mut summed);
    let size = found.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
    for (own, known) in summed.iter().flatten().zip(found.iter().flatten()) {
        assert!((own - known).abs() < 1e-11 * size, "{own}, {known}");
    }
}

/// Zick and Homsy (1982), Stokes flow through a simple cubic array: drag in that of a sphere alone, by the part of space that
/// spheres fill. The drag is that of the pressure gradient over the whole cell.
#[test]
fn drag_of_a_cubic_array_of_spheres_is_that_of_zick_and_homsy() {
    for (part, known) in [(0.064, 2.810), (0.343, 15.4)] {
        let radius = (3.0 * part / (4.0 * PI)).cbrt();
        let region = Region { size: [1.0; 3], periodic: [true; 3] };
        let dx = 1.0 / 20.0;
        let ground = Ground { region, dx, surface: 0.5 * dx, surfaces: vec![ball([0.5; 3], radius)] };
        let viscosity = 100.0;
        let mut flow = flow(ground, viscosity, None, 1e-3);
        let solution = flow.solve(&flow.cloud.numbers()).expect("a solution");
        let at = flow.at(&solution);
        let rate = flow.measures.value(Figure::FlowRate, &at);
        let drag = 1.0 / (6.0 * PI * viscosity * radius * rate);
        println!("{part}: {} particles, {drag:.4}, known {known}", flow.cloud.particles());
        assert!((drag / known - 1.0).abs() < 5e-3, "{part}: {drag}, known {known}");
        assert!((solution.shaped.volume + part - 1.0).abs() < 1e-3 * part);
        // By the surface alone, beside the balance with the body force on the fluid.
        let own = flow.measures.surface_force(&at, 0, 0);
        assert!((own / (1.0 - part) - 1.0).abs() < 0.03, "{own}");
        assert!((flow.measures.value(Figure::Force { shape: 0, along: 0 }, &at) / (1.0 - part) - 1.0).abs() < 1e-3);
    }
}

/// As much must flow through every plane across a cubic array of spheres, since nothing flows through their surfaces. Continuity holds
/// at particles, with the pressure's damping, and not as a balance: from the plane between spheres to that through their centres
/// the rate grows by 0.6 % at 12 spacings.
#[test]
fn the_same_flows_through_all_planes_of_an_array_of_spheres() {
    let (part, dx, count) = (0.125f64, 1.0 / 12.0, 60);
    let radius = (3.0 * part / (4.0 * PI)).cbrt();
    let region = Region { size: [1.0; 3], periodic: [true; 3] };
    let ground = Ground { region, dx, surface: 0.5 * dx, surfaces: vec![ball([0.5; 3], radius)] };
    let middle = |k: usize| (k as f64 + 0.5) / count as f64;
    let plane = |x: f64| (0..count * count).map(move |k| [x, middle(k / count), middle(k % count)]);
    let in_fluid = |p: &[f64; 3]| region.distance([0.5; 3], *p) > radius;
    let planes: Vec<Vec<[f64; 3]>> = [0.0, 0.25, 0.5].map(|x| plane(x).filter(in_fluid).collect()).to_vec();
    let fluid = Fluid { viscosity: 100.0, diffusivity: None, force: [1.0, 0.0, 0.0], buoyancy: None, velocity: 1e-3 };
    let cloud = Cloud::new(ground, fluid, Arc::new(AtRest), 2).expect("a cloud");
    let mut flow = SteadyFlow::new(
        cloud,
        None,
        MeasureSettings { probes: &planes.concat(), target: 0.0, balanced: Balanced::Steady },
        2,
    )
    .expect("a flow");
    let solution = flow.solve(&flow.cloud.numbers()).expect("a solution");
    let at = flow.at(&solution);
    let mut next = 0;
    let mut rate = |points: &Vec<[f64; 3]>| -> f64 {
        let own = next..next + points.len();
        next = own.end;
        own.map(|probe| flow.measures.value(Figure::Probe { field: 0, probe }, &at)).sum::<f64>()
            / (count * count) as f64
    };
    let rates: Vec<f64> = planes.iter().map(&mut rate).collect();
    println!("{rates:?}");
    for found in &rates {
        assert!((found / rates[0] - 1.0).abs() < 1e-2, "{rates:?}");
    }
    // The figure is taken at the plane between spheres.
    let figure = flow.measures.value(Figure::FlowRate, &at);
    assert!((figure / rates[0] - 1.0).abs() < 2e-3, "{figure}, {rates:?}");
}

/// A ball, a box and a column that turn, in the middle of a periodic channel and where the period begins and ends: the same flow.
#[test]
fn a_flow_is_the_same_wherever_its_period_begins() {
    let text = |shape: &str, [x, y]: [f64; 2]| {
        let shape = match shape {
            "disc" => format!("centre = [{x}, {y}, 0.35]\nradius = 0.12\n"),
            "box" => format!("lower = [{}, {}, 0.2]\nupper = [{}, {}, 0.4]\n", x - 0.1, y - 0.1, x + 0.1, y + 0.1),
            _ => format!("centre = [{x}, {y}]\nradii = [0.13, 0.11, 0.13, 0.12]\n"),
        } + &format!(
            "kind = \"{shape}\"\nvelocity = [\"0.3*({y} - y)\", \"0.3*(x - {x})\", 0.0]\ntemperature = 1.0\n"
        );
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [0.8, 0.6, 0.6]\nregion.periodic = [true, true, false]\n\
             region.acceleration = [0.5, 0.0, 0.0]\nregion.sides.front = {{ kind = \"wall\", temperature = 0.0 }}\n\
             region.sides.back = {{ kind = \"wall\", temperature = 0.0 }}\ninitial.temperature = 0.0\nresolution.dx = 0.05\n\
             fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nobjective.kind = \"drag\"\n[[shapes]]\n{shape}"
        )
    };
    for shape in ["disc", "box", "spline"] {
        let figures = |place: [f64; 2]| {
            let (around, solution) = solved(&text(shape, place));
            let all = [
                Figure::FlowRate,
                Figure::Force { shape: 0, along: 0 },
                Figure::Torque { shape: 0 },
                Figure::Heat { shape: 0 },
            ];
            all.map(|figure| around.flow.measures.value(figure, &around.flow.at(&solution)))
        };
        let middle = figures([0.4, 0.3]);
        println!("{shape}: {middle:?}");
        for place in [[0.0, 0.3], [0.8, 0.3], [0.4, 0.6]] {
            for (found, wanted) in figures(place).iter().zip(&middle) {
                // Points of a box or a column are spread from its corner, which rounding moves to another cell.
                assert!(
                    (found - wanted).abs() < 2e-3 * wanted.abs().max(0.01),
                    "{shape} at {place:?}: {found}, {wanted} in the middle"
                );
            }
        }
    }
}

/// A round column across a channel, as long as three spacings with a period along it: finite elements of the plane flow,
/// data/reference/bodies (circle): flow rate 0.25039, drag 0.18711, heat 0.038151 a length.
#[test]
fn a_column_has_the_flow_drag_and_heat_of_the_plane() {
    let (dx, depth) = (0.025, 0.1);
    let region = Region { size: [1.0, 0.4, depth], periodic: [true, false, true] };
    let disc =
        ShapeEntry { kind: Kind::Disc, centre: Some(vec![0.5, 0.2]), radius: Some(0.06), ..ShapeEntry::default() };
    let outline = Outline::new(&disc, 0.0).expect("an outline");
    let column = Surface::column(outline, 2, None, &region);
    let ground = Ground { region, dx, surface: 0.5 * dx, surfaces: vec![column] };
    let mut flow = flow(ground, 0.006, Some(0.006), 1.0);
    let solution = flow.solve(&flow.cloud.numbers()).expect("a solution");
    let at = flow.at(&solution);
    let of = |figure: Figure| flow.measures.value(figure, &at) / depth;
    let found = [of(Figure::FlowRate), of(Figure::Force { shape: 0, along: 0 }), of(Figure::Heat { shape: 0 })];
    println!("{} particles, flow, drag, heat {found:?}", flow.cloud.particles());
    for (found, (known, tolerance)) in found.iter().zip([(0.25039, 0.01), (0.18711, 0.005), (0.038151, 0.03)]) {
        assert!((found / known - 1.0).abs() < tolerance, "{found}, known {known}");
    }
}

/// A cylinder of 3.5 spacings from one side to the other, where the fluid slips, has the drag of the plane: by the balance and by its surface.
/// With 32 neighbours everywhere it is 7 and 10 % too large (with more 0.8 and 1.1), because some particles hardly see themselves.
#[test]
fn a_coarse_cylinder_between_sides_has_the_drag_of_the_plane() {
    let slips = ["top", "bottom", "front", "back"];
    let sides = |names: &[&str]| {
        names.iter().map(|side| format!("region.sides.{side} = {{ kind = \"symmetry\" }}\n")).collect::<String>()
    };
    let text = |dx: f64, size: &str, velocity: &str, slips: &[&str], shape: &str| {
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = {dx}\nfluid.viscosity = 0.055\nregion.size = {size}\n\
             {}region.sides.left = {{ kind = \"inflow\", velocity = {velocity} }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\nobjective.kind = \"drag\"\nobjective.shapes = [0]\n\
             [[shapes]]\nradius = 0.125\n{shape}",
            sides(slips)
        )
    };
    let of_plane = text(0.03, "[1.4, 0.7]", "[\"1\", \"0\"]", &slips[..2], "kind = \"disc\"\ncentre = [0.6, 0.33]\n");
    let mut plane = AroundShapes::new(&loaded(&of_plane)).unwrap();
    let solution = plane.flow.solve(&plane.flow.cloud.numbers()).expect("a flow");
    let known = plane.flow.value(&solution, Figure::Force { shape: 0, along: 0 });

    let shape = "kind = \"cylinder\"\naxis = \"z\"\ncentre = [0.6, 0.33, 0.35]\n";
    let of_space = text(0.07, "[1.4, 0.7, 0.7]", "[\"1\", \"0\", \"0\"]", &slips, shape);
    let (around, solution) = solved(&of_space);
    let (at, measures) = (around.flow.at(&solution), &around.flow.measures);
    let balance = measures.value(Figure::Force { shape: 0, along: 0 }, &at) / 0.7;
    let surface = measures.surface_force(&at, 0, 0) / 0.7;
    println!("{} particles: {balance}, {surface}, in the plane {known}", around.flow.cloud.particles());
    assert!((balance / known - 1.0).abs() < 0.015 && (surface / known - 1.0).abs() < 0.025);
}

/// Exact derivatives by place and radius of a ball between walls, of flow rate, drag and heat together.
#[test]
fn gradient_agrees_with_differences() {
    let region = Region { size: [0.6, 0.4, 0.4], periodic: [true, false, false] };
    let dx = 0.05;
    let ground = Ground { region, dx, surface: 0.6 * dx, surfaces: vec![ball([0.3, 0.22, 0.2], 0.1)] };
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
    let wanted = [(0, 1), (0, 3)];
    let gradient = flow.gradient(&solution, &terms, &wanted).expect("a gradient").by_numbers;
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    for (k, &(shape, number)) in wanted.iter().enumerate() {
        let mut central = |step: f64| {
            let mut at = |sign: f64| {
                let mut moved = numbers.clone();
                moved[shape][number] += sign * step;
                let solution = flow.solve(&moved).expect("a solution");
                terms.iter().map(|(figure, w)| w * flow.measures.value(*figure, &flow.at(&solution))).sum::<f64>()
            };
            (at(1.0) - at(-1.0)) / (2.0 * step)
        };
        let (wide, narrow) = (central(2e-3), central(1e-3));
        let difference = (4.0 * narrow - wide) / 3.0;
        let off = (gradient[k] - difference).abs() / norm;
        println!("{number}: {} {difference} {off:.1e}", gradient[k]);
        assert!(off < 1e-6, "number {number}: {} by differences {difference}", gradient[k]);
    }
}

/// Fluid leaves through a side no faster than it flows before it, also where gravity draws it across that side. (Where a velocity followed
/// from its slope alone, one point of this side hardly counted in its own equation: it was four times as fast as all others, and with gravity
/// no flow was found.)
#[test]
fn fluid_leaves_no_faster_than_it_flows() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [1.2, 1.6, 1.0]\nregion.periodic = [false, false, false]\n\
        resolution.dx = 0.1\nfluid.viscosity = 0.05\nfluid.reference_velocity = 1.0\nobjective.kind = \"flow-rate\"\n\
        region.acceleration = [0.2, 0.0, -0.4]\n\
        region.sides.bottom = { kind = \"inflow\", velocity = [0, \"11*z*(1-z)*x*(1.2-x)\", 0] }\nregion.sides.top = { kind = \"outflow\" }\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.72, 0.5, 0.4]\nradius = 0.24\n\
        [[shapes]]\nkind = \"box\"\nlower = [0.3, 1.05, 0.6]\nupper = [0.7, 1.35, 0.85]\n";
    let (around, solution) = solved(text);
    let inside = around.flow.cloud.places.inside;
    let fastest = |range: std::ops::Range<usize>| {
        range.map(|i| solution.state.velocity(i).iter().map(|u| u * u).sum::<f64>().sqrt()).fold(0.0, f64::max)
    };
    let leaving = |k: &usize| matches!(solution.conditions[*k].motion, Motion::Outflow(_));
    let [flows, leaves] = [
        fastest(0..inside),
        (0..solution.conditions.len()).filter(leaving).map(|k| fastest(inside + k..inside + k + 1)).fold(0.0, f64::max),
    ];
    println!("{leaves} of {flows}");
    assert!(flows > 0.9 && leaves > 0.2 && leaves < flows, "{leaves} of {flows}");
}

/// Where a side that lets fluid slip meets an outflow, the normal is that of the side whose condition holds: across it velocities have no slope.
#[test]
fn edges_have_the_normal_of_the_side_whose_condition_holds() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [1.2, 0.8, 0.8]\nresolution.dx = 0.1\n\
        fluid.viscosity = 0.1\nfluid.reference_velocity = 1.0\nobjective.kind = \"flow-rate\"\n\
        region.sides.left = { kind = \"inflow\", velocity = [1, 0, 0] }\nregion.sides.right = { kind = \"outflow\" }\n\
        region.sides.bottom = { kind = \"symmetry\" }\nregion.sides.top = { kind = \"symmetry\" }\n\
        region.sides.back = { kind = \"symmetry\" }\nregion.sides.front = { kind = \"symmetry\" }\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.4, 0.4]\nradius = 0.15\n";
    let (around, solution) = solved(text);
    let mut edges = 0;
    for (condition, point) in solution.conditions.iter().zip(&around.flow.cloud.places.boundary) {
        if let Motion::Symmetry(along) | Motion::Outflow(along) = condition.motion {
            edges += usize::from(point.sides.len() > 1);
            assert_eq!(condition.normal[along].abs(), 1.0, "{point:?}: {condition:?}");
        }
    }
    assert!(edges > 40, "{edges}");
}

/// What fixed particles do not have in three dimensions, and shapes that cannot be.
#[test]
fn scenes_are_refused_by_name() {
    const BOX: &str = "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [1.0, 0.4, 0.4]\n\
                       region.periodic = [true, false, false]\nregion.acceleration = [1.0, 0.0, 0.0]\nresolution.dx = 0.05\n\
                       fluid.viscosity = 0.01\nobjective.kind = \"flow-rate\"\n";
    let ball =
        |centre: &str, radius: f64| format!("[[shapes]]\nkind = \"disc\"\ncentre = {centre}\nradius = {radius}\n");
    let middle = ball("[0.5, 0.2, 0.2]", 0.1);
    let section = |points: &str, more: &str| format!("[[shapes]]\nkind = \"polygon\"\npoints = {points}\n{more}\n");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    let cases = [
        (format!("{middle}[[limits]]\nkind = \"area\"\nat_most = 1.0\n"), "limits[0].kind = area in three dimensions"),
        (format!("resolution.far = 2.0\n{middle}"), "resolution.far"),
        (ball("[0.5, 0.2]", 0.1), "shapes[0].centre"),
        (ball("[0.5, 0.2, 0.2]", 0.21), "shapes[0] is a ball that goes through sides"),
        (ball("[0.5, 0.2, 0.12]", 0.115), "from another shape or a side of the region"),
        (ball("[0.5, 0.2, 0.2]", 0.01), "too thin"),
        (format!("{middle}{}", ball("[0.6, 0.2, 0.2]", 0.1)), "cuts another shape"),
        (
            "[[shapes]]\nkind = \"cylinder\"\naxis = \"z\"\ncentre = [0.5, 0.2, 0.2]\nradius = 0.1\n\
             [[variables]]\nnumber = \"shapes[0].centre[2]\"\nlower = 0.1\nupper = 0.3\n"
                .to_string(),
            "does not change the shape",
        ),
        (format!("{}ends = [0.0, 0.2]\n", middle), "shapes[0].ends: has no meaning here"),
        (section("[[0.4, 0.1], [0.6, 0.1], [0.5, 0.3]]", "ends = [0.2, 0.2]"), "shapes[0].ends: [0.2, 0.2]"),
        (section("[[0.4, 0.1], [0.6, 0.1], [0.5, 0.3]]", "ends = [0.2]"), "shapes[0].ends: [0.2]"),
        (
            // An L of narrow arms, whose centroid is outside.
            section(
                "[[0.3, 0.1], [0.6, 0.1], [0.6, 0.15], [0.35, 0.15], [0.35, 0.3], [0.3, 0.3]]",
                "ends = [0.0, 0.2]",
            ),
            "not all of its outline is seen",
        ),
    ];
    for (more, problem) in cases {
        std::fs::write(&file, format!("{BOX}{more}")).unwrap();
        let loaded = Config::load(Some(file.to_str().unwrap()), None, &[]);
        let error = match loaded {
            Ok(loaded) => AroundBodies::new(&loaded.config).err().map(|error| error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        let error = error.unwrap_or_else(|| panic!("{problem}: not refused"));
        assert!(error.contains(problem), "{problem}: {error}");
    }
}

/// A channel of some depth with a hot box of 0.4 x 0.4 from `low` to `high` along z.
fn on_the_floor(sides: &str, depth: f64, inflow: &str, [low, high]: [f64; 2], more: &str) -> String {
    format!(
        "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.1\ninitial.temperature = 0.0\nfluid.viscosity = 0.05\n\
         fluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\nregion.size = [1.6, 1.0, {depth}]\nregion.periodic = [false, false, false]\n\
         region.sides.left = {{ kind = \"inflow\", velocity = [\"{inflow}\", 0, 0], temperature = 0 }}\n\
         region.sides.right = {{ kind = \"outflow\" }}\n{sides}\nobjective.kind = \"shape-heat\"\n\
         [[shapes]]\nkind = \"box\"\nlower = [0.5, 0.3, {low}]\nupper = [0.9, 0.7, {high}]\ntemperature = 1.0\n{more}"
    )
}

/// A box on a side where fluid slips has half of the drag and heat of one twice as high in a channel twice as deep. Its volume is that of the
/// box in the region.
#[test]
fn a_box_on_a_side_is_half_of_one_that_is_twice_as_high() {
    let figures = |text: &str| {
        let (around, solution) = solved(text);
        let value = |figure: Figure| around.value(&solution, figure);
        let [heat, drag] = [value(Figure::Heat { shape: 0 }), value(Figure::Force { shape: 0, along: 0 })];
        (heat, drag, solution.shaped.volume)
    };
    let slips = "region.sides.back = { kind = \"symmetry\" }";
    let half = figures(&on_the_floor(slips, 0.8, "6*y*(1-y)*(1-(z/0.8)^2)", [-0.3, 0.3], ""));
    let whole = figures(&on_the_floor("", 1.6, "6*y*(1-y)*(1-((z-0.8)/0.8)^2)", [0.5, 1.1], ""));
    println!("{half:?} of {whole:?}");
    assert!((half.2 - (1.6 * 0.8 - 0.16 * 0.3)).abs() < 1e-12 && (whole.2 - 2.0 * half.2).abs() < 1e-12);
    // Layers and lattice are not mirrors of each other, and the half is three spacings high.
    let off = |half: f64, whole: f64| (2.0 * half / whole - 1.0).abs();
    assert!(off(half.0, whole.0) < 0.04 && off(half.1, whole.1) < 0.02);
}

/// Boxes on one side, in an edge of the region, and from side to side have exact derivatives; what is behind a side changes nothing.
#[test]
fn boxes_on_sides_have_exact_derivatives() {
    let places = [
        ([0.5, 0.3, -0.2], [0.9, 0.7, 0.3]),
        ([0.5, -0.1, -0.2], [0.9, 0.45, 0.3]),
        ([0.5, -0.1, 0.3], [0.9, 1.1, 0.6]),
    ];
    for (lower, upper) in places {
        let mut text = on_the_floor("", 0.8, "16*y*(1-y)*z*(0.8-z)", [0.0, 0.1], "");
        text = text.replace("lower = [0.5, 0.3, 0]", &format!("lower = {lower:?}"));
        text = text.replace("upper = [0.9, 0.7, 0.1]", &format!("upper = {upper:?}"));
        text = text.replace("dx = 0.1\n", "dx = 0.13\n");
        let mut around = AroundBodies::new(&loaded(&text)).unwrap();
        let terms = [(Figure::Heat { shape: 0 }, 1.0), (Figure::Force { shape: 0, along: 0 }, 0.3)];
        let numbers = around.flow.cloud.numbers();
        let solution = around.flow.solve(&numbers).expect("a flow");
        let wanted = [(0, 0), (0, 2), (0, 5)];
        let gradient = around.flow.gradient(&solution, &terms, &wanted).expect("a gradient").by_numbers;
        let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for (own, (shape, number)) in gradient.into_iter().zip(wanted) {
            if number == 2 && lower[2] < 0.0 {
                assert_eq!(own, 0.0, "{lower:?}");
                continue;
            }
            let mut at = |step: f64| {
                let mut moved = numbers.clone();
                moved[shape][number] += step;
                let solution = around.flow.solve(&moved).expect("a flow");
                let value = |(figure, weight): &(Figure, f64)| {
                    weight * around.flow.measures.value(*figure, &around.flow.at(&solution))
                };
                terms.iter().map(value).sum::<f64>()
            };
            let [wide, narrow] = [2e-3, 1e-3].map(|step| (at(step) - at(-step)) / (2.0 * step));
            let difference = (4.0 * narrow - wide) / 3.0;
            println!("{lower:?}, number {number}: {own} {difference}");
            assert!((own - difference).abs() < 1e-6 * norm, "{lower:?}, number {number}: {own} {difference}");
        }
    }
}

/// A box that leaves its side is another shape, for which particles are placed anew; one out of the region is none.
#[test]
fn a_box_stays_on_its_sides() {
    let text = on_the_floor("", 0.8, "16*y*(1-y)*z*(0.8-z)", [-0.1, 0.3], "");
    let around = AroundBodies::new(&loaded(&text)).unwrap();
    let mut numbers = around.flow.cloud.numbers();
    numbers[0][2] = -0.3;
    assert!(around.flow.cloud.shaped(&numbers).is_ok());
    numbers[0][2] = 0.01;
    let refused = around.flow.cloud.shaped(&numbers).err();
    assert!(matches!(refused, Some(Unusable::Folded(_))), "{refused:?}");
    let behind = on_the_floor("", 0.8, "16*y*(1-y)*z*(0.8-z)", [-0.4, -0.1], "");
    let error = AroundBodies::new(&loaded(&behind)).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(
        error.contains("is not in it") && error.contains("they may stand on sides and reach through them"),
        "{error}"
    );
}

/// Drag, lift and heat of a cube of four spacings on the floor of a duct beside finite elements (`scripts/standing_fem.py 16
/// data/scenes/examples/cube.toml`; with 12 bricks a length 0.5745, 0.1806 and a lift of -0.1046), by the closed surface around it. Sums
/// over its points are 17 and 34 % off. Where the floor within the surface was told by its cells and not by its edge, which goes through points
/// of the floor, the lift was 3 % off, with dx = 0.067 27 %.
#[test]
fn a_surface_around_a_cube_tells_its_drag_and_heat() {
    let text = std::fs::read_to_string("data/scenes/examples/cube.toml").unwrap();
    let (around, solution) = solved(&text);
    let value = |figure: Figure| around.value(&solution, figure);
    let force = [0, 1, 2].map(|along| value(Figure::Force { shape: 0, along }));
    let (drag, heat) = (force[0], value(Figure::Heat { shape: 0 }));
    let at = around.flow.at(&solution);
    let own = [around.flow.measures.surface_force(&at, 0, 0), around.flow.measures.surface_heat(&at, 0)];
    println!("{force:?} {heat}, by its points {own:?}");
    assert!((drag / 0.5764 - 1.0).abs() < 0.01 && (heat / 0.18033 - 1.0).abs() < 0.025, "{drag} {heat}");
    assert!((force[2] / -0.1046 - 1.0).abs() < 0.015 && force[1].abs() < 1e-3, "{force:?}");
    assert!(own[0] < 0.9 * drag && own[1] < 0.8 * heat, "{own:?}");
}

/// A shape on a side covers more of it when it grows, and the fluid pushes that part of the side no more: the derivative of its lift beside what
/// clouds of their own say of other lengths, which see other particles. Without what it covers it was 30 % less, and by the height along z
/// its sign was wrong.
#[test]
fn what_a_shape_covers_of_a_side_is_in_the_derivative_of_its_lift() {
    let text = |[low, high, top]: [f64; 3]| {
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.1\nregion.size = [2.0, 1.0, 1.0]\n\
             region.periodic = [false, false, false]\nfluid.viscosity = 0.05\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [\"16*y*(1-y)*z*(1-z)\", 0, 0] }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\n\
             [[shapes]]\nkind = \"box\"\nlower = [{low}, -0.2, 0.3]\nupper = [{high}, 0.4, {top}]\n"
        )
    };
    let lift = Figure::Force { shape: 0, along: 1 };
    let (mut around, solution) = solved(&text([0.6, 1.0, 0.7]));
    let wanted = [(0, 0), (0, 3), (0, 5)];
    let gradient = around.flow.gradient(&solution, &[(lift, 1.0)], &wanted).expect("a gradient").by_numbers;
    let placed = |numbers: [f64; 3]| {
        let (around, solution) = solved(&text(numbers));
        around.value(&solution, lift)
    };
    let differences = [
        (placed([0.62, 1.0, 0.7]) - placed([0.58, 1.0, 0.7])) / 0.04,
        (placed([0.6, 1.02, 0.7]) - placed([0.6, 0.98, 0.7])) / 0.04,
        (placed([0.6, 1.0, 0.72]) - placed([0.6, 1.0, 0.68])) / 0.04,
    ];
    println!("{gradient:?} {differences:?}");
    for (derivative, difference) in gradient.iter().zip(&differences) {
        assert!((derivative - difference).abs() < 0.06, "{gradient:?} {differences:?}");
    }
    // In the same cloud it is exact.
    let numbers = around.flow.cloud.numbers();
    let mut at = |by: f64| {
        let mut moved = numbers.clone();
        wanted.iter().for_each(|&(shape, number)| moved[shape][number] += by);
        let solution = around.flow.solve(&moved).expect("a flow");
        around.flow.measures.value(lift, &around.flow.at(&solution))
    };
    let (own, difference) = (gradient.iter().sum::<f64>(), (at(1e-4) - at(-1e-4)) / 2e-4);
    assert!((own - difference).abs() < 1e-5, "{own} {difference}");
}

/// A channel with a hot cylinder on its floor, and its drag and heat.
fn pin(more: &str) -> String {
    format!(
        "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.1\nregion.size = [2.0, 1.0, 1.0]\n\
         region.periodic = [false, false, false]\nfluid.viscosity = 0.05\nfluid.conductivity = 0.05\n\
         fluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
         region.sides.left = {{ kind = \"inflow\", velocity = [\"16*y*(1-y)*z*(1-z)\", \"0\", \"0\"], temperature = 0.0 }}\n\
         region.sides.right = {{ kind = \"outflow\" }}\nobjective.kind = \"shape-heat\"\n\
         [[shapes]]\nkind = \"cylinder\"\naxis = \"z\"\ncentre = [0.8, 0.5, 0.0]\nradius = 0.2\ntemperature = 1.0\n{more}"
    )
}

/// Drag and heat of a cylinder of four spacings on the floor of a duct beside finite elements (`scripts/standing_fem.py 12` with this scene: 0.45858,
/// 0.16616; with 8 elements along a length of 1 0.46006 and 0.16650), and its volume.
#[test]
fn a_cylinder_on_the_floor_has_the_drag_and_heat_of_finite_elements() {
    let (around, solution) = solved(&pin("ends = [-0.1, 0.4]"));
    let value = |figure: Figure| around.value(&solution, figure);
    let [drag, heat] = [value(Figure::Force { shape: 0, along: 0 }), value(Figure::Heat { shape: 0 })];
    println!("{drag} {heat}");
    assert!((drag / 0.458 - 1.0).abs() < 0.01 && (heat / 0.166 - 1.0).abs() < 0.03, "{drag} {heat}");
    assert!((solution.shaped.volume - (2.0 - PI * 0.04 * 0.4)).abs() < 1e-10, "{}", solution.shaped.volume);
}

/// Of a ball that stands on a side, or between two opposite ones: the volume and the area of what is in the region, places and areas by its
/// numbers beside differences, and layers that go on around it.
#[test]
fn a_ball_on_a_side_is_cut_there() {
    let region = Region { size: [2.0, 1.2, 1.0], periodic: [true, false, false] };
    for (numbers, sides) in [
        ([0.5, 0.6, 0.0, 0.25], vec![4]),
        ([0.5, 0.6, 0.12, 0.25], vec![4]),
        ([0.4, 1.35, 0.5, 0.3], vec![3]),
        ([0.5, 0.6, 0.45, 0.57], vec![4, 5]),
        ([0.5, 0.6, 0.25, 0.25], vec![4]),
        ([0.5, 0.6, 0.75 + 1e-11, 0.25], vec![5]),
    ] {
        let form = Form::Ball(Standing::of_ball(&region, &numbers));
        let surface = Surface { form, ..ball([numbers[0], numbers[1], numbers[2]], numbers[3]) };
        assert_eq!((0..6).filter(|&side| surface.stands_on(side)).collect::<Vec<_>>(), sides, "{numbers:?}");
        let (axis, r) = (sides[0] / 2, numbers[3]);
        // Heights from the centre between which it is in the region.
        let low = -numbers[axis].min(r);
        let high = (region.size[axis] - numbers[axis]).min(r);
        let over = |h: f64| PI * (r * r * h - h.powi(3) / 3.0);
        let (volume, area) = (over(high) - over(low), 2.0 * PI * r * (high - low));
        for spacing in [0.05, 0.025] {
            let spots = surface.spread(&region, spacing, 0.0);
            let on: Vec<_> = spots.iter().map(|spot| surface.at(spot, &numbers)).collect();
            let length = |a: [f64; 3]| a.iter().map(|x| x * x).sum::<f64>().sqrt();
            let found = on.iter().map(|on| surface.volume(on, [numbers[0], numbers[1], numbers[2]])).sum::<f64>();
            let whole = on.iter().map(|on| length(on.area)).sum::<f64>();
            // Exact where it stands on one side. Between two it is that across the axis alone, and rings have the radius of their middle: with
            // n of height h it is pi n h^3 / 12 too large.
            let off = if sides.len() > 1 { 0.12 * (spacing / r).powi(2) } else { 1e-12 };
            assert!((found / volume - 1.0).abs() < off, "{numbers:?}: {found} {volume}");
            assert!((whole / area - 1.0).abs() < 1e-12, "{numbers:?}: {whole} {area}");
            // What it leaves open on its sides.
            let open = PI * ((r * r - low * low) - (r * r - high * high));
            let along: f64 = on.iter().map(|on| on.area[axis]).sum();
            assert!((along - open).abs() < 1e-12, "{numbers:?}: {along} {open}");
            assert!(on.iter().all(|on| surface.distance(&region, on.place).abs() < 1e-12));
            for side in &sides {
                let from = |p: &[f64; 3]| if side % 2 == 0 { p[axis] } else { region.size[axis] - p[axis] };
                assert!(on.iter().all(|on| from(&on.place) >= 0.35 * spacing), "{numbers:?}");
            }
            // As many points as its area has places.
            let each = area / on.len() as f64 / (spacing * spacing);
            assert!((0.8..1.3).contains(&each), "{numbers:?}: {each}");
        }
        for spot in surface.spread(&region, 0.05, 0.05) {
            let on = surface.at(&spot, &numbers);
            let n = on.area.map(|a| a / on.area.iter().map(|x| x * x).sum::<f64>().sqrt());
            let p: [f64; 3] = std::array::from_fn(|d| on.place[d] + 0.05 * n[d]);
            assert!((surface.distance(&region, p) - 0.05).abs() < 1e-12);
            for side in &sides {
                let from = if side % 2 == 0 { p[axis] } else { region.size[axis] - p[axis] };
                assert!(from > 0.02, "{numbers:?}: {p:?}");
            }
        }
        depend_on_numbers(&surface, &surface.spread(&region, 0.1, 0.0), 1e-6, 1e-6);
    }
    let text = |centre: &str| {
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.1\nregion.size = [1.0, 1.0, 1.0]\n\
             region.periodic = [true, false, false]\nregion.acceleration = [1.0, 0.0, 0.0]\nfluid.viscosity = 1.0\n\
             [[shapes]]\nkind = \"disc\"\ncentre = {centre}\nradius = 0.25\n"
        )
    };
    let error = AroundBodies::new(&loaded(&text("[0.5, 0.1, 0.1]"))).err().unwrap().to_string();
    assert!(
        error.contains("shapes[0] is a ball that goes through sides of the region which are not opposite"),
        "{error}"
    );
}

/// Drag, lift and heat of domes of five spacings on the floor of a duct beside finite elements (`scripts/standing_fem.py 12` with these scenes), half
/// of a ball, and more or less of it; and the derivatives of one by its height and radius beside differences.
#[test]
fn a_dome_on_the_floor_has_the_forces_and_heat_of_finite_elements() {
    for (height, radius, drag, lift, heat) in [
        (0.0, 0.25, 0.19537, -0.13987, 0.11710),
        (0.12, 0.25, 0.36398, -0.09589, 0.14951),
        (-0.12, 0.3, 0.14064, -0.17333, 0.10480),
    ] {
        let text = pin("").replace("kind = \"cylinder\"\naxis = \"z\"", "kind = \"disc\"");
        let text = text.replace(
            "centre = [0.8, 0.5, 0.0]\nradius = 0.2",
            &format!("centre = [0.8, 0.5, {height}]\nradius = {radius}"),
        );
        let (mut around, solution) = solved(&text);
        let terms =
            [Figure::Force { shape: 0, along: 0 }, Figure::Force { shape: 0, along: 2 }, Figure::Heat { shape: 0 }];
        let found = terms.map(|figure| around.value(&solution, figure));
        println!("{height}: {found:?}");
        let off = |k: usize, known: f64| (found[k] - known).abs() / known.abs();
        // Drags of domes are small beside what the floor below them would have.
        assert!(off(0, drag) < 0.06 && off(1, lift) < 0.025 && off(2, heat) < 0.06, "{height}: {found:?}");
        // One of them is enough.
        if height <= 0.0 {
            continue;
        }
        let wanted = [(0, 2), (0, 3)];
        let weighted = terms.map(|figure| (figure, 1.0));
        let gradient = around.flow.gradient(&solution, &weighted, &wanted).expect("a gradient").by_numbers;
        let numbers = around.flow.cloud.numbers();
        for (&(shape, number), derivative) in wanted.iter().zip(&gradient) {
            let mut at = |by: f64| {
                let mut moved = numbers.clone();
                moved[shape][number] += by;
                let solution = around.flow.solve(&moved).expect("a flow");
                terms.iter().map(|figure| around.flow.measures.value(*figure, &around.flow.at(&solution))).sum::<f64>()
            };
            let difference = (at(1e-4) - at(-1e-4)) / 2e-4;
            assert!((derivative - difference).abs() < 1e-5 * derivative.abs(), "{derivative} {difference}");
        }
    }
}

/// Columns between two ends, in the fluid and on a side, have the volume and the area of what they are, and closed surfaces, which are as far as
/// they are moved; one that ends behind both sides is the column without ends.
#[test]
fn columns_with_ends_are_closed() {
    let region = Region { size: [1.0, 1.0, 1.0], periodic: [true, false, false] };
    let disc =
        ShapeEntry { kind: Kind::Disc, centre: Some(vec![0.5, 0.4]), radius: Some(0.2), ..ShapeEntry::default() };
    let radii = Some(vec![0.2, 0.25, 0.2, 0.18, 0.22]);
    let spline = ShapeEntry { kind: Kind::Spline, centre: Some(vec![0.5, 0.4]), radii, ..ShapeEntry::default() };
    // Points of a spline are not as evenly spaced as those of a disc.
    for (entry, off) in [(disc, 1e-12), (spline, 5e-3)] {
        let column = |ends: Option<&[f64]>| Surface::column(Outline::new(&entry, 0.0).unwrap(), 2, ends, &region);
        let of = |surface: &Surface| {
            let spots = surface.spread(&region, 0.05, 0.0);
            let on: Vec<_> = spots.iter().map(|spot| surface.at(spot, &surface.numbers)).collect();
            let volume = on.iter().map(|on| surface.volume(on, [0.5, 0.4, 0.45])).sum::<f64>();
            let whole: [f64; 3] = std::array::from_fn(|d| on.iter().map(|on| on.area[d]).sum());
            for (on, sign) in on.iter().flat_map(|on| [(on, 1.0), (on, -1.0)]) {
                let size = on.area.iter().map(|a| a * a).sum::<f64>().sqrt();
                let beside = std::array::from_fn(|d| on.place[d] + sign * 0.01 * on.area[d] / size);
                assert!((surface.distance(&region, beside) / (sign * 0.01) - 1.0).abs() < 0.1, "{on:?}");
            }
            (volume, whole)
        };
        let section = of(&column(None)).0;
        for (ends, height, open) in [([0.3, 0.6], 0.3, 0.0), ([-0.2, 0.6], 0.6, 1.0), ([0.4, 1.5], 0.6, -1.0)] {
            let (volume, whole) = of(&column(Some(&ends)));
            assert!((volume - section * height).abs() < off, "{ends:?}: {volume}, {}", section * height);
            assert!(whole[0].abs() < off && whole[1].abs() < off, "{ends:?}: {whole:?}");
            assert!((whole[2] - open * section).abs() < off, "{ends:?}: {whole:?}, section {section}");
        }
        let (all, between) = (column(None), column(Some(&[-0.1, 1.3])));
        let places = |surface: &Surface| -> Vec<[f64; 3]> {
            [0.0, 0.05]
                .iter()
                .flat_map(|&away| surface.spread(&region, 0.05, away))
                .map(|spot| surface.at(&spot, &surface.numbers).place)
                .collect()
        };
        assert!(places(&all) == places(&between) && (0..6).all(|side| all.stands_on(side) == between.stands_on(side)));
    }
}

/// Heat and drag by the radius of a cylinder on the floor, by its end in the fluid and by the one behind the floor, which changes nothing.
#[test]
fn ends_of_columns_have_exact_derivatives() {
    let mut around =
        AroundBodies::new(&loaded(&pin("ends = [-0.1, 0.4]").replace("dx = 0.1\n", "dx = 0.13\n"))).unwrap();
    let terms = [(Figure::Heat { shape: 0 }, 1.0), (Figure::Force { shape: 0, along: 0 }, 0.3)];
    let numbers = around.flow.cloud.numbers();
    let solution = around.flow.solve(&numbers).expect("a flow");
    let names: Vec<Part> = around.flow.cloud.ground.surfaces[0].parts.clone();
    let of = |part: Part| (0, names.iter().position(|other| *other == part).expect("a number"));
    let wanted = [of(Part::Radius), of(Part::End(1)), of(Part::End(0))];
    let gradient = around.flow.gradient(&solution, &terms, &wanted).expect("a gradient").by_numbers;
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    assert!(gradient[2] == 0.0 && gradient[0].abs() > 0.1 * norm && gradient[1].abs() > 0.1 * norm, "{gradient:?}");
    // Along both at once, so that it takes few solutions.
    let mut at = |step: f64| {
        let mut moved = numbers.clone();
        moved[0][wanted[0].1] += step;
        moved[0][wanted[1].1] += 2.0 * step;
        let solution = around.flow.solve(&moved).expect("a flow");
        terms
            .iter()
            .map(|(figure, weight)| weight * around.flow.measures.value(*figure, &around.flow.at(&solution)))
            .sum::<f64>()
    };
    let [wide, narrow] = [2e-3, 1e-3].map(|step| (at(step) - at(-step)) / (2.0 * step));
    let (own, difference) = (gradient[0] + 2.0 * gradient[1], (4.0 * narrow - wide) / 3.0);
    println!("{own} {difference}");
    assert!((own - difference).abs() < 1e-6 * norm, "{own} {difference}");
}

/// What goes through the surface around a ball that warms a fluid at rest, with what the fluid within keeps, is its exact heat, with sound too.
#[test]
fn a_surface_tells_the_heat_while_a_ball_warms_its_fluid() {
    let text = |dx: f64, pressure: &str| {
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\nmethod.pressure = \"{pressure}\"\nresolution.dx = {dx}\n\
             time.end = 0.3\nregion.size = [1.0, 1.0, 1.0]\nregion.periodic = [false, false, false]\nregion.acceleration = [0.0, 0.0, 0.0]\n\
             fluid.viscosity = 0.02\nfluid.conductivity = 0.02\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
             [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.5, 0.5]\nradius = 0.2\ntemperature = 1.0\n"
        )
    };
    // A ball in a fluid without end: 4 pi R alpha (1 + R / sqrt(pi alpha t)) (Carslaw and Jaeger 1959, 9.10).
    let exact = 4.0 * PI * 0.2 * 0.02 * (1.0 + 0.2 / (PI * 0.02 * 0.3).sqrt());
    for pressure in ["incompressible", "weakly-compressible"] {
        let around = AroundBodies::new(&loaded(&text(1.0 / 12.0, pressure))).unwrap();
        let solution = around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap().1;
        let found = around.value(&solution, Figure::Heat { shape: 0 });
        println!("{pressure}: {found} beside {exact}");
        assert!((found / exact - 1.0).abs() < 0.04, "{pressure}: {found} beside {exact}");
    }
}
