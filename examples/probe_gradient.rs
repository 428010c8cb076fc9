use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::segments::{gradient, Sph};
use hydrograd::scene::config::{Config, Kernels};
use hydrograd::scene::heated_channel::HeatedChannel;
use hydrograd::scene::shape::Shape;
use hydrograd::solver::Snapshot;
use std::sync::Arc;
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;
fn main() {
    let sets: Vec<String> = std::env::args().skip(1).collect();
    let loaded = Config::load(None, None, &sets).unwrap();
    let c = &loaded.config;
    let shape = Shape::from_config(c).unwrap();
    let ch = HeatedChannel::<f64>::new(c, &shape);
    let state = ch.deformation.state::<f64>(&shape.offsets);
    let n = ch.model.particles();
    let start = Snapshot { step: 0, reference: Arc::new(state[..2 * n].to_vec()), state };
    let d = Sph { model: ch.model.clone(), kernels: Kernels::Fused };
    let g = gradient(&d, &start, &Schedule::segments(ch.steps, std::env::var("SEG").map_or(30, |v| v.parse().unwrap())), &ch.objective, &mut |_| ()).unwrap();
    let bar = g.state.flatten_all().unwrap().to_vec1::<f64>().unwrap();
    let gr = ch.deformation.adjoint(&bar);
    print!(
        "steps {} Q {:.6} fwd {:.2}ms bwd {:.2}ms: ",
        ch.steps,
        g.value,
        1e3 * g.forward_seconds / ch.steps as f64,
        1e3 * g.backward_seconds / ch.steps as f64
    );
    for x in gr {
        print!("{:.1} ", x * 1e3);
    }
    println!();
}
