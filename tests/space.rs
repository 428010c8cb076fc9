//! Fixed particles around shapes in space.

use hydrograd::config::custom::Part;
use hydrograd::sph::cloud::equations::Warmth;
use hydrograd::sph::cloud::figures::Figure;
use hydrograd::sph::cloud::nearest::Region;
use hydrograd::sph::cloud::space::equations::Motion;
use hydrograd::sph::cloud::space::particles::{Cloud, Fluid, Surroundings};
use hydrograd::sph::cloud::space::placing::{BoundaryPoint, Ground};
use hydrograd::sph::cloud::space::problem::SteadyFlow;
use hydrograd::sph::cloud::space::surface::{Form, Surface};
use std::sync::Arc;

#[derive(Debug)]
struct AtRest;

impl Surroundings for AtRest {
    fn condition(&self, point: &BoundaryPoint, _: [f64; 3], _: &[Vec<f64>]) -> (Motion, Warmth) {
        (Motion::Given([0.0; 3]), Warmth::Given(if point.on.is_some() { 1.0 } else { 0.0 }))
    }
    fn varies(&self, _: usize) -> bool {
        false
    }
}

fn ball(centre: [f64; 3], radius: f64) -> Surface {
    let parts = vec![Part::Centre(0), Part::Centre(1), Part::Centre(2), Part::Radius];
    Surface { form: Form::Ball, parts, numbers: vec![centre[0], centre[1], centre[2], radius], geometry: 4 }
}

/// A sphere that fills a part of a periodic cube, in Stokes flow.
fn periodic(part: f64, cells: f64, surface: f64, viscosity: f64) -> SteadyFlow {
    let radius = (3.0 * part / (4.0 * std::f64::consts::PI)).cbrt();
    let region = Region { size: [1.0; 3], periodic: [true; 3] };
    let dx = 1.0 / cells;
    let ground = Ground { region, dx, surface: surface * dx, surfaces: vec![ball([0.5; 3], radius)] };
    let fluid = Fluid { viscosity, diffusivity: None, force: [1.0, 0.0, 0.0], velocity: 1e-3 };
    let cloud = Cloud::new(ground, fluid, Arc::new(AtRest), 2).unwrap();
    SteadyFlow::new(cloud, None, &[], 2).unwrap()
}

#[test]
fn drag_of_a_cubic_array_of_spheres_is_that_of_zick_and_homsy() {
    let env = |name: &str, value: f64| std::env::var(name).ok().and_then(|x| x.parse().ok()).unwrap_or(value);
    let (cells, surface) = (env("CELLS", 16.0), env("H0", 0.5));
    for (part, known) in [(0.064, 2.810), (0.125, 4.292), (0.343, 15.4)] {
        let clock = std::time::Instant::now();
        let viscosity = 100.0;
        let mut flow = periodic(part, cells, surface, viscosity);
        let placed = clock.elapsed().as_secs_f64();
        if let Ok(path) = std::env::var("HG_DUMP") {
            let rows: Vec<f64> = flow.cloud.places.place.iter().flatten().copied().chain(flow.cloud.places.spacing.iter().copied()).collect();
            std::fs::write(format!("{path}.place"), rows.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
            std::fs::write(format!("{path}.inside"), (flow.cloud.places.inside as f64).to_le_bytes()).unwrap();
        }
        let solution = flow.solve(&flow.cloud.numbers()).unwrap();
        let rate = flow.measures.value(Figure::FlowRate, &flow.at(&solution));
        let at = flow.at(&solution);
        let radius = flow.cloud.numbers()[0][3];
        let drag = 1.0 / (6.0 * std::f64::consts::PI * viscosity * radius * rate);
        let force = flow.measures.surface_force(&at, 0, 0);
        println!("{part} n {} inside {}: K {drag:.4} known {known} {:+.3} %, surface force {force:.5} volume {:.5} exact {:.5} lambda {:.2e} counts {:?} {placed:.1} {:.1} s",
            flow.cloud.particles(), flow.cloud.places.inside, 100.0 * (drag / known - 1.0), solution.shaped.volume, 1.0 - part, solution.state.lambda / rate, flow.solver.counts, clock.elapsed().as_secs_f64());
    }
}
