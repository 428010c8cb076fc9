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
    let text = std::fs::read_to_string("data/reference/fem-shapes-H0.2.csv").unwrap();
    let mut pts = vec![];
    for line in text.lines().skip(1) {
        let f: Vec<&str> = line.split(',').collect();
        let off: Vec<f64> = f[13..38].iter().map(|x| x.parse().unwrap()).collect();
        let fq: f64 = f[3].parse().unwrap();
        let ff: f64 = f[6].parse().unwrap();
        let nodes = hydrograd::scene::shape::default_nodes(0.25, 0.75, 0.02);
        let Ok(shape) = Shape::new(nodes, off.clone(), c.channel.hot_from, c.channel.hot_to) else { continue };
        let ch = HeatedChannel::<f64>::new(c, &shape);
        let mut s = Solver::new(ch.model.clone(), ch.deformation.state(&off)).unwrap();
        let (mut q, mut cnt, mut flow) = (0.0, 0.0, 0.0);
        for k in 0..ch.steps {
            if s.advance().is_err() {
                q = f64::NAN;
                break;
            }
            if k + ch.window >= ch.steps && k % 5 == 0 {
                let f = ch.objective.fields(&mut s);
                let m = ch.objective.targets.len();
                q += ch.objective.outflow(&f);
                flow += ch.objective.scale * f[m..2 * m].iter().sum::<f64>();
                cnt += 1.0;
            }
        }
        pts.push((fq, q / cnt));
        if std::env::var("V").is_ok() {
            println!(
                "{} {} FEM Q {:.5} flow {:.4}  ours {:.5} {:.4} ratio {:.3} {:.3}",
                f[0],
                f[1],
                fq,
                ff,
                q / cnt,
                flow / cnt,
                q / cnt / fq,
                flow / cnt / ff
            );
        }
    }
    let n = pts.len() as f64;
    let (mx, my) = (pts.iter().map(|p| p.0).sum::<f64>() / n, pts.iter().map(|p| p.1).sum::<f64>() / n);
    let cov = pts.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>();
    let (vx, vy) =
        (pts.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>(), pts.iter().map(|p| (p.1 - my).powi(2)).sum::<f64>());
    println!(
        "{sets:?} n {n} mean ratio {:.4} corr {:.3} slope {:.2} max|err| {:.3}",
        my / mx,
        cov / (vx * vy).sqrt(),
        cov / vx,
        pts.iter().map(|p| (p.1 / p.0 - 1.0).abs()).fold(0.0, f64::max)
    );
}
