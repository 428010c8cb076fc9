use hydrograd::scene::config::Config;
use hydrograd::scene::heated_channel::HeatedChannel;
use hydrograd::scene::shape::Shape;
use hydrograd::solver::Solver;
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;
fn main() {
    let sets: Vec<String> = std::env::args().skip(1).collect();
    let loaded = Config::load(None, None, &sets).unwrap();
    let c = &loaded.config;
    let nodes = hydrograd::scene::shape::default_nodes(c.channel.hot_from, c.channel.hot_to, 0.02);
    let off = c.design.offsets.clone().unwrap_or(vec![0.0; nodes.len()]);
    let shape = Shape::new(nodes, off.clone(), c.channel.hot_from, c.channel.hot_to).unwrap();
    let ch = HeatedChannel::<f64>::new(c, &shape);
    let mut s = Solver::new(ch.model.clone(), ch.deformation.state(&off)).unwrap();
    let t0 = std::time::Instant::now();
    let n = ch.model.particles();
    let mut q = 0.0;
    let mut um = 0.0;
    let mut us = 0.0;
    let mut q2 = 0.0;
    let mut o2 = ch.objective.clone();
    o2.targets = std::sync::Arc::new(
        ch.objective.targets.iter().flat_map(|t| [0.2, 0.4, 0.5, 0.6, 0.8].map(|x| [x, t[1], 0.0])).collect(),
    );
    let mut cnt = 0.0;
    let mut flow = 0.0;
    let mut rho = 0.0;
    let every = (0.1 / ch.model.dt) as usize;
    for k in 0..ch.steps {
        if let Err(e) = s.advance() {
            println!("FAILED {e}");
            return;
        }
        if k + ch.window >= ch.steps && k % 5 == 0 {
            let f = ch.objective.fields(&mut s);
            let m = ch.objective.targets.len();
            q += ch.objective.outflow(&f);
            flow += ch.objective.scale * f[m..2 * m].iter().sum::<f64>();
            let mut u: f64 = 0.0;
            for i in 0..n {
                if ch.model.is_fluid(i) {
                    u = u.max(s.row(2)[i]);
                    rho += s.primitives[i] / (n as f64);
                }
            }
            um += u;
            cnt += 1.0;
            let qq = ch.objective.outflow(&f);
            q2 += qq * qq;
            let f2 = o2.fields(&mut s);
            let m2 = o2.targets.len();
            us += f2[m2..2 * m2].iter().cloned().fold(0.0, f64::max);
        }
        if std::env::var("HIST").is_ok() && k % every == 0 {
            let f = ch.objective.fields(&mut s);
            println!("t {:.3} Q {:.6}", k as f64 * ch.model.dt, ch.objective.outflow(&f));
        }
    }
    let fl = ch.model.tags.iter().filter(|&&t| t == 0).count() as f64 / n as f64;
    println!(
        "{:?} N {n} dt {:.3e} steps {} Q {:.6} +-{:.6} u_max {:.5} smooth {:.5} flow {:.5} rho {:.5} {:.4} ms/step",
        sets,
        ch.model.dt,
        ch.steps,
        q / cnt,
        (q2 / cnt - q * q / cnt / cnt).abs().sqrt(),
        um / cnt,
        us / cnt,
        flow / cnt,
        rho / cnt / fl,
        t0.elapsed().as_secs_f64() * 1e3 / ch.steps as f64
    );
}
